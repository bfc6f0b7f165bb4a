"""Comparison of a recording's pictures with its states: figures, each with its limit.

How the limits were chosen stands in docs/audit.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

import cv2
import numpy as np

from ssp_core.run_file.road import Road
from ssp_eval.data.audit import PictureCheck
from ssp_eval.pictures.change import Change, compare_change, is_aside, is_visible
from ssp_eval.pictures.footage import Footage, Grey, coarse, pairs_apart, reduced_size, spread
from ssp_eval.pictures.ground import Pair, agrees, compare_ground, mean_match
from ssp_eval.pictures.sides import Sides, compare_sides, frames_apart
from ssp_eval.pictures.turning import Turn, compare_turning
from ssp_eval.recordings.sight import Moment, Optics

_ROAD_APART_S, _ROAD_PAIRS = 0.1, 48
# Of the pairs those come first in which an object's mirror image would lie elsewhere.
_CHANGE_APART_S, _CHANGE_PAIRS, _ASIDE_PAIRS = 0.4, 28, 16
_TURN_PAIRS = 12
# Slower, the road moves too little between two frames.
_MOVING_MPS = 2.0
_LEAST_PAIRS, _LEAST_ASIDE = 8, 5

# Pictures' speed over recorded speed. A camera whose pitch is off by a degree makes a quarter.
RATIO_LIMITS = (0.7, 1.4)
_RATIOS = tuple(k / 20.0 for k in range(-30, 61))
AGREEING_LIMIT = 0.5
# Of states and pictures; METHOD 4.3b lets topics differ by 0.3 s.
LAG_LIMIT_S = 0.5
_LAGS_S = tuple(k / 10.0 for k in range(-20, 21))
_KNOWN_LAG_S = 0.6
# So much more must the speeds differ 0.6 s beside the best lag for it to be known, and within the
# limit for a lag beyond it to count; of a pair that was mistaken, so much does.
_LAG_RISE_MPS, _OFF_RISE_MPS, _MISTAKEN_MPS = 0.12, 0.05, 2.0
# And by half of what they differ at the best lag, since noise of places makes lags fit by chance.
_LAG_RISE_SHARE = 0.5
# At each lag speeds may be off by a factor, within the limits of the ratio.
_TIME_RATIOS = tuple(0.7 + 0.025 * k for k in range(29))
# Recorded turning that is large enough to be compared, and in how many pairs; how much is seen.
_TURNING_RADPS = 0.03
_LEAST_TURNS = 4
TURN_LIMITS = (0.5, 1.6)
# Without recorded turning: median of the pictures' yaw rate.
STRAIGHT_LIMIT_RADPS = 0.03
# Difference of frames near in time over that of frames further apart.
ORDER_LIMIT, _FAR_PAIRS, _LEAST_DIFFERENCE = 0.85, 16, 0.5
# Fit of lane borders in the pictures less that in their mirror images. Between the limit and its
# opposite neither is the better one. Fits below the least, or lanes of which less differs between
# the sides, tell nothing.
SIDES = "left and right"
SIDES_LIMIT, _LEAST_FIT, _DIFFERING = -0.06, 0.4, 0.2
# How many times as much changes in an object's box as beside it.
CHANGE_LIMIT = 1.3
# Darker or flatter pictures show too little, median over frames in grey levels.
# At a smaller width the road near the VUT moves by less than a pixel a frame.
_LEAST_WIDTH_PX = 240
_DARK, _FLAT, _LIT_FRAMES = 20.0, 6.0, 16


@dataclass(frozen=True)
class Plan:
    """Pairs of frames that are compared, by index, the earlier one first.

    Args:
        road: near in time, for motion and turning.
        far: of some of these the earlier frame, with one further away, for the order of frames.
        change: per object that is looked for.
        sides: single frames, some way apart, for the two sides of the road.
    """

    road: Sequence[tuple[int, int]]
    far: Sequence[tuple[int, int]]
    change: Mapping[str, Sequence[tuple[int, int]]]
    sides: Sequence[int]

    @property
    def frame_indices(self) -> set[int]:
        """Indices of all frames that are needed."""
        pairs = [*self.road, *self.far, *(pair for one in self.change.values() for pair in one)]
        return {index for pair in pairs for index in pair}.union(self.sides)


def plan_pairs(
    moments: Sequence[Moment],
    optics: Optics,
    vut_id: str,
    targets: Collection[str],
    repeated: Collection[int] = (),
) -> Plan:
    """Choose the pairs to compare by the states, out of frames whose pictures are their own.

    Args:
        moments: frames of the clip with their states.
        optics: lens and mount of the camera.
        vut_id: id of the VUT.
        targets: ids of the objects that are looked for.
        repeated: indices of frames that repeat the one before.
    """
    times_s = [moment.t_s for moment in moments]
    usable = [
        k for k, moment in enumerate(moments) if vut_id in moment.states and k not in repeated
    ]
    road = pairs_apart(times_s, _ROAD_APART_S, _ROAD_PAIRS, set(usable))
    # Sizes in the picture are those at the width at which pictures are compared.
    width, height = reduced_size(optics.lens.width_px, optics.lens.height_px)
    unread = Footage(moments, {0: np.zeros((height, width), np.uint8)}, optics, vut_id)
    wide = pairs_apart(times_s, _CHANGE_APART_S, len(times_s), set(usable))
    change = {}
    for target in targets:
        visible_pairs = [pair for pair in wide if is_visible(unread, pair[1], target)]
        aside = [pair for pair in visible_pairs if is_aside(unread, pair[1], target)]
        rest = [pair for pair in visible_pairs if pair not in set(aside)]
        target_pairs = [*spread(aside, _ASIDE_PAIRS), *spread(rest, _CHANGE_PAIRS - _ASIDE_PAIRS)]
        change[target] = sorted(target_pairs)
    starts = {first for first, _ in spread(road, _FAR_PAIRS)}
    far = [pair for pair in wide if pair[0] in starts]
    return Plan(road, far, change, frames_apart(moments, vut_id, usable))


@dataclass(frozen=True)
class PictureFigures:
    """All figures of a recording, and what they come from."""

    checks: tuple[PictureCheck, ...]
    road: tuple[Pair, ...] = ()
    turns: tuple[Turn, ...] = ()
    change: Mapping[str, Sequence[Change]] = field(default_factory=dict)


def compare_pictures(footage: Footage, plan: Plan, lanes: Road | None = None) -> PictureFigures:
    """Compare pictures with states.

    Args:
        footage: with the pictures of the plan; pairs of which one is missing are left out.
        plan: pairs of frames, as plan_pairs chose them.
        lanes: the road that is bound to the recording; None: there is none.
    """

    def read(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        return [pair for pair in pairs if all(index in footage.grey for index in pair)]

    road_pairs = read(plan.road)
    if why := _unlit(footage.grey):
        names = ["speed", "course of the speed", "time", "turning", "order of the frames"]
        names += [SIDES, *plan.change]
        return PictureFigures(tuple(_open(name, why) for name in names))
    road = compare_ground(footage, road_pairs)
    moving = [
        pair
        for pair, one in zip(road_pairs, road, strict=True)
        if abs(one.speed_mps) >= _MOVING_MPS
    ]
    turns = compare_turning(footage, spread(moving, _TURN_PAIRS))
    change = {
        target: compare_change(footage, read(pairs), target)
        for target, pairs in plan.change.items()
    }
    checks = [*road_checks(road), turning_check(turns)]
    starts = {first for first, _ in moving}
    far = [pair for pair in read(plan.far) if pair[0] in starts]
    checks.append(order_check(footage.grey, moving, far))
    sides = None
    if lanes is not None:
        sides = compare_sides(footage, [k for k in plan.sides if k in footage.grey], lanes)
    checks.append(sides_check(sides, lanes is not None, _other_side_evidence(checks, change)))
    for target, changes in change.items():
        checks += [change_check(target, changes), place_check(target, changes)]
    return PictureFigures(tuple(checks), tuple(road), tuple(turns), change)


def _open(name: str, why: str, sample_count: int = 0) -> PictureCheck:
    return PictureCheck(name=name, figure=None, judged=sample_count, told=why)


def _figure(
    name: str,
    figure: float,
    limits: tuple[float | None, float | None],
    sample_count: int,
    finding: str,
    unit: str = "",
) -> PictureCheck:
    low, high = limits
    return PictureCheck(
        name=name, figure=figure, unit=unit, low=low, high=high, judged=sample_count, told=finding
    )


def _unlit(grey: Mapping[int, Grey]) -> str:
    """Return why pictures show too little to be judged; empty: they don't."""
    if not grey:
        return "there are no pictures with states of the VUT"
    some = spread(sorted(grey), _LIT_FRAMES)
    width_px = grey[some[0]].shape[1]
    if width_px < _LEAST_WIDTH_PX:
        return f"the pictures are too small: {width_px} px wide, needed are {_LEAST_WIDTH_PX}"
    bright = median(float(grey[index].mean()) for index in some)
    contrast = median(float(grey[index].std()) for index in some)
    if bright < _DARK:
        return f"the pictures are dark: {bright:.0f} of 255 grey levels, needed are {_DARK:g}"
    if contrast < _FLAT:
        return f"the pictures show nothing: they vary by {contrast:.1f} of 255 grey levels"
    return ""


