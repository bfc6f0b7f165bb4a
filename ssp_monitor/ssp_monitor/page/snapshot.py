"""The page's content as JSON values: the site once, snapshots of the session, and its camera."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ssp_core.geometry import Polyline, box_distance
from ssp_core.motion.encounter import Encounter, encounter
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.values import Point
from ssp_core.run_file.verdict import EndWord
from ssp_core.safety import limits as judge
from ssp_core.vocabulary import ControlState, Phase, Role, SessionPhase
from ssp_core.world.road_drawing import Drawing, drawing_of
from ssp_monitor.page.ending import end_of, verdict_of
from ssp_monitor.status.board import (
    DEFAULT_STATE_AGE_S,
    STALE_S,
    Board,
    Event,
    LatestReport,
    LatestState,
    LinkFact,
    RecorderFact,
    StateOnPage,
    age_s,
    links_of,
    object_age_s,
)
from ssp_monitor.status.health import not_armed, standing_in_the_way
from ssp_monitor.status.messages import jpeg_of

# Which commands a session takes in which state; the manager has the last word.
COMMANDS: dict[SessionPhase, tuple[str, ...]] = {
    SessionPhase.UNKNOWN: (),
    SessionPhase.IDLE: (),
    SessionPhase.LOADED: ("connect", "reset"),
    SessionPhase.CONNECTED: ("arm", "reset"),
    SessionPhase.ARMED: ("disarm", "start"),
    SessionPhase.RUNNING: ("stop",),
    SessionPhase.STOPPING: (),
    SessionPhase.FINISHED: ("reset",),
    SessionPhase.ABORTING: (),
    SessionPhase.ABORTED: ("all_clear",),
}

# What a person does next in each state; the manager has the last word here, too.
NEXT: dict[SessionPhase, str] = {
    SessionPhase.UNKNOWN: "start the scenario manager: nothing was heard of a session",
    SessionPhase.IDLE: "load a run: ssp run, or the service load_scenario",
    SessionPhase.LOADED: "type start in the terminal of ssp run, or press connect here",
    SessionPhase.CONNECTED: "arm, once nothing below prevents it",
    SessionPhase.ARMED: "start, when everybody is clear; objects drive then. Disarm goes back",
    SessionPhase.RUNNING: "watch; ABORT stops everybody at once, stop ends the run in order",
    SessionPhase.STOPPING: "wait until everything stands",
    SessionPhase.FINISHED: "over: reset for another run",
    SessionPhase.ABORTING: "wait until everything stands",
    SessionPhase.ABORTED: "all clear, once you have seen that everything stands",
}

# A session is ARMED once its objects were told to arm. Until all report that they are, each may
# still refuse, and people are told so.
ARMING = "ARMING"
NEXT_WHILE_ARMING = "wait until every object reports that it is armed. Disarm goes back"

_DIGITS = re.compile(r"(\d+)")


def number(value: float, digits: int = 3) -> float | None:
    """Round for JSON; NaN and infinity, which it doesn't have, become None."""
    return round(value, digits) if math.isfinite(value) else None


