"""One object target without ROS: heartbeats, commands, references and states in, commands out.

This file owns the control state: every transition is made here. What is remembered of states,
references, aborts and brakes is owned by the parts; an all-clear or a disarm clears references and
brakes together.
"""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.body import BodyCheck, TrajectoryDecision
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.control.stopping import Brakes
from ssp_ot_controller.objects.aborts import Aborts
from ssp_ot_controller.objects.driving import Driving
from ssp_ot_controller.objects.local_safety import (
    WATCHED,
    SafetyInputs,
    decide,
    is_idle,
    lost_its_place,
)
from ssp_ot_controller.objects.own_states import OwnStates
from ssp_ot_controller.objects.references import Refusal, RefusalCode
from ssp_ot_controller.objects.rules import Rules
from ssp_ot_controller.objects.state_machine import (
    COMMANDS,
    REFUSED_CONDITION,
    REFUSED_TRANSITION,
    CommandResponse,
    IllegalTransition,
    ObjectEvent,
    cannot_arm,
    transition,
)

# Limits that an object exceeds by standing still when it should drive.
_WHERE_IT_STANDS = (SafetyCode.STATE_FROZEN, SafetyCode.ERROR_LONGITUDINAL)
_NO_STATE = "the object has no state of its own yet"
# States in which an object moves or is about to.
_MAY_MOVE = WATCHED | {ControlState.ABORTING}
# What an object does when the manager's session is in this state and the object is RUNNING.
_WHEN_RUNNING = {
    SessionPhase.RUNNING: None,
    SessionPhase.STOPPING: ObjectEvent.STOP,
    SessionPhase.FINISHED: ObjectEvent.STOP,
}


@value_class(frozen=True, slots=True)
class TargetStep:
    """The result of one step: the command for the body, the state to report, a limit passed."""

    command: Command
    report: ObjectState
    stopped: LimitViolation | None


