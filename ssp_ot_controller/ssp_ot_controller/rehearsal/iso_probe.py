"""``ssp iso probe``: measurement of how far a test object keeps to ISO 22133."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any, get_args

import click
from pydantic import BeforeValidator, ConfigDict
from rich.markup import escape
from rich.table import Table

from ssp_core import console
from ssp_core.addresses import host_and_port
from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Point, outline_problem
from ssp_core.motion.state import Size
from ssp_core.options import Number
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import Motion
from ssp_core.run_file.values import Outline, SiteDatum, Strict
from ssp_core.vocabulary import ObjectClass, ObjectWord
from ssp_ot_controller.bodies.iso22133.framing import TCP_PORT, RejectedBytes
from ssp_ot_controller.bodies.iso22133.link import Link
from ssp_ot_controller.bodies.iso22133.probe.fenced_way import FencedWay, motion_of
from ssp_ot_controller.bodies.iso22133.probe.stages import Probe, report_of
from ssp_ot_controller.bodies.iso22133.probe_report import (
    ObjectKind,
    Outcome,
    ProbeReport,
    Row,
    Stage,
    write_report,
)
from ssp_ot_controller.bodies.iso22133.trajectories import points_of, read_trajectory

_STYLE = {Outcome.PASS: "green", Outcome.FAIL: "bold red", Outcome.INFO: "cyan"}
_CORNERS = 4


def _points(value: Any) -> Any:
    """Return the points of a fence: a run file's fence has nothing else, a site file's names them.

    A fence that is a strip of a road has none, and is refused.
    """
    if not isinstance(value, dict):
        return value
    if "points" not in value:
        raise ValueError("is a strip of a block: name the run file of a task that was compiled")
    return value["points"]


class _Place(Strict):
    """The part of a site file or a run file that a probe needs."""

    geofence: Annotated[Outline, BeforeValidator(_points)]
    datum: SiteDatum | None = None

    model_config = ConfigDict(extra="ignore", frozen=True)


def parse_address(text: str) -> tuple[str, int]:
    """Return the host and TCP port of ``HOST[:PORT]``.

    Raises:
        InputError: it is none.
    """
    host, port = host_and_port(text) or ("", None)
    port = TCP_PORT if port is None else port
    if not host or not 1 < port < 65_536:
        raise InputError(
            "is no address",
            field="HOST[:PORT]",
            value=text,
            remedy="write a name or an address, [..] around one of IPv6, and a port from 2 on",
        )
    return host, port


def parse_numbers(text: str, count: int, field: str, remedy: str) -> list[float]:
    """Parse numbers with commas between them; raise InputError for anything else."""
    try:
        numbers = [decimal(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) < 1e9 for number in numbers):
        raise InputError(f"needs {count} numbers", field=field, value=text, remedy=remedy)
    return numbers


def load_fence(text: str) -> tuple[tuple[Point, ...], Datum | None]:
    """Return the fence of four corners or of a file, and the datum of a file that has one.

    Raises:
        InputError: neither.
    """
    corners = text.split()
    if "," not in text or Path(text).suffix in (".yaml", ".yml", ".json"):
        place = load_model(_Place, text)
        return tuple(place.geofence), None if place.datum is None else place.datum.datum
    if len(corners) != _CORNERS:
        raise InputError(
            f"has {len(corners)} corners",
            field="--fence",
            value=text,
            remedy="write four as 'X,Y X,Y X,Y X,Y' in m, or name a site file or a run file",
        )
    pairs = [parse_numbers(corner, 2, "--fence", "write a corner as X,Y") for corner in corners]
    fence = tuple((x, y) for x, y in pairs)
    problem = outline_problem(fence)
    if problem is not None:
        raise InputError(problem[0], field="--fence", value=text, remedy=problem[1])
    return fence, None


def load_motion(path: Path, datum: Datum) -> Motion:
    """Load way and speed of a trajectory file, in the datum's frame; raise InputError for none."""
    points = points_of(read_trajectory(path), datum)
    motion = points if isinstance(points, RejectedBytes) else motion_of(points)
    if not isinstance(motion, Motion):
        problem = "leads nowhere" if motion is None else motion.text
        raise InputError(problem, file=path, remedy="give a way and a speed")
    return motion