class Snapshots:
    """Makes snapshots of a board.

    Attributes:
        word: how the run ends, once its runner has sent it.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self.word: EndWord | None = None
        self._frozen: dict[str, Any] | None = None
        run = board.run
        self._path = Polyline(run.vut.approach.path) if run and run.vut.approach else None
        self._limits: Limits | None = run.limits if run else None

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """Return everything but events, site and picture.

        After the end that was heard it stays as it was then: what stood still stands, and the
        silence of processes that have ended is no news.
        """
        end = end_of(self._board, self.word, now_ns)
        if end is None:
            self._frozen = None
            return {**self._live(now_ns), "end": None}
        if self._frozen is None:
            heard_ns = self._board.session.at_ns
            self._frozen = self._live(now_ns if heard_ns is None else min(now_ns, heard_ns))
        session = {**self._session(now_ns), "commands": [], "press": "", "next": end["next"]}
        quiet = {"stale": [], "leaderless": False, "abort_unheard": False, "standing": []}
        blind = not end["stands"]
        return {**self._frozen, **quiet, "blind": blind, "session": session, "end": end}

    def _live(self, now_ns: int) -> dict[str, Any]:
        board = self._board
        return {
            "session": self._session(now_ns),
            "ages": self._ages(now_ns),
            "stale": self.stale(now_ns),
            "leaderless": board.manager.silent_s(now_ns) > STALE_S,
            "blind": self._is_blind(now_ns),
            "standing": standing_in_the_way(board, now_ns),
            "objects": self._objects(now_ns),
            "recorder": _recorder(board.recorder.value),
            "replay": board.replay,
            "abort_unheard": self._is_abort_unheard(),
            "camera_fault": board.camera.value,
        }

    def stale(self, now_ns: int) -> list[str]:
        """List silent sources, as sentences; what they last said must not pass for the present."""
        board = self._board
        silent = []
        if board.manager.at_ns is None:
            silent.append("the scenario manager was never heard")
        elif (age := board.manager.silent_s(now_ns)) > STALE_S:
            silent.append(f"the scenario manager is silent for {age:.1f} s")
        for object_id in self._expected():
            latest_state = board.objects.get(object_id)
            if latest_state is None:
                silent.append(f"{object_id} was never heard")
            elif (age := age_s(now_ns, latest_state.at_ns)) > STALE_S:
                silent.append(f"{object_id} is silent for {age:.1f} s")
            elif (age := object_age_s(board, latest_state, now_ns)) > STALE_S:
                silent.append(f"what {object_id} says is {age:.1f} s old")
        return silent

    def _is_blind(self, now_ns: int) -> bool:
        """Tell whether nothing is known of any moving object."""
        board = self._board
        return all(object_age_s(board, one, now_ns) > STALE_S for one in board.objects.values())

    def _is_abort_unheard(self) -> bool:
        """Tell whether ABORT would reach no receiver now; in a replay none should hear it."""
        board = self._board
        return not board.replay and board.offered is not None and "abort" not in board.offered

    def _commands(self, state: SessionPhase) -> list[str]:
        """List the commands that may be given now.

        One without a service would only give an error.
        """
        board = self._board
        if board.replay:
            return []
        return [c for c in COMMANDS[state] if board.offered is None or c in board.offered]

    def events(self) -> dict[str, Any]:
        """Return all remembered events, newest first."""
        zero_ns = self._board.session.started_ns
        return {
            "events_seen": self._board.events.count,
            "events": [_event(n, event, zero_ns) for n, event in reversed(self._board.events)],
        }

    def _expected(self) -> list[str]:
        run = self._board.run
        return run.object_ids if run is not None else sorted(self._board.objects)

    def _session(self, now_ns: int) -> dict[str, Any]:
        board = self._board
        fact, state = board.session.fact, board.session.state
        run = board.run
        elapsed_s = board.elapsed_s
        verdict, reasons = verdict_of(board, self.word)
        arming = state is SessionPhase.ARMED and bool(not_armed(board))
        return {
            "state": state.name,
            "shown": ARMING if arming else state.name,
            "press": str(StateOnPage(int(state), fact.stamp_ns, now_ns)) if fact else "",
            "event": fact.event if fact else "",
            "reason": fact.reason if fact else "",
            "run_id": (fact.run_id if fact else "") or (run.run_id if run else ""),
            "scenario": (fact.scenario if fact else "") or (run.scenario if run else ""),
            "site": run.site if run else "",
            "stand_in": bool(run and run.stand_in),
            "mode": run.mode if run else "",
            "verdict": verdict.name,
            "reasons": list(reasons),
            "phase": _phase(board.session.phase),
            "elapsed_s": None if elapsed_s is None else number(elapsed_s, 2),
            "commands": self._commands(state),
            "next": "" if board.replay else NEXT_WHILE_ARMING if arming else NEXT[state],
        }

    def _ages(self, now_ns: int) -> dict[str, float | None]:
        board = self._board
        sources = {
            "session": board.session.at_ns,
            "manager": board.manager.at_ns,
            "recorder": board.recorder.at_ns,
            "camera": board.camera.at_ns,
        }
        return {name: number(age_s(now_ns, at_ns), 2) for name, at_ns in sources.items()}

    def _objects(self, now_ns: int) -> list[dict[str, Any]]:
        board = self._board
        everyone = sorted(
            board.objects.values(), key=lambda latest_state: _order(latest_state.state)
        )
        vut = next((h for h in everyone if h.state.role is Role.VUT), None)
        fresh_vut = vut.state if vut and object_age_s(board, vut, now_ns) <= STALE_S else None
        return [self._object(latest_state, fresh_vut, now_ns) for latest_state in everyone]

    def _object(
        self, latest_state: LatestState, vut: ObjectState | None, now_ns: int
    ) -> dict[str, Any]:
        state = latest_state.state
        old_s = object_age_s(self._board, latest_state, now_ns)
        limit_s = self._limits.state_age_s if self._limits else DEFAULT_STATE_AGE_S
        entry: dict[str, Any] = {
            "id": state.object_id,
            "class": state.object_class.word,
            "role": state.role.name,
            "control": _control(state),
            "x": number(state.x_m),
            "y": number(state.y_m),
            "yaw": number(state.yaw_rad, 4),
            "front": number(state.size.front_m, 2),
            "rear": number(state.size.rear_m, 2),
            "width": number(state.size.width_m, 2),
            "speed": number(state.speed_mps, 2),
            "age": number(old_s, 2),
            "late": old_s > limit_s,
            "stale": old_s > STALE_S,
        }
        if state.reference_id:
            entry["error"] = [
                number(state.error_longitudinal_m, 2),
                number(state.error_lateral_m, 2),
            ]
            entry["error_over"] = self._is_off(state)
        link = links_of(self._board, now_ns).get(state.object_id)
        if link is not None:
            entry["link"] = _link(link, self._limits)
        if vut is None or state.object_id == vut.object_id:
            return entry
        if not (state.is_finite and vut.is_finite):
            return entry
        entry["distance"] = number(box_distance(vut.box, state.box), 2)
        if self._path is not None and state.role is Role.OT:
            entry["meeting"] = _meeting(
                encounter(vut, state.extrapolated(vut.stamp_ns), self._path)
            )
        return entry

    def _is_off(self, state: ObjectState) -> bool:
        limits = self._limits
        return limits is not None and (
            judge.error_longitudinal(state.error_longitudinal_m, limits) is not None
            or judge.error_lateral(state.error_lateral_m, limits) is not None
        )


def _order(state: ObjectState) -> tuple[bool, bool, list[tuple[int, str]]]:
    """Return a sorting key: the VUT first, traffic last, and ot2 before ot10."""
    parts = [(int(p), "") if p.isdecimal() else (-1, p) for p in _DIGITS.split(state.object_id)]
    return state.role is not Role.VUT, state.role is Role.TRAFFIC, parts


def _phase(phase: Phase) -> str:
    """Describe a phase; one that only the recording's end can confirm is said to be provisional."""
    if phase is Phase.UNKNOWN:
        return ""
    return phase.name + (", PROVISIONAL" if phase.is_provisional else "")


