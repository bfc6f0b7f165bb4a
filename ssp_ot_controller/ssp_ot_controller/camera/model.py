"""Geometry of the forward camera: intrinsics, mounting, and projection of map points.

Pinhole without distortion. Pixel (0, 0) is the centre of the upper left pixel, so the image spans
-0.5 to width - 0.5. The optical frame is x right, y down, z forward (REP-103).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssp_core.geometry import FloatArray, Pose2
from ssp_core.names import VUT_ID
from ssp_core.run_spec import Camera
from ssp_core.state import ObjectState

OPTICAL_FRAME = f"{VUT_ID}/front_camera_optical"
BASE_FRAME = f"{VUT_ID}/base_link"
NEAR_M = 0.1


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole numbers in px: u = fx x / z + cx, v = fy y / z + cy."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def k(self) -> list[float]:
        """The 3x3 camera matrix, row by row, as CameraInfo wants it."""
        return [self.fx_px, 0.0, self.cx_px, 0.0, self.fy_px, self.cy_px, 0.0, 0.0, 1.0]

    def p(self) -> list[float]:
        """The 3x4 projection matrix, row by row, as CameraInfo wants it."""
        return [
            self.fx_px,
            0.0,
            self.cx_px,
            0.0,
            0.0,
            self.fy_px,
            self.cy_px,
            0.0,
            0.0,
            0.0,
            1.0,
            0.0,
        ]


@dataclass(frozen=True, slots=True)
class Mount:
    """Transform from the VUT's base_link to the optical frame: position and orientation there."""

    translation_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True)
class View:
    """A camera in a parent frame (z up).

    Args:
        position_m: shape (3,), camera centre in the parent frame.
        rotation: shape (3, 3), rows are the optical x, y and z axes in the parent frame.
        intrinsics: pinhole numbers.
    """

    position_m: FloatArray
    rotation: FloatArray
    intrinsics: Intrinsics


@dataclass(frozen=True)
class Projection:
    """Image of points: px, px, m along the optical axis; ``in_front`` says which are valid."""

    u_px: FloatArray
    v_px: FloatArray
    depth_m: FloatArray
    in_front: NDArray[np.bool_]


def intrinsics(camera: Camera) -> Intrinsics:
    """The pinhole numbers of a camera with square pixels and a central principal point."""
    return Intrinsics(
        camera.width_px,
        camera.height_px,
        camera.focal_px,
        camera.focal_px,
        (camera.width_px - 1) / 2,
        (camera.height_px - 1) / 2,
    )


def optical_axes(pitch_down_rad: float) -> FloatArray:
    """Shape (3, 3): rows are the optical x, y, z axes in base_link; + pitches the view down."""
    c, s = math.cos(pitch_down_rad), math.sin(pitch_down_rad)
    return np.array([[0.0, -1.0, 0.0], [-s, 0.0, -c], [c, 0.0, -s]])


def mount(camera: Camera) -> Mount:
    """Where the camera sits on the VUT, as the mount topic states it.

    The rotation is the one that turns base_link's axes into the optical ones: first yaw by -90
    degrees and roll by -90 degrees (REP-103), then the pitch about the optical x axis.
    """
    half = camera.pitch_down_rad / 2
    # (x, y, z, w) = (-1/2, 1/2, -1/2, 1/2) turns x forward, z up into z forward, y down; the
    # pitch down multiplies from the right with (-sin(half), 0, 0, cos(half)).
    c, s = math.cos(half) / 2, math.sin(half) / 2
    return Mount((camera.forward_m, 0.0, camera.height_m), (-c - s, c + s, s - c, c - s))


def view_from(pose: Pose2, camera: Camera) -> View:
    """The camera of a VUT whose reference point has this pose, in the pose's parent frame."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    parent_from_base = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x, y = pose.to_parent(camera.forward_m, 0.0)
    rotation = optical_axes(camera.pitch_down_rad) @ parent_from_base.T
    return View(np.array([x, y, camera.height_m]), rotation, intrinsics(camera))


def project(view: View, points_m: ArrayLike) -> Projection:
    """Where points appear in the image.

    Args:
        view: camera in the points' frame.
        points_m: shape (n, 3).

    Returns:
        n pixel positions and depths; those nearer than 0.1 m or behind are not ``in_front``, and
        their pixel positions are NaN.
    """
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    optical = (points - view.position_m) @ view.rotation.T
    depth = optical[:, 2]
    in_front = depth > NEAR_M
    safe = np.where(in_front, depth, np.nan)
    lens = view.intrinsics
    u = lens.fx_px * optical[:, 0] / safe + lens.cx_px
    v = lens.fy_px * optical[:, 1] / safe + lens.cy_px
    return Projection(u, v, depth, in_front)


def object_corners(state: ObjectState) -> FloatArray:
    """Corners of an object's bounding box in map, shape (8, 3), the four on the ground first."""
    ground = state.box.corners()
    return np.array(
        [[x, y, 0.0] for x, y in ground] + [[x, y, state.size.height_m] for x, y in ground]
    )


def image_box(view: View, state: ObjectState) -> tuple[float, float, float, float] | None:
    """Rectangle (left, top, right, bottom) in px around an object's bounding box, unclipped.

    None when a corner is not in front of the camera.
    """
    seen = project(view, object_corners(state))
    if not seen.in_front.all():
        return None
    return (
        float(seen.u_px.min()),
        float(seen.v_px.min()),
        float(seen.u_px.max()),
        float(seen.v_px.max()),
    )
