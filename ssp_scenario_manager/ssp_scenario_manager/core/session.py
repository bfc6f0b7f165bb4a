"""The session: commands and states in, transitions, references and events out.

One object holds what is known of a session; every method takes the time and appends to
``outbox`` what the node is to send. ``_move`` is the only place that changes the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.reference import Reference
from ssp_core.run_spec import RunSpec, TriggerSpec
from ssp_core.safety_codes import SafetyCode
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Phase, SessionPhase, Verdict
from ssp_scenario_manager.core import conditions, dispatch, outbox, phases, readiness, supervisor
from ssp_scenario_manager.core.session_machine import (
    IllegalTransition,
    SessionEvent,
    next_state,
)

STANDSTILL_MPS = 0.05
OWN_REASON_S = 0.1
REFUSED_TRANSITION = 1
REFUSED_CONDITION = 2


@dataclass(frozen=True, slots=True)
class Answer:
    """A command's answer (SessionCommand.srv)."""

    accepted: bool
    error_code: int = 0
    error_msg: str = ""
    missing: tuple[str, ...] = ()


@dataclass
class _Run:
    """What belongs to one run and is forgotten with it."""

    spec: RunSpec
    path: Polyline
    started_ns: int | None = None
    references: dict[str, Reference] = field(default_factory=dict)
    unanswered: dict[str, Reference] = field(default_factory=dict)
    watches: dict[str, conditions.Watch] = field(default_factory=dict)
    phase_watch: phases.PhaseWatch = field(default_factory=phases.PhaseWatch)
    armed: bool = False
    resolved_ns: int | None = None
    judged_ns: int = -1
    own_abort_ns: dict[str, int] = field(default_factory=dict)
    sent: int = 0
    verdict: Verdict = Verdict.NONE
    reasons: list[str] = field(default_factory=list)


