"""The health of a session: what is in the way of arming, and what /diagnostics says of parts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.motion.state import ObjectState
from ssp_core.node_interface import Level, Status
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety import limits as judge
from ssp_core.safety import liveness
from ssp_core.safety.body_status import FORGOTTEN_S, BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_core.vocabulary import ControlState, Role, SessionPhase, Verdict
from ssp_monitor.status.board import (
    DEFAULT_STATE_AGE_S,
    STALE_S,
    Board,
    LinkFact,
    Received,
    age_s,
    links_of,
    object_age_s,
)

_BEFORE_START = (
    SessionPhase.UNKNOWN,
    SessionPhase.IDLE,
    SessionPhase.LOADED,
    SessionPhase.CONNECTED,
    SessionPhase.ARMED,
)


def standing_in_the_way(board: Board, now_ns: int) -> list[str]:
    """Everything, as sentences; empty once the session is past its start."""
    session = board.session.state if board.session is not None else SessionPhase.UNKNOWN
    if session not in _BEFORE_START:
        return []
    problems = []
    if age_s(now_ns, board.manager_at_ns) > STALE_S:
        problems.append("the scenario manager is silent")
    if session in (SessionPhase.UNKNOWN, SessionPhase.IDLE):
        problems.append("no run is loaded")
    problems += _recorder_problems(board, now_ns)
    run = board.run
    if run is None:
        return problems
    if run.camera is not None and age_s(now_ns, board.camera_at_ns) > liveness.CAMERA_SILENT_S:
        problems.append("no camera picture arrives")
    if board.vut_refused and age_s(now_ns, board.vut_refused_at_ns) <= liveness.ADAPTER_SILENT_S:
        problems.append(f"the VUT's GNSS/INS gives no state: {board.vut_refused}")
    bodies = _bodies(board, run, now_ns)
    problems += [one.problem for one in board.rules.checks(run).values() if one.problem]
    for participant in (run.vut, *run.targets):
        body = bodies.get(participant.id, BodyStatus(participant.id))
        problems += _participant(board, run, participant, session, body, now_ns)
        others = (text for text in body.cannot_arm if text not in body.no_state)
        problems += [f"{participant.id}: {text}" for text in others]
    return problems


def not_armed(board: Board) -> list[str]:
    """Objects of the run that don't report that they are armed."""
    run, heard = board.run, board.objects
    return [
        target.id
        for target in (run.targets if run is not None else ())
        if target.id not in heard or heard[target.id].state.control_state is not ControlState.ARMED
    ]


def _bodies(board: Board, run: RunSpec, now_ns: int) -> dict[str, BodyStatus]:
    """What the processes of live objects have said of late."""
    fresh = {
        object_id: status
        for object_id, (status, at_ns) in board.bodies.items()
        if age_s(now_ns, at_ns) <= FORGOTTEN_S
    }
    return {target.id: fresh[target.id] for target in run.targets if target.id in fresh}


def _recorder_problems(board: Board, now_ns: int) -> list[str]:
    recorder = board.recorder
    if recorder is None or age_s(now_ns, board.recorder_at_ns) > liveness.RECORDER_SILENT_S:
        return ["the recorder is silent"]
    if recorder.failure:
        return [f"the recorder has failed: {recorder.failure}"]
    if not recorder.ready:
        return [f"the recorder is not ready: {', '.join(recorder.missing) or 'no open file'}"]
    if recorder.lost:
        return [f"the recorder has lost {recorder.lost} messages, limit 0"]
    return []


def _participant(
    board: Board,
    run: RunSpec,
    who: ParticipantSpec,
    session: SessionPhase,
    body: BodyStatus,
    now_ns: int,
) -> list[str]:
    heard = board.objects.get(who.id)
    why = f": {'; '.join(body.no_state)}" if body.no_state else ""
    if heard is None:
        return [f"no state of {who.id} arrives{why}"]
    silent_s = object_age_s(board, heard, now_ns)
    if silent_s > STALE_S:
        return [f"no state of {who.id} for {silent_s:.1f} s, limit {STALE_S:g} s{why}"]
    problems = []
    if who is not run.vut:
        problems += _link(who.id, links_of(board, now_ns).get(who.id, LinkFact()), run)
        wanted = (
            (ControlState.ARMED,)
            if session is SessionPhase.ARMED
            else (ControlState.DISARMED, ControlState.ARMED)
        )
        if session >= SessionPhase.CONNECTED and heard.state.control_state not in wanted:
            names = " or ".join(one.name for one in wanted)
            problems.append(f"{who.id} is {heard.state.control_state.name}, not {names}")
    return problems + _place(heard.state, who, run)


def _link(object_id: str, link: LinkFact, run: RunSpec) -> list[str]:
    if not math.isfinite(link.delay_s):
        return [f"the link to {object_id} is not measured yet"]
    words = {
        SafetyCode.LINK_DELAY: f"the link to {object_id} takes",
        SafetyCode.CLOCK_OFFSET: f"the clock of {object_id} is off by",
    }
    return [
        f"{words[one.code]} {one.measured:.3f} s, limit {one.limit:g} s"
        for one in judge.link_violations(link.offset_s, link.delay_s, run.limits)
    ]


