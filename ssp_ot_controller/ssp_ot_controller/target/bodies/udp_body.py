"""A stand-in for a body of hardware: a simulated plant behind the body protocol.

``python -m ssp_ot_controller.target.bodies.udp_body --object ot1 --port 9001`` listens until it is
interrupted. It says on standard output where it listens.
"""

from __future__ import annotations

import select
import socket
import time

import click

from ssp_core.geometry import Pose2
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.target.bodies.body_server import BodyServer
from ssp_ot_controller.target.bodies.datagrams import COMMAND_BYTES

# The loop looks at the plant this often at least.
_TICK_S = 0.002
_CLASSES = [c.word for c in ObjectClass if c is not ObjectClass.UNKNOWN]


@click.command()
@click.option("--object", "object_id", required=True, help="Whose body, as in the run file.")
@click.option("--class", "object_class", type=click.Choice(_CLASSES), default="car")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option("--port", default=0, show_default=True, help="0: one that is free.")
@click.option("--x", "x_m", default=0.0, help="Where it stands, m, map.")
@click.option("--y", "y_m", default=0.0, help="Where it stands, m, map.")
@click.option("--yaw", "yaw_rad", default=0.0, help="Where it looks, rad from east.")
@click.option("--rate", "rate_hz", default=100.0, show_default=True, help="States per second.")
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
    """Plays the body of one object: follows commands, sends states, brakes when it hears none."""
    if not rate_hz > 0.0:
        raise click.BadParameter(f"must be positive, got {rate_hz:g}", param_hint="--rate")
    cls = ObjectClass.from_word(object_class)
    server = BodyServer(object_id, cls, Pose2(x_m, y_m, yaw_rad), time.time_ns(), rate_hz)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((host, port))
        except OSError as error:
            raise click.ClickException(f"can't listen at {host}:{port}: {error}") from None
        sock.setblocking(False)
        click.echo(f"{object_id} listens at udp://{host}:{sock.getsockname()[1]}")
        try:
            _serve(server, sock)
        except KeyboardInterrupt:
            return


def _serve(server: BodyServer, sock: socket.socket) -> None:
    while True:
        readable, _, _ = select.select([sock], [], [], _TICK_S)
        if readable:
            data, address = sock.recvfrom(COMMAND_BYTES + 1)
            server.on_datagram(data, address, time.time_ns())
        state = server.state_due(time.time_ns())
        if state is not None:
            sock.sendto(state, server.commander)


if __name__ == "__main__":
    main()
