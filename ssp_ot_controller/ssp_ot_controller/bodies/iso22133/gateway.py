"""A test object that speaks ISO 22133, as a body: MONR in, trajectories and heartbeats out."""

from __future__ import annotations

import socket
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssp_core.cdr.iso_frames import RawFrame
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geodesy import Datum
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Reference
from ssp_core.names import ISO_LEVER, iso_body
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_ot_controller.bodies.body import BodyCheck, BodyReading, TrajectoryDecision
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.bodies.iso22133.conversation import (
    LEAST_TIMEOUT_S,
    Conversation,
    NewestReport,
    Settings,
)
from ssp_ot_controller.bodies.iso22133.framing import TCP_PORT, Reason, RejectedBytes
from ssp_ot_controller.bodies.iso22133.link import Link, Tap
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Dres,
    Monr,
    Traj,
    TrajectoryInfo,
    TrajPoint,
)
from ssp_ot_controller.bodies.iso22133.probe_report import (
    ObjectKind,
    ProbeReport,
    cannot_arm,
    honours_start_time,
    load_report,
    stops_on_abort_s,
)
from ssp_ot_controller.bodies.iso22133.reports import MonrReadings
from ssp_ot_controller.bodies.odometry import LeverArm

# A lost connection is tried again so often.
_RETRY_NS = NS_PER_S
# Intervals and ages are kept of the newest MONR, for a minute of them.
_KEPT = 6000


@dataclass(frozen=True, slots=True)
class IsoAddress:
    """``iso22133://HOST[:PORT][?report=FILE&waive=NAME&forward_m=X&left_m=Y]``.

    Args:
        port: TCP; process data go by UDP to the one below.
        report: of ``ssp iso probe``.
        waive: name of the person who lets the object be armed without one.
        lever: where the point that it reports lies.
    """

    host: str
    port: int = TCP_PORT
    report: Path | None = None
    waive: str = ""
    lever: LeverArm | None = None

    @staticmethod
    def parse(text: str) -> IsoAddress | None:
        """Parse an address; None for any other text."""
        parts = iso_body(text)
        if parts is None:
            return None
        host, port, options = parts
        metres = [float(options.get(name, "0")) for name in ISO_LEVER]
        lever = LeverArm(*metres) if any(metres) else None
        report = Path(options["report"]) if options.get("report") else None
        return IsoAddress(host, port or TCP_PORT, report, options.get("waive", "").strip(), lever)


class MonrStatistics:
    """Rate, regularity and age of MONR, and what they don't state."""

    def __init__(self) -> None:
        self.count = 0
        self.rejected: Counter[str] = Counter()
        self.unavailable: Counter[str] = Counter()
        self._intervals_s: deque[float] = deque(maxlen=_KEPT)
        self._ages_s: deque[float] = deque(maxlen=_KEPT)
        self._last_ns: int | None = None

    def take(self, monr: Monr, stamp_ns: int | None, arrived_ns: int) -> None:
        """Count one MONR; its stamp is None where it gave no reading."""
        self.count += 1
        if self._last_ns is not None:
            self._intervals_s.append(ns_to_seconds(arrived_ns - self._last_ns))
        self._last_ns = arrived_ns
        if stamp_ns is not None:
            self._ages_s.append(ns_to_seconds(arrived_ns - stamp_ns))
        self.unavailable.update(
            name for name in Monr.__dataclass_fields__ if getattr(monr, name) is None
        )

    def text(self) -> str:
        """Describe the rate, the intervals and the ages for people.

        Of the intervals it has the 1st and the 99th percentile.
        """
        if len(self._intervals_s) < 2:
            return f"{self.count} MONR"
        low, middle, high = np.percentile(self._intervals_s, (1, 50, 99)) * 1e3
        parts = [
            f"{self.count} MONR, {1e3 / middle:.1f} Hz",
            f"intervals {low:.1f} to {high:.1f} ms",
        ]
        if self._ages_s:
            age, oldest = np.percentile(self._ages_s, (50, 99)) * 1e3
            parts.append(f"age {age:.1f} ms, p99 {oldest:.1f} ms")
        if self.unavailable:
            parts.append("unavailable: " + ", ".join(sorted(self.unavailable)))
        parts += [f"{count} × {reason}" for reason, count in self.rejected.most_common(3)]
        return "; ".join(parts)


class ProbeGate:
    """The judgement whether a probe report lets an object be armed.

    Args:
        report: None: there is none.
        limits: of the site.
        waive: name of the person who lets it be armed without one; may be empty.
        kind: of the object in the run.

    Attributes:
        firmware: that the object says it runs; None before it has said so.
    """

    def __init__(
        self, report: ProbeReport | None, limits: Limits, waive: str, kind: ObjectKind
    ) -> None:
        self.firmware: str | None = None
        self._report = report
        self._limits = limits
        self._waive = waive
        self._kind = kind

    def judge(self, reported: NewestReport) -> NewestReport:
        """Return what is reported, with what the report lacks."""
        report = self._report
        probed = None if report is None else report.firmware
        gate = self._cannot_arm(self.firmware)
        # What it lacks even of the firmware that it is of.
        lasting = bool(self._cannot_arm(probed))
        return replace(reported, gate=gate, lasting=lasting)

    def _cannot_arm(self, firmware: str | None) -> tuple[str, ...]:
        return cannot_arm(self._report, self._limits, firmware, self._waive, self._kind)


