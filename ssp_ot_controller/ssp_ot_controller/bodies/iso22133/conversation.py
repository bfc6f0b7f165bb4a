"""The messages of a control centre to one test object, and the faults that it finds in the answers.

It has no socket and reads no clock: it receives the time, what the object target decided and what
the object reports, and says what is sent. The object target stays the judge of the motion; here is
judged what it can't see, the object's own state and whether it obeys.

This file owns what was sent to the object: ``ControlQueue`` what waits, ``Trajectories`` what it
drives, ``Conversation`` the rest. A new connection, or a new arming, forgets the run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.geodesy import Datum
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import Limits
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.body import BodyCheck, TrajectoryDecision
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    CoordinateSystem,
    Dreq,
    Heab,
    Message,
    ObjectCommand,
    ObjectError,
    Osem,
    OsemTestMode,
    Ostm,
    Strt,
    Traj,
)
from ssp_ot_controller.bodies.iso22133.states import STATUS_OF, Fit, fit, state_of, state_text
from ssp_ot_controller.bodies.iso22133.stop_watch import SLOW_MPS, StopWatch
from ssp_ot_controller.bodies.iso22133.trajectories import trajectory_of
from ssp_ot_controller.bodies.iso22133.units import leap_seconds, to_gps

HEAB_RATE_HZ = 100
MONR_RATE_HZ = 100
# Public objects take what came with a TRAJ or a DREQ in one read for a part of it.
PAUSE_NS = 250_000_000
# What an OSEM can say: the largest deviations, and the shortest timeout of heartbeats.
MOST_DEVIATION_M = 65.534
LEAST_TIMEOUT_S = 0.01
# How long an object's state may lag behind ours; arming may take longer.
LAG_S = 1.0
ARMING_S = 3.0
# A reference that is over must have led to a standstill after so long.
OVER_S = 0.5

C, P = ControlState, SessionPhase
# The phase whose states an object target in this state expects of the object. Elsewhere it is the
# session's own.
_PHASE_OF = {
    C.PRE_ARMING: P.ARMED,
    C.ARMED: P.ARMED,
    C.RUNNING: P.RUNNING,
    C.POSTRUN: P.STOPPING,
}
# What an object was asked for when its object target came into a state; elsewhere nothing.
_ASKED = {
    C.PRE_ARMING: "was asked to arm",
    C.ARMED: "was armed",
    C.RUNNING: "should have started",
    C.POSTRUN: "was commanded to stop",
}
_NOT_ASKED = "was to stand disarmed"
# Errors with which an object must not drive, and all with which it isn't armed.
_ENDS = {
    ObjectError.ABORT_REQUEST: "requests an abort",
    ObjectError.OUTSIDE_GEOFENCE: "says that it is outside its geofence",
}
_KEEPS_FROM_ARMING = _ENDS | {
    ObjectError.ENGINE_FAULT: "reports an engine fault",
    ObjectError.BATTERY_FAULT: "reports a battery fault",
}
# Before these nobody waits for an object's state.
_EARLY = (P.UNKNOWN, P.IDLE, P.LOADED)


@dataclass(frozen=True, slots=True)
class NewestReport:
    """The newest report of an object.

    Args:
        connected: its control connection stands.
        number: of the state in its newest MONR; None before the first, and for 'unavailable'.
        has_report: a MONR has come since it was connected.
        speed_mps: of its newest MONR.
        errors: error status of its newest MONR, bits of ObjectError.
        gate: why its probe report doesn't let it be armed, as sentences; empty when it does.
        lasting: no connection to come changes that.
        problem: why its control connection doesn't stand.
    """

    connected: bool = False
    number: int | None = None
    has_report: bool = False
    speed_mps: float = 0.0
    errors: int = 0
    gate: tuple[str, ...] = ()
    lasting: bool = False
    problem: str = ""

    @property
    def state(self) -> ControlState | None:
        """Return the reported state.

        None before the first MONR, and for a number without a name.
        """
        return state_of(self.number)

    @property
    def text(self) -> str:
        """Describe a reason for people."""
        return f"reports {state_text(self.number)}"

    def texts_of(self, errors: Mapping[ObjectError, str]) -> list[str]:
        """Return the texts of those of the errors that are reported."""
        return [text for error, text in errors.items() if error & self.errors]


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings sent to an object when it is connected, and the requirements on it.

    Args:
        device_id: given to the object.
        approach: what it drives from the start; None: it stands until its first reference. Its
            times count from 0.
        stands: where it stands without one, as a trajectory of two points.
        honours_start_time: its probe report shows that it waits for a STRT's time.
    """

    device_id: int
    datum: Datum
    limits: Limits
    approach: Reference | None
    stands: Traj
    honours_start_time: bool = False

    def osem(self, now_ns: int) -> Osem:
        """Return the settings as they are sent; the coordinate system isn't rotated.

        Larger deviations than an OSEM can say are sent as the largest one.
        """
        place, limits = self.datum.place, self.limits
        week, time_of_week_ns = to_gps(now_ns)
        today = datetime.fromtimestamp(now_ns / NS_PER_S, UTC)
        return Osem(
            device_id=self.device_id,
            sub_device_id=0,
            control_centre_id=0,
            latitude_deg=place.latitude_deg,
            longitude_deg=place.longitude_deg,
            altitude_m=place.altitude_m,
            rotation_rad=0.0,
            coordinate_system=CoordinateSystem.WGS84,
            date=int(today.strftime("%Y%m%d")),
            week=week,
            time_of_week_ns=time_of_week_ns,
            leap_seconds=leap_seconds(now_ns),
            max_way_deviation_m=min(limits.error_longitudinal_m, MOST_DEVIATION_M),
            max_lateral_deviation_m=min(limits.error_lateral_m, MOST_DEVIATION_M),
            max_yaw_deviation_rad=limits.error_yaw_rad,
            max_position_error_m=limits.position_std_m,
            heab_timeout_s=limits.heartbeat_s,
            test_mode=OsemTestMode.ONLINE,
            monr_rate_hz=MONR_RATE_HZ,
            # Not used; public objects divide by it.
            monr2_rate_hz=1,
            heab_rate_hz=HEAB_RATE_HZ,
            max_message_bytes=None,
        )


