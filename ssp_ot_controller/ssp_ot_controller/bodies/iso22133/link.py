"""Connection of a control centre to one object: a TCP and a UDP socket that never wait.

The object listens at a TCP port, and at the UDP port below it. Public objects take what one read
of TCP gives for one message, so each message is sent by itself and at once.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from ssp_core.addresses import resolve
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import HostError
from ssp_ot_controller.bodies.iso22133.framing import (
    CENTRE_ID,
    HEADER_BYTES,
    LONGEST_TRAJECTORY_BYTES,
    TCP_PORT,
    Frame,
    Header,
    RejectedBytes,
    StreamDecoder,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Heab,
    Message,
    Rcmm,
    decode,
    encode,
)

# An object that doesn't answer a connection attempt for so long isn't there.
CONNECT_TIMEOUT_S = 2.0
# The rest of a frame comes within this time, or its length was damaged.
RESYNC_S = 0.5
# A peer that leaves more than this unread doesn't read at all.
QUEUE_BYTES = 2 * LONGEST_TRAJECTORY_BYTES
_READ_BYTES = 65_536
# So that a flood of datagrams doesn't keep a caller in one call.
_READS_PER_POLL = 256

# Told of bytes as they were sent (True) or came, and when (time.time_ns).
Tap = Callable[[bool, int, bytes], None]


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """A message that came from the object.

    Args:
        stamp_ns: when it was read (time.time_ns).
        data: the frame; for what isn't one, the evidence of its rejection.
    """

    udp: bool
    stamp_ns: int
    outcome: DecodedMessage | RejectedBytes
    data: bytes


class TcpFrames:
    """The frames of one TCP connection; a frame whose rest doesn't come is given up in time."""

    def __init__(self) -> None:
        self._decoder = StreamDecoder()
        self._waits_since_ns: int | None = None

    def feed(self, data: bytes) -> list[Frame | RejectedBytes]:
        """Take what one read gave; return the frames that are whole."""
        frames = self._decoder.feed(data)
        if frames:
            self._waits_since_ns = None
        return frames

    def give_up(self, now_ns: int) -> list[Frame | RejectedBytes]:
        """Return what is left of a frame whose rest hasn't come for RESYNC_S; empty otherwise.

        Args:
            now_ns: on the clock of the time limits, when everything was read.
        """
        if not self._decoder.waiting_bytes:
            self._waits_since_ns = None
        elif self._waits_since_ns is None:
            self._waits_since_ns = now_ns
        elif now_ns - self._waits_since_ns > seconds_to_ns(RESYNC_S):
            self._waits_since_ns = None
            return self._decoder.resync()
        return []


