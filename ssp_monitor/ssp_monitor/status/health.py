"""The health of a session: what is in the way of arming, and what /diagnostics says of parts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core import names
from ssp_core.motion.state import ObjectState
from ssp_core.node_interface import Level, Status
from ssp_core.run_file.model import Limits
from ssp_core.safety import limits as judge
from ssp_core.safety.arming import (
    ARM_AGAIN_S,
    ARM_FAILED,
    Facts,
    Gate,
    obstacles,
    recorder_lacks,
    recorder_obstacles,
    refusal_of,
)
from ssp_core.safety.body_status import known_bodies
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.liveness import ADAPTER_SILENT_S, RECORDER_SILENT_S
from ssp_core.safety.publishers import known_strangers
from ssp_core.safety.start_heading import UNKNOWN_AT_REST
from ssp_core.vocabulary import ControlState, Role, SessionPhase, Verdict
from ssp_monitor.status.board import (
    DEFAULT_STATE_AGE_S,
    STALE_S,
    Board,
    LatestState,
    LinkFact,
    RecorderFact,
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
    """List every obstacle, as sentences, by the rules that the manager arms by.

    The list is empty once the session is past its start.
    """
    session = board.session.state
    if session not in _BEFORE_START:
        return []
    problems = []
    if board.manager.silent_s(now_ns) > STALE_S:
        problems.append("the scenario manager is silent")
    if session in (SessionPhase.UNKNOWN, SessionPhase.IDLE):
        problems.append("no run is loaded")
    run, facts = board.run, _facts(board, now_ns)
    if run is None:
        present_obstacles = [*recorder_obstacles(facts)]
    else:
        gate = Gate.START if session is SessionPhase.ARMED else Gate.ARM
        states = {
            object_id: latest_state.state for object_id, latest_state in board.objects.items()
        }
        vut = states.pop(run.vut.id, None)
        present_obstacles = obstacles(gate, run, facts, vut, states, _session_ns(board, now_ns))
        # What concerns the whole session first: a page shows a few of many.
        present_obstacles.sort(key=lambda obstacle: obstacle.who in run.object_ids)
    return problems + [obstacle.text for obstacle in present_obstacles]


def _facts(board: Board, now_ns: int) -> Facts:
    """Collect the facts heard, as the manager's rules ask for them."""
    run, recorder = board.run, board.recorder.value or RecorderFact(ready=False)
    ages_s = {who: age_s(now_ns, latest_state.at_ns) for who, latest_state in board.objects.items()}
    ages_s[names.MONITOR] = board.recorder.age_s(now_ns)
    ages_s[names.FRONT_CAMERA] = board.camera.age_s(now_ns)
    if run is not None:
        # Of a simulated world the states of the VUT are the sign.
        for who in (names.VUT_ID, names.SIL_WORLD):
            ages_s[who] = ages_s.get(run.vut.id, math.inf)
    live = run is not None and run.mode == "live"
    ids = [target.id for target in run.targets] if run is not None else []
    adapted = board.vut_refused.age_s(now_ns) <= ADAPTER_SILENT_S
    strangers = _strangers(board, recorder, now_ns)
    return Facts(
        ages_s=ages_s,
        # What is measured was answered within the last second, and how long ago isn't told.
        links={
            who: LinkEstimate(link.offset_s, link.delay_s, 0.0)
            for who, link in links_of(board, now_ns).items()
            if math.isfinite(link.delay_s)
        },
        rules=board.rules.checks(run) if run is not None else {},
        recorder_ready=recorder.ready,
        recorder_missing=recorder_lacks(recorder.missing, recorder.failure, recorder.warnings),
        recorder_lost=recorder.lost,
        vut_refused=board.vut_refused.value if adapted else "",
        motion=board.motion,
        other_managers=len(strangers),
        foreign="; ".join(strangers),
        bodies=known_bodies(ids, board.bodies, now_ns) if live else {},
        refusals=_refusals(board, now_ns),
    )


def _strangers(board: Board, recorder: RecorderFact, now_ns: int) -> tuple[str, ...]:
    """Return the strangers that the manager finds in the graph and the recorder in messages."""
    graph_strangers = board.manager.strangers
    return known_strangers(graph_strangers.value, graph_strangers.age_s(now_ns), recorder.strangers)


def _refusals(board: Board, now_ns: int) -> dict[str, str]:
    """Return the refusal that the newest transition names, while the manager counts it."""
    session = board.session
    fact = session.fact
    if fact is None or fact.event != ARM_FAILED or age_s(now_ns, session.at_ns) > ARM_AGAIN_S:
        return {}
    return refusal_of(fact.reason)


def _session_ns(board: Board, now_ns: int) -> int:
    """Return session time, ns.

    In a live session it goes on after the manager's last word of it; a simulated world stands still
    before the start.
    """
    stamp_ns, heard_ns = board.manager.stamp_ns, board.manager.at_ns
    if stamp_ns is None:
        return max(
            (latest_state.state.stamp_ns for latest_state in board.objects.values()), default=0
        )
    live = board.run is not None and board.run.mode == "live"
    return stamp_ns + (now_ns - heard_ns if live and heard_ns is not None else 0)


