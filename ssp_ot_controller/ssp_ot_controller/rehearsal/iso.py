"""``ssp iso``: objects that speak ISO 22133."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import click

from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_core.run_file.model import Limits, load_run
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.terminal import catch_stop_signals
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.iso22133.framing import TCP_PORT
from ssp_ot_controller.bodies.iso22133.messages import Traj
from ssp_ot_controller.bodies.iso22133.trajectories import read_trajectory
from ssp_ot_controller.objects.rules import ObjectRules
from ssp_ot_controller.rehearsal.iso_faults import KINDS, FaultyObject, IsoFault
from ssp_ot_controller.rehearsal.iso_object import STEP_S, IsoObject
from ssp_ot_controller.rehearsal.iso_probe import probe_command
from ssp_ot_controller.rehearsal.iso_server import IsoServer, object_of_run, serve
from ssp_ot_controller.rehearsal.played import StateLog

RUN_FILE = "run.yaml"
# Without a run it stays within so far of where it starts, in x and in y.
RANGE_M = 500.0
LIMITS = Limits(speed_mps=20.0, acceleration_mps2=4.0, duration_s=600.0)
_CLASSES = [c.word for c in ObjectClass if c is not ObjectClass.UNKNOWN]


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
    help="Of `ssp compile --target track` or a live session: start, limits, fence and datum. "
    "[default: a fence of 1 km around the start]",
)
@click.option("--object", "object_id", metavar="ID", help="Which of the run. [default: its only]")
@click.option(
    "--class",
    "object_class",
    type=click.Choice(_CLASSES),
    default=None,
    help="What it is, without --run. [default: car]",
)
@click.option(
    "--start",
    type=(float, float, float),
    metavar="X Y YAW",
    default=None,
    help="Where it stands, m and rad, without --run. [default: its trajectory's first point, or 0]",
)
@click.option(
    "--trajectory",
    "trajectory_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="CSV of one that it holds from the beginning: t_s,x_m,y_m,yaw_rad,speed_mps.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address that it listens at.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=TCP_PORT,
    show_default=True,
    help="Of TCP, UDP is the one below; 0: any that are free.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="KIND[=VALUE][@AT_S[+FOR_S]]",
    help=f"What is wrong with it, since its first start; may be repeated: {', '.join(KINDS)}.",
)
@click.option("--log", type=click.Path(path_type=Path), help="CSV of its true states.")
def object_(
    run_path: Path | None,
    object_id: str | None,
    object_class: str | None,
    start: tuple[float, float, float] | None,
    trajectory_file: Path | None,
    host: str,
    port: int,
    faults: tuple[str, ...],
    log: Path | None,
) -> int:
    """Play an object target for any control centre that speaks ISO 22133.

    It has the simulated body, the limits and the checks of our object targets, and listens until
    it is interrupted. Whatever drives it may be ours or another vendor's; there is one at a time.
    """
    if port == 1:
        raise click.BadParameter("must have a port below it", param_hint="--port")
    trajectory = None if trajectory_file is None else read_trajectory(trajectory_file)
    now_ns = time.time_ns()
    if run_path is not None:
        if object_class is not None or start is not None:
            raise click.UsageError("--class and --start are the run's where --run is given")
        played = _of_run(run_path, object_id, trajectory, now_ns)
    else:
        played = _of_options(object_id or "ot1", object_class or "car", start, trajectory, now_ns)
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


def _of_run(path: Path, object_id: str | None, trajectory: Traj | None, now_ns: int) -> IsoObject:
    run_file = path / RUN_FILE if path.is_dir() else path
    run = load_run(run_file)
    ids = [target.id for target in run.targets]
    wanted = object_id or (ids[0] if len(ids) == 1 else None)
    if wanted not in ids:
        raise InputError(
            "is no object target of this run" if wanted else "isn't given",
            file=run_file,
            field="--object",
            value=wanted,
            remedy=f"name one of {', '.join(ids)}",
        )
    return object_of_run(run, wanted, now_ns, trajectory)


def _of_options(
    object_id: str,
    object_class: str,
    start: tuple[float, float, float] | None,
    trajectory: Traj | None,
    now_ns: int,
) -> IsoObject:
    if start is None:
        first = None if trajectory is None else trajectory.points[0]
        here = (first.x_m, first.y_m, first.yaw_rad) if first is not None else (0.0, 0.0, 0.0)
        start = (here[0] or 0.0, here[1] or 0.0, here[2] or 0.0)
    x, y, yaw = start
    given = {
        "id": object_id,
        "object_class": object_class,
        "start": {"x_m": x, "y_m": y, "yaw_rad": yaw},
    }
    spec = parse_model(ParticipantSpec, given, "--object, --class, --start")
    r = RANGE_M
    fence = ((x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r))
    return IsoObject(ObjectRules(spec, LIMITS, fence, STEP_S), now_ns, trajectory=trajectory)
