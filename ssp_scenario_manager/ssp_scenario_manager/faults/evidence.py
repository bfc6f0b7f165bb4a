"""What a run left behind, as far as a judgement of a fault needs it: bag, result, notes, stopping
distances.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core import names
from ssp_core.bag.check import check_bag
from ssp_core.bag.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.states import decode_state, decode_states
from ssp_core.cdr.steps import decode_heartbeat, decode_tick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geometry import Box, FloatArray, Pose2, boxes_overlap
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.safety.fence import corners_of, excess_m
from ssp_core.safety.stopping import Stopping
from ssp_core.vocabulary import ControlState, Phase, Role, SessionPhase
from ssp_scenario_manager.run.over_dds import FAULTS_FILE, WITNESS_FILE

STANDSTILL_MPS = 0.05


@dataclass(frozen=True, slots=True)
class Track:
    """True states of one object, in the order of time.

    Args:
        t_s: session time, rises strictly, shape (n,).
        x_m: frame map; as y_m.
        yaw_rad: frame map.
        speed_mps: along the heading.
    """

    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray

    def speed_at(self, t_s: float) -> float:
        """Speed at the last state that is not later, 0 before the first, m/s."""
        i = int(np.searchsorted(self.t_s, t_s, side="right")) - 1
        return float(self.speed_mps[i]) if i >= 0 else 0.0

    def box(self, index: int, size: Size) -> Box:
        """Where the object was at one of its states."""
        pose = Pose2(float(self.x_m[index]), float(self.y_m[index]), float(self.yaw_rad[index]))
        return Box(pose, size.front_m, size.rear_m, size.width_m)

    def stands_at_the_end(self) -> bool:
        return len(self.t_s) == 0 or abs(float(self.speed_mps[-1])) <= STANDSTILL_MPS

    def first_motion_s(self, since_s: float) -> float | None:
        """When it first moves at or after an instant; None when it doesn't."""
        moving = np.flatnonzero((self.t_s >= since_s) & (np.abs(self.speed_mps) > STANDSTILL_MPS))
        return float(self.t_s[moving[0]]) if len(moving) else None

    def farthest_outside_m(self, size: Size, fence: list[tuple[float, float]]) -> float:
        """How far it ever stuck out of the fence, m; 0 when it never did."""
        if len(self.t_s) == 0:
            return 0.0
        corners = corners_of(self.x_m, self.y_m, self.yaw_rad, size)
        return float(excess_m(corners, fence).max())


def touch(a: Track, a_size: Size, b: Track, b_size: Size) -> bool:
    """Whether the boxes of two objects ever overlap, by their true states."""
    _, ours, theirs = np.intersect1d(a.t_s, b.t_s, return_indices=True)
    reach = sum(max(s.front_m, s.rear_m) + 0.5 * s.width_m for s in (a_size, b_size))
    away = np.hypot(a.x_m[ours] - b.x_m[theirs], a.y_m[ours] - b.y_m[theirs])
    return any(
        boxes_overlap(a.box(int(ours[k]), a_size), b.box(int(theirs[k]), b_size))
        for k in np.flatnonzero(away <= reach)
    )


@dataclass(frozen=True, slots=True)
class Stop:
    """How an object stopped.

    Args:
        speed_mps: the highest from the fault until it had to be noticed.
        distance_m: driven from the fault to standstill.
        bound_m: that it may be at most.
        standstill_s: session time at which it stands for good; None when it doesn't.
    """

    speed_mps: float
    distance_m: float
    bound_m: float
    standstill_s: float | None

    @property
    def kept(self) -> bool:
        return self.standstill_s is not None and self.distance_m <= self.bound_m


