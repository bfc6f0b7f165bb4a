"""Stage by stage, a probe asks an object for everything ISO 22133 requires, and records it.

Whatever ends a probe that has armed the object, HEAB abort for a second is the last that is sent.
"""

from __future__ import annotations

import math
import select
import socket
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Protocol

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.errors import HostError
from ssp_core.geodesy import Datum
from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.reference import Points, Reference
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.conversation import Settings
from ssp_ot_controller.bodies.iso22133.framing import VERSION, Header
from ssp_ot_controller.bodies.iso22133.link import CONNECT_TIMEOUT_S, ReceivedMessage, Tap
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Dreq,
    Dres,
    Heab,
    Message,
    Monr,
    ObjectCommand,
    Osem,
    OsemTestMode,
    Ostm,
    Strt,
    Traj,
    TrajectoryInfo,
    TrajPoint,
)
from ssp_ot_controller.bodies.iso22133.probe.clauses import rows_of
from ssp_ot_controller.bodies.iso22133.probe.fenced_way import FencedWay
from ssp_ot_controller.bodies.iso22133.probe.latest import Latest
from ssp_ot_controller.bodies.iso22133.probe.motion import STANDS_M
from ssp_ot_controller.bodies.iso22133.probe.steps import LIMITS, ProbeFrame, Step
from ssp_ot_controller.bodies.iso22133.probe_report import (
    CAR,
    ObjectKind,
    Outcome,
    ProbeReport,
    Stage,
)
from ssp_ot_controller.bodies.iso22133.trajectories import trajectory_of
from ssp_ot_controller.bodies.iso22133.units import to_gps

C = ControlState
DEVICE_ID = 1
RATE_HZ = 100
_BEAT_NS = NS_PER_S // RATE_HZ
# Public objects take what follows a TRAJ too closely for a part of it.
_PAUSE_S = 0.3
_LISTEN_S = 3.0
_START_AHEAD_S = 1.0
ABORT_S = 1.0
# It may be so far from where it should be.
_OFF_WAY_M = 2.0
_SILENT_S = 0.5
_MOVED_M = 0.5


class ProbeEnd(Exception):
    """The reason why a probe goes no further."""


class Wire(Protocol):
    """The part of a ``Link`` that a probe needs."""

    problem: str
    receiver_id: int

    @property
    def connected(self) -> bool: ...
    @property
    def connecting(self) -> bool: ...
    @property
    def sockets(self) -> list[socket.socket]: ...
    def connect(self) -> None: ...
    def poll(self) -> list[ReceivedMessage]: ...
    def send(self, message: Message, *, acknowledge: bool = False) -> Header: ...
    def close(self) -> None: ...


class Clock:
    """The time, and waiting."""

    def now_ns(self) -> int:
        return time.time_ns()

    def wait(self, wire: Wire, seconds: float) -> None:
        """Wait until something may have come, and no longer than that."""
        select.select(wire.sockets, [], [], max(seconds, 0.0))


class Beats:
    """The heartbeats that a probe sends.

    Attributes:
        status: that they carry; None: none are sent.
    """

    def __init__(self) -> None:
        self.status: CentreStatus | None = None
        self._next_ns = 0

    def begin(self, status: CentreStatus, now_ns: int) -> None:
        """Send heartbeats from now on."""
        self.status, self._next_ns = status, now_ns

    def due(self, now_ns: int) -> CentreStatus | None:
        """Return the status of a heartbeat that is sent now; None: none is."""
        if self.status is None or now_ns < self._next_ns:
            return None
        self._next_ns = max(self._next_ns + _BEAT_NS, now_ns)
        return self.status

    def next_ns(self, now_ns: int) -> int:
        """Return when to look for the next one."""
        return now_ns + _BEAT_NS if self.status is None else self._next_ns


