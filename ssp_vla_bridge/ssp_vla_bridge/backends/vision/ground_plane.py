"""Pixels on the road and back: a pinhole camera over a flat ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ssp_vla_bridge.core.request import CameraGeometry

FloatArray = NDArray[np.float64]

ASSUMED_HFOV_DEG = 60.0
ASSUMED_HEIGHT_M = 1.4
ASSUMED_PITCH_DOWN_RAD = 0.0
FARTHEST_M = 80.0


@dataclass(frozen=True)
class GroundPlane:
    """A camera over a flat road, for images of one size.

    Ground coordinates are x forward of the camera and y to the left, m.

    Args:
        fx_px: focal length along the width, px.
        fy_px: focal length along the height, px.
        cx_px: principal point, px.
        cy_px: principal point, px.
        width_px: image width.
        height_px: image height.
        height_m: camera above ground, m.
        pitch_down_rad: rad, + looks down.
        assumed: what of this was not given but assumed.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int
    height_m: float
    pitch_down_rad: float
    assumed: tuple[str, ...] = ()

    @property
    def horizon_px(self) -> float:
        """Row of the horizon: v = cy − fy tan(pitch)."""
        return self.cy_px - self.fy_px * math.tan(self.pitch_down_rad)

    @cached_property
    def row_x_m(self) -> FloatArray:
        """Distance ahead of the ground seen in each row, m; infinite at and above the horizon."""
        slope = (np.arange(self.height_px) - self.cy_px) / self.fy_px
        c, s = math.cos(self.pitch_down_rad), math.sin(self.pitch_down_rad)
        down = slope * c + s
        safe = np.where(down > 1e-6, down, np.nan)
        ahead = self.height_m * (c - slope * s) / safe
        return np.asarray(np.where(np.isnan(ahead) | (ahead <= 0), np.inf, ahead))

    @cached_property
    def row_px_per_m(self) -> FloatArray:
        """Image size of 1 m that stands on the ground seen in each row, px/m; 0 at the horizon."""
        slope = (np.arange(self.height_px) - self.cy_px) / self.fy_px
        c, s = math.cos(self.pitch_down_rad), math.sin(self.pitch_down_rad)
        return np.asarray(np.maximum(0.0, self.fx_px * (slope * c + s) / self.height_m))

    def y_m(self, u_px: float, row: int) -> float:
        """Lateral position of the ground seen at a pixel, m, + is left."""
        scale = float(self.row_px_per_m[row])
        return (self.cx_px - u_px) / scale if scale > 0 else math.inf

    @cached_property
    def lateral_m(self) -> NDArray[np.float32]:
        """Shape (height, width): lateral position of the ground at each pixel; NaN above it."""
        scale = np.where(self.row_px_per_m > 0, self.row_px_per_m, np.nan)
        columns = np.arange(self.width_px, dtype=np.float64)
        return ((self.cx_px - columns)[None, :] / scale[:, None]).astype(np.float32)


@lru_cache(maxsize=4)
def ground_plane(
    camera: CameraGeometry | None,
    image_size: tuple[int, int],
    scale: float,
    horizon_px: float | None = None,
) -> GroundPlane:
    """The plane for images of a size that are scaled by a factor before they are looked at.

    What the request doesn't give is assumed and named: a field of view, a mounting height, and a
    pitch from the horizon's row if that was found, else a level camera.

    Args:
        camera: as the request gives it.
        image_size: width and height of the images as they came, px.
        scale: of the images that are looked at.
        horizon_px: row of the horizon in the scaled image; used where the pitch is not given.
    """
    width, height = image_size
    assumed = []
    if camera is None:
        assumed.append(f"hfov_deg={ASSUMED_HFOV_DEG:g}")
        focal = width / 2 / math.tan(math.radians(ASSUMED_HFOV_DEG) / 2)
        camera = CameraGeometry(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    # Frames may have been resized after calibration.
    kx = scale * width / (camera.width_px or width)
    ky = scale * height / (camera.height_px or height)
    fy_px, cy_px = camera.fy_px * ky, (camera.cy_px + 0.5) * ky - 0.5
    height_m, pitch = camera.height_m, camera.pitch_down_rad
    if height_m is None:
        height_m = ASSUMED_HEIGHT_M
        assumed.append(f"height_m={height_m:g}")
    if pitch is None:
        pitch = ASSUMED_PITCH_DOWN_RAD
        if horizon_px is not None:
            pitch = math.atan2(cy_px - horizon_px, fy_px)
        assumed.append(f"pitch_down_rad={pitch:.3f}")
    return GroundPlane(
        fx_px=camera.fx_px * kx,
        fy_px=fy_px,
        cx_px=(camera.cx_px + 0.5) * kx - 0.5,
        cy_px=cy_px,
        width_px=round(width * scale),
        height_px=round(height * scale),
        height_m=height_m,
        pitch_down_rad=pitch,
        assumed=tuple(assumed),
    )
