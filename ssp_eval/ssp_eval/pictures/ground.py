"""Motion of the road in the pictures, against the recorded speed.

The road from 5 to 20 m ahead is resampled to a view from above, along the arc that the VUT drives.
What doesn't change along the road, such as lane lines, is taken out, and the second picture is
correlated with the first one at each way that the VUT may have gone in between. Hence each pair of
frames gives a curve over speeds.
Hypotheses such as "half as fast" or "a second later" are compared by the mean of those curves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.world.camera import Intrinsics, Mounting, optical_axes, shown_box
from ssp_eval.pictures.footage import Float32, Footage, Grey, Mask, coarse

_STEP_M = 0.1
_NEAR_M, _FAR_M, _HALF_WIDTH_M = 5.0, 20.0, 5.0
# The strip goes on by so much at both ends; a way is no longer than that.
_MARGIN_M = 6.0
_SLOWEST_MPS, _FASTEST_MPS = -20.0, 50.0
_ALONG_M = 3.1
_LEAST_CELLS = 2000
# Of the correlation at the best speed; a pair below it shows nothing that could be followed.
FOLLOWED = 0.4
# At a shorter way the road stands still in the pictures.
_STILL_M = 0.15
# Beside an object, in its heights.
_SHADOW = 0.6
# A quarter of the speed, or 1 m/s.
_AGREE_SHARE, _AGREE_MPS = 0.25, 1.0
# Recorded turning below it leaves the arc straight: 20 m ahead it moves the road by half a cell.
_TURNING_RADPS = 0.03
# States so far beside a pair count for its arc, since the heading of a single one is noisy.
_BESIDE_S = 0.3
# A tighter arc is that of no vehicle.
_TIGHTEST_1PM = 0.125
# In grey levels; frames of a moving camera differ by 0.9 or more.
_REPEATED_DIFFERENCE = 0.05

# The road from above without what doesn't change along it, and where it is seen.
_Seen = tuple[Float32, Mask]


@dataclass(frozen=True)
class Pair:
    """Two frames in which the road was compared.

    Args:
        t_s: clip time, half-way between them.
        apart_s: time between them.
        way_m: that the VUT went in between by its states, + forward.
        ways_m: that were tried, rising.
        match: correlation of the road at each of them, NaN where it wasn't comparable.
        is_repeated: both frames are one picture.
    """

    t_s: float
    apart_s: float
    way_m: float
    ways_m: FloatArray
    match: FloatArray
    is_repeated: bool = False

    @property
    def speed_mps(self) -> float:
        """The recorded speed, from the way."""
        return self.way_m / self.apart_s

    @property
    def best(self) -> float:
        """The correlation at the way that fits best; NaN where none was comparable."""
        return float(np.nanmax(self.match)) if np.isfinite(self.match).any() else math.nan

    @property
    def is_followed(self) -> bool:
        """Tell whether the road shows detail that is found again."""
        return self.best >= FOLLOWED and not self.is_still

    @property
    def is_still(self) -> bool:
        """Tell whether different pictures of a moving VUT match best without any motion.

        Artefacts of compression and dirt on the lens do so, whatever the road does.
        """
        if self.is_repeated or abs(self.way_m) <= 2.0 * _STILL_M or not self.best > 0.0:
            return False
        return abs(self.picture_mps * self.apart_s) <= _STILL_M

    @property
    def picture_mps(self) -> float:
        """The speed at which the road fits best."""
        return float(self.ways_m[int(np.nanargmax(self.match))]) / self.apart_s

    @property
    def refined_mps(self) -> float:
        """The same, finer than the ways that were tried: the top of a parabola through the best."""
        k = int(np.nanargmax(self.match))
        way_m = float(self.ways_m[k])
        if 0 < k < len(self.match) - 1:
            low, best, high = (float(value) for value in self.match[k - 1 : k + 2])
            bend = low - 2.0 * best + high
            if bend < 0.0:  # not NaN
                way_m += 0.5 * (low - high) / bend * float(self.ways_m[k] - self.ways_m[k - 1])
        return way_m / self.apart_s

    def match_at(self, way_m: float) -> float:
        """Return the correlation at a displacement, NaN outside those that were tried."""
        if not self.ways_m[0] <= way_m <= self.ways_m[-1]:
            return math.nan
        return float(np.interp(way_m, self.ways_m, self.match))


def compare_ground(footage: Footage, pairs: Sequence[tuple[int, int]]) -> list[Pair]:
    """Correlate the road in pairs of frames.

    Args:
        footage: pictures and states of the recording.
        pairs: indices of frames with a picture and a state of the VUT, the earlier one first.
    """
    strips: dict[float, _Strip] = {}
    views_by_frame: dict[tuple[int, float], _Seen] = {}

    def view(index: int, bend_1pm: float) -> _Seen:
        if (index, bend_1pm) not in views_by_frame:
            if bend_1pm not in strips:
                strips[bend_1pm] = _Strip.of(footage.lens, footage.optics.mounting, bend_1pm)
            views_by_frame[index, bend_1pm] = strips[bend_1pm].resampled(
                footage.grey[index], free_road(footage, index)
            )
        return views_by_frame[index, bend_1pm]

    road_pairs = []
    for first, second in pairs:
        before, after = footage.moments[first], footage.moments[second]
        apart_s = after.t_s - before.t_s
        at, to = before.states[footage.vut_id], after.states[footage.vut_id]
        way_m = at.pose.to_local(to.x_m, to.y_m)[0]
        bend_1pm = _bend_1pm(footage, first, second)
        views = view(first, bend_1pm), view(second, bend_1pm)
        ways_m, match = _correlate(*views, apart_s)
        small = [coarse(footage.grey[index]) for index in (first, second)]
        is_repeated = float(cv2.absdiff(*small).mean()) < _REPEATED_DIFFERENCE
        middle_s = (before.t_s + after.t_s) / 2.0
        pair = Pair(middle_s, apart_s, way_m, ways_m, match, is_repeated)
        is_alone = all(len(moment.states) == 1 for moment in (before, after))
        if pair.is_followed and not is_alone and not agrees(pair.picture_mps, pair.speed_mps):
            # A low sun lays an object's shadow across one half of the road; it moves with it.
            halves = (replace(pair, match=_correlate(*half, apart_s)[1]) for half in _halves(views))
            agreeing = (
                half
                for half in halves
                if half.is_followed and agrees(half.picture_mps, half.speed_mps)
            )
            pair = next(agreeing, pair)
        road_pairs.append(pair)
    return road_pairs


def _halves(views: tuple[_Seen, _Seen]) -> Iterator[tuple[_Seen, _Seen]]:
    """Yield what two frames show of the right half of the road, then of the left one."""
    middle = views[0][0].shape[1] // 2
    for part in (slice(None, middle), slice(middle, None)):
        (old, old_mask), (new, new_mask) = views
        yield (old[:, part], old_mask[:, part]), (new[:, part], new_mask[:, part])


def agrees(picture_mps: float, recorded_mps: float) -> bool:
    """Tell whether two speeds are the same within a quarter of the larger, or 1 m/s."""
    larger_mps = max(abs(picture_mps), abs(recorded_mps))
    return abs(picture_mps - recorded_mps) <= max(_AGREE_SHARE * larger_mps, _AGREE_MPS)


def _bend_1pm(footage: Footage, first: int, second: int) -> float:
    """Return the recorded curvature of the VUT's way about a pair of frames, + left."""
    moments = footage.moments
    low, high = first, second
    while low > 0 and moments[first].t_s - moments[low - 1].t_s <= _BESIDE_S:
        low -= 1
    while high + 1 < len(moments) and moments[high + 1].t_s - moments[second].t_s <= _BESIDE_S:
        high += 1
    near = [m for m in moments[low : high + 1] if footage.vut_id in m.states]
    states = [m.states[footage.vut_id] for m in near]
    speed_mps = sum(state.speed_mps for state in states) / len(states)
    times_s = np.array([m.t_s for m in near])
    beside_s = times_s - times_s.mean()
    yaws_rad = np.unwrap([state.yaw_rad for state in states])
    rate_radps = float(beside_s @ yaws_rad / (beside_s @ beside_s))
    if abs(rate_radps) < _TURNING_RADPS or abs(rate_radps) > _TIGHTEST_1PM * abs(speed_mps):
        return 0.0
    return rate_radps / speed_mps