def stop_of(track: Track, fault_s: float, timeout_s: float, stopping: Stopping) -> Stop:
    """The stop after a fault.

    Args:
        track: of the object.
        fault_s: session time of the fault.
        timeout_s: how long it may go unnoticed.
        stopping: how the object is said to stop.
    """
    if len(track.t_s) == 0:
        return Stop(0.0, 0.0, stopping.distance_m(0.0, timeout_s), fault_s)
    # From the very instant: a busy witness may have missed the states just before it.
    after = track.t_s > fault_s
    t = np.concatenate(([fault_s], track.t_s[after]))
    x, y, speed = (
        np.interp(t, track.t_s, v) for v in (track.x_m, track.y_m, np.abs(track.speed_mps))
    )
    unnoticed = t <= fault_s + timeout_s + stopping.reaction_s
    fastest = float(speed[unnoticed].max()) if unnoticed.any() else 0.0
    distance = float(np.hypot(np.diff(x), np.diff(y)).sum())
    moving = np.flatnonzero(speed > STANDSTILL_MPS)
    if len(moving) == 0:
        standstill: float | None = fault_s
    elif moving[-1] + 1 < len(t):
        standstill = float(t[moving[-1] + 1])
    else:
        standstill = None
    bound = stopping.distance_m(fastest, timeout_s)
    return Stop(fastest, distance, bound, standstill)


@dataclass(frozen=True, slots=True)
class SafetyNote:
    """A safety event: when, which limit, who saw it, whose."""

    t_s: float
    limit_name: str
    source: str
    object_id: str


@dataclass(frozen=True, slots=True)
class FaultNote:
    """An injected fault that began or ended; wall time where the runner injected it."""

    t_s: float
    index: int
    active: bool
    wall_s: float | None = None


@dataclass(frozen=True, slots=True)
class HeardEvent:
    """What the runner heard, with the wall's clock: a session state or a safety event."""

    kind: str
    name: str
    detail: str
    t_s: float
    wall_s: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """One run, as far as a judgement of a fault needs it. Session times in s.

    Args:
        verdict: word of result.json.
        reasons: of it.
        truth: true states of VUT and OTs while the world ran, by id.
        own_states: (time, object, control state) whenever a target's published state changed it.
        session: (time, state) of each transition.
        phases: start of each phase of the event.
        triggers: when each trigger fired.
        safety: events in their order.
        faults: injected ones, in their order.
        last_heartbeat_s: of the manager; None without one.
        last_state_s: of each target, as published.
        lost: messages that the recorder says are lost.
        heard: by the runner.
        problems: what is wrong with what the run left.
        wall_s: how long the run took on the wall's clock.
        has_wall: False: the run took no time on the wall's clock that would mean anything.
    """

    spec: RunSpec
    verdict: str
    reasons: tuple[str, ...]
    truth: dict[str, Track]
    own_states: tuple[tuple[float, str, ControlState], ...] = ()
    session: tuple[tuple[float, SessionPhase], ...] = ()
    phases: tuple[tuple[float, Phase], ...] = ()
    triggers: tuple[float, ...] = ()
    safety: tuple[SafetyNote, ...] = ()
    faults: tuple[FaultNote, ...] = ()
    last_heartbeat_s: float | None = None
    last_state_s: dict[str, float] | None = None
    lost: int = 0
    heard: tuple[HeardEvent, ...] = ()
    problems: tuple[str, ...] = ()
    wall_s: float = 0.0
    has_wall: bool = True

    def reached(self, state: SessionPhase) -> float | None:
        """When the session came to a state first; None when it didn't."""
        return next((t for t, s in self.session if s is state), None)

    def phase_at(self, phase: Phase) -> float | None:
        """When a phase of the event began; None when it didn't."""
        return next((t for t, p in self.phases if p is phase), None)


RESULT_FILE = "result.json"
_OURS = (Role.VUT, Role.OT)