def _control(state: ObjectState) -> str:
    """Return the control state; traffic has none, and an uncontrolled VUT says OFF as it drives."""
    driven = state.role is Role.VUT and state.control_state is ControlState.OFF
    return "" if driven or state.role is Role.TRAFFIC else state.control_state.name


def _meeting(meeting: Encounter) -> dict[str, float | None]:
    return {
        "ttc": number(meeting.ttc_s, 1),
        "vut": number(meeting.vut_arrival_s, 1),
        "object": number(meeting.object_arrival_s, 1),
    }


def _link(link: LinkFact, limits: Limits | None) -> dict[str, Any]:
    return {
        "delay": number(link.delay_s, 4),
        "age": number(link.state_age_s, 3),
        "lost": link.lost,
        "over": limits is not None and link.delay_s > limits.link_delay_s,
    }


def _event(count: int, event: Event, zero_ns: int | None) -> dict[str, Any]:
    return {
        "n": count,
        "kind": event.kind,
        "t": None if zero_ns is None else number((event.stamp_ns - zero_ns) / 1e9, 2),
        "title": event.title,
        "text": event.text,
        "object": event.object_id,
        "measured": number(event.measured),
        "limit": number(event.limit),
        "unit": event.unit,
    }


def _recorder(fact: RecorderFact | None) -> dict[str, Any] | None:
    if fact is None:
        return None
    return {
        "ready": fact.ready,
        "failure": fact.failure,
        "bytes": fact.bytes,
        "lost": fact.lost,
        "missing": list(fact.missing),
        "queue": number(fact.queue_bytes / fact.queue_limit_bytes)
        if fact.queue_limit_bytes
        else None,
        "free_bytes": fact.free_bytes or None,
        "rate": number(fact.write_bytes_per_s, 0),
        # A recorder that doesn't know its disk says 0 free.
        "disk_left_s": number(fact.disk_left_s, 0) if fact.free_bytes else None,
        "warnings": list(fact.warnings),
        "topics": [
            {"name": t.name, "lost": t.lost, "dropped": t.dropped}
            for t in fact.topics
            if t.lost or t.dropped
        ][:20],
    }


