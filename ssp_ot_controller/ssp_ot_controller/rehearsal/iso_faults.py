"""Faults of a played ISO 22133 object: what happens to bytes on their way to it and from it.

The object behind them is sound; only what it hears and says is not. Names are those of run files
where these have one (``FaultKind``).
"""

from __future__ import annotations

import re
import struct
from binascii import crc_hqx
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.dynamics import BodyState
from ssp_ot_controller.bodies.iso22133.framing import (
    LONGEST_TRAJECTORY_BYTES,
    Frame,
    Header,
    StreamDecoder,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Dreq,
    Heab,
    Message,
    Monr,
    Strt,
    decode,
    encode,
)
from ssp_ot_controller.rehearsal.centre_link import CentreLink, OutgoingFrame
from ssp_ot_controller.rehearsal.iso_object import IsoObject

KINDS = {
    "link_cut": "nothing arrives and nothing leaves",
    "link_delay": "everything arrives and leaves VALUE s later",
    "deaf_to_abort": "it reports ABORTING and drives on",
    "deaf_to_silence": "it drives on when heartbeats or the connection are lost",
    "early_start": "it ignores the start time of a STRT",
    "two_centres": "it obeys a second control centre as well",
    "no_dres": "it doesn't answer DREQ",
    "yaw_range": "its MONR state a yaw of 400 degrees",
    "driving_state": "its MONR state the number VALUE while it runs or stops",
    "speed_factor": "its MONR state VALUE times its speed",
    "wrong_version": "it speaks wire version 3",
    "fragments": "what it sends by TCP comes in pieces of 7 bytes",
}
# Those that are nothing without a value.
_VALUED = ("link_delay", "driving_state", "speed_factor")
_NUMBER = r"([0-9]{1,6}(?:\.[0-9]{1,6})?)"
_FAULT = re.compile(rf"([a-z_]+)(?:={_NUMBER})?(?:@{_NUMBER}(?:\+{_NUMBER})?)?")
_PIECE_BYTES = 7
_BEAT_NS = 10_000_000
# Where a MONR's yaw lies in its frame, and 400 degrees.
_YAW_AT, _YAW = 38, 40_000
_VERSION_AT = 6


@dataclass(frozen=True, slots=True)
class IsoFault:
    """A fault.

    Args:
        value: s, of a delay; a number of a state; a factor.
        at_s: since the first start; None: from the beginning on.
        for_s: how long; None: for good.
    """

    kind: str
    value: float = 0.0
    at_s: float | None = None
    for_s: float | None = None

    @staticmethod
    def parse(text: str) -> IsoFault:
        """Parse ``KIND[=VALUE][@AT_S[+FOR_S]]``.

        Raises:
            InputError: it isn't of that form.
        """
        match = _FAULT.fullmatch(text)
        kind, value, at, for_ = ("", None, None, None) if match is None else match.groups()
        if kind not in KINDS or (value is None) is (kind in _VALUED):
            raise InputError(
                "is no fault",
                field="--fault",
                value=text,
                remedy="write KIND, KIND@AT_S or KIND@AT_S+FOR_S, with one of "
                f"{', '.join(KINDS)}; {', '.join(f'{one}=VALUE' for one in _VALUED)}",
            )
        at_s, for_s = (None if number is None else float(number) for number in (at, for_))
        return IsoFault(kind, float(value or 0.0), at_s, for_s)