def road_checks(pairs: Sequence[Pair]) -> list[PictureCheck]:
    """Judge speed, its course, and the time of the pictures by the motion of the road."""
    names = ("speed", "course of the speed", "time")
    moving = [pair for pair in pairs if abs(pair.speed_mps) >= _MOVING_MPS]
    followed = [pair for pair in pairs if pair.is_followed]
    if len(moving) < _LEAST_PAIRS:
        why = f"the VUT stands or creeps in all but {len(moving)} pairs of frames"
        return [_open(name, why, len(moving)) for name in names]
    usable_pairs = [pair for pair in moving if pair.is_followed]
    if len(usable_pairs) < max(_LEAST_PAIRS, len(moving) / 2.0):
        still = sum(pair.is_still for pair in moving)
        why = f"the road could be followed in {len(usable_pairs)} of {len(moving)} pairs of frames"
        if still:
            why += f"; in {still} what is seen stands still, as artefacts of compression do"
        return [_open(name, why, len(usable_pairs)) for name in names]
    ratio = max(
        _RATIOS, key=lambda r: _fit(usable_pairs, [r * pair.way_m for pair in usable_pairs])
    )
    speed = _figure(
        names[0],
        ratio,
        RATIO_LIMITS,
        len(usable_pairs),
        f"the road moves {ratio:.2f} times as fast as recorded",
    )
    scale = min(max(ratio, RATIO_LIMITS[0]), RATIO_LIMITS[1])
    agreeing = sum(agrees(pair.picture_mps / scale, pair.speed_mps) for pair in followed)
    share = agreeing / len(followed)
    course = _figure(
        names[1],
        share,
        (AGREEING_LIMIT, None),
        len(followed),
        f"the road moves as fast as recorded, but for that factor, in {agreeing} of "
        f"{len(followed)} pairs of frames",
    )
    return [speed, course, _time_check(names[2], followed)]