def read_evidence(folder: Path) -> Evidence:
    """Reads a run's folder.

    Raises:
        InputError: run.yaml or result.json is missing or broken; a bag that can't be read is a
            problem in the evidence.
    """
    spec = load_run(folder / "run.yaml")
    result = _json(folder / RESULT_FILE)
    notes = _json(folder / FAULTS_FILE) if (folder / FAULTS_FILE).is_file() else {}
    witness = _json(folder / WITNESS_FILE) if (folder / WITNESS_FILE).is_file() else {}
    read = _Bag(spec)
    bag = folder / str(result["bag"])
    if bag.is_dir():
        try:
            with BagReader(bag) as reader:
                read.take(reader)
            read.problems += check_bag(bag).problems
        except InputError as error:
            read.problems.append(str(error))
    else:
        read.problems.append("the run left no bag")
    return read.evidence(result, notes, witness)


def _json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"can't be read: {error}", file=path) from error
    if not isinstance(value, dict):
        raise InputError("must hold an object", file=path)
    return value


class _Bag:
    """Collects what the topics say."""

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self.problems: list[str] = []
        self._rows: dict[str, list[tuple[float, ObjectState]]] = {}
        self._own: list[tuple[float, str, ControlState]] = []
        self._last_own: dict[str, ControlState] = {}
        self._last_state_s: dict[str, float] = {}
        self._session: list[tuple[float, SessionPhase]] = []
        self._phases: list[tuple[float, Phase]] = []
        self._triggers: list[float] = []
        self._safety: list[SafetyNote] = []
        self._faults: list[FaultNote] = []
        self._heartbeat_s: float | None = None
        self._lost = 0
        self._stepped = -1

    def take(self, reader: BagReader) -> None:
        """Reads every topic that says something."""
        whole: dict[str, Callable[[Any], None]] = {
            names.SESSION_STATE: self._on_session,
            names.PHASE_EVENT: self._on_phase,
            names.TRIGGER_EVENT: self._on_trigger,
            names.SAFETY_EVENT: self._on_safety,
            names.FAULT_EVENT: self._on_fault,
            names.RECORDER_STATUS: self._on_status,
        }
        raw: dict[str, Callable[[bytes], None]] = {
            names.WORLD_TICK: self._on_tick,
            names.HEARTBEAT: self._on_heartbeat,
            names.OBJECT_STATES: lambda data: self._on_states(decode_states(data).states),
        }
        for target in self._spec.targets:
            raw[names.state_topic(target.id)] = lambda data: self._on_states([decode_state(data)])
        whole = {names.absolute(topic): take for topic, take in whole.items()}
        raw = {names.absolute(topic): take for topic, take in raw.items()}
        for message in reader.messages([*whole, *raw]):
            self._one(reader, message, whole, raw)

    def _one(
        self,
        reader: BagReader,
        message: BagMessage,
        whole: dict[str, Callable[[Any], None]],
        raw: dict[str, Callable[[bytes], None]],
    ) -> None:
        try:
            if message.topic in raw:
                raw[message.topic](message.data)
            else:
                whole[message.topic](reader.decode(message))
        except ValueError as error:
            self.problems.append(f"{message.topic}: {error}")

    # -- topics ----------------------------------------------------------------------------------

    def _on_tick(self, data: bytes) -> None:
        tick = decode_tick(data)
        if tick.step <= self._stepped:
            return  # a world that holds repeats itself
        self._stepped = tick.step
        for one in tick.objects:
            if one.role in _OURS:
                row = self._rows.setdefault(one.object_id, [])
                row.append((ns_to_seconds(tick.stamp_ns), one))

    def _on_heartbeat(self, data: bytes) -> None:
        self._heartbeat_s = ns_to_seconds(decode_heartbeat(data).stamp_ns)

    def _on_states(self, states: Iterable[ObjectState]) -> None:
        for state in states:
            t_s = ns_to_seconds(state.stamp_ns)
            self._last_state_s[state.object_id] = t_s
            if self._last_own.get(state.object_id) is not state.control_state:
                self._last_own[state.object_id] = state.control_state
                self._own.append((t_s, state.object_id, state.control_state))

    def _on_session(self, message: Any) -> None:
        self._session.append((_stamp_s(message), SessionPhase(message.state)))

    def _on_phase(self, message: Any) -> None:
        self._phases.append((_stamp_s(message), Phase(message.phase)))

    def _on_trigger(self, message: Any) -> None:
        self._triggers.append(ns_to_seconds(stamp_ns(message.dispatch_time)))

    def _on_safety(self, message: Any) -> None:
        self._safety.append(
            SafetyNote(_stamp_s(message), message.limit_name, message.source, message.object_id)
        )

    def _on_fault(self, message: Any) -> None:
        number = message.fault.partition(" ")[0]
        if not number.isdigit():
            raise ValueError(f"a fault without a number: {message.fault!r}")
        self._faults.append(FaultNote(_stamp_s(message), int(number), bool(message.active)))

    def _on_status(self, message: Any) -> None:
        self._lost = max(self._lost, int(message.lost))

    # -- the whole -------------------------------------------------------------------------------

    def evidence(
        self, result: dict[str, Any], notes: dict[str, Any], witness: dict[str, Any]
    ) -> Evidence:
        heard = tuple(
            HeardEvent(h["kind"], h["name"], h["detail"], h["session_s"], h["wall_s"])
            for h in notes.get("heard", ())
        )
        by_runner = {
            (one["index"], one["active"]): FaultNote(
                one["session_s"], one["index"], one["active"], one["wall_s"]
            )
            for one in notes.get("injected", ())
        }
        faults = [n for n in self._faults if (n.index, n.active) not in by_runner]
        faults = sorted([*faults, *by_runner.values()], key=lambda n: (n.t_s, n.index))
        truth = {object_id: track_of(rows) for object_id, rows in self._rows.items()}
        return Evidence(
            spec=self._spec,
            verdict=str(result["verdict"]),
            reasons=tuple(result["reasons"]),
            truth=_longer(truth, _witnessed(witness)),
            own_states=tuple(self._own),
            session=tuple(self._session),
            phases=tuple(self._phases),
            triggers=tuple(self._triggers),
            safety=tuple(self._safety),
            faults=tuple(faults),
            last_heartbeat_s=self._heartbeat_s,
            last_state_s=self._last_state_s,
            lost=self._lost,
            heard=heard,
            problems=tuple(self.problems),
            wall_s=float(result.get("wall_s", 0.0)),
        )