@click.command("probe")
@click.argument("host", metavar="HOST[:PORT]")
@click.option(
    "--stage",
    "stages",
    type=click.Choice([stage.value for stage in Stage]),
    multiple=True,
    help="How far to go; each stage needs those before it.  [default: connect]",
)
@click.option("--may-move", is_flag=True, help="The object may move: needed for the stage move.")
@click.option(
    "--trajectory",
    type=click.Path(path_type=Path),
    help="CSV with the path and highest speed for the stage move: t_s,x_m,y_m,yaw_rad,speed_mps. "
    "[default: 20 m straight on at 3 m/s]",
)
@click.option(
    "--fence",
    metavar="FILE|CORNERS",
    help="A site or run file, or four corners 'X,Y X,Y X,Y X,Y' in m: no stop may end outside.",
)
@click.option(
    "--origin",
    metavar="LAT,LON[,ALT]",
    help="Origin of the coordinates, degrees and m.  [default: the fence file's datum, or 0,0]",
)
@click.option(
    "--size",
    default="2.5,2.5,2",
    show_default=True,
    metavar="FRONT,REAR,WIDTH",
    help="Extent of the object around its reference point, m.",
)
@click.option(
    "--class",
    "object_class",
    type=click.Choice(get_args(ObjectWord)),
    default="car",
    show_default=True,
    help="Class of the object in the run: sets how far its direction of motion may be off its yaw.",
)
@click.option(
    "--omnidirectional",
    is_flag=True,
    help="It may move in any direction, whatever its yaw: for objects that the site names in "
    "limits.omnidirectional.",
)
@click.option(
    "--heartbeat-timeout",
    "heartbeat_s",
    type=Number(0.05, 5.0),
    default=Limits.model_fields["heartbeat_s"].default,
    show_default=True,
    help="Heartbeat timeout of the OSEM, s; a session gives that of its site.",
)
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the report.")
def probe_command(
    host: str,
    stages: tuple[str, ...],
    may_move: bool,
    trajectory: Path | None,
    fence: str | None,
    origin: str | None,
    size: str,
    object_class: str,
    omnidirectional: bool,
    heartbeat_s: float,
    json_file: Path | None,
) -> int:
    """Test whether an object does what ISO 22133 promises.

    Stages: listen (to its reports), connect (and be answered), arm (disarm, abort, clear, lose
    heartbeats, all at a standstill), move (start at a time, stop, abort, lose heartbeats). Before
    the stage move, stand by with independent means to stop the object: this is where one that
    doesn't obey shows.

    Exit status 1 if a clause fails or wasn't reached.
    """
    name, port = parse_address(host)
    stages_to_run = _up_to(stages)
    if Stage.MOVE in stages_to_run and not (may_move and fence):
        raise click.UsageError("--stage move needs --may-move and --fence")
    outline, datum = load_fence(fence) if fence is not None else ((), None)
    if origin is not None:
        remedy = "write LAT,LON or LAT,LON,ALT"
        numbers = parse_numbers(origin, 3 if origin.count(",") > 1 else 2, "--origin", remedy)
        place = Place(*numbers)
        if place.problem is not None:
            raise InputError(place.problem, field="--origin", value=origin, remedy=remedy)
        datum = Datum(place)
    if datum is None and Stage.MOVE in stages_to_run:
        raise click.UsageError("--stage move needs --origin, or a fence file with a datum")
    datum = datum or Datum(Place(0.0, 0.0))
    front_m, rear_m, width_m = parse_numbers(size, 3, "--size", "write FRONT,REAR,WIDTH in m")
    motion = None if trajectory is None else load_motion(trajectory, datum)
    way = FencedWay(outline, Size(front_m, rear_m, width_m, 1.5), motion) if outline else None
    probe = Probe(
        lambda tap: Link(name, port, tap),
        datum,
        way,
        heartbeat_s,
        console.note,
        kind=ObjectKind(ObjectClass.from_word(object_class), omnidirectional),
    )
    started_ns = time.time_ns()
    try:
        probe.run(stages_to_run)
    finally:
        # Also what was found before somebody interrupted it.
        report = report_of(probe, name, port, started_ns, stages_to_run)
        show(report)
        if json_file is not None:
            write_report(json_file, report)
    return (
        1
        if any(row.verdict in (Outcome.FAIL, Outcome.NOT_RUN) for row in requested_rows(report))
        else 0
    )


def _up_to(stages: tuple[str, ...]) -> tuple[Stage, ...]:
    every = list(Stage)
    last = max((every.index(Stage(stage)) for stage in stages), default=1)
    return tuple(every[: last + 1])


def requested_rows(report: ProbeReport) -> list[Row]:
    """Return the rows of the stages that were asked for."""
    return [row for row in report.rows if row.stage in report.stages]


def show(report: ProbeReport) -> None:
    """Print the table for people, on standard output."""
    firmware = report.firmware or "unknown"
    title = f"{report.host}:{report.port}, firmware {firmware}, wire version {report.wire_version}"
    table = Table(title=escape(title), title_justify="left")
    for column in ("clause", "verdict", "measured", "bound", "found"):
        table.add_column(column, overflow="fold")
    for row in requested_rows(report):
        style = _STYLE.get(row.verdict, "yellow")
        table.add_row(
            f"{row.clause}\n[dim]{escape(row.title)}[/]",
            f"[{style}]{row.verdict.value}[/]",
            "" if row.measured is None else f"{row.measured:.4g} {row.unit}",
            "" if row.bound is None else f"{row.bound:g} {row.unit}",
            escape(console.visible(row.text)),
        )
    console.out.print(table)