def _place(state: ObjectState, who: ParticipantSpec, run: RunSpec) -> list[str]:
    if not state.is_finite:
        return [f"{who.id} has a state with a value that is no number"]
    problems = []
    away_m = math.hypot(state.x_m - who.start.x_m, state.y_m - who.start.y_m)
    if away_m > run.limits.start_region_m:
        problems.append(
            f"{who.id} is {away_m:.2f} m from its start, limit {run.limits.start_region_m:g} m"
        )
    if abs(state.speed_mps) > judge.STANDSTILL_MPS:
        problems.append(
            f"{who.id} moves at {state.speed_mps:.2f} m/s, limit {judge.STANDSTILL_MPS:g} m/s"
        )
    outside = judge.outside_geofence(box_excess_m(state.box, run.geofence))
    if outside is not None:
        problems.append(f"{who.id} is outside the geofence by {outside.measured:.2f} m")
    if (vague := judge.localisation(state, run.limits)) is not None:
        problems.append(
            f"the position of {who.id} is uncertain by {vague.measured:.2f} m, "
            f"limit {vague.limit:g} m"
        )
    return problems


CLOCK_STANDS_S = 1.0


_REPLAY = Status("ssp: replay", "replay", Level.WARN, "a bag is replayed: nothing of this is live")


@dataclass(slots=True)
class ClockWatch:
    """Whether session time goes on: the newest stamp, and when it last changed."""

    stamp_ns: int | None = None
    changed_at_ns: int = 0

    def see(self, stamp_ns: int | None, now_ns: int) -> None:
        """The newest stamp as it is now; a replay that begins again may go back."""
        if stamp_ns is not None and stamp_ns != self.stamp_ns:
            self.stamp_ns, self.changed_at_ns = stamp_ns, now_ns


def health(board: Board, clock: ClockWatch, now_ns: int) -> tuple[Status, ...]:
    """Recorder, session, clock, and each object that the run names or that was heard.

    Args:
        clock: of session time.
    """
    objects = dict.fromkeys([*(board.run.object_ids if board.run else ()), *sorted(board.objects)])
    return (
        _recorder(board, now_ns),
        _session(board, now_ns),
        _clock(board, clock, now_ns),
        *(_object(board, object_id, now_ns) for object_id in objects),
        *([_REPLAY] if board.replay else []),
    )


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "unknown"


def _recorder(board: Board, now_ns: int) -> Status:
    fact, name = board.recorder, "ssp: recorder"
    if fact is None:
        return Status(name, "monitor", Level.STALE, "no recorder was heard")
    silent_s = age_s(now_ns, board.recorder_at_ns)
    values = (
        ("bag", fact.bag),
        ("messages", str(fact.messages)),
        ("bytes", str(fact.bytes)),
        ("lost", str(fact.lost)),
        ("dropped", str(fact.dropped)),
        ("files", str(fact.files)),
        ("waiting bytes", str(fact.queue_bytes)),
        ("free bytes", str(fact.free_bytes)),
        ("disk left, s", _number(fact.disk_left_s, 0)),
        ("age of the last flush, s", _number(fact.flush_age_s, 2)),
        ("missing topics", ", ".join(fact.missing)),
    )
    if silent_s > liveness.RECORDER_SILENT_S:
        level, message = Level.STALE, f"silent for {silent_s:.1f} s"
    elif fact.failure:
        level, message = Level.ERROR, f"nothing is recorded any more: {fact.failure}"
    elif fact.lost or fact.dropped:
        level, message = Level.ERROR, f"{fact.lost} messages lost, {fact.dropped} of them dropped"
    elif not fact.ready:
        level, message = Level.WARN, f"not ready, missing: {', '.join(fact.missing)}"
    elif fact.warnings:
        level, message = Level.WARN, fact.warnings[0]
    else:
        level, message = Level.OK, f"recording {fact.bag}"
    return Status(name, "monitor", level, message, values)


def _session(board: Board, now_ns: int) -> Status:
    fact, name, part = board.session, "ssp: session", "scenario_manager"
    if fact is None:
        return Status(name, part, Level.STALE, "no session was heard")
    in_the_way = standing_in_the_way(board, now_ns)
    values = (
        ("state", fact.state.name),
        ("run", fact.run_id),
        ("scenario", fact.scenario),
        ("phase", board.phase.name),
        ("verdict", fact.verdict.name),
        ("reasons", "; ".join(fact.reasons)),
        ("in the way of arming", "; ".join(in_the_way)),
    )
    silent_s = age_s(now_ns, board.manager_at_ns)
    why = f": {fact.reason}" if fact.reason else ""
    if fact.state in (SessionPhase.ABORTING, SessionPhase.ABORTED):
        level, message = Level.ERROR, f"{fact.state.name}{why}"
    elif fact.verdict not in (Verdict.NONE, Verdict.VALID):
        level, message = Level.ERROR, f"{fact.state.name}, {fact.verdict.name}{why}"
    elif silent_s > STALE_S:
        for_s = "" if math.isinf(silent_s) else f" for {silent_s:.1f} s"
        level, message = Level.STALE, f"{fact.state.name}; the scenario manager is silent{for_s}"
    elif in_the_way:
        level, message = Level.WARN, f"{fact.state.name}; {in_the_way[0]}"
    else:
        level, message = Level.OK, fact.state.name
    return Status(name, part, level, message, values)


