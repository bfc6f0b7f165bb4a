"""OpenSCENARIO XML of a task (METHOD 2.5), for esmini, CARLA's ScenarioRunner and others.

Version 1.0, the only one that ScenarioRunner takes; esmini takes all. Only what both play is
written. What a session does and these files don't stands in docs/exports.md.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scenariogeneration import xosc  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.files.writing import write_bytes
from ssp_core.geometry import FloatArray, Polyline, wrap_angle
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    Hold,
    LaneChange,
    Motion,
    ParticipantSpec,
    TriggerSpec,
)
from ssp_scenario_manager.compile.targets.foreseen import (
    FIRING_LAG_S,
    PLAYER_LAG_S,
    SAME_MPS,
    ForeseenSession,
    foresee,
    gaps_m,
)
from ssp_scenario_manager.compile.targets.goal_lane import goal_lane
from ssp_scenario_manager.compile.targets.map_file import (
    Heights,
    MapFile,
    map_file,
    provenance,
)
from ssp_scenario_manager.compile.targets.opendrive import FIXED_DATE, to_bytes
from ssp_scenario_manager.compile.targets.openscenario_elements import (
    Start,
    after,
    driven,
    entity,
    environment,
    firing,
    outside_control,
    path_of,
    position,
    stop_at,
)
from ssp_scenario_manager.compile.targets.player import play
from ssp_scenario_manager.compile.targets.ramps import (
    TARGET_START_S,
    Ramp,
    distance_during,
    journey,
    legs,
    matched,
    ramp,
    sine_length_m,
    times_along,
)
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD

MINOR_VERSION = 0
# From firing to a player's act, s: a straight ramp is nearest to a session's rounded one if it
# begins half of the rounding later. ScenarioRunner takes no longer delay (docs/exports.md).
ACT_DELAY_S = 0.2
# A speed that compensates the way of a lane change is reached, and left, in this time.
_RAISED_OVER_S = 0.5
# (t in s, x, y)
_TimedPoint: TypeAlias = tuple[float, float, float]
_Action: TypeAlias = (
    "xosc.AbsoluteSpeedAction | xosc.RelativeLaneChangeAction | xosc.FollowTrajectoryAction"
)


def export_openscenario(task: Task, block: Block, map_text: str | None, folder: Path) -> list[Path]:
    """Write the scenario twice, with its map: the VUT as foreseen, and left to the user.

    Args:
        task: sealed.
        block: that it was placed on.
        map_text: the user's map; None where the task's place isn't an OpenDRIVE map.
        folder: to write into; it is there.

    Returns:
        The files: ``<event>.xosc``, ``<event>_external.xosc`` and the map.

    Raises:
        InputError: the block can't be put into OpenDRIVE, a place has no height on the map, the
            trigger never fires, or the scenario would show another gap than a session.
    """
    chart = map_file(task, block, map_text)
    session = foresee(task.run)
    files = {
        f"{task.event.name}.xosc": scenario_xml(task, chart, session, external=False),
        f"{task.event.name}_external.xosc": scenario_xml(task, chart, session, external=True),
        chart.name: chart.data,
    }
    _check_gap(task.run, files[f"{task.event.name}.xosc"], chart, block, session)
    for name, data in files.items():
        write_bytes(folder / name, data)
    return [folder / name for name in files]


# Between the gap that a player shows and a session's.
MOST_GAP_ERROR_M = 0.3
_EVERY_S = 0.1


def _check_gap(
    run: RunSpec, scenario: bytes, chart: MapFile, block: Block, session: ForeseenSession
) -> None:
    """Play a scenario and hold the gap between VUT and initiator against the session's.

    Raises:
        InputError: they differ by too much; with when and by how much.
    """
    played = play(scenario, chart.data, block.line)
    times = np.arange(_EVERY_S, played[run.vut.id][-1, 0], _EVERY_S)
    errors = gaps_m(run, played, times) - gaps_m(run, session.tracks, times)
    worst = int(np.argmax(np.abs(errors)))
    if not abs(errors[worst]) <= MOST_GAP_ERROR_M:
        raise InputError(
            f"would show another event in a player: at {times[worst]:.1f} s the gap between VUT "
            f"and {run.initiator_id} differs by {errors[worst]:+.2f} m from the session's, at most "
            f"{MOST_GAP_ERROR_M:g} m",
            field="block",
            value=block.block_id,
            remedy=_remedy(run, session, float(times[worst])),
        )


def _remedy(run: RunSpec, session: ForeseenSession, at_s: float) -> str:
    """Return the remedy of a gap that differs, by what a storyboard doesn't show."""
    triggers = [trigger.model_copy(update={"adaptation": None}) for trigger in run.triggers]
    plain = foresee(run.model_copy(update={"triggers": triggers}))
    moved_m = session.driven_m_of_initiator(at_s) - plain.driven_m_of_initiator(at_s)
    if abs(moved_m) <= MOST_GAP_ERROR_M:
        return "choose a block that bends less, or milder values in part C"
    return (
        f"the session adapts the speed of {run.initiator_id} to the VUT, by {moved_m:+.2f} m of "
        "way until then, and a storyboard doesn't: choose values in part C with which the VUT "
        f"keeps its approach speed until {run.initiator_id} is in its corridor, or export for sumo"
    )


