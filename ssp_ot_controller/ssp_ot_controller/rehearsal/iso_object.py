"""SSP's own ISO 22133 object without I/O: bytes of a control centre in, its own out.

``Target`` judges and follows as it does for our own manager, a simulated body moves. The centre's
frame is ENU at the origin of its OSEM; frame map is where the object stands and its fence lies.
Nothing here reads a clock.

This file owns where the object is, what it would drive from its start (``PlannedTrajectory``), and
why it stops by itself (``OwnStop``). ``CentreLink`` owns the connection, ``Target`` its state. A
new centre finds the body where it is, and no trajectory of another centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import ssp_core
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2, wrap_angle, wrap_angles
from ssp_core.motion.reference import Points, Reference
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.body import BodyReading, state_of
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.bodies.iso22133.framing import (
    Frame,
    RejectedBytes,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    END_OF_TRANSMISSION,
    SIMULATED_OBJECT,
    CentreStatus,
    Dreq,
    Dres,
    DriveDirection,
    Heab,
    Monr,
    ObjectCommand,
    ObjectError,
    Opaque,
    Osem,
    OsemTestMode,
    Ostm,
    ReadyToArm,
    Strt,
    Traj,
    TrajectoryInfo,
    decode,
)
from ssp_ot_controller.bodies.iso22133.states import session_of
from ssp_ot_controller.bodies.iso22133.trajectories import points_of
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns, to_gps
from ssp_ot_controller.objects.own_states import OWN_STANDSTILL_MPS
from ssp_ot_controller.objects.rules import ObjectRules
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.objects.target import Target
from ssp_ot_controller.rehearsal.centre_link import CentreLink, OutgoingFrame
from ssp_ot_controller.rehearsal.iso_settings import (
    RefusalReason,
    frame_of,
    invalid,
    not_now,
    problem_of,
    tightened,
    unsupported,
)
from ssp_ot_controller.rehearsal.played import PUT_BACK_S, is_away

# The object judges and its body moves this often.
STEP_S = 0.005
_STEP_NS = seconds_to_ns(STEP_S)
# One sigma of its localisation.
POSITION_STD_M = 0.02
# A centre that has sent STRT may still say READY for so long.
HEAB_LAG_S = 0.5
# A STRT that comes so long after its time still says from when the trajectory's times count.
LATE_START_S = 0.3
# It reports for so long that it stands before it gives a silent centre's connection up.
_STOOD_NS = 3 * NS_PER_S // 2
_RESTING = (ControlState.INIT, ControlState.DISARMED, ControlState.ABORTING)
_BEFORE_START = (*_RESTING, ControlState.PRE_ARMING, ControlState.ARMED)
# What leaves nothing latched: the next control centre begins anew.
_LOST = (SafetyCode.HEARTBEAT_LOST, SafetyCode.CONNECTION_LOST)
_EVENTS = {
    ObjectCommand.ARM: ObjectEvent.ARM,
    ObjectCommand.DISARM: ObjectEvent.DISARM,
    ObjectCommand.ALL_CLEAR: ObjectEvent.ALL_CLEAR,
}
# Heartbeats that take back a start that hasn't come yet.
_NO_START = (
    SessionPhase.CONNECTED,
    SessionPhase.STOPPING,
    SessionPhase.FINISHED,
    SessionPhase.ABORTING,
)


class PlannedTrajectory:
    """The trajectory that an object drives from its start.

    Attributes:
        trajectory: its points in frame map, and its name; None: it stands.
        is_refused: the newest one is refused: the object must not be armed with an older one, or
            with none.
    """

    def __init__(self) -> None:
        self.trajectory: tuple[Points, str] | None = None
        self.is_refused = False
        self._count = 0

    def forget(self) -> None:
        """Forget the trajectory: the object stands at its start."""
        self.trajectory, self.is_refused = None, False

    def name_of(self, traj: Traj) -> str:
        """Return a name that no trajectory before had."""
        self._count += 1
        return f"{traj.name or 'trajectory'} {traj.trajectory_id} ({self._count})"

    def take(self, points: Points, name: str) -> None:
        """Take a trajectory that can be driven."""
        self.trajectory, self.is_refused = (points, name), False


@dataclass(slots=True)
class OwnStop:
    """A stop that the object made by itself.

    Args:
        cause: None: there was none, or it was cleared.
        lost_centre: it stopped because it lost its centre: nothing is latched when it stands.
    """

    cause: SafetyCode | None = None
    lost_centre: bool = False


class IsoObject:
    """One object and the one control centre that may drive it.

    Args:
        datum: of frame map; None: unknown, and the frame of the centre's OSEM is frame map.

    Attributes:
        body: where the object is.
        link: the connection with the control centre.
    """

    def __init__(
        self,
        rules: ObjectRules,
        now_ns: int,
        datum: Datum | None = None,
    ) -> None:
        self.body = BodyState.at_rest(rules.spec.start.pose)
        self.link = CentreLink(now_ns)
        self.started_ns: int | None = None
        self._rules, self._datum = rules, datum
        # Ours, tightened to what the centre's OSEM asks for.
        self._tight = rules
        self._now_ns = now_ns
        self._states = 0
        self._frame = Pose2(0.0, 0.0, 0.0)
        self._planned = PlannedTrajectory()
        self._start_ns: int | None = None
        self._stop = OwnStop()
        self._last_motion_ns = now_ns - _STOOD_NS
        self._new_rules = False
        self._target = self._new_target(rules)

    @property
    def object_id(self) -> str:
        """Id of the object in its run."""
        return self._rules.spec.id

    # -- the control centre --------------------------------------------------------------------

    @property
    def state(self) -> ControlState:
        """Return the reported state: INIT until a control centre is connected."""
        state = self._target.state
        alone = self.link.host is None or self.link.closes
        return ControlState.INIT if alone and state is ControlState.DISARMED else state

    @property
    def brakes_by_itself(self) -> bool:
        """It stops, whatever trajectory it was sent."""
        return self._target.state is ControlState.ABORTING

    def connect(self, host: str, now_ns: int) -> bool:
        """Connect a control centre by TCP; return False where another one is connected already."""
        self.advance(now_ns)
        if not self.link.open(host):
            return False
        self._tight = self._rules
        # What another centre sent is not driven for this one.
        self._planned.forget()
        return True

    def disconnect(self, now_ns: int) -> None:
        """End the connection, from whichever side."""
        self.advance(now_ns)
        if not self.link.close():
            return
        self._start_ns = None
        if self._target.state not in _RESTING:
            self._target.local_stop()
            self._begin_own_stop(LimitViolation(SafetyCode.CONNECTION_LOST, 0.0, 0.0))

    def on_tcp(self, data: bytes, now_ns: int) -> None:
        """Take bytes of the connection, in pieces of any size."""
        self.advance(now_ns)
        self._take(self.link.feed(data, now_ns))

    def on_udp(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Take a datagram; hear only the centre that is connected, from one port."""
        self.advance(now_ns)
        if not self.link.is_from_centre(address):
            return
        for frame in frames_of(data):
            outcome = decode(frame) if isinstance(frame, Frame) else frame
            if isinstance(outcome, RejectedBytes):
                self.link.note(f"datagram refused: {outcome.reason.value}: {outcome.text}")
            elif isinstance(outcome.message, Heab):
                self.link.address = address
                self._on_heab(outcome.message)
            else:
                self.link.note(f"{type(outcome.message).__name__} by UDP isn't heard")

    def _take(self, frames: list[Frame | RejectedBytes]) -> None:
        for frame in frames:
            outcome = decode(frame) if isinstance(frame, Frame) else frame
            if isinstance(outcome, RejectedBytes):
                self.link.note(f"refused: {outcome.reason.value}: {outcome.text}")
                if isinstance(frame, Frame):
                    self.link.answer(frame.header, invalid(outcome.text))
                continue
            handler = _HANDLERS.get(type(outcome.message))
            name = type(outcome.message).__name__.upper()
            if isinstance(outcome.message, Opaque):
                name = f"message 0x{outcome.message.message_id:02X}"
            refused = (
                unsupported("isn't supported")
                if handler is None
                else handler(self, outcome.message)
            )
            if refused is not None:
                self.link.note(f"{name} refused: {refused.text}")
            elif not isinstance(outcome.message, Dreq):
                self.link.note(f"{name} taken")
            self.link.answer(outcome.header, refused)

    # -- messages ------------------------------------------------------------------------------

    def _on_osem(self, osem: Osem) -> RefusalReason | None:
        if self._target.state not in _RESTING:
            return not_now(f"settings aren't taken in {self.state.name}")
        refused = problem_of(osem, self._now_ns)
        frame = refused or frame_of(osem, self._datum)
        if isinstance(frame, RefusalReason):
            return frame
        self.link.take_settings(osem, self._now_ns)
        self._frame, self._tight = frame, tightened(self._rules, osem)
        self._new_rules = True
        self._settle()
        return None

    def _on_traj(self, traj: Traj) -> RefusalReason | None:
        running = self._target.state is ControlState.RUNNING
        if self.link.osem is None:
            return not_now("there was no OSEM")
        if running and self.link.osem.test_mode != OsemTestMode.ONLINE:
            return not_now("trajectories aren't taken while it runs, test_mode isn't ONLINE")
        if not running and self._target.state not in _BEFORE_START:
            return not_now(f"trajectories aren't taken in {self.state.name}")
        if not running:
            self._planned.forget()
            if traj.info == TrajectoryInfo.DELETE:
                return None
            self._planned.is_refused = True  # until it is taken
        if traj.info != TrajectoryInfo.RELATIVE_TO_ORIGIN:
            return unsupported(f"info {traj.info}, only relative to the origin")
        if traj.line_info not in (None, END_OF_TRANSMISSION):
            return unsupported(f"line info {traj.line_info}, only whole trajectories")
        enu_points = points_of(traj, Datum(Place(0.0, 0.0)))
        if isinstance(enu_points, RejectedBytes):
            return invalid(enu_points.text)
        points = self._in_map(enu_points)
        name = self._planned.name_of(traj)
        if running and self.started_ns is not None:
            return self._drive(points, name, self.started_ns)
        refused = self._check(points, name)
        if refused is None:
            self._planned.take(points, name)
        return refused

    def _in_map(self, points: Points) -> Points:
        columns = points.columns.copy()
        c, s = math.cos(self._frame.yaw_rad), math.sin(self._frame.yaw_rad)
        _, x, y, yaw = points.columns[:4]
        columns[1] = self._frame.x_m + c * x - s * y
        columns[2] = self._frame.y_m + s * x + c * y
        columns[3] = wrap_angles(yaw + self._frame.yaw_rad)
        return Points(columns)

    def _reference(self, points: Points, name: str, execute_at_ns: int) -> Reference:
        version = self._rules.event_version
        reference = Reference(
            name, self.object_id, version, "traj", self._now_ns, execute_at_ns, 0, points
        )
        # A TRAJ carries no expiry: it is over at its end.
        return replace(reference, expires_at_ns=reference.end_ns)

    def _check(self, points: Points, name: str) -> RefusalReason | None:
        """Judge a trajectory as if it were started now."""
        reference = self._reference(points, name, self._now_ns)
        refusal = self._target.check(reference, self._now_ns, ControlState.RUNNING)
        return None if refusal is None else invalid(refusal.message)

    def _drive(self, points: Points, name: str, began_ns: int) -> RefusalReason | None:
        """Drive a trajectory from its first point on that isn't over."""
        due = points.columns[0] >= ns_to_seconds(self._now_ns - began_ns)
        if np.count_nonzero(due) < 2:
            return invalid("less than two of its points lie ahead")
        columns = points.columns[:, due].copy()
        first_ns = began_ns + seconds_to_ns(float(columns[0, 0]))
        columns[0] -= columns[0, 0]
        reference = self._reference(Points(columns), name, first_ns)
        refusal = self._target.on_reference(reference, self._now_ns)
        return None if refusal is None else invalid(refusal.message)

    def _on_ostm(self, ostm: Ostm) -> RefusalReason | None:
        event = _EVENTS.get(ObjectCommand(ostm.command)) if ostm.command in _COMMANDS else None
        if event is None:
            return unsupported(f"command {ostm.command}")
        if event is ObjectEvent.ARM:
            if self.link.osem is None:
                return not_now("there was no OSEM")
            if self._planned.is_refused:
                return not_now("its newest trajectory was refused")
            if self._planned.trajectory is not None:
                refused = self._check(*self._planned.trajectory)
                if refused is not None:
                    return not_now(f"its trajectory can't be driven: {refused.text}")
        response = self._target.command(
            event, self._rules.event_version, self.link.silence_s(self._now_ns), abort_id=None
        )
        if not response.accepted:
            return not_now(response.error_msg)
        self._start_ns = self.started_ns = None
        if event is ObjectEvent.ALL_CLEAR:
            self._stop.cause = None
        return None

    def _on_strt(self, strt: Strt) -> RefusalReason | None:
        if self._target.state is not ControlState.ARMED:
            return not_now(f"it is {self.state.name}, not ARMED")
        now_ns = self._now_ns
        start_ns = now_ns
        if strt.time_of_week_ns is not None:
            start_ns = nearest_utc_ns(strt.time_of_week_ns, now_ns)
            if strt.week not in (None, to_gps(start_ns)[0]):
                return invalid(f"week is {strt.week}, it is {to_gps(now_ns)[0]} now")
        late_s = ns_to_seconds(now_ns - start_ns)
        self._start_ns = now_ns if late_s > LATE_START_S else start_ns
        return None

    def _on_dreq(self, _: Dreq) -> None:
        version = ssp_core.__version__
        self.link.send(Dres(*SIMULATED_OBJECT, version, self.object_id, 0))

    def _on_heab(self, heab: Heab) -> None:
        self.link.last_heartbeat_ns, self.link.status = self._now_ns, heab.status
        session = session_of(heab.status, self.started_ns is not None)
        late = self.started_ns is not None and heab.status == CentreStatus.READY
        if late and ns_to_seconds(self._now_ns - (self.started_ns or 0)) > HEAB_LAG_S:
            session = SessionPhase.ABORTING
        if session in _NO_START:
            self._start_ns = None
        if session is SessionPhase.ABORTING:
            # An abort is latched, also where it was braking for silence.
            self._stop.lost_centre = False
        before = self._target.state
        self._target.on_session_state(session)
        if self._target.state is not before:
            self.link.note(f"{self._target.state.name} by a heartbeat with status {heab.status}")

    # -- motion --------------------------------------------------------------------------------

    def advance(self, now_ns: int) -> None:
        """Move the object up to a time."""
        while self._now_ns + _STEP_NS <= now_ns:
            self._step()
        self._take(self.link.take_overdue(now_ns))

    def take_sent(self, now_ns: int) -> list[OutgoingFrame]:
        """Return the messages that are due by now, in order."""
        self.advance(now_ns)
        osem = self.link.report_due(self._now_ns)
        if osem is not None:
            self.link.send(self._monr(osem), udp=True)
        return self.link.take()

    def _step(self) -> None:
        now_ns = self._now_ns
        self._begin_if_due()
        before = self._target.state
        outcome = self._target.step(self._own(), now_ns, self.link.silence_s(self._now_ns))
        if outcome.stopped is not None:
            self._begin_own_stop(outcome.stopped)
        if before is ControlState.POSTRUN and self._target.state is ControlState.DISARMED:
            self.started_ns = None
        self.body = step_body(self._rules.spec.cls, self.body, outcome.command, STEP_S)
        self._now_ns = now_ns + _STEP_NS
        self._settle()

    def put_back(self, *, is_called: bool = False) -> bool:
        """Put it back to its start, switched on anew; return False while that isn't called for.

        It is once no centre has been connected and nothing has moved for ``PUT_BACK_S``, where it
        stands elsewhere or is latched by an abort.

        Args:
            is_called: a centre is about to connect: earlier too, where it stands and the centre
                before said that its test was over. One that was cut off finds it where it stopped.
        """
        stands_ns = self._now_ns - self._last_motion_ns
        is_over = self.link.status not in (None, CentreStatus.READY, CentreStatus.RUNNING)
        is_next = is_called and is_over and stands_ns > 0
        alone = self.link.host is None and (is_next or stands_ns > seconds_to_ns(PUT_BACK_S))
        start = self._rules.spec.start.pose
        latched = self._target.state is ControlState.ABORTING
        if not alone or not (latched or is_away(self.body, start)):
            return False
        self.body = BodyState.at_rest(start)
        self._tight, self._stop = self._rules, OwnStop()
        self.started_ns = None
        self._target = self._new_target(self._rules)
        self.link.note("back at its start")
        return True

    def _begin_if_due(self) -> None:
        start_ns = self._start_ns
        if start_ns is None or start_ns >= self._now_ns + _STEP_NS:
            return
        self._start_ns = None
        if self._target.state is not ControlState.ARMED:
            return
        self.started_ns = start_ns
        self._target.on_session_state(SessionPhase.RUNNING)
        self.link.note("started")
        if self._planned.trajectory is not None:
            refused = self._drive(*self._planned.trajectory, start_ns)
            if refused is not None:
                self.link.note(f"its trajectory is refused: {refused.text}")

    def _begin_own_stop(self, stop: LimitViolation) -> None:
        self._stop = OwnStop(stop.code, lost_centre=stop.code in _LOST)
        name = stop.code.name.lower()
        self.link.note(f"stops by itself: {name} {stop.measured:.3f}, limit {stop.limit:.3f}")

    def _settle(self) -> None:
        """Do what has to wait until the object stands."""
        if self.body.speed_mps > 0.0:
            self._last_motion_ns = self._now_ns
        if self.body.speed_mps > OWN_STANDSTILL_MPS:
            return
        is_still = self._now_ns - self._last_motion_ns >= _STOOD_NS
        resting = self._target.state in _RESTING
        silent = (
            self.link.last_heartbeat_ns is not None
            and self.link.silence_s(self._now_ns) > self._tight.limits.heartbeat_s
        )
        if self._stop.lost_centre and is_still:
            self._target = self._new_target(self._tight)
            self._stop, self.started_ns = OwnStop(), None
            self.link.note("stands, waits for a control centre")
        if self._new_rules and resting:
            self._new_rules = False
            latched = self._target.state is ControlState.ABORTING
            self._target = self._new_target(self._tight)
            if latched:
                self._target.local_stop()
        if resting and silent and is_still and self.link.host is not None:
            self.link.closes = True

    def _new_target(self, rules: ObjectRules) -> Target:
        target = Target(self.object_id, rules)
        target.power_on()
        target.step(self._own(), self._now_ns, math.inf)
        return target

    # -- reports -------------------------------------------------------------------------------

    def _own(self) -> ObjectState:
        b = self.body
        reading = BodyReading(
            self._now_ns,
            b.x_m,
            b.y_m,
            b.yaw_rad,
            b.speed_mps,
            b.acceleration_mps2,
            b.yaw_rate_radps,
            POSITION_STD_M,
        )
        self._states += 1
        return state_of(reading, self._rules.spec, self._states)

    def _monr(self, osem: Osem) -> Monr:
        b = self.body
        x, y = self._frame.to_local(b.x_m, b.y_m)
        bound_m = osem.max_position_error_m
        errors = ObjectError(0)
        if self._target.state is ControlState.ABORTING and self._stop.cause is not None:
            errors |= ObjectError.ABORT_REQUEST
        if self._stop.cause is SafetyCode.OUTSIDE_GEOFENCE:
            errors |= ObjectError.OUTSIDE_GEOFENCE
        if bound_m is not None and bound_m < POSITION_STD_M:
            errors |= ObjectError.BAD_POSITIONING_ACCURACY
        ready = (
            self.state is ControlState.DISARMED
            and b.speed_mps <= OWN_STANDSTILL_MPS
            and self.link.silence_s(self._now_ns) <= self._tight.limits.heartbeat_s
            and not self._planned.is_refused
            and not errors
        )
        return Monr(
            time_of_week_ns=to_gps(self._now_ns)[1],
            x_m=x,
            y_m=y,
            z_m=0.0,
            yaw_rad=wrap_angle(b.yaw_rad - self._frame.yaw_rad),
            pitch_rad=None,
            roll_rad=None,
            speed_mps=b.speed_mps,
            lateral_speed_mps=0.0,
            acceleration_mps2=b.acceleration_mps2,
            lateral_acceleration_mps2=b.speed_mps * b.yaw_rate_radps,
            drive_direction=DriveDirection.FORWARD,
            state=self.state,
            ready_to_arm=ReadyToArm.READY if ready else ReadyToArm.NOT_READY,
            error_status=errors,
            error_code=0 if self._stop.cause is None else self._stop.cause,
        )


_COMMANDS = frozenset(ObjectCommand)
_HANDLERS: dict[type, Callable[[IsoObject, Any], RefusalReason | None]] = {
    Osem: IsoObject._on_osem,
    Traj: IsoObject._on_traj,
    Ostm: IsoObject._on_ostm,
    Strt: IsoObject._on_strt,
    Dreq: IsoObject._on_dreq,
}
