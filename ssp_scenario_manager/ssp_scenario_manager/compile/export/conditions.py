"""Triggers of a task as OpenSCENARIO conditions.

| ours                                     | OpenSCENARIO 1.0                                      |
|------------------------------------------|-------------------------------------------------------|
| relative_distance: bumper gap from the   | RelativeDistanceCondition, longitudinal, freespace,   |
| VUT to the object below ``below_m``      | lessThan; triggering entity: the VUT                  |
| time_to_arrival: VUT's front at the      | TimeToCollisionCondition to a position, lessThan; the |
| anchor in less than ``below_s``          | position is the anchor less the VUT's front overhang, |
|                                          | since a position is compared with reference points    |
| time_headway                             | TimeHeadwayCondition, freespace, lessThan; triggering |
|                                          | entity: the VUT                                       |
| time_to_collision                        | TimeToCollisionCondition to the entity, freespace     |
| speed                                    | SpeedCondition of that entity                         |
| elapsed_time                             | SimulationTimeCondition                               |
| all, any                                 | ConditionGroups: any of groups, of whose conditions   |
|                                          | all must hold                                         |
| edge                                     | conditionEdge, where the condition is a single one:   |
|                                          | the edge of a group can't be asked                    |
| not_before_s                             | SimulationTimeCondition that starts the act, before   |
|                                          | which no event of it is looked at                     |
| fires once                               | maximumExecutionCount 1                               |
| lead_time_s from firing to the act       | delay of the condition                                |
| held_for_s                               | none: a delay doesn't ask whether it still holds      |
| in_region                                | none: there are no polygons                           |
| phase_reached                            | none: an event's phases are measured in a session     |
"""

from __future__ import annotations

import itertools

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    ElapsedTime,
    InRegion,
    Leaf,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    SpeedIs,
    TimeHeadway,
    TimeToArrival,
    TimeToCollision,
    TriggerSpec,
)
from ssp_scenario_manager.compile.export.entities import position
from ssp_scenario_manager.compile.export.heights import Heights

# Nested conditions multiply when they are written as groups; no task needs as many.
MOST_GROUPS = 64

_EDGES = {
    "none": xosc.ConditionEdge.none,
    "rising": xosc.ConditionEdge.rising,
    "falling": xosc.ConditionEdge.falling,
}


def after(name: str, time_s: float) -> xosc.ValueTrigger:
    """True from a time after the scenario's start, s."""
    condition = xosc.SimulationTimeCondition(time_s, xosc.Rule.greaterThan)
    return xosc.ValueTrigger(name, 0, xosc.ConditionEdge.none, condition)


def driven(name: str, entity: str, distance_m: float) -> xosc.EntityTrigger:
    """True once an entity has driven a distance since the scenario's start, m."""
    condition = xosc.TraveledDistanceCondition(distance_m)
    return xosc.EntityTrigger(name, 0, xosc.ConditionEdge.none, condition, entity)


def stop_at(
    name: str, vut_driven_m: float, at_latest_s: float, over_s: float | None
) -> xosc.Trigger:
    """Ends where a session does, by whichever comes first.

    Args:
        name: of the act or storyboard that ends; conditions' names begin with it, since
            ScenarioRunner remembers by names what is done.
        vut_driven_m: the VUT is at the end of its route.
        at_latest_s: time is up, s after the scenario's start.
        over_s: the event is over, s after the scenario's start; None: not known beforehand.
    """

    def at(word: str, time_s: float) -> xosc.ValueTrigger:
        condition = xosc.SimulationTimeCondition(time_s, xosc.Rule.greaterThan)
        none = xosc.ConditionEdge.none
        return xosc.ValueTrigger(f"{name}_{word}", 0, none, condition, triggeringpoint="stop")

    ends: list[xosc.EntityTrigger | xosc.ValueTrigger] = [
        xosc.EntityTrigger(
            f"{name}_vut_at_goal",
            0,
            xosc.ConditionEdge.none,
            xosc.TraveledDistanceCondition(vut_driven_m),
            VUT_ID,
            triggeringpoint="stop",
        ),
        at("time_is_up", at_latest_s),
    ]
    if over_s is not None:
        ends.append(at("event_is_over", over_s))
    stop = xosc.Trigger("stop")
    for end in ends:
        group = xosc.ConditionGroup("stop")
        group.add_condition(end)
        stop.add_conditiongroup(group)
    return stop


