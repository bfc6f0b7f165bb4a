"""The vehicle ahead in the VUT's lane brakes abruptly (relation following)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from ssp_core.run_file.participants import Brake
from ssp_scenario_manager.event_spec.model import Event
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
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.motions import cruise_reached_s
from ssp_scenario_manager.scenarios.planning import Draft, plans_in_lane
from ssp_scenario_manager.scenarios.prediction import Prediction
from ssp_scenario_manager.scenarios.values import (
    acceleration_limit,
    approach_acceleration,
    choose,
    choose_headway,
    size_of,
    speed_bounds,
    vehicle_speed_limit,
)

_VUT_BRAKING_MPS2 = 2.5
# A driver who keeps the usual 1.4 s slows down behind the lead well before it brakes.
_HEADWAYS_S = (0.8, 1.1, 1.4)


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def _draft(setting: Setting, values: Mapping[str, float]) -> Draft:
    event, block, limits = setting.event, setting.block, setting.limits
    name = event.interaction.initiator
    lane = block.forward_lanes[vut_lane_indices(event, block)[0]]
    vut, other = size_of(event, event.vut_id), size_of(event, name)
    v, u = values["vut_speed"], values["speed"]
    if values["end_speed"] >= u:
        raise CannotPlace(f"braking to {values['end_speed']:g} m/s needs more than {u:g} m/s")
    if values["gap"] <= values["below"]:
        raise CannotPlace(
            f"the gap at the start, {values['gap']:g} m, is under the trigger's "
            f"{values['below']:g} m"
        )
    a, b = (approach_acceleration(event, who, limits) for who in (event.vut_id, name))
    start = BlockPoint(entry_m(block), lane.y_m)
    ahead = vut.front_m + values["gap"] + other.rear_m
    s = within_block(block, other, ahead_of(block, start.s_m, ahead, lane.y_m), name)
    return Draft(
        vut=Drive(start, v, end_of(block, vut), a, _VUT_BRAKING_MPS2, values["headway"]),
        targets={name: Drive(BlockPoint(round(s, 3), lane.y_m), u, end_of(block, other), b)},
        trigger=Trigger(
            object_id=name,
            quantity="relative_distance",
            below=values["below"],
            anchor=None,
            act=Brake(
                kind="brake",
                to_mps=values["end_speed"],
                deceleration_mps2=values["deceleration"],
            ),
            not_before_s=round(0.5 * cruise_reached_s(v, a), 1),
        ),
    )


def _plans(setting: Setting) -> Iterator[Plan]:
    event, limits = setting.event, setting.limits
    name, vut = event.interaction.initiator, event.vut_id
    pick = partial(choose, event, preferred=setting.preferred)
    fastest = vehicle_speed_limit(event, limits, setting.block)
    hardest = acceleration_limit(event, limits)
    least, most = speed_bounds(event, name, ("conflict", "resolution"))
    c = "constraints"
    choices = {
        "headway": choose_headway(setting.preferred, _HEADWAYS_S),
        "gap": pick(f"participants.{name}.region.gap", "m"),
        "vut_speed": pick(f"{c}.speeds.{vut}.approach", "m/s", at_most=fastest),
        "speed": pick(f"{c}.speeds.{name}.approach", "m/s", at_most=fastest),
        "below": pick(f"{c}.trigger.below", "m"),
        "deceleration": pick(f"{c}.manoeuvre.deceleration", "m/s^2", at_most=hardest),
        "end_speed": pick(
            f"{c}.manoeuvre.end_speed", "m/s", at_most=min(fastest, most), at_least=least
        ),
    }

    def reach(draft: Draft, prediction: Prediction) -> float:
        """Return how far it drives while it brakes."""
        act = draft.trigger.act
        if not isinstance(act, Brake):
            return 0.0
        spread = prediction.initiator_fired_mps**2 - act.to_mps**2
        return max(spread, 0.0) / (2.0 * act.deceleration_mps2)

    return plans_in_lane(setting, LEAD_BRAKING.observable, choices, partial(_draft, setting), reach)


LEAD_BRAKING = Kind(
    name="lead_braking",
    relation="following",
    zone="vut_lane",
    observable="braking",
    dominant_motions=frozenset({"same_direction"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={"same_direction": frozenset({"vut_lane"})},
    first="initiator",
    manoeuvre={"deceleration": "m/s^2", "end_speed": "m/s"},
    trigger_quantities=frozenset({"relative_distance"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
)