def scenario_xml(task: Task, chart: MapFile, session: ForeseenSession, *, external: bool) -> bytes:
    """Return the scenario as XML.

    Args:
        task: with its run.
        chart: the map beside it, with heights.
        session: the session that is foreseen.
        external: the VUT stands until the user's controller drives it; else it drives in its lane
            at the speeds of a session, whatever it meets.
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
        _storyboard(run, chart, session, external),
        xosc.RoadNetwork(chart.name),
        xosc.Catalog(),
        osc_minor_version=MINOR_VERSION,
        creation_date=datetime.datetime.fromisoformat(FIXED_DATE),
    )
    return to_bytes(scenario.get_element())


def _storyboard(
    run: RunSpec, chart: MapFile, session: ForeseenSession, external: bool
) -> xosc.StoryBoard:
    route, heights = path_of(run.vut), chart.heights
    init = xosc.Init()
    init.add_global_action(xosc.EnvironmentAction(environment(run.look)))
    for who in (run.vut, *run.targets):
        at = who.start
        start = position((at.x_m, at.y_m), heights, at.yaw_rad)
        init.add_init_action(who.id, xosc.TeleportAction(start))
        init.add_init_action(who.id, _speed(Ramp(0.0, 0.0)))
    if external:
        init.add_init_action(VUT_ID, outside_control())

    # When the event is over depends on how the VUT drives: in the external file nobody knows.
    over_s = None if external else session.over_s

    def stop(name: str) -> xosc.Trigger:
        return stop_at(name, journey(route).braking_from_m, run.end.at_latest_s, over_s)

    groups = [] if external else [_vut_drive(run, session, heights)]
    groups += [_approach(who, run, session) for who in run.targets if who.approach is not None]
    acts = []
    if groups:
        acts.append(_act("approach", after("approach_starts", 0.0), stop("approach"), groups))
    for trigger in run.triggers:
        name, group = f"act_{trigger.id}", _manoeuvre(run, trigger, chart, session, external)
        if group is None:
            continue
        start = after(f"{trigger.id}_not_before", trigger.not_before_s)
        acts.append(_act(name, start, stop(name), [group]))
    if not acts:
        # A story has an act at least, and of an object that only stands there is nothing to tell.
        still = _event("stands", _at("stands_starts", TARGET_START_S), _speed(Ramp(0.0, 0.0)))
        group = _group(run.initiator_id, "stands", [still])
        acts.append(_act("act_stands", after("act_starts", 0.0), stop("act_stands"), [group]))
    story = xosc.Story("story")
    for act in acts:
        story.add_act(act)
    board = xosc.StoryBoard(init, stop("storyboard"))
    board.add_story(story)
    return board


def _act(
    name: str, start: Start, stop: xosc.Trigger, groups: Sequence[xosc.ManeuverGroup]
) -> xosc.Act:
    act = xosc.Act(name, start, stop)
    for group in groups:
        act.add_maneuver_group(group)
    return act


def _speed(change: Ramp) -> xosc.AbsoluteSpeedAction:
    shapes = xosc.DynamicsShapes
    shape = shapes.step if change.duration_s == 0.0 else shapes.linear
    dynamics = xosc.TransitionDynamics(shape, xosc.DynamicsDimension.time, change.duration_s)
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


def _event(name: str, start: Start, *actions: _Action) -> xosc.Event:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_trigger(start)
    for i, action in enumerate(actions):
        event.add_action(f"{name}_{i}", action)
    return event


def _vut_drive(run: RunSpec, session: ForeseenSession, heights: Heights) -> xosc.ManeuverGroup:
    """Return the VUT's speeds as the SIL's driver drives, leg by leg.

    A VUT that turns at a junction follows its way of the session. A player would go straight on
    over a map's junction, and it doesn't cut a turn as the driver does, which shifts the conflict
    zone.
    """
    speed_legs = matched(legs(session.speeds), session.speeds, session.driven_m)
    way = _way(session.tracks[VUT_ID])
    first: list[_Action] = [_follow("vut_way", way, heights)] if _turns(run) else []
    events = [
        _event(
            f"vut_{i}",
            _at(f"vut_{i}_starts", leg.start_s),
            *(first if i == 0 else ()),
            _speed(leg.change),
        )
        for i, leg in enumerate(speed_legs)
    ]
    return _group(VUT_ID, "vut_drive", events)


def _turns(run: RunSpec) -> bool:
    """Tell whether the VUT's route turns at a junction."""
    path = Polyline(path_of(run.vut).path)
    first, last = (path.pose(s).yaw_rad for s in (0.0, path.length_m))
    return run.road.junction is not None and abs(wrap_angle(last - first)) >= STRAIGHT_ON_RAD