class Link:
    """The control centre's end.

    Args:
        host: a name or an address; resolving a name may take a while, nothing later does.
        port: of TCP.
        tap: gets each frame that is sent, each datagram, and what each read of TCP gave.
        monotonic_ns: the clock of the time limits.

    Attributes:
        problem: why there is no connection; empty while there is one.
        transmitter_id: of the messages to come.
        receiver_id: of the messages to come; the object's, once it is known.

    Raises:
        HostError: the host has no address, or the port has none below it.
    """

    def __init__(
        self,
        host: str,
        port: int = TCP_PORT,
        tap: Tap | None = None,
        *,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        if not 1 < port < 65_536:
            raise HostError(f"object at {self.name}: the port must be from 2 to 65535")
        try:
            addresses = resolve(host, port, socket.SOCK_STREAM)
        except HostError as error:
            raise HostError(f"object at {self.name}: {error}") from None
        # A host with several addresses may listen at one of them only: they take turns.
        self._addresses = deque((family, address) for family, _, _, _, address in addresses)
        self._port = port
        self.problem = "not connected yet"
        self.transmitter_id = CENTRE_ID
        self.receiver_id = CENTRE_ID
        self._tap = tap or (lambda _sent, _stamp_ns, _data: None)
        self._monotonic_ns = monotonic_ns
        self._counter = 0
        self._tcp: socket.socket | None = None
        self._udp: socket.socket | None = None
        self._connected = False
        self._started_ns = 0
        self._frames = TcpFrames()
        self._queue: deque[bytes] = deque()

    @property
    def sockets(self) -> list[socket.socket]:
        """Those that become readable when something came; a new connection shows in ``poll``."""
        return [sock for sock in (self._tcp, self._udp) if sock is not None]

    @property
    def connected(self) -> bool:
        return self._connected

    @property
    def connecting(self) -> bool:
        """An attempt is under way."""
        return self._tcp is not None and not self._connected

    def connect(self) -> None:
        """Start to connect; do nothing while there is a connection or an attempt."""
        if self._tcp is not None:
            return
        self._close_udp()
        self._frames = TcpFrames()
        family, address = self._addresses[0]
        self._addresses.rotate(-1)
        try:
            self._udp = socket.socket(family, socket.SOCK_DGRAM)
            self._udp.setblocking(False)
            # The kernel keeps strangers' datagrams away from a socket with a peer.
            self._udp.connect((address[0], self._port - 1, *address[2:]))
            self._tcp = socket.socket(family, socket.SOCK_STREAM)
            self._tcp.setblocking(False)
            self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            code = self._tcp.connect_ex(address)
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        self.problem = "still connecting"
        self._started_ns = self._monotonic_ns()
        if code not in (0, errno.EINPROGRESS):
            self._lose(os.strerror(code))

    def poll(self) -> list[ReceivedMessage]:
        """Return the messages since the last call, in order for each socket.

        Also send what waited.
        """
        messages = self._read_udp()
        if self._tcp is not None and not self._connected:
            self._finish_connecting(self._tcp)
        if self._connected:
            self._flush()
            messages += self._read_tcp()
        return messages

    def send(self, message: Message, *, acknowledge: bool = False) -> Header:
        """Send a message; without a connection it is lost, unless it goes by UDP.

        Raises:
            ValueError: a value that the wire can't say.
        """
        ids = self.transmitter_id, self.receiver_id, self._counter
        data = encode(
            message,
            transmitter_id=ids[0],
            receiver_id=ids[1],
            counter=ids[2],
            acknowledge=acknowledge,
        )
        self._counter = (self._counter + 1) % 256
        if isinstance(message, Heab | Rcmm):
            self._send_udp(data)
        elif self._connected:
            self._send_tcp(data)
        message_id = int.from_bytes(data[HEADER_BYTES - 2 : HEADER_BYTES], "little")
        return Header(message_id, *ids, acknowledge)

    def close(self) -> None:
        """Leave the object to its own watchdog."""
        if self._connected:
            self._flush()
        self._lose("closed")
        self._close_udp()

    # -- UDP --------------------------------------------------------------------------------------

    def _send_udp(self, data: bytes) -> None:
        # A datagram that can't be sent is lost like one on the way; the object's watchdog counts.
        with suppress(OSError):
            if self._udp is not None:
                self._udp.send(data)
                self._tap(True, time.time_ns(), data)

    def _read_udp(self) -> list[ReceivedMessage]:
        messages: list[ReceivedMessage] = []
        for _ in range(_READS_PER_POLL):
            if self._udp is None:
                break
            try:
                data = self._udp.recv(_READ_BYTES)
            except BlockingIOError:
                break
            except OSError:
                # Nobody listens there at present; TCP tells whether the object is there.
                continue
            stamp_ns = time.time_ns()
            self._tap(False, stamp_ns, data)
            messages += _received(frames_of(data), True, stamp_ns)
        return messages

    def _close_udp(self) -> None:
        if self._udp is not None:
            self._udp.close()
            self._udp = None

    # -- TCP --------------------------------------------------------------------------------------

    def _finish_connecting(self, tcp: socket.socket) -> None:
        poll = select.poll()
        poll.register(tcp, select.POLLOUT)
        if poll.poll(0):
            code = tcp.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if code:
                self._lose(os.strerror(code))
            elif tcp.getsockname() == tcp.getpeername():
                # The kernel may take the wanted port for this end, where no program listens at it.
                self._lose(os.strerror(errno.ECONNREFUSED))
            else:
                self._connected, self.problem = True, ""
        elif self._monotonic_ns() - self._started_ns > seconds_to_ns(CONNECT_TIMEOUT_S):
            self._lose(f"no answer within {CONNECT_TIMEOUT_S:g} s")

    def _send_tcp(self, data: bytes) -> None:
        self._queue.append(data)
        self._tap(True, time.time_ns(), data)
        self._flush()
        if sum(map(len, self._queue)) > QUEUE_BYTES:
            self._lose(f"takes no bytes, more than {QUEUE_BYTES} wait")

    def _flush(self) -> None:
        """Send what waits, a message at a time, until the socket takes no more."""
        while self._queue and self._tcp is not None:
            data = self._queue[0]
            try:
                sent = self._tcp.send(data)
            except BlockingIOError:
                return
            except OSError as error:
                self._lose(error.strerror or str(error))
                return
            if sent < len(data):
                self._queue[0] = data[sent:]
            else:
                self._queue.popleft()

    def _read_tcp(self) -> list[ReceivedMessage]:
        messages: list[ReceivedMessage] = []
        now_ns = self._monotonic_ns()
        for _ in range(_READS_PER_POLL):
            if self._tcp is None:
                return messages
            try:
                data = self._tcp.recv(_READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                self._lose(error.strerror or str(error))
                return messages
            stamp_ns = time.time_ns()
            if not data:
                self._lose("the object closed the connection")
                return messages
            self._tap(False, stamp_ns, data)
            messages += _received(self._frames.feed(data), False, stamp_ns)
        if rest := self._frames.give_up(now_ns):
            messages += _received(rest, False, time.time_ns())
        return messages

    def _lose(self, problem: str) -> None:
        """Give the connection up. UDP stays open, for heartbeats that tell of an abort."""
        if self._tcp is not None:
            self._tcp.close()
        self._tcp, self._connected, self.problem = None, False, problem
        self._queue.clear()


def _received(
    frames: list[Frame | RejectedBytes], udp: bool, stamp_ns: int
) -> list[ReceivedMessage]:
    messages = []
    for frame in frames:
        if isinstance(frame, RejectedBytes):
            messages.append(ReceivedMessage(udp, stamp_ns, frame, frame.evidence))
        else:
            messages.append(ReceivedMessage(udp, stamp_ns, decode(frame), frame.data))
    return messages
