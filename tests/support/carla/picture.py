"""Pictures of the CARLA counterpart: flat boxes, with the frame number and all poses written in.

Nothing here is SSP's: the geometry is CARLA's own (left-handed, z up, degrees), so that a mistake
on our side shows. Poses stand in blocks of 4 px, black or white, along the picture's upper edge:
the first row holds the frame, each further row an actor's id, x, y, yaw.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

BLOCK_PX = 4
_ID_BITS, _PLACE_BITS, _YAW_BITS = 12, 26, 16
_FRAME_BITS = 40
_PLACE_MM, _YAW_DEG = 1e-3, 0.01
_GROUND_BGR, _SKY_BGR = (96, 100, 98), (215, 200, 180)
_BAND_BGR = (240, 240, 240)
_BANDS = ((0.3, 0.4), (0.5, 0.6), (0.7, 0.8), (0.86, 0.93))
_NEAR_M = 0.1
# One colour for each kind of body, in blue, green, red.
COLOURS = {
    "car": (30, 30, 200),
    "truck": (200, 60, 30),
    "bus": (30, 190, 200),
    "motorcycle": (190, 30, 190),
    "bicycle": (40, 180, 40),
    "pedestrian": (10, 120, 250),
}


@dataclass(frozen=True)
class Pose:
    """Location in m and rotation in degrees, as CARLA has them."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0

    @property
    def rotation(self) -> Any:
        """Shape (3, 3): columns are the axes forward, right and up in the world."""
        cp, sp = math.cos(math.radians(self.pitch)), math.sin(math.radians(self.pitch))
        cy, sy = math.cos(math.radians(self.yaw)), math.sin(math.radians(self.yaw))
        cr, sr = math.cos(math.radians(self.roll)), math.sin(math.radians(self.roll))
        return np.array(
            [
                [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
                [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
                [sp, -cp * sr, cp * cr],
            ]
        )

    def to_world(self, points: Any) -> Any:
        """Points of this frame, shape (n, 3), in the world."""
        return np.asarray(points, np.float64) @ self.rotation.T + (self.x, self.y, self.z)

    def to_local(self, points: Any) -> Any:
        """Points of the world, shape (n, 3), in this frame."""
        return (np.asarray(points, np.float64) - (self.x, self.y, self.z)) @ self.rotation


@dataclass(frozen=True)
class Solid:
    """A body in its place: its box as half sizes around an offset from the actor's origin."""

    actor_id: int
    kind: str
    pose: Pose
    offset: tuple[float, float, float]
    extent: tuple[float, float, float]

    @property
    def corners(self) -> Any:
        """Shape (8, 3), in the world."""
        signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        return self.pose.to_world(signs * self.extent + self.offset)


def project(camera: Pose, fov_deg: float, size_px: tuple[int, int], points: Any) -> Any:
    """Pixels of points of the world, shape (n, 3): u, v with a pixel's middle at whole numbers, and
    the depth.
    """
    width, height = size_px
    focal = width / 2.0 / math.tan(math.radians(fov_deg) / 2.0)
    ahead, right, up = camera.to_local(points).T
    safe = np.where(ahead > _NEAR_M, ahead, np.nan)
    u = width / 2.0 + focal * right / safe - 0.5
    v = height / 2.0 - focal * up / safe - 0.5
    return np.stack([u, v, ahead], axis=1)


def draw(
    camera: Pose,
    fov_deg: float,
    size_px: tuple[int, int],
    solids: Iterable[Solid],
    frame: int | None,
) -> Any:
    """A picture, shape (height, width, 4), blue, green, red, alpha.

    Args:
        frame: that is written in; None: nothing is, as in a picture of instances.
    """
    width, height = size_px
    picture = np.empty((height, width, 4), np.uint8)
    picture[:] = (*_SKY_BGR, 255)
    picture[height // 2 :] = (*_GROUND_BGR, 255)
    shown = list(solids)
    away = {
        s.actor_id: float(camera.to_local([(s.pose.x, s.pose.y, s.pose.z)])[0, 0]) for s in shown
    }
    for solid in sorted(shown, key=lambda one: -away[one.actor_id]):
        points = project(camera, fov_deg, size_px, solid.corners)
        if np.isnan(points).any():
            continue
        _fill(picture, points[:, :2], COLOURS[solid.kind])
    if frame is not None:
        _write_rows(picture, frame, shown)
    return picture


def _fill(picture: Any, points: Any, colour: tuple[int, int, int]) -> None:
    """Paint the pixels whose middle lies in the convex hull of points."""
    hull = cv2.convexHull(points.astype(np.float32), clockwise=False)[:, 0].astype(np.float64)
    height, width = picture.shape[:2]
    left, top = np.maximum(np.ceil(hull.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.floor(hull.max(axis=0)), (width - 1, height - 1)).astype(int)
    if left > right or top > bottom:
        return
    x, y = np.arange(left, right + 1)[None, :], np.arange(top, bottom + 1)[:, None]
    inside = np.ones((bottom + 1 - top, right + 1 - left), bool)
    for (ax, ay), (bx, by) in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0.0
    part = picture[top : bottom + 1, left : right + 1]
    part[inside] = (*colour, 255)
    # Bands across the body, by its own height in the picture, so that it moves as a whole.
    share = (y - hull[:, 1].min()) / max(float(np.ptp(hull[:, 1])), 1e-9)
    bands = np.zeros_like(share, bool)
    for low, high in _BANDS:
        bands |= (share >= low) & (share < high)
    part[inside & bands] = (*_BAND_BGR, 255)


def _bits(value: int, count: int) -> list[int]:
    return [value >> k & 1 for k in range(count - 1, -1, -1)]


def _number(bits: Sequence[int]) -> int:
    return int("".join(map(str, bits)), 2)


def _write_rows(picture: Any, frame: int, solids: Sequence[Solid]) -> None:
    rows = [_bits(frame, _FRAME_BITS) + _bits(len(solids), _ID_BITS)]
    half = 1 << _PLACE_BITS - 1
    for solid in solids:
        pose = solid.pose
        row = _bits(solid.actor_id, _ID_BITS)
        row += _bits(round(pose.x / _PLACE_MM) + half, _PLACE_BITS)
        row += _bits(round(pose.y / _PLACE_MM) + half, _PLACE_BITS)
        row += _bits(round(pose.yaw % 360.0 / _YAW_DEG) % 36000, _YAW_BITS)
        rows.append(row)
    for index, row in enumerate(rows):
        line = np.repeat(np.array(row, np.uint8) * 255, BLOCK_PX)
        top = index * BLOCK_PX
        picture[top : top + BLOCK_PX, : len(line), :3] = line[None, :, None]


@dataclass(frozen=True)
class Written:
    """Content of a picture: its frame, and x, y in m and yaw in degrees by actor."""

    frame: int
    poses: dict[int, tuple[float, float, float]]


def read_picture(picture: Any) -> Written:
    """Read the frame number and the poses that a picture, also one that was a JPEG, holds."""

    def row(index: int, count: int) -> list[int]:
        middle = index * BLOCK_PX + BLOCK_PX // 2
        places = np.arange(count) * BLOCK_PX + BLOCK_PX // 2
        return [int(v > 127) for v in picture[middle, places, 1]]

    first = row(0, _FRAME_BITS + _ID_BITS)
    poses = {}
    half = 1 << _PLACE_BITS - 1
    for index in range(_number(first[_FRAME_BITS:])):
        bits = row(1 + index, _ID_BITS + 2 * _PLACE_BITS + _YAW_BITS)
        at = _ID_BITS + _PLACE_BITS
        poses[_number(bits[:_ID_BITS])] = (
            (_number(bits[_ID_BITS:at]) - half) * _PLACE_MM,
            (_number(bits[at : at + _PLACE_BITS]) - half) * _PLACE_MM,
            _number(bits[at + _PLACE_BITS :]) * _YAW_DEG,
        )
    return Written(_number(first[:_FRAME_BITS]), poses)
