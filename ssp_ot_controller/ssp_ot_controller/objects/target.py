"""One object target without ROS: heartbeats, commands, references and states in, commands out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.limits import (
    Continuity,
    LimitViolation,
    follow,
    has_stood,
    net_way_m,
    state_contradicts,
)
from ssp_core.safety.start_heading import start_heading
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.body import BodyCheck, Decided
from ssp_ot_controller.bodies.dynamics import LIMITS, Command, brake_command, tightened
from ssp_ot_controller.control.stopping import BrakeMonitor, StoppingRoom
from ssp_ot_controller.control.tracker import Tracker, TrackingError
from ssp_ot_controller.objects.local_safety import (
    WATCHED,
    SafetyInputs,
    decide,
    is_idle,
    lost_its_place,
    reference_over,
)
from ssp_ot_controller.objects.references import (
    ReferenceQueue,
    Refusal,
    RefusalCode,
    check_reference,
)
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

# An object that knows its own motion has stopped below this speed.
OWN_STANDSTILL_MPS = 0.02
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
        # The abort that it heard of since it stopped, and the last one that was cleared.
        self._abort_id: str | None = None
        self._cleared_id: str | None = None
        # Of a body with a control state of its own.
        self.body = BodyCheck()
        self._run = run
        self._body_limits = tightened(LIMITS[spec.cls], run.limits)
        self.tracker = Tracker(spec.cls, self._body_limits, run.step_s)
        self._stop_room = StoppingRoom(spec.cls, spec.size, run.limits, run.geofence, run.step_s)
        self._own: ObjectState | None = None
        self._continuity = Continuity()
        self._motion = ConsistencyWatch(Bounds.of(object_id, spec.cls, run.limits))
        self._heading = start_heading(spec, run.limits)
        self._queue = ReferenceQueue()
        self._error: TrackingError | None = None
        self._refused = 0
        # An object that has lost its place is blind until it is cleared, whatever it sees later.
        self._blind = False
        self._running_since_ns: int | None = None
        # How long it has been braking; one whose brakes failed brakes hard until it is cleared.
        self._braking: BrakeMonitor | None = None
        self._hard = False
        self._told: LimitViolation | None = None
        self._command = Command(0.0, 0.0, spec.start.yaw_rad)

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
            if (doubt := self._motion.doubt) is not None:
                text = f"its states contradict its places: {doubt.text}"
                return CommandResponse(False, REFUSED_CONDITION, text)
        if event is ObjectEvent.ALL_CLEAR and self.state is ControlState.ABORTING:
            if abort_id is not None and abort_id != self._abort_id:
                return CommandResponse(False, REFUSED_CONDITION, "another abort than that stops it")
            if not self._stands():
                return CommandResponse(False, REFUSED_CONDITION, "the object still moves")
        elif event is ObjectEvent.ALL_CLEAR and abort_id and abort_id == self._cleared_id:
            return CommandResponse(True)  # asked again, because the answer was lost
        try:
            self.state = transition(self.state, event)
        except IllegalTransition as error:
            return CommandResponse(False, REFUSED_TRANSITION, str(error))
        if event in (ObjectEvent.ALL_CLEAR, ObjectEvent.DISARM):
            self._drop_references()
            self._blind = self._hard = False
        if event is ObjectEvent.ALL_CLEAR:
            self._abort_id, self._cleared_id = None, abort_id or ""
        return CommandResponse(True)

    def on_session_state(self, session: SessionPhase, abort_id: str = "") -> None:
        """Obey the session's state in the manager's heartbeat: start, stop, abort.

        Args:
            session: state that the heartbeat names.
            abort_id: names the session's newest abort.
        """
        aborted = session in (SessionPhase.ABORTING, SessionPhase.ABORTED)
        if aborted and abort_id and abort_id == self._cleared_id:
            return  # it was under way when that abort was cleared
        self.session = session
        if aborted:
            self._abort_id = abort_id
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
        if self._queue.has_taken(reference):
            return None
        if self._own is None:
            return Refusal(RefusalCode.STATE, _NO_STATE)
        newer = self._queue.overtaker(reference) if reference.purpose == "adapted" else None
        if newer is not None:
            text = f"came after {newer.reference_id}, which was sent later and waits already"
            return Refusal(RefusalCode.LATE, text)
        refusal = self.check(reference, now_ns, self.state)
        if refusal is None:
            self._queue.take(reference)
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
        if self._own is None:
            return Refusal(RefusalCode.STATE, _NO_STATE)
        return check_reference(
            reference,
            now_ns=now_ns,
            current=self._own,
            previous=self._queue.before(reference.execute_at_ns),
            limits=self._run.limits,
            geofence=self._run.geofence,
            body_limits=self._body_limits,
            event_version=self._run.event_version,
            control_state=control_state,
            stop_room=self._stop_room,
        )

    def _can_do_without(self, reference: Reference, refusal: Refusal) -> bool:
        """Tell whether an adapted reference came too late to adapt what is driven or waits."""
        late = refusal.code in (RefusalCode.LATE, RefusalCode.DISCONTINUOUS)
        return reference.purpose == "adapted" and late and not self._queue.is_empty

    @property
    def decided(self) -> Decided:
        """Return the decision for a body that follows trajectories by itself."""
        return Decided(self.session, self.state, self._queue.planned)

    def last_report(self) -> ObjectState | None:
        """Return the newest own state as it would be reported now, None before the first."""
        return None if self._own is None else self._report(self._own)

    def local_stop(self) -> None:
        """Stop without being told to; left by all_clear alone, once the session has aborted."""
        if self.state is not ControlState.ABORTING:
            self._abort_id = None
        self.state = transition(self.state, ObjectEvent.LOCAL_STOP)

    def stop_blindly(self) -> Command:
        """Stop without being told to and without states; return the command for the body."""
        self.local_stop()
        self._blind = True
        return self._hold_steering()

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
        self._own = own
        if own.is_finite:
            self._motion.see(own)
        self._advance(own)
        running = self.state is ControlState.RUNNING
        running_s = self._running_s(now_ns)
        # A manoeuvre that waits when the object has to stop must not begin any more.
        if running and self._queue.advance(now_ns):
            self._error = None
        reference = self._queue.current
        asked_mps = self._asked_mps(now_ns) if running else 0.0
        self._continuity, broken = follow(self._continuity, own, self._run.limits, asked_mps)
        if (contradicts := state_contradicts(self._motion)) is not None:
            broken.append(contradicts)
        if (turned := self._turned(own, running=running)) is not None:
            broken.append(turned)
        lost = lost_its_place(own, now_ns, broken, self._run.limits)
        if lost is not None and self.state in _MAY_MOVE:
            self._blind = True
        tracking: Command | None = None
        room_excess_m = 0.0
        if running and lost is None:
            # A state that is a little late is led on; one that is too late is no state.
            here = own if own.stamp_ns == now_ns else own.extrapolated(now_ns)
            if reference is not None:
                tracking, self._error = self.tracker.track(here, reference, now_ns)
            room_excess_m = self._room_excess_m(here, reference, now_ns)
        refused, self._refused = self._refused, 0
        stopped = decide(
            SafetyInputs(
                heartbeat_age_s=heartbeat_age_s,
                state=own,
                reference=reference,
                error=self._error,
                running_s=running_s,
                lost=lost,
                other_managers=other_managers,
                outside_m=self._stop_room.outside_m(own),
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
        if self._blind:
            command = self._hold_steering()
        elif tracking is None or is_idle(self.state, reference, now_ns):
            command = self._brake(own, now_ns)
        else:
            command, self._braking = tracking, None
        self._command = command
        return TargetStep(command, self._report(own), stopped)

    def _turned(self, own: ObjectState, *, running: bool) -> LimitViolation | None:
        """Judge how far the object faces off its start's heading, once its first metre shows it."""
        if self._heading is None or not own.is_finite:
            return None
        if not running:
            self._heading.clear()
            return None
        return self._heading.see(own, stands=has_stood(own, self._motion))

    def _body_violation(self) -> LimitViolation | None:
        """Find a violation by the body itself; each is reported once."""
        found, told = self.body.violation, self._told
        self._told = found
        return None if found == told else found

    def _running_s(self, now_ns: int) -> float:
        """Return the time since the first step in RUNNING, 0 elsewhere."""
        if self.state is not ControlState.RUNNING:
            self._running_since_ns = None
            return 0.0
        if self._running_since_ns is None:
            self._running_since_ns = now_ns
        return ns_to_seconds(now_ns - self._running_since_ns)

    def _asked_mps(self, now_ns: int) -> float:
        """Return the speed of its reference, unless the object is ahead of it and may wait."""
        reference = self._queue.current
        if reference is None or self._error is None or reference_over(reference, now_ns):
            return 0.0
        if self._error.longitudinal_m > 0.0:
            return 0.0
        track = self.tracker.track_of(reference)
        return track.speed_mps(track.seconds(now_ns))

    def _room_excess_m(self, own: ObjectState, reference: Reference | None, now_ns: int) -> float:
        if reference is None or self._error is None:
            return self._stop_room.excess_m(own, None, None)
        track = self.tracker.track_of(reference)
        left_m = track.left_m(track.seconds(now_ns), self._error.longitudinal_m)
        return self._stop_room.excess_m(own, left_m, track)

    def _advance(self, own: ObjectState) -> None:
        """Make the transitions that the object makes by itself."""
        if self.state is ControlState.INIT and own.is_finite:
            self.state = transition(self.state, ObjectEvent.INIT_DONE)
        elif self.state is ControlState.PRE_ARMING and own.is_finite and self._stands():
            if self.body.armed:
                self.state = transition(self.state, ObjectEvent.PRE_ARM_DONE)
        elif self.state is ControlState.POSTRUN and self._stands():
            self.state = transition(self.state, ObjectEvent.STANDSTILL)
            self._drop_references()

    def _brake(self, own: ObjectState, now_ns: int) -> Command:
        if not own.is_finite:
            return self._hold_steering()
        deceleration = self._run.limits.stop_deceleration_mps2
        if self._braking is None:
            self._braking = BrakeMonitor(now_ns, own.speed_mps)
        elif self._braking.fails(own.speed_mps, now_ns, deceleration):
            self._hard = True
        reference = self._queue.current
        if reference is not None:
            command = self.tracker.brake(own, reference, now_ns, deceleration)
        else:
            command = brake_command(own, deceleration)
        return replace(command, emergency_stop=True) if self._hard else command

    def _hold_steering(self) -> Command:
        """Return the last steering, and the brakes as hard as they go."""
        return replace(self._command, acceleration_mps2=0.0, emergency_stop=True)

    def _report(self, own: ObjectState) -> ObjectState:
        reference, error = self._queue.current, self._error
        if reference is None or error is None:
            as_given = own.error_longitudinal_m, own.error_lateral_m, own.error_yaw_rad
            return own.reported(self.state, own.reference_id, as_given)
        errors = error.longitudinal_m, error.lateral_m, error.yaw_rad
        return own.reported(self.state, reference.reference_id, errors)

    def _stands(self) -> bool:
        own = self._own
        stands = own is not None and abs(own.speed_mps) <= OWN_STANDSTILL_MPS
        return stands and net_way_m(self._motion) is None

    def _drop_references(self) -> None:
        self._queue.clear()
        self._error = None
