"""A vehicle of the next lane cuts in ahead of the VUT (relation merge)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from ssp_core.run_file.participants import LaneChange
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Drive,
    Kind,
    Plan,
    Setting,
    Trigger,
)
from ssp_scenario_manager.scenarios.block_places import (
    ahead_of,
    end_of,
    entry_m,
    neighbour,
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.motions import (
    HOLD_S,
    LEAST_HOLD_S,
    cruise_reached_s,
    driver_travel,
    reference_travel,
)
from ssp_scenario_manager.scenarios.planning import Draft, plans_in_lane
from ssp_scenario_manager.scenarios.prediction import Prediction
from ssp_scenario_manager.scenarios.values import (
    Choice,
    acceleration_limit,
    approach_acceleration,
    choice_entries,
    choose,
    fixed,
    quantity_at,
    size_of,
    speed_bounds,
    vehicle_speed_limit,
)

_VUT_BRAKING_MPS2 = 2.5
_LEAST_CLOSING_MPS = 0.5


def _manoeuvres(event: Event) -> frozenset[str]:
    from_left = event.interaction.dominant_motion == "cutting_in_from_left"
    return frozenset({"keep_lane", "lane_change_right" if from_left else "lane_change_left"})


def _lanes(event: Event, block: Block) -> tuple[BlockLane, BlockLane]:
    """Return the VUT's lane and the initiator's."""
    from_left = event.interaction.dominant_motion == "cutting_in_from_left"
    refused: CannotPlace | None = None
    for index in vut_lane_indices(event, block):
        try:
            return block.forward_lanes[index], neighbour(block, index, from_left)
        except CannotPlace as error:
            refused = refused or error
    raise refused or CannotPlace("it has no lane for the VUT")


def _start_gap(event: Event, closing_mps: float, wanted_m: float) -> float:
    """Return the gap at standstill: as wanted, or as near to it as K* allows.

    Raises:
        CannotPlace: then VUT and initiator aren't both at cruise speed before the trigger.
    """
    gap_quantity = quantity_at(event, f"participants.{event.interaction.initiator}.region.gap")
    if not isinstance(gap_quantity, Interval):
        return wanted_m
    gap = gap_quantity.si.nearest(wanted_m)
    hold = HOLD_S + (gap - wanted_m) / closing_mps
    if hold < LEAST_HOLD_S:
        raise CannotPlace(
            f"a gap of {gap:.1f} m at the start closes before both are at cruise speed; "
            f"{wanted_m:.1f} m would do"
        )
    return gap


def draft(setting: Setting, values: Mapping[str, float]) -> Draft:
    """Return a plan of these values.

    Raises:
        CannotPlace: they don't fit the block.
    """
    event, block, limits = setting.event, setting.block, setting.limits
    name = event.interaction.initiator
    lane, beside = _lanes(event, block)
    vut, other = size_of(event, event.vut_id), size_of(event, name)
    v, u, below = values["vut_speed"], values["speed"], values["below"]
    if v - u < _LEAST_CLOSING_MPS:
        raise CannotPlace(f"the VUT at {v:g} m/s doesn't close in on a car at {u:g} m/s")
    a, b = (approach_acceleration(event, who, limits) for who in (event.vut_id, name))
    fires_s = cruise_reached_s(v, a) + HOLD_S
    driven, _ = driver_travel(v, a, fires_s)
    covered = reference_travel(u, b, fires_s)
    gap = _start_gap(event, v - u, below + driven - covered)
    start = BlockPoint(entry_m(block), lane.y_m)
    ahead = vut.front_m + gap + other.rear_m
    s = within_block(block, other, ahead_of(block, start.s_m, ahead, lane.y_m), name)
    field = f"participants.{name}.region.gap"
    at_start = {"gap": fixed(event, field, "m", gap, "closes after both are at cruise speed")}
    return Draft(
        vut=Drive(start, v, end_of(block, vut), a, _VUT_BRAKING_MPS2),
        targets={name: Drive(BlockPoint(round(s, 3), beside.y_m), u, end_of(block, other), b)},
        trigger=Trigger(
            object_id=name,
            quantity="relative_distance",
            below=below,
            anchor=None,
            act=LaneChange(
                kind="lane_change",
                lateral_shift_m=lane.y_m - beside.y_m,
                duration_s=values["duration"],
                cruise_mps=values["end_speed"],
                deceleration_mps2=values["deceleration"],
            ),
            not_before_s=round(0.5 * fires_s, 1),
        ),
        choices=choice_entries(at_start, {"gap": gap}),
    )


def choices(setting: Setting) -> dict[str, Choice]:
    """Return the values of each quantity, in the order in which they are tried.

    Raises:
        CannotPlace: one has none, or the road lacks a lane.
    """
    event, limits = setting.event, setting.limits
    name, vut = event.interaction.initiator, event.vut_id
    _lanes(event, setting.block)
    pick = partial(choose, event, preferred=setting.preferred)
    fastest = vehicle_speed_limit(event, limits, setting.block)
    hardest = acceleration_limit(event, limits)
    least, most = speed_bounds(event, name, ("conflict", "resolution"))
    c = "constraints"
    return {
        "vut_speed": pick(f"{c}.speeds.{vut}.approach", "m/s", at_most=fastest),
        "speed": pick(f"{c}.speeds.{name}.approach", "m/s", at_most=fastest),
        "below": pick(f"{c}.trigger.below", "m"),
        "duration": pick(f"{c}.manoeuvre.duration", "s"),
        "end_speed": pick(
            f"{c}.manoeuvre.end_speed", "m/s", at_most=min(fastest, most), at_least=least
        ),
        "deceleration": pick(f"{c}.manoeuvre.deceleration", "m/s^2", at_most=hardest),
    }


def reach(trial_draft: Draft, prediction: Prediction) -> float:
    """Return how far the initiator drives while it comes over, m."""
    act = trial_draft.trigger.act
    return prediction.initiator_fired_mps * act.duration_s if isinstance(act, LaneChange) else 0.0


def _plans(setting: Setting) -> Iterator[Plan]:
    return plans_in_lane(
        setting, CUT_IN.observable, choices(setting), partial(draft, setting), reach
    )


CUT_IN = Kind(
    name="cut_in",
    relation="merge",
    zone="vut_lane",
    observable="lateral",
    dominant_motions=frozenset({"cutting_in_from_left", "cutting_in_from_right"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={
        "cutting_in_from_left": frozenset({"left_lane"}),
        "cutting_in_from_right": frozenset({"right_lane"}),
    },
    first="initiator",
    manoeuvre={"duration": "s", "end_speed": "m/s", "deceleration": "m/s^2"},
    trigger_quantities=frozenset({"relative_distance"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=2,
    manoeuvres=_manoeuvres,
    plans=_plans,
)