class Announcements:
    """Sentences about one object, for an operator or a dispute.

    Args:
        tell: is given each sentence, which begins with the object's name.
    """

    def __init__(self, object_id: str, tell: Callable[[str], None]) -> None:
        self._object_id = object_id
        self._tell = tell
        self._announced_texts: set[str] = set()

    def always(self, text: str) -> None:
        """Say something, however often."""
        self._tell(f"{self._object_id}{text}")

    def once(self, text: str) -> None:
        """Say something that wasn't said since the last ``forget``."""
        if text not in self._announced_texts:
            self._announced_texts.add(text)
            self.always(text)

    def forget(self) -> None:
        """Begin anew: what was said once may be said again."""
        self._announced_texts.clear()


class IsoBody:
    """Leads one test object. It follows its trajectory by itself: commands of a body are not sent.

    Args:
        tell: called with what an operator or a dispute needs to know, once each.
        device_id: that the object is given.
        make_link: of host, port and tap.

    Attributes:
        approach: what it is armed with; None: it stands until its first reference.
        slows_s: see ``BodyCheck``.

    Raises:
        InputError: the run has no datum, or a limit that the object can't be sent, or the probe
            report can't be read.
        HostError: there is no way to that address.
    """

    def __init__(
        self,
        run: RunSpec,
        spec: ParticipantSpec,
        address: IsoAddress,
        device_id: int,
        tell: Callable[[str], None],
        make_link: Callable[[str, int, Tap], Link] = Link,
    ) -> None:
        if run.datum is None:
            raise InputError(
                f"{spec.id} speaks ISO 22133, and the run doesn't say where it takes place",
                field="datum",
                remedy="give the site file a datum and compile the run anew (docs/sites.md)",
            )
        if run.limits.heartbeat_s < LEAST_TIMEOUT_S:
            raise InputError(
                f"{spec.id} speaks ISO 22133, whose timeout of heartbeats is {LEAST_TIMEOUT_S:g} s "
                "or more",
                field="limits.heartbeat_s",
                value=run.limits.heartbeat_s,
                remedy="give the site file a longer one and compile the run anew",
            )
        datum = run.datum.datum
        self._say = Announcements(spec.id, tell)
        report = None if address.report is None else load_report(address.report)
        self._gate = ProbeGate(report, run.limits, address.waive, ObjectKind.of(spec, run.limits))
        # Measured from an abort to its slowing; who waives the report answers for its stops.
        probed = None if address.waive else report
        self.slows_s = 0.0 if probed is None else stops_on_abort_s(probed) or 0.0
        # It said of itself that it is a model.
        self.is_simulated = False
        self._frames: list[RawFrame] = []
        self._link = make_link(address.host, address.port, self._tap)
        settings = _settings(run, spec, datum, device_id, report)
        self.approach = settings.approach
        self._conversation = Conversation(settings)
        self._readings = MonrReadings(datum, address.lever, run.limits.position_std_m)
        self.statistics = MonrStatistics()
        self._reported = self._gate.judge(NewestReport())
        self._newest: BodyReading | None = None
        self._tried_ns = -_RETRY_NS
        # Why what came last gave no reading.
        self._refused = ""
        if address.waive:
            tell(
                f"{address.waive} lets {spec.id} be armed whatever its probe report lacks, and "
                "answers for its stops"
            )

    def _tap(self, sent: bool, stamp_ns: int, data: bytes) -> None:
        self._frames.append(RawFrame(sent, stamp_ns, data))

    # -- as a body -----------------------------------------------------------------------------

    def read(self) -> BodyReading | None:
        newest, self._newest = self._newest, None
        return newest

    def command(self, command: Command, now_ns: int) -> None:
        """Do nothing: the object drives by itself what ``follow`` received."""

    def close(self) -> None:
        """Leave the object to its own watchdog."""
        self._say.always(f": {self.statistics.text()}{self._timing()}")
        self._link.close()

    def problems(self) -> tuple[str, ...]:
        reported = self._reported
        if not reported.connected:
            return (f"its test object isn't connected: {reported.problem}",)
        if self._refused:
            return (f"what it says is refused: {self._refused}",)
        return () if reported.has_report else ("its test object sends no MONR",)

    # -- as a test object ----------------------------------------------------------------------

    @property
    def sockets(self) -> list[socket.socket]:
        """List the sockets that may be waited for."""
        return list(self._link.sockets)

    @property
    def check(self) -> BodyCheck:
        return self._conversation.check

    def frames(self) -> list[RawFrame]:
        """Return the frames since the last call, of both directions."""
        frames, self._frames = self._frames, []
        return frames

    def poll(self, now_ns: int) -> bool:
        """Take what has come, and keep the connection; True for a new reading."""
        if not self._link.connected:
            self._lose()
            # One that was tried in the future was tried before the clock was set back.
            if not 0 <= now_ns - self._tried_ns < _RETRY_NS:
                self._tried_ns = now_ns
                self._link.connect()
        for received in self._link.poll():
            if isinstance(received.outcome, RejectedBytes):
                self._reject(received.outcome)
            else:
                self._hear(received.outcome, received.stamp_ns)
        if not self._link.connected:
            self._lose()
        elif not self._reported.connected:
            gate, lasting = self._reported.gate, self._reported.lasting
            self._reported = NewestReport(connected=True, gate=gate, lasting=lasting)
            self._refused = ""
            self._readings.forget()
            self._conversation.on_connected(now_ns)
            self._say.always(" is connected")
        return self._newest is not None

    def _lose(self) -> None:
        was_connected = self._reported.connected
        problem = self._reported.problem
        if not (self._link.connecting and problem):
            # What an attempt under way may change is told when it has ended.
            problem = f"{self._link.name}: {self._link.problem}"
        self._reported = replace(
            self._reported,
            connected=False,
            number=None,
            has_report=False,
            errors=0,
            problem=problem,
        )
        if was_connected:
            self._conversation.on_lost()
            self._say.always(f" is not connected any more: {self._link.problem}")
            self._say.forget()

    def follow(self, decided: TrajectoryDecision, now_ns: int) -> None:
        """Take the object target's decision."""
        before = self._conversation.timing
        self._conversation.step(decided, self._reported, now_ns)
        if self._conversation.timing != before:
            self._say.always(self._timing())
        self.send(now_ns)

    def send(self, now_ns: int) -> None:
        """Send the control messages that are due."""
        if self._link.connected:
            for message in self._conversation.due(now_ns):
                self._link.send(message)

    def beat(self, now_ns: int) -> None:
        """Send one heartbeat, an abort without a connection too, and what else is due."""
        heab = self._conversation.heab(now_ns)
        aborts = heab is not None and heab.status == CentreStatus.ABORT
        if heab is not None and (self._link.connected or aborts):
            self._link.send(heab)
        self.send(now_ns)

    # -- inside --------------------------------------------------------------------------------

    def _hear(self, decoded: DecodedMessage, arrived_ns: int) -> None:
        message = decoded.message
        for text in decoded.odd:
            self._say.once(f" {text}")
        if isinstance(message, Monr):
            reading = self._readings.take(message, arrived_ns)
            if isinstance(reading, RejectedBytes):
                self._reject(reading)
                self.statistics.take(message, None, arrived_ns)
                if reading.reason is Reason.ORDER:
                    return  # a newer one has said what counts
            else:
                self._newest, self._refused = reading, ""
                self.statistics.take(message, reading.stamp_ns, arrived_ns)
            speed = self._reported.speed_mps if message.speed_mps is None else message.speed_mps
            self._reported = replace(
                self._reported,
                has_report=True,
                number=message.state,
                speed_mps=speed,
                errors=message.error_status,
            )
        elif isinstance(message, Dres):
            self._gate.firmware = message.firmware
            self.is_simulated |= message.is_simulated
            self._reported = self._gate.judge(self._reported)
            self._say.once(f" is {message.vendor} {message.product}, firmware {message.firmware}")

    def _reject(self, rejected: RejectedBytes) -> None:
        self.statistics.rejected[rejected.reason.value] += 1
        self._refused = f"{rejected.reason.value}: {rejected.text}"
        evidence = f" ({rejected.evidence.hex()})" if rejected.evidence else ""
        if self.statistics.rejected[rejected.reason.value] == 1:
            self._say.always(f": {rejected.reason.value}: {rejected.text}{evidence}")

    def _timing(self) -> str:
        timing = self._conversation.timing
        parts = []
        if timing.start_error_s is not None:
            parts.append(f" was RUNNING {timing.start_error_s:+.3f} s from its start time")
        if timing.stop_s is not None:
            parts.append(f" slowed {timing.stop_s:.3f} s after the command to stop")
        return ",".join(parts)


def _settings(
    run: RunSpec, spec: ParticipantSpec, datum: Datum, device_id: int, report: ProbeReport | None
) -> Settings:
    approach = None
    if spec.approach is not None:
        approach = Reference(
            reference_id=f"{spec.id} approach",
            object_id=spec.id,
            event_version=run.event_version,
            purpose="approach",
            dispatched_ns=0,
            execute_at_ns=0,
            expires_at_ns=0,
            points=approach_points(spec.approach),
        )
    pose = datum.to_enu(spec.start.pose)
    stand = TrajPoint(0.0, pose.x_m, pose.y_m, 0.0, pose.yaw_rad, 0.0, 0.0, 0.0, 0.0, 0.0)
    ends = replace(stand, t_s=round(run.limits.duration_s, 3))
    stands = Traj(1, TrajectoryInfo.RELATIVE_TO_ORIGIN, f"{spec.id} stands", (stand, ends))
    return Settings(
        device_id,
        datum,
        run.limits,
        approach,
        stands,
        honours_start_time=report is not None and honours_start_time(report) is not None,
    )
