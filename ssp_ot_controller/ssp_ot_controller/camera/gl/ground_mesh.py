"""The ground as triangles that follow the reference line, with arc length and offset at corners."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ssp_core.run_spec import Road
from ssp_ot_controller.camera import ground
from ssp_ot_controller.camera.bend import block_line
from ssp_ot_controller.camera.jit import Array

NUMBERS = 6  # of a corner: place, arc length and offset, face of a kerb
_BEFORE_M, _BEYOND_M = 300.0, 900.0
_STEP_M = 1.0  # on bends: the chord is 6 mm from an arc of 20 m
_MOST_TURNED = 0.9  # of the way to the centre of a bend
_FACE_DEPTH_M = 1e-3  # so that both corners of a kerb's face have offsets of their own


def _stations(road: Road) -> Array:
    line = block_line(road)
    inside = (
        np.array([0.0, line.length_m])
        if line.is_straight
        else np.linspace(0.0, line.length_m, math.ceil(line.length_m / _STEP_M) + 1)
    )
    return np.concatenate(
        [np.linspace(-_BEFORE_M, 0.0, 8)[:-1], inside,
         np.linspace(line.length_m, line.length_m + _BEYOND_M, 16)[1:]]
    )  # fmt: skip


def _strips(road: Road) -> list[tuple[float, float, float, float, float]]:
    """Offsets and heights of strips along the road: right l, left l, right z, left z, face."""
    left, right, far = road.left_edge_m, road.right_edge_m, ground.HALF_WIDTH_M
    high = ground.KERB_HEIGHT_M
    on_left = high if road.sidewalk_left_m > 0.0 else 0.0
    on_right = high if road.sidewalk_right_m > 0.0 else 0.0
    strips: list[tuple[float, float, float, float, float]] = []
    for a, b in ((right - 20.0, right), (right - 50.0, right - 20.0), (-far, right - 50.0)):
        strips.append((a, b, on_right, on_right, 0.0))
    middle = np.linspace(right, left, max(2, round((left - right) / 2.0)) + 1)
    strips += [(float(a), float(b), 0.0, 0.0, 0.0) for a, b in pairwise(middle)]
    for a, b in ((left, left + 20.0), (left + 20.0, left + 50.0), (left + 50.0, far)):
        strips.append((a, b, on_left, on_left, 0.0))
    if on_left > 0.0:
        strips.append((left, left + _FACE_DEPTH_M, 0.0, high, 1.0))
    if on_right > 0.0:
        strips.append((right - _FACE_DEPTH_M, right, high, 0.0, 1.0))
    return strips


def ground_mesh(road: Road) -> Array:
    """Corners of the ground's triangles, shape (n, NUMBERS), float32, block frame."""
    line = block_line(road)
    stations = _stations(road)
    frames = []
    for s in stations:
        pose = line.pose(float(s))
        inside = 0.0 <= s <= line.length_m
        frames.append(
            (pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad),
             line.curvature_1pm(float(s)) if inside else 0.0)
        )  # fmt: skip
    x, y, c, s, k = np.array(frames).T

    def column(offset_m: float, z_m: float, face: float) -> Array:
        # Beyond the centre of a bend the map along the line would run backwards.
        limit = np.where(k * offset_m > _MOST_TURNED, _MOST_TURNED / np.where(k == 0.0, 1.0, k), 0)
        offset = np.where(k * offset_m > _MOST_TURNED, limit, offset_m)
        return np.stack(
            [x - s * offset, y + c * offset, np.full_like(x, z_m), stations, offset,
             np.full_like(x, face)], axis=1,
        )  # fmt: skip

    parts = []
    for low, high, low_z, high_z, face in _strips(road):
        if high <= low:
            continue
        a, b = column(low, low_z, face), column(high, high_z, face)
        parts.append(
            np.stack([a[:-1], a[1:], b[1:], a[:-1], b[1:], b[:-1]], axis=1).reshape(-1, NUMBERS)
        )
    return np.concatenate(parts).astype(np.float32)