def free_road(footage: Footage, index: int) -> Grey:
    """Return where no other participant or its shadow is in a picture: 255 there, else 0."""
    mask = np.full(footage.grey[index].shape, 255, np.uint8)
    view = footage.view(index)
    for name, state in footage.moments[index].states.items():
        box = None if name == footage.vut_id else shown_box(view, state)
        if box is not None:
            left, top, right, bottom = (round(edge) for edge in box)
            # Its shadow moves with it.
            shadow = round(_SHADOW * (bottom - top))
            mask[max(0, top - 2) : bottom + 6, max(0, left - shadow) : right + shadow + 1] = 0
    return mask


@dataclass(frozen=True)
class _Strip:
    """Pixels of the cells of the road ahead; rows go along the VUT's arc, columns to the left."""

    u_px: Float32
    v_px: Float32

    @classmethod
    def of(cls, lens: Intrinsics, mounting: Mounting, bend_1pm: float) -> _Strip:
        ahead_m = np.arange(_NEAR_M - _MARGIN_M, _FAR_M + _MARGIN_M, _STEP_M)
        left_m = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M, _STEP_M)
        x_m, y_m = np.meshgrid(ahead_m, left_m, indexing="ij")
        if bend_1pm:
            # The VUT's point of reference goes along the arc; the camera is ahead of it.
            radius_m = 1.0 / bend_1pm
            angle_rad = (x_m + mounting.forward_m) * bend_1pm
            x_m = (radius_m - y_m) * np.sin(angle_rad) - mounting.forward_m
            y_m = radius_m - (radius_m - y_m) * np.cos(angle_rad)
        points = np.stack([x_m, y_m, np.full_like(x_m, -mounting.height_m)], axis=-1)
        axes = optical_axes(mounting.pitch_down_rad, mounting.yaw_left_rad, mounting.roll_right_rad)
        optical = points @ axes.T
        depth = np.where(optical[..., 2] > 0.5, optical[..., 2], np.nan)
        u = lens.fx_px * optical[..., 0] / depth + lens.cx_px
        v = lens.fy_px * optical[..., 1] / depth + lens.cy_px
        return cls(
            np.nan_to_num(u, nan=-1.0).astype(np.float32),
            np.nan_to_num(v, nan=-1.0).astype(np.float32),
        )

    def resampled(self, picture: Grey, free: Grey) -> _Seen:
        """Return the road from above without what doesn't change along it, and where it is seen."""
        height, width = picture.shape
        road = cv2.remap(picture, self.u_px, self.v_px, cv2.INTER_LINEAR)
        clear = cv2.remap(free, self.u_px, self.v_px, cv2.INTER_NEAREST) > 0
        inside = (
            (self.u_px >= 0.0)
            & (self.u_px < width - 1.0)
            & (self.v_px >= 0.0)
            & (self.v_px < height - 1.0)
        )
        mask: Mask = np.asarray(inside & clear, np.bool_)
        masked_road = np.where(mask, road, 0).astype(np.float32)
        along = (1, round(_ALONG_M / _STEP_M))
        count = cv2.blur(mask.astype(np.float32), along)
        mean = cv2.blur(masked_road, along) / np.maximum(count, 1e-3)
        detail = cv2.GaussianBlur(
            np.where(mask, masked_road - mean, 0.0).astype(np.float32), (3, 3), 0
        )
        return np.asarray(detail * mask, np.float32), mask


