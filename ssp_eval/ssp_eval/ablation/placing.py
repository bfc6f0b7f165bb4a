"""The search for a place: which lane fits observed bodies best, by geometry alone.

Arms without structure share it. A moving vehicle fits a lane whose middle it keeps and whose
direction it has; a body that stands fits where no lane is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import Driver, Motion, ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.safety.fence import way_excess_m
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import NotOneToOne
from ssp_eval.ablation.ground import VUT, Ground, NoRun
from ssp_eval.ablation.source import STANDS_MPS
from ssp_ot_controller.bodies.dynamics import LIMITS as BODIES
from ssp_ot_controller.bodies.dynamics import tightened
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.base import BlockPoint
from ssp_scenario_manager.scenarios.block_places import end_of, entry_m
from ssp_scenario_manager.scenarios.motions import HOLD_S, cruise_reached_s, start_pose

# Places along a lane that are tried lie so far apart.
_STEP_M = 25.0
# Of the VUT's driver, tried in this order.
HEADWAYS_S = (1.4, 0.8, 0.5)
MOST_LANES = 3
# Placements that are no worse than the best by this fit as well.
_AS_GOOD_M = 0.3
# A fit that is no better.
_SAME_M = 1e-6
_APPROACH_MPS2 = {ObjectClass.TRUCK: 1.2, ObjectClass.BUS: 1.2, ObjectClass.CYCLIST: 1.2}
_VEHICLES = (ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE)
# What a braking to a standstill at a lane's end takes, beside the way that was observed.
_RESERVE_M = 30.0
# Of what a body or a place allows; the rest is for the tracking of it.
_SHARE_OF_LIMIT = 0.95
# A track is smoothed over the fewest of so many instants with which its body can drive it.
_SMOOTHED_OVER = (1, 5, 9, 13, 17, 25, 33)


@dataclass(frozen=True)
class Body:
    """An observed body on a block.

    Args:
        l_m: offset from the block's reference line.
        forward: it heads along the block.
        stands: it doesn't move.
    """

    object_class: ObjectClass
    l_m: float
    forward: bool
    stands: bool


@dataclass(frozen=True)
class Placement:
    """A lane for the VUT, and where in it it starts.

    Args:
        misfit_m: distance from where it fits of the body that fits worst.
    """

    block: Block
    lane: BlockLane
    start_s_m: float
    misfit_m: float


def approach_mps2(object_class: ObjectClass, limits: Limits) -> float:
    """Return the acceleration with which a body gets to its speed."""
    return min(_APPROACH_MPS2.get(object_class, 2.0), limits.acceleration_mps2)


def size_of(object_class: ObjectClass) -> Size:
    return DEFAULT_SIZES[object_class]


def run_up_s(cruise_mps: float, acceleration_mps2: float) -> float:
    """Return the time that the VUT needs from standstill until it holds its speed."""
    return cruise_reached_s(cruise_mps, acceleration_mps2) + HOLD_S


def slower_by(ground: Ground, block: Block, speeds: Sequence[FloatArray]) -> float:
    """Return the share of the observed speeds at which the place carries all of them.

    Args:
        ground: the place.
        block: of it.
        speeds: of each body, m/s, shape (n,).
    """
    most_mps = _SHARE_OF_LIMIT * min(ground.limits.speed_mps, block.speed_limit_mps or np.inf)
    return min(1.0, most_mps / max(float(speed.max()) for speed in speeds))


def most_mps2(object_class: ObjectClass, limits: Limits) -> tuple[float, float]:
    """Return the hardest acceleration and braking that a body and the place allow."""
    body = tightened(BODIES[object_class], limits)
    return _SHARE_OF_LIMIT * body.acceleration_mps2, _SHARE_OF_LIMIT * body.deceleration_mps2


def placements(
    ground: Ground, need_m: float, bodies: Callable[[Block, BlockLane, float], Sequence[Body]]
) -> list[Placement]:
    """Return the lanes that fit best, and about as well as each other, each where it fits best.

    Args:
        ground: the place.
        need_m: way of the VUT from its start on.
        bodies: at block, lane and start of the VUT.

    Raises:
        NoRun: no lane is long enough.
    """
    best: dict[tuple[str, float], Placement] = {}
    for one in _placements(ground, need_m, bodies):
        incumbent = best.setdefault((one.block.block_id, one.lane.y_m), one)
        if one.misfit_m < incumbent.misfit_m - _SAME_M:
            best[one.block.block_id, one.lane.y_m] = one
    if not best:
        longest = max((block.length_m for block in ground.blocks), default=0.0)
        raise NoRun(f"no lane is long enough: {need_m:.0f} m are needed, {longest:.0f} m are there")
    candidates = sorted(best.values(), key=lambda one: one.misfit_m)
    as_good = (one for one in candidates if one.misfit_m <= candidates[0].misfit_m + _AS_GOOD_M)
    return list(islice(as_good, MOST_LANES))


def _placements(
    ground: Ground, need_m: float, bodies: Callable[[Block, BlockLane, float], Sequence[Body]]
) -> Iterator[Placement]:
    for block in ground.blocks:
        last_m = end_of(block, size_of(ObjectClass.CAR)) - need_m - _RESERVE_M
        for lane in block.forward_lanes:
            for start_m in np.arange(entry_m(block), last_m + 1e-9, _STEP_M).tolist():
                try:
                    there = bodies(block, lane, start_m)
                except NotOneToOne:
                    continue
                misfit_m = max((_misfit_m(block, body) for body in there), default=0.0)
                yield Placement(block, lane, start_m, misfit_m)


def _misfit_m(block: Block, body: Body) -> float:
    if body.stands:
        half_m = size_of(body.object_class).width_m / 2.0
        right_m, left_m = body.l_m - half_m, body.l_m + half_m
        if not any(
            right_m < lane.y_m + lane.width_m / 2.0 and left_m > lane.y_m - lane.width_m / 2.0
            for lane in block.lanes
        ):
            return 0.0
        # As far as it is from where it would stand beside all lanes.
        return min(left_m - block.right_edge_m, block.left_edge_m - right_m)
    if body.object_class not in _VEHICLES:
        return 0.0
    lanes = [lane for lane in block.lanes if lane.forward == body.forward]
    # Off every lane of its direction it is as far off as the road is wide.
    wide_m = block.left_edge_m - block.right_edge_m
    return min((abs(lane.y_m - body.l_m) for lane in lanes), default=wide_m)


def vut_of(
    placement: Placement, cruise_mps: float, headway_s: float, limits: Limits
) -> tuple[ParticipantSpec, Driver]:
    """Return a VUT that drives along its lane, and its driver."""
    block, lane = placement.block, placement.lane
    end_m = end_of(block, size_of(ObjectClass.CAR))
    a = approach_mps2(ObjectClass.CAR, limits)
    spec = ParticipantSpec(
        id=VUT,
        object_class="car",
        start=start_pose(block.line, BlockPoint(placement.start_s_m, lane.y_m)),
        approach=Motion(
            path=block.line.path(placement.start_s_m, end_m, lane.y_m),
            cruise_mps=cruise_mps,
            acceleration_mps2=a,
        ),
    )
    return spec, Driver(cruise_mps=cruise_mps, acceleration_mps2=a, headway_s=headway_s)


# After what was observed a body goes on as it was seen last, for the longest of these that the
# fence leaves room for, and stops.
_GOES_ON_S = (10.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.0, 0.5, 0.0)
_DT_S = 1.0 / 24.0
_STOP_M = 3.0


def timed_motion(
    times_s: FloatArray,
    places_m: FloatArray,
    object_class: ObjectClass,
    ground: Ground,
    block: Block,
) -> tuple[Start, Motion | None]:
    """Return the motion through places at session times, with a run-up and a run-out.

    Args:
        times_s: rising, from the beginning of the observed part on, shape (n,).
        places_m: shape (n, 2), frame map.
        object_class: of the body.
        ground: whose fence it keeps to.
        block: of the place.

    Returns:
        Where it stands at first, and its motion; None: it stands all the time.

    Raises:
        NoRun: it leaves the fence, or there is no time for its run-up.
    """
    # Noise of the places is no motion, and who creeps stands.
    steady = _smoothed(places_m, _SMOOTHED_OVER[-1])
    if np.hypot(*np.gradient(steady, times_s, axis=0).T).max() < STANDS_MPS:
        x, y = steady.mean(axis=0)
        return Start(x_m=float(x), y_m=float(y), yaw_rad=0.0), None
    a = approach_mps2(object_class, ground.limits)
    places_m = _drivable(times_s, places_m, most_mps2(object_class, ground.limits))
    way = np.hypot(*(places_m - places_m[0]).T)
    begins = int(np.argmax(way > 1e-3)) - 1
    t, p = times_s[max(begins, 0) :], places_m[max(begins, 0) :]
    v0 = (p[1] - p[0]) / (t[1] - t[0])
    if np.hypot(*v0) > STANDS_MPS:
        t, p = _with_run_up(t, p, v0, a)
    fence = ground.area.geofence(block)
    size = size_of(object_class)
    for goes_on_s in _GOES_ON_S:
        times, places = _with_run_out(t, p, goes_on_s, a)
        yaw = np.arctan2(*np.gradient(places, times, axis=0).T[::-1])
        margin = Size(size.front_m + _STOP_M, size.rear_m, size.width_m, size.height_m)
        if not way_excess_m(places[:, 0], places[:, 1], yaw, margin, fence).any():
            return _motion(times, places)
    raise NoRun("its observed track leaves the fence")


def _smoothed(places: FloatArray, count: int) -> FloatArray:
    """Return the means of places over so many instants, shape (n, 2)."""
    half = min(count // 2, len(places) - 1)
    # Mirrored in its ends, so that a steady motion stays as it is.
    padded = np.pad(places, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    window = np.ones(2 * half + 1) / (2 * half + 1)
    return np.stack([np.convolve(c, window, "valid") for c in padded.T], axis=1)


def _drivable(times: FloatArray, places: FloatArray, most: tuple[float, float]) -> FloatArray:
    """Smooth a track as little as its body needs to drive it."""
    smooth = places
    for count in _SMOOTHED_OVER:
        smooth = _smoothed(places, count)
        speed = np.hypot(*np.gradient(smooth, times, axis=0).T)
        change = np.gradient(speed, times)
        if change.max() <= most[0] and -change.min() <= most[1]:
            break
    return smooth


# The manager sends every approach so long before it begins.
_LEAD_S = 0.5


def _motion(times: FloatArray, places: FloatArray) -> tuple[Start, Motion]:
    moved = np.append(True, np.hypot(*np.diff(places, axis=0).T) > 1e-6)
    times, places = times[moved], places[moved]
    if times[0] < _LEAD_S:
        raise NoRun(f"its run-up would begin {_LEAD_S - times[0]:.1f} s before the session")
    heading = places[min(5, len(places) - 1)] - places[0]
    speed = np.hypot(*np.gradient(places, times, axis=0).T)
    start = Start(
        x_m=float(places[0, 0]),
        y_m=float(places[0, 1]),
        yaw_rad=float(np.arctan2(heading[1], heading[0])),
    )
    motion = Motion(
        path=[(float(x), float(y)) for x, y in places.round(6)],
        cruise_mps=float(speed.max()),
        times_s=[round(float(t) - _LEAD_S, 6) for t in times],
    )
    return start, motion


def ramp_s(speed_mps: float, acceleration_mps2: float) -> float:
    """Return the time of a smooth change from or to a standstill with this peak acceleration."""
    return 1.5 * speed_mps / acceleration_mps2


def _with_run_up(
    t: FloatArray, p: FloatArray, v0: FloatArray, a: float
) -> tuple[FloatArray, FloatArray]:
    """Put a smooth start from standstill, and a second at the first speed, before a track."""
    speed = float(np.hypot(*v0))
    along = v0 / speed
    took_s, held_s = ramp_s(speed, a), 1.0
    before = -np.arange(_DT_S, took_s + held_s, _DT_S)[::-1]
    u = np.clip((before + held_s + took_s) / took_s, 0.0, 1.0)
    # The integral of speed * u^2 (3 - 2 u), which ends in half of the way at that speed.
    driven = took_s * speed * (u**3 - 0.5 * u**4)
    left_m = np.where(
        before < -held_s, speed * held_s + 0.5 * took_s * speed - driven, -before * speed
    )
    return np.concatenate((t[0] + before, t)), np.concatenate((p[0] - left_m[:, None] * along, p))


def _with_run_out(
    t: FloatArray, p: FloatArray, goes_on_s: float, a: float
) -> tuple[FloatArray, FloatArray]:
    """Let a track go on as it was seen last, and come to a smooth stop."""
    v1 = (p[-1] - p[-2]) / (t[-1] - t[-2])
    speed = float(np.hypot(*v1))
    if speed < STANDS_MPS:
        return t, p
    took_s = max(ramp_s(speed, a), 0.5)
    after = np.arange(_DT_S, goes_on_s + took_s + _DT_S, _DT_S)
    u = np.clip((after - goes_on_s) / took_s, 0.0, 1.0)
    braked = took_s * speed * (u - (u**3 - 0.5 * u**4))
    way_m = np.where(after < goes_on_s, speed * after, speed * goes_on_s + braked)
    places = p[-1] + way_m[:, None] * (v1 / speed)
    return np.concatenate((t, t[-1] + after)), np.concatenate((p, places))
