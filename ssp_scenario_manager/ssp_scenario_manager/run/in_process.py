"""A session against a plant in the same process: for sweeps, for machines without ROS, and to ask
whether an event would happen.
"""

from __future__ import annotations

import gc
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import write_bytes
from ssp_core.motion.event import Passing, PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import Participation
from ssp_core.safety.arming import Facts
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.vocabulary import ControlState, Phase, SessionPhase, Verdict
from ssp_core.world.plant import FaultFact, ManagerUpdate, Plant, StepReport, make_plant
from ssp_scenario_manager.run.faults import ARMED_HOLD_S, strikes_armed
from ssp_scenario_manager.run.result import Happened, misses, result_keys, rounded
from ssp_scenario_manager.session import limits, outbox
from ssp_scenario_manager.session.run_script import RunOutcome, RunScript
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import SessionEvent
from ssp_scenario_manager.session.supervision import AbortWatch, LivenessMonitor

WHO = "run_scenario"
HOLD_NS = seconds_to_ns(0.1)
# A session that is over while something still rolls is watched for so long.
ROLL_OUT_S = 20.0
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)

OnReport = Callable[[StepReport], None]


def _ignore(_: StepReport) -> None:
    pass


Fact = TypeVar("Fact", bound=outbox.Outgoing)


class InProcessSession:
    """One run of one session. ``run`` may be called once.

    Args:
        on_report: is given every report of the running world.
        on_hold: is given every report of the world that holds.

    Attributes:
        sent: everything that the session sent, in its order.
        faults: that began or ended.
    """

    def __init__(
        self,
        spec: RunSpec,
        plant: Plant,
        on_report: OnReport = _ignore,
        on_hold: OnReport = _ignore,
    ) -> None:
        self.session = Session()
        self.sent: list[outbox.Outgoing] = []
        self.faults: list[FaultFact] = []
        self.problems: tuple[str, ...] = ()
        self._spec = spec
        self._plant = plant
        self._on_report = on_report
        self._on_hold = on_hold
        self._now_ns = 0
        self._steady_ns = 0
        self._abort = AbortWatch()
        self._armed_ns: int | None = None
        self._script = RunScript("", 0)
        self._liveness = LivenessMonitor()
        self._links: dict[str, LinkEstimate] = {}
        self._fresh: list[Reference] = []
        self._aborts = [fault for fault in spec.faults if fault.kind == "operator_abort"]

    def run(self) -> None:
        """Loads, connects, arms, starts, and steps until everything is over."""
        self._prepare()
        if self.session.state is SessionPhase.RUNNING:
            self._play()

    # -- before the start ----------------------------------------------------------------------

    def _prepare(self) -> None:
        session, script = self.session, self._script
        while True:
            wish = script.next(session.state, self._steady_ns)
            if wish is SessionEvent.START and self._holds_armed():
                wish = None
            if wish is SessionEvent.LOAD:
                script.on_answer(session.load(self._spec, 0))
            elif wish is not None:
                session.facts = self._facts()
                script.on_answer(session.command(wish, self._now_ns, WHO, ""))
            self._flush()
            if session.state is SessionPhase.ARMED:
                self._abort_by_operator(None)
            if session.state is SessionPhase.RUNNING or script.finished:
                break
            self._steady_ns += HOLD_NS
            report = self._plant.hold(self._word())
            self._on_hold(report)
            self._take(report)
            if session.state in (SessionPhase.ARMED, SessionPhase.ABORTING):
                session.step(self._now_ns)
                self._flush()
            if session.state in _OVER or self._waits_in_vain():
                break
        self.problems = script.problems

    def _holds_armed(self) -> bool:
        """A session with a fault in it before the start is held, for the limits that apply to it.

        It counts from when every object says that it is armed, which is when the faults begin.
        """
        states = [self.session.targets.get(t.id) for t in self._spec.targets]
        if not strikes_armed(self._spec):
            return False
        if self._armed_ns is None and all(
            state is not None and state.control_state is ControlState.ARMED for state in states
        ):
            self._armed_ns = self._steady_ns
        waited_ns = 0 if self._armed_ns is None else self._steady_ns - self._armed_ns
        return waited_ns < seconds_to_ns(ARMED_HOLD_S)

    def _facts(self) -> Facts:
        """Ages as the node measures them, counted in holds."""
        heard = self._liveness.facts(self._spec, self._steady_ns)
        return replace(
            Facts.of_one_process(self._spec),
            ages_s={**heard.ages_s, names.MONITOR: 0.0, names.FRONT_CAMERA: 0.0},
            links=dict(self._links),
        )

    # -- while it runs -------------------------------------------------------------------------

    def _play(self) -> None:
        over_since_ns: int | None = None
        while True:
            report = self._plant.advance(self._word())
            self._on_report(report)
            if not report.running:
                self.faults += report.faults
                return
            self._steady_ns += report.now_ns - self._now_ns
            self._take(report)
            self._abort_by_operator(report.now_ns)
            self.session.step(self._now_ns)
            self._flush()
            if self._waits_in_vain():
                return
            if self.session.state in _OVER:
                over_since_ns = over_since_ns or self._now_ns
                if ns_to_seconds(self._now_ns - over_since_ns) > ROLL_OUT_S:
                    return

    def _waits_in_vain(self) -> bool:
        """An abort whose end nobody reports: of what is not heard no standstill is known."""
        in_vain = self._abort.unconfirmed(
            self.session, self._liveness, self._steady_ns, self._now_ns
        )
        if in_vain:
            self.session.give_up_on_standstill(self._now_ns)
            self._flush()
        return in_vain

    def _take(self, report: StepReport) -> None:
        session = self.session
        self._now_ns = report.now_ns
        self.faults += report.faults
        self._liveness.hear(names.SIL_WORLD, self._steady_ns)
        for state in (*report.vut_states, *report.target_states):
            self._liveness.hear(state.object_id, self._steady_ns)
        for state in report.vut_states:
            session.on_vut_state(state)
        for state in report.target_states:
            session.on_target_state(state)
        for link in report.links:
            self._links[link.object_id] = LinkEstimate(
                link.offset_s, link.delay_s, 0.0 if math.isfinite(link.delay_s) else math.inf
            )
        for ack in report.acks:
            session.on_ack(
                ack.reference_id, ack.accepted, ack.error_code, ack.error_msg, ack.stamp_ns
            )
            self._flush()
        for seen in report.limits:
            of_other = f"seen by {seen.source}"
            session.fail(
                limits.Violation(
                    seen.code,
                    seen.object_id,
                    seen.measured,
                    seen.limit,
                    seen.stamp_ns,
                    of_other,
                    words=seen.words,
                ),
                announced=True,
            )
            self._flush()

    def _abort_by_operator(self, now_ns: int | None) -> None:
        """Those aborts that are due: with None, the ones of the armed session."""
        for fault in list(self._aborts):
            at_s = fault.at_s
            if at_s is None or (now_ns is not None and now_ns >= seconds_to_ns(at_s)):
                self._aborts.remove(fault)
                self.session.command(SessionEvent.ABORT, self._now_ns, "operator", "injected fault")
                self._flush()

    # -- sending -------------------------------------------------------------------------------

    def _word(self) -> ManagerUpdate:
        references, self._fresh = tuple(self._fresh), []
        return ManagerUpdate(self.session.state, self._now_ns, references)

    def _flush(self) -> None:
        while self.session.outbox:
            fact = self.session.outbox.pop(0)
            self.sent.append(fact)
            if isinstance(fact, Reference):
                self._fresh.append(fact)
            elif isinstance(fact, outbox.ObjectCommand):
                self._command_objects(fact)

    def of_kind(self, kind: type[Fact]) -> list[Fact]:
        """List the facts of one kind that the session sent, in its order."""
        return [fact for fact in self.sent if isinstance(fact, kind)]

    def _command_objects(self, command: outbox.ObjectCommand) -> None:
        for target in self._spec.targets:
            refusal = self._plant.command(target.id, command.value, self._spec.event_version)
            if refusal and command is outbox.ObjectCommand.ARM:
                reason = f"{target.id} refused: {refusal}"
                self._script.on_setback(reason)
                self.session.arming_failed(self._now_ns, reason)


