"""The forward camera's geometry: intrinsics, where it looks from, and where points appear.

Pinhole without distortion. Pixel (0, 0) is the centre of the upper left pixel, so the image spans
-0.5 to width - 0.5. The optical frame is x right, y down, z forward (REP-103).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera

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
        """Return the 3x3 camera matrix, row by row, as CameraInfo wants it."""
        return [self.fx_px, 0.0, self.cx_px, 0.0, self.fy_px, self.cy_px, 0.0, 0.0, 1.0]

    def p(self) -> list[float]:
        """Return the 3x4 projection matrix, row by row, as CameraInfo wants it."""
        k = self.k()
        return [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]


@dataclass(frozen=True, slots=True)
class Mounting:
    """The place of a camera on a vehicle, and its orientation there.

    Args:
        forward_m: ahead of the vehicle's reference point.
        height_m: above the ground.
        pitch_down_rad: + looks down.
        left_m: to the left of the vehicle's middle.
        yaw_left_rad: + looks to the left.
        roll_right_rad: about the direction of view; + leans to the right, so that the picture's
            content turns to the left.
    """

    forward_m: float
    height_m: float
    pitch_down_rad: float
    left_m: float = 0.0
    yaw_left_rad: float = 0.0
    roll_right_rad: float = 0.0

    @classmethod
    def of_transform(
        cls,
        translation_m: tuple[float, float, float],
        quaternion_xyzw: tuple[float, float, float, float],
    ) -> Mounting:
        """Return the mounting that a transform from base_link to the optical frame stands for.

        Args:
            translation_m: of the camera's centre in base_link.
            quaternion_xyzw: turns the optical axes into base_link.
        """
        x, y, z, w = quaternion_xyzw
        # Third column: the direction of view; third row: how the optical axes rise.
        ahead, left = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
        right_up, down_up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
        up = 1.0 - 2.0 * (x * x + y * y)
        return cls(
            forward_m=translation_m[0],
            height_m=translation_m[2],
            pitch_down_rad=-math.atan2(up, math.hypot(ahead, left)),
            left_m=translation_m[1],
            yaw_left_rad=math.atan2(left, ahead),
            roll_right_rad=math.atan2(-right_up, -down_up),
        )


@dataclass(frozen=True)
class View:
    """A camera in a parent frame (z up).

    Args:
        position_m: shape (3,), camera centre in the parent frame.
        rotation: shape (3, 3), rows are the optical x, y and z axes in the parent frame.
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
    """Return the pinhole numbers of a camera with square pixels and a central principal point."""
    return Intrinsics(
        camera.width_px,
        camera.height_px,
        camera.focal_px,
        camera.focal_px,
        (camera.width_px - 1) / 2,
        (camera.height_px - 1) / 2,
    )


def optical_axes(
    pitch_down_rad: float, yaw_left_rad: float = 0.0, roll_right_rad: float = 0.0
) -> FloatArray:
    """Return the optical axes, shape (3, 3): rows are optical x, y, z in base_link.

    The camera is turned about the upright axis first, then down, then about its direction of view;
    signs as in ``Mounting``.
    """
    c, s = math.cos(pitch_down_rad), math.sin(pitch_down_rad)
    level = np.array([[0.0, -1.0, 0.0], [-s, 0.0, -c], [c, 0.0, -s]])
    c, s = math.cos(yaw_left_rad), math.sin(yaw_left_rad)
    turned = level @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = math.cos(roll_right_rad), math.sin(roll_right_rad)
    leaning: FloatArray = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turned
    return leaning


def view_from(pose: Pose2, camera: Camera) -> View:
    """Return the camera of a VUT whose reference point has this pose.

    It is in the pose's parent frame.
    """
    return mounted_view(pose, intrinsics(camera), camera)


def mounted_view(pose: Pose2, lens: Intrinsics, mounting: Mounting | Camera) -> View:
    """Make the view of ``view_from`` from the numbers that a recording holds.

    Args:
        pose: of the VUT's reference point.
        lens: of the recorded camera.
        mounting: of the camera on the VUT.
    """
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    parent_from_base = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x, y = pose.to_parent(mounting.forward_m, mounting.left_m)
    axes = optical_axes(mounting.pitch_down_rad, mounting.yaw_left_rad, mounting.roll_right_rad)
    return View(np.array([x, y, mounting.height_m]), axes @ parent_from_base.T, lens)


def project(view: View, points_m: ArrayLike) -> Projection:
    """Compute where points appear in the image.

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
    """Return the corners of an object's box in map, shape (8, 3), the four on the ground first."""
    ground = state.box.corners()
    return np.array(
        [[x, y, 0.0] for x, y in ground] + [[x, y, state.size.height_m] for x, y in ground]
    )


# Edges of object_corners: around the ground, around the top, upright.
_EDGES = tuple(
    pair for i in range(4) for pair in ((i, (i + 1) % 4), (4 + i, 4 + (i + 1) % 4), (i, 4 + i))
)


def shown_box(view: View, state: ObjectState) -> tuple[float, float, float, float] | None:
    """Return the rectangle (left, top, right, bottom) in px around what the image shows of a box.

    The bounding box is cut off 0.1 m before the camera and at the image's borders, so that an
    object beside the camera has one too.

    Returns:
        None where nothing of it lies in the image.
    """
    optical = (object_corners(state) - view.position_m) @ view.rotation.T
    corners = [corner for corner in optical if corner[2] > NEAR_M]
    for a, b in _EDGES:
        p, q = optical[a], optical[b]
        if (p[2] > NEAR_M) != (q[2] > NEAR_M):
            corners.append(p + (q - p) * (NEAR_M - p[2]) / (q[2] - p[2]))
    if not corners:
        return None
    lens, places = view.intrinsics, np.array(corners)
    u = lens.fx_px * places[:, 0] / places[:, 2] + lens.cx_px
    v = lens.fy_px * places[:, 1] / places[:, 2] + lens.cy_px
    left, right = max(float(u.min()), -0.5), min(float(u.max()), lens.width_px - 0.5)
    top, bottom = max(float(v.min()), -0.5), min(float(v.max()), lens.height_px - 0.5)
    return (left, top, right, bottom) if left < right and top < bottom else None
