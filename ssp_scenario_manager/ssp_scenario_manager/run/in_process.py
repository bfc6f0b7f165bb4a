"""A run in one process, as fast as it goes, and its result: for sweeps, and without ROS."""

from __future__ import annotations

import gc
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ssp_core import names
from ssp_core.bag.seals.verdict import leave_verdict
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import PeerError
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_bytes
from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.passing import Passing
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import Participation
from ssp_core.vocabulary import Phase, SessionPhase, Verdict
from ssp_core.world.driver import AnswersOverError, NotRecordedError, RecordedAnswer
from ssp_core.world.plant import FaultFact, StepReport, make_plant
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.run.result import RunEvents, misses, result_keys, rounded
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.run_script import RunOutcome

if TYPE_CHECKING:
    from ssp_scenario_manager.run.kept_session import KeptSession, SessionListener

_COLUMNS = ("stamp_ns", "x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps")
_VALUES = attrgetter(*_COLUMNS)


@dataclass
class Record:
    """Every report of a run while its world went."""

    reports: list[StepReport] = field(default_factory=list)

    def truths(self, object_id: str) -> list[ObjectState]:
        """Return the true states of one object, in time order."""
        return [s for r in self.reports for s in r.truths if s.object_id == object_id]

    def arrived(self, object_id: str) -> list[ObjectState]:
        """Return the states of one object as they arrived at the manager, in that order."""
        return [
            s
            for r in self.reports
            for s in (*r.vut_states, *r.target_states)
            if s.object_id == object_id
        ]

    @property
    def sha256(self) -> str:
        """Hash of the true states of every body at each step."""
        ids = [state.object_id for report in self.reports for state in report.truths]
        states = [_VALUES(state) for report in self.reports for state in report.truths]
        return sha256_bytes(" ".join(ids).encode() + np.array(states, dtype=np.float64).tobytes())


@dataclass(frozen=True, slots=True)
class InProcessResult:
    """The ending of a run.

    Args:
        verdict: of the run; NONE when the session never started.
        reasons: of the verdict, the primary one first.
        session_s: session time at the end.
        happened: its phases, triggers and faults, and what was measured of it.
        error_rms_m: rms of the initiator's reported tracking errors, longitudinal and lateral; NaN
            when it tracked nothing.
        aborted_ns: session time of its first abort; None: there was none.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    session_s: float
    happened: RunEvents
    error_rms_m: tuple[float, float]
    aborted_ns: int | None = None

    @property
    def phases(self) -> tuple[PhaseBegan, ...]:
        """Return the phases as the whole run has them.

        Those announced meanwhile stand in ``happened``.
        """
        return self.happened.final_phases

    @property
    def triggers(self) -> tuple[outbox.TriggerDecision, ...]:
        return self.happened.triggers

    @property
    def faults(self) -> tuple[FaultFact, ...]:
        return self.happened.faults

    @property
    def passing(self) -> Passing:
        return self.happened.passing

    @property
    def min_distance_m(self) -> float:
        return self.happened.min_distance_m

    @property
    def ok(self) -> bool:
        return self.verdict is Verdict.VALID

    def failed_for(self, why: str) -> InProcessResult:
        """Return the result of a run that is sound no longer, for one more reason."""
        verdict = Verdict.INVALID_HARNESS if self.ok else self.verdict
        reasons = (why, *self.reasons) if self.ok else (*self.reasons, why)
        return replace(self, verdict=verdict, reasons=reasons)

    def phase_s(self, phase: Phase) -> float | None:
        """Return session time at which a phase began, None if it didn't."""
        return next((ns_to_seconds(p.stamp_ns) for p in self.phases if p.phase is phase), None)


def run_in_process(
    spec: RunSpec,
    work_dir: Path | None = None,
    listener: SessionListener | None = None,
    answers: Sequence[RecordedAnswer] | None = None,
) -> tuple[InProcessResult, Record]:
    """Run a session in this process, as fast as it goes.

    Args:
        spec: the run, in mode lockstep.
        work_dir: for SUMO's files, where there is traffic.
        listener: takes all that the session's nodes would say; None: nothing does.
        answers: that the model of a driven run gave before, and repeats; None: it is asked.

    Returns:
        Its result and its states; a server that doesn't draw a frame ends it as invalid.

    Raises:
        InputError: a run that needs processes, a clock or somebody else to drive the VUT.
    """
    record = Record()
    plant = make_plant(spec, work_dir, answers)
    # Nothing here makes cycles, and looking for some in every kept state takes its time.
    collects = gc.isenabled()
    gc.disable()
    session = InProcessSession(spec, plant, record.reports.append, listener=listener)
    try:
        session.run()
    except NotRecordedError as error:
        # An abort ended the model, which was asked nothing behind it.
        if isinstance(error, AnswersOverError) and session.is_aborting:
            session.leave()
        else:
            session.lose(names.VUT_DRIVER, str(error))
    except PeerError as error:
        session.lose(names.FRONT_CAMERA, str(error))
    finally:
        if collects:
            gc.enable()
        plant.close()
    reports = record.reports
    outcome, happened = judge_session(spec, session, record)
    return InProcessResult(
        verdict=outcome.verdict,
        reasons=outcome.reasons,
        session_s=ns_to_seconds(reports[-1].now_ns) if reports else 0.0,
        happened=happened,
        error_rms_m=_error_rms_m(record.arrived(spec.initiator_id)),
        aborted_ns=next(
            (
                change.stamp_ns
                for change in session.of_kind(outbox.StateChanged)
                if change.state is SessionPhase.ABORTING
            ),
            None,
        ),
    ), record