def _fit(pairs: Sequence[Pair], ways_m: Sequence[float]) -> float:
    correlation = mean_match(pairs, ways_m)
    return correlation if math.isfinite(correlation) else -math.inf


def _time_check(name: str, pairs: Sequence[Pair]) -> PictureCheck:
    """Find the delay of the pictures at which the recorded speeds differ least from those seen."""
    times_s = np.array([pair.t_s for pair in pairs])
    recorded_mps = np.array([pair.speed_mps for pair in pairs])
    picture_mps = np.array([pair.refined_mps for pair in pairs])
    scaled_mps = picture_mps / np.array(_TIME_RATIOS)[:, None]

    def left_over_mps(lag_s: float) -> float:
        # Before the first and after the last pair their speeds go on.
        expected_mps = np.interp(times_s + lag_s, times_s, recorded_mps)
        # Beyond the bound a pair was mistaken, by however much.
        apart_mps = np.minimum(np.abs(scaled_mps - expected_mps), _MISTAKEN_MPS)
        return float(apart_mps.mean(axis=1).min())

    misfits_mps = {lag_s: left_over_mps(lag_s) for lag_s in _LAGS_S}

    def best_of(lags_s: Iterable[float]) -> float:
        return min(lags_s, key=lambda lag_s: (misfits_mps[lag_s], abs(lag_s)))

    best_s = best_of(_LAGS_S)
    beside_s = [lag_s for lag_s in _LAGS_S if abs(lag_s - best_s) >= _KNOWN_LAG_S - 1e-9]
    least_mps = max(_LAG_RISE_MPS, _LAG_RISE_SHARE * misfits_mps[best_s])
    if misfits_mps[best_of(beside_s)] - misfits_mps[best_s] < least_mps:
        return _open(name, "the speed changes too little to tell a delay", len(pairs))
    sound_s = best_of(lag_s for lag_s in _LAGS_S if abs(lag_s) <= LAG_LIMIT_S + 1e-9)
    if misfits_mps[sound_s] - misfits_mps[best_s] < _OFF_RISE_MPS:
        best_s = sound_s
    where = "ahead of" if best_s > 0.0 else "behind"
    finding = f"the speeds fit best where the pictures are {abs(best_s):.1f} s {where} the states"
    return _figure(name, best_s, (-LAG_LIMIT_S, LAG_LIMIT_S), len(pairs), finding, "s")


