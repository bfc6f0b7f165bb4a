"""``python -P -m ssp_ot_controller.rehearsal FOLDER``: a live session without its hardware.

It plays what a session connects to: the VUT's GNSS/INS, the camera driver and the bodies of the
objects, in the ROS domain of the environment, so that a track's network, clocks and limits can be
rehearsed with `ssp run --mode live` before a vehicle moves.
"""

from __future__ import annotations

import shlex
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

import ssp_core
from ssp_core.console import report_error
from ssp_core.errors import InputError, SspError
from ssp_core.host.environment import live_environment
from ssp_core.host.processes import ProcessGroup
from ssp_core.host.terminal import catch_stop_signals, own_command, survive_lost_output
from ssp_core.options import Number, WholeNumber
from ssp_core.run_file.model import load_run
from ssp_ot_controller.rehearsal.iso_server import PlayedIsoObjects
from ssp_ot_controller.rehearsal.played import PlayedBodies

PARTS = ("vut", "camera", "bodies", "iso")
RUN_FILE = "run.yaml"
FIRST_PORT = 9001
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_hosts.xml"


@click.command()
@click.argument("what", metavar="FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--play",
    "parts",
    type=click.Choice(PARTS),
    multiple=True,
    help="May be repeated; iso: the objects as ISO 22133 objects, not as bodies. [all but iso]",
)
@click.option(
    "--odometry", default="/ins/odometry", show_default=True, help="Topic of the VUT's GNSS/INS."
)
@click.option("--navsat", metavar="TOPIC", help="NavSatFix of the GNSS/INS, instead of odometry.")
@click.option("--heading", metavar="TOPIC", help="Its Imu, with --navsat.")
@click.option("--velocity", metavar="TOPIC", help="Its TwistStamped, with --navsat.")
@click.option(
    "--fix-type",
    type=WholeNumber(-1, 2),
    default=2,
    show_default=True,
    help="Fix type of the positions: -1 none, 0 fix, 1 SBAS, 2 GBAS.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(0, low_open=True),
    default=100.0,
    show_default=True,
    help="Rate of the GNSS/INS, Hz.",
)
@click.option("--frame", default="map", show_default=True, help="Frame of the odometry.")
@click.option(
    "--clock-offset",
    "clock_offset_s",
    type=Number(),
    default=0.0,
    show_default=True,
    help="Offset of the VUT's clock, s, as of one that isn't synchronised.",
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address that the bodies listen at."
)
@click.option(
    "--first-port",
    type=WholeNumber(0, 65535),
    default=FIRST_PORT,
    show_default=True,
    help="Port of the first body; the others follow (an ISO object has two, UDP below). 0: "
    "any free ones.",
)
@click.option("--log", type=click.Path(path_type=Path), help="CSV of the bodies' true states.")
@click.option(
    "--remap", "remappings", multiple=True, metavar="FROM:=TO", help="Remap an SSP topic."
)
def main(
    what: Path,
    parts: tuple[str, ...],
    odometry: str,
    navsat: str | None,
    heading: str | None,
    velocity: str | None,
    fix_type: int,
    rate_hz: float,
    frame: str,
    clock_offset_s: float,
    host: str,
    first_port: int,
    log: Path | None,
    remappings: tuple[str, ...],
) -> int:
    """Play the hardware of a live session until it is interrupted.

    FOLDER is what `ssp compile --target track` or `ssp run --mode live` wrote, or a run.yaml.
    Start it first: it says how `ssp run --mode live`, in another terminal, reaches what it plays.
    """
    gnss = {"navsat": navsat, "heading": heading, "velocity": velocity}
    if (navsat is None) != (heading is None) or (velocity is not None and navsat is None):
        raise click.UsageError("--navsat and --heading go together, and --velocity with them")
    try:
        run_file = what / RUN_FILE if what.is_dir() else what
        run = load_run(run_file)
        if run.domain != "physical":
            raise InputError(
                "is no run on a proving ground: it can't be live",
                file=run_file,
                field="domain",
                value=run.domain,
                remedy="name a folder of `ssp compile --target track`, or of a live session",
            )
        whole = not parts
        without = {"iso"} if run.camera is not None else {"iso", "camera"}
        parts = parts or tuple(part for part in PARTS if part not in without)
        if {"iso", "bodies"} <= set(parts):
            raise click.BadParameter("takes bodies or iso, not both", param_hint="--play")
        vut = {"odometry": odometry, "rate_hz": rate_hz, "frame": frame, "fix_type": fix_type}
        vut |= {name: topic for name, topic in gnss.items() if topic is not None}
        nodes: dict[str, dict[str, object]] = {
            "vut": {**vut, "clock_offset_s": clock_offset_s},
            "camera": {},
            "bodies": {},
        }
        played = {"bodies" if part == "iso" else part for part in parts}
        with tempfile.TemporaryDirectory(prefix="ssp-rehearsal-") as logs:
            environment = live_environment(PROFILE)
            with ProcessGroup(environment, Path(logs), owns_domain=False) as group:
                for name, parameters in nodes.items():
                    if name in played:
                        module, arguments = f"played_{name}", {"run_file": run_file, **parameters}
                        group.start_node(
                            module, f"ssp_ot_controller.ros.{module}", arguments, remappings
                        )
                where = gnss if navsat is not None else {"odometry": odometry}
                options = [
                    f"--{name} {shlex.quote(topic)}" for name, topic in where.items() if topic
                ]
                run_options = options if "vut" in parts else []
                run_options += [f"--remap {shlex.quote(rule)}" for rule in remappings]
                kind = PlayedIsoObjects if "iso" in parts else PlayedBodies
                opened = {"bodies", "iso"} & set(parts)
                bodies = partial(kind, run, host, first_port, log) if opened else None
                return _play(group, bodies, run_options, what if whole else None)
    except SspError as error:
        report_error(str(error))
        return 1


def _play(
    group: ProcessGroup,
    open_bodies: Callable[[], PlayedBodies | PlayedIsoObjects] | None,
    run_options: list[str],
    what: Path | None,
) -> int:
    """Play until something ends.

    Args:
        group: processes of the parts.
        open_bodies: listens for the objects; None: they aren't played.
        run_options: options of `ssp run` that reach the rest.
        what: folder of the run where all of it is played: the whole command is said; None: not.
    """
    stop = threading.Event()
    catch_stop_signals(lambda _: stop.set())

    def over() -> bool:
        return stop.is_set() or bool(group.ended())

    def tell(options: list[str]) -> None:
        for option in options:
            click.echo(option)
        if what is not None and what.is_dir():
            click.echo("to begin the session, in another terminal with the same environment:")
            where = shlex.quote(str(what))
            option_text = " ".join(options)
            click.echo(f"  {own_command()} run {where} --mode live --wait --page {option_text}")
        click.echo("playing; Ctrl-C ends it")

    if open_bodies is None:
        tell(run_options)
        while not over():
            stop.wait(0.05)
    else:
        with open_bodies() as bodies:
            tell([*run_options, *(f"--body {i}={where}" for i, where in bodies.addresses.items())])
            bodies.serve(over)
    for node in group.ended():
        report_error(f"{node.name} {node.describe_exit()}\n{node.log_tail()}")
    return 0 if stop.is_set() else 1


def run() -> None:
    """Run the command: exit with 0 after an interrupt, 1 when a part ended, 2 for wrong usage."""
    raise SystemExit(_status())


def _status() -> int:
    survive_lost_output()
    try:
        return int(main(standalone_mode=False) or 0)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except click.Abort:
        return 0


if __name__ == "__main__":
    run()