_COLUMNS = ("stamp_ns", "x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps")


@dataclass
class Record:
    """Every report of a run while its world went."""

    reports: list[StepReport] = field(default_factory=list)

    def truths(self, object_id: str) -> list[ObjectState]:
        """True states of one object, in time order."""
        return [s for r in self.reports for s in r.truths if s.object_id == object_id]

    def arrived(self, object_id: str) -> list[ObjectState]:
        """States of one object as they arrived at the manager, in that order."""
        return [
            s
            for r in self.reports
            for s in (*r.vut_states, *r.target_states)
            if s.object_id == object_id
        ]


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
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    session_s: float
    happened: Happened
    error_rms_m: tuple[float, float]

    @property
    def phases(self) -> tuple[PhaseBegan, ...]:
        """Return the phases as the whole run has them; those announced meanwhile stand in
        ``happened``.
        """
        return self.happened.final_phases

    @property
    def triggers(self) -> tuple[outbox.Triggered, ...]:
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

    def phase_s(self, phase: Phase) -> float | None:
        """Session time at which a phase began, None: never."""
        return next((ns_to_seconds(p.stamp_ns) for p in self.phases if p.phase is phase), None)


def run_in_process(spec: RunSpec, work_dir: Path | None = None) -> tuple[InProcessResult, Record]:
    """Runs a session in this process, as fast as it goes.

    Args:
        spec: the run, in mode lockstep.
        work_dir: for SUMO's files, where there is traffic.

    Raises:
        InputError: a run that needs processes, a clock or somebody else to drive the VUT.
    """
    record = Record()
    plant = make_plant(spec, work_dir)
    # Nothing here makes cycles, and looking for some in every kept state takes its time.
    collects = gc.isenabled()
    gc.disable()
    try:
        session = InProcessSession(spec, plant, record.reports.append)
        session.run()
    finally:
        if collects:
            gc.enable()
        plant.close()
    reports = record.reports
    outcome, happened = judged(spec, session, record)
    return InProcessResult(
        verdict=outcome.verdict,
        reasons=outcome.reasons,
        session_s=ns_to_seconds(reports[-1].now_ns) if reports else 0.0,
        happened=happened,
        error_rms_m=_error_rms_m(record.arrived(spec.initiator_id)),
    ), record