# Places of a way of the session are so far apart.
_WAY_STEP_M = 1.0


def _way(rows: FloatArray) -> list[_TimedPoint]:
    """Return the places of a track of the session, as (t in s, x, y)."""
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows[:, 1:3], axis=0).T))])
    stations = np.arange(0.0, driven_m[-1], _WAY_STEP_M)
    at = np.unique(np.searchsorted(driven_m, stations))
    return [(float(t), float(x), float(y)) for t, x, y in rows[at, :3]]


def _follow(
    name: str, points: Sequence[_TimedPoint], heights: Heights
) -> xosc.FollowTrajectoryAction:
    """Return the action that leads an entity along points, at the speed that others give it."""
    trajectory = xosc.Trajectory(name, False)
    trajectory.add_shape(
        xosc.Polyline([t for t, _, _ in points], [position((x, y), heights) for _, x, y in points])
    )
    return xosc.FollowTrajectoryAction(trajectory, xosc.FollowingMode.position)


def _at(name: str, time_s: float) -> xosc.ValueTrigger:
    """Return a condition that is true in the step of a time."""
    return after(name, round(max(0.0, time_s - PLAYER_LAG_S), 3))


def _approach(who: ParticipantSpec, run: RunSpec, session: ForeseenSession) -> xosc.ManeuverGroup:
    name, faster = f"{who.id}_approach", journey(path_of(who)).start
    if who.id == run.initiator_id:
        faster = session.approach(faster, TARGET_START_S)
    start = _at(f"{name}_starts", TARGET_START_S)
    return _group(who.id, name, [_event(name, start, _speed(faster))])


def _manoeuvre(
    run: RunSpec, trigger: TriggerSpec, chart: MapFile, session: ForeseenSession, external: bool
) -> xosc.ManeuverGroup | None:
    """Return what a trigger sets off; None: the object goes on as it came."""
    who = next(t for t in run.targets if t.id == trigger.object_id)
    name, manoeuvre = trigger.id, trigger.manoeuvre
    if isinstance(manoeuvre, Hold):
        return None
    if isinstance(manoeuvre, LaneChange) and _keeps_speed(who, manoeuvre):
        return _steady_lane_change(run, trigger, who, manoeuvre, chart, session, external)
    delay_s = max(trigger.lead_time_s, ACT_DELAY_S)
    start = firing(run, trigger, delay_s, session, chart.heights)
    if isinstance(manoeuvre, FollowPath):
        faster = _first_ramp(manoeuvre.motion, delay_s + FIRING_LAG_S, session)
        points = _led_along(who, manoeuvre.motion, session)
        walk = _walk(who, name, manoeuvre.motion, points, start, faster, chart.heights)
        return _group(who.id, name, walk)
    cruise, starts_s = path_of(who).cruise_mps, delay_s + FIRING_LAG_S
    to_mps = manoeuvre.to_mps if isinstance(manoeuvre, Brake) else manoeuvre.cruise_mps
    nominal = ramp(cruise, to_mps, manoeuvre.deceleration_mps2)
    slower = session.act(cruise, nominal, starts_s)
    if isinstance(manoeuvre, Brake):
        return _group(who.id, name, [_event(name, start, _speed(slower))])
    shift = _lane_change(who, chart, session, manoeuvre, slower)
    return _group(who.id, name, [_event(name, start, shift, _speed(slower))])


def _lane_change(
    who: ParticipantSpec,
    chart: MapFile,
    session: ForeseenSession,
    manoeuvre: LaneChange,
    slower: Ramp,
) -> xosc.RelativeLaneChangeAction:
    """Lead sideways to the goal lane over the distance that is driven in the planned time.

    ScenarioRunner knows a lane change's distance and relative goals only. The sine is the player's
    shape nearest to a session's quintic.
    """
    goal = goal_lane(chart.data, session.poses[who.id], manoeuvre.lateral_shift_m)
    distance = distance_during(path_of(who).cruise_mps, slower, manoeuvre.duration_s)
    dynamics = xosc.TransitionDynamics(
        xosc.DynamicsShapes.sinusoidal, xosc.DynamicsDimension.distance, distance
    )
    offset = goal.offset_m or None
    return xosc.RelativeLaneChangeAction(goal.ids, who.id, dynamics, offset)


