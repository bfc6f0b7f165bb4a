"""One object target without ROS: heartbeats, commands, references and states in, commands out."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ssp_core.clock import seconds_to_ns
from ssp_core.reference import Reference
from ssp_core.run_spec import RunSpec
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, SessionPhase
from ssp_ot_controller.core.bodies import LIMITS, Command, brake_command, tightened
from ssp_ot_controller.core.local_safety import Continue, StopNow, decide
from ssp_ot_controller.core.object_machine import IllegalTransition, ObjectEvent, transition
from ssp_ot_controller.core.reference_check import Refusal, RefusalCode, check_reference
from ssp_ot_controller.core.tracking import Tracker, TrackingError

STANDSTILL_MPS = 0.02
# What the manager may ask for; the other events are for the object itself to notice.
_COMMANDS = frozenset(
    {
        ObjectEvent.CONNECT,
        ObjectEvent.ARM,
        ObjectEvent.DISARM,
        ObjectEvent.START,
        ObjectEvent.STOP,
        ObjectEvent.ABORT,
        ObjectEvent.ALL_CLEAR,
    }
)
# What an object does when the manager's session is in this state and the object is RUNNING.
_WHEN_RUNNING = {
    SessionPhase.RUNNING: None,
    SessionPhase.STOPPING: ObjectEvent.STOP,
    SessionPhase.FINISHED: ObjectEvent.STOP,
}


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a command of the manager (ObjectCommand.srv)."""

    accepted: bool
    error_code: int = 0
    error_msg: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one step led to: the command for the body, the state to report, a limit passed."""

    command: Command
    report: ObjectState
    stopped: StopNow | None


class Target:
    """Control state, references and local safety of one object. Reads no clock.

    Args:
        object_id: one of the run's targets.
        run: the run; gives limits, fence, K* version and step.
    """

    def __init__(self, object_id: str, run: RunSpec) -> None:
        spec = next(t for t in run.targets if t.id == object_id)
        self.object_id = object_id
        self.state = ControlState.OFF
        self._run = run
        self._body = tightened(LIMITS[spec.cls], run.limits)
        self._tracker = Tracker(spec.cls, self._body, run.step_s)
        self._own: ObjectState | None = None
        self._reference: Reference | None = None
        self._next: Reference | None = None
        self._error: TrackingError | None = None

    # -- commands ------------------------------------------------------------------------------

    def power_on(self) -> None:
        """OFF -> INIT; the first good state leads on to DISARMED."""
        self.state = transition(self.state, ObjectEvent.CONNECT)

    def command(self, event: ObjectEvent, event_version: str, heartbeat_age_s: float) -> Reply:
        """A command of the manager; refused ones change nothing.

        Args:
            event: one of the commands.
            event_version: K* version of the manager's run.
            heartbeat_age_s: since the manager's last heartbeat, inf before the first. An object
                that doesn't hear the manager is not armed: it would have to stop at once.
        """
        if event not in _COMMANDS:
            return Reply(False, 1, f"{event.name} is no command")
        if event is ObjectEvent.ARM and event_version != self._run.event_version:
            return Reply(
                False,
                3,
                f"this object has K* version {self._run.event_version[:19]}..., "
                f"the manager {event_version[:19]}...",
            )
        if event is ObjectEvent.ARM and not heartbeat_age_s <= self._run.limits.heartbeat_s:
            return Reply(
                False,
                2,
                f"no heartbeat of the manager for {heartbeat_age_s:.2g} s, limit "
                f"{self._run.limits.heartbeat_s:g} s",
            )
        if event is ObjectEvent.ALL_CLEAR and not self._stands():
            return Reply(False, 2, "the object still moves")
        try:
            self.state = transition(self.state, event)
        except IllegalTransition as error:
            return Reply(False, 1, str(error))
        if event in (ObjectEvent.ALL_CLEAR, ObjectEvent.DISARM):
            self._drop_references()
        return Reply(True)

    def on_session_state(self, session: SessionPhase) -> None:
        """What the manager's heartbeat says of the session: start, stop, abort."""
        if session in (SessionPhase.ABORTING, SessionPhase.ABORTED):
            if self.state not in (ControlState.OFF, ControlState.INIT):
                self.state = transition(self.state, ObjectEvent.ABORT)
        elif self.state is ControlState.RUNNING:
            event = _WHEN_RUNNING.get(session, ObjectEvent.ABORT)
            if event is not None:
                self.state = transition(self.state, event)
        elif self.state is ControlState.ARMED and session is SessionPhase.RUNNING:
            self.state = transition(self.state, ObjectEvent.START)

    def on_reference(self, reference: Reference, now_ns: int) -> Refusal | None:
        """Takes a reference, or says why not."""
        if self._own is None:
            return Refusal(RefusalCode.STATE, "the object has no state of its own yet")
        refusal = check_reference(
            reference,
            now_ns=now_ns,
            current=self._own,
            previous=self._next or self._reference,
            limits=self._run.limits,
            geofence=self._run.geofence,
            body_limits=self._body,
            event_version=self._run.event_version,
            control_state=self.state,
        )
        if refusal is None:
            self._next = reference
        return refusal

    def last_report(self) -> ObjectState | None:
        """The newest own state as it would be reported now, None before the first."""
        return None if self._own is None else self._report(self._own)

    def local_stop(self) -> None:
        """Stops without being told to; left by all_clear alone."""
        self.state = transition(self.state, ObjectEvent.LOCAL_STOP)

    # -- states --------------------------------------------------------------------------------

    def step(self, own: ObjectState, now_ns: int, heartbeat_age_s: float) -> Outcome:
        """Judges the newest own state and says what the body is to do until the next one.

        Args:
            own: the object's localised state.
            now_ns: session time, ns.
            heartbeat_age_s: since the manager's last heartbeat, on the watchdog's clock.
        """
        self._own = own
        self._advance(own)
        running = self.state is ControlState.RUNNING
        # A manoeuvre that waits when the object has to stop must not begin any more.
        if running and self._next is not None and now_ns >= self._next.execute_at_ns:
            self._reference, self._next, self._error = self._next, None, None
        tracking: Command | None = None
        if running and self._reference is not None and own.is_finite:
            tracking, self._error = self._tracker.track(own, self._reference, now_ns)
        verdict = decide(
            now_ns=now_ns,
            control_state=self.state,
            heartbeat_ns=now_ns - seconds_to_ns(min(heartbeat_age_s, 1e6)),
            state=own,
            reference=self._reference,
            error=self._error,
            limits=self._run.limits,
            geofence=self._run.geofence,
        )
        if isinstance(verdict, StopNow):
            self.local_stop()
        drive = isinstance(verdict, Continue) and not verdict.brake
        if drive and tracking is not None:
            command = tracking
        else:
            command = self._brake(own, now_ns)
        stopped = verdict if isinstance(verdict, StopNow) else None
        return Outcome(command, self._report(own), stopped)

    def _advance(self, own: ObjectState) -> None:
        """Transitions that the object makes by itself."""
        if self.state is ControlState.INIT and own.is_finite:
            self.state = transition(self.state, ObjectEvent.INIT_DONE)
        elif self.state is ControlState.PRE_ARMING and own.is_finite and self._stands():
            self.state = transition(self.state, ObjectEvent.PRE_ARM_DONE)
        elif self.state is ControlState.POSTRUN and self._stands():
            self.state = transition(self.state, ObjectEvent.STANDSTILL)
            self._drop_references()

    def _brake(self, own: ObjectState, now_ns: int) -> Command:
        deceleration = self._run.limits.stop_deceleration_mps2
        if self._reference is not None and own.is_finite:
            return self._tracker.brake(own, self._reference, now_ns, deceleration)
        if not own.is_finite:
            return Command(0.0, 0.0, 0.0, emergency_stop=True)
        return brake_command(own, deceleration)

    def _report(self, own: ObjectState) -> ObjectState:
        if self._reference is None or self._error is None:
            return replace(own, control_state=self.state)
        return replace(
            own,
            control_state=self.state,
            reference_id=self._reference.reference_id,
            error_longitudinal_m=self._error.longitudinal_m,
            error_lateral_m=self._error.lateral_m,
            error_yaw_rad=self._error.yaw_rad,
        )

    def _stands(self) -> bool:
        return self._own is not None and abs(self._own.speed_mps) <= STANDSTILL_MPS

    def _drop_references(self) -> None:
        self._reference = self._next = self._error = None
