"""The ground in a picture: its plane, the horizon, and which pixels are road."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_vla_bridge.messages import CameraGeometry

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
        """Return the lateral position of the ground seen at a pixel, m, + is left."""
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
    """Return the plane for images of a size that are scaled by a factor before they are looked at.

    What the request doesn't give is assumed and named: a field of view, a mounting height, and a
    pitch from the horizon's row if that was found, else a level camera.

    Args:
        camera: None: nothing is known of it.
        image_size: width and height of the images as they came, px.
        scale: factor from the images as they came to those that are looked at.
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


_SKY_SHARE = 0.45  # lines of the road lie below this share of the height
_MIN_LENGTH_SHARE = 0.06
_STEEP_RAD = (0.25, 1.35)  # slopes of lines that may run along the road
_LONGEST = 24
_MIN_CROSSINGS = 4
_SPREAD_SHARE = 0.06
_PLAUSIBLE_SHARE = (0.25, 0.75)


def horizon_row(images: Sequence[NDArray[np.uint8]]) -> float | None:
    """Return the row in which road lines from left and right meet, px; None when unclear.

    Args:
        images: of one camera, each of shape (height, width, 3).
    """
    height = images[0].shape[0]
    low, high = (share * height for share in _PLAUSIBLE_SHARE)
    rows = np.concatenate([_crossing_rows(image) for image in images])
    rows = rows[(rows > low) & (rows < high)]
    if len(rows) < _MIN_CROSSINGS:
        return None
    row = float(np.median(rows))
    spread = float(np.median(np.abs(rows - row)))
    return row if spread < _SPREAD_SHARE * height else None


