"""What stands in the way of arming, as far as the page sees it from the topics.

The manager alone decides, when it is asked to arm, and its answer is shown word for word. This list
is for the time before: the same measurements against the same limits of the run.
"""

from __future__ import annotations

import math

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.fence import box_excess_m
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_monitor.status.board import Board, LinkFact, age_s, links_of, object_age_s

FRESH_S = 1.0
RECORDER_FRESH_S = 2.0
CAMERA_FRESH_S = 3.0
STANDSTILL_MPS = 0.05
_BEFORE_START = (
    SessionPhase.UNKNOWN,
    SessionPhase.IDLE,
    SessionPhase.LOADED,
    SessionPhase.CONNECTED,
    SessionPhase.ARMED,
)


def standing_in_the_way(board: Board, now_ns: int) -> list[str]:
    """Everything, as sentences; empty once the session is past its start.

    Args:
        board: what was heard.
        now_ns: steady clock.
    """
    session = board.session.state if board.session is not None else SessionPhase.UNKNOWN
    if session not in _BEFORE_START:
        return []
    problems = []
    if age_s(now_ns, board.manager_at_ns) > FRESH_S:
        problems.append("the scenario manager is silent")
    if session in (SessionPhase.UNKNOWN, SessionPhase.IDLE):
        problems.append("no run is loaded")
    problems += _recorder(board, now_ns)
    run = board.run
    if run is None:
        return problems
    if run.camera is not None and age_s(now_ns, board.camera_at_ns) > CAMERA_FRESH_S:
        problems.append("no camera picture arrives")
    for participant in (run.vut, *run.targets):
        problems += _participant(board, run, participant, session, now_ns)
    return problems


def _recorder(board: Board, now_ns: int) -> list[str]:
    recorder = board.recorder
    if recorder is None or age_s(now_ns, board.recorder_at_ns) > RECORDER_FRESH_S:
        return ["the recorder is silent"]
    if recorder.failure:
        return [f"the recorder has failed: {recorder.failure}"]
    if not recorder.ready:
        return [f"the recorder is not ready: {', '.join(recorder.missing) or 'no open file'}"]
    if recorder.lost:
        return [f"the recorder has lost {recorder.lost} messages, limit 0"]
    return []


def _participant(
    board: Board, run: RunSpec, who: ParticipantSpec, session: SessionPhase, now_ns: int
) -> list[str]:
    heard = board.objects.get(who.id)
    if heard is None:
        return [f"no state of {who.id} arrives"]
    silent_s = object_age_s(board, heard, now_ns)
    if silent_s > FRESH_S:
        return [f"no state of {who.id} for {silent_s:.1f} s, limit {FRESH_S:g} s"]
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
    problems = []
    if (delay := judge.link_delay(link.delay_s, run.limits)) is not None:
        problems.append(
            f"the link to {object_id} takes {delay.measured:.3f} s, limit {delay.limit:g} s"
        )
    if (offset := judge.clock_offset(link.offset_s, run.limits)) is not None:
        problems.append(
            f"the clock of {object_id} is off by {offset.measured:.3f} s, limit {offset.limit:g} s"
        )
    return problems


def _place(state: ObjectState, who: ParticipantSpec, run: RunSpec) -> list[str]:
    if not state.is_finite:
        return [f"{who.id} has a state with a value that is no number"]
    problems = []
    away_m = math.hypot(state.x_m - who.start.x_m, state.y_m - who.start.y_m)
    if away_m > run.limits.start_region_m:
        problems.append(
            f"{who.id} is {away_m:.2f} m from its start, limit {run.limits.start_region_m:g} m"
        )
    if abs(state.speed_mps) > STANDSTILL_MPS:
        problems.append(
            f"{who.id} moves at {state.speed_mps:.2f} m/s, limit {STANDSTILL_MPS:g} m/s"
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