@dataclass(frozen=True, slots=True)
class Timing:
    """The delays with which an object obeys, s; None where it wasn't commanded or didn't obey yet.

    Args:
        start_error_s: from a STRT's time until RUNNING is reported, negative when it was early.
        stop_s: from the first HEAB with the normal stop or the abort that a moving object obeyed
            first, until it has lost 0.3 m/s.
    """

    start_error_s: float | None = None
    stop_s: float | None = None


class ControlQueue:
    """The control messages that wait, in their order; after a long one the object gets a pause."""

    def __init__(self) -> None:
        self._waiting: deque[Message] = deque()
        self._quiet_until_ns = 0

    def begin(self, messages: Iterable[Message], now_ns: int) -> None:
        """Forget what waits, and let these messages wait instead: a connection stands."""
        self._waiting = deque(messages)
        self._quiet_until_ns = now_ns

    def put(self, message: Message) -> None:
        """Let one more message wait."""
        self._waiting.append(message)

    def due(self, now_ns: int) -> list[Message]:
        """Take out the messages that are sent now."""
        messages: list[Message] = []
        while self._waiting and now_ns >= self._quiet_until_ns:
            message = self._waiting.popleft()
            messages.append(message)
            if isinstance(message, Traj | Dreq):
                self._quiet_until_ns = now_ns + PAUSE_NS
        return messages


