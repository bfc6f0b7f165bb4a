"""Somebody crosses ahead of the VUT, in the open or from behind an occluder (relation crossing)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import Camera
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Kind,
    Plan,
    Setting,
    Trigger,
    Wait,
)
from ssp_scenario_manager.scenarios.block_places import (
    ahead_of,
    end_of,
    entry_m,
    left_kerb_m,
    parked_m,
    rectangle,
    right_kerb_m,
    station_of,
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.motions import (
    HOLD_S,
    LEAST_HOLD_S,
    Motions,
    cruise_reached_s,
    driver_travel,
)
from ssp_scenario_manager.scenarios.planning import Draft, plans_on
from ssp_scenario_manager.scenarios.prediction import Prediction
from ssp_scenario_manager.scenarios.values import (
    Choice,
    acceleration_limit,
    approach_acceleration,
    choice_entries,
    choose,
    fixed,
    size_of,
    speed_bounds,
    vehicle_speed_limit,
)


def is_hidden(vut: ObjectState, subject: ObjectState, occluder: ObjectState, eye_m: float) -> bool:
    """Tell whether an occluder hides an object from a place on the VUT's centre line, wholly.

    Args:
        vut: that looks.
        subject: the object.
        occluder: what may hide it.
        eye_m: the camera's place ahead of the VUT's reference point, m.
    """
    eye = vut.pose.to_parent(eye_m, 0.0)
    corners = occluder.box.corners()
    sides = [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return all(any(_cross(eye, point, a, b) for a, b in sides) for point in subject.box.corners())


def _cross(
    p: tuple[float, float],
    q: tuple[float, float],
    a: tuple[float, float],
    b: tuple[float, float],
) -> bool:
    """Tell whether two segments cross."""

    def side(u: tuple[float, float], v: tuple[float, float], w: tuple[float, float]) -> float:
        return (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])

    return side(p, q, a) * side(p, q, b) < 0.0 and side(a, b, p) * side(a, b, q) < 0.0


_VUT_BRAKING_MPS2 = 3.0
# At a marked crossing, the VUT may be seen at cruise speed for this long before the trigger.
_LONGEST_HOLD_S = 4.0
# How far beyond the other kerb a crossing ends.
_BEYOND_M = 1.0
_LEAST_BEYOND_M = 0.3
# Beyond the reach of a marked crossing, for whoever crosses away from it.
_OFF_MARKING_M = 0.5


@dataclass(frozen=True, slots=True)
class _Along:
    """The VUT's start and the crossing of its path, arc lengths in m."""

    start_s_m: float
    crossing_s_m: float
    fires_s: float


def _from_right(event: Event) -> bool:
    return event.interaction.dominant_motion == "crossing_from_right"


def _across(event: Event, block: Block, kerb_m: float) -> tuple[float, float]:
    """Return offsets of start and goal."""
    right, left = right_kerb_m(block), left_kerb_m(block)
    beyond_right = min(_BEYOND_M, max(block.sidewalk_right_m, _LEAST_BEYOND_M))
    beyond_left = min(_BEYOND_M, max(block.sidewalk_left_m, _LEAST_BEYOND_M))
    if _from_right(event):
        return right - kerb_m, left + beyond_left
    return left + kerb_m, right - beyond_right


def _along(
    block: Block,
    vut: Size,
    lane_m: float,
    speed_mps: float,
    rate: float,
    below_s: float,
    hidden_m: float | None,
) -> _Along:
    """Choose a marked crossing if there is one and the VUT has the room, else the earliest place.

    Args:
        block: in which the VUT drives.
        vut: its size.
        lane_m: offset of its lane.
        speed_mps: its cruising speed.
        rate: its acceleration, m/s².
        below_s: time to arrival at which the trigger fires.
        hidden_m: None: the place may be marked; else it lies away from every marking, and so does
            what hides it, which stands on so much of the road before it.
    """
    reached = cruise_reached_s(speed_mps, rate)
    entry = entry_m(block)

    def needed(hold_s: float) -> float:
        driven, _ = driver_travel(speed_mps, rate, reached + hold_s)
        return vut.front_m + driven + speed_mps * below_s

    for marked in block.crossings_s_m if hidden_m is None else ():
        room = station_of(block, entry, marked, lane_m)
        if needed(LEAST_HOLD_S) <= room <= needed(_LONGEST_HOLD_S):
            hold = LEAST_HOLD_S
            hold += (room - needed(LEAST_HOLD_S)) / speed_mps
            return _Along(entry, marked, reached + hold)
        for hold in (HOLD_S, LEAST_HOLD_S):
            start = ahead_of(block, marked, -needed(hold), lane_m)
            if start >= vut.rear_m + 1.0:
                return _Along(round(start, 3), marked, reached + hold)
    crossing = round(ahead_of(block, entry, needed(HOLD_S), lane_m), 3)
    clear = crossing if hidden_m is None else _clear_of(block.crossings, crossing, hidden_m)
    if clear == crossing:
        return _Along(entry, crossing, reached + HOLD_S)
    start = ahead_of(block, clear, -needed(HOLD_S), lane_m)
    return _Along(round(start, 3), clear, reached + HOLD_S)


