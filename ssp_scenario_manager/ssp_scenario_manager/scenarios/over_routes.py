"""Plans in which a vehicle comes over one route through a junction while the VUT follows another.

The vehicle waits on its arm before the junction, and drives off along its route when the trigger
fires. Which routes it may come over is up to the kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Literal

import numpy as np

from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.encounter import (
    AGAINST_RAD,
    ALONG_RAD,
    corridor_half_m,
    is_crossing,
    swept_on_way,
)
from ssp_core.motion.state import Size
from ssp_core.run_file.participants import GiveWay
from ssp_core.run_file.values import Point
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.block import Block, Conflict, Passage
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Plan,
    Setting,
    Trigger,
    Wait,
)
from ssp_scenario_manager.scenarios.block_places import (
    END_MARGIN_M,
    ahead_of,
    bend_speed_mps,
    end_of,
    rectangle,
    station_of,
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.motions import HOLD_S, cruise_reached_s, driver_travel, motions
from ssp_scenario_manager.scenarios.planning import (
    BODY_MPS2,
    MOST_DRAFTED,
    Draft,
    plans_in_lane,
    plans_on,
)
from ssp_scenario_manager.scenarios.prediction import predict
from ssp_scenario_manager.scenarios.values import (
    Choice,
    acceleration_limit,
    approach_acceleration,
    choice_entries,
    choose,
    classes_of,
    combinations,
    fixed,
    quantity_at,
    size_of,
    speed_bounds,
    thresholds_of,
    vehicle_speed_limit,
)

_VUT_BRAKING_MPS2 = 3.0
# The vehicle's way goes on so far beyond the junction, and is sampled at this step.
_BEYOND_M = 40.0
_STEP_M = 1.0
# The VUT waits until the vehicle's rear is so far beyond where it came into the VUT's lane, and
# follows one that goes on in it.
_FOLLOWED_M = 14.0
# The error of a way along the chords of a line.
_CHORD_M = 0.001
_BELOW = "constraints.trigger.below"
# Where routes cross, the other route, and its part in the junction.
Crossing = tuple[Conflict, Block, Passage]
# The vehicle's path, and the first and last station of it that the VUT covers; None: of none.
_Met = tuple[list[Point], tuple[float, float] | None]


@dataclass(frozen=True, slots=True)
class RouteMotion:
    """The motion of the vehicle over its route.

    Args:
        ahead_s: so long before a VUT that doesn't react it is in the corridor, where K* allows it.
        speed: field of ``constraints.manoeuvre`` that holds its speed.
        beyond_m: its way ends so far beyond the junction, at the latest.
        has_priority: the VUT gives way to it, by ``constraints.manoeuvre.critical_gap``, and it
            keeps no time gap by itself.
        before_zone_m: the VUT's front waits so far before the conflict zone.
    """

    ahead_s: float
    speed: str = "crossing_speed"
    beyond_m: float = _BEYOND_M
    has_priority: bool = False
    before_zone_m: float = 1.0


def side_of(event: Event) -> str:
    """Return the side that the vehicle comes from."""
    return event.interaction.dominant_motion.rpartition("_")[2]


def conflicting_routes(
    block: Block,
    routes: Mapping[str, Block],
    kind: Literal["crossing", "merge"] = "crossing",
    *,
    turns: bool = False,
) -> Iterator[Crossing]:
    """Yield the conflicts with routes that cross or join one, and those.

    Args:
        block: the one, which leads straight on, or turns left.
        routes: all.
        kind: of the conflicts.
        turns: it turns left.

    Raises:
        CannotPlace: the block isn't such a route.
    """
    passage = turning_left(block) if turns else straight_on(block)
    for conflict in passage.conflicts:
        other = routes.get(conflict.route)
        if conflict.kind == kind and other is not None and other.passage is not None:
            yield conflict, other, other.passage


def _passage(block: Block) -> Passage:
    """Return the part of a route in its junction.

    Raises:
        CannotPlace: the block is no route.
    """
    if block.passage is None:
        raise CannotPlace("it leads over no connecting road of a junction")
    return block.passage


def turning_left(block: Block) -> Passage:
    """Return the part of a route in its junction, on which the VUT turns left.

    Raises:
        CannotPlace: the block is no route, or it doesn't turn left.
    """
    passage = _passage(block)
    if passage.turn_rad < STRAIGHT_ON_RAD:
        raise CannotPlace(
            f"it turns by {math.degrees(passage.turn_rad):.0f} deg in the junction; the VUT turns "
            f"left, which is at least {math.degrees(STRAIGHT_ON_RAD):.0f} deg"
        )
    return passage


def straight_on(block: Block) -> Passage:
    """Return the part of a route in its junction, on which the VUT goes straight on.

    Raises:
        CannotPlace: the block is no route, or it turns.
    """
    passage = _passage(block)
    turn_rad = abs(passage.turn_rad)
    if turn_rad >= STRAIGHT_ON_RAD:
        raise CannotPlace(
            f"it turns by {math.degrees(turn_rad):.0f} deg in the junction; the VUT goes straight "
            f"on, which is less than {math.degrees(STRAIGHT_ON_RAD):.0f} deg"
        )
    return passage


def _speed_limit(
    setting: Setting, route: Block, span_m: tuple[float, float], field: str, who: str
) -> float:
    """Return the least of what road, place and K* allow on a stretch, also sideways, m/s.

    Args:
        setting: event and limits.
        route: that the stretch is part of.
        span_m: arc lengths at which the stretch begins and ends.
        field: of the speed in K*.
        who: drives there.

    Raises:
        CannotPlace: the stretch bends too much for what K* demands.
    """
    event, limits = setting.event, setting.limits
    fastest, most_mps2 = (
        vehicle_speed_limit(event, limits, route),
        acceleration_limit(event, limits),
    )
    in_bend = bend_speed_mps(route, *span_m, most_mps2)
    quantity = quantity_at(event, field)
    least_mps = quantity.si.low if isinstance(quantity, Interval) else 0.0
    if in_bend < min(least_mps, fastest):
        raise CannotPlace(
            f"the way of {who} bends so much that {most_mps2:g} m/s^2 sideways allow "
            f"{in_bend:.1f} m/s; K* wants at least {least_mps:g} m/s"
        )
    return min(fastest, in_bend)


def _approach_m(setting: Setting, speed_mps: float, below_s: float) -> float:
    """Return the distance that the VUT's front needs up to where it is crossed, m."""
    rate = approach_acceleration(setting.event, setting.event.vut_id, setting.limits)
    driven, _ = driver_travel(speed_mps, rate, cruise_reached_s(speed_mps, rate) + HOLD_S)
    return driven + speed_mps * below_s