def fires(
    trigger: TriggerSpec, vut: ParticipantSpec, route: Motion, heights: Heights, field: str
) -> xosc.EntityTrigger | xosc.ValueTrigger | xosc.Trigger:
    """The condition that starts a trigger's act; see the module's table.

    Args:
        trigger: of the task's run.
        vut: whose front overhang counts.
        route: the VUT's path, frame map.
        heights: of the map's ground.
        field: path of the trigger, for errors.

    Raises:
        InputError: it asks something that OpenSCENARIO can't.
    """
    if trigger.held_for_s > 0.0:
        raise InputError(
            "can't be told in OpenSCENARIO, whose delays don't ask whether a condition still holds",
            field=f"{field}.held_for_s",
            value=trigger.held_for_s,
            remedy="0",
        )
    condition = trigger.condition
    if isinstance(condition, AllOf | AnyOf):
        if trigger.edge != "none":
            raise InputError(
                "OpenSCENARIO has edges of single conditions, not of all or any",
                field=f"{field}.edge",
                value=trigger.edge,
                remedy="none",
            )
        return _groups(trigger, vut, route, heights, f"{field}.condition")
    return _single(
        trigger, f"{trigger.id}_fires", condition, vut, route, heights, f"{field}.condition"
    )


def _groups(
    trigger: TriggerSpec, vut: ParticipantSpec, route: Motion, heights: Heights, field: str
) -> xosc.Trigger:
    groups = _any_of_all(trigger.condition, field)
    if len(groups) > MOST_GROUPS:
        raise InputError(
            f"needs {len(groups)} groups of conditions in OpenSCENARIO, more than {MOST_GROUPS}",
            field=field,
            remedy="nest all and any less deeply",
        )
    whole = xosc.Trigger("start")
    number = itertools.count()
    for leaves in groups:
        group = xosc.ConditionGroup("start")
        for leaf, where in leaves:
            name = f"{trigger.id}_fires_{next(number)}"
            group.add_condition(_single(trigger, name, leaf, vut, route, heights, where))
        whole.add_conditiongroup(group)
    return whole


def _any_of_all(condition: Leaf | AllOf | AnyOf, field: str) -> list[tuple[tuple[Leaf, str], ...]]:
    """The condition as any of groups of leaves that all must hold, each leaf with its field."""
    if not isinstance(condition, AllOf | AnyOf):
        return [((condition, field),)]
    parts = [_any_of_all(part, f"{field}.of[{i}]") for i, part in enumerate(condition.of)]
    if isinstance(condition, AnyOf):
        return [group for part in parts for group in part]
    product: list[tuple[tuple[Leaf, str], ...]] = [()]
    for part in parts:
        # Stops growing once it is refused anyway.
        product = [a + b for a in product[: MOST_GROUPS + 1] for b in part]
    return product


def _single(
    trigger: TriggerSpec,
    name: str,
    condition: Leaf,
    vut: ParticipantSpec,
    route: Motion,
    heights: Heights,
    field: str,
) -> xosc.EntityTrigger | xosc.ValueTrigger:
    delay, edge = trigger.lead_time_s, _EDGES[trigger.edge]
    if isinstance(condition, ElapsedTime):
        since = xosc.SimulationTimeCondition(condition.after_s, xosc.Rule.greaterThan)
        return xosc.ValueTrigger(name, delay, edge, since)
    entity = condition.object_id if isinstance(condition, SpeedIs) else VUT_ID
    asked = _of_entity(condition, vut, route, heights, field)
    return xosc.EntityTrigger(name, delay, edge, asked, entity)


def _of_entity(
    condition: Leaf, vut: ParticipantSpec, route: Motion, heights: Heights, field: str
) -> (
    xosc.RelativeDistanceCondition
    | xosc.TimeToCollisionCondition
    | xosc.TimeHeadwayCondition
    | xosc.SpeedCondition
):
    less = xosc.Rule.lessThan
    if isinstance(condition, RelativeDistance):
        return xosc.RelativeDistanceCondition(
            condition.below_m,
            less,
            xosc.RelativeDistanceType.longitudinal,
            condition.object_id,
            freespace=True,
        )
    if isinstance(condition, TimeToArrival):
        path = Polyline(route.path)
        station, _ = path.project(*condition.anchor)
        place = path.pose(station - vut.size.front_m)
        return xosc.TimeToCollisionCondition(
            condition.below_s,
            less,
            alongroute=False,
            freespace=False,
            position=position((place.x_m, place.y_m), heights, place.yaw_rad),
        )
    if isinstance(condition, TimeHeadway):
        return xosc.TimeHeadwayCondition(
            condition.object_id, condition.below_s, less, alongroute=False, freespace=True
        )
    if isinstance(condition, TimeToCollision):
        return xosc.TimeToCollisionCondition(
            condition.below_s, less, alongroute=False, freespace=True, entity=condition.object_id
        )
    if isinstance(condition, SpeedIs):
        rule = xosc.Rule.greaterThan if condition.relation == "above" else less
        return xosc.SpeedCondition(condition.value_mps, rule)
    why = (
        "OpenSCENARIO has no regions that are polygons"
        if isinstance(condition, InRegion)
        else "OpenSCENARIO knows nothing of an event's phases, which are measured in a session"
    )
    raise InputError(why, field=f"{field}.type", value=condition.type, remedy="another condition")