# A line of more points is thinned: on a screen nobody would see the difference.
MOST_POINTS = 600


def site_message(run: RunSpec | None) -> dict[str, Any]:
    """Return the drawing of a run; ``known`` is false, and nothing is drawn, without a run file."""
    if run is None:
        return {"known": False}
    drawing = drawing_of(run)
    return {
        "known": True,
        "name": run.site,
        "scenario": run.scenario,
        "camera": run.camera is not None,
        "bounds": list(drawing.bounds_m),
        "fence": _line(drawing.fence),
        "lines": [
            {"kind": one.kind, "opposed": one.opposed, "points": _line(one.points)}
            for one in drawing.road_lines
        ],
        "crossings": [_line(outline) for outline in drawing.crossings],
        "routes": _routes(drawing),
        "starts": [
            {
                "id": one.object_id,
                "role": one.role.name,
                "at": [round(c, 3) for c in one.centre],
                "yaw": round(one.yaw_rad, 4),
                "radius": one.radius_m,
            }
            for one in drawing.starts
        ],
        "zones": [{"name": z.name, "points": _line(z.outline)} for z in drawing.conflict_zones],
        "anchors": [{"name": a.name, "at": [round(c, 3) for c in a.at]} for a in drawing.anchors],
        "regions": [{"name": r.name, "points": _line(r.outline)} for r in drawing.regions],
    }


def _routes(drawing: Drawing) -> list[dict[str, Any]]:
    return [
        {
            "id": one.object_id,
            "role": one.role.name,
            "purpose": one.purpose,
            "points": _line(one.points),
        }
        for one in drawing.routes
    ]


def _line(points: Sequence[Point]) -> list[list[float]]:
    step = max(1, -(-len(points) // MOST_POINTS))
    vertices = [*points[:-1:step], *points[-1:]]
    return [[round(x, 3), round(y, 3)] for x, y in vertices]


NOT_JPEG = "not JPEG"


class Pictures:
    """Takes messages as they come, gives pictures at a bounded rate.

    Args:
        board: notes when the newest picture came, and what is wrong with the camera.
        period_ns: between two pictures, at the least.
    """

    def __init__(self, board: Board, period_ns: int) -> None:
        self._board = board
        self._period_ns = period_ns
        self._newest: tuple[bytes, int] | None = None
        self._jpeg: bytes | None = None
        self._next_ns = 0

    def put(self, data: bytes, at_ns: int) -> None:
        """Keep a serialised CompressedImage with its time of arrival on the steady clock."""
        self._newest = (data, at_ns)

    def settle(self) -> str:
        """Examine the newest picture; return what is wrong with it, empty when nothing is."""
        if self._newest is None:
            return ""
        (data, at_ns), self._newest = self._newest, None
        try:
            self._jpeg = jpeg_of(data)
        except ValueError as error:
            self._board.camera = replace(self._board.camera, value=NOT_JPEG)
            return str(error)
        self._board.camera = LatestReport("", at_ns)
        return ""

    def take(self, now_ns: int) -> bytes | None:
        """Return the newest picture if one is due that wasn't taken yet."""
        if self._jpeg is None or now_ns < self._next_ns:
            return None
        self._next_ns = now_ns + self._period_ns
        jpeg, self._jpeg = self._jpeg, None
        return jpeg
