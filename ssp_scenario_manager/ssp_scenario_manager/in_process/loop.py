"""A session from loading to its end against a plant in the same process.

It does with each step what the manager's node does in lockstep, in the same order, so that the
states are the same to the last bit. Before the start, time stands still for the session; those who
wait count in holds of the world.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_core.world.plant import FaultFact, LimitFact, ManagerUpdate, Plant, StepReport
from ssp_scenario_manager.core import outbox, supervisor
from ssp_scenario_manager.core.link_clock import Link
from ssp_scenario_manager.core.patience import ABORT_STANDSTILL_S, SILENT_S
from ssp_scenario_manager.core.readiness import Facts
from ssp_scenario_manager.core.run_script import RunScript
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.session_machine import SessionEvent
from ssp_scenario_manager.runner.happened import Fired

WHO = "run_scenario"
# As ObjectCommand.srv has them.
_ARM, _DISARM, _ALL_CLEAR = 2, 3, 7
HOLD_NS = seconds_to_ns(0.1)
# How long an armed session is held with a fault in it (as runner/follow.py does).
ARMED_HOLD_S = 3.0
# A session that is over while something still rolls is watched for so long.
ROLL_OUT_S = 20.0
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)

OnReport = Callable[[StepReport], None]


@dataclass
class Account:
    """What a session sent that belongs to its record, in its order."""

    changes: list[outbox.StateChanged] = field(default_factory=list)
    triggers: list[Fired] = field(default_factory=list)
    phases: list[outbox.PhaseBegan] = field(default_factory=list)
    violations: list[supervisor.Violation] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    notes: list[outbox.Note] = field(default_factory=list)
    faults: list[FaultFact] = field(default_factory=list)


class InProcessSession:
    """One run of one session. ``run`` may be called once.

    Args:
        spec: the run.
        plant: its world and objects.
        on_report: is given every report of the running world.
    """

    def __init__(self, spec: RunSpec, plant: Plant, on_report: OnReport | None = None) -> None:
        self.session = Session()
        self.account = Account()
        self.problems: tuple[str, ...] = ()
        self._spec = spec
        self._plant = plant
        self._on_report = on_report
        self._now_ns = 0
        self._steady_ns = 0
        self._aborting_since_ns: int | None = None
        self._armed_ns: int | None = None
        self._script = RunScript("", 0)
        self._heard_ns: dict[str, int] = {}
        self._links: dict[str, Link] = {}
        self._fresh: list[Reference] = []
        self._aborts = _operator_aborts(spec)

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
            self._take(self._plant.hold(self._word()))
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
        if not any(fault.at_s is None for fault in self._spec.faults):
            return False
        if self._armed_ns is None and all(
            state is not None and state.control_state is ControlState.ARMED for state in states
        ):
            self._armed_ns = self._steady_ns
        waited_ns = 0 if self._armed_ns is None else self._steady_ns - self._armed_ns
        return waited_ns < seconds_to_ns(ARMED_HOLD_S)

    def _facts(self) -> Facts:
        """Ages as the node measures them, counted in holds."""
        ids = [t.id for t in self._spec.targets]
        return replace(
            Facts.of_one_process(self._spec),
            vut_age_s=self._age_s(names.VUT_ID),
            target_age_s=tuple((i, self._age_s(i)) for i in ids),
            links=tuple((i, self._links.get(i, Link())) for i in ids),
        )

    def _age_s(self, object_id: str) -> float:
        heard_ns = self._heard_ns.get(object_id)
        return math.inf if heard_ns is None else ns_to_seconds(self._steady_ns - heard_ns)

    # -- while it runs -------------------------------------------------------------------------

    def _play(self) -> None:
        over_since_ns: int | None = None
        while True:
            report = self._plant.advance(self._word())
            if self._on_report is not None:
                self._on_report(report)
            if not report.running:
                self.account.faults += report.faults
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
        if self.session.state is not SessionPhase.ABORTING:
            self._aborting_since_ns = None
        elif self._aborting_since_ns is None:
            self._aborting_since_ns = self._steady_ns
        elif ns_to_seconds(self._steady_ns - self._aborting_since_ns) > ABORT_STANDSTILL_S:
            return True
        else:
            ids = [target.id for target in self._spec.targets]
            silent = [i for i in ids if self._age_s(i) > SILENT_S]
            return bool(silent) and self.session.stands(self._now_ns, without=silent)
        return False

    def _take(self, report: StepReport) -> None:
        session = self.session
        self._now_ns = report.now_ns
        self.account.faults += report.faults
        for state in report.vut_states:
            self._hear(state)
            session.on_vut_state(state)
        for state in report.target_states:
            self._hear(state)
            session.on_target_state(state)
        for link in report.links:
            self._links[link.object_id] = Link(
                link.offset_s, link.delay_s, 0.0 if math.isfinite(link.delay_s) else math.inf
            )
        for ack in report.acks:
            session.on_ack(
                ack.reference_id, ack.accepted, ack.error_code, ack.error_msg, ack.stamp_ns
            )
            self._flush()
        for seen in report.limits:
            session.fail(_violation(seen), announced=True)
            self._flush()

    def _hear(self, state: ObjectState) -> None:
        self._heard_ns[state.object_id] = self._steady_ns

    def _abort_by_operator(self, now_ns: int | None) -> None:
        """Those aborts that are due: with None, the ones of the armed session."""
        for fault in list(self._aborts):
            if now_ns is None:
                due = fault.at_s is None
            else:
                due = fault.at_s is None or now_ns >= seconds_to_ns(fault.at_s)
            if due:
                self._aborts.remove(fault)
                self.session.command(SessionEvent.ABORT, self._now_ns, "operator", "injected fault")
                self._flush()

    # -- sending -------------------------------------------------------------------------------

    def _word(self) -> ManagerUpdate:
        references, self._fresh = tuple(self._fresh), []
        return ManagerUpdate(self.session.state, self._now_ns, references)

    def _flush(self) -> None:
        account = self.account
        while self.session.outbox:
            fact = self.session.outbox.pop(0)
            if isinstance(fact, outbox.Dispatch):
                self._fresh.append(fact.reference)
                account.references.append(fact.reference)
            elif isinstance(fact, outbox.StateChanged):
                account.changes.append(fact)
            elif isinstance(fact, outbox.Triggered):
                account.triggers.append(_fired(fact, self._now_ns))
            elif isinstance(fact, outbox.PhaseBegan):
                account.phases.append(fact)
            elif isinstance(fact, outbox.LimitPassed):
                account.violations.append(fact.violation)
            elif isinstance(fact, outbox.Note):
                account.notes.append(fact)
            elif isinstance(fact, outbox.ArmObjects):
                self._command_objects(_ARM if fact.armed else _DISARM)
            else:
                self._command_objects(_ALL_CLEAR)

    def _command_objects(self, command: int) -> None:
        for target in self._spec.targets:
            refusal = self._plant.command(target.id, command, self._spec.event_version)
            if refusal and command == _ARM:
                reason = f"{target.id} refused: {refusal}"
                self._script.on_setback(reason)
                self.session.arming_failed(self._now_ns, reason)


def _fired(triggered: outbox.Triggered, now_ns: int) -> Fired:
    """A state that comes late brings about what it does at its arrival, not at its stamp."""
    return Fired(
        trigger_id=triggered.trigger_id,
        condition=triggered.condition,
        threshold=triggered.threshold,
        samples=triggered.samples,
        crossing_ns=triggered.crossing_ns,
        dispatched_ns=now_ns,
        reference_ids=tuple(reference.reference_id for reference in triggered.references),
    )


def _operator_aborts(spec: RunSpec) -> list[Fault]:
    return [fault for fault in spec.faults if fault.kind == "operator_abort"]


def _violation(seen: LimitFact) -> supervisor.Violation:
    return supervisor.Violation(
        seen.code,
        seen.object_id,
        seen.measured,
        seen.limit,
        seen.stamp_ns,
        f"seen by {seen.source}",
    )
