"""``ssp doctor``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click
from rich.markup import escape
from rich.table import Table

from ssp_core import console
from ssp_core.carla.address import parse_address
from ssp_core.errors import InputError
from ssp_core.host.environment import require_sound
from ssp_core.options import Number
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.cli.carla import map_sha256
from ssp_scenario_manager.doctor.checks import (
    Finding,
    LinkMeasurement,
    Status,
    all_checks,
    carla_server,
)
from ssp_scenario_manager.doctor.session import failed, session_findings

_STYLE = {Status.OK: "green", Status.WARN: "yellow", Status.FAIL: "bold red"}
_STEPS = 100


@click.command()
@click.option(
    "--session",
    "run_file",
    type=click.Path(path_type=Path),
    help="Listen to what is connected to the live session of this run file instead.",
)
@click.option(
    "--seconds",
    type=Number(1.0, 600.0),
    default=5.0,
    show_default=True,
    help="How long to listen, with --session.",
)
@click.option("--odometry", metavar="TOPIC", help="With --session: also judge the VUT's GNSS/INS.")
@click.option(
    "--navsat", metavar="TOPIC", help="With --session: the same, if it publishes positions."
)
@click.option(
    "--remap",
    "remappings",
    multiple=True,
    metavar="FROM:=TO",
    help="With --session: as given to `ssp run`; may be repeated.",
)
@click.option(
    "--carla",
    "carla_text",
    metavar="HOST[:PORT]",
    help="Show instead whether a CARLA server would be accepted for a run.",
)
@click.option(
    "--map",
    "map_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With --carla: OpenDRIVE file that the server's map must be.  [default: any]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(
    run_file: Path | None,
    seconds: float,
    odometry: str | None,
    navsat: str | None,
    remappings: tuple[str, ...],
    carla_text: str | None,
    map_file: Path | None,
    as_json: bool,
) -> int:
    """Show what is installed, what is missing, and whether two processes can talk over DDS.

    With --session it listens, in the ROS domain and with the DDS profile of the environment, to the
    session of a run file: rates, stamps, frames, clock offsets and link delays of what is
    connected, and what prevents it from arming. It sends nothing. With --carla it asks a CARLA
    server and changes nothing there.

    Exit status 1 when something that a session needs is missing.
    """
    if carla_text is not None and run_file is not None:
        raise click.UsageError("--carla and --session ask different things: give one of them")
    if map_file is not None and carla_text is None:
        raise click.UsageError("--map goes with --carla")
    if carla_text is not None:
        findings = [_ask_carla(carla_text, map_file)]
    elif run_file is None:
        if odometry is not None or navsat is not None or remappings:
            raise click.UsageError("--odometry, --navsat and --remap go with --session")
        findings = all_checks(_measure_link)
    else:
        findings = _listen(run_file, seconds, odometry, remappings, navsat)
    bad = failed(findings)
    if as_json:
        click.echo(
            json.dumps(
                {
                    "ok": not bad,
                    "findings": [{**asdict(f), "status": f.status.value} for f in findings],
                }
            )
        )
        return 1 if bad else 0
    if carla_text is not None:
        _print_line(findings[0])
        return 1 if bad else 0
    _print_table(findings)
    console.out.print("something that a session needs is missing" if bad else "ready")
    return 1 if bad else 0


def _ask_carla(text: str, map_file: Path | None) -> Finding:
    address = parse_address(text, "--carla")
    return carla_server(address, None if map_file is None else map_sha256(map_file))


def _measure_link() -> LinkMeasurement:
    from ssp_scenario_manager.ros.link_probe import measure_link

    return measure_link()


def _listen(
    run_file: Path,
    seconds: float,
    odometry: str | None,
    remappings: Sequence[str],
    navsat: str | None,
) -> list[Finding]:
    spec = load_run(run_file)
    if spec.mode != "live":
        raise InputError(
            "is no live session's",
            file=run_file,
            field="mode",
            value=spec.mode,
            remedy="give the run file of a session without a simulated world (mode: live)",
        )
    require_sound(os.environ, asks_servers=True)
    from ssp_scenario_manager.ros.session_listener import listen

    with console.progress("listening", _STEPS) as bar:
        observations = listen(
            spec,
            seconds,
            lambda share: bar.update(bar.task_ids[0], completed=share * _STEPS),
            odometry,
            remappings,
            navsat,
        )
        bar.update(bar.task_ids[0], completed=_STEPS)
    return session_findings(spec, observations)


def _print_line(finding: Finding) -> None:
    style, remedy = _STYLE[finding.status], f"; {finding.remedy}" if finding.remedy else ""
    console.out.print(f"[{style}]{finding.status.value}[/] ", end="")
    console.out.print(f"{finding.name}: {finding.text}{remedy}", markup=False)


def _print_table(findings: Sequence[Finding]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in ("", "what", "found", "what to do"):
        table.add_column(column)
    for finding in findings:
        style = _STYLE[finding.status]
        table.add_row(
            f"[{style}]{finding.status.value}[/]",
            *(escape(text) for text in (finding.name, finding.text, finding.remedy)),
        )
    console.out.print(table)