def _vut_start(
    setting: Setting, speed_mps: float, below_s: float, crossing_s_m: float
) -> BlockPoint:
    """Return the VUT's start, from which it drives at cruise speed before the trigger.

    Raises:
        CannotPlace: the approach is too short.
    """
    vut = size_of(setting.event, setting.event.vut_id)
    needed = vut.front_m + _approach_m(setting, speed_mps, below_s)
    start = crossing_s_m - needed
    # Chords cut bends, so that the start lies no later than that along the line.
    if start >= vut.rear_m - _CHORD_M:
        start = round(ahead_of(setting.block, crossing_s_m, -needed, 0.0), 3)
    if start < vut.rear_m:
        raise CannotPlace(
            f"the VUT needs {needed + vut.rear_m:.0f} m up to where it is crossed, and the route "
            f"has {crossing_s_m:.0f} m"
        )
    return BlockPoint(start, 0.0)


def _way(
    block: Block,
    other: Block,
    passage: Passage,
    size: Size,
    line_distance_m: float,
    beyond_m: float,
    *,
    joins: bool,
) -> tuple[Wait, tuple[BlockPoint, ...]]:
    """Return the vehicle's place before the junction, and its way over its own route.

    It keeps to the junction's arms, which the run's road has; one that joins the VUT's route goes
    on along that.

    Raises:
        CannotPlace: its arm is too short, or it leaves the frame of the VUT's route.
    """
    start = passage.start_s_m - line_distance_m - size.front_m
    within_block(other, size, start, "the vehicle that waits")
    arm_start_m, arm_end_m = passage.arms_s_m
    if start - size.rear_m < arm_start_m:
        raise CannotPlace(
            f"the vehicle that waits needs {passage.start_s_m - start + size.rear_m:.1f} m of its "
            f"arm, which is {passage.start_s_m - arm_start_m:.1f} m long"
        )
    end = min(passage.end_s_m + beyond_m, end_of(other, size))
    if not joins:
        end = min(end, arm_end_m - size.front_m - END_MARGIN_M)
    if end <= passage.end_s_m:
        short_m = passage.end_s_m - end
        raise CannotPlace(f"the road beyond the junction is {short_m:.1f} m too short for it")
    stations = np.linspace(start, end, max(2, math.ceil((end - start) / _STEP_M) + 1))
    if other.line.is_straight:
        stations = stations[[0, -1]]
    local = block.line.to_local_many(other.line.to_map_many(stations, 0.0))
    if not np.isfinite(local).all():
        raise CannotPlace("the VUT's route bends too much for a way across it")
    places = tuple(BlockPoint(round(s, 3), round(y, 3)) for s, y in local.tolist())
    yaw = other.line.pose(start).yaw_rad - block.line.pose(places[0].s_m).yaw_rad
    return Wait(places[0], wrap_angle(yaw)), places[1:]


