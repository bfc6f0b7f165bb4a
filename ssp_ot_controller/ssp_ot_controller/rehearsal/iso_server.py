"""Sockets of SSP's own ISO 22133 objects."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import click

from ssp_core.closing import Closing
from ssp_core.errors import HostError
from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.objects.rules import ObjectRules
from ssp_ot_controller.rehearsal.iso_faults import FaultyObject
from ssp_ot_controller.rehearsal.iso_object import STEP_S, IsoObject
from ssp_ot_controller.rehearsal.played import StateLog

# The loop looks at the objects this often at least, and logs their states this often.
_TICK_S = 0.002
_LOG_NS = 10_000_000
_READ_BYTES = 1 << 16
_READS_PER_TICK = 64
# A centre whose host has gone is noticed after so long, where it sent no heartbeat yet.
_KEEPALIVE_S = 5
_ATTEMPTS = 100


class IsoServer(Closing):
    """TCP and UDP sockets of one object, UDP at the port below TCP's.

    Args:
        port: of TCP; 0: any that is free.
        puts_back: an object that is left alone goes back to its start.

    Raises:
        HostError: the ports can't be listened at.
    """

    def __init__(
        self, played: IsoObject | FaultyObject, host: str, port: int, *, puts_back: bool = False
    ) -> None:
        self.played, self._puts_back = played, puts_back
        self._centre: socket.socket | None = None
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        for attempt in range(_ATTEMPTS):
            try:
                self._listener, self._udp = _listen(family, host, port)
                break
            except OSError as error:
                # Of free ports the one below may be taken.
                if (port and error.strerror) or attempt == _ATTEMPTS - 1:
                    raise HostError(
                        f"can't listen at {host}:{port} (TCP) and {port - 1} (UDP): "
                        f"{error.strerror}; choose another port"
                    ) from None
        self.host, self.port = host, self._listener.getsockname()[1]

    @property
    def sockets(self) -> list[socket.socket]:
        """Those that become readable when something came."""
        return [s for s in (self._listener, self._udp, self._centre) if s is not None]

    def serve(self, readable: Sequence[socket.socket], now_ns: int) -> None:
        """Take what came, and send what is due."""
        if self._udp in readable:
            self._read_udp()
        # A centre that connects again has ended its old connection before.
        while self._read_tcp():
            pass
        if self._listener in readable:
            self._accept(now_ns)
        for sent in self.played.take_sent(time.time_ns()):
            address = self.played.link.address
            # What can't be sent is lost, like a message on the way.
            with suppress(OSError):
                if sent.udp and address is not None:
                    self._udp.sendto(sent.data, address)
                elif not sent.udp and self._centre is not None:
                    self._centre.sendall(sent.data)
        if self.played.link.closes:
            self._drop()

    def put_back(self, *, is_called: bool = False) -> None:
        """Let the object go back to its start, where that is due."""
        if self._puts_back and isinstance(self.played, IsoObject):
            self.played.put_back(is_called=is_called)

    def _accept(self, now_ns: int) -> None:
        with suppress(OSError):
            centre, address = self._listener.accept()
            self.put_back(is_called=True)
            if not self.played.connect(address[0], now_ns):
                centre.close()
                return
            centre.setblocking(False)
            centre.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            centre.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            centre.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _KEEPALIVE_S)
            if self._centre is not None:
                self._centre.close()
            self._centre = centre

    def _read_udp(self) -> None:
        for _ in range(_READS_PER_TICK):
            try:
                data, address = self._udp.recvfrom(_READ_BYTES)
            except OSError:
                return
            self.played.on_udp(data, address, time.time_ns())

    def _read_tcp(self) -> bool:
        """Read once; tell whether there may be more."""
        if self._centre is None:
            return False
        try:
            data = self._centre.recv(_READ_BYTES)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if data:
            self.played.on_tcp(data, time.time_ns())
        else:
            self._drop()
        return bool(data)

    def _drop(self) -> None:
        if self._centre is not None:
            self._centre.close()
            self._centre = None
        self.played.disconnect(time.time_ns())

    def close(self) -> None:
        for sock in self.sockets:
            sock.close()


def _listen(family: int, host: str, port: int) -> tuple[socket.socket, socket.socket]:
    listener = socket.create_server((host, port), family=family)
    udp = socket.socket(family, socket.SOCK_DGRAM)
    try:
        udp.bind((host, listener.getsockname()[1] - 1))
    except OSError:
        listener.close()
        udp.close()
        raise
    listener.setblocking(False)
    udp.setblocking(False)
    return listener, udp


def serve(servers: Sequence[IsoServer], until: Callable[[], bool], log: StateLog) -> None:
    """Play objects until ended; say what happens to each.

    Args:
        servers: of the objects.
        until: tells whether to end; asked once a tick.
        log: takes the objects' states.
    """
    next_log_ns = 0
    while not until():
        sockets = [sock for server in servers for sock in server.sockets]
        readable, _, _ = select.select(sockets, [], [], _TICK_S)
        now_ns = time.time_ns()
        for server in servers:
            server.serve(readable, now_ns)
            while server.played.link.notes:
                click.echo(f"{server.played.object_id}: {server.played.link.notes.pop(0)}")
        if now_ns >= next_log_ns:
            next_log_ns = now_ns + _LOG_NS
            for server in servers:
                played = server.played
                server.put_back()
                log.add(played.object_id, played.body, brakes_by_itself=played.brakes_by_itself)


class PlayedIsoObjects(Closing):
    """The object targets of a run as ISO 22133 objects.

    Args:
        first_port: TCP of the first object, UDP at the port below; the next one's are two above.
            0: any that are free.
        log: CSV file for the true states; None: none.

    Raises:
        HostError: an address can't be listened at.
    """

    def __init__(self, run: RunSpec, host: str, first_port: int, log: Path | None) -> None:
        self._log = StateLog(log)
        self._servers: list[IsoServer] = []
        try:
            for number, target in enumerate(run.targets):
                played = object_of_run(run, target.id, time.time_ns())
                port = first_port + 2 * number if first_port else 0
                self._servers.append(IsoServer(played, host, port, puts_back=True))
        except HostError:
            self.close()
            raise

    @property
    def addresses(self) -> dict[str, str]:
        """Return each object's address, as ``ssp run --body`` takes it."""
        return {s.played.object_id: f"iso22133://{s.host}:{s.port}" for s in self._servers}

    def serve(self, until: Callable[[], bool]) -> None:
        """Play until ended."""
        serve(self._servers, until, self._log)

    def close(self) -> None:
        for server in self._servers:
            server.close()
        self._log.close()


def object_of_run(run: RunSpec, object_id: str, now_ns: int) -> IsoObject:
    """Make an object target of a run, with the run's limits and fence."""
    spec = next(t for t in run.targets if t.id == object_id)
    fence = tuple(run.geofence)
    rules = ObjectRules(spec, run.limits, fence, STEP_S, run.event_version)
    datum = None if run.datum is None else run.datum.datum
    return IsoObject(rules, now_ns, datum)
