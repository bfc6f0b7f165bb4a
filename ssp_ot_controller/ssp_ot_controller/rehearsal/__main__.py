"""``python -m ssp_ot_controller.rehearsal RUN_FILE``: a live session without its hardware.

It plays what a session connects to: the VUT's GNSS/INS, the camera driver and the bodies of the
objects, in the ROS domain of the environment, so that a track's network, clocks and limits can be
rehearsed with `ssp run --mode live` before a vehicle moves.
"""

from __future__ import annotations

import signal
import tempfile
import time
from pathlib import Path
from types import FrameType

import click

import ssp_core
from ssp_core.console import report_error
from ssp_core.errors import InputError, SspError
from ssp_core.processes import ProcessGroup, live_environment
from ssp_core.run_spec import RunSpec, load_run
from ssp_ot_controller.rehearsal.bodies import PlayedBodies

PARTS = ("vut", "camera", "bodies")
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_hosts.xml"


@click.command()
@click.argument("run_file", type=click.Path(path_type=Path))
@click.option(
    "--play", "parts", type=click.Choice(PARTS), multiple=True, help="May be repeated. [all]"
)
@click.option(
    "--odometry", default="/ins/odometry", show_default=True, help="Topic of the VUT's GNSS/INS."
)
@click.option("--rate", "rate_hz", default=100.0, show_default=True, help="Of the odometry, Hz.")
@click.option("--frame", default="map", show_default=True, help="Of the odometry.")
@click.option(
    "--clock-offset",
    "clock_offset_s",
    default=0.0,
    show_default=True,
    help="Of the VUT's clock, s: what a clock that isn't synchronised does.",
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address that the bodies listen at."
)
@click.option(
    "--first-port", default=0, show_default=True, help="Of the first body; 0: any that are free."
)
@click.option("--log", type=click.Path(path_type=Path), help="CSV of the bodies' true states.")
@click.option("--remap", "remappings", multiple=True, metavar="FROM:=TO", help="Of our topics.")
def main(
    run_file: Path,
    parts: tuple[str, ...],
    odometry: str,
    rate_hz: float,
    frame: str,
    clock_offset_s: float,
    host: str,
    first_port: int,
    log: Path | None,
    remappings: tuple[str, ...],
) -> int:
    """Plays the hardware of the live session RUN_FILE until it is interrupted.

    On standard output it says how `ssp run --mode live` reaches what it plays.
    """
    if not rate_hz > 0.0:
        raise click.BadParameter(f"must be positive, got {rate_hz:g}", param_hint="--rate")
    try:
        run = load_run(run_file)
        if run.mode != "live":
            raise InputError(
                "is no live session's",
                file=run_file,
                field="mode",
                value=run.mode,
                remedy="`ssp run --mode live --wait` writes one into the run's folder",
            )
        parts = parts or tuple(part for part in PARTS if part != "camera" or run.camera is not None)
        vut: dict[str, object] = {
            "odometry": odometry,
            "rate_hz": rate_hz,
            "frame": frame,
            "clock_offset_s": clock_offset_s,
        }
        nodes: dict[str, dict[str, object]] = {
            "vut": {"run_file": run_file, **vut},
            "camera": {"run_file": run_file},
        }
        wanted = {name: nodes[name] for name in nodes if name in parts}
        with tempfile.TemporaryDirectory(prefix="ssp-rehearsal-") as logs:
            environment = live_environment(PROFILE)
            with ProcessGroup(environment, Path(logs), owns_domain=False) as group:
                for name, parameters in wanted.items():
                    module = f"ssp_ot_controller.rehearsal.{name}.node"
                    group.start_node(f"played_{name}", module, parameters, remappings)
                if "vut" in parts:
                    click.echo(f"--odometry {odometry}")
                return _play(run, group, (host, first_port) if "bodies" in parts else None, log)
    except SspError as error:
        report_error(str(error))
        return 1


def _play(
    run: RunSpec, group: ProcessGroup, address: tuple[str, int] | None, log: Path | None
) -> int:
    stop = _Stop()

    def over() -> bool:
        return stop.asked or bool(group.ended())

    if address is None:
        click.echo("playing")
        while not over():
            time.sleep(0.05)
    else:
        with PlayedBodies(run, *address, log) as bodies:
            for object_id, where in bodies.addresses.items():
                click.echo(f"--body {object_id}={where}")
            click.echo("playing")
            bodies.serve(over)
    for node in group.ended():
        report_error(f"{node.name} {node.describe_exit()}\n{node.log_tail()}")
    return 0 if stop.asked else 1


class _Stop:
    """Set by SIGINT or SIGTERM."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.asked = True


def run() -> None:
    """Entry point: exit status 0 after an interrupt, 1 when a part ended, 2 for wrong usage."""
    raise SystemExit(_status())


def _status() -> int:
    try:
        return int(main(standalone_mode=False) or 0)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except click.Abort:
        return 0


if __name__ == "__main__":
    run()