def judged(spec: RunSpec, session: InProcessSession, record: Record) -> tuple[RunOutcome, Happened]:
    """Judge how a session that is over ended, and what happened in it."""
    happened = Happened.seen(
        spec,
        0,
        session.of_kind(PhaseBegan),
        session.of_kind(outbox.Triggered),
        session.faults,
        {i: record.truths(i) for i in spec.object_ids},
    )
    told = RunOutcome(session.session.verdict, tuple(session.session.reasons or session.problems))
    return told.with_misses(misses(spec, happened)), happened


def save_states(path: Path, spec: RunSpec, record: Record) -> None:
    """``states.npz``: per object ``<id>_true`` and ``<id>_arrived``, rows of ``columns``."""
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
    """``result.json`` of a run in one process: that of any run, and what was measured."""
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


# What a VUT that doesn't respond brings about after the conflict has begun.
_OF_NO_RESPONSE = frozenset(
    code.name.lower()
    for code in (SafetyCode.COLLISION, SafetyCode.SEPARATION, SafetyCode.EVENT_MISSING)
)


def why_not(run: RunSpec) -> list[str]:
    """Reasons for which a run's event wouldn't happen, each with the quantity that misses.

    It is run without a response of the VUT, then with the SIL's driver and the surroundings.

    Args:
        run: as it is compiled, with what K* wants of the passing; a VUT that somebody else drives
            is driven by the SIL's driver.

    Returns:
        None of them: it happens.
    """
    still = _without_response(run)
    reasons = _no_event(run, run_in_process(still)[0])
    if reasons:
        return [f"{reason}, while the VUT holds its approach speed" for reason in reasons]
    told = _not_valid(_plain(run).model_copy(update={"traffic": run.traffic}))
    if told and run.traffic and not _not_valid(_plain(run)):
        return [f"{reason}, with the surroundings" for reason in told]
    return [f"{reason}, with the SIL's driver" for reason in told]


def _not_valid(run: RunSpec) -> Sequence[str]:
    """Reasons for which a run isn't valid; none of them: it is."""
    try:
        result, _ = run_in_process(run)
    except InputError as error:
        return [str(error)]
    return [] if result.ok else result.reasons or ["it doesn't begin"]


def driven(run: RunSpec) -> tuple[InProcessResult, Record]:
    """The second of the two runs: with the SIL's driver, without camera, traffic and faults."""
    return run_in_process(_plain(run))


def _plain(run: RunSpec) -> RunSpec:
    """Remove from a run what needs processes of its own and doesn't change the event."""
    driver = run.driver.model_copy(update={"external": False})
    return run.model_copy(
        update={"mode": "lockstep", "camera": None, "traffic": [], "faults": [], "driver": driver}
    )


def _without_response(run: RunSpec) -> RunSpec:
    plain = _plain(run)
    driver = plain.driver.model_copy(
        update={"reacts": False, "aeb_deceleration_mps2": None, "later": []}
    )
    # Most of the time gap comes of the response; the order is judged below.
    return plain.model_copy(update={"driver": driver, "passing": None})


def _no_event(run: RunSpec, seen: InProcessResult) -> list[str]:
    """List what is missing of trigger, conflict and passing order."""
    who = run.initiator_id
    told = [reason for reason in seen.reasons if _code(reason) not in _OF_NO_RESPONSE]
    if told:
        return told
    late = "; ".join(reason for reason in seen.reasons if _code(reason) == "event_missing")
    if not seen.triggers:
        return [f"the trigger of {who} doesn't fire ({late})"]
    met = seen.phase_s(Phase.CONFLICT) is not None
    if seen.passing.other_first is None and not met:
        return [f"no conflict comes of it ({late or _phases(seen)})"]
    if seen.passing.other_first is None:
        near = f"smallest distance {seen.min_distance_m:.2f} m"
        return [f"{who} doesn't come into the VUT's corridor ({near})"]
    if run.passing is not None and seen.passing.other_first is not run.passing.initiator_first:
        first = who if seen.passing.other_first else run.vut.id
        return [f"{first} reaches the conflict point first, against K*'s passing order"]
    return []


def _code(reason: str) -> str:
    return reason.partition(":")[0]


def _phases(seen: InProcessResult) -> str:
    names: Sequence[str] = [p.phase.name.lower() for p in seen.phases]
    return f"phases: {', '.join(names)}"
