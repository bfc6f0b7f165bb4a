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
from ssp_core.environment import require_sound
from ssp_core.errors import InputError
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.doctor.checks import Finding, LinkMeasurement, Status, all_checks
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
    type=click.FloatRange(1.0, 600.0),
    default=5.0,
    show_default=True,
    help="How long to listen, with --session.",
)
@click.option(
    "--odometry", metavar="TOPIC", help="With --session: the VUT's GNSS/INS, to be judged too."
)
@click.option("--navsat", metavar="TOPIC", help="With --session: the same, where it gives places.")
@click.option(
    "--remap",
    "remappings",
    multiple=True,
    metavar="FROM:=TO",
    help="With --session: as given to `ssp run`; may be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(
    run_file: Path | None,
    seconds: float,
    odometry: str | None,
    navsat: str | None,
    remappings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Say what is installed, what is missing, and whether two processes can talk over DDS.

    With --session it listens, in the ROS domain and with the DDS profile of the environment, to the
    session of a run file: rates, stamps, frames, clock offsets and link delays of what is
    connected, and what keeps it from arming. It sends nothing.

    Exit status 1 when something that a session needs is missing.
    """
    if run_file is None:
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
    _print_table(findings)
    console.out.print("something that a session needs is missing" if bad else "ready")
    return 1 if bad else 0


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
        heard = listen(
            spec,
            seconds,
            lambda share: bar.update(bar.task_ids[0], completed=share * _STEPS),
            odometry,
            remappings,
            navsat,
        )
        bar.update(bar.task_ids[0], completed=_STEPS)
    return session_findings(spec, heard)


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