def run_recorded(
    spec: RunSpec,
    run_file: Path,
    bag: Path,
    say: Callable[[str], None],
    server: ServerOfRun | None = None,
    answers: Sequence[RecordedAnswer] | None = None,
) -> tuple[InProcessResult, Record, dict[str, Any]]:
    """Run a session in this process and leave its bag, with the verdict in it.

    Args:
        spec: the run, in mode lockstep; its camera, if it has one, is drawn.
        run_file: holds ``spec``; its task lies beside it.
        bag: a new folder.
        say: takes what doesn't end the run, for people.
        server: that draws the camera's frames; None: our own renderer does.
        answers: as for ``run_in_process``.

    Returns:
        Its result, its states, and what ``result.json`` says of the bag.

    Raises:
        InputError: as ``run_in_process``, or a file of the task can't be taken.
        HostError: the disk doesn't take the bag, or CARLA's client isn't installed.
    """
    # A sweep writes no bags, and needs none of what writes them.
    from ssp_scenario_manager.run.in_process_recording import SessionRecording
    from ssp_scenario_manager.run.report import measured

    with SessionRecording(spec, run_file, bag, server) as recording:
        result, record = run_in_process(spec, listener=recording, answers=answers)
    for line in recording.recorder.not_given_back:
        say(line)
    seal = leave_verdict(bag, result.verdict, result.reasons, "runner")
    return result, record, {"bag": bag.name, "seal": seal, "measured": measured(bag, spec, say)}


def leave_recording(
    spec: RunSpec, run_file: Path, bag: Path, session_record: KeptSession, result: InProcessResult
) -> dict[str, Any]:
    """Leave the bag of a run in one process that is over, with the verdict in it.

    Args:
        spec: the run; its camera, if it has one, is drawn by our own renderer.
        run_file: holds ``spec``; its task lies beside it.
        bag: a new folder.
        session_record: what was said in the run.
        result: of the run.

    Returns:
        What ``result.json`` says of the bag.

    Raises:
        InputError: a file of the task can't be taken.
        HostError: the disk doesn't take the bag.
    """
    from ssp_scenario_manager.run.in_process_recording import SessionRecording
    from ssp_scenario_manager.run.report import ReportInput, report_fields

    with SessionRecording(spec, run_file, bag) as recording:
        session_record.tell(recording)
    seal = leave_verdict(bag, result.verdict, result.reasons, "runner")
    return {
        "bag": bag.name,
        "seal": seal,
        "measured": report_fields(ReportInput.of_session_record(session_record, spec), spec),
    }


def judge_session(
    spec: RunSpec, session: InProcessSession, record: Record
) -> tuple[RunOutcome, RunEvents]:
    """Judge how a session that is over ended, and what happened in it."""
    happened = RunEvents.measure(
        spec,
        0,
        session.of_kind(PhaseBegan),
        session.of_kind(outbox.TriggerDecision),
        session.faults,
        {i: record.truths(i) for i in spec.object_ids},
    )
    outcome = RunOutcome(
        session.session.verdict, tuple(session.session.reasons or session.problems)
    )
    # What K* says of passing and time gap decides nothing of a driven run.
    return outcome.with_misses([] if spec.driven else misses(spec, happened)), happened


def save_states(path: Path, spec: RunSpec, record: Record) -> None:
    """Write ``states.npz``: per object ``<id>_true`` and ``<id>_arrived``, rows of ``columns``."""
    arrays: dict[str, Any] = {"columns": np.array(_COLUMNS)}
    for object_id in spec.object_ids:
        for name, states in (
            ("true", record.truths(object_id)),
            ("arrived", record.arrived(object_id)),
        ):
            rows = [[getattr(state, column) for column in _COLUMNS] for state in states]
            arrays[f"{object_id}_{name}"] = np.array(rows, dtype=np.float64).reshape(
                -1, len(_COLUMNS)
            )
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)
    write_bytes(path, packed.getvalue())


def result_json(spec: RunSpec, result: InProcessResult) -> dict[str, Any]:
    """Return ``result.json`` of a run in one process: that of any run, and what was measured."""
    return {
        **result_keys(spec, result.happened, Participation(spec.mode, {})),
        "in_process": True,
        "verdict": result.verdict.name.lower(),
        "reasons": list(result.reasons),
        "session_s": round(result.session_s, 3),
        "error_longitudinal_rms_m": rounded(result.error_rms_m[0]),
        "error_lateral_rms_m": rounded(result.error_rms_m[1]),
    }


def _error_rms_m(states: Sequence[ObjectState]) -> tuple[float, float]:
    tracked = [s for s in states if s.reference_id]
    if not tracked:
        return math.nan, math.nan
    squares = np.array([(s.error_longitudinal_m, s.error_lateral_m) for s in tracked]) ** 2
    longitudinal, lateral = np.sqrt(squares.mean(axis=0))
    return float(longitudinal), float(lateral)
