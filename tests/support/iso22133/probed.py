"""A probe of a played object in time that is set, without sockets."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from ssp_core.geodesy import Datum
from ssp_core.motion.state import Size
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.iso22133.framing import (
    Frame,
    Header,
    RejectedBytes,
    StreamDecoder,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.link import ReceivedMessage, Tap
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Heab,
    Message,
    Monr,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.probe.fenced_way import FencedWay
from ssp_ot_controller.bodies.iso22133.probe.stages import Clock, Probe, Wire, report_of
from ssp_ot_controller.bodies.iso22133.probe_report import ObjectKind, Outcome, ProbeReport, Stage
from ssp_ot_controller.rehearsal.iso_faults import FaultyObject, IsoFault
from ssp_ot_controller.rehearsal.iso_object import IsoObject
from tests.support.iso22133.centre import FENCE, HOST, MS, PLACE, T0, S, rules_of

STAGES = tuple(Stage)
SIZE = Size(2.5, 2.5, 2.0, 1.5)
WAY_AND_FENCE = FencedWay(FENCE, SIZE)


class SetClock(Clock):
    """Time goes on only where somebody waits."""

    def __init__(self) -> None:
        self.at_ns = T0

    def now_ns(self) -> int:
        return self.at_ns

    def wait(self, wire: Wire, seconds: float) -> None:
        self.at_ns += max(round(seconds * S), MS)


class SetLink:
    """A stand-in for ``Link`` to an object in the same process.

    Args:
        lost: messages of the object that get lost.
        reports: a MONR that arrives instead of the object's own.
    """

    def __init__(
        self,
        played: Any,
        clock: SetClock,
        tap: Tap,
        lost: Callable[[Message], bool],
        reports: Callable[[Monr], Monr],
    ) -> None:
        self.problem, self.receiver_id = "not connected yet", 0
        self._played, self._clock, self._tap = played, clock, tap
        self._lost, self._reports = lost, reports
        self._connected = False
        self._counter = 0
        self._tcp = StreamDecoder()

    @property
    def connected(self) -> bool:
        return self._connected

    @property
    def connecting(self) -> bool:
        return False

    @property
    def sockets(self) -> list[socket.socket]:
        return []

    def connect(self) -> None:
        self._connected = self._played.connect(HOST, self._clock.at_ns)

    def send(self, message: Message, *, acknowledge: bool = False) -> Header:
        data = encode(message, counter=self._counter, acknowledge=acknowledge)
        self._counter = (self._counter + 1) % 256
        self._tap(True, self._clock.at_ns, data)
        if isinstance(message, Heab):
            self._played.on_udp(data, (HOST, 50_000), self._clock.at_ns)
        elif self._connected:
            self._played.on_tcp(data, self._clock.at_ns)
        return _of(data)

    def poll(self) -> list[ReceivedMessage]:
        now_ns, found = self._clock.at_ns, []
        for sent in self._played.take_sent(now_ns):
            for frame in frames_of(sent.data) if sent.udp else self._tcp.feed(sent.data):
                outcome = decode(frame) if isinstance(frame, Frame) else frame
                data = frame.data if isinstance(frame, Frame) else frame.evidence
                if isinstance(outcome, DecodedMessage) and isinstance(outcome.message, Monr):
                    outcome = replace(outcome, message=self._reports(outcome.message))
                if not (isinstance(outcome, DecodedMessage) and self._lost(outcome.message)):
                    found.append(ReceivedMessage(sent.udp, now_ns, outcome, data))
        if self._played.link.closes:
            self.close()
        return found if self._connected else []

    def close(self) -> None:
        if self._connected:
            self._played.disconnect(self._clock.at_ns)
        self._connected, self.problem = False, "the object closed the connection"


class ReorderingLink(SetLink):
    """A link that delivers each seventh report behind the next one."""

    _count = 0
    _held: ReceivedMessage | None = None

    def poll(self) -> list[ReceivedMessage]:
        found: list[ReceivedMessage] = []
        for received in super().poll():
            is_report = isinstance(received.outcome, DecodedMessage) and isinstance(
                received.outcome.message, Monr
            )
            self._count += is_report
            if is_report and self._count % 7 == 0:
                self._held = received
                continue
            found.append(received)
            if is_report and self._held is not None:
                found.append(replace(self._held, stamp_ns=received.stamp_ns))
                self._held = None
        return found


def _of(data: bytes) -> Header:
    (frame,) = frames_of(data) if len(data) < 4000 else StreamDecoder(1 << 20).feed(data)
    assert not isinstance(frame, RejectedBytes)
    return frame.header


class Probed:
    """A probe of a played object, which has ended."""

    def __init__(
        self,
        *faults: str,
        stages: Iterable[Stage] = STAGES,
        way: FencedWay = WAY_AND_FENCE,
        lost: Callable[[Message], bool] = lambda message: False,
        watch: Callable[[str], None] = lambda text: None,
        reports: Callable[[str, Monr], Monr] = lambda step, monr: monr,
        object_class: str = "car",
        omnidirectional: bool = False,
        link: type[SetLink] = SetLink,
    ) -> None:
        self.clock = SetClock()
        self.told: list[str] = []
        self.object = FaultyObject(
            IsoObject(rules_of(object_class), T0, Datum(PLACE)),
            [IsoFault.parse(fault) for fault in faults],
        )
        self.beats: list[tuple[int, int]] = []

        def open_wire(tap: Tap) -> SetLink:
            def both(sent: bool, stamp_ns: int, data: bytes) -> None:
                found = decode(frames_of(data)[0]) if len(data) < 60 else None  # type: ignore[arg-type]
                if isinstance(found, DecodedMessage) and isinstance(found.message, Heab):
                    self.beats.append((stamp_ns, found.message.status))
                tap(sent, stamp_ns, data)

            return link(self.object, self.clock, both, lost, self._stated)

        def tell(text: str) -> None:
            self.told.append(text)
            watch(text)

        kind = ObjectKind(ObjectClass.from_word(object_class), omnidirectional)
        self.probe = Probe(open_wire, Datum(PLACE), way, 0.5, tell, self.clock, kind)
        self.stages = tuple(stages)
        self._reports = reports

    def _stated(self, monr: Monr) -> Monr:
        return self._reports(list(self.probe.steps)[-1], monr)

    def run(self) -> ProbeReport:
        self.probe.run(self.stages)
        return self.report()

    def report(self) -> ProbeReport:
        return report_of(self.probe, HOST, 53241, T0, self.stages)


def with_verdict(report: ProbeReport, verdict: Outcome) -> set[str]:
    return {row.clause for row in report.rows if row.verdict is verdict}