class Trajectories:
    """The trajectories of one run that the object is given, on one axis of time.

    Attributes:
        start_ns: session time of their time 0; None before it is known.
        is_started: the object was given this time.
    """

    def __init__(self, settings: Settings) -> None:
        self.start_ns: int | None = None
        self.is_started = False
        self._settings = settings
        self._count = 0
        # All times that were sent, ms, and the references.
        self._times: set[int] = set()
        self._sent: set[tuple[str, int]] = set()

    def forget(self) -> None:
        """Begin another run: only the first trajectory was sent."""
        self.start_ns, self.is_started = None, False
        self._count = 1
        self._times = {_ms(point.t_s) for point in self.first().points}
        self._sent.clear()

    @property
    def any_sent(self) -> bool:
        """A reference was sent beside the first trajectory."""
        return bool(self._sent)

    def first(self) -> Traj:
        """Return the trajectory that an object is armed with."""
        approach = self._settings.approach
        if approach is None:
            return self._settings.stands
        return trajectory_of(approach, approach.execute_at_ns, self._settings.datum, 1)

    def find_start(self, references: Sequence[Reference], now_ns: int) -> LimitViolation | None:
        """Find the session time of time 0, as soon as the manager has said it.

        Returns:
            A violation where the object was armed with another trajectory than it is to drive.
        """
        approach = self._settings.approach
        if approach is None:
            self.start_ns = now_ns
            return None
        first = next((r for r in references if r.purpose == approach.purpose), None)
        if first is None:
            return None
        approach_columns, reference_columns = np.array(approach.columns), np.array(first.columns)
        if approach_columns.shape != reference_columns.shape or not np.allclose(
            approach_columns, reference_columns, rtol=0.0, atol=1e-6
        ):
            words = "is to drive another trajectory than it was armed with"
            return LimitViolation(SafetyCode.REFERENCE_REFUSED, 0.0, 0.0, words)
        self._sent.add((first.reference_id, first.execute_at_ns))
        self.start_ns = first.execute_at_ns
        return None

    def new(self, references: Sequence[Reference], start_ns: int, now_ns: int) -> Iterator[Traj]:
        """Yield the trajectories of the references that weren't sent yet."""
        for reference in references:
            key = reference.reference_id, reference.execute_at_ns
            if key not in self._sent and reference.execute_at_ns >= start_ns:
                self._sent.add(key)
                yield self._next(reference, start_ns, now_ns)

    def _next(self, reference: Reference, start_ns: int, now_ns: int) -> Traj:
        """Return the trajectory of a reference, in place of what was to be driven from its time on.

        Objects merge points by their times: those of before that lie beyond its end are sent again
        as a standstill there.
        """
        self._count += 1
        datum = self._settings.datum
        traj = trajectory_of(reference, start_ns, datum, self._count, from_ns=now_ns)
        if not traj.points:
            return traj
        last = traj.points[-1]
        rest = sorted(t for t in self._times if t > _ms(last.t_s))
        stand = replace(last, speed_mps=0.0, acceleration_mps2=0.0)
        points = (*traj.points, *(replace(stand, t_s=t / 1000.0) for t in rest))
        self._times |= {_ms(point.t_s) for point in traj.points}
        return replace(traj, points=points)


def _ms(t_s: float) -> int:
    return round(t_s * 1000.0)


