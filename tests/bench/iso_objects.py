"""The other side of an ISO 22133 gateway in ``iso``, each part as one process until SIGTERM.

``python iso_objects.py objects RUN_FILE`` plays all objects of a run: they take the states that
messages ask for, drive along x what their TRAJ says, and send MONR at 100 Hz, one after the other.
``echo COUNT`` sends datagrams back, and ``ask PORT...`` sends datagrams of a MONR's size to it at
the same rates. The first line on standard output is the ports, and the last one what was measured,
as JSON.
"""

from __future__ import annotations

import json
import select
import signal
import socket
import sys
import time
from bisect import bisect_right
from collections.abc import Callable

from ssp_core.geodesy import Datum, Place
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.framing import (
    LONGEST_TRAJECTORY_BYTES,
    NO_ID,
    Frame,
    StreamDecoder,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Heab,
    Monr,
    ObjectCommand,
    Osem,
    Ostm,
    Strt,
    Traj,
    TrajPoint,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.states import Stimulus, after
from ssp_ot_controller.bodies.iso22133.units import to_gps

PERIOD_NS = 10_000_000
LONGEST_WAIT_S = 0.1
MONR_BYTES = 60
_ASKED = {
    ObjectCommand.ARM: (Stimulus.ARM, Stimulus.ARM_DONE),
    ObjectCommand.DISARM: (Stimulus.DISARM,),
    ObjectCommand.ALL_CLEAR: (Stimulus.ALL_CLEAR,),
}
_TOLD = {
    CentreStatus.ABORT: (Stimulus.ABORT,),
    CentreStatus.NORMAL_STOP: (Stimulus.NORMAL_STOP, Stimulus.STANDSTILL),
    CentreStatus.TEST_DONE: (Stimulus.TEST_DONE, Stimulus.STANDSTILL),
}


def udp(port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(("127.0.0.1", port))
    return sock


def both() -> tuple[socket.socket, socket.socket]:
    """A listener, and a UDP socket at the port before."""
    while True:
        listener = socket.create_server(("127.0.0.1", 0))
        listener.setblocking(False)
        try:
            return listener, udp(listener.getsockname()[1] - 1)
        except OSError:
            listener.close()


class Played:
    """An object that is always where it is wanted."""

    def __init__(self, spec: ParticipantSpec, datum: Datum) -> None:
        self.listener, self.udp = both()
        self.tcp: socket.socket | None = None
        self.sent: list[tuple[int, int]] = []
        self.heartbeats = 0
        self._pose = datum.to_enu(spec.start.pose)
        self._state = ControlState.INIT
        self._decoder = StreamDecoder(LONGEST_TRAJECTORY_BYTES)
        self._id, self._counter = NO_ID, 0
        self._centre: tuple[str, int] | None = None
        self._points: tuple[TrajPoint, ...] = ()
        self._start_ns: int | None = None

    def on_listener(self) -> socket.socket:
        self.tcp, _ = self.listener.accept()
        self.tcp.setblocking(False)
        self._take(Stimulus.CONNECTED)
        return self.tcp

    def on_tcp(self) -> bool:
        """False: the connection is over."""
        data = b"" if self.tcp is None else self.tcp.recv(65536)
        for frame in self._decoder.feed(data):
            found = decode(frame) if isinstance(frame, Frame) else frame
            message = found.message if isinstance(found, DecodedMessage) else None
            if isinstance(message, Osem):
                self._id = message.device_id
            elif isinstance(message, Ostm):
                self._take(*_ASKED[ObjectCommand(message.command)])
            elif isinstance(message, Traj):
                self._points = message.points
            elif isinstance(message, Strt):
                self._start_ns = time.time_ns()
                self._take(Stimulus.START, Stimulus.START_DONE)
        return bool(data)

    def on_udp(self) -> None:
        data, self._centre = self.udp.recvfrom(2048)
        self.heartbeats += 1
        for frame in frames_of(data):
            found = decode(frame) if isinstance(frame, Frame) else frame
            if isinstance(found, DecodedMessage) and isinstance(found.message, Heab):
                self._take(*_TOLD.get(CentreStatus(found.message.status), ()))

    def report(self) -> None:
        """One MONR, and when it was handed over."""
        if self._centre is None:
            return
        now_ns = time.time_ns()
        _, time_of_week_ns = to_gps(now_ns)
        pose, (x_m, speed_mps) = self._pose, self._along_x(now_ns)
        monr = Monr(
            time_of_week_ns,
            x_m,
            pose.y_m,
            0.0,
            pose.yaw_rad,
            0.0,
            0.0,
            speed_mps,
            0.0,
            0.0,
            0.0,
            0,
            int(self._state),
            1,
            0,
            0,
        )
        self._counter = (self._counter + 1) % 256
        data = encode(monr, transmitter_id=self._id, counter=self._counter)
        self.udp.sendto(data, self._centre)
        self.sent.append((now_ns, time.time_ns()))

    def _along_x(self, now_ns: int) -> tuple[float, float]:
        """Place and speed."""
        if self._start_ns is None:
            return self._pose.x_m, 0.0
        points, t_s = self._points, (now_ns - self._start_ns) * 1e-9
        k = min(bisect_right(points, t_s, key=lambda point: point.t_s), len(points) - 1)
        before, after_it = points[k - 1], points[k]
        share = min((t_s - before.t_s) / (after_it.t_s - before.t_s), 1.0)
        x_m = before.x_m + share * (after_it.x_m - before.x_m)
        return x_m, before.speed_mps + share * (after_it.speed_mps - before.speed_mps)

    def _take(self, *stimuli: Stimulus) -> None:
        for stimulus in stimuli:
            self._state = after(self._state, stimulus)


class Loop:
    """Waits for sockets, and calls one of several functions in turn, each every 10 ms."""

    def __init__(self, turns: list[Callable[[], None]]) -> None:
        self._turns = turns
        self._poll = select.epoll()
        self._calls: dict[int, Callable[[], object]] = {}
        self._over = False
        signal.signal(signal.SIGTERM, self._end)

    def add(self, sock: socket.socket, call: Callable[[], object]) -> None:
        self._poll.register(sock, select.EPOLLIN)
        self._calls[sock.fileno()] = call

    def remove(self, sock: socket.socket) -> None:
        self._poll.unregister(sock)

    def run(self) -> None:
        began_ns, k = time.monotonic_ns(), 0
        step_ns = PERIOD_NS // len(self._turns) if self._turns else 0
        while not self._over:
            wait_s = LONGEST_WAIT_S
            if self._turns:
                wait_s = max(0.0, (began_ns + k * step_ns - time.monotonic_ns()) / 1e9)
            for file, _ in self._poll.poll(wait_s):
                self._calls[file]()
            if self._turns and time.monotonic_ns() >= began_ns + k * step_ns:
                self._turns[k % len(self._turns)]()
                k += 1

    def _end(self, *_: object) -> None:
        self._over = True


def play_objects(run_file: str) -> dict[str, object]:
    run = load_run(run_file)
    datum = Datum(Place(57.7, 12.7, 200.0))
    objects = {spec.id: Played(spec, datum) for spec in run.targets}
    loop = Loop([one.report for one in objects.values()])

    def accept(one: Played) -> None:
        tcp = one.on_listener()
        loop.add(tcp, lambda: one.on_tcp() or loop.remove(tcp))

    for one in objects.values():
        loop.add(one.listener, lambda one=one: accept(one))  # type: ignore[misc]
        loop.add(one.udp, one.on_udp)
    tell({key: one.listener.getsockname()[1] for key, one in objects.items()})
    loop.run()
    return {key: [one.heartbeats, one.sent] for key, one in objects.items()}


def echo(count: int) -> dict[str, object]:
    socks = [udp(0) for _ in range(count)]
    loop = Loop([])

    def answer(sock: socket.socket) -> None:
        sock.sendto(*sock.recvfrom(2048))

    for sock in socks:
        loop.add(sock, lambda sock=sock: answer(sock))  # type: ignore[misc]
    tell([sock.getsockname()[1] for sock in socks])
    loop.run()
    return {}


def ask(ports: list[int]) -> dict[str, object]:
    """Round trips, ns; nothing waits for an answer."""
    trips: list[int] = []

    def answered(sock: socket.socket) -> None:
        sent_ns = int.from_bytes(sock.recv(2048)[:8], "little")
        trips.append(time.monotonic_ns() - sent_ns)

    def send(sock: socket.socket, port: int) -> None:
        sock.sendto(time.monotonic_ns().to_bytes(MONR_BYTES, "little"), ("127.0.0.1", port))

    socks = [(udp(0), port) for port in ports]
    loop = Loop([lambda s=s, p=p: send(s, p) for s, p in socks])  # type: ignore[misc]
    for sock, _ in socks:
        loop.add(sock, lambda sock=sock: answered(sock))  # type: ignore[misc]
    tell([])
    loop.run()
    return {"trips_ns": trips}


def tell(found: object) -> None:
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    if role == "objects":
        tell(play_objects(rest[0]))
    elif role == "echo":
        tell(echo(int(rest[0])))
    else:
        tell(ask([int(port) for port in rest]))
