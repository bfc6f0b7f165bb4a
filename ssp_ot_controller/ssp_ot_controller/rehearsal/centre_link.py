"""The connection of an object to the only control centre that may drive it, without I/O.

Everything that changes who is connected, and what waits to be sent, lives here. Nothing here reads
a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_ot_controller.bodies.iso22133.framing import (
    LONGEST_TRAJECTORY_BYTES,
    Frame,
    Header,
    RejectedBytes,
    StreamDecoder,
)
from ssp_ot_controller.bodies.iso22133.messages import Grem, Message, Osem, ResponseCode, encode
from ssp_ot_controller.rehearsal.iso_settings import RefusalReason

# A frame on TCP that is incomplete for so long is given up.
_INCOMPLETE_NS = NS_PER_S // 2
_MOST_NOTES = 1000


@dataclass(frozen=True, slots=True)
class OutgoingFrame:
    """A frame that goes to the control centre, by UDP or by TCP."""

    udp: bool
    data: bytes


class CentreLink:
    """The connection with one control centre.

    Attributes:
        host: of the centre; None: none is connected.
        address: where heartbeats come from, and MONR goes; None until the first.
        last_heartbeat_ns: when the last heartbeat came; None before the first.
        status: of the last heartbeat, also of a centre that has gone; None before the first.
        osem: the centre's settings, whose ids the answers carry.
        closes: the connection is given up; the caller closes it.
        notes: what happened, for people.
        strangers: datagrams of others.
    """

    def __init__(self, now_ns: int) -> None:
        self.host: str | None = None
        self.address: Any = None
        self.last_heartbeat_ns: int | None = None
        self.status: int | None = None
        self.osem: Osem | None = None
        self.closes = False
        self.notes: list[str] = []
        self.strangers = 0
        self._out: list[OutgoingFrame] = []
        self._counter = 0
        self._decoder = StreamDecoder(LONGEST_TRAJECTORY_BYTES)
        self._fed_ns = now_ns
        self._next_monr_ns = now_ns

    def open(self, host: str) -> bool:
        """Connect a control centre; False where another one is connected already."""
        if self.host is not None:
            self.note(f"a second control centre, {host}, is refused")
            return False
        self.host, self.address = host, None
        self._decoder = StreamDecoder(LONGEST_TRAJECTORY_BYTES)
        self.osem = self.last_heartbeat_ns = None
        self.closes = False
        self.note(f"{host} is connected")
        return True

    def close(self) -> bool:
        """Forget the control centre; False where none is connected."""
        if self.host is None:
            return False
        self.note(f"{self.host} is disconnected")
        self.host = self.address = None
        self.closes = False
        return True

    def feed(self, data: bytes, now_ns: int) -> list[Frame | RejectedBytes]:
        """Decode bytes of the connection, in pieces of any size."""
        self._fed_ns = now_ns
        return self._decoder.feed(data)

    def take_overdue(self, now_ns: int) -> list[Frame | RejectedBytes]:
        """Decode what follows a frame that has been incomplete for too long."""
        if not self._decoder.waiting_bytes or now_ns - self._fed_ns <= _INCOMPLETE_NS:
            return []
        self._fed_ns = now_ns
        return self._decoder.resync()

    def is_from_centre(self, address: tuple[str, int]) -> bool:
        """Tell whether a datagram is of the connected centre, whose heartbeats use one port."""
        if address[0] == self.host and self.address in (None, address):
            return True
        self.strangers += 1
        if self.strangers == 1:
            self.note(f"datagrams from {address[0]}:{address[1]} aren't heard")
        return False

    def silence_s(self, now_ns: int) -> float:
        """Return the time since the last heartbeat, inf before the first and without a centre."""
        if self.last_heartbeat_ns is None or self.host is None:
            return math.inf
        return ns_to_seconds(now_ns - self.last_heartbeat_ns)

    def take_settings(self, osem: Osem, now_ns: int) -> None:
        """Take the centre's settings; reports are due from now on."""
        self.osem = osem
        self._next_monr_ns = now_ns

    def report_due(self, now_ns: int) -> Osem | None:
        """Return the settings of a MONR that is due now, and count it as sent; None: none is."""
        if self.address is None or self.closes or self.osem is None or now_ns < self._next_monr_ns:
            return None
        period_ns = NS_PER_S // self.osem.monr_rate_hz
        self._next_monr_ns += period_ns
        if self._next_monr_ns <= now_ns:
            # Those that are missing stay missing.
            self._next_monr_ns = now_ns + period_ns
        return self.osem

    def answer(self, header: Header, refused: RefusalReason | None) -> None:
        """Acknowledge a message whose sender requests it."""
        if header.acknowledge:
            code = ResponseCode.OK if refused is None else refused.code
            self.send(Grem(header.transmitter_id, header.counter, header.message_id, code))

    def send(self, message: Message, *, udp: bool = False) -> None:
        """Queue a message for the centre."""
        osem = self.osem
        data = encode(
            message,
            transmitter_id=0 if osem is None else osem.device_id,
            receiver_id=0 if osem is None else osem.control_centre_id,
            counter=self._counter,
        )
        self._counter = (self._counter + 1) % 256
        self._out.append(OutgoingFrame(udp, data))

    def take(self) -> list[OutgoingFrame]:
        """Return the queued frames, in order."""
        out, self._out = self._out, []
        return out

    def note(self, text: str) -> None:
        """Tell people what happened."""
        if len(self.notes) < _MOST_NOTES:
            self.notes.append(text)