class Conversation:
    """The conversation with one object, from connection to connection."""

    def __init__(self, settings: Settings) -> None:
        self.timing = Timing()
        self._settings = settings
        self._decided = TrajectoryDecision(P.UNKNOWN, C.OFF)
        self._reported = NewestReport()
        self._violation: LimitViolation | None = None
        self._queue = ControlQueue()
        self._trajectories = Trajectories(settings)
        self._now_ns = self._since_ns = 0
        self._clear_due = self._lost = False
        self._stop: StopWatch | None = None
        self._over = self._soft = False
        self._deaf = False

    # -- what happens --------------------------------------------------------------------------

    def on_connected(self, now_ns: int) -> None:
        """Queue the settings, the first trajectory and a DREQ: the control connection stands."""
        first = self._trajectories.first()
        self._queue.begin([self._settings.osem(now_ns), first, Dreq()], now_ns)
        self._forget_run()

    def on_lost(self) -> None:
        """Note that the control connection broke, for however short a time."""
        self._lost = True

    def step(self, decided: TrajectoryDecision, reported: NewestReport, now_ns: int) -> None:
        """Take the object target's decision and the object's report; ``due`` sends what follows."""
        before, self._decided, self._reported = self._decided, decided, reported
        self._now_ns = now_ns
        if decided.state is not before.state:
            self._since_ns = now_ns
            self._on_change(before.state, decided.state)
        if self._clear_due and self.status is not CentreStatus.ABORT:
            self._clear_due = False
            self._queue.put(Ostm(ObjectCommand.ALL_CLEAR))
        if decided.state is C.RUNNING:
            self._run(now_ns)
        self._watch_start(now_ns)
        self._watch_stop(now_ns)
        self._violation = self._violation or self._judge(now_ns)
        self._lost = False

    def due(self, now_ns: int) -> list[Message]:
        """Return the control messages that are sent now, in their order."""
        return self._queue.due(now_ns)

    def heab(self, now_ns: int) -> Heab | None:
        """Return the heartbeat; None for an object that doesn't obey it: silence must stop it."""
        return None if self._deaf else Heab(to_gps(now_ns)[1], self.status)

    # -- what is known -------------------------------------------------------------------------

    @property
    def status(self) -> CentreStatus:
        """Return the status that the heartbeat carries."""
        session, state = self._decided.session, self._decided.state
        if state is C.ABORTING:
            return CentreStatus.ABORT
        if self._soft or state is C.POSTRUN:
            return CentreStatus.NORMAL_STOP
        if session is P.UNKNOWN and state not in _PHASE_OF:
            return CentreStatus.INIT
        return STATUS_OF[session]

    @property
    def check(self) -> BodyCheck:
        """Return the judgement of the object for the object target."""
        reported = self._reported
        lacks: list[str] = []
        if not reported.connected:
            why = f": {reported.problem}" if reported.problem else ""
            lacks.append(f"its test object isn't connected{why}")
        elif not reported.has_report:
            lacks.append("its test object sends no MONR")
        elif self._decided.state is C.DISARMED and reported.state is not C.DISARMED:
            lacks.append(f"its test object {reported.text}, not DISARMED (3)")
        lacks += [f"its test object {text}" for text in reported.texts_of(_KEEPS_FROM_ARMING)]
        armed = reported.connected and reported.state is C.ARMED
        missed = self._missed_start
        cannot_arm = (*reported.gate, *lacks)
        return BodyCheck(armed, cannot_arm, reported.lasting, self._violation, missed)

    # -- the run -------------------------------------------------------------------------------

    def _forget_run(self) -> None:
        self._trajectories.forget()
        self.timing = Timing()
        self._over = self._soft = False

    def _run(self, now_ns: int) -> None:
        """Queue STRT at its time, and the trajectories of the references that were taken."""
        trajectories, references = self._trajectories, self._decided.references
        if trajectories.start_ns is None:
            refused = trajectories.find_start(references, now_ns)
            if refused is not None:
                self._violation = refused
        start_ns = trajectories.start_ns
        if start_ns is None:
            return
        is_due = self._settings.honours_start_time or now_ns >= start_ns
        if not trajectories.is_started and is_due:
            trajectories.is_started = True
            week, time_of_week_ns = to_gps(start_ns)
            self._queue.put(Strt(time_of_week_ns, week))
        for traj in trajectories.new(references, start_ns, now_ns):
            self._queue.put(traj)
        ends = [reference.end_ns for reference in references]
        self._over = bool(ends) and now_ns > max(ends) + seconds_to_ns(OVER_S)
        self._soft = self._soft or (self._over and abs(self._reported.speed_mps) > SLOW_MPS)

    # -- judgement -----------------------------------------------------------------------------

    def _on_change(self, before: ControlState, now: ControlState) -> None:
        if before is C.ABORTING and now is C.DISARMED:
            # A person has cleared it; the object is told as soon as our heartbeat allows it.
            self._clear_due = True
            self._deaf = False
            self._violation = None
        elif now is C.PRE_ARMING:
            if self._trajectories.any_sent:
                self._queue.put(self._trajectories.first())
            self._forget_run()
            self._queue.put(Ostm(ObjectCommand.ARM))
        elif before in (C.PRE_ARMING, C.ARMED) and now is C.DISARMED:
            self._queue.put(Ostm(ObjectCommand.DISARM))

    def _watch_start(self, now_ns: int) -> None:
        trajectories = self._trajectories
        runs = self._reported.state is C.RUNNING and trajectories.is_started
        start_ns = trajectories.start_ns
        if runs and start_ns and self.timing.start_error_s is None:
            error_s = ns_to_seconds(now_ns - start_ns)
            self.timing = replace(self.timing, start_error_s=error_s)

    def _watch_stop(self, now_ns: int) -> None:
        status, speed_mps = self.status, abs(self._reported.speed_mps)
        if status not in (CentreStatus.ABORT, CentreStatus.NORMAL_STOP):
            self._stop = None
            return
        if self._stop is None or self._stop.status is not status:
            bound_s = self._settings.limits.stop_reaction_s
            self._stop = StopWatch(status, speed_mps, now_ns, bound_s)
        disobeys = self._stop.judge(speed_mps, now_ns)
        if self._deaf:
            return
        if self.timing.stop_s is None:
            self.timing = replace(self.timing, stop_s=self._stop.slowed_s)
        if disobeys is not None:
            self._violation = disobeys
            # One that doesn't obey the normal stop is told to abort, by the object target's state;
            # one that doesn't obey that either hears nothing any more.
            self._deaf = status is CentreStatus.ABORT
            self._stop = None

    @property
    def _phase(self) -> SessionPhase:
        """The phase whose states are expected of the object.

        An object target that is DISARMED has not been commanded to arm, or has refused to,
        whatever the session says.
        """
        decided = self._decided
        if decided.state is C.DISARMED and decided.session in (P.ARMED, P.RUNNING):
            return P.CONNECTED
        return _PHASE_OF.get(decided.state, decided.session)

    @property
    def _missed_start(self) -> LimitViolation | None:
        """Its start time is over, and it doesn't report to run."""
        start_ns, state = self._trajectories.start_ns, self._reported.state
        if self._decided.state is not C.RUNNING or start_ns is None or self._over:
            return None
        late_s = ns_to_seconds(self._now_ns - start_ns)
        if state is C.RUNNING or late_s <= 0.0:
            return None
        return self._contradiction(f"{late_s:.2g} s after its start time", LAG_S)

    def _contradiction(self, when: str, patience_s: float) -> LimitViolation:
        number = self._reported.number
        words = f"{self._reported.text} {when}"
        measured = -1.0 if number is None else float(number)
        return LimitViolation(SafetyCode.OBJECT_CONTRADICTS, measured, patience_s, words)

    def _judge(self, now_ns: int) -> LimitViolation | None:
        """Find a violation in the object's own state and errors."""
        decided, reported = self._decided, self._reported
        if decided.state in (C.ABORTING, C.OFF, C.INIT):
            return None
        if self._lost or not reported.connected:
            if decided.state not in _PHASE_OF:
                return None
            why = f"lost its control connection: {reported.problem or 'it broke for a moment'}"
            return LimitViolation(SafetyCode.CONNECTION_LOST, 0.0, 0.0, why)
        ends = reported.texts_of(_ENDS)
        if ends and decided.state in _PHASE_OF:
            return self._contradiction(f"and {' and '.join(ends)}", 0.0)
        phase = self._phase
        agreement = fit(phase, reported.state)
        if agreement is Fit.AGREES or phase in _EARLY or not reported.has_report:
            return None
        if self._over and reported.state in (C.POSTRUN, C.DISARMED):
            return None
        since_ns = self._since_ns
        if decided.state is C.RUNNING:
            # Nothing is expected before the start's time.
            start_ns = self._trajectories.start_ns
            since_ns = max(since_ns, now_ns if start_ns is None else start_ns)
        lag_s = ns_to_seconds(now_ns - since_ns)
        patience_s = ARMING_S if phase is P.ARMED else LAG_S
        when = f"{patience_s:g} s after it {_ASKED.get(decided.state, _NOT_ASKED)}"
        if agreement is Fit.CONTRADICTS and decided.state in (C.ARMED, C.RUNNING):
            # It has agreed before: no message under way explains it.
            patience_s = 0.0
            when = "while it is armed" if decided.state is C.ARMED else "while it is to run"
        if lag_s <= patience_s or (agreement is Fit.COMES and phase is P.CONNECTED):
            return None
        return self._contradiction(when, patience_s)