def _stamp_s(message: Any) -> float:
    return ns_to_seconds(stamp_ns(message.header.stamp))


def track_of(rows: list[tuple[float, ObjectState]]) -> Track:
    """(session time, true state) of one object, in the order of time."""
    values = np.array([(t, s.x_m, s.y_m, s.yaw_rad, s.speed_mps) for t, s in rows])
    t, x, y, yaw, speed = values.reshape(-1, 5).T
    return Track(t, x, y, yaw, speed)


def _witnessed(witness: dict[str, Any]) -> dict[str, Track]:
    times = np.array(witness.get("t_s", ()), dtype=np.float64)
    keep = np.concatenate(([True], np.diff(times) > 0.0)) if len(times) else np.zeros(0, bool)
    return {
        object_id: Track(
            times[keep],
            *(np.array(rows[key])[keep] for key in ("x_m", "y_m", "yaw_rad", "speed_mps")),
        )
        for object_id, rows in witness.get("objects", {}).items()
    }


def _longer(bag: dict[str, Track], heard: dict[str, Track]) -> dict[str, Track]:
    """Of each object the row that reaches farther: a struck recorder's bag ends early."""
    truth = dict(bag)
    for object_id, track in heard.items():
        known = truth.get(object_id)
        reaches = len(track.t_s) > 0 and (
            known is None or len(known.t_s) == 0 or track.t_s[-1] > known.t_s[-1]
        )
        if reaches:
            truth[object_id] = track
    return truth
