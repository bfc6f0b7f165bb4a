"""Left and right of the pictures, against the lane borders of the road.

Nothing turns on a straight road, and an object dead ahead is where its mirror image is. What a
mirrored picture shows elsewhere is the road: the VUT drives in one lane, not in the middle of all.
The road ahead is resampled to a view from above. Edges along it that one side has and the other
lacks are correlated with the lane borders that one side has and the other lacks. In a mirrored
picture that correlation changes its sign.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Road
from ssp_core.world.camera import project
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_eval.pictures.footage import Float32, Footage, spread
from ssp_eval.pictures.ground import free_road
from ssp_eval.recordings.sight import Moment

_STEP_M = 0.1
# Beside the VUT, and ahead of its point of reference.
_NEAREST_M, _REACH_M = 0.5, 13.0
_AHEAD_M = tuple(8.0 + 0.5 * k for k in range(34))
# An offset needs so many places ahead in a frame, and so many of the frames.
_LEAST_PLACES, _LEAST_SHARE = 6, 0.5
_LEAST_FRAMES, _MOST_FRAMES, _LEAST_OFFSETS = 5, 32, 40
# Between two frames, so that what lies across the road, such as a zebra, is in few of them.
_APART_M = 0.5
# A border is drawn with a line, and a line has two edges.
_BLUR_M = 0.2
# An edge of so many times the usual strength counts half as much as the strongest one.
_STRONG = 3.0
# Both are fitted, since places and calibration are off by as much.
_SHIFTS_M = tuple(0.1 * k for k in range(-5, 6))
_PITCHES_RAD = tuple(0.004 * k for k in range(-3, 4))
# What differs between the sides counts twice as much as what they have in common.
_WEIGHT = 2.0


@dataclass(frozen=True)
class Sides:
    """Correlation of edges along the road with the borders of its lanes.

    Args:
        fit: in the pictures as they are, at the place and pitch at which it is largest.
        mirrored: the same in their mirror images.
        differing: share of the borders' pattern in which the two sides differ, 0 to 1.
        frame_count: frames that it comes from.
    """

    fit: float
    mirrored: float
    differing: float
    frame_count: int


def frames_apart(moments: Sequence[Moment], vut_id: str, usable: Sequence[int]) -> list[int]:
    """Choose frames between which the VUT goes some way, spread over all of its way.

    Args:
        moments: all frames.
        vut_id: id of the VUT.
        usable: indices to choose from, rising.
    """
    frames: list[int] = []
    last: ObjectState | None = None
    for index in usable:
        state = moments[index].states[vut_id]
        if last is None or math.hypot(state.x_m - last.x_m, state.y_m - last.y_m) >= _APART_M:
            frames.append(index)
            last = state
    return spread(frames, _MOST_FRAMES)


def compare_sides(footage: Footage, indices: Sequence[int], road: Road) -> Sides | None:
    """Compare both sides of the road; None: the VUT isn't on it, or too little of it is seen.

    Args:
        footage: pictures and states of the recording.
        indices: of frames with a picture and a state of the VUT.
        road: that the VUT drives on.
    """
    line, borders_m = ReferenceLine.of_road(road), _borders_m(road)
    mounting = footage.optics.mounting
    fits: list[_Fit] = []
    frame_count = 0
    for pitch_rad in _PITCHES_RAD:
        lower = replace(mounting, pitch_down_rad=mounting.pitch_down_rad + pitch_rad)
        turned = replace(footage, optics=replace(footage.optics, mounting=lower))
        strips = [strip for k in indices if (strip := _Strip.of(turned, k, line)) is not None]
        if len(strips) >= _LEAST_FRAMES:
            frame_count = len(strips)
            fits += _fits(_Edges.of(strips), borders_m)
    if not fits:
        return None
    return Sides(
        max(one.common + _WEIGHT * one.opposed for one in fits) / (1.0 + _WEIGHT),
        max(one.common - _WEIGHT * one.opposed for one in fits) / (1.0 + _WEIGHT),
        float(np.median([one.differing for one in fits])),
        frame_count,
    )


def _borders_m(road: Road) -> list[float]:
    """Return the offsets of lane borders and of the outer edges of sidewalks."""
    offsets_m = {
        round(lane.y_m + half * lane.width_m, 2) for lane in road.lanes for half in (-0.5, 0.5)
    }
    if road.sidewalk_left_m > 0.0:
        offsets_m.add(road.left_edge_m + road.sidewalk_left_m)
    if road.sidewalk_right_m > 0.0:
        offsets_m.add(road.right_edge_m - road.sidewalk_right_m)
    return sorted(offsets_m)


@dataclass(frozen=True)
class _Strip:
    """Edges along the road ahead, in one frame.

    Args:
        first: number of the first offset, in steps to the left of the road's line.
        place_m: of the VUT, to the left of the line.
        edges: how grey changes across the road, per offset, + brighter to the left; NaN where too
            little is seen.
    """

    first: int
    place_m: float
    edges: FloatArray

    @classmethod
    def of(cls, footage: Footage, index: int, line: ReferenceLine) -> _Strip | None:
        pose = footage.moments[index].states[footage.vut_id].pose
        try:
            s_m, place_m = line.to_local(pose.x_m, pose.y_m)
        except NotOneToOne:
            return None
        along = math.copysign(1.0, math.cos(pose.yaw_rad - line.pose(s_m).yaw_rad))
        ahead = line.poses([s_m + along * one for one in _AHEAD_M])
        first = round((place_m - _REACH_M) / _STEP_M)
        left_m = (first + np.arange(round(2.0 * _REACH_M / _STEP_M) + 1)) * _STEP_M
        x_m, y_m, yaw_rad = np.array([(at.x_m, at.y_m, at.yaw_rad) for at in ahead]).T[:, :, None]
        ground_m = np.zeros((len(ahead), len(left_m)))
        places = [x_m - left_m * np.sin(yaw_rad), y_m + left_m * np.cos(yaw_rad), ground_m]
        pixels = project(footage.view(index), np.stack(places, axis=-1))
        u_px, v_px = (
            np.nan_to_num(px, nan=-1.0).astype(np.float32).reshape(ground_m.shape)
            for px in (pixels.u_px, pixels.v_px)
        )
        return cls(first, place_m, _edges(footage, index, u_px, v_px))


def _edges(footage: Footage, index: int, u_px: Float32, v_px: Float32) -> FloatArray:
    picture, free = footage.grey[index], free_road(footage, index)
    # An object of a mirrored picture is on the other side.
    free = np.minimum(free, free[:, ::-1])
    height, width = picture.shape
    clear = cv2.remap(free, u_px, v_px, cv2.INTER_NEAREST) > 0
    clear &= (u_px >= 0.0) & (u_px < width - 1.0) & (v_px >= 0.0) & (v_px < height - 1.0)
    grey = cv2.remap(picture, u_px, v_px, cv2.INTER_LINEAR).astype(np.float64)
    across, mask = np.zeros_like(grey), np.zeros_like(clear)
    across[:, 1:-1] = grey[:, 2:] - grey[:, :-2]
    mask[:, 1:-1] = clear[:, 2:] & clear[:, :-2]
    count = mask.sum(axis=0)
    mean = (across * mask).sum(axis=0) / np.maximum(count, 1)
    return np.where(count >= _LEAST_PLACES, mean, np.nan)


@dataclass(frozen=True)
class _Edges:
    """Usual edges along the road over some frames.

    Args:
        offsets_m: to the left of the road's line, rising.
        strength: 0 to 1, of the same shape; NaN where too little is seen.
        place_m: of the VUT, on average.
    """

    offsets_m: FloatArray
    strength: FloatArray
    place_m: float

    @classmethod
    def of(cls, strips: Sequence[_Strip]) -> _Edges:
        start = min(strip.first for strip in strips)
        end = max(strip.first + len(strip.edges) for strip in strips)
        rows = np.full((len(strips), end - start), np.nan)
        for row, strip in zip(rows, strips, strict=True):
            at = strip.first - start
            row[at : at + len(strip.edges)] = strip.edges
        enough = np.isfinite(rows).sum(axis=0) >= _LEAST_SHARE * len(rows)
        usual = np.full(end - start, np.nan)
        if enough.any():
            usual[enough] = np.sqrt(np.abs(np.nanmedian(rows[:, enough], axis=0)))
            usual /= usual + _STRONG * np.nanmedian(usual) + 1e-9
        place_m = float(np.mean([strip.place_m for strip in strips]))
        offsets_m = np.asarray(np.arange(start, end) * _STEP_M, np.float64)
        return cls(offsets_m, np.asarray(usual, np.float64), place_m)

    def at(self, offsets_m: FloatArray) -> FloatArray:
        mask = np.isfinite(self.strength)
        if not mask.any():
            return np.full(len(offsets_m), np.nan)
        strengths = np.interp(
            offsets_m, self.offsets_m[mask], self.strength[mask], left=np.nan, right=np.nan
        )
        return np.asarray(strengths, np.float64)


@dataclass(frozen=True)
class _Fit:
    """Correlations of edges and borders at one place and pitch.

    Args:
        common: of the sum of both sides, which a mirrored picture leaves as it is.
        opposed: of their difference, which a mirrored picture turns round.
        differing: as in Sides.
    """

    common: float
    opposed: float
    differing: float


def _fits(edges: _Edges, borders_m: Sequence[float]) -> list[_Fit]:
    """Correlate edges with borders at each shift of the VUT's place."""
    beside_m = np.arange(_NEAREST_M, _REACH_M, _STEP_M)
    left, right = (_bumps(edges.place_m + side * beside_m, borders_m) for side in (1.0, -1.0))
    fits = []
    for shift_m in _SHIFTS_M:
        middle_m = edges.place_m + shift_m
        seen_left, seen_right = edges.at(middle_m + beside_m), edges.at(middle_m - beside_m)
        mask = np.isfinite(seen_left) & np.isfinite(seen_right)
        if mask.sum() < _LEAST_OFFSETS:
            continue
        both, seen_both = ((a + b)[mask] for a, b in ((left, right), (seen_left, seen_right)))
        apart, seen_apart = ((a - b)[mask] for a, b in ((left, right), (seen_left, seen_right)))
        total = float((left**2 + right**2)[mask].sum())
        fits.append(
            _Fit(
                _correlation(both - both.mean(), seen_both - seen_both.mean()),
                _correlation(apart, seen_apart),
                float(apart @ apart) / max(total, 1e-9),
            )
        )
    return fits


def _correlation(one: FloatArray, other: FloatArray) -> float:
    return float(one @ other) / math.sqrt(max(float(one @ one) * float(other @ other), 1e-12))


def _bumps(offsets_m: FloatArray, borders_m: Sequence[float]) -> FloatArray:
    away = (offsets_m[:, None] - np.array(borders_m)) / _BLUR_M
    return np.asarray(np.exp(-0.5 * away**2).sum(axis=1), np.float64)