class Probe:
    """One probe of one object.

    Args:
        open_wire: makes a link that isn't connected, with this tap.
        way: needed for the stage MOVE.
        heartbeat_s: after which the object is to notice that heartbeats are lost.
        tell: called with progress.
        kind: of the object, which says how its yaw may lie to its motion.
    """

    def __init__(
        self,
        open_wire: Callable[[Tap], Wire],
        datum: Datum,
        way: FencedWay | None,
        heartbeat_s: float,
        tell: Callable[[str], None],
        clock: Clock | None = None,
        kind: ObjectKind = CAR,
    ) -> None:
        self.kind = kind
        self.steps: dict[str, Step] = {}
        self.ended = "the probe ended before"
        self._open_wire, self._way = open_wire, way
        self._tell, self._clock = tell, clock or Clock()
        limits = LIMITS.model_copy(update={"heartbeat_s": heartbeat_s})
        stands = Traj(0, TrajectoryInfo.RELATIVE_TO_ORIGIN, "", ())
        self._settings = Settings(DEVICE_ID, datum, limits, None, stands)
        self._wire: Wire | None = None
        self._step = Step(0)
        self._bytes = b""
        self._beats = Beats()
        self._latest = Latest(datum)
        self._armed = False
        self._guard: Callable[[], str] = lambda: ""

    @property
    def firmware(self) -> str | None:
        """Return the firmware that the object states; None where it answers no DREQ."""
        return self._latest.firmware

    def run(self, stages: Iterable[Stage]) -> None:
        """Ask stage by stage; ``steps`` has what came, ``ended`` why it went no further."""
        by_stage = {
            Stage.LISTEN: self._listen,
            Stage.CONNECT: self._connect,
            Stage.ARM: self._arm,
            Stage.MOVE: self._move,
        }
        try:
            for stage in stages:
                by_stage[stage]()
        except ProbeEnd as end:
            self.ended = self._step.problem = str(end)
            self._tell(str(end))
        finally:
            self._leave()

    def _leave(self) -> None:
        if self._wire is None:
            return
        if self._armed:
            self._begin("leave", "leaves with HEAB abort")
            self._guard = lambda: ""
            self._beats.status = CentreStatus.ABORT
            with suppress(ProbeEnd):
                self._run(ABORT_S)
        self._wire.close()

    # -- steps ---------------------------------------------------------------------------------

    def _begin(self, name: str, text: str) -> None:
        self._end()
        self._tell(text)
        self._step = self.steps[name] = Step(self._clock.now_ns(), bounds=self.kind.bounds)

    def _end(self) -> None:
        self._step.marks["end"] = self._clock.now_ns()

    def _mark(self, name: str = "stimulus") -> None:
        self._step.marks[name] = self._clock.now_ns()

    def _send(self, message: Message, *, acknowledge: bool = False) -> None:
        if self._wire is not None:
            header = self._wire.send(message, acknowledge=acknowledge)
            sent = ProbeFrame(self._clock.now_ns(), header, message, self._bytes)
            self._step.sent.append(sent)

    def _tap(self, sent: bool, _: int, data: bytes) -> None:
        if sent:
            self._bytes = data

    def _run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Keep heartbeats going; return True as soon as a condition holds, False at the end."""
        end_ns = self._clock.now_ns() + seconds_to_ns(seconds)
        while self._wire is not None:
            now_ns = self._clock.now_ns()
            if (status := self._beats.due(now_ns)) is not None:
                self._send(Heab(to_gps(now_ns)[1], status))
            for received in self._wire.poll():
                self._take(received)
            problem = self._guard()
            if problem:
                raise ProbeEnd(problem)
            if until():
                return True
            if now_ns >= end_ns:
                break
            until_ns = min(end_ns, self._beats.next_ns(now_ns))
            self._clock.wait(self._wire, ns_to_seconds(until_ns - self._clock.now_ns()))
        return False

    def _take(self, received: ReceivedMessage) -> None:
        self._step.came.append(received)
        if isinstance(received.outcome, DecodedMessage):
            message = received.outcome.message
            if isinstance(message, Monr):
                self._latest.take(message, received.stamp_ns)
            elif isinstance(message, Dres):
                self._latest.firmware = message.firmware

    def _is(self, *states: ControlState) -> Callable[[], bool]:
        since_ns = self._clock.now_ns()
        return lambda: (
            self._latest.monr is not None
            and self._latest.arrived_ns > since_ns
            and self._latest.state in states
        )

    def _open(self, name: str, text: str, status: CentreStatus = CentreStatus.INIT) -> None:
        """Connect anew, and send at once what an object needs to report and to stand."""
        self._begin(name, text)
        try:
            wire = self._open_wire(self._tap)
        except HostError as error:
            raise ProbeEnd(f"no connection: {error}") from None
        if self._wire is not None:
            self._wire.close()
        self._wire = wire
        self._latest.forget()
        self._beats.status, self._guard = None, lambda: ""
        wire.connect()
        # The link gives up by itself.
        self._run(2.0 * CONNECT_TIMEOUT_S, lambda: not wire.connecting)
        if not wire.connected:
            raise ProbeEnd(f"no connection: {wire.problem}")
        self._mark("connected")
        wire.receiver_id = DEVICE_ID
        self._send(self._osem(), acknowledge=True)
        self._beats.begin(status, self._clock.now_ns())
        if not self._run(2.0, lambda: self._latest.monr is not None):
            raise ProbeEnd("no MONR came after OSEM and HEAB")
        at = self._latest.enu()
        if at is None:
            raise ProbeEnd("its MONR states no place: no trajectory can be sent")
        point = TrajPoint(0.0, at.x_m, at.y_m, 0.0, at.yaw_rad, 0.0, 0.0, 0.0, 0.0, 0.0)
        stand = (point, replace(point, t_s=1.0))
        self._send(Traj(1, TrajectoryInfo.RELATIVE_TO_ORIGIN, "standing", stand), acknowledge=True)
        self._run(_PAUSE_S)
        self._guard = self._stays_here()

    def _osem(self) -> Osem:
        """Make an OSEM as in a session, except for trajectories that replace each other."""
        message = self._settings.osem(self._clock.now_ns())
        return replace(message, test_mode=OsemTestMode.PREPLANNED)

    def _stays_here(self) -> Callable[[], str]:
        """Make the check that the object, which was not started, stays here."""
        pose = self._latest.pose()

        def moved() -> str:
            now = self._latest.pose()
            if pose is None or now is None:
                return ""
            way_m = math.hypot(now.x_m - pose.x_m, now.y_m - pose.y_m)
            return f"it moved {way_m:.1f} m, without a start command" if way_m > _MOVED_M else ""

        return moved

    # -- stages --------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._open("listen", "connects and listens")
        self._run(_LISTEN_S)

    def _connect(self) -> None:
        self._begin("connect", "asks who it is")
        # Alone: public objects take what follows an unknown message for a part of it.
        self._send(Dreq())
        self._run(_PAUSE_S + 0.2, lambda: self.firmware is not None)
        self._open("reconnect", "connects again")
        self._run(2.0, self._is(C.DISARMED, C.ABORTING))

    def _order(self, command: ObjectCommand) -> None:
        self._mark()
        self._send(Ostm(command), acknowledge=True)

    def _arm_it(self) -> None:
        self._armed = True
        self._beats.status = CentreStatus.READY
        self._run(0.1)
        self._order(ObjectCommand.ARM)
        if not self._run(2.0, self._is(C.ARMED)):
            raise ProbeEnd("it didn't arm")

    def _arm(self) -> None:
        if self._is_aborting():
            self._tell("an earlier abort is latched: all clear")
            self._order(ObjectCommand.ALL_CLEAR)
            self._run(1.0, self._is(C.DISARMED))
        self._begin("arm", "arms")
        self._arm_it()
        self._run(0.5)
        self._begin("disarm", "disarms")
        self._order(ObjectCommand.DISARM)
        self._run(1.0, self._is(C.DISARMED))
        self._begin("arm_abort", "arms and aborts")
        self._arm_it()
        self._beats.status = CentreStatus.ABORT
        self._mark()
        aborted = self._run(1.0, self._is(C.ABORTING))
        self._begin("latch", "takes the abort back without an all clear")
        self._beats.status = CentreStatus.READY
        self._run(0.5)
        self._begin("all_clear", "clears")
        self._order(ObjectCommand.ALL_CLEAR if aborted else ObjectCommand.DISARM)
        self._run(1.0, self._is(C.DISARMED))
        self._begin("arm_loss", "arms and ceases heartbeats")
        self._arm_it()
        self._cease()
        self._open("arm_again", "connects again")
        self._run(0.5)

    def _is_aborting(self) -> bool:
        return self._latest.state is C.ABORTING

    def _cease(self) -> None:
        """Send no heartbeats until the object must have noticed."""
        wire, self._beats.status = self._wire, None
        self._mark()
        silent_s = self._settings.limits.heartbeat_s + 1.0
        if self._run(silent_s, lambda: wire is not None and not wire.connected):
            self._mark("lost")

    def _move(self) -> None:
        failed = [
            row.clause
            for row in rows_of(self.steps, [Stage.ARM], "")
            if row.verdict is Outcome.FAIL and row.clause != "arm.latch"
        ]
        if failed:
            raise ProbeEnd(f"it isn't moved: {', '.join(failed)} failed while it stood")
        self._drive("normal_stop", CentreStatus.NORMAL_STOP)
        self._begin("rest", "waits for DISARMED")
        self._beats.status = CentreStatus.READY
        self._mark()
        self._rests("rest_again")
        self._drive("abort", CentreStatus.ABORT)
        self._begin("abort_clear", "clears")
        self._beats.status = CentreStatus.READY
        self._order(ObjectCommand.ALL_CLEAR)
        self._rests("abort_again")
        self._drive("loss", None)
        self._open("loss_again", "connects again", CentreStatus.ABORT)
        self._guard = lambda: ""
        self._run(2.0)
        self._wait_for_standstill("loss_again", 60.0)

    def _rests(self, name: str) -> None:
        """Wait until it is DISARMED; connect anew where it doesn't get there by itself."""
        if not self._run(3.0, self._is(C.DISARMED)):
            self._open(name, "connects again")
            if not self._run(1.0, self._is(C.DISARMED)):
                raise ProbeEnd("it doesn't come back to DISARMED")

    def _drive(self, name: str, status: CentreStatus | None) -> None:
        """Bring it to speed, and stop it by this status, or by none."""
        self._guard = lambda: ""
        self._begin(name, f"moves it, and then: {'no HEAB' if status is None else status.name}")
        pose, way = self._latest.pose(), self._way
        points = "it reports no place" if pose is None or way is None else way.plan(pose)
        if isinstance(points, str) or way is None:
            raise ProbeEnd(f"it isn't moved: {points}")
        whole = Reference(name, "", "", "", 0, 0, 0, points)
        self._send(trajectory_of(whole, 0, self._settings.datum, 2), acknowledge=True)
        self._run(_PAUSE_S)
        self._arm_it()
        del self._step.marks["stimulus"]
        # Public objects report another place until they are armed.
        self._run(_PAUSE_S)
        self._guard = self._keeps_to(way, points)
        now_ns = self._clock.now_ns()
        start_ns = now_ns + seconds_to_ns(_START_AHEAD_S)
        self._step.marks["start"] = start_ns
        week, time_of_week_ns = to_gps(start_ns)
        self._send(Strt(time_of_week_ns, week), acknowledge=True)
        self._beats.status = CentreStatus.RUNNING
        cruise_mps = float(points.columns[4].max())
        t_s = points.columns[0]
        accelerating_s = float(t_s[np.flatnonzero(points.columns[4] >= 0.99 * cruise_mps)[0]])
        limit_s = _START_AHEAD_S + accelerating_s + 2.0
        if not self._run(limit_s, lambda: self._latest.measured_speed_mps() >= 0.9 * cruise_mps):
            raise ProbeEnd(f"it didn't reach {0.9 * cruise_mps:.1f} m/s within {limit_s:.1f} s")
        self._run(0.3)
        if status is None:
            self._guard = lambda: ""
            self._cease()
            if "lost" in self._step.marks:
                self._end()
                return
        else:
            self._beats.status = status
            self._mark()
        self._wait_for_standstill(name, float(t_s[-1]) + 5.0)

    def _keeps_to(self, way: FencedWay, points: Points) -> Callable[[], str]:
        line = Polyline(points.columns[1:3].T[:: max(1, len(points) // 50)])
        fastest_mps = float(points.columns[4].max()) + 1.0

        def judge() -> str:
            pose = self._latest.pose()
            silent_s = ns_to_seconds(self._clock.now_ns() - self._latest.arrived_ns)
            if silent_s > _SILENT_S or pose is None:
                return f"no place was reported for {silent_s:.2f} s while it moved"
            if not way.holds(pose):
                return f"it is outside of the fence at ({pose.x_m:.1f}, {pose.y_m:.1f})"
            stated_mps, moved_mps = (
                self._latest.reported_speed_mps(),
                self._latest.measured_speed_mps(),
            )
            if max(stated_mps, moved_mps) > fastest_mps:
                return (
                    f"it drives {moved_mps:.1f} m/s and states {stated_mps:.1f} m/s, asked for "
                    f"{fastest_mps - 1.0:.1f} m/s"
                )
            off_m = abs(line.project(pose.x_m, pose.y_m)[1])
            return f"it is {off_m:.1f} m off its trajectory" if off_m > _OFF_WAY_M else ""

        return judge

    def _wait_for_standstill(self, name: str, limit_s: float) -> None:
        """Wait until it has not moved for a second, by the places that it reports."""
        here: list[tuple[int, Pose2]] = []

        def stands() -> bool:
            pose = self._latest.pose()
            if pose is None:
                return False
            moved = (
                not here
                or math.hypot(pose.x_m - here[0][1].x_m, pose.y_m - here[0][1].y_m) > 0.5 * STANDS_M
            )
            if moved:
                here[:] = [(self._latest.arrived_ns, pose)]
            return self._latest.arrived_ns - here[0][0] > 1.2 * NS_PER_S

        if not self._run(3.0, stands):
            self._tell("it still moves: be ready to stop it by other means")
            if not self._run(limit_s, stands):
                raise ProbeEnd(f"it doesn't stand {limit_s + 3.0:.0f} s after {name}")
        self._end()


def report_of(
    probe: Probe, host: str, port: int, started_ns: int, stages: tuple[Stage, ...]
) -> ProbeReport:
    """Report the findings of a probe that has ended."""
    return ProbeReport(
        host=host,
        port=port,
        firmware=probe.firmware,
        started=datetime.fromtimestamp(started_ns // NS_PER_S, UTC),
        wire_version=VERSION,
        object_class=probe.kind.object_class.word,
        omnidirectional=probe.kind.omnidirectional,
        stages=stages,
        rows=rows_of(probe.steps, stages, probe.ended),
    )
