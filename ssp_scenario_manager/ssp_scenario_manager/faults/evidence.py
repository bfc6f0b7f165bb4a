"""The evidence of a run by which a fault is judged: bag, result, notes, stopping distances."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core import names
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.states import decode_state, decode_states
from ssp_core.cdr.steps import decode_heartbeat, decode_tick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geometry import Box, FloatArray, Pose2, boxes_overlap
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.safety.fence import way_excess_m
from ssp_core.safety.limits import STANDSTILL_MPS
from ssp_core.safety.stopping import Stopping
from ssp_core.vocabulary import ControlState, Phase, Role, SessionPhase
from ssp_scenario_manager.faults.kept import (
    WitnessFile,
    load_notes,
    load_result,
    load_witness,
)


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
        """Return the speed at the last state that is not later, 0 before the first, m/s."""
        i = int(np.searchsorted(self.t_s, t_s, side="right")) - 1
        return float(self.speed_mps[i]) if i >= 0 else 0.0

    def box(self, index: int, size: Size) -> Box:
        """Return the object's box at one of its states."""
        pose = Pose2(float(self.x_m[index]), float(self.y_m[index]), float(self.yaw_rad[index]))
        return Box(pose, size.front_m, size.rear_m, size.width_m)

    def stands_at_the_end(self) -> bool:
        return len(self.t_s) == 0 or abs(float(self.speed_mps[-1])) <= STANDSTILL_MPS

    def first_motion_s(self, since_s: float) -> float | None:
        """Find the time of its first motion at or after an instant; None when it doesn't move."""
        moving = np.flatnonzero((self.t_s >= since_s) & (np.abs(self.speed_mps) > STANDSTILL_MPS))
        return float(self.t_s[moving[0]]) if len(moving) else None

    def farthest_outside_m(self, size: Size, fence: list[tuple[float, float]]) -> float:
        """Measure how far it ever stuck out of the fence, m; 0 when it never did."""
        if len(self.t_s) == 0:
            return 0.0
        return float(way_excess_m(self.x_m, self.y_m, self.yaw_rad, size, fence).max())


def touch(a: Track, a_size: Size, b: Track, b_size: Size) -> bool:
    """Tell whether the boxes of two objects ever overlap, by their true states."""
    _, ours, theirs = np.intersect1d(a.t_s, b.t_s, return_indices=True)
    return any(
        boxes_overlap(a.box(int(i), a_size), b.box(int(j), b_size))
        for i, j in zip(ours, theirs, strict=True)
    )


@dataclass(frozen=True, slots=True)
class Stop:
    """The stop of an object.

    Args:
        speed_mps: the highest from the last state before the fault until it had to be noticed.
        distance_m: driven from that state to standstill.
        bound_m: that it may be at most, with what the speed makes between state and fault.
        standstill_s: session time at which it stands for good; None when it doesn't.
    """

    speed_mps: float
    distance_m: float
    bound_m: float
    standstill_s: float | None

    @property
    def is_within_bound(self) -> bool:
        return self.standstill_s is not None and self.distance_m <= self.bound_m


def stop_of(track: Track, fault_s: float, timeout_s: float, stopping: Stopping) -> Stop:
    """Return the stop after a fault.

    It is counted from the last state before the fault: a witness on a busy machine hears some of
    the states, and what lies between two that are seconds apart can't be interpolated.

    Args:
        track: of the object.
        fault_s: session time of the fault.
        timeout_s: how long it may go unnoticed.
        stopping: the object's declared reaction and deceleration.
    """
    if len(track.t_s) == 0:
        return Stop(0.0, 0.0, stopping.distance_m(0.0, timeout_s), fault_s)
    first = max(0, int(np.searchsorted(track.t_s, fault_s, side="right")) - 1)
    t, x, y = track.t_s[first:], track.x_m[first:], track.y_m[first:]
    speed = np.abs(track.speed_mps[first:])
    before_s = max(0.0, fault_s - float(t[0]))
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
    bound = stopping.distance_m(fastest, timeout_s + before_s)
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
class RunnerEvent:
    """An event that the runner heard, with the wall's clock: a session state or a safety event."""

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
        runner_events: heard by the runner.
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
    runner_events: tuple[RunnerEvent, ...] = ()
    problems: tuple[str, ...] = ()
    wall_s: float = 0.0
    has_wall: bool = True

    def time_of_phase(self, state: SessionPhase) -> float | None:
        """Return the time at which the session came to a state first; None when it didn't."""
        return next((t for t, s in self.session if s is state), None)

    def phase_at(self, phase: Phase) -> float | None:
        """Return the time at which a phase of the event began; None when it didn't."""
        return next((t for t, p in self.phases if p is phase), None)


_OURS = (Role.VUT, Role.OT)


def read_evidence(folder: Path) -> Evidence:
    """Read a run's folder.

    Raises:
        InputError: run.yaml or result.json is missing, or a file isn't as it was written; a bag
            that can't be read is a problem in the evidence.
    """
    spec, result = load_run(folder / "run.yaml"), load_result(folder)
    notes, witness = load_notes(folder), load_witness(folder)
    evidence = Evidence(
        spec=spec,
        verdict=result.verdict,
        reasons=tuple(result.reasons),
        truth={},
        runner_events=tuple(
            RunnerEvent(h.kind, h.name, h.detail, h.session_s, h.wall_s) for h in notes.heard
        ),
        wall_s=result.wall_s,
    )
    problems: list[str] = []
    bag = folder / result.bag
    if bag.is_dir():
        try:
            with BagReader(bag) as reader:
                evidence = _of_bag(reader, evidence, problems)
            problems += check_bag(bag).problems
        except InputError as error:
            problems.append(str(error))
    else:
        problems.append("the run left no bag")
    by_runner = [
        FaultNote(one.session_s, one.index, one.active, one.wall_s) for one in notes.injected
    ]
    runner_keys = {(note.index, note.active) for note in by_runner}
    others = [note for note in evidence.faults if (note.index, note.active) not in runner_keys]
    return replace(
        evidence,
        truth=_longer(evidence.truth, _witnessed(witness)),
        faults=tuple(sorted([*others, *by_runner], key=lambda n: (n.t_s, n.index))),
        problems=tuple(problems),
    )