def _clear_of(crossings: Sequence[Crossing], s_m: float, behind_m: float) -> float:
    """Return the first arc length from one on that is out of reach of every zebra, m.

    Args:
        crossings: the zebras.
        s_m: where the search begins.
        behind_m: length of a stretch before it that has no zebra on it either.
    """
    for zebra in sorted(crossings, key=lambda zebra: zebra.s_m - zebra.reach_m):
        before = zebra.s_m - zebra.reach_m - _OFF_MARKING_M
        beyond = zebra.s_m + max(zebra.reach_m, zebra.half_m + behind_m) + _OFF_MARKING_M
        if before < s_m < beyond:
            s_m = round(beyond, 3)
    return s_m


def _gap(block: Block, start_s_m: float, front_m: float, near_s_m: float, lane_m: float) -> float:
    """Return the bumper gap along the VUT's path, m."""
    return station_of(block, start_s_m, near_s_m, lane_m) - front_m


def _draft(setting: Setting, values: Mapping[str, float]) -> Draft:
    event, block = setting.event, setting.block
    name, vut_id = event.interaction.initiator, event.vut_id
    lane = block.forward_lanes[vut_lane_indices(event, block)[0]]
    vut, walker = size_of(event, vut_id), size_of(event, name)
    v, below = values["vut_speed"], values["below"]
    rate = approach_acceleration(event, vut_id, setting.limits)
    occluder = event.interaction.occluder
    half = walker.width_m / 2.0
    hidden = None
    if occluder is not None:
        parked = size_of(event, occluder)
        hidden = half + values["occluder_gap"] + parked.front_m + parked.rear_m
    along = _along(block, vut, lane.y_m, v, rate, below, hidden)
    s = along.crossing_s_m
    if s + ROOM_BEYOND_M > block.length_m:
        raise CannotPlace(
            f"the VUT's path would be crossed at s = {s:.0f} m; the block is "
            f"{block.length_m:.0f} m long and {ROOM_BEYOND_M:g} m are needed beyond"
        )
    from_l, to_l = (round(y, 3) for y in _across(event, block, values["kerb_distance"]))
    turn = math.copysign(math.pi / 2.0, to_l - from_l)
    gap = _gap(block, along.start_s_m, vut.front_m, s - half, lane.y_m)
    choices = {name: fixed(event, f"participants.{name}.region.gap", "m", gap, "as cruise needs")}
    gaps = {name: gap}
    targets: dict[str, Drive | Wait] = {name: Wait(BlockPoint(s, from_l), turn)}
    extra = None
    if occluder is not None:
        size = size_of(event, occluder)
        place = _parked(event, block, size, s - half - values["occluder_gap"], lane.y_m)
        within_block(block, size, place.s_m, occluder)
        targets[occluder] = Wait(place)
        gaps[occluder] = _gap(
            block, along.start_s_m, vut.front_m, place.s_m - size.rear_m, lane.y_m
        )
        field = f"participants.{occluder}.region.gap"
        choices[occluder] = fixed(event, field, "m", gaps[occluder], "hides who crosses")
        extra = partial(hidden_at_the_trigger, name, occluder)
    return Draft(
        vut=Drive(
            BlockPoint(along.start_s_m, lane.y_m), v, end_of(block, vut), rate, _VUT_BRAKING_MPS2
        ),
        targets=targets,
        trigger=Trigger(
            object_id=name,
            quantity="time_to_arrival",
            below=below,
            anchor=BlockPoint(s, lane.y_m),
            act=Cross(
                goal=BlockPoint(s, to_l),
                speed_mps=values["walking_speed"],
                acceleration_mps2=values["acceleration"],
            ),
            not_before_s=round(0.5 * along.fires_s, 1),
        ),
        extra=extra,
        choices=choice_entries(choices, gaps),
    )


# Room beyond the crossing, for the VUT to drive on once it is free.
ROOM_BEYOND_M = 20.0


