"""The course of a session as far as an export needs it, foreseen by running one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geometry import Box, FloatArray, Polyline, Pose2, box_distance, wrap_angle
from ssp_core.motion.event import RESOLUTION_CONFIRMATION_S
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.compile.targets.ramps import Ramp
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.run.in_process import InProcessResult
from ssp_scenario_manager.triggers.conditions import condition_text

# A player looks at time conditions once per step, and a step of esmini is 10 ms: half of one before
# a time is the last at which it is sure to begin at that time.
PLAYER_LAG_S = 0.005
# What a trigger's condition starts begins so much later than its delay says.
FIRING_LAG_S = 0.01
# A change of speed has come to its end this long after its planned one.
_SETTLED_S = 1.0
# Speeds nearer than this are one, and no ramp is measured between them.
SAME_MPS = 0.1
# Shorter than this a ramp is a step to a player.
_LEAST_S = 0.01


@dataclass(frozen=True)
class ForeseenSession:
    """A session with the SIL's driver.

    Args:
        speeds: of the VUT until the end, (t in s, m/s), t rising from 0.
        driven_m: of the VUT at these times, distance since the start.
        over_s: when it ends: ``after_resolution_s`` after the session confirmed the resolution, s
            after the start; None where nothing was resolved. What of a conflict comes back later
            doesn't lengthen it.
        poses: of all when the trigger fires, by id.
        fired_s: when that is, s after the start.
        tracks: of the VUT and the initiator until the end, rows of (t in s, x, y in m, yaw in rad).
        course: of the initiator: (t in s since the start, distance driven in m).
    """

    speeds: tuple[tuple[float, float], ...]
    driven_m: tuple[float, ...]
    over_s: float | None
    poses: Mapping[str, Pose2]
    fired_s: float
    tracks: Mapping[str, FloatArray]
    course: tuple[tuple[float, float], ...]

    def approach(self, nominal: Ramp, start_s: float) -> Ramp:
        """Stretch the initiator's first ramp so that it is where it is in the session at firing.

        Args:
            nominal: from standstill, as planned.
            start_s: when a player begins it, s after the start.
        """
        if self.fired_s < start_s + nominal.duration_s + _SETTLED_S:
            return nominal
        lacking = nominal.to_mps * (self.fired_s - start_s) - self.driven_m_of_initiator(
            self.fired_s
        )
        return Ramp(nominal.to_mps, round(max(2.0 * lacking / nominal.to_mps, _LEAST_S), 3))

    def act(self, from_mps: float, nominal: Ramp, start_s: float) -> Ramp:
        """Stretch a ramp of the initiator's act so that it covers the session's distance.

        A session rounds its ramps, and its objects follow them with a lag.

        Args:
            from_mps: speed at which it begins.
            nominal: as planned.
            start_s: when a player begins it, s after the trigger fires.
        """
        start_s += self.fired_s
        end_s = start_s + nominal.duration_s + _SETTLED_S
        change = from_mps - nominal.to_mps
        if abs(change) < SAME_MPS or self.course[-1][0] < end_s:
            return nominal
        beyond_m = self.driven_m_of_initiator(end_s) - self.driven_m_of_initiator(start_s)
        beyond_m -= nominal.to_mps * (end_s - start_s)
        return Ramp(nominal.to_mps, round(max(2.0 * beyond_m / change, nominal.duration_s), 3))

    def session_ramp(self, nominal: Ramp, start_s: float, until_m: float) -> Ramp:
        """Return a ramp of the initiator's act to the mean speed that it then keeps in the session.

        A session plays the act a little slower or faster where it adapts it to the VUT.

        Args:
            nominal: as planned, from standstill.
            start_s: when a player begins it, s after the trigger fires.
            until_m: distance driven, since then, up to which the speed is kept.
        """
        start_s += self.fired_s
        end_s = start_s + nominal.duration_s + _SETTLED_S
        from_m = self.driven_m_of_initiator(end_s)
        over_s = self.course[-1][0] if self.over_s is None else self.over_s
        last_m = min(
            self.driven_m_of_initiator(over_s), self.driven_m_of_initiator(start_s) + until_m
        )
        times, driven_m = zip(*self.course, strict=True)
        lasts_s = float(np.interp(last_m, driven_m, times)) - end_s
        if lasts_s < _SETTLED_S:
            return nominal
        return replace(nominal, to_mps=round((last_m - from_m) / lasts_s, 3))

    def driven_m_of_initiator(self, at_s: float) -> float:
        """Return the distance that the initiator has driven at a time, m."""
        times, driven_m = zip(*self.course, strict=True)
        return float(np.interp(at_s, times, driven_m))


def foresee(run: RunSpec) -> ForeseenSession:
    """Run a session in this process, with its driver's reaction.

    Raises:
        InputError: its trigger never fires.
    """
    result, record = driven(run)
    if not result.triggers:
        raise InputError(
            f"its trigger never fires: {condition_text(run.triggers[0].condition)}",
            field="run.triggers[0]",
            remedy="compile the event for a place with a longer run-up, or change its trigger",
        )
    vut = record.truths(run.vut.id)
    over_s = _over_s(run, result, ns_to_seconds(vut[-1].stamp_ns))
    samples = [
        (t, state.speed_mps, driven_m)
        for state, (t, driven_m) in zip(vut, _course(vut), strict=True)
        if t > 0.0 and (over_s is None or t <= over_s)
    ]
    fired_ns = result.triggers[0].crossing_ns
    initiator = record.truths(run.initiator_id)
    return ForeseenSession(
        speeds=((0.0, 0.0), *((t, v) for t, v, _ in samples)),
        driven_m=(0.0, *(driven_m for _, _, driven_m in samples)),
        over_s=over_s,
        poses={
            who.id: _pose_at(record.truths(who.id), fired_ns) for who in (run.vut, *run.targets)
        },
        fired_s=ns_to_seconds(fired_ns),
        tracks={run.vut.id: _track(vut), run.initiator_id: _track(initiator)},
        course=_course(initiator),
    )


def _over_s(run: RunSpec, result: InProcessResult, ended_s: float) -> float | None:
    """Return when the session is over, s after the start; None where nothing was resolved.

    Args:
        run: the compiled run.
        result: of the session.
        ended_s: when the session ended. True states may resolve the event later, or never, where a
            conflict comes back: then it counts when the session announced the resolution.
    """
    announced = (p.stamp_ns for p in result.happened.phases if p.phase is Phase.RESOLUTION)
    after_s = RESOLUTION_CONFIRMATION_S + run.end.after_resolution_s
    over_s = result.phase_s(Phase.RESOLUTION)
    if over_s is None or over_s + after_s > ended_s:
        over_s = next(map(ns_to_seconds, announced), None)
    return None if over_s is None else over_s + after_s


def _pose_at(states: Sequence[ObjectState], at_ns: int) -> Pose2:
    """Interpolate the pose at a time; the first or last one outside of all."""
    for a, b in pairwise(states):
        if at_ns <= b.stamp_ns:
            share = max(0.0, (at_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns))
            return Pose2(
                a.x_m + share * (b.x_m - a.x_m),
                a.y_m + share * (b.y_m - a.y_m),
                a.yaw_rad + share * wrap_angle(b.yaw_rad - a.yaw_rad),
            )
    return states[-1].pose


def _track(states: Sequence[ObjectState]) -> FloatArray:
    rows = [(ns_to_seconds(s.stamp_ns), s.x_m, s.y_m, s.yaw_rad) for s in states]
    return np.array(rows)


def _course(states: Sequence[ObjectState]) -> tuple[tuple[float, float], ...]:
    """Return (t in s, distance driven in m) since the start."""
    steps = [math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in pairwise(states)]
    driven_m = [0.0, *itertools.accumulate(steps)]
    return tuple((ns_to_seconds(s.stamp_ns), d) for s, d in zip(states, driven_m, strict=True))


def gaps_m(run: RunSpec, tracks: Mapping[str, FloatArray], times: FloatArray) -> FloatArray:
    """Measure the gap between VUT and initiator at times, m.

    To an initiator that drives it is the bumper gap along the VUT's path, negative behind; to one
    that stands until the trigger fires, the distance between both bodies.

    Args:
        run: the compiled run.
        tracks: per object rows of (t, x, y, yaw), as in ``ForeseenSession``.
        times: s, shape (n,).
    """
    other = next(t for t in run.targets if t.id == run.initiator_id)
    poses = []
    for who in (run.vut, other):
        track = tracks[who.id]
        yaw = np.unwrap(track[:, 3])
        columns = [np.interp(times, track[:, 0], c) for c in (track[:, 1], track[:, 2], yaw)]
        poses.append([Pose2(*map(float, row)) for row in zip(*columns, strict=True)])
    if other.approach is None or run.vut.approach is None:
        boxes = [
            [Box(pose, who.size.front_m, who.size.rear_m, who.size.width_m) for pose in own_poses]
            for who, own_poses in zip((run.vut, other), poses, strict=True)
        ]
        return np.array([box_distance(a, b) for a, b in zip(*boxes, strict=True)])
    path = Polyline(run.vut.approach.path)
    here, there = (
        np.array([s for s, _ in path.project_all_beyond([(p.x_m, p.y_m) for p in own_poses])])
        for own_poses in poses
    )
    gaps: FloatArray = there - other.size.rear_m - here - run.vut.size.front_m
    return gaps


def shorter_m(run: RunSpec, session: ForeseenSession, other: ParticipantSpec) -> float:
    """Compute by how much a player's bumper gap is less than a session's when the trigger fires, m.

    A session measures along the VUT's path. A player measures along the VUT's heading, from its
    front to the nearest corner of the other: in a bend less.
    """
    if run.vut.approach is None:
        raise ValueError("the VUT has no path")
    path, vut, there = (
        Polyline(run.vut.approach.path),
        session.poses[run.vut.id],
        session.poses[other.id],
    )
    ahead, _ = path.project_beyond(there.x_m, there.y_m)
    here, _ = path.project_beyond(vut.x_m, vut.y_m)
    size = other.size
    corners = [
        vut.to_local(*there.to_parent(-size.rear_m, side * size.width_m / 2)) for side in (-1, 1)
    ]
    return (ahead - size.rear_m - here) - min(x for x, _ in corners)


def straight_share(run: RunSpec, session: ForeseenSession, anchor: tuple[float, float]) -> float:
    """Return a player's distance to an anchor, straight, over a session's, along the VUT's path.

    Args:
        run: the compiled run.
        session: the session that is foreseen.
        anchor: that the VUT's front reaches, frame map.
    """
    if run.vut.approach is None:
        raise ValueError("the VUT has no path")
    path, vut = Polyline(run.vut.approach.path), session.poses[run.vut.id]
    there = path.project(*anchor)[0] - run.vut.size.front_m
    here = path.project(vut.x_m, vut.y_m)[0]
    place = path.pose(there)
    return math.dist((place.x_m, place.y_m), (vut.x_m, vut.y_m)) / (there - here)
