"""The session against a plant in the same process: commands, steps, reports and sent facts.

This file owns the times at which the session hears its plant, and everything that it sent. The
session's own state is ``Session``'s, the world's is the plant's. Its clocks rise with the plant's
reports and holds: nothing here reads a clock, so that the same run gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts, refusal_text
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_core.world.plant import FaultFact, ManagerUpdate, Plant, StepReport
from ssp_scenario_manager.run.faults import ARMED_HOLD_S, strikes_armed
from ssp_scenario_manager.session import limits, outbox
from ssp_scenario_manager.session.run_script import RunScript
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import SessionEvent
from ssp_scenario_manager.session.supervision import AbortWatch, LivenessMonitor

if TYPE_CHECKING:
    from ssp_scenario_manager.run.kept_session import SessionListener

WHO = "run_scenario"
HOLD_NS = seconds_to_ns(0.1)
# A session that is over while something still rolls is watched for so long.
ROLL_OUT_S = 20.0
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)

OnReport = Callable[[StepReport], None]


def _ignore(_: StepReport) -> None:
    pass


Fact = TypeVar("Fact", bound=outbox.Outgoing)


class _PlantReports:
    """Times at which the plant's participants were heard, and the quality of their links."""

    def __init__(self) -> None:
        self.liveness = LivenessMonitor()
        self._links: dict[str, LinkEstimate] = {}

    def hear(self, report: StepReport, steady_ns: int) -> None:
        self.liveness.hear(names.SIL_WORLD, steady_ns)
        for state in (*report.vut_states, *report.target_states):
            self.liveness.hear(state.object_id, steady_ns)
        for link in report.links:
            self._links[link.object_id] = LinkEstimate(
                link.offset_s, link.delay_s, 0.0 if math.isfinite(link.delay_s) else math.inf
            )

    def facts(self, spec: RunSpec, steady_ns: int) -> Facts:
        """Return ages as the node measures them, counted in holds."""
        liveness_facts = self.liveness.facts(spec, steady_ns)
        return replace(
            Facts.of_one_process(spec),
            ages_s={**liveness_facts.ages_s, names.MONITOR: 0.0, names.FRONT_CAMERA: 0.0},
            links=dict(self._links),
        )


class _InjectedOperator:
    """An operator whom the run file's faults have hold an armed session, or abort."""

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._aborts = [fault for fault in spec.faults if fault.kind == "operator_abort"]
        self._armed_ns: int | None = None

    def holds_armed(self, session: Session, steady_ns: int) -> bool:
        """Tell whether a session with a fault before its start is held, so that limits apply.

        It counts from when every object says that it is armed, which is when the faults begin.
        """
        if not strikes_armed(self._spec):
            return False
        states = [session.targets.get(t.id) for t in self._spec.targets]
        if self._armed_ns is None and all(
            state is not None and state.control_state is ControlState.ARMED for state in states
        ):
            self._armed_ns = steady_ns
        waited_ns = 0 if self._armed_ns is None else steady_ns - self._armed_ns
        return waited_ns < seconds_to_ns(ARMED_HOLD_S)

    def due_aborts(self, now_ns: int | None) -> int:
        """Count the aborts that are due, once each: with None, those of the armed session."""
        due = [
            fault
            for fault in self._aborts
            if fault.at_s is None or (now_ns is not None and now_ns >= seconds_to_ns(fault.at_s))
        ]
        self._aborts = [fault for fault in self._aborts if fault not in due]
        return len(due)