def _keeps_speed(who: ParticipantSpec, manoeuvre: LaneChange) -> bool:
    return abs(path_of(who).cruise_mps - manoeuvre.cruise_mps) < SAME_MPS


def _steady_lane_change(
    run: RunSpec,
    trigger: TriggerSpec,
    who: ParticipantSpec,
    manoeuvre: LaneChange,
    chart: MapFile,
    session: ForeseenSession,
    external: bool,
) -> xosc.ManeuverGroup:
    """Return a lane change at constant speed along the lane.

    It has no ramp that would begin later than a session's, so that its delay is the lead time. A
    player's speed is along the sine, which is longer than the lane: it is raised by as much until
    the lane change is over. Where the VUT is the user's, when that is isn't known beforehand, and
    the speed stays as it is.
    """
    name, cruise = trigger.id, path_of(who).cruise_mps
    start = firing(run, trigger, trigger.lead_time_s, session, chart.heights)
    shift = _lane_change(who, chart, session, manoeuvre, ramp(cruise, cruise, 1.0))
    if external:
        return _group(who.id, name, [_event(name, start, shift)])
    lane_m = cruise * manoeuvre.duration_s
    share = sine_length_m(lane_m, manoeuvre.lateral_shift_m) / lane_m
    over_s = session.fired_s + trigger.lead_time_s + FIRING_LAG_S + manoeuvre.duration_s
    faster, back = (Ramp(round(v, 3), _RAISED_OVER_S) for v in (share * cruise, cruise))
    after_it = _event(f"{name}_over", _at(f"{name}_is_over", over_s), _speed(back))
    return _group(who.id, name, [_event(name, start, shift, _speed(faster)), after_it])


def _first_ramp(motion: Motion, starts_s: float, session: ForeseenSession) -> Ramp:
    """Return the speed from standstill on of a path of its own, as the session plays it.

    Args:
        motion: along its path.
        starts_s: when a player begins it, s after the trigger fires.
        session: the session.
    """
    trip = journey(motion)
    start_ramp = session.session_ramp(trip.start, starts_s, trip.braking_from_m)
    return session.act(0.0, start_ramp, starts_s)


def _led_along(who: ParticipantSpec, motion: Motion, session: ForeseenSession) -> list[_TimedPoint]:
    """Return the points of a path of its own, as (t in s, x, y).

    A vehicle cuts the bends of its path in a session. If they lead to both sides, as through a
    ring, the angle at which it leaves the VUT's corridor is so flat that this moves the time by
    0.1 s: it follows its way of the session, and from where that ends on the path.
    """
    planned, path = times_along(motion), Polyline(motion.path)
    if who.id not in session.tracks or not _bends_both_ways(motion):
        return planned
    way = _way(session.tracks[who.id])
    last_s, *last = way[-1]
    done_m, _ = path.project(*last)
    late_s = last_s - float(np.interp(done_m, path.stations_m, [t for t, _, _ in planned]))
    rest = np.searchsorted(path.stations_m, done_m + _WAY_STEP_M)
    return [*way, *((t + late_s, x, y) for t, x, y in planned[rest:])]


def _bends_both_ways(motion: Motion) -> bool:
    """Tell whether a path bends to either side by as much as a turn at a junction."""
    yaws = np.unwrap(np.arctan2(*np.diff(motion.path, axis=0).T[::-1]))
    turns = np.diff(yaws)
    left, right = turns[turns > 0.0].sum(), -turns[turns < 0.0].sum()
    return bool(min(left, right) >= STRAIGHT_ON_RAD)


def _walk(
    who: ParticipantSpec,
    name: str,
    motion: Motion,
    points: Sequence[_TimedPoint],
    start: Start,
    faster: Ramp,
    heights: Heights,
) -> list[xosc.Event]:
    """Make the events of a path of its own: speed up from standstill, and stop at its end.

    Args:
        who: whose path it is.
        name: that the events' names begin with.
        motion: along its path.
        points: that it is led along, (t in s, x, y).
        start: the condition that starts it.
        faster: its speed from standstill on.
        heights: of the map.
    """
    trip = journey(motion)
    follow = _follow(f"{name}_path", points, heights)
    stop_name = f"{name}_stop"
    stop = driven(f"{stop_name}_starts", who.id, trip.braking_from_m)
    return [
        _event(name, start, follow, _speed(faster)),
        _event(stop_name, stop, _speed(trip.stop)),
    ]