def _of_bag(reader: BagReader, evidence: Evidence, problems: list[str]) -> Evidence:
    """Read the topics; each one that can't be read is a problem."""

    def values_of(*topics: str, take: Callable[[Any], Any], raw: bool = False) -> list[Any]:
        values = []
        for message in reader.messages([names.absolute(topic) for topic in topics]):
            try:
                values.append(take(message.data if raw else reader.decode(message)))
            except ValueError as error:
                problems.append(f"{message.topic}: {error}")
        return values

    rows: dict[str, list[tuple[float, ObjectState]]] = {}
    stepped = -1
    for tick in values_of(names.WORLD_TICK, take=decode_tick, raw=True):
        if tick.step <= stepped:
            continue  # a world that holds repeats itself
        stepped = tick.step
        for one in tick.objects:
            if one.role in _OURS:
                rows.setdefault(one.object_id, []).append((ns_to_seconds(tick.stamp_ns), one))
    own = [
        values_of(names.state_topic(target.id), take=decode_state, raw=True)
        for target in evidence.spec.targets
    ]
    own += [array.states for array in values_of(names.OBJECT_STATES, take=decode_states, raw=True)]
    states = [state for some in own for state in some]
    beats = values_of(names.HEARTBEAT, take=decode_heartbeat, raw=True)
    return replace(
        evidence,
        truth={object_id: track_of(samples) for object_id, samples in rows.items()},
        own_states=own_states(states),
        session=tuple(
            values_of(names.SESSION_STATE, take=lambda m: (_stamp_s(m), SessionPhase(m.state)))
        ),
        phases=tuple(values_of(names.PHASE_EVENT, take=lambda m: (_stamp_s(m), Phase(m.phase)))),
        triggers=tuple(
            values_of(names.TRIGGER_EVENT, take=lambda m: ns_to_seconds(stamp_ns(m.dispatch_time)))
        ),
        safety=tuple(
            values_of(
                names.SAFETY_EVENT,
                take=lambda m: SafetyNote(_stamp_s(m), m.limit_name, m.source, m.object_id),
            )
        ),
        faults=tuple(values_of(names.FAULT_EVENT, take=_fault_note)),
        last_heartbeat_s=ns_to_seconds(beats[-1].stamp_ns) if beats else None,
        last_state_s={state.object_id: ns_to_seconds(state.stamp_ns) for state in states},
        lost=max(values_of(names.RECORDER_STATUS, take=lambda m: int(m.lost)), default=0),
    )


def _stamp_s(message: Any) -> float:
    return ns_to_seconds(stamp_ns(message.header.stamp))


def _fault_note(message: Any) -> FaultNote:
    number = message.fault.partition(" ")[0]
    if not number.isdigit():
        raise ValueError(f"a fault without a number: {message.fault!r}")
    return FaultNote(_stamp_s(message), int(number), bool(message.active))


def own_states(states: Iterable[ObjectState]) -> tuple[tuple[float, str, ControlState], ...]:
    """Return (time, object, control state) of each change of a target's published state.

    Args:
        states: of each object in order.
    """
    last: dict[str, ControlState] = {}
    changes = []
    for state in states:
        if last.get(state.object_id) is not state.control_state:
            last[state.object_id] = state.control_state
            t_s = ns_to_seconds(state.stamp_ns)
            changes.append((t_s, state.object_id, state.control_state))
    return tuple(changes)


def track_of(rows: list[tuple[float, ObjectState]]) -> Track:
    """Return (session time, true state) of one object, in the order of time."""
    values = np.array([(t, s.x_m, s.y_m, s.yaw_rad, s.speed_mps) for t, s in rows])
    t, x, y, yaw, speed = values.reshape(-1, 5).T
    return Track(t, x, y, yaw, speed)


def _witnessed(witness: WitnessFile) -> dict[str, Track]:
    times = np.array(witness.t_s, dtype=np.float64)
    keep = np.concatenate(([True], np.diff(times) > 0.0)) if len(times) else np.zeros(0, bool)
    return {
        object_id: Track(
            times[keep],
            *(
                np.array(values, dtype=np.float64)[keep]
                for values in (rows.x_m, rows.y_m, rows.yaw_rad, rows.speed_mps)
            ),
        )
        for object_id, rows in witness.objects.items()
    }


def _longer(bag: dict[str, Track], witness_tracks: dict[str, Track]) -> dict[str, Track]:
    """Choose for each object the longer track: a struck recorder's bag ends early."""
    truth = dict(bag)
    for object_id, track in witness_tracks.items():
        bag_track = truth.get(object_id)
        reaches = len(track.t_s) > 0 and (
            bag_track is None or len(bag_track.t_s) == 0 or track.t_s[-1] > bag_track.t_s[-1]
        )
        if reaches:
            truth[object_id] = track
    return truth
