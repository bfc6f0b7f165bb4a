"""What placing any kind needs: the VUT's lane and start, and the judgement of a plan."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ssp_core.geometry import Polyline
from ssp_core.interaction import Observable, corridor_half_m
from ssp_core.run_spec import ConflictThresholds, EndCondition, ObjectWord
from ssp_core.state import DEFAULT_SIZES, Size
from ssp_core.vocab import ObjectClass
from ssp_scenario_manager.interactions import kinematics
from ssp_scenario_manager.interactions.adapting import gap_before_response_s
from ssp_scenario_manager.interactions.base import (
    BlockPoint,
    CannotPlace,
    Drive,
    PlaceLimits,
    Plan,
    Trigger,
    Wait,
)
from ssp_scenario_manager.interactions.choosing import Choice, chosen, combinations, in_si, inside
from ssp_scenario_manager.interactions.kinematics import Foresight, foresee, stopping_m
from ssp_scenario_manager.interactions.motions import Motions, motions
from ssp_scenario_manager.spec.model import Event, Interval
from ssp_scenario_manager.topology.block import Block, BlockLane

# How far into a long and a short block the VUT starts.
_ENTRY_M = (15.0, 2.0)
_ENTRY_SHARE = 0.04
# Between what stands at a block's end and the end itself.
END_MARGIN_M = 2.0
# Plans that are followed to their end before a block is given up.
MOST_FORESEEN = 20
MOST_DRAFTED = 400
# Accelerations of an approach, m/s^2, for those who can't do the usual.
_APPROACH_MPS2 = {"truck": 1.2, "bus": 1.2, "cyclist": 1.2}
_USUAL_MPS2 = 2.0


@dataclass(frozen=True)
class Draft:
    """A plan before it was looked ahead.

    Args:
        vut: how the VUT drives.
        targets: what the OTs do.
        trigger: of the initiator.
        extra: further reasons against it, from what was foreseen; None where there are none.
        chosen: further fields that follow from the others, as Plan.chosen has them.
    """

    vut: Drive
    targets: Mapping[str, Drive | Wait]
    trigger: Trigger
    extra: Callable[[Motions, Foresight], list[str]] | None = None
    chosen: Mapping[str, tuple[float, str, str]] | None = None


def size_of(event: Event, name: str) -> Size:
    """Extent of a participant."""
    return DEFAULT_SIZES[ObjectClass.from_word(event.participants[name].class_)]


def classes_of(event: Event) -> dict[str, ObjectWord]:
    """Object classes by participants' ids."""
    return {name: who.class_ for name, who in event.participants.items()}


def thresholds_of(event: Event) -> ConflictThresholds:
    """When a conflict begins, by part C: the middle of what it gives."""

    def middle(interval: Interval | None) -> float | None:
        if interval is None:
            return None
        known = in_si(interval)
        sides = [side for side in (known.min, known.max) if side is not None]
        return sum(sides) / len(sides) if sides else None

    needs = event.constraints.thresholds
    return ConflictThresholds(ttc_s=middle(needs.ttc), arrival_gap_s=middle(needs.arrival_gap))


def vut_lane_indices(event: Event, block: Block) -> list[int]:
    """Indices into the block's forward lanes in which the VUT may drive, preferred first.

    Raises:
        CannotPlace: there is no such lane.
    """
    count = len(block.forward_lanes)
    word = event.topology.vut_lane
    indices = list(range(count))
    if word == "rightmost":
        indices = indices[:1]
    elif word == "leftmost":
        indices = indices[-1:]
    elif word == "middle":
        indices = indices[1:-1]
    if not indices:
        raise CannotPlace(f"of its {count} lane(s) in the VUT's direction none is the {word} one")
    return indices


def neighbour(block: Block, index: int, to_left: bool) -> BlockLane:
    """The lane beside a forward lane.

    Raises:
        CannotPlace: there is none in the same direction, or it isn't adjacent.
    """
    lanes = block.forward_lanes
    beside = index + (1 if to_left else -1)
    side = "left" if to_left else "right"
    if not 0 <= beside < len(lanes):
        raise CannotPlace(
            f"it has no driving lane to the {side} of the VUT's in its direction "
            f"({len(lanes)} driving lane(s) per direction)"
        )
    lane, other = lanes[index], lanes[beside]
    between = abs(other.y_m - lane.y_m) - (lane.width_m + other.width_m) / 2.0
    if between > 0.5:
        raise CannotPlace(f"its lane to the {side} lies {between:.1f} m apart from the VUT's")
    return other


def right_kerb_m(block: Block) -> float:
    """Offset of the right kerb, where the sidewalk or verge begins."""
    return block.right_edge_m - block.shoulder_right_m


