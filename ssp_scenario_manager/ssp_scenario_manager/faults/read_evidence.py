"""What a run left behind, read: its bag, its result and the runner's notes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
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
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.vocabulary import ControlState, Phase, Role, SessionPhase
from ssp_scenario_manager.faults.evidence import Evidence, FaultNote, Heard, SafetyNote
from ssp_scenario_manager.faults.motion import Track
from ssp_scenario_manager.runner.session import FAULTS_FILE, WITNESS_FILE

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
            Heard(h["kind"], h["name"], h["detail"], h["session_s"], h["wall_s"])
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