def _crossing_rows(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the rows where each line of the left half-plane meets each of the right one, px."""
    height, width = image.shape[:2]
    top = round(_SKY_SHARE * height)
    edges = cv2.Canny(cv2.cvtColor(image[top:], cv2.COLOR_BGR2GRAY), 50, 120)
    lines = cv2.HoughLinesP(
        edges, 1, math.pi / 180, 30, minLineLength=_MIN_LENGTH_SHARE * width, maxLineGap=6
    )
    if lines is None:
        return np.zeros(0)
    segments = lines.reshape(-1, 4).astype(np.float64)
    run, rise = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    steep = np.arctan2(np.abs(rise), np.abs(run))
    useful = (steep > _STEEP_RAD[0]) & (steep < _STEEP_RAD[1])
    order = np.argsort(-np.hypot(run, rise)[useful], kind="stable")[:_LONGEST]
    long_segments = segments[useful][order]
    slope = (long_segments[:, 3] - long_segments[:, 1]) / (
        long_segments[:, 2] - long_segments[:, 0]
    )
    offset = long_segments[:, 1] - slope * long_segments[:, 0]
    # A line on the left of the road rises to the right: its slope in the image is negative.
    left, right = slope < 0, slope > 0
    across = slope[right][None, :] - slope[left][:, None]
    column = (offset[left][:, None] - offset[right][None, :]) / across
    rows = top + slope[left][:, None] * column + offset[left][:, None]
    return np.asarray(rows.ravel())


STRIP_M = 0.1
HALF_WIDTH_M = 8.0
_STRIPS = round(2 * HALF_WIDTH_M / STRIP_M)
_LEARN_TO_M = 8.0
_LEARN_PER_ASIDE = 1.25
_MIN_PIXELS = 12
_NEIGHBOUR_STRIPS = (-1, 1, -2, 2)

_CHROMA_LEVELS = 9.0
_CHROMA_SPREADS = 3.0
_DARK_RATIO = 0.36

_NEUTRAL = np.array([0, 128, 128], np.float32)

ByteImage = NDArray[np.uint8]
Mask = NDArray[np.uint8]


@dataclass(frozen=True)
class Surface:
    """Colour of the ground per strip, in Y, Cr − 128, Cb − 128.

    Args:
        colours: shape (strips, 3), median.
        spreads: shape (strips,), spread of the chroma.
        has_pixels: shape (strips,), where anything was seen.
    """

    colours: NDArray[np.float32]
    spreads: NDArray[np.float32]
    has_pixels: NDArray[np.bool_]


def to_ycc(image: ByteImage) -> NDArray[np.float32]:
    """Convert to Y, Cr − 128, Cb − 128 as float32."""
    ycc = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    # By rows: numpy loops over the last axis, and three numbers are short for a loop.
    rows, neutral = ycc.reshape(len(ycc), -1), np.tile(_NEUTRAL, ycc.shape[1])
    return np.subtract(rows, neutral, dtype=np.float32).reshape(ycc.shape)


@lru_cache(maxsize=4)
def strip_index(plane: GroundPlane) -> NDArray[np.int32]:
    """Return the strip of each pixel, (height, width); −1 outside of them and above ground."""
    ahead = plane.row_x_m[:, None]
    inside = (np.abs(plane.lateral_m) < HALF_WIDTH_M) & (ahead < FARTHEST_M)
    lateral = np.where(inside, plane.lateral_m, 0.0)
    index = np.floor((lateral + HALF_WIDTH_M) / STRIP_M).astype(np.int32)
    return np.asarray(np.where(inside, index, -1))


@lru_cache(maxsize=4)
def _near_ground(plane: GroundPlane) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pixels that a surface is learned from, flat and strip by strip, and their bounds.

    The bounds have one number more than there are strips: the first pixel of each, and the end.
    """
    index = strip_index(plane)
    # Only as far as needed to see a strip at all: farther away, something stands on it.
    reach_m = _LEARN_TO_M + _LEARN_PER_ASIDE * np.abs(np.nan_to_num(plane.lateral_m))
    near = (index >= 0) & (plane.row_x_m[:, None] < reach_m)
    # Every third pixel of every third row is plenty; counted from both sides, so that a mirrored
    # picture is learned from the mirrored pixels.
    columns = np.arange(plane.width_px)
    thin = np.zeros_like(near)
    thin[::3] = np.minimum(columns, columns[::-1]) % 3 == 0
    places = np.flatnonzero(near & thin)
    strips = index.ravel()[places]
    order = np.argsort(strips, kind="stable")
    return places[order], np.searchsorted(strips[order], np.arange(_STRIPS + 1))


def learn_surface(frames: Sequence[NDArray[np.float32]], plane: GroundPlane) -> Surface:
    """Take medians over the near ground of all frames."""
    places, bounds = _near_ground(plane)
    pixels = np.stack([np.take(frame.reshape(-1, 3), places, axis=0) for frame in frames])
    colours = np.zeros((_STRIPS, 3), np.float32)
    spreads = np.zeros(_STRIPS, np.float32)
    has_pixels = np.diff(bounds) >= _MIN_PIXELS
    for strip in np.flatnonzero(has_pixels):
        # A row for each channel: what a median sorts lies together.
        inside = pixels[:, bounds[strip] : bounds[strip + 1]].reshape(-1, 3).T.copy()
        colours[strip] = _medians(inside)
        distances = np.abs(inside[1:] - colours[strip, 1:, None]).sum(axis=0)
        spreads[strip] = _medians(distances[None])[0]
    return Surface(_filled(colours, has_pixels), _filled(spreads, has_pixels), has_pixels)


def _medians(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median of each row, as np.median does, which takes three times as long."""
    count = rows.shape[1]
    middle = np.partition(rows, ((count - 1) // 2, count // 2), axis=1)
    return (middle[:, (count - 1) // 2] + middle[:, count // 2]) / np.float32(2.0)


def _filled(values: NDArray[np.float32], is_known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill strips that the near ground doesn't show from the nearest one that it does."""
    if not is_known.any():
        return values
    places = np.flatnonzero(is_known)
    nearest = places[np.abs(np.arange(len(is_known))[:, None] - places[None, :]).argmin(axis=1)]
    return np.asarray(values[nearest])


def foreign_pixels(
    frames: Sequence[NDArray[np.float32]], surface: Surface, index: NDArray[np.int32]
) -> list[Mask]:
    """Mark per frame with 1 the pixels of strips that look like none of the strips around."""
    last = len(surface.colours) - 1
    places = np.flatnonzero(index >= 0)
    strips = index.ravel()[places]
    own = _reference(surface, strips)
    masks = []
    for frame in frames:
        pixels = np.take(frame.reshape(-1, 3), places, axis=0)
        # Most pixels match their own strip, so the others are few.
        left = np.flatnonzero(_differs(pixels, own))
        for shift in _NEIGHBOUR_STRIPS:
            neighbours = _reference(surface, np.clip(strips[left] + shift, 0, last))
            left = left[_differs(pixels[left], neighbours)]
        mask = np.zeros(index.size, np.uint8)
        mask[places[left]] = 1
        masks.append(mask.reshape(index.shape))
    return masks


@dataclass(frozen=True)
class _Reference:
    """The expected appearance of the ground at some pixels."""

    inverse_luma: NDArray[np.float32]
    cr: NDArray[np.float32]
    cb: NDArray[np.float32]
    limit: NDArray[np.float32]


def _reference(surface: Surface, strips: NDArray[np.int32]) -> _Reference:
    luma, cr, cb = np.ascontiguousarray(surface.colours.T)
    limits = (_CHROMA_LEVELS + _CHROMA_SPREADS * surface.spreads).astype(np.float32)
    inverse = (1.0 / np.maximum(luma, 1.0)).astype(np.float32)
    return _Reference(inverse[strips], cr[strips], cb[strips], limits[strips])


def _differs(pixels: NDArray[np.float32], expected: _Reference) -> NDArray[np.bool_]:
    ratio = pixels[:, 0] * expected.inverse_luma
    weight = np.clip(ratio, 0.3, 1.3)
    chroma = np.abs(pixels[:, 1] - weight * expected.cr)
    chroma += np.abs(pixels[:, 2] - weight * expected.cb)
    # The light's own tint shows more on bright paint.
    return np.asarray((ratio <= _DARK_RATIO) | (chroma >= expected.limit * np.maximum(1.0, ratio)))