def _correlate(before: _Seen, after: _Seen, apart_s: float) -> tuple[FloatArray, FloatArray]:
    """Return ways in m, and the correlation of the road at each of them."""
    most = round(_MARGIN_M / _STEP_M)
    low = max(-most, round(_SLOWEST_MPS * apart_s / _STEP_M))
    high = min(most, round(_FASTEST_MPS * apart_s / _STEP_M))
    steps = np.arange(low, high + 1)
    match = np.full(len(steps), np.nan)
    (old, old_mask), (new, new_mask) = before, after
    rows = len(old)
    new, new_mask = new[most : rows - most], new_mask[most : rows - most]
    for k, step in enumerate(steps):
        part = slice(most + step, rows - most + step)
        both = old_mask[part] & new_mask
        if both.sum() < _LEAST_CELLS:
            continue
        a, b = old[part][both], new[both]
        # One grey level of noise: a road without detail matches nothing.
        energy = (float(a @ a) + both.sum()) * (float(b @ b) + both.sum())
        match[k] = float(a @ b) / math.sqrt(energy)
    return np.asarray(steps * _STEP_M, np.float64), match


def mean_match(pairs: Sequence[Pair], ways_m: Sequence[float]) -> float:
    """Return the mean correlation if the VUT went these ways; NaN where none was tried."""
    matches = [pair.match_at(way_m) for pair, way_m in zip(pairs, ways_m, strict=True)]
    finite_matches = [value for value in matches if math.isfinite(value)]
    return math.fsum(finite_matches) / len(finite_matches) if finite_matches else math.nan
