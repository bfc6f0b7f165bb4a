"""``ssp iso``: objects that speak ISO 22133."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import click

from ssp_core.errors import InputError
from ssp_core.host.terminal import catch_stop_signals
from ssp_core.options import WholeNumber
from ssp_core.run_file.model import load_run
from ssp_ot_controller.bodies.iso22133.framing import TCP_PORT
from ssp_ot_controller.rehearsal.iso_faults import KINDS, FaultyObject, IsoFault
from ssp_ot_controller.rehearsal.iso_object import IsoObject
from ssp_ot_controller.rehearsal.iso_probe import probe_command
from ssp_ot_controller.rehearsal.iso_server import IsoServer, object_of_run, serve
from ssp_ot_controller.rehearsal.played import StateLog

RUN_FILE = "run.yaml"


@click.group()
def iso() -> None:
    """Play and probe objects that speak ISO 22133."""


iso.add_command(probe_command)


@iso.command("object")
@click.option(
    "--run",
    "run_path",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder of `ssp compile --target track` or a live session: start, limits, fence, datum.",
)
@click.option(
    "--object", "object_id", metavar="ID", help="Object of the run. [default: its only one]"
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    type=WholeNumber(0, 65535),
    default=TCP_PORT,
    show_default=True,
    help="TCP port; UDP uses the one below it. 0: any free ones.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="KIND[=VALUE][@AT_S[+FOR_S]]",
    help=f"Fault, timed from its first start; may be repeated: {', '.join(KINDS)}.",
)
@click.option("--log", type=click.Path(path_type=Path), help="CSV of its true states.")
def object_(
    run_path: Path,
    object_id: str | None,
    host: str,
    port: int,
    faults: tuple[str, ...],
    log: Path | None,
) -> int:
    """Play an object target for any control centre that speaks ISO 22133.

    It has the simulated body, the limits and the checks of our object targets, and listens until
    it is interrupted. The control centre may be ours or another vendor's, one at a time.
    """
    if port == 1:
        raise click.BadParameter("must have a port below it", param_hint="--port")
    played = _of_run(run_path, object_id, time.time_ns())
    wrong = [IsoFault.parse(text) for text in faults]
    stop = threading.Event()
    catch_stop_signals(lambda _: stop.set())
    with (
        StateLog(log) as states,
        IsoServer(FaultyObject(played, wrong) if wrong else played, host, port) as server,
    ):
        where = f"[{server.host}]" if ":" in server.host else server.host
        click.echo(f"{played.object_id} listens at iso22133://{where}:{server.port}")
        serve([server], stop.is_set, states)
    return 0


def _of_run(path: Path, object_id: str | None, now_ns: int) -> IsoObject:
    run_file = path / RUN_FILE if path.is_dir() else path
    run = load_run(run_file)
    ids = [target.id for target in run.targets]
    target_id = object_id or (ids[0] if len(ids) == 1 else None)
    if target_id not in ids:
        raise InputError(
            "is no object target of this run" if target_id else "isn't given",
            file=run_file,
            field="--object",
            value=target_id,
            remedy=f"name one of {', '.join(ids)}",
        )
    return object_of_run(run, target_id, now_ns)
