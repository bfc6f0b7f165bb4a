"""Hardware that a rehearsal plays: the VUT as its driver moves it, and bodies behind UDP."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.closing import Closing
from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Role, SessionPhase
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.bodies.simulated import BodyServer, serve
from ssp_ot_controller.sil.vut_driver import VutDriver

# The plant is stepped at least this finely, also where a busy machine comes late.
_PLANT_STEP_S = 0.01
# Left alone and standing for so long, what is played goes back to its start, for the next session.
# If that one comes earlier, it goes back then.
PUT_BACK_S = 10.0
# Before these a session has armed nothing.
_UNARMED = (SessionPhase.IDLE, SessionPhase.LOADED, SessionPhase.CONNECTED)
# What stands within so much of its start is there.
_AT_START_M = 0.05
# However late: what wasn't stepped by then stays out, as for a vehicle that stood meanwhile.
_LONGEST_S = 1.0


def is_away(body: BodyState, start: Pose2) -> bool:
    """Tell whether a body stands elsewhere than at its start."""
    away_m = math.hypot(body.x_m - start.x_m, body.y_m - start.y_m)
    return body.speed_mps == 0.0 and away_m > _AT_START_M


class PlayedVehicle:
    """Drives by the heartbeats that it hears, as a driver does by the radio. Reads no clock."""

    def __init__(self, run: RunSpec, now_ns: int) -> None:
        self._run = run
        self._driver = VutDriver(run)
        self._now_ns = now_ns
        self._began_ns: int | None = None
        self._silent_ns = seconds_to_ns(run.limits.heartbeat_s)
        self._last_message_ns: int | None = None
        self._phase = SessionPhase.IDLE
        # Of the newest heartbeat's session, and of the one in which it drove.
        self._token = self._driven_token = ""
        self.body = BodyState.at_rest(run.vut.start.pose)

    def hear(self, phase: SessionPhase, token: str, now_ns: int) -> None:
        """Take phase and session token of a heartbeat."""
        if phase is SessionPhase.RUNNING and self._phase is not SessionPhase.RUNNING:
            self._began_ns = now_ns
        if phase is SessionPhase.RUNNING:
            self._driven_token = token
        self._phase, self._token, self._last_message_ns = phase, token, now_ns

    def drives(self, now_ns: int) -> bool:
        """Tell whether the session runs, and a manager still says so."""
        has_manager = (
            self._last_message_ns is not None and now_ns - self._last_message_ns <= self._silent_ns
        )
        return has_manager and self._phase is SessionPhase.RUNNING

    def advance(self, others: Sequence[ObjectState], now_ns: int) -> BodyState:
        """Move the vehicle up to a time."""
        left_ns = min(now_ns - self._now_ns, seconds_to_ns(_LONGEST_S))
        self._now_ns = now_ns - left_ns
        longest_ns = seconds_to_ns(_PLANT_STEP_S)
        while self._now_ns < now_ns:
            step_ns = min(longest_ns, now_ns - self._now_ns)
            self._now_ns += step_ns
            command = self._driver.command(
                self._state(), others, None, drives=self.drives(self._now_ns)
            )
            self.body = step_body(self._run.vut.cls, self.body, command, ns_to_seconds(step_ns))
        if self._is_left_away():
            self._driver, self._began_ns = VutDriver(self._run), None
            self.body = BodyState.at_rest(self._run.vut.start.pose)
        return self.body

    def _is_left_away(self) -> bool:
        """Tell whether its session has gone, or the next one is there, and it stands elsewhere."""
        heard_ns = self._last_message_ns
        silent = heard_ns is not None and self._now_ns - heard_ns > seconds_to_ns(PUT_BACK_S)
        is_next = self._token not in ("", self._driven_token) and self._phase in _UNARMED
        return (silent or is_next) and is_away(self.body, self._run.vut.start.pose)

    @property
    def now_ns(self) -> int:
        """Return the time up to which the VUT was moved."""
        return self._now_ns

    def _state(self) -> ObjectState:
        vut, b = self._run.vut, self.body
        began_ns = self._began_ns if self._began_ns is not None else self._now_ns
        return ObjectState(
            vut.id,
            vut.cls,
            Role.VUT,
            max(self._now_ns - began_ns, 0),
            b.x_m,
            b.y_m,
            b.yaw_rad,
            b.speed_mps,
            b.acceleration_mps2,
            b.yaw_rate_radps,
            vut.size,
        )


class StateLog(Closing):
    """True states of played objects as CSV, on the system clock.

    Args:
        path: of the file; None: nothing is written.

    Raises:
        InputError: it can't be written.
    """

    def __init__(self, path: Path | None) -> None:
        try:
            self._file = path.open("w") if path is not None else None
        except OSError as error:
            remedy = "name a file in a folder that is there"
            problem = f"can't be written: {error.strerror}"
            raise InputError(problem, file=path, remedy=remedy) from None
        self._write("time_ns,object,x_m,y_m,yaw_rad,speed_mps,brakes_by_itself\n")

    def add(self, object_id: str, body: BodyState, *, brakes_by_itself: bool) -> None:
        """Write the state that an object has now."""
        self._write(
            f"{time.time_ns()},{object_id},{body.x_m:.4f},{body.y_m:.4f},{body.yaw_rad:.5f},"
            f"{body.speed_mps:.4f},{int(brakes_by_itself)}\n"
        )

    def _write(self, text: str) -> None:
        if self._file is not None:
            self._file.write(text)
            self._file.flush()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


class PlayedBodies(Closing):
    """One socket and one plant per object of a run.

    Args:
        first_port: of the first object, counting up; 0: any that are free.
        log: CSV file for the true states, one row per object and state; None: none.

    Raises:
        HostError: an address can't be listened at.
    """

    def __init__(self, run: RunSpec, host: str, first_port: int, log: Path | None) -> None:
        self._log = StateLog(log)
        self._starts = {target.id: target.start.pose for target in run.targets}
        # By object, who has commanded it since it was at its start.
        self._commanders: dict[str, Any] = {}
        self._served: list[tuple[BodyServer, socket.socket]] = []
        for number, target in enumerate(run.targets):
            port = first_port + number if first_port else 0
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            server = BodyServer(target.id, target.cls, target.start.pose, time.time_ns())
            self._served.append((server, sock))
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
        """Return the address of each object's body, as ``ssp run --body`` takes it."""
        address_by_id = {}
        for body, sock in self._served:
            host, port = sock.getsockname()
            address_by_id[body.object_id] = f"udp://{host}:{port}"
        return address_by_id

    def serve(self, until: Callable[[], bool]) -> None:
        """Follow commands and send states until ended."""
        serve(self._served, until, self._write)

    def _write(self, server: BodyServer) -> None:
        start = self._starts[server.object_id]
        # The process that commands a body is its session's: another one is of the next session.
        last = self._commanders.setdefault(server.object_id, server.commander)
        is_next = last is not None and server.commander != last
        if not is_away(server.body, start):
            self._commanders[server.object_id] = server.commander
        elif server.silent_s > PUT_BACK_S or is_next:
            self._commanders[server.object_id] = server.commander
            server.place(start)
            click.echo(f"{server.object_id}: back at its start")
        self._log.add(server.object_id, server.body, brakes_by_itself=server.brakes_by_itself)

    def close(self) -> None:
        """Free the sockets."""
        for _, sock in self._served:
            sock.close()
        self._log.close()