class Session:
    """State machine, triggers, dispatch and supervision of one session."""

    def __init__(self) -> None:
        self.state = SessionPhase.IDLE
        self.outbox: list[outbox.Outgoing] = []
        self.vut: ObjectState | None = None
        self.targets: dict[str, ObjectState] = {}
        self.facts = readiness.Facts()
        self._run: _Run | None = None

    # -- what others may look at --------------------------------------------------------------

    @property
    def spec(self) -> RunSpec | None:
        return self._run.spec if self._run else None

    @property
    def verdict(self) -> Verdict:
        return self._run.verdict if self._run else Verdict.NONE

    @property
    def reasons(self) -> tuple[str, ...]:
        return tuple(self._run.reasons) if self._run else ()

    @property
    def phase(self) -> Phase:
        return self._run.phase_watch.phase if self._run else Phase.UNKNOWN

    def elapsed_s(self, now_ns: int) -> float:
        """Session time since the start of the run, 0 before it."""
        if self._run is None or self._run.started_ns is None:
            return 0.0
        return ns_to_seconds(now_ns - self._run.started_ns)

    # -- commands ------------------------------------------------------------------------------

    def load(self, spec: RunSpec, now_ns: int) -> Answer:
        """Takes a run that was read and validated."""
        problems = readiness.cannot_fire(spec)
        if problems:
            return Answer(False, REFUSED_CONDITION, "; ".join(problems), tuple(problems))
        try:
            next_state(self.state, SessionEvent.LOAD)
        except IllegalTransition as error:
            return Answer(False, REFUSED_TRANSITION, str(error))
        if spec.vut.approach is None:
            raise ValueError("a run without a path for the VUT passed the checks")
        self._run = _Run(spec=spec, path=Polyline(spec.vut.approach.path))
        # What was heard so far belongs to another run.
        self.vut = None
        self.targets = {}
        self._move(SessionEvent.LOAD, now_ns, f"{spec.scenario} on {spec.site}")
        return Answer(True)

    def command(self, event: SessionEvent, now_ns: int, requested_by: str, reason: str) -> Answer:
        """connect, arm, disarm, start, stop, abort, all_clear or reset.

        Raises:
            ValueError: the event is no command.
        """
        if event.value not in names.SESSION_COMMANDS:
            raise ValueError(f"{event.value} is no command")
        if event is SessionEvent.ABORT:
            self._abort_by_operator(now_ns, requested_by, reason)
            return Answer(True)
        try:
            next_state(self.state, event)
        except IllegalTransition as error:
            return Answer(False, REFUSED_TRANSITION, str(error))
        missing = self._missing(event, now_ns)
        if missing:
            text = f"{event.value} refused: " + "; ".join(missing)
            return Answer(False, REFUSED_CONDITION, text, tuple(missing))
        if event is SessionEvent.STOP:
            self._stop_by_operator(requested_by)
        self._move(event, now_ns, reason or f"requested by {requested_by}")
        if event is SessionEvent.ARM and self._run is not None:
            self._run.armed = True
            self.outbox.append(outbox.ArmObjects(True))
        elif event is SessionEvent.DISARM:
            self.outbox.append(outbox.ArmObjects(False))
        elif event is SessionEvent.START:
            self._begin(now_ns)
        elif event is SessionEvent.ALL_CLEAR:
            self.outbox.append(outbox.ClearObjects())
        elif event is SessionEvent.RESET:
            self._run = None
        return Answer(True)

    def arming_failed(self, now_ns: int, reason: str) -> None:
        """An object refused to arm or didn't answer."""
        if self.state is SessionPhase.ARMED:
            self._move(SessionEvent.ARM_FAILED, now_ns, reason)
            self.outbox.append(outbox.ArmObjects(False))

    # -- what arrives --------------------------------------------------------------------------

    def on_vut_state(self, state: ObjectState) -> None:
        """Keeps the newest state; one that is older than what is known is dropped."""
        if self.vut is None or state.stamp_ns >= self.vut.stamp_ns:
            self.vut = state

    def on_target_state(self, state: ObjectState) -> None:
        """Keeps the newest state; one that is older than what is known is dropped."""
        known = self.targets.get(state.object_id)
        if known is None or state.stamp_ns >= known.stamp_ns:
            self.targets[state.object_id] = state

    def on_ack(
        self, reference_id: str, accepted: bool, code: int, message: str, now_ns: int
    ) -> None:
        """An object's answer to a reference; a refusal aborts the session."""
        if self._run is None:
            return
        reference = self._run.unanswered.pop(reference_id, None)
        if reference is None:
            return
        if accepted:
            self._run.references[reference.object_id] = reference
        else:
            self.fail(
                supervisor.Violation(
                    SafetyCode.REFERENCE_REFUSED,
                    reference.object_id,
                    float(code),
                    0.0,
                    now_ns,
                    message,
                )
            )

    def fail(self, violation: supervisor.Violation, announced: bool = False) -> None:
        """A limit was passed: announces it and aborts. The first one gives the verdict.

        Args:
            violation: which limit.
            announced: another node saw it and has published its event already.
        """
        if self.state in (SessionPhase.IDLE, SessionPhase.FINISHED, SessionPhase.ABORTED):
            return
        if self._run is not None:
            if violation.text in self._run.reasons:
                return
            if not self._run.reasons:
                self._run.verdict = supervisor.verdict_for(violation.code)
            self._run.reasons.append(violation.text)
        if not announced:
            self.outbox.append(outbox.LimitPassed(violation))
        if self.state is not SessionPhase.ABORTING:
            self._move(SessionEvent.ABORT, violation.stamp_ns, violation.text)

    def step(self, now_ns: int) -> None:
        """Judges the states of one instant: limits, triggers, phases, the end of the run.

        Args:
            now_ns: session time; the stamp of the VUT's newest state is at most that.
        """
        if self.state in (SessionPhase.RUNNING, SessionPhase.STOPPING):
            self._supervise(now_ns)
        if self.state is SessionPhase.RUNNING and self._run is not None and self.vut is not None:
            if self.vut.stamp_ns > self._run.judged_ns:
                self._run.judged_ns = self.vut.stamp_ns
                self._watch_triggers(self.vut, now_ns)
                self._watch_phases(self.vut)
            self._watch_end(now_ns)
        if self.state is SessionPhase.ABORTING:
            self._watch_collisions()
        ending = self.state in (SessionPhase.STOPPING, SessionPhase.ABORTING)
        if ending and self.stands(now_ns):
            run = self._run
            if self.state is SessionPhase.STOPPING and run and run.verdict is Verdict.NONE:
                run.verdict = Verdict.VALID
            self._move(SessionEvent.STANDSTILL, now_ns, "everything stands")

    # -- inside --------------------------------------------------------------------------------

    def _move(self, event: SessionEvent, now_ns: int, reason: str) -> None:
        """Makes a transition and announces it. Raises IllegalTransition without effect."""
        previous = self.state
        self.state = next_state(previous, event)
        self.outbox.append(
            outbox.StateChanged(
                now_ns, self.state, previous, event.value, reason, self.verdict, self.reasons
            )
        )

    def _missing(self, event: SessionEvent, now_ns: int) -> list[str]:
        if self._run is None:
            return []
        if event is SessionEvent.CONNECT:
            return readiness.missing_to_connect(self._run.spec, self.facts, self.vut, self.targets)
        if event is SessionEvent.ARM:
            return readiness.missing_to_arm(self._run.spec, self.facts, self.vut, self.targets)
        if event is SessionEvent.START:
            return readiness.missing_to_start(self._run.spec, self.facts, self.vut, self.targets)
        if event is SessionEvent.ALL_CLEAR and not self.stands(now_ns):
            return ["it is not known of everything that it stands"]
        return []

    def _abort_by_operator(self, now_ns: int, requested_by: str, reason: str) -> None:
        text = f"abort by {requested_by}" + (f": {reason}" if reason else "")
        if self._run is not None and self.state is not SessionPhase.FINISHED:
            if not self._run.reasons:
                self._run.verdict = Verdict.ABORTED
            self._run.reasons.append(text)
        violation = supervisor.Violation(SafetyCode.OPERATOR, "", 0.0, 0.0, now_ns, text)
        self.outbox.append(outbox.LimitPassed(violation))
        self._move(SessionEvent.ABORT, now_ns, text)

    def _stop_by_operator(self, requested_by: str) -> None:
        """A run that is ended before its event is resolved is no valid one."""
        run = self._run
        if run is not None and run.resolved_ns is None:
            reached = run.phase_watch.phase.name.lower()
            run.verdict = Verdict.ABORTED
            run.reasons.append(f"stopped by {requested_by} before resolution, in {reached}")

    def _begin(self, now_ns: int) -> None:
        run = self._run
        if run is None:
            return
        run.started_ns = now_ns
        self.outbox.append(outbox.PhaseBegan(now_ns, Phase.APPROACH, "start of the run"))
        for target in run.spec.targets:
            if target.approach is not None:
                address = self._address(
                    run, target.id, "approach", now_ns, dispatch.APPROACH_LEAD_S
                )
                self._send(run, dispatch.approach_reference(address, target.approach))

    def _address(
        self, run: _Run, object_id: str, purpose: str, now_ns: int, lead_s: float
    ) -> dispatch.Address:
        run.sent += 1
        return dispatch.Address(
            reference_id=f"{object_id}-{run.sent}",
            object_id=object_id,
            event_version=run.spec.event_version,
            purpose=purpose,
            dispatched_ns=now_ns,
            execute_at_ns=now_ns + seconds_to_ns(lead_s),
        )

    def _send(self, run: _Run, reference: Reference) -> None:
        run.unanswered[reference.reference_id] = reference
        self.outbox.append(outbox.Dispatch(reference))

    def _supervise(self, now_ns: int) -> None:
        run = self._run
        if run is None or run.started_ns is None or self.vut is None:
            return
        limits = run.spec.limits
        vut_age_s = ns_to_seconds(now_ns - self.vut.stamp_ns)
        found: list[supervisor.Violation | None] = [
            supervisor.silent(
                SafetyCode.VUT_SILENT, names.VUT_ID, vut_age_s, limits.state_age_s, now_ns
            )
        ]
        present = []
        for target in run.spec.targets:
            state = self.targets.get(target.id)
            last_ns = state.stamp_ns if state is not None else run.started_ns
            age_s = ns_to_seconds(now_ns - last_ns)
            silent = supervisor.silent(
                SafetyCode.OBJECT_SILENT, target.id, age_s, limits.state_age_s, now_ns
            )
            found.append(silent)
            if state is not None and silent is None:
                broken = supervisor.not_finite(state)
                if broken is not None:
                    found.append(broken)
                    continue
                present.append(state.extrapolated(self.vut.stamp_ns))
                found.append(self._own_abort(run, state, now_ns))
        found += supervisor.violations(self.vut, present, limits, run.spec.geofence)
        for reference in run.unanswered.values():
            found.append(
                supervisor.ack_missing(reference.object_id, reference.dispatched_ns, now_ns, limits)
            )
        found.append(supervisor.duration(run.started_ns, now_ns, limits))
        for violation in found:
            if violation is not None:
                self.fail(violation)

    def _watch_collisions(self) -> None:
        """While everything brakes there is one thing left to see: that two of us touch."""
        run = self._run
        if run is None or self.vut is None or not self.vut.is_finite:
            return
        everyone = [
            state.extrapolated(self.vut.stamp_ns)
            for target in run.spec.targets
            if (state := self.targets.get(target.id)) is not None and state.is_finite
        ]
        for violation in supervisor.violations(
            self.vut, everyone, run.spec.limits, run.spec.geofence
        ):
            if violation.code is SafetyCode.COLLISION:
                self.fail(violation)

    @staticmethod
    def _own_abort(run: _Run, state: ObjectState, now_ns: int) -> supervisor.Violation | None:
        """An object that stopped by itself; it is given time to say why, with a safety event."""
        violation = supervisor.own_abort(state)
        if violation is None:
            return None
        since = run.own_abort_ns.setdefault(state.object_id, now_ns)
        return violation if now_ns - since >= seconds_to_ns(OWN_REASON_S) else None

    def _watch_triggers(self, vut: ObjectState, now_ns: int) -> None:
        run = self._run
        if run is None or run.started_ns is None:
            return
        others = {
            object_id: state.extrapolated(vut.stamp_ns) for object_id, state in self.targets.items()
        }
        for trigger in run.spec.triggers:
            value = conditions.condition_value(trigger.condition, vut, others, run.path)
            watch, firing = conditions.observe(
                run.watches.get(trigger.id, conditions.Watch()),
                trigger,
                conditions.Sample(vut.stamp_ns, value),
                run.started_ns,
            )
            run.watches[trigger.id] = watch
            if firing is not None:
                self._fire(run, trigger, firing, others, now_ns)

    def _fire(
        self,
        run: _Run,
        trigger: TriggerSpec,
        firing: conditions.Firing,
        others: dict[str, ObjectState],
        now_ns: int,
    ) -> None:
        target = next(t for t in run.spec.targets if t.id == trigger.object_id)
        address = self._address(run, target.id, "manoeuvre", now_ns, trigger.lead_time_s)
        try:
            reference = dispatch.manoeuvre_reference(
                address,
                trigger.manoeuvre,
                others[target.id],
                run.references.get(target.id),
                target.approach,
            )
        except ValueError as error:
            self.fail(
                supervisor.Violation(
                    SafetyCode.EVENT_MISSING,
                    target.id,
                    self.elapsed_s(now_ns),
                    run.spec.end.at_latest_s,
                    now_ns,
                    f"trigger {trigger.id} fired, but its manoeuvre can't be driven: {error}",
                )
            )
            return
        self._send(run, reference)
        self.outbox.append(
            outbox.Triggered(
                stamp_ns=firing.fired_ns,
                trigger_id=trigger.id,
                condition=conditions.condition_text(trigger.condition),
                threshold=conditions.condition_threshold(trigger.condition),
                samples=firing.samples,
                crossing_ns=firing.crossing_ns,
                references=(reference,),
            )
        )

    def _watch_phases(self, vut: ObjectState) -> None:
        run = self._run
        if run is None:
            return
        state = self.targets.get(run.spec.triggers[0].object_id)
        if state is None:
            return
        run.phase_watch, began = phases.watch_phases(
            run.phase_watch,
            vut,
            state.extrapolated(vut.stamp_ns),
            run.path,
            run.spec.thresholds,
        )
        if began is not None:
            self.outbox.append(outbox.PhaseBegan(began.stamp_ns, began.phase, began.evidence))
            if began.phase is Phase.RESOLUTION:
                run.resolved_ns = vut.stamp_ns

    def _watch_end(self, now_ns: int) -> None:
        run = self._run
        if run is None or run.started_ns is None:
            return
        end = run.spec.end
        if run.resolved_ns is not None:
            if now_ns - run.resolved_ns >= seconds_to_ns(end.after_resolution_s):
                self._move(SessionEvent.COMPLETE, now_ns, "the event is resolved")
        elif ns_to_seconds(now_ns - run.started_ns) >= end.at_latest_s:
            reached = run.phase_watch.phase.name.lower()
            self.fail(
                supervisor.Violation(
                    SafetyCode.EVENT_MISSING,
                    "",
                    ns_to_seconds(now_ns - run.started_ns),
                    end.at_latest_s,
                    now_ns,
                    f"phase reached: {reached}",
                )
            )

    def stands(self, now_ns: int, without: Sequence[str] = ()) -> bool:
        """True when a fresh state of everything says that it stands.

        Before the session armed anything, what was never heard need not prove it.

        Args:
            now_ns: session time.
            without: objects that are not asked, because nothing can be heard of them.
        """
        if self._run is None:
            return True
        wanted = [t.id for t in self._run.spec.targets if t.id not in without]
        states = [self.vut, *(self.targets.get(object_id) for object_id in wanted)]
        if not self._run.armed:
            states = [state for state in states if state is not None]
        moving_state = (ControlState.RUNNING, ControlState.REMOTE_CONTROLLED)
        return all(
            state is not None
            and abs(state.speed_mps) <= STANDSTILL_MPS
            and ns_to_seconds(now_ns - state.stamp_ns) <= readiness.FRESH_S
            and state.control_state not in moving_state
            for state in states
        )