def left_kerb_m(block: Block) -> float:
    """Offset of the left kerb."""
    return block.left_edge_m + block.shoulder_left_m


def station_of(block: Block, from_s_m: float, to_s_m: float, l_m: float) -> float:
    """Distance along an offset line from one arc length to another, m; negative backwards."""
    if block.line.is_straight or to_s_m == from_s_m:
        return to_s_m - from_s_m
    low, high = sorted((from_s_m, to_s_m))
    length = Polyline(block.line.path(low, high, l_m)).length_m
    return math.copysign(length, to_s_m - from_s_m)


def ahead_of(block: Block, from_s_m: float, distance_m: float, l_m: float) -> float:
    """Arc length of the place that lies a distance further along an offset line."""
    s = from_s_m + distance_m
    for _ in range(20):
        off = distance_m - station_of(block, from_s_m, s, l_m)
        s += off
        if abs(off) < 1e-4:
            break
    return s


def entry_m(block: Block) -> float:
    """How far into the block the VUT starts."""
    high, low = _ENTRY_M
    return min(high, max(low, _ENTRY_SHARE * block.length_m))


def approach_acceleration(event: Event, name: str, limits: PlaceLimits) -> float:
    """With which a participant gets to its cruise speed, m/s^2."""
    usual = _APPROACH_MPS2.get(event.participants[name].class_, _USUAL_MPS2)
    return min(usual, limits.acceleration_mps2)


def acceleration_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place and K* allow, m/s^2."""
    most = in_si(event.constraints.safety.acceleration).max
    return min(limits.acceleration_mps2, most if most is not None else math.inf)


def vehicle_speed_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place, road and K* allow, m/s."""
    most = in_si(event.constraints.safety.speed).max
    return min(limits.speed_mps, limits.speed_limit_mps, most if most is not None else math.inf)


def speed_bounds(event: Event, name: str, phases: tuple[str, ...]) -> tuple[float, float]:
    """Largest minimum and smallest maximum of a participant's speed over some phases, m/s."""
    known = event.constraints.speeds.get(name, {})
    found = [in_si(q) for phase, q in known.items() if phase in phases and isinstance(q, Interval)]
    return (
        max((q.min for q in found if q.min is not None), default=0.0),
        min((q.max for q in found if q.max is not None), default=math.inf),
    )


def within_block(block: Block, size: Size, s_m: float, who: str) -> float:
    """An arc length at which somebody who faces along the block fits on it.

    Raises:
        CannotPlace: it leaves the block.
    """
    low, high = size.rear_m, block.length_m - size.front_m
    if not low <= s_m <= high:
        raise CannotPlace(
            f"{who} would start at s = {s_m:.1f} m; {low:g} to {high:.1f} m fits on the block"
        )
    return s_m


def end_of(block: Block, size: Size) -> float:
    """Arc length at which a path along the block ends."""
    return block.length_m - size.front_m - END_MARGIN_M


def place_on(
    event: Event,
    block: Block,
    limits: PlaceLimits,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    zone: Callable[[Draft, Foresight, BlockPoint], tuple[BlockPoint, ...]],
) -> Plan:
    """The first plan, from the preferred values on, that goes as K* says.

    Args:
        event: K*.
        block: to place it on.
        limits: of the place.
        observable: of the kind.
        choices: quantities by name.
        draft: makes a plan of values; raises CannotPlace where they don't fit the block.
        zone: corners of the conflict zone, from plan, foresight and conflict point.

    Raises:
        CannotPlace: none does; the reason is that of the preferred values.
    """
    thresholds = thresholds_of(event)
    vut_id = event.vut_id
    first_reason, looked = "", 0
    for values in itertools.islice(combinations(choices), MOST_DRAFTED):
        try:
            made = draft(values)
            told = motions(
                block.line, classes_of(event), vut_id, made.vut, made.targets, made.trigger
            )
            looked += 1
            seen = foresee(told, observable, thresholds)
            reasons = judge(event, limits, told, seen)
            if made.extra is not None:
                reasons += made.extra(told, seen)
        except CannotPlace as error:
            reasons = [str(error)]
            made = None
        if made is not None and not reasons:
            conflict = _on_block(block, made.vut, seen.conflict_station_m)
            return Plan(
                vut=made.vut,
                targets=made.targets,
                trigger=made.trigger,
                conflict=conflict,
                zone=zone(made, seen, conflict),
                expected=_on_block(block, made.vut, seen.fired_station_m),
                chosen={**chosen(choices, values), **(made.chosen or {})},
                gap_s=gap_before_response_s(told, seen, initiator_first=initiator_first(event)),
            )
        first_reason = first_reason or "; ".join(reasons)
        if looked >= MOST_FORESEEN:
            break
    raise CannotPlace(first_reason)