def _draft(
    setting: Setting,
    crossing: Crossing,
    route_motion: RouteMotion,
    way_from: Callable[[float], tuple[Wait, tuple[BlockPoint, ...]]],
    ends: Callable[[], tuple[float, float]],
    meets: Callable[[float], _Met],
    values: Mapping[str, float],
) -> Draft:
    """Return the plan of some values, with the vehicle's way and the zone's ends as they allow."""
    event, block = setting.event, setting.block
    name = event.interaction.initiator
    conflict = crossing[0]
    vut, vehicle = size_of(event, event.vut_id), size_of(event, name)
    v, below = values["vut_speed"], values["below"]
    rate = approach_acceleration(event, event.vut_id, setting.limits)
    waits, way = way_from(values["line_distance"])
    near_s = conflict.s_m - corridor_half_m(vehicle.width_m)
    if not is_crossing(waits.heading_rad):
        comes = abs(waits.heading_rad) > AGAINST_RAD
        near_s = waits.start.s_m - (vehicle.front_m if comes else vehicle.rear_m)
    anchor_s = near_s if conflict.kind == "merge" else conflict.s_m
    start = _vut_start(setting, v, below, anchor_s)
    gap = station_of(block, start.s_m, near_s, 0.0) - vut.front_m
    choices = {name: fixed(event, f"participants.{name}.region.gap", "m", gap, "as cruise needs")}
    return Draft(
        vut=Drive(
            start,
            v,
            end_of(block, vut),
            rate,
            _VUT_BRAKING_MPS2,
            gives_way=_gives_way(
                setting, crossing, route_motion, ends, meets, start, values.get("critical_gap")
            ),
        ),
        targets={name: waits},
        trigger=Trigger(
            object_id=name,
            quantity="time_to_arrival",
            below=below,
            anchor=BlockPoint(anchor_s, 0.0),
            act=Cross(
                goal=way[-1],
                speed_mps=values["speed"],
                acceleration_mps2=values["acceleration"],
                via=way[:-1],
            ),
            not_before_s=round(0.5 * (cruise_reached_s(v, rate) + HOLD_S), 1),
        ),
        choices=choice_entries(choices, {name: gap}),
    )


def _gives_way(
    setting: Setting,
    crossing: Crossing,
    route_motion: RouteMotion,
    ends: Callable[[], tuple[float, float]],
    meets: Callable[[float], _Met],
    start: BlockPoint,
    critical_gap_s: float | None,
) -> GiveWay | None:
    """Return the place at which the VUT lets the vehicle pass; None where nothing is said of it.

    Raises:
        CannotPlace: the vehicle doesn't cross the VUT's corridor, or already does where it starts.
    """
    if critical_gap_s is None:
        return None
    block, conflict = setting.block, crossing[0]
    near_s, far_s = ends()
    zone = tuple(round(station_of(block, start.s_m, s, 0.0), 3) for s in (near_s, far_s))
    line_m = round(zone[0] - route_motion.before_zone_m, 3)
    if line_m < 0.0:
        raise CannotPlace(
            f"the VUT would wait {-line_m:.1f} m before its start, where the vehicle's corridor "
            "crosses its own; it needs more road up to the junction"
        )
    path, swept = meets(start.s_m)
    if swept is None:
        raise CannotPlace("the VUT's way doesn't cross the vehicle's corridor")
    if swept[0] < 0.0:
        raise CannotPlace(
            f"the vehicle's route begins {-swept[0]:.1f} m after the VUT's way crosses it; it "
            "needs more road up to the junction"
        )
    last_m = swept[1]
    if not _across_rad(conflict):
        last_m = min(last_m, conflict.other_s_m + _FOLLOWED_M)
    return GiveWay(
        line_m=line_m,
        zone_m=(zone[0], zone[1]),
        priority_path=path,
        priority_zone_m=(round(swept[0], 3), round(last_m, 3)),
        critical_gap_s=critical_gap_s,
    )