class InProcessSession:
    """One run of one session. ``run`` may be called once.

    Args:
        on_report: is given every report of the running world.
        on_hold: is given every report of the world that holds.
        listener: takes all that the session's nodes would say; None: nothing does.

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
        listener: SessionListener | None = None,
    ) -> None:
        self.session = Session()
        self.sent: list[outbox.Outgoing] = []
        self.faults: list[FaultFact] = []
        self._spec = spec
        self._plant = plant
        self._on_report = on_report
        self._on_hold = on_hold
        self._listener = listener
        self._now_ns = 0
        self._steady_ns = 0
        self._abort = AbortWatch()
        self._script = RunScript("", 0)
        self._plant_reports = _PlantReports()
        self._fresh: list[Reference] = []
        self._operator = _InjectedOperator(spec)

    def run(self) -> None:
        """Load, connect, arm, start, and step until everything is over."""
        self._prepare()
        if self.session.state is SessionPhase.RUNNING:
            self._play()

    def lose(self, participant: str, words: str) -> None:
        """End a session whose plant can't go on, as that of a lost node ends.

        Args:
            participant: that is lost.
            words: what happened to it.
        """
        lost = limits.Violation(
            SafetyCode.PARTICIPANT_LOST, participant, 0.0, 0.0, self._now_ns, words=words
        )
        self.session.fail(lost)
        self._flush()
        self.leave()

    @property
    def problems(self) -> tuple[str, ...]:
        """Return the reasons why the session didn't come to run; empty where it did."""
        return self._script.problems

    @property
    def is_aborting(self) -> bool:
        """True after an abort, until everything is known to stand."""
        return self.session.state is SessionPhase.ABORTING

    def leave(self) -> None:
        """End a session that is aborted where it is, since its plant can't go on."""
        self.session.give_up_on_standstill(self._now_ns)
        self._flush()
        self._answer()

    # -- before the start ----------------------------------------------------------------------

    def _prepare(self) -> None:
        session, script = self.session, self._script
        while True:
            wish = script.next(session.state, self._steady_ns)
            if wish is SessionEvent.START and self._operator.holds_armed(session, self._steady_ns):
                wish = None
            if wish is SessionEvent.LOAD:
                script.on_answer(session.load(self._spec, 0))
            elif wish is not None:
                session.facts = self._plant_reports.facts(self._spec, self._steady_ns)
                script.on_answer(session.command(wish, self._now_ns, WHO, ""))
            self._flush()
            if session.state is SessionPhase.ARMED:
                self._abort_by_operator(None)
            if session.state is SessionPhase.RUNNING or script.finished:
                break
            self._steady_ns += HOLD_NS
            report = self._plant.hold(self._word())
            self._on_hold(report)
            self._hear(report)
            if session.state in (SessionPhase.ARMED, SessionPhase.ABORTING):
                session.step(self._now_ns)
                self._flush()
            self._answer()
            if session.state in _OVER or self._waits_in_vain():
                break

    # -- while it runs -------------------------------------------------------------------------

    def _play(self) -> None:
        over_since_ns: int | None = None
        while True:
            report = self._plant.advance(self._word())
            self._on_report(report)
            if not report.running:
                self.faults += report.faults
                self._record(report)
                return
            self._steady_ns += report.now_ns - self._now_ns
            self._hear(report)
            self._abort_by_operator(report.now_ns)
            self.session.step(self._now_ns)
            self._flush()
            self._answer()
            if self._waits_in_vain():
                return
            if self.session.state in _OVER:
                over_since_ns = over_since_ns or self._now_ns
                if ns_to_seconds(self._now_ns - over_since_ns) > ROLL_OUT_S:
                    return

    def _waits_in_vain(self) -> bool:
        """Tell whether an abort's end can't be reported, as a silent object's standstill can't."""
        in_vain = self._abort.unconfirmed(
            self.session, self._plant_reports.liveness, self._steady_ns, self._now_ns
        )
        if in_vain:
            self.session.give_up_on_standstill(self._now_ns)
            self._flush()
        return in_vain

    def _hear(self, report: StepReport) -> None:
        self._record(report)
        self._take(report)

    def _record(self, report: StepReport) -> None:
        if self._listener is not None:
            self._listener.hear(report)

    def _answer(self) -> None:
        if self._listener is not None:
            self._listener.answer(self._now_ns, self.session.state)

    def _take(self, report: StepReport) -> None:
        session = self.session
        self._now_ns = report.now_ns
        self.faults += report.faults
        self._plant_reports.hear(report, self._steady_ns)
        for state in report.vut_states:
            session.on_vut_state(state)
        for state in report.target_states:
            session.on_target_state(state)
        for ack in report.acks:
            session.on_ack(
                ack.reference_id, ack.accepted, ack.error_code, ack.error_msg, ack.stamp_ns
            )
            self._flush()
        for safety_event in report.limits:
            of_other = f"seen by {safety_event.source}"
            session.fail(
                limits.Violation(
                    safety_event.code,
                    safety_event.object_id,
                    safety_event.measured,
                    safety_event.limit,
                    safety_event.stamp_ns,
                    of_other,
                    words=safety_event.words,
                ),
                announced=True,
            )
            self._flush()

    def _abort_by_operator(self, now_ns: int | None) -> None:
        """Do the aborts that are due: with None, the ones of the armed session."""
        for _ in range(self._operator.due_aborts(now_ns)):
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
            if self._listener is not None:
                self._listener.sent(fact)
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
                reason = refusal_text(target.id, refusal)
                self._script.on_setback(reason)
                self.session.arming_failed(self._now_ns, reason)