def place_in_lane(
    event: Event,
    block: Block,
    limits: PlaceLimits,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    reach: Callable[[Draft, Foresight], float],
) -> Plan:
    """As ``place_on``, for an initiator that takes a part of the VUT's lane.

    The zone begins at the conflict point, where the initiator's rear is when it comes into the
    VUT's way, and ends where its front is when it has done what it does.

    Args:
        reach: how far it drives meanwhile, m; the others as for ``place_on``.
    """
    half = corridor_half_m(size_of(event, event.vut_id).width_m)
    length = size_of(event, event.interaction.initiator).length_m

    def zone(made: Draft, seen: Foresight, conflict: BlockPoint) -> tuple[BlockPoint, ...]:
        s, y = conflict.s_m, conflict.l_m
        end = min(s + length + reach(made, seen), block.length_m)
        return rectangle(block, s, end, y - half, y + half)

    return place_on(event, block, limits, observable, choices, draft, zone)


def _on_block(block: Block, vut: Drive, station_m: float) -> BlockPoint:
    s = ahead_of(block, vut.start.s_m, station_m, vut.start.l_m)
    return BlockPoint(round(s, 3), vut.start.l_m)


def judge(event: Event, limits: PlaceLimits, told: Motions, seen: Foresight) -> list[str]:
    """What is wrong with a plan that was looked ahead; empty: it goes as K* says."""
    c = event.constraints
    wrong = []
    if seen.early_conflict:
        wrong.append("the conflict begins before the trigger")
    if seen.trigger_s is None:
        wrong.append("the manoeuvre never becomes observable")
    if seen.conflict_s is None:
        wrong.append("no conflict comes: TTC and arrival gap stay above their thresholds")
    elif seen.trigger_s is not None and seen.conflict_s < seen.trigger_s:
        wrong.append("the conflict begins before the trigger can be seen")
    if seen.resolution_s is None and seen.conflict_s is not None:
        wrong.append("the conflict isn't resolved")
    wrong += _wrong_order(event, seen)
    low, high = speed_bounds(event, event.vut_id, ("approach", "trigger"))
    # A driver nears its cruise speed slowly.
    if not low * kinematics.CRUISE_SHARE <= seen.fired_speed_mps <= high + 1e-9:
        wrong.append(
            f"the VUT would drive {seen.fired_speed_mps:.1f} m/s at the trigger, K* wants "
            f"{low:g} to {high:g} m/s"
        )
    least = max(limits.separation_m, in_si(c.safety.separation).min or 0.0)
    if seen.separation_m <= least:
        wrong.append(f"VUT and target come within {seen.separation_m:.2f} m, limit is {least:g} m")
    path = Polyline(told.vut.approach.path) if told.vut.approach is not None else None
    needed = seen.vut_station_end_m + stopping_m(
        seen.vut_end_mps, told.driver.comfortable_deceleration_mps2
    )
    if path is not None and needed > path.length_m:
        wrong.append(
            f"the VUT needs {needed:.0f} m from its start to the run's end and to a stop, the "
            f"block leaves it {path.length_m:.0f} m"
        )
    most = in_si(c.safety.duration).max
    end = EndCondition()
    longest = end.at_latest_s if most is None else min(most, end.at_latest_s)
    ends = (seen.resolution_s or 0.0) + end.after_resolution_s
    if ends > longest:
        wrong.append(f"the run takes {ends:.0f} s, limit is {longest:g} s")
    return wrong


def initiator_first(event: Event) -> bool:
    """The passing order of K*."""
    return event.interaction.passing_order[0] == event.interaction.initiator


def _wrong_order(event: Event, seen: Foresight) -> list[str]:
    if initiator_first(event) != seen.initiator_first:
        return [f"{event.interaction.passing_order[0]} wouldn't reach the conflict point first"]
    gap = event.constraints.time_gap
    if not isinstance(gap, Interval) or math.isinf(seen.vut_arrival_s):
        return []
    gap = in_si(gap)
    if not inside(gap, seen.time_gap_s):
        return [
            f"the time gap at the conflict point would be {seen.time_gap_s:.2f} s, K* wants "
            f"{gap.min} to {gap.max} s"
        ]
    return []


def rectangle(
    block: Block, from_s_m: float, to_s_m: float, from_l_m: float, to_l_m: float
) -> tuple[BlockPoint, ...]:
    """Corners of a stretch of the block, counter-clockwise."""
    low, high = round(from_s_m, 3), round(to_s_m, 3)
    right, left = round(from_l_m, 3), round(to_l_m, 3)
    return (
        BlockPoint(low, right),
        BlockPoint(high, right),
        BlockPoint(high, left),
        BlockPoint(low, left),
    )
