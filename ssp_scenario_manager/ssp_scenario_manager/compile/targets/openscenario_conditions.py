"""Triggers of a task as OpenSCENARIO conditions, and its participants as entities."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.state import Size
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
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.targets.map_file import Heights
from ssp_scenario_manager.compile.targets.ramps import CLASSES, ClassFacts


def _box(size: Size) -> xosc.BoundingBox:
    return xosc.BoundingBox(
        size.width_m,
        size.length_m,
        size.height_m,
        0.5 * (size.front_m - size.rear_m),
        0.0,
        0.5 * size.height_m,
    )


def _vehicle(facts: ClassFacts, category: xosc.VehicleCategory, size: Size) -> xosc.Vehicle:
    return xosc.Vehicle(
        facts.blueprint,
        category,
        _box(size),
        xosc.Axle(
            facts.steering_rad,
            facts.wheel_m,
            facts.track_m,
            facts.wheelbase_m,
            facts.wheel_m / 2,
        ),
        xosc.Axle(0.0, facts.wheel_m, facts.track_m, 0.0, facts.wheel_m / 2),
        facts.speed_mps,
        facts.acceleration_mps2,
        facts.deceleration_mps2,
    )


def entity(who: ParticipantSpec) -> xosc.Vehicle | xosc.Pedestrian:
    """A participant as OpenSCENARIO 1.0 has it, named by its CARLA blueprint."""
    facts = CLASSES[who.object_class]
    made: xosc.Vehicle | xosc.Pedestrian
    if facts.category is None:
        made = xosc.Pedestrian(
            who.object_class,
            facts.mass_kg,
            xosc.PedestrianCategory.pedestrian,
            _box(who.size),
            model=facts.blueprint,
        )
    else:
        made = _vehicle(facts, facts.category, who.size)
    made.add_property("type", "ego_vehicle" if who.id == VUT_ID else "simulation")
    return made


def position(place: Point, heights: Heights, yaw_rad: float | None = None) -> xosc.WorldPosition:
    """A place of frame map. On a flat map its height is left to the player."""
    z = None if heights.is_flat else heights.at(place)
    return xosc.WorldPosition(place[0], place[1], z, yaw_rad)


def start_position(who: ParticipantSpec, heights: Heights) -> xosc.WorldPosition:
    """Where a participant stands at the start."""
    start = who.start
    return position((start.x_m, start.y_m), heights, start.yaw_rad)


def outside_control() -> xosc.ControllerAction:
    """Leaves an entity to the user, in the words of ScenarioRunner and of esmini."""
    properties = xosc.Properties()
    properties.add_property("module", "external_control")
    properties.add_property("esminiController", "ExternalController")
    nothing = xosc.OverrideControllerValueAction()
    nothing.set_throttle(False)
    nothing.set_brake(False)
    nothing.set_clutch(False)
    nothing.set_parkingbrake(False)
    nothing.set_steeringwheel(False)
    nothing.set_gear(False)
    assign = xosc.AssignControllerAction(xosc.Controller("user", properties))
    return xosc.ControllerAction(assign, nothing)


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


@dataclass(frozen=True)
class Firing:
    """The condition that starts a trigger's act.

    Args:
        vut: whose front overhang counts.
        route: the VUT's path, frame map.
        field: of the trigger in the task, for messages.
    """

    trigger: TriggerSpec
    vut: ParticipantSpec
    route: Motion
    heights: Heights
    field: str

    def condition(self) -> xosc.EntityTrigger | xosc.ValueTrigger | xosc.Trigger:
        """The condition in OpenSCENARIO.

        Raises:
            InputError: it asks something that OpenSCENARIO can't.
        """
        trigger = self.trigger
        if trigger.held_for_s > 0.0:
            raise InputError(
                "can't be told in OpenSCENARIO, whose delays don't ask whether a condition still "
                "holds",
                field=f"{self.field}.held_for_s",
                value=trigger.held_for_s,
                remedy="0",
            )
        where = f"{self.field}.condition"
        if not isinstance(trigger.condition, AllOf | AnyOf):
            return self._single(f"{trigger.id}_fires", trigger.condition, where)
        if trigger.edge != "none":
            raise InputError(
                "OpenSCENARIO has edges of single conditions, not of all or any",
                field=f"{self.field}.edge",
                value=trigger.edge,
                remedy="none",
            )
        groups = _any_of_all(trigger.condition, where)
        if len(groups) > MOST_GROUPS:
            raise InputError(
                f"needs {len(groups)} groups of conditions in OpenSCENARIO, more than "
                f"{MOST_GROUPS}",
                field=where,
                remedy="nest all and any less deeply",
            )
        whole = xosc.Trigger("start")
        number = itertools.count()
        for leaves in groups:
            group = xosc.ConditionGroup("start")
            for leaf, at in leaves:
                name = f"{trigger.id}_fires_{next(number)}"
                group.add_condition(self._single(name, leaf, at))
            whole.add_conditiongroup(group)
        return whole

    def _single(
        self, name: str, condition: Leaf, field: str
    ) -> xosc.EntityTrigger | xosc.ValueTrigger:
        delay, edge = self.trigger.lead_time_s, _EDGES[self.trigger.edge]
        if isinstance(condition, ElapsedTime):
            since = xosc.SimulationTimeCondition(condition.after_s, xosc.Rule.greaterThan)
            return xosc.ValueTrigger(name, delay, edge, since)
        entity = condition.object_id if isinstance(condition, SpeedIs) else VUT_ID
        return xosc.EntityTrigger(name, delay, edge, self._asked(condition, field), entity)

    def _asked(
        self, condition: Leaf, field: str
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
            path = Polyline(self.route.path)
            station, _ = path.project(*condition.anchor)
            place = path.pose(station - self.vut.size.front_m)
            return xosc.TimeToCollisionCondition(
                condition.below_s,
                less,
                alongroute=False,
                freespace=False,
                position=position((place.x_m, place.y_m), self.heights, place.yaw_rad),
            )
        if isinstance(condition, TimeHeadway):
            return xosc.TimeHeadwayCondition(
                condition.object_id, condition.below_s, less, alongroute=False, freespace=True
            )
        if isinstance(condition, TimeToCollision):
            return xosc.TimeToCollisionCondition(
                condition.below_s,
                less,
                alongroute=False,
                freespace=True,
                entity=condition.object_id,
            )
        if isinstance(condition, SpeedIs):
            rule = xosc.Rule.greaterThan if condition.relation == "above" else less
            return xosc.SpeedCondition(condition.value_mps, rule)
        why = (
            "OpenSCENARIO has no regions that are polygons"
            if isinstance(condition, InRegion)
            else "OpenSCENARIO knows nothing of an event's phases, which are measured in a session"
        )
        raise InputError(
            why, field=f"{field}.type", value=condition.type, remedy="another condition"
        )


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
