"""An object on its references: which one it drives, how far off it is, and where it could stop.

This file owns the references that were taken and the tracking error; both are forgotten together.
Reads no clock.
"""

from __future__ import annotations

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.dynamics import LIMITS, Command, brake_command, tightened
from ssp_ot_controller.control.stopping import StoppingRoom
from ssp_ot_controller.control.tracker import Tracker, TrackingError
from ssp_ot_controller.objects.local_safety import reference_over
from ssp_ot_controller.objects.references import ReferenceQueue, Refusal, check_reference
from ssp_ot_controller.objects.rules import Rules


def room_of(spec: ParticipantSpec, run: Rules, slows_s: float = 0.0) -> StoppingRoom:
    """Return the room for an object's stops; arguments as for ``StoppingRoom``."""
    return StoppingRoom(spec.cls, spec.size, run.limits, run.geofence, run.step_s, slows_s)


class Driving:
    """References, tracker and stopping room of one object.

    Args:
        spec: of the object.
        run: the rules that it judges by.

    Attributes:
        queue: the references that were taken.
        error: of the last tracking step of the present reference; None when there was none.

    Raises:
        HostError: the package that the tracker needs isn't installed.
    """

    def __init__(self, spec: ParticipantSpec, run: Rules) -> None:
        self.queue = ReferenceQueue()
        self.error: TrackingError | None = None
        self._spec, self._run = spec, run
        self._body_limits = tightened(LIMITS[spec.cls], run.limits)
        self._tracker = Tracker(spec.cls, self._body_limits, run.step_s)
        self._stop_room = room_of(spec, run)

    def brake_late(self, slows_s: float) -> None:
        """Judge stops by the time that the object's body takes until it slows, s."""
        self._stop_room = room_of(self._spec, self._run, slows_s)

    def check(
        self, reference: Reference, now_ns: int, own: ObjectState, control_state: ControlState
    ) -> Refusal | None:
        """Say why a reference would be refused, None when it would be taken; changes nothing."""
        return check_reference(
            reference,
            now_ns=now_ns,
            current=own,
            previous=self.queue.before(reference.execute_at_ns),
            limits=self._run.limits,
            geofence=self._run.geofence,
            body_limits=self._body_limits,
            event_version=self._run.event_version,
            control_state=control_state,
            stop_room=self._stop_room,
        )

    def advance(self, now_ns: int) -> None:
        """Begin what is due."""
        if self.queue.advance(now_ns):
            self.error = None

    def clear(self) -> None:
        """Forget all references."""
        self.queue.clear()
        self.error = None

    def reference_speed_mps(self, now_ns: int) -> float:
        """Return the speed of its reference, unless the object is ahead of it and may wait."""
        reference = self.queue.current
        if reference is None or self.error is None or reference_over(reference, now_ns):
            return 0.0
        if self.error.longitudinal_m > 0.0:
            return 0.0
        track = self._tracker.track_of(reference)
        return track.speed_mps(track.seconds(now_ns))

    def track(self, here: ObjectState, now_ns: int) -> Command | None:
        """Return the command of the present reference; None without one."""
        if self.queue.current is None:
            return None
        command, self.error = self._tracker.track(here, self.queue.current, now_ns)
        return command

    def brake(self, own: ObjectState, now_ns: int, deceleration_mps2: float) -> Command:
        """Return the command that brakes, along the present reference where there is one."""
        if self.queue.current is None:
            return brake_command(own, deceleration_mps2)
        return self._tracker.brake(own, self.queue.current, now_ns, deceleration_mps2)

    def outside_m(self, own: ObjectState) -> float:
        """Compute how far the object sticks out of the fence, here or since the last state."""
        return self._stop_room.outside_m(own)

    def room_excess_m(self, here: ObjectState, now_ns: int) -> float:
        """Compute how far a stop from here would end outside the fence, 0 for inside."""
        reference = self.queue.current
        if reference is None or self.error is None:
            return self._stop_room.excess_m(here, None, None)
        track = self._tracker.track_of(reference)
        left_m = track.left_m(track.seconds(now_ns), self.error.longitudinal_m)
        return self._stop_room.excess_m(here, left_m, track)

    def report(self, own: ObjectState, control_state: ControlState) -> ObjectState:
        """Return the own state with the reference that is driven, and the errors off it."""
        reference, error = self.queue.current, self.error
        if reference is None or error is None:
            as_given = own.error_longitudinal_m, own.error_lateral_m, own.error_yaw_rad
            return own.reported(control_state, own.reference_id, as_given)
        errors = error.longitudinal_m, error.lateral_m, error.yaw_rad
        return own.reported(control_state, reference.reference_id, errors)