def _parked(event: Event, block: Block, size: Size, front_s_m: float, lane_m: float) -> BlockPoint:
    """Return the occluder's reference point, at the edge on the side of the one who crosses.

    Raises:
        CannotPlace: it would stand in the VUT's corridor.
    """
    corridor = corridor_half_m(size_of(event, event.vut_id).width_m)
    y = parked_m(block, size, lane_m, corridor, right=_from_right(event))
    return BlockPoint(round(front_s_m - size.front_m, 3), round(y, 3))


def hidden_at_the_trigger(
    name: str, occluder: str, _: Motions, prediction: Prediction
) -> list[str]:
    """List the reasons why the occluder doesn't hide the crosser when the trigger fires."""
    states = {state.object_id: state for state in prediction.targets_fired}
    eye_m = Camera().forward_m
    if is_hidden(prediction.vut_fired, states[name], states[occluder], eye_m):
        return []

    def nearest_m(who: str) -> float:
        corners = states[who].box.corners()
        return min(abs(prediction.vut_fired.pose.to_local(*corner)[1]) for corner in corners)

    return [
        f"{occluder} doesn't hide {name} from the VUT when the trigger fires: {name} stands "
        f"{nearest_m(name):.2f} m beside the VUT's middle, {occluder} {nearest_m(occluder):.2f} m"
    ]


def crossing_manoeuvres(_event: Event) -> frozenset[str]:
    """Return the manoeuvres that the road must permit to be crossed."""
    return frozenset({"keep_lane", "crossing"})


def plans_crossing(setting: Setting) -> Iterator[Plan]:
    """Yield plans of crossings on a block, behind an occluder where K* names one.

    Raises:
        CannotPlace: it doesn't fit.
    """
    event, block, limits = setting.event, setting.block, setting.limits
    name, vut = event.interaction.initiator, event.vut_id
    pick = partial(choose, event, preferred=setting.preferred)
    _, most = speed_bounds(event, name, ("trigger", "conflict", "resolution"))
    least, _ = speed_bounds(event, name, ("conflict", "resolution"))
    c = "constraints"
    choices: dict[str, Choice] = {
        "vut_speed": pick(
            f"{c}.speeds.{vut}.approach", "m/s", at_most=vehicle_speed_limit(event, limits, block)
        ),
        "below": pick(f"{c}.trigger.below", "s"),
        "walking_speed": pick(
            f"{c}.manoeuvre.walking_speed",
            "m/s",
            at_most=min(most, limits.speed_mps),
            at_least=least,
        ),
        "kerb_distance": pick(f"{c}.manoeuvre.kerb_distance", "m"),
        "acceleration": pick(
            f"{c}.manoeuvre.acceleration", "m/s^2", at_most=acceleration_limit(event, limits)
        ),
    }
    if event.interaction.occluder is not None:
        choices["occluder_gap"] = pick(f"{c}.manoeuvre.occluder_gap", "m")
    half = corridor_half_m(size_of(event, vut).width_m)
    reach = corridor_half_m(size_of(event, name).width_m)

    def zone(draft: Draft, _seen: Prediction, _conflict: BlockPoint) -> tuple[BlockPoint, ...]:
        s = draft.targets[name].start.s_m
        y = draft.vut.start.l_m
        return rectangle(s - reach, s + reach, y - half, y + half)

    for plan in plans_on(setting, "lateral", choices, partial(_draft, setting), zone):
        # The zone is cut square to the reference line, and the conflict point is where it begins.
        yield replace(plan, conflict=BlockPoint(plan.zone[0].s_m, plan.conflict.l_m))


OCCLUDED_CROSSING = Kind(
    name="occluded_crossing",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_right"}),
    initiator_classes=frozenset({"pedestrian", "cyclist"}),
    initiator_places={"crossing_from_right": frozenset({"right_kerb"})},
    first="initiator",
    manoeuvre={
        "walking_speed": "m/s",
        "kerb_distance": "m",
        "acceleration": "m/s^2",
        "occluder_gap": "m",
    },
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=True,
    uses_arrival_gap=True,
    same_direction_lanes=1,
    manoeuvres=crossing_manoeuvres,
    plans=plans_crossing,
)


VRU_CROSSING = Kind(
    name="vru_crossing",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_left", "crossing_from_right"}),
    initiator_classes=frozenset({"pedestrian", "cyclist"}),
    initiator_places={
        "crossing_from_left": frozenset({"left_kerb"}),
        "crossing_from_right": frozenset({"right_kerb"}),
    },
    first="initiator",
    manoeuvre={"walking_speed": "m/s", "kerb_distance": "m", "acceleration": "m/s^2"},
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=True,
    same_direction_lanes=1,
    manoeuvres=crossing_manoeuvres,
    plans=plans_crossing,
)