class FaultyObject:
    """An object whose bytes pass through its faults; otherwise as ``IsoObject``."""

    def __init__(self, played: IsoObject, faults: Sequence[IsoFault]) -> None:
        self._played, self._faults = played, tuple(faults)
        self._began_ns: int | None = None
        self._waiting: deque[tuple[int, Callable[[int], None]]] = deque()
        self._out: deque[tuple[int, OutgoingFrame]] = deque()
        self._pieces: deque[OutgoingFrame] = deque()
        self._decoder = StreamDecoder(LONGEST_TRAJECTORY_BYTES)
        self._beat_ns = 0
        self._status = int(CentreStatus.INIT)
        self._aborted = self._is_centre_gone = False

    @property
    def object_id(self) -> str:
        return self._played.object_id

    @property
    def body(self) -> BodyState:
        return self._played.body

    @property
    def brakes_by_itself(self) -> bool:
        return self._played.brakes_by_itself

    @property
    def link(self) -> CentreLink:
        return self._played.link

    # -- to the object -------------------------------------------------------------------------

    def connect(self, host: str, now_ns: int) -> bool:
        if self._is_centre_gone:
            self._leave(now_ns)
        if self._played.connect(host, now_ns):
            self._decoder = StreamDecoder(LONGEST_TRAJECTORY_BYTES)
            return True
        return self._has("two_centres", now_ns) is not None

    def disconnect(self, now_ns: int) -> None:
        self._is_centre_gone = True
        if self._has("deaf_to_silence", now_ns) is None:
            self._leave(now_ns)

    def _leave(self, now_ns: int) -> None:
        self._is_centre_gone = False
        self._played.disconnect(now_ns)

    def on_tcp(self, data: bytes, now_ns: int) -> None:
        self._later(lambda at_ns: self._take_tcp(data, at_ns), now_ns)

    def on_udp(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        if self._has("link_cut", now_ns) is None:
            self._later(lambda at_ns: self._take_udp(data, address, at_ns), now_ns)

    def _take_tcp(self, data: bytes, now_ns: int) -> None:
        for frame in self._decoder.feed(data):
            if not isinstance(frame, Frame):
                self._played.on_tcp(frame.evidence, now_ns)
                continue
            outcome = decode(frame)
            message = outcome.message if isinstance(outcome, DecodedMessage) else None
            if isinstance(message, Dreq) and self._has("no_dres", now_ns) is not None:
                continue
            if isinstance(message, Strt) and self._has("early_start", now_ns) is not None:
                self._played.on_tcp(_again(frame.header, Strt(None, None)), now_ns)
            else:
                self._played.on_tcp(frame.data, now_ns)

    def _take_udp(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        if self._has("two_centres", now_ns) is not None and self.link.address is not None:
            address = self.link.address
        for frame in frames_of(data):
            outcome = decode(frame) if isinstance(frame, Frame) else None
            if isinstance(outcome, DecodedMessage) and isinstance(outcome.message, Heab):
                self._aborted = outcome.message.status == CentreStatus.ABORT
                if self._aborted and self._has("deaf_to_abort", now_ns) is not None:
                    data = _again(outcome.header, replace(outcome.message, status=self._status))
                else:
                    self._status = outcome.message.status
                self._beat_ns = now_ns
        self._played.on_udp(data, address, now_ns)

    def _later(self, take: Callable[[int], None], now_ns: int) -> None:
        """Call now, after the delay, or when the link stands again; in the order of arrival."""
        self._waiting.append((now_ns + self._delay_ns(now_ns), take))
        self.advance(now_ns)

    def advance(self, now_ns: int) -> None:
        """Move the object up to a time."""
        while self._waiting and self._waiting[0][0] <= now_ns and not self._is_cut(now_ns):
            self._waiting.popleft()[1](now_ns)
        deaf = self._has("deaf_to_silence", now_ns) is not None
        drives = self._played.state is ControlState.RUNNING and self.body.speed_mps > 0.0
        if deaf and drives and self.link.address is not None:
            while now_ns - self._beat_ns > _BEAT_NS:
                self._beat_ns = max(self._beat_ns + _BEAT_NS, now_ns - 10 * _BEAT_NS)
                beat = encode(Heab(None, self._status))
                self._played.on_udp(beat, self.link.address, self._beat_ns)
        elif self._is_centre_gone:
            self._leave(now_ns)
        self._played.advance(now_ns)
        self._began_ns = self._began_ns or self._played.started_ns

    # -- from the object -----------------------------------------------------------------------

    def take_sent(self, now_ns: int) -> list[OutgoingFrame]:
        """Return the messages that are due by now, in order."""
        self.advance(now_ns)
        for sent in self._played.take_sent(now_ns):
            self._out.append((now_ns + self._delay_ns(now_ns), self._changed(sent, now_ns)))
        frames: list[OutgoingFrame] = []
        cut = self._is_cut(now_ns)
        if cut:
            self._out = deque(due for due in self._out if not due[1].udp)
        while self._out and self._out[0][0] <= now_ns and not cut:
            frames.append(self._out.popleft()[1])
        if self._has("fragments", now_ns) is None:
            return frames
        for sent in (one for one in frames if not one.udp):
            starts = range(0, len(sent.data), _PIECE_BYTES)
            self._pieces += (OutgoingFrame(False, sent.data[i : i + _PIECE_BYTES]) for i in starts)
        piece = [self._pieces.popleft()] if self._pieces else []
        return [*(one for one in frames if one.udp), *piece]

    def _changed(self, sent: OutgoingFrame, now_ns: int) -> OutgoingFrame:
        data = bytearray(sent.data)
        if sent.udp and self._has("yaw_range", now_ns) is not None:
            struct.pack_into("<H", data, _YAW_AT, _YAW)
        changes = self._changes(now_ns)
        if sent.udp and changes:
            (frame,) = frames_of(sent.data)
            outcome = decode(frame) if isinstance(frame, Frame) else None
            if isinstance(outcome, DecodedMessage) and isinstance(outcome.message, Monr):
                data = bytearray(_again(outcome.header, replace(outcome.message, **changes)))
        if self._has("wrong_version", now_ns) is not None:
            data[_VERSION_AT] += 1
        return OutgoingFrame(sent.udp, _with_checksum(bytes(data)))

    def _changes(self, now_ns: int) -> dict[str, Any]:
        """Return the changed fields of a MONR."""
        changes: dict[str, Any] = {}
        odd, factor = self._has("driving_state", now_ns), self._has("speed_factor", now_ns)
        if factor is not None:
            changes["speed_mps"] = factor.value * self.body.speed_mps
        if odd is not None and self._played.state in (ControlState.RUNNING, ControlState.POSTRUN):
            changes["state"] = int(odd.value)
        if self._aborted and self._has("deaf_to_abort", now_ns) is not None:
            changes["state"] = ControlState.ABORTING
        return changes

    # -- which faults --------------------------------------------------------------------------

    def _has(self, kind: str, now_ns: int) -> IsoFault | None:
        """Return an active fault of that kind, or None."""
        for fault in self._faults:
            if fault.kind != kind:
                continue
            if fault.at_s is None:
                return fault
            if self._began_ns is None:
                continue
            begin_ns = self._began_ns + seconds_to_ns(fault.at_s)
            over = fault.for_s is not None and now_ns >= begin_ns + seconds_to_ns(fault.for_s)
            if now_ns >= begin_ns and not over:
                return fault
        return None

    def _is_cut(self, now_ns: int) -> bool:
        return self._has("link_cut", now_ns) is not None

    def _delay_ns(self, now_ns: int) -> int:
        fault = self._has("link_delay", now_ns)
        return 0 if fault is None else seconds_to_ns(fault.value)


def _again(header: Header, message: Message) -> bytes:
    """Encode another message under the same header."""
    return encode(
        message,
        transmitter_id=header.transmitter_id,
        receiver_id=header.receiver_id,
        counter=header.counter,
        acknowledge=header.acknowledge,
    )


def _with_checksum(frame: bytes) -> bytes:
    """Return the frame with the checksum that its bytes give."""
    body = frame[:-2]
    return body + crc_hqx(body, 0).to_bytes(2, "little")
