"""``ssp carla``: measurements of the functions of a CARLA server that a run relies on."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click
from rich.markup import escape
from rich.table import Table

from ssp_core import console
from ssp_core.carla.acceptance import opendrive_sha256, read_map, refusals
from ssp_core.carla.address import parse_address
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.probe import probe
from ssp_core.carla.probe_report import CarlaProbeReport, Outcome, write_report
from ssp_core.errors import PeerError

DEFAULT_FILE = "carla_probe.json"
_STYLE = {Outcome.PASS: "green", Outcome.FAIL: "bold red", Outcome.INFO: "cyan"}


@click.group()
def carla() -> None:
    """Query a CARLA server (docs/carla.md)."""


@carla.command("probe")
@click.argument("server", metavar="HOST[:PORT]")
@click.option(
    "--map",
    "map_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="OpenDRIVE file that the server's map must be.  [default: any]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=DEFAULT_FILE,
    show_default=True,
    help="File for the report.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def probe_command(server: str, map_file: Path | None, out: Path, as_json: bool) -> int:
    """Measure what a CARLA server does, and leave it as it was.

    The world must be empty but for the map's own actors. The report holds version, settings, map
    and the box of every body; whether what is placed is there in the next frame, whether a frame's
    picture is that frame's, and how a box lies in its picture; the rate, and how far two equal runs
    differ. Exit status 1 when a check fails or the server is refused.
    """
    address = parse_address(server, "HOST[:PORT]")
    map_digest = None if map_file is None else map_sha256(map_file)
    started = datetime.now(UTC)
    with CarlaServer(address) as carla_server:
        if restored := carla_server.restore_left():
            console.note(restored)
        facts = carla_server.facts()
        refused = refusals(facts, map_digest)
        if refused:
            lines = "".join(f"\n  {one.text}; {one.remedy}" for one in refused)
            raise PeerError(f"CARLA server {address} is refused:{lines}")
        report = probe(carla_server, facts, address, started, console.note)
        left = carla_server.close()
    write_report(out, report)
    if as_json:
        click.echo(report.model_dump_json(by_alias=True))
    else:
        show(report)
    for line in left:
        console.report_error(line)
    failed = any(row.outcome is Outcome.FAIL for row in report.rows)
    return 1 if failed or left else 0


def map_sha256(path: Path) -> str:
    """Return the hash of an OpenDRIVE file, with which a server's map is compared."""
    return opendrive_sha256(read_map(path))


def show(report: CarlaProbeReport) -> None:
    """Print the table for people on standard output."""
    title = f"CARLA {report.version} at {report.host}:{report.port}, {report.map_name}"
    table = Table(title=escape(title), title_justify="left")
    for column in ("check", "outcome", "measured", "bound", "found"):
        table.add_column(column, overflow="fold")
    for row in report.rows:
        table.add_row(
            row.check,
            f"[{_STYLE[row.outcome]}]{row.outcome.value}[/]",
            "" if row.measured is None else f"{row.measured:.4g} {row.unit}".strip(),
            "" if row.bound is None else f"{row.bound:g} {row.unit}".strip(),
            escape(console.visible(row.text)),
        )
    console.out.print(table)