def turning_check(turns: Sequence[Turn]) -> PictureCheck:
    """Judge the pictures' turning against the recorded yaw rate."""
    name = "turning"
    if len(turns) < _LEAST_PAIRS:
        return _open(name, f"points could be followed in {len(turns)} pairs of frames", len(turns))
    recorded = np.array([turn.recorded_radps for turn in turns])
    picture_radps = np.array([turn.picture_radps for turn in turns])
    turned = np.abs(recorded) >= _TURNING_RADPS
    if turned.sum() >= _LEAST_TURNS:
        # The median: a pair in which points were mistaken moves nothing.
        share = float(np.median(picture_radps[turned] / recorded[turned]))
        finding = f"the pictures turn {share:.2f} times as fast as recorded"
        return _figure(name, share, TURN_LIMITS, int(turned.sum()), finding)
    rate_radps = float(np.median(np.abs(picture_radps - recorded)))
    finding = (
        f"the pictures turn by {rate_radps:.3f} rad/s other than the VUT, which drives straight"
    )
    return _figure(name, rate_radps, (None, STRAIGHT_LIMIT_RADPS), len(turns), finding, "rad/s")


def order_check(
    grey: Mapping[int, Grey], near: Sequence[tuple[int, int]], far: Sequence[tuple[int, int]]
) -> PictureCheck:
    """Judge whether frames that lie close together resemble each other more than others do.

    Args:
        grey: reduced pictures by frame.
        near: pairs of frames, while the VUT moves.
        far: pairs that lie further apart.
    """
    name = "order of the frames"
    second = dict(near)
    starts = [(first, later) for first, later in far if first in second]
    if len(starts) < _LEAST_PAIRS:
        return _open(name, f"there are {len(starts)} triples of frames to compare")

    def differ(one: int, other: int) -> float:
        return float(cv2.absdiff(coarse(grey[one]), coarse(grey[other])).mean())

    apart = [differ(first, later) for first, later in starts]
    if median(apart) < _LEAST_DIFFERENCE:
        return _open(name, f"frames {_CHANGE_APART_S:g} s apart hardly differ", len(starts))
    # From one frame each: what a drive shows in one stretch says nothing of another.
    close = [differ(first, second[first]) for first, _ in starts]
    share = median(one / max(other, 1e-9) for one, other in zip(close, apart, strict=True))
    finding = (
        f"frames {_ROAD_APART_S:g} s apart differ {share:.2f} times as much as frames "
        f"{_CHANGE_APART_S:g} s apart"
    )
    return _figure(name, share, (None, ORDER_LIMIT), len(starts), finding)


