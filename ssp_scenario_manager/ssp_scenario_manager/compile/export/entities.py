"""Participants of a task as OpenSCENARIO entities.

OpenSCENARIO's vehicle origin is below the middle of the rear axle, a pedestrian's below the body:
both are our reference points (ObjectState.msg), so that poses go over unchanged.
"""

from __future__ import annotations

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.export.classes import CLASSES, ClassFacts
from ssp_scenario_manager.compile.export.heights import Heights


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