def not_armed(board: Board) -> list[str]:
    """Return objects of the run that don't report that they are armed."""
    run, latest_states = board.run, board.objects
    return [
        target.id
        for target in (run.targets if run is not None else ())
        if target.id not in latest_states
        or latest_states[target.id].state.control_state is not ControlState.ARMED
    ]


CLOCK_STANDS_S = 1.0


_REPLAY = Status("ssp: replay", "replay", Level.WARN, "a bag is replayed: nothing of this is live")


@dataclass(slots=True)
class ClockWatch:
    """The clock of the session: the newest stamp, and when it last changed."""

    stamp_ns: int | None = None
    changed_at_ns: int = 0

    def see(self, stamp_ns: int | None, now_ns: int) -> None:
        """Take the newest stamp as it is now; a replay that begins again may go back."""
        if stamp_ns is not None and stamp_ns != self.stamp_ns:
            self.stamp_ns, self.changed_at_ns = stamp_ns, now_ns


def health(board: Board, clock: ClockWatch, now_ns: int) -> tuple[Status, ...]:
    """Return the status of recorder, session, clock and each object.

    The objects are those that the run names and those that were heard.

    Args:
        board: what was heard.
        clock: of session time.
        now_ns: on the steady clock.
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
    fact, name = board.recorder.value, "ssp: recorder"
    if fact is None:
        return Status(name, "monitor", Level.STALE, "no recorder was heard")
    silent_s = board.recorder.age_s(now_ns)
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
    if silent_s > RECORDER_SILENT_S:
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
    fact, name, part = board.session.fact, "ssp: session", "scenario_manager"
    if fact is None:
        return Status(name, part, Level.STALE, "no session was heard")
    in_the_way = standing_in_the_way(board, now_ns)
    values = (
        ("state", fact.state.name),
        ("run", fact.run_id),
        ("scenario", fact.scenario),
        ("phase", board.session.phase.name),
        ("verdict", fact.verdict.name),
        ("reasons", "; ".join(fact.reasons)),
        ("in the way of arming", "; ".join(in_the_way)),
    )
    silent_s = board.manager.silent_s(now_ns)
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
    running = board.session.state is SessionPhase.RUNNING
    if stands_s <= CLOCK_STANDS_S:
        return Status(name, "session time", Level.OK, "session time goes on", values)
    level = Level.ERROR if running else Level.WARN
    return Status(name, "session time", level, f"has stood for {stands_s:.1f} s", values)


def _object(board: Board, object_id: str, now_ns: int) -> Status:
    name = f"ssp: object {object_id}"
    latest_state = board.objects.get(object_id)
    if latest_state is None:
        return Status(name, object_id, Level.STALE, "was never heard")
    limits = board.run.limits if board.run is not None else None
    link = links_of(board, now_ns).get(object_id, LinkFact())
    old_s = object_age_s(board, latest_state, now_ns)
    level, message = _judgement(latest_state, link, limits, old_s)
    state = latest_state.state
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


def _off_reference(state: ObjectState, limits: Limits) -> str:
    """Say which tracking error is over its limit or no number; empty: none is."""
    tracking_errors = (
        ("ahead", "m", judge.error_longitudinal(state.error_longitudinal_m, limits)),
        ("to the left", "m", judge.error_lateral(state.error_lateral_m, limits)),
        ("of the heading", "rad", judge.error_yaw(state.error_yaw_rad, limits)),
    )
    for where, unit, passed in tracking_errors:
        if passed is None:
            continue
        if not math.isfinite(passed.measured):
            return f"tracking error {where} is no number"
        return f"tracking error {where} is {passed.measured:.2f} {unit}, over {passed.limit:g}"
    return ""


def _judgement(
    latest_state: LatestState, link: LinkFact, limits: Limits | None, old_s: float
) -> tuple[Level, str]:
    """Return the worst that is known of an object; what makes the rest meaningless goes first."""
    state = latest_state.state
    if old_s > STALE_S:
        return Level.STALE, f"silent for {old_s:.1f} s"
    if not state.is_finite:
        return Level.ERROR, "its state is no number"
    age_limit_s = limits.state_age_s if limits is not None else DEFAULT_STATE_AGE_S
    if not old_s <= age_limit_s:
        return Level.ERROR, f"its state is {old_s:.2f} s old, over {age_limit_s:g} s"
    if state.control_state is ControlState.ABORTING:
        return Level.ERROR, "is aborting"
    well = state.control_state.name if state.role is Role.OT else "heard"
    if limits is None:
        return Level.OK, well
    if state.reference_id and (off := _off_reference(state, limits)):
        return Level.ERROR, off
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