class Target:
    """Control state, references and local safety of one object. Reads no clock.

    Args:
        object_id: one of the run's targets.

    Raises:
        HostError: the package that its tracker needs isn't installed.
    """

    def __init__(self, object_id: str, run: Rules) -> None:
        spec = next(t for t in run.targets if t.id == object_id)
        self.object_id = object_id
        self.state = ControlState.OFF
        self.session = SessionPhase.UNKNOWN
        self._body = BodyCheck()
        self._run = run
        self._aborts = Aborts()
        self._states = OwnStates(spec, run.limits)
        self._driving = Driving(spec, run)
        self._brakes = Brakes(run.limits.stop_deceleration_mps2, spec.start.yaw_rad)
        self._refused = 0
        self._running_since_ns: int | None = None
        self._last_violation: LimitViolation | None = None

    @property
    def body(self) -> BodyCheck:
        """Return what a body with a control state of its own is found to be."""
        return self._body

    @body.setter
    def body(self, check: BodyCheck) -> None:
        if check.slows_s != self._body.slows_s:
            self._driving.brake_late(check.slows_s)
        self._body = check

    # -- commands ------------------------------------------------------------------------------

    def power_on(self) -> None:
        """Go from OFF to INIT; the first good state leads on to DISARMED."""
        self.state = transition(self.state, ObjectEvent.CONNECT)

    def command(
        self,
        event: ObjectEvent,
        event_version: str,
        heartbeat_age_s: float,
        other_managers: int = 0,
        abort_id: str | None = "",
    ) -> CommandResponse:
        """Obey a command of the manager; refused ones change nothing.

        Args:
            event: one of COMMANDS.
            event_version: K* version of the manager's run.
            heartbeat_age_s: since the manager's last heartbeat, inf before the first. An object
                that doesn't hear the manager is not armed: it would have to stop at once.
            other_managers: how many managers beside ours send heartbeats; with any it isn't armed.
            abort_id: of the abort that an all-clear clears. It clears no other; None clears
                whatever stops the object, as the all-clear of ISO 22133 does, which names none.
        """
        if event not in COMMANDS:
            return CommandResponse(False, REFUSED_TRANSITION, f"{event.name} is no command")
        if event is ObjectEvent.ARM:
            refusal = cannot_arm(
                self._run, event_version, heartbeat_age_s, other_managers, self.body
            )
            if refusal is not None:
                return refusal
            if (doubt := self._states.doubt) is not None:
                text = f"its states contradict its places: {doubt.text}"
                return CommandResponse(False, REFUSED_CONDITION, text)
        if event is ObjectEvent.ALL_CLEAR and self.state is ControlState.ABORTING:
            if not self._aborts.may_clear(abort_id):
                return CommandResponse(False, REFUSED_CONDITION, "another abort than that stops it")
            if not self._states.stands:
                return CommandResponse(False, REFUSED_CONDITION, "the object still moves")
        elif event is ObjectEvent.ALL_CLEAR and self._aborts.is_cleared(abort_id):
            return CommandResponse(True)  # asked again, because the answer was lost
        try:
            self.state = transition(self.state, event)
        except IllegalTransition as error:
            return CommandResponse(False, REFUSED_TRANSITION, str(error))
        if event in (ObjectEvent.ALL_CLEAR, ObjectEvent.DISARM):
            self._driving.clear()
            self._brakes.clear()
        if event is ObjectEvent.ALL_CLEAR:
            self._aborts.clear(abort_id)
        return CommandResponse(True)

    def on_session_state(self, session: SessionPhase, abort_id: str = "") -> None:
        """Obey the session's state in the manager's heartbeat: start, stop, abort.

        Args:
            session: state that the heartbeat names.
            abort_id: names the session's newest abort.
        """
        aborted = session in (SessionPhase.ABORTING, SessionPhase.ABORTED)
        if aborted and self._aborts.is_cleared(abort_id):
            return  # it was under way when that abort was cleared
        self.session = session
        if aborted:
            self._aborts.hear(abort_id)
            if self.state not in (ControlState.OFF, ControlState.INIT):
                self.state = transition(self.state, ObjectEvent.ABORT)
        elif self.state is ControlState.RUNNING:
            event = _WHEN_RUNNING.get(session, ObjectEvent.ABORT)
            if event is not None:
                self.state = transition(self.state, event)
        elif self.state is ControlState.ARMED and session is SessionPhase.RUNNING:
            self.state = transition(self.state, ObjectEvent.START)

    def on_reference(self, reference: Reference, now_ns: int) -> Refusal | None:
        """Take a reference, or say why not; one that was taken before is taken again."""
        if self._driving.queue.has_accepted(reference):
            return None
        if self._states.newest is None:
            return Refusal(RefusalCode.STATE, _NO_STATE)
        adapted = reference.purpose == "adapted"
        newer = self._driving.queue.overtaker(reference) if adapted else None
        if newer is not None:
            text = f"came after {newer.reference_id}, which was sent later and waits already"
            return Refusal(RefusalCode.LATE, text)
        refusal = self.check(reference, now_ns, self.state)
        if refusal is None:
            self._driving.queue.take(reference)
        elif self.state is ControlState.RUNNING and not self._can_do_without(reference, refusal):
            # An object sent an undrivable reference while driving no longer knows its task.
            self._refused = self._refused or int(refusal.code)
        return refusal

    def check(
        self, reference: Reference, now_ns: int, control_state: ControlState
    ) -> Refusal | None:
        """Say why a reference would be refused, None when it would be taken; changes nothing.

        Args:
            reference: to be checked.
            now_ns: on the object's clock.
            control_state: that the object has when it gets the reference.
        """
        own = self._states.newest
        if own is None:
            return Refusal(RefusalCode.STATE, _NO_STATE)
        return self._driving.check(reference, now_ns, own, control_state)

    def _can_do_without(self, reference: Reference, refusal: Refusal) -> bool:
        """Tell whether an adapted reference came too late to adapt what is driven or waits."""
        late = refusal.code in (RefusalCode.LATE, RefusalCode.DISCONTINUOUS)
        return reference.purpose == "adapted" and late and not self._driving.queue.is_empty

    @property
    def decided(self) -> TrajectoryDecision:
        """Return the decision for a body that follows trajectories by itself."""
        return TrajectoryDecision(self.session, self.state, self._driving.queue.planned)

    def last_report(self) -> ObjectState | None:
        """Return the newest own state as it would be reported now, None before the first."""
        own = self._states.newest
        return None if own is None else self._driving.report(own, self.state)

    def local_stop(self) -> None:
        """Stop without a command; left by all_clear alone, once the session has aborted."""
        if self.state is not ControlState.ABORTING:
            self._aborts.forget()
        self.state = transition(self.state, ObjectEvent.LOCAL_STOP)

    def stop_blindly(self) -> Command:
        """Stop without a command and without states; return the command for the body."""
        self.local_stop()
        return self._brakes.stop_blindly()

    # -- states --------------------------------------------------------------------------------

    def step(
        self,
        own: ObjectState,
        now_ns: int,
        heartbeat_age_s: float,
        others: Sequence[ObjectState] = (),
        other_managers: int = 0,
    ) -> TargetStep:
        """Judge the newest own state and say what the body is to do until the next one.

        Args:
            own: the object's localised state.
            now_ns: on the object's clock.
            heartbeat_age_s: since the manager's last heartbeat, on the watchdog's clock.
            others: states of other objects, as far as they are heard; at the stamp of the own one.
            other_managers: how many managers beside ours send heartbeats.
        """
        driving = self._driving
        self._states.see(own)
        self._advance(own)
        running = self.state is ControlState.RUNNING
        running_s = self._running_s(now_ns)
        # A manoeuvre that waits when the object has to stop must not begin any more.
        if running:
            driving.advance(now_ns)
        reference = driving.queue.current
        asked_mps = driving.reference_speed_mps(now_ns) if running else 0.0
        may_move = self.state in _MAY_MOVE
        broken = self._states.judge(own, asked_mps=asked_mps, may_move=may_move, running=running)
        lost = lost_its_place(own, now_ns, broken, self._run.limits)
        if lost is not None and may_move:
            self._brakes.blind = True
        tracking: Command | None = None
        room_excess_m = 0.0
        if running and lost is None:
            # A state that is a little late is led on; one that is too late is no state.
            here = own if own.stamp_ns == now_ns else own.extrapolated(now_ns)
            tracking = driving.track(here, now_ns)
            room_excess_m = driving.room_excess_m(here, now_ns)
        refused, self._refused = self._refused, 0
        stopped = decide(
            SafetyInputs(
                heartbeat_age_s=heartbeat_age_s,
                state=own,
                reference=reference,
                error=driving.error,
                running_s=running_s,
                lost=lost,
                other_managers=other_managers,
                outside_m=driving.outside_m(own),
                room_excess_m=room_excess_m,
                refused=refused,
                others=others,
            ),
            now_ns=now_ns,
            control_state=self.state,
            limits=self._run.limits,
        )
        missed = self.body.missed_start
        if stopped is not None and missed is not None and stopped.code in _WHERE_IT_STANDS:
            stopped = missed
        stopped = stopped or self._body_violation()
        if stopped is not None:
            self.local_stop()
        if self._brakes.blind:
            command = self._brakes.stop_blindly()
        elif tracking is None or is_idle(self.state, reference, now_ns):
            command = self._brake(own, now_ns)
        else:
            command = self._brakes.release(tracking)
        return TargetStep(command, driving.report(own, self.state), stopped)

    def _body_violation(self) -> LimitViolation | None:
        """Find a violation by the body itself; each is reported once."""
        violation, last_violation = self.body.violation, self._last_violation
        self._last_violation = violation
        return None if violation == last_violation else violation

    def _running_s(self, now_ns: int) -> float:
        """Return the time since the first step in RUNNING, 0 elsewhere."""
        if self.state is not ControlState.RUNNING:
            self._running_since_ns = None
            return 0.0
        if self._running_since_ns is None:
            self._running_since_ns = now_ns
        return ns_to_seconds(now_ns - self._running_since_ns)

    def _advance(self, own: ObjectState) -> None:
        """Make the transitions that the object makes by itself."""
        if self.state is ControlState.INIT and own.is_finite:
            self.state = transition(self.state, ObjectEvent.INIT_DONE)
        elif self.state is ControlState.PRE_ARMING and own.is_finite and self._states.stands:
            if self.body.armed:
                self.state = transition(self.state, ObjectEvent.PRE_ARM_DONE)
        elif self.state is ControlState.POSTRUN and self._states.stands:
            self.state = transition(self.state, ObjectEvent.STANDSTILL)
            self._driving.clear()

    def _brake(self, own: ObjectState, now_ns: int) -> Command:
        if not own.is_finite:
            return self._brakes.hold_steering()
        command = self._driving.brake(own, now_ns, self._run.limits.stop_deceleration_mps2)
        return self._brakes.brake(own.speed_mps, now_ns, command)
