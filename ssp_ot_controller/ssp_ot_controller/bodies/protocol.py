"""Datagrams between an object_target and a body of hardware, and the body at their other end.

docs/body-protocol.md has the layout for those who build bodies. Little-endian throughout. What
isn't a whole, unbroken datagram of this version for this object is rejected with its reason.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time
import zlib
from collections import Counter
from dataclasses import dataclass
from enum import Enum

from ssp_core.addresses import resolve
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import HostError
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.dynamics import Command

MAGIC = b"SSPB"
VERSION = 1
STATE_KIND = 1
COMMAND_KIND = 2
ID_BYTES = 32

# Magic, version, kind, bytes in all, object, boot, sequence, stamp.
_HEADER = struct.Struct("<4sBBH32sqQq")
_STATE = struct.Struct("<7dB7x")
_COMMAND = struct.Struct("<3dIB3x")
_CRC = struct.Struct("<I")
STATE_BYTES = _HEADER.size + _STATE.size + _CRC.size
COMMAND_BYTES = _HEADER.size + _COMMAND.size + _CRC.size
_BRAKES_BY_ITSELF = 1
_EMERGENCY_STOP = 1


class Reason(Enum):
    """The reason why a datagram is refused."""

    LENGTH = "length"
    MAGIC = "magic"
    VERSION = "version"
    CHECKSUM = "checksum"
    KIND = "kind"
    OBJECT = "object"
    NOT_FINITE = "not finite"
    ORDER = "order"


@dataclass(frozen=True, slots=True)
class Envelope:
    """The fields that every datagram carries.

    Args:
        object_id: whose body; ASCII, at most ID_BYTES bytes.
        boot_ns: when the sender was started; one that was started anew has a higher one.
        sequence: counts the sender's datagrams of this boot, from 1.
        stamp_ns: when the content was measured or decided, on the session's clock.
    """

    object_id: str
    boot_ns: int
    sequence: int
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class CommandDatagram:
    """A command, and how long it holds.

    Args:
        timeout_ms: the body brakes by itself when it hears nothing new for so long.
    """

    envelope: Envelope
    command: Command
    timeout_ms: int


def _pack(kind: int, envelope: Envelope, payload: bytes) -> bytes:
    name = envelope.object_id.encode("ascii")
    if not 0 < len(name) <= ID_BYTES:
        raise ValueError(f"object id {envelope.object_id!r} needs 1 to {ID_BYTES} bytes")
    size = _HEADER.size + len(payload) + _CRC.size
    head = _HEADER.pack(
        MAGIC, VERSION, kind, size, name, envelope.boot_ns, envelope.sequence, envelope.stamp_ns
    )
    body = head + payload
    return body + _CRC.pack(zlib.crc32(body))


def encode_state(envelope: Envelope, reading: BodyReading) -> bytes:
    """Return a body's datagram; raise ValueError for what its fields can't hold.

    The envelope's stamp is sent, not the reading's.
    """
    flags = _BRAKES_BY_ITSELF if reading.brakes_by_itself else 0
    payload = _STATE.pack(
        reading.x_m,
        reading.y_m,
        reading.yaw_rad,
        reading.speed_mps,
        reading.acceleration_mps2,
        reading.yaw_rate_radps,
        reading.position_std_m,
        flags,
    )
    return _pack(STATE_KIND, envelope, payload)


def encode_command(datagram: CommandDatagram) -> bytes:
    """Return an object_target's datagram; raise ValueError for what its fields can't hold."""
    command = datagram.command
    if not command.is_finite:
        raise ValueError(f"a body can't follow a command that isn't finite: {command}")
    payload = _COMMAND.pack(
        command.acceleration_mps2,
        command.curvature_1pm,
        command.heading_rad,
        datagram.timeout_ms,
        _EMERGENCY_STOP if command.emergency_stop else 0,
    )
    return _pack(COMMAND_KIND, datagram.envelope, payload)


def _open(data: bytes, kind: int, size: int, object_id: str) -> Envelope | Reason:
    if len(data) != size:
        return Reason.LENGTH
    magic, version, its_kind, stated, name, boot_ns, sequence, stamp_ns = _HEADER.unpack_from(data)
    (crc,) = _CRC.unpack_from(data, size - _CRC.size)
    # In this order: of another version not even the checksum's place is known.
    for is_right, reason in (
        (magic == MAGIC, Reason.MAGIC),
        (version == VERSION, Reason.VERSION),
        (crc == zlib.crc32(data[: -_CRC.size]), Reason.CHECKSUM),
        (stated == size, Reason.LENGTH),
        (its_kind == kind, Reason.KIND),
        (name.rstrip(b"\0") == object_id.encode("ascii"), Reason.OBJECT),
    ):
        if not is_right:
            return reason
    return Envelope(object_id, boot_ns, sequence, stamp_ns)


def decode_state(data: bytes, object_id: str) -> tuple[Envelope, BodyReading] | Reason:
    """Return a body's reading, or why it is not taken. Its stamp is the envelope's."""
    envelope = _open(data, STATE_KIND, STATE_BYTES, object_id)
    if isinstance(envelope, Reason):
        return envelope
    x, y, yaw, speed, acceleration, yaw_rate, std, flags = _STATE.unpack_from(data, _HEADER.size)
    if not all(map(math.isfinite, (x, y, yaw, speed, acceleration, yaw_rate))):
        return Reason.NOT_FINITE
    reading = BodyReading(
        stamp_ns=envelope.stamp_ns,
        x_m=x,
        y_m=y,
        yaw_rad=yaw,
        speed_mps=speed,
        acceleration_mps2=acceleration,
        yaw_rate_radps=yaw_rate,
        position_std_m=std,
        brakes_by_itself=bool(flags & _BRAKES_BY_ITSELF),
    )
    return envelope, reading


def decode_command(data: bytes, object_id: str) -> CommandDatagram | Reason:
    """Return a command, or why it is not taken; arguments as for decode_state."""
    envelope = _open(data, COMMAND_KIND, COMMAND_BYTES, object_id)
    if isinstance(envelope, Reason):
        return envelope
    acceleration, curvature, heading, timeout_ms, flags = _COMMAND.unpack_from(data, _HEADER.size)
    command = Command(acceleration, curvature, heading, bool(flags & _EMERGENCY_STOP))
    if not command.is_finite:
        return Reason.NOT_FINITE
    return CommandDatagram(envelope, command, timeout_ms)


# A sender of an older boot, or of lower sequences of the same one, is taken for the same sender,
# started again, when it has gone on for so long, without such a gap and without a newer word.
RESTART_S = 1.0
_GAP_S = 0.25


class Order:
    """Lets each datagram of a sender pass once and in order; a late one is an old one.

    A sender that is started again has a higher boot. One whose clock was set back meanwhile has a
    lower one, and one without a clock may have the same, and counts anew: it is refused until it
    has gone on in order for RESTART_S while nothing newer was heard. Datagrams that were merely
    late don't do that.

    Attributes:
        set_back_s: by how much the newest datagram's boot lies before the one that is obeyed, s;
            0 when it doesn't.
    """

    def __init__(self) -> None:
        self.set_back_s = 0.0
        self._last: tuple[int, int] | None = None
        # Of an older one: boot and newest sequence, since when it goes on, and when it was heard.
        self._older = (0, 0)
        self._older_since_ns: int | None = None
        self._older_heard_ns = 0

    def is_new(self, envelope: Envelope, now_ns: int, *, may_restart: bool = True) -> bool:
        """Tell whether a datagram is newer than all before; it counts from then on.

        Args:
            envelope: of the datagram.
            now_ns: of its arrival, on a clock that doesn't step.
            may_restart: an older boot may be followed from now on.
        """
        order = (envelope.boot_ns, envelope.sequence)
        last = self._last
        if last is None or order > last:
            self._follow(order)
            return True
        self.set_back_s = ns_to_seconds(last[0] - envelope.boot_ns)
        boot_ns, sequence = self._older
        gap_ns, self._older_heard_ns = now_ns - self._older_heard_ns, now_ns
        begins = self._older_since_ns is None or envelope.boot_ns != boot_ns
        if begins or gap_ns > seconds_to_ns(_GAP_S):
            self._older_since_ns, self._older = now_ns, order
            return False
        if envelope.sequence <= sequence:
            return False
        self._older = order
        goes_on_ns = now_ns - (self._older_since_ns or now_ns)
        if not may_restart or goes_on_ns <= seconds_to_ns(RESTART_S):
            return False
        self._follow(order)
        return True

    def _follow(self, order: tuple[int, int]) -> None:
        self._last, self._older_since_ns, self.set_back_s = order, None, 0.0


# The body brakes by itself when it hears nothing for so long.
TIMEOUT_MS = 200


class UdpBody:
    """Talks to one body. Datagrams from elsewhere never get here: the socket is connected.

    Args:
        boot_ns: session time at which this end was started.

    Raises:
        HostError: there is no way to that address.
    """

    def __init__(self, object_id: str, host: str, port: int, boot_ns: int) -> None:
        self.rejected: Counter[Reason] = Counter()
        self._object_id = object_id
        self._address = f"udp://[{host}]:{port}" if ":" in host else f"udp://{host}:{port}"
        self._boot_ns = boot_ns
        # Of what came last: why it wasn't taken, and whether no program listens there.
        self._refused: Reason | None = None
        self._unreachable = False
        self._sequence = 0
        self._order = Order()
        try:
            family, kind, protocol, _, address = resolve(host, port, socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            self._socket.connect(address)
        except (OSError, HostError) as error:
            raise HostError(f"body of {object_id}: {self._address}: {error}") from None

    def read(self) -> BodyReading | None:
        newest: BodyReading | None = None
        while True:
            try:
                # One byte more than a good one has, so that a longer one shows.
                data = self._socket.recv(STATE_BYTES + 1)
            except OSError as error:
                # Nothing more to read, or no program listens there: its silence is what counts.
                self._unreachable |= isinstance(error, ConnectionRefusedError)
                return newest
            outcome = decode_state(data, self._object_id)
            self._unreachable, self._refused = False, None
            if isinstance(outcome, Reason):
                self._refused = outcome
            elif self._order.is_new(outcome[0], time.monotonic_ns()):
                newest = outcome[1]
            else:
                self._refused = Reason.ORDER
            if self._refused is not None:
                self.rejected[self._refused] += 1

    def problems(self) -> tuple[str, ...]:
        if self._unreachable:
            return (f"no program listens at {self._address}",)
        if self._refused is None:
            return (f"nothing comes from {self._address}",)
        count = self.rejected[self._refused]
        text = f"what comes from {self._address} is refused: {self._refused.value} ({count} times)"
        if self._refused is Reason.ORDER:
            back_s = self._order.set_back_s
            why = "it restarted its count with the same boot"
            if back_s > 0.0:
                why = f"it was started again, and its clock set back by {back_s:.1f} s or more"
            text += f"; {why}: it is followed after {RESTART_S:g} s"
        return (text,)

    def command(self, command: Command, now_ns: int) -> None:
        self._sequence += 1
        envelope = Envelope(self._object_id, self._boot_ns, self._sequence, now_ns)
        # A datagram that can't be sent is lost like one on the way; the body's watchdog counts.
        with contextlib.suppress(OSError):
            self._socket.send(encode_command(CommandDatagram(envelope, command, TIMEOUT_MS)))

    def close(self) -> None:
        self._socket.close()
