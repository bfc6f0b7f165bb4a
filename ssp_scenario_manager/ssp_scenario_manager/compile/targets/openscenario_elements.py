"""The parts of which an OpenSCENARIO storyboard is made: weather, entities, places, conditions."""

from __future__ import annotations

import datetime
import math
from typing import TypeAlias

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.geometry import Polyline
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Look, RunSpec
from ssp_core.run_file.participants import (
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TriggerSpec,
)
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.targets.foreseen import ForeseenSession, shorter_m, straight_share
from ssp_scenario_manager.compile.targets.map_file import Heights, trigger_condition
from ssp_scenario_manager.compile.targets.opendrive import FIXED_DATE
from ssp_scenario_manager.compile.targets.ramps import CLASSES

Start: TypeAlias = "xosc.EntityTrigger | xosc.ValueTrigger"
# What an eye can tell from fog, by Koschmieder's law: contrast 5 %.
_FOG_CONTRAST = 0.05
_CLEAR_M = 100000.0
# A player's measure that differs by less from a session's is left as K* has it, m or s.
_SAME = 0.02


def path_of(who: ParticipantSpec) -> Motion:
    """Return the motion of a participant of a compiled task before any trigger."""
    if who.approach is None:
        raise ValueError(f"{who.id} has no approach")
    return who.approach


def environment(look: Look) -> xosc.Environment:
    """Return sun, fog and a dry road; OpenSCENARIO's azimuth is clockwise from north."""
    far = -math.log(_FOG_CONTRAST) / look.fog_per_m if look.fog_per_m > 0.0 else _CLEAR_M
    weather = xosc.Weather(
        xosc.CloudState.free,
        sun=xosc.Sun(
            1.0,
            math.radians((90.0 - look.sun_azimuth_deg) % 360.0),
            math.radians(look.sun_elevation_deg),
        ),
        fog=xosc.Fog(min(far, _CLEAR_M)),
        precipitation=xosc.Precipitation(xosc.PrecipitationType.dry, 0.0),
    )
    noon = datetime.datetime.fromisoformat(FIXED_DATE).replace(hour=12)
    return xosc.Environment(
        "environment",
        xosc.TimeOfDay(False, noon.year, noon.month, noon.day, noon.hour, 0, 0),
        weather,
        xosc.RoadCondition(1.0),
    )


def _box(size: Size) -> xosc.BoundingBox:
    return xosc.BoundingBox(
        size.width_m,
        size.length_m,
        size.height_m,
        0.5 * (size.front_m - size.rear_m),
        0.0,
        0.5 * size.height_m,
    )


def entity(who: ParticipantSpec) -> xosc.Vehicle | xosc.Pedestrian:
    """Return a participant as OpenSCENARIO 1.0 has it, named by its CARLA blueprint."""
    facts, box = CLASSES[who.object_class], _box(who.size)
    participant: xosc.Vehicle | xosc.Pedestrian
    if facts.category is None:
        walks = xosc.PedestrianCategory.pedestrian
        participant = xosc.Pedestrian(
            who.object_class, facts.mass_kg, walks, box, model=facts.blueprint
        )
    else:
        wheel, track = facts.wheel_m, facts.track_m
        participant = xosc.Vehicle(
            facts.blueprint,
            facts.category,
            box,
            xosc.Axle(facts.steering_rad, wheel, track, facts.wheelbase_m, wheel / 2),
            xosc.Axle(0.0, wheel, track, 0.0, wheel / 2),
            facts.speed_mps,
            facts.acceleration_mps2,
            facts.deceleration_mps2,
        )
    participant.add_property("type", "ego_vehicle" if who.id == VUT_ID else "simulation")
    return participant


def position(place: Point, heights: Heights, yaw_rad: float | None = None) -> xosc.WorldPosition:
    """Return a place of frame map. On a flat map its height is left to the player."""
    z = None if heights.is_flat else heights.at(place)
    return xosc.WorldPosition(place[0], place[1], z, yaw_rad)


def outside_control() -> xosc.ControllerAction:
    """Leave an entity to the user, in the words of ScenarioRunner and of esmini."""
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


def after(name: str, time_s: float, point: str = "start") -> xosc.ValueTrigger:
    """Return a condition that is true from a time after the scenario's start, s."""
    condition = xosc.SimulationTimeCondition(time_s, xosc.Rule.greaterThan)
    return xosc.ValueTrigger(name, 0, xosc.ConditionEdge.none, condition, point)


def driven(
    name: str, entity_id: str, distance_m: float, point: str = "start"
) -> xosc.EntityTrigger:
    """Return a condition that is true once an entity has driven a distance since the start, m."""
    far, none = xosc.TraveledDistanceCondition(distance_m), xosc.ConditionEdge.none
    return xosc.EntityTrigger(name, 0, none, far, entity_id, triggeringpoint=point)


def stop_at(
    name: str, vut_driven_m: float, at_latest_s: float, over_s: float | None
) -> xosc.Trigger:
    """End where a session does, by the first of these conditions.

    Args:
        name: of the act or storyboard that ends; conditions' names begin with it, since
            ScenarioRunner remembers by names what is done.
        vut_driven_m: the VUT is at the end of its route.
        at_latest_s: time is up, s after the scenario's start.
        over_s: the event is over, s after the scenario's start; None: not known beforehand.
    """
    ends: list[Start] = [
        driven(f"{name}_vut_at_goal", VUT_ID, vut_driven_m, "stop"),
        after(f"{name}_time_is_up", at_latest_s, "stop"),
    ]
    if over_s is not None:
        ends.append(after(f"{name}_event_is_over", over_s, "stop"))
    stop = xosc.Trigger("stop")
    for end in ends:
        group = xosc.ConditionGroup("stop")
        group.add_condition(end)
        stop.add_conditiongroup(group)
    return stop


def firing(
    run: RunSpec, trigger: TriggerSpec, delay_s: float, session: ForeseenSession, heights: Heights
) -> Start:
    """Return the condition that starts a trigger's act, asked of the VUT.

    A session measures along the VUT's path and a player straight ahead. On a bend the condition has
    the value that a player measures when the session's trigger fires.
    """
    condition, less = trigger_condition(trigger), xosc.Rule.lessThan
    if isinstance(condition, RelativeDistance):
        other = next(t for t in run.targets if t.id == condition.object_id)
        below = condition.below_m - shorter_m(run, session, other)
        entity_condition = xosc.RelativeDistanceCondition(
            condition.below_m if abs(below - condition.below_m) < _SAME else round(below, 3),
            less,
            xosc.RelativeDistanceType.longitudinal,
            condition.object_id,
            freespace=True,
        )
    else:
        # The anchor is moved back along the VUT's path by its front overhang.
        path = Polyline(path_of(run.vut).path)
        station, _ = path.project(*condition.anchor)
        place = path.pose(station - run.vut.size.front_m)
        below = condition.below_s * straight_share(run, session, condition.anchor)
        entity_condition = xosc.TimeToCollisionCondition(
            condition.below_s if abs(below - condition.below_s) < _SAME else round(below, 3),
            less,
            alongroute=False,
            freespace=False,
            position=position((place.x_m, place.y_m), heights, place.yaw_rad),
        )
    name = f"{trigger.id}_fires"
    return xosc.EntityTrigger(name, delay_s, xosc.ConditionEdge.none, entity_condition, VUT_ID)