def _clock(board: Board, clock: ClockWatch, now_ns: int) -> Status:
    name = "ssp: clock"
    if clock.stamp_ns is None:
        return Status(name, "session time", Level.STALE, "no session time was heard")
    stands_s = age_s(now_ns, clock.changed_at_ns)
    values = (
        ("session time, s", _number(clock.stamp_ns / 1e9)),
        ("unchanged for, s", _number(stands_s, 2)),
    )
    running = board.session is not None and board.session.state is SessionPhase.RUNNING
    if stands_s <= CLOCK_STANDS_S:
        return Status(name, "session time", Level.OK, "session time goes on", values)
    level = Level.ERROR if running else Level.WARN
    return Status(name, "session time", level, f"has stood for {stands_s:.1f} s", values)


def _object(board: Board, object_id: str, now_ns: int) -> Status:
    name = f"ssp: object {object_id}"
    heard = board.objects.get(object_id)
    if heard is None:
        return Status(name, object_id, Level.STALE, "was never heard")
    limits = board.run.limits if board.run is not None else None
    link = links_of(board, now_ns).get(object_id, LinkFact())
    old_s = object_age_s(board, heard, now_ns)
    level, message = _judged(heard, link, limits, old_s)
    state = heard.state
    values = (
        ("control state", "" if state.role is Role.TRAFFIC else state.control_state.name),
        ("state age, s", _number(old_s)),
        ("speed, m/s", _number(state.speed_mps, 2)),
        ("tracking error ahead, m", _number(state.error_longitudinal_m)),
        ("tracking error left, m", _number(state.error_lateral_m)),
        ("tracking error yaw, rad", _number(state.error_yaw_rad, 4)),
        ("position one sigma, m", _number(state.position_std_m)),
        ("link there and back, s", _number(link.delay_s, 4)),
        ("clock offset, s", _number(link.offset_s, 4)),
        ("states lost", str(link.lost)),
        ("its own stricter limits", "; ".join(_stricter(board, object_id))),
        ("heading at rest", _heading_at_rest(limits, object_id)),
    )
    return Status(name, object_id, level, message, values)


def _heading_at_rest(limits: Limits | None, object_id: str) -> str:
    by_course = limits is not None and object_id in limits.heading_by_course
    return UNKNOWN_AT_REST if by_course else ""


def _stricter(board: Board, object_id: str) -> tuple[str, ...]:
    rules = {} if board.run is None else board.rules.checks(board.run)
    return rules[object_id].stricter if object_id in rules else ()


def _judged(
    heard: Received, link: LinkFact, limits: Limits | None, old_s: float
) -> tuple[Level, str]:
    """The worst that is known of an object, first what makes everything else meaningless."""
    state = heard.state
    if old_s > STALE_S:
        return Level.STALE, f"silent for {old_s:.1f} s"
    if not state.is_finite:
        return Level.ERROR, "its state is no number"
    age_limit_s = limits.state_age_s if limits is not None else DEFAULT_STATE_AGE_S
    if old_s > age_limit_s:
        return Level.ERROR, f"its state is {old_s:.2f} s old, over {age_limit_s:g} s"
    if state.control_state is ControlState.ABORTING:
        return Level.ERROR, "is aborting"
    well = state.control_state.name if state.role is Role.OT else "heard"
    if limits is None:
        return Level.OK, well
    measured = (
        ("ahead", state.error_longitudinal_m, limits.error_longitudinal_m, "m", Level.ERROR),
        ("to the left", state.error_lateral_m, limits.error_lateral_m, "m", Level.ERROR),
        ("of the heading", state.error_yaw_rad, limits.error_yaw_rad, "rad", Level.ERROR),
    )
    if state.reference_id:
        for where, value, limit, unit, level in measured:
            if abs(value) > limit:
                return level, f"tracking error {where} is {value:.2f} {unit}, over {limit:g}"
    bad = (
        judge.link_violations(link.offset_s, link.delay_s, limits)
        if math.isfinite(link.delay_s)
        else []
    )
    for one in bad:
        if one.code is SafetyCode.LINK_DELAY:
            return Level.WARN, f"its link takes {one.measured:.3f} s, over {one.limit:g} s"
        return Level.WARN, f"its clock is {one.measured:.3f} s off, over {one.limit:g}"
    return Level.OK, well