def change_check(target: str, changes: Sequence[Change]) -> PictureCheck:
    """Judge whether an object is where its states say.

    Pairs in which its mirror image would lie elsewhere must hold by themselves: an object straight
    ahead is where its mirror image is.
    """
    if len(changes) < _LEAST_PAIRS:
        why = f"it is large, clear and before the road in {len(changes)} pairs of frames"
        return _open(target, why, len(changes))
    factor = median(one.factor for one in changes)
    elsewhere = ""
    beside = _aside(changes)
    if len(beside) >= _LEAST_ASIDE:
        aside = median(one.factor for one in beside)
        mirrored = median(one.mirrored_factor or 0.0 for one in beside)
        factor = min(factor, aside)
        elsewhere = f", and {mirrored:.2f} times as much where a mirrored picture had it"
    finding = f"{factor:.2f} times as much changes in its box as on the road beside it{elsewhere}"
    return _figure(target, factor, (CHANGE_LIMIT, None), len(changes), finding)


def _other_side_evidence(
    checks: Sequence[PictureCheck], change: Mapping[str, Sequence[Change]]
) -> str:
    """Return what else tells left from right in a recording; empty: nothing."""
    turning = next(check for check in checks if check.name == "turning")
    if turning.figure is not None and not turning.unit:
        return "its turning does"
    aside = [target for target, changes in change.items() if len(_aside(changes)) >= _LEAST_ASIDE]
    return f"the place of {aside[0]} does" if aside else ""


def sides_check(sides: Sides | None, has_lanes: bool, otherwise: str) -> PictureCheck:
    """Judge whether the lanes lie on the side of the pictures on which the road has them.

    Args:
        sides: comparison of both sides; None: there was nothing to compare.
        has_lanes: a road is bound to the recording.
        otherwise: what else tells left from right; empty: nothing.
    """
    why = ""
    if not has_lanes:
        why = "the recording has no road whose lanes could tell left from right"
    elif sides is None:
        why = "too little of the road is seen to tell left from right by its lanes"
    elif sides.differing < _DIFFERING:
        why = "the lanes of the road are alike to the left and right of the VUT"
    elif max(sides.fit, sides.mirrored) < _LEAST_FIT:
        why = "lane borders do not stand out in the pictures"
    elif abs(sides.fit - sides.mirrored) < -SIDES_LIMIT:
        why = "lane borders fit the pictures and their mirror images alike"
    if sides is None or why:
        rest = otherwise or "nothing else does, so that mirrored pictures would not be seen"
        return _open(SIDES, f"{why}; {rest}", 0 if sides is None else sides.frame_count)
    finding = (
        f"lane borders fit the pictures by {sides.fit:.2f}, and their mirror images by "
        f"{sides.mirrored:.2f}"
    )
    return _figure(
        SIDES, sides.fit - sides.mirrored, (SIDES_LIMIT, None), sides.frame_count, finding
    )


def _aside(changes: Sequence[Change]) -> list[Change]:
    """Return the pairs in which a mirrored picture would have the object elsewhere."""
    return [one for one in changes if one.mirrored is not None]


def place_check(target: str, changes: Sequence[Change]) -> PictureCheck:
    """Tell how far beside an object's box the change lies: in three of four pairs no further.

    It has no limit: places from other systems are sound and off by decimetres.
    """
    name = f"place of {target}"
    off_m = [abs(one.off_m) for one in changes if one.off_m is not None]
    if len(off_m) < _LEAST_PAIRS:
        return _open(name, f"change stands out in {len(off_m)} pairs of frames", len(off_m))
    figure_m = float(np.percentile(off_m, 75))
    finding = f"in three of four pairs the change lies within {figure_m:.2f} m of the box"
    return _figure(name, figure_m, (None, None), len(off_m), finding, "m")
