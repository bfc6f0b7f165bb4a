"""A body behind the body protocol: datagrams to its address, its readings back from there."""

from __future__ import annotations

import contextlib
import socket
from collections import Counter

from ssp_core.errors import HostError
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.datagrams import (
    STATE_BYTES,
    CommandDatagram,
    Envelope,
    Order,
    Reason,
    Rejected,
    decode_state,
    encode_command,
)
from ssp_ot_controller.bodies.dynamics import Command

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
        self._boot_ns = boot_ns
        self._sequence = 0
        self._order = Order()
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            self._socket.connect(address)
        except OSError as error:
            raise HostError(f"body of {object_id}: udp://{host}:{port}: {error}") from None

    def read(self) -> BodyReading | None:
        newest: BodyReading | None = None
        while True:
            try:
                # One byte more than a good one has, so that a longer one shows.
                data = self._socket.recv(STATE_BYTES + 1)
            except OSError:
                # Nothing more to read, or nobody listens there: its silence is what counts.
                return newest
            found = decode_state(data, self._object_id)
            if not isinstance(found, Rejected):
                envelope, reading = found
                late = self._order.check(envelope)
                if late is None:
                    newest = reading
                    continue
                found = late
            self.rejected[found.reason] += 1

    def command(self, command: Command, now_ns: int) -> None:
        self._sequence += 1
        envelope = Envelope(self._object_id, self._boot_ns, self._sequence, now_ns)
        # A datagram that can't be sent is lost like one on the way; the body's watchdog counts.
        with contextlib.suppress(OSError):
            self._socket.send(encode_command(CommandDatagram(envelope, command, TIMEOUT_MS)))

    def close(self) -> None:
        self._socket.close()
