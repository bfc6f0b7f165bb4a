"""Turning of the pictures, against the recorded yaw rate.

Points that are tracked from frame to frame move away from the point that the VUT drives towards,
whatever their distance. What is left across that direction comes from rotation alone, so that the
yaw rate follows without knowing how far anything is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray
from ssp_core.world.camera import Intrinsics, Mounting, optical_axes, shown_box
from ssp_eval.pictures.footage import Footage, Grey, Mask

Points = NDArray[np.float32]

_MOST_POINTS = 250
_LEAST_POINTS = 25
_BACK_PX = 1.0
_ITERATIONS = 8
# Before and after.
_SMOOTHED_S = 0.5
# A point nearer to the direction of travel says little about rotation.
_CENTRE = 0.05


@dataclass(frozen=True)
class Turn:
    """Yaw rate at a pair of frames, + to the left.

    Args:
        t_s: clip time of the earlier one.
        recorded_radps: by the states.
        picture_radps: by the pictures.
    """

    t_s: float
    recorded_radps: float
    picture_radps: float


def compare_turning(footage: Footage, pairs: Sequence[tuple[int, int]]) -> list[Turn]:
    """Measure rotation in pairs of frames; a pair with too few points gives nothing.

    Args:
        footage: pictures and states of the recording.
        pairs: indices of frames with a picture and a state of the VUT, the earlier one first.
    """
    turns = []
    for first, second in pairs:
        before, after = footage.moments[first], footage.moments[second]
        at, to = before.states[footage.vut_id], after.states[footage.vut_id]
        tracked = _tracked(footage, first, second)
        if tracked is None:
            continue
        way_m, _ = at.pose.to_local(to.x_m, to.y_m)
        ahead_m = footage.optics.mounting.forward_m
        seen_rad = _rotation(*tracked, way_m, ahead_m)
        recorded_radps = _recorded(footage, (before.t_s + after.t_s) / 2.0)
        turns.append(Turn(before.t_s, recorded_radps, seen_rad / (after.t_s - before.t_s)))
    return turns


def _recorded(footage: Footage, t_s: float) -> float:
    """Return the recorded yaw rate, by a line through the yaws of a second.

    Two yaws alone carry the noise of a positioning system, divided by a tenth of a second.
    """
    near = [
        (moment.t_s - t_s, moment.states[footage.vut_id].yaw_rad)
        for moment in footage.moments
        if abs(moment.t_s - t_s) <= _SMOOTHED_S and footage.vut_id in moment.states
    ]
    times, yaws = np.array([t for t, _ in near]), np.unwrap([yaw for _, yaw in near])
    times = times - times.mean()
    return float(times @ (yaws - yaws.mean()) / (times @ times))


def _tracked(footage: Footage, first: int, second: int) -> tuple[FloatArray, FloatArray] | None:
    """Return points of both frames as slopes of a level camera that looks ahead.

    Slopes are to the right and down, each of shape (n, 2); None: too few were found again.
    """
    old, new = footage.grey[first], footage.grey[second]
    mask = np.full(old.shape, 255, np.uint8)
    view = footage.view(first)
    for name, state in footage.moments[first].states.items():
        box = None if name == footage.vut_id else shown_box(view, state)
        if box is not None:
            left, top, right, bottom = (round(edge) for edge in box)
            mask[max(0, top - 2) : bottom + 3, max(0, left - 2) : right + 3] = 0
    corners: Any = cv2.goodFeaturesToTrack(old, _MOST_POINTS, 0.02, 7.0, mask=mask, blockSize=5)
    if corners is None:
        return None
    points = np.asarray(corners, np.float32).reshape(-1, 2)
    there, ahead = _follow(old, new, points)
    again, back = _follow(new, old, there)
    inliers = ahead & back & (np.linalg.norm(again - points, axis=1) < _BACK_PX)
    if inliers.sum() < _LEAST_POINTS:
        return None
    lens, mounting = footage.lens, footage.optics.mounting
    return _slopes(points[inliers], lens, mounting), _slopes(there[inliers], lens, mounting)


def _follow(old: Grey, new: Grey, points: Points) -> tuple[Points, Mask]:
    """Return where points of one picture lie in another one, and which were found."""
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.03)
    follow: Any = cv2.calcOpticalFlowPyrLK
    there, status, _ = follow(
        old, new, points[:, None], None, winSize=(15, 15), maxLevel=4, criteria=criteria
    )
    return np.asarray(there, np.float32).reshape(-1, 2), np.asarray(status.ravel() > 0, np.bool_)


def _slopes(pixels: Points, lens: Intrinsics, mounting: Mounting) -> FloatArray:
    optical = np.column_stack(
        [
            (pixels[:, 0] - lens.cx_px) / lens.fx_px,
            (pixels[:, 1] - lens.cy_px) / lens.fy_px,
            np.ones(len(pixels)),
        ]
    )
    axes = optical_axes(mounting.pitch_down_rad, mounting.yaw_left_rad, mounting.roll_right_rad)
    base = optical @ axes
    return np.column_stack([-base[:, 1] / base[:, 0], -base[:, 2] / base[:, 0]])


def _rotation(old: FloatArray, new: FloatArray, way_m: float, ahead_m: float) -> float:
    """Return the rotation to the left between two sets of points, by reweighted least squares.

    Pitch is fitted with it. A camera ahead of the axle that turns moves sideways too, which shifts
    the point that everything moves away from; one repetition takes that in.
    """
    yaw_rad = 0.0
    for _ in range(2):
        sideways = 0.0
        if abs(way_m) > 0.2:
            sideways = -yaw_rad * ahead_m / way_m
        middle = (old + new) / 2.0
        x, y = middle[:, 0] - sideways, middle[:, 1]
        right, down = (new - old).T
        radius = np.hypot(x, y) + _CENTRE
        across = (y * right - x * down) / radius
        parts = np.column_stack([y / radius, x / radius])
        weight = np.ones(len(across))
        fitted = np.zeros(2)
        for _ in range(_ITERATIONS):
            root = np.sqrt(weight)
            fitted = np.linalg.lstsq(parts * root[:, None], across * root, rcond=None)[0]
            left_over = across - parts @ fitted
            scale = max(1.48 * float(np.median(np.abs(left_over))), 2e-4)
            weight = 1.0 / (1.0 + (left_over / (2.0 * scale)) ** 2)
        yaw_rad = float(fitted[0])
    return yaw_rad if math.isfinite(yaw_rad) else 0.0
