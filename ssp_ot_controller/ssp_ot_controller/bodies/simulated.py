"""The body's end of the body protocol: a simulated plant, and the command that serves it."""

from __future__ import annotations

import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import click

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Pose2
from ssp_core.options import Number, WholeNumber
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.dynamics import BodyState, Command, step_body
from ssp_ot_controller.bodies.protocol import (
    COMMAND_BYTES,
    Envelope,
    Order,
    Reason,
    decode_command,
    encode_state,
)

# However long a command says that it holds: nothing heard for this long, and the body brakes.
WATCHDOG_S = 0.2
# The loop looks at the plant this often at least.
_TICK_S = 0.002
# The plant is stepped this finely.
_PLANT_STEP_S = 0.005


class BodyServer:
    """One body: follows the newest command, and brakes by itself when it hears none.

    It follows one commander. Another address is not listened to until the first has been silent
    for as long as the watchdog waits and the body stands.
    """

    def __init__(
        self,
        object_id: str,
        object_class: ObjectClass,
        pose: Pose2,
        now_ns: int,
        rate_hz: float = 100.0,
    ) -> None:
        self.rejected: Counter[Reason] = Counter()
        self.strangers = 0
        self.commander: Any = None
        self.body = BodyState.at_rest(pose)
        self.object_id = object_id
        self._class = object_class
        self._boot_ns = now_ns
        self._now_ns = self._seen_ns = now_ns
        self._period_ns = round(NS_PER_S / rate_hz)
        self._next_state_ns = now_ns
        self._sequence = 0
        self._order = Order()
        self._command = Command(0.0, 0.0, self.body.yaw_rad, emergency_stop=True)
        self._brakes_at_ns = now_ns

    @property
    def brakes_by_itself(self) -> bool:
        """The last command is too old."""
        return self._now_ns >= self._brakes_at_ns

    @property
    def silent_s(self) -> float:
        """Return for how long the last command has been too old, 0 while it holds."""
        return max(0.0, ns_to_seconds(self._now_ns - self._brakes_at_ns))

    def place(self, pose: Pose2) -> None:
        """Put the body somewhere, at rest, as a person does who moves it by hand."""
        self.body = BodyState.at_rest(pose)
        self._command = Command(0.0, 0.0, self.body.yaw_rad, emergency_stop=True)

    def on_datagram(self, data: bytes, address: Any, now_ns: int) -> None:
        """Take a datagram of any sender, at the time at which it came."""
        self.advance(now_ns)
        datagram = decode_command(data, self.object_id)
        if isinstance(datagram, Reason):
            self.rejected[datagram] += 1
            return
        stands = self.brakes_by_itself and self.body.speed_mps == 0.0
        if address != self.commander:
            if not (self.commander is None or stands):
                self.strangers += 1
                return
            self.commander, self._order = address, Order()
        if not self._order.is_new(datagram.envelope, now_ns, may_restart=stands):
            self.rejected[Reason.ORDER] += 1
            return
        holds_s = min(datagram.timeout_ms / 1000.0, WATCHDOG_S)
        self._command = datagram.command
        self._brakes_at_ns = now_ns + seconds_to_ns(holds_s)

    def advance(self, now_ns: int) -> None:
        """Move the body up to a time.

        Its own goes on where the clock was set back. One that stands and hears no command stays so,
        however far the clock was set ahead.
        """
        back_ns = max(0, self._seen_ns - now_ns)
        self._seen_ns = now_ns
        self._now_ns -= back_ns
        self._next_state_ns -= back_ns
        self._brakes_at_ns -= back_ns
        step_ns = seconds_to_ns(_PLANT_STEP_S)
        while self._now_ns + step_ns <= now_ns:
            command = self._command
            if self.brakes_by_itself:
                if self.body.speed_mps == 0.0:
                    self._now_ns += (now_ns - self._now_ns) // step_ns * step_ns
                    break
                # Steering stays as it is: that is where the object was led last.
                command = Command(
                    0.0, self.body.curvature_1pm, self.body.yaw_rad, emergency_stop=True
                )
            self.body = step_body(self._class, self.body, command, ns_to_seconds(step_ns))
            self._now_ns += step_ns

    def state_due(self, now_ns: int) -> bytes | None:
        """Return the datagram that is due by now, None while none is, or none was asked for."""
        self.advance(now_ns)
        if self.commander is None or now_ns < self._next_state_ns:
            return None
        self._next_state_ns = max(self._next_state_ns + self._period_ns, now_ns)
        self._sequence += 1
        b = self.body
        reading = BodyReading(
            self._now_ns,
            b.x_m,
            b.y_m,
            b.yaw_rad,
            b.speed_mps,
            b.acceleration_mps2,
            b.yaw_rate_radps,
            0.02,
            self.brakes_by_itself,
        )
        envelope = Envelope(self.object_id, self._boot_ns, self._sequence, self._now_ns)
        return encode_state(envelope, reading)


_CLASSES = [c.word for c in ObjectClass if c is not ObjectClass.UNKNOWN]


def serve(
    bodies: Sequence[tuple[BodyServer, socket.socket]],
    until: Callable[[], bool],
    sent: Callable[[BodyServer], None] = lambda _body: None,
) -> None:
    """Follow commands and send states until ended; ``sent`` gets the body after each state."""
    sockets = [sock for _, sock in bodies]
    while not until():
        readable, _, _ = select.select(sockets, [], [], _TICK_S)
        for body, sock in bodies:
            if sock in readable:
                data, address = sock.recvfrom(COMMAND_BYTES + 1)
                body.on_datagram(data, address, time.time_ns())
            state = body.state_due(time.time_ns())
            if state is not None:
                # A commander that can't be reached: lost, like a datagram on the way.
                with suppress(OSError):
                    sock.sendto(state, body.commander)
                sent(body)


@click.command()
@click.option("--object", "object_id", required=True, help="Id of the object, as in the run file.")
@click.option("--class", "object_class", type=click.Choice(_CLASSES), default="car")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option(
    "--port", type=WholeNumber(0, 65535), default=0, show_default=True, help="0: any free one."
)
@click.option("--x", "x_m", type=Number(), default=0.0, help="Start, m east in frame map.")
@click.option("--y", "y_m", type=Number(), default=0.0, help="Start, m north in frame map.")
@click.option(
    "--yaw",
    "yaw_rad",
    default=0.0,
    type=Number(-6.2832, 6.2832),
    help="Heading, rad counter-clockwise from east.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(0, low_open=True),
    default=100.0,
    show_default=True,
    help="States per second.",
)
def main(
    object_id: str,
    object_class: str,
    host: str,
    port: int,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    rate_hz: float,
) -> None:
    """Play the body of one object: follow commands, send states, brake when it hears none."""
    cls = ObjectClass.from_word(object_class)
    server = BodyServer(object_id, cls, Pose2(x_m, y_m, yaw_rad), time.time_ns(), rate_hz)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((host, port))
        except OSError as error:
            raise click.ClickException(f"can't listen at {host}:{port}: {error}") from None
        sock.setblocking(False)
        click.echo(f"{object_id} listens at udp://{host}:{sock.getsockname()[1]}")
        with suppress(KeyboardInterrupt):
            serve([(server, sock)], lambda: False)


if __name__ == "__main__":
    main()