def _met_on_way(setting: Setting, crossing: Crossing, start_s_m: float) -> _Met:
    """Return the vehicle's path, and the stations between which the VUT's way covers its corridor.

    Args:
        setting: event and block.
        crossing: of the vehicle's route.
        start_s_m: arc length at which the VUT starts.
    """
    event, block, (conflict, other, _) = setting.event, setting.block, crossing
    path = other.line.path(0.0, other.length_m, 0.0)
    vut, vehicle = (size_of(event, who) for who in (event.vut_id, event.interaction.initiator))
    own = _passage(block)
    stations = np.arange(start_s_m, block.length_m, 0.25 * _STEP_M)
    # Beyond it the VUT may cross the straights on which a corridor goes on past both ends.
    here = (stations >= own.start_s_m) & (stations <= own.end_s_m)
    way = block.line.poses(stations[here].tolist())
    half = corridor_half_m(vehicle.width_m)
    return path, swept_on_way(way, vut, Polyline(path), half, _across_rad(conflict))


def _thresholds(
    setting: Setting,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    ahead_s: float,
) -> list[Choice]:
    """Return the choices of ``below`` that are searched, one after the other.

    The first one begins with the least value at which the vehicle is there before a VUT that
    doesn't react: so near to its own arrival a VUT that keeps its speed meets the vehicle, and
    doesn't pass behind it. It is computed for the first values that can be placed. Where these
    aren't the preferred ones, room is scarce, and the choice as K* gives it comes second.
    """
    event, as_it_is = setting.event, choices["below"]
    for values in islice(combinations(choices), MOST_DRAFTED):
        try:
            first_draft = draft(values)
        except CannotPlace:
            continue
        break
    else:
        return [as_it_is]
    plan_motions = motions(
        setting.block.line,
        classes_of(event),
        event.vut_id,
        first_draft.vut,
        first_draft.targets,
        first_draft.trigger,
    )
    steady = plan_motions.driver.model_copy(update={"reacts": False})
    prediction = predict(replace(plan_motions, driver=steady), "lateral", thresholds_of(event))
    least_s = round(
        values["below"] - (prediction.vut_arrival_s - prediction.overlap_s) + ahead_s, 2
    )
    if not math.isfinite(least_s):
        return [as_it_is]
    first = choose(event, _BELOW, "s", {_BELOW: least_s})
    why = f"it is there {ahead_s:g} s before a VUT that keeps its speed"
    if first.values[0] != least_s:
        why = f"the end of K*'s interval; with {least_s:g} s {why}"
    preferred = all(values[name] == choice.values[0] for name, choice in choices.items())
    return [replace(first, why=why), *([] if preferred else [as_it_is])]


def plans_with(
    setting: Setting, crossings: Sequence[Crossing], route_motion: RouteMotion
) -> Iterator[Plan]:
    """Yield the plans in which the vehicle comes over the first route of these that it can.

    Args:
        setting: event, block and limits.
        crossings: the routes that it may come over, where they cross the block.
        route_motion: of the vehicle over its route.

    Raises:
        CannotPlace: there is none.
    """
    event, block = setting.event, setting.block
    if block.lanes.index(next(x for x in block.lanes if x.y_m == 0.0)) not in [
        block.lanes.index(block.forward_lanes[i]) for i in vut_lane_indices(event, block)
    ]:
        lane_words = " or ".join(event.topology.vut_lane.words)
        raise CannotPlace(f"it goes on from a lane that is not the {lane_words} one")
    refused: list[CannotPlace] = []
    for crossing in crossings:
        try:
            yield from _plans_over(setting, crossing, route_motion)
        except CannotPlace as error:
            refused.append(error)
    if len(refused) == len(crossings):
        raise refused[0]


