"""Plays the bodies of all objects of a run: simulated plants behind the body protocol."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from pathlib import Path

from ssp_core.errors import HostError
from ssp_core.files import Closing
from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.target.bodies.body_server import BodyServer
from ssp_ot_controller.target.bodies.datagrams import COMMAND_BYTES

# The loop looks at the plants this often at least.
_TICK_S = 0.002
_LOG_HEADER = "time_ns,object,x_m,y_m,yaw_rad,speed_mps,brakes_by_itself"


class PlayedBodies(Closing):
    """One socket and one plant per object of a run.

    Args:
        run: gives classes and starts.
        host: address to listen at.
        first_port: of the first object, counting up; 0: any that are free.
        log: CSV file for the true states, one row per object and state; None: none.

    Raises:
        HostError: an address can't be listened at.
    """

    def __init__(self, run: RunSpec, host: str, first_port: int, log: Path | None) -> None:
        self._log = log.open("w") if log is not None else None
        self._served: list[tuple[str, BodyServer, socket.socket]] = []
        if self._log is not None:
            self._log.write(_LOG_HEADER + "\n")
        for number, target in enumerate(run.targets):
            port = first_port + number if first_port else 0
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            server = BodyServer(target.id, target.cls, target.start.pose, time.time_ns())
            self._served.append((target.id, server, sock))
            try:
                sock.bind((host, port))
            except OSError as error:
                self.close()
                raise HostError(
                    f"can't listen at {host}:{port}: {error.strerror}; choose other ports with "
                    "--first-port, or 0 for any that are free"
                ) from None

    @property
    def addresses(self) -> dict[str, str]:
        """Of each object's body, as ``ssp run --body`` takes it."""
        found = {}
        for object_id, _, sock in self._served:
            host, port = sock.getsockname()
            found[object_id] = f"udp://{host}:{port}"
        return found

    def serve(self, until: Callable[[], bool]) -> None:
        """Follows commands and sends states until told to end."""
        sockets = [sock for _, _, sock in self._served]
        while not until():
            readable, _, _ = select.select(sockets, [], [], _TICK_S)
            for object_id, server, sock in self._served:
                if sock in readable:
                    data, address = sock.recvfrom(COMMAND_BYTES + 1)
                    server.on_datagram(data, address, time.time_ns())
                state = server.state_due(time.time_ns())
                if state is not None:
                    _send(sock, state, server.commander)
                    self._write(object_id, server)

    def _write(self, object_id: str, server: BodyServer) -> None:
        if self._log is None:
            return
        b = server.body
        self._log.write(
            f"{time.time_ns()},{object_id},{b.x_m:.4f},{b.y_m:.4f},{b.yaw_rad:.5f},"
            f"{b.speed_mps:.4f},{int(server.brakes_by_itself)}\n"
        )
        self._log.flush()

    def close(self) -> None:
        """Frees the sockets."""
        for _, _, sock in self._served:
            sock.close()
        if self._log is not None:
            self._log.close()


def _send(sock: socket.socket, data: bytes, address: tuple[str, int]) -> None:
    try:
        sock.sendto(data, address)
    except OSError:
        # A commander that is gone or can't be reached: lost, like a datagram on the way.
        return
