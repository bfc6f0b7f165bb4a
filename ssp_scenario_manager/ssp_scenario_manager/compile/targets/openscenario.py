"""OpenSCENARIO XML of a task (METHOD 2.5), for esmini, CARLA's ScenarioRunner and others.

Version 1.0, the only one that ScenarioRunner takes; esmini takes all. Only what both play is
written. What a session does and these files don't is told in docs/exports.md.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.files import write_bytes
from ssp_core.motion.speed_profile import DEFAULT_RAMP_S
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Look, RunSpec
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    LaneChange,
    Motion,
    ParticipantSpec,
    TriggerSpec,
)
from ssp_scenario_manager.compile.targets.map_file import (
    Heights,
    MapFile,
    lanes_crossed,
    map_file,
    provenance,
)
from ssp_scenario_manager.compile.targets.opendrive import FIXED_DATE, to_bytes
from ssp_scenario_manager.compile.targets.openscenario_conditions import (
    Firing,
    after,
    driven,
    entity,
    outside_control,
    position,
    start_position,
    stop_at,
)
from ssp_scenario_manager.compile.targets.ramps import (
    TARGET_START_S,
    Ramp,
    distance_during,
    driven_speeds,
    journey,
    legs,
    ramp,
    times_along,
)
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block

MINOR_VERSION = 0
# What an eye can tell from fog, by Koschmieder's law: contrast 5 %.
_FOG_CONTRAST = 0.05
_CLEAR_M = 100000.0


def export_openscenario(task: Task, block: Block, map_text: str | None, folder: Path) -> list[Path]:
    """Writes the scenario twice, with its map: the VUT as foreseen, and left to the user.

    Args:
        task: sealed.
        block: that it was placed on.
        map_text: the user's map; None where the task's place isn't an OpenDRIVE map.
        folder: to write into; it is there.

    Returns:
        The files: ``<event>.xosc``, ``<event>_external.xosc`` and the map.

    Raises:
        InputError: the task has something that OpenSCENARIO 1.0 can't tell.
    """
    chart = map_file(task, block, map_text)
    files = {
        f"{task.event.name}.xosc": scenario_xml(task, block, chart, external=False),
        f"{task.event.name}_external.xosc": scenario_xml(task, block, chart, external=True),
        chart.name: chart.data,
    }
    for name, data in files.items():
        write_bytes(folder / name, data)
    return [folder / name for name in files]


def scenario_xml(task: Task, block: Block, chart: MapFile, *, external: bool) -> bytes:
    """The scenario.

    Args:
        external: the VUT stands until the user's controller drives it; else it drives in its lane
            at the speeds of a session, whatever it meets.

    Raises:
        InputError: the task has something that OpenSCENARIO 1.0 can't tell.
    """
    run = task.run
    entities = xosc.Entities()
    for who in (run.vut, *run.targets):
        entities.add_scenario_object(who.id, entity(who))
    facts = provenance(task)
    drivers = "the VUT is the user's" if external else "the VUT drives as foreseen"
    description = (
        f"{facts['event']} on {task.place.name}: event {facts['event_version']}, "
        f"task {facts['task_version']}, compiler {facts['compiler']}, seed {facts['seed']}; "
        f"{drivers}"
    )
    scenario = xosc.Scenario(
        description,
        f"SSP, {facts['compiler']}",
        xosc.ParameterDeclarations(),
        entities,
        _storyboard(run, block, chart.heights, external),
        xosc.RoadNetwork(chart.name),
        xosc.Catalog(),
        osc_minor_version=MINOR_VERSION,
        creation_date=datetime.datetime.fromisoformat(FIXED_DATE),
    )
    return to_bytes(scenario.get_element())


def _storyboard(run: RunSpec, block: Block, heights: Heights, external: bool) -> xosc.StoryBoard:
    route = _route(run)
    init = xosc.Init()
    init.add_global_action(xosc.EnvironmentAction(_environment(run.look)))
    for who in (run.vut, *run.targets):
        init.add_init_action(who.id, xosc.TeleportAction(start_position(who, heights)))
        init.add_init_action(who.id, _speed(Ramp(0.0, 0.0)))
    if external:
        init.add_init_action(VUT_ID, outside_control())

    manoeuvres = [_manoeuvre(run, block, trigger, route, heights) for trigger in run.triggers]
    # When the event is over depends on how the VUT drives: in the external file nobody knows.
    speeds, over_s = ((), None) if external else driven_speeds(run)

    def stop(name: str) -> xosc.Trigger:
        return stop_at(name, journey(route).braking_from_m, run.end.at_latest_s, over_s)

    acts = []
    for trigger, group in zip(run.triggers, manoeuvres, strict=True):
        name = f"act_{trigger.id}"
        start = after(f"{trigger.id}_not_before", trigger.not_before_s)
        act = xosc.Act(name, start, stop(name))
        act.add_maneuver_group(group)
        acts.append(act)
    story = xosc.Story("story")
    approach = xosc.Act("approach", after("approach_starts", 0.0), stop("approach"))
    movers = [t for t in run.targets if t.approach is not None]
    if not external:
        approach.add_maneuver_group(_vut_drive(speeds))
    for who in movers:
        approach.add_maneuver_group(_approach(who))
    if movers or not external:
        story.add_act(approach)
    for act in acts:
        story.add_act(act)
    board = xosc.StoryBoard(init, stop("storyboard"))
    board.add_story(story)
    return board


def _route(run: RunSpec) -> Motion:
    if run.vut.approach is None:
        raise InputError("has no path for the VUT", field="run.vut.approach")
    return run.vut.approach


def _speed(change: Ramp) -> xosc.AbsoluteSpeedAction:
    if change.duration_s == 0.0:
        dynamics = xosc.TransitionDynamics(
            xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0
        )
    else:
        dynamics = xosc.TransitionDynamics(
            xosc.DynamicsShapes.linear, xosc.DynamicsDimension.time, change.duration_s
        )
    return xosc.AbsoluteSpeedAction(change.to_mps, dynamics)


def _group(entity_id: str, name: str, events: list[xosc.Event]) -> xosc.ManeuverGroup:
    # No two elements have one name: ScenarioRunner remembers by names what is done.
    manoeuvre = xosc.Maneuver(f"maneuver_{name}")
    for event in events:
        manoeuvre.add_event(event)
    group = xosc.ManeuverGroup(f"group_{name}")
    group.add_actor(entity_id)
    group.add_maneuver(manoeuvre)
    return group


def _event(
    name: str,
    trigger: xosc.EntityTrigger | xosc.ValueTrigger | xosc.Trigger,
    actions: list[
        xosc.AbsoluteSpeedAction | xosc.RelativeLaneChangeAction | xosc.FollowTrajectoryAction
    ],
) -> xosc.Event:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_trigger(trigger)
    for i, action in enumerate(actions):
        event.add_action(f"{name}_{i}", action)
    return event


def _vut_drive(speeds: Sequence[tuple[float, float]]) -> xosc.ManeuverGroup:
    """The VUT's speeds as the SIL's driver drives, leg by leg."""
    events = [
        _event(f"vut_{i}", after(f"vut_{i}_starts", leg.start_s), [_speed(leg.change)])
        for i, leg in enumerate(legs(speeds))
    ]
    return _group(VUT_ID, "vut_drive", events)


def _approach(who: ParticipantSpec) -> xosc.ManeuverGroup:
    if who.approach is None:
        raise ValueError(f"{who.id} has no approach")
    name = f"{who.id}_approach"
    start = after(f"{name}_starts", TARGET_START_S)
    return _group(who.id, name, [_event(name, start, [_speed(journey(who.approach).start)])])


def _manoeuvre(
    run: RunSpec, block: Block, trigger: TriggerSpec, route: Motion, heights: Heights
) -> xosc.ManeuverGroup:
    who = next(t for t in run.targets if t.id == trigger.object_id)
    field = f"run.triggers[{run.triggers.index(trigger)}]"
    condition = Firing(trigger, run.vut, route, heights, field).condition()
    manoeuvre = trigger.manoeuvre
    if isinstance(manoeuvre, FollowPath):
        return _group(
            who.id, trigger.id, _walk(who, trigger.id, manoeuvre.motion, condition, heights)
        )
    if who.approach is None:
        raise InputError("has no approach to leave or brake on", field="run.targets", value=who.id)
    cruise = who.approach.cruise_mps
    if isinstance(manoeuvre, Brake):
        change = ramp(cruise, manoeuvre.to_mps, manoeuvre.deceleration_mps2)
        return _group(who.id, trigger.id, [_event(trigger.id, condition, [_speed(change)])])
    slower = ramp(cruise, manoeuvre.cruise_mps, manoeuvre.deceleration_mps2)
    shift = _lane_change(who, block, manoeuvre, slower)
    return _group(who.id, trigger.id, [_event(trigger.id, condition, [shift, _speed(slower)])])


def _lane_change(
    who: ParticipantSpec, block: Block, manoeuvre: LaneChange, slower: Ramp
) -> xosc.RelativeLaneChangeAction:
    """Sideways over the distance that is driven in the planned time.

    ScenarioRunner knows a lane change's distance only. The sine is the player's shape nearest to
    a session's quintic.
    """
    if who.approach is None:
        raise ValueError(f"{who.id} has no approach")
    _, from_l = block.line.to_local(who.start.x_m, who.start.y_m)
    lanes, beside = lanes_crossed(block, from_l, manoeuvre)
    distance = distance_during(who.approach.cruise_mps, slower, manoeuvre.duration_s)
    return xosc.RelativeLaneChangeAction(
        lanes,
        who.id,
        xosc.TransitionDynamics(
            xosc.DynamicsShapes.sinusoidal, xosc.DynamicsDimension.distance, distance
        ),
        beside if abs(beside) > 0.01 else None,
    )


def _walk(
    who: ParticipantSpec,
    name: str,
    motion: Motion,
    condition: xosc.EntityTrigger | xosc.ValueTrigger | xosc.Trigger,
    heights: Heights,
) -> list[xosc.Event]:
    """A path of its own, its speed up from standstill, and the stop at its end."""
    if who.approach is not None:
        raise InputError(
            "drives before it follows a path of its own, which isn't told here",
            field="run.targets",
            value=who.id,
        )
    points = times_along(motion)
    trajectory = xosc.Trajectory(f"{name}_path", False)
    trajectory.add_shape(
        xosc.Polyline([t for t, _, _ in points], [position((x, y), heights) for _, x, y in points])
    )
    trip = journey(motion)
    # A session's ramp is rounded, and lags behind a straight one by half of the rounding.
    start = replace(trip.start, duration_s=trip.start.duration_s + DEFAULT_RAMP_S)
    follow = xosc.FollowTrajectoryAction(trajectory, xosc.FollowingMode.position)
    stop_name = f"{name}_stop"
    stop = driven(f"{stop_name}_starts", who.id, trip.braking_from_m)
    return [
        _event(name, condition, [follow, _speed(start)]),
        _event(stop_name, stop, [_speed(trip.stop)]),
    ]


def _environment(look: Look) -> xosc.Environment:
    """Sun, fog and a dry road; OpenSCENARIO's azimuth is clockwise from north."""
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