def _plans_over(setting: Setting, crossing: Crossing, route_motion: RouteMotion) -> Iterator[Plan]:
    """Yield the plans in which the vehicle comes over one route.

    Raises:
        CannotPlace: there is none.
    """
    event, block, limits = setting.event, setting.block, setting.limits
    name, vut = event.interaction.initiator, event.vut_id
    conflict, other, passage = crossing
    pick = partial(choose, event, preferred=setting.preferred)
    _, most = speed_bounds(event, name, ("trigger", "conflict", "resolution"))
    c = "constraints"
    approach, crossing_speed = f"{c}.speeds.{vut}.approach", f"{c}.manoeuvre.{route_motion.speed}"
    below = pick(_BELOW, "s")
    vut_speed = pick(approach, "m/s", at_most=vehicle_speed_limit(event, limits, block))
    needed_m = _approach_m(setting, max(vut_speed.values), max(below.values))
    from_m = conflict.s_m - needed_m - size_of(event, vut).length_m
    fastest = _speed_limit(setting, block, (from_m, block.length_m), approach, "the VUT")
    hardest = BODY_MPS2[event.participants[name].class_][0]
    line_distance = pick(f"{c}.manoeuvre.line_distance", "m")
    from_m = passage.start_s_m - max(line_distance.values) - size_of(event, name).front_m
    way_m = (from_m, passage.end_s_m + route_motion.beyond_m)
    crossing_mps = _speed_limit(setting, other, way_m, crossing_speed, "the vehicle")
    choices = {
        "vut_speed": pick(approach, "m/s", at_most=fastest),
        "below": below,
        "speed": pick(crossing_speed, "m/s", at_most=min(most, crossing_mps)),
        "line_distance": line_distance,
        "acceleration": pick(
            f"{c}.manoeuvre.acceleration",
            "m/s^2",
            at_most=min(hardest, acceleration_limit(event, limits)),
        ),
    }
    if route_motion.has_priority:
        choices["critical_gap"] = pick(f"{c}.manoeuvre.critical_gap", "s")
    size, beyond_m = size_of(event, name), route_motion.beyond_m

    # Neither depends on most of the values.
    @cache
    def way_from(line_distance_m: float) -> tuple[Wait, tuple[BlockPoint, ...]]:
        joins = conflict.kind == "merge"
        return _way(block, other, passage, size, line_distance_m, beyond_m, joins=joins)

    ends = cache(partial(_zone, setting, crossing))
    meets = cache(partial(_met_on_way, setting, crossing))
    draft = partial(_draft, setting, crossing, route_motion, way_from, ends, meets)
    thresholds = [below]
    if _BELOW not in setting.preferred:
        thresholds = _thresholds(setting, choices, draft, route_motion.ahead_s)

    def plans(threshold: Choice) -> Iterator[Plan]:
        tried = {**choices, "below": threshold}
        if conflict.kind == "merge":
            # It comes to stay, and goes on as fast as it came.
            yield from plans_in_lane(
                setting, "lateral", tried, draft, lambda *_: route_motion.beyond_m
            )
            return
        half = corridor_half_m(size_of(event, vut).width_m)
        near_s, far_s = ends()
        corners = rectangle(near_s, far_s, -half, half)
        for plan in plans_on(setting, "lateral", tried, draft, lambda *_: corners):
            # One that has priority doesn't drive by what the VUT does.
            gap_s = None if route_motion.has_priority else plan.gap_s
            place = BlockPoint(corners[0].s_m, plan.conflict.l_m)
            yield replace(plan, conflict=place, gap_s=gap_s)

    refused: list[CannotPlace] = []
    for threshold in thresholds:
        try:
            yield from plans(threshold)
        except CannotPlace as error:
            refused.append(error)
    if len(refused) == len(thresholds):
        raise refused[-1]


def _across_rad(conflict: Conflict) -> float:
    """Return the angle from which on vehicle and VUT are in each other's way; 0 in one lane."""
    return ALONG_RAD if abs(conflict.angle_rad) > ALONG_RAD else 0.0


def _zone(setting: Setting, crossing: Crossing) -> tuple[float, float]:
    """Return the arc lengths between which both swept corridors cross (METHOD 1)."""
    event, block, (conflict, other, passage) = setting.event, setting.block, crossing
    size = size_of(event, event.interaction.initiator)
    half = corridor_half_m(size_of(event, event.vut_id).width_m)
    if max(abs(passage.turn_rad), abs(_passage(block).turn_rad)) < STRAIGHT_ON_RAD:
        along = corridor_half_m(size.width_m) / abs(math.sin(conflict.angle_rad))
        along += half / abs(math.tan(conflict.angle_rad))
        return conflict.s_m - along, conflict.s_m + along
    last = min(passage.end_s_m + _BEYOND_M, other.length_m)
    stations = np.arange(passage.start_s_m, last, 0.25 * _STEP_M)
    path = Polyline(block.line.path(0.0, block.length_m, 0.0))
    swept = swept_on_way(
        map(other.line.pose, stations.tolist()), size, path, half, _across_rad(conflict)
    )
    if swept is None:
        raise CannotPlace("the vehicle's way doesn't cross the VUT's corridor")
    near, far = (ahead_of(block, 0.0, station, 0.0) for station in swept)
    return near, far
