"""``ssp doctor``."""

from __future__ import annotations

import json

import click
from rich.table import Table

from ssp_core import console
from ssp_scenario_manager.doctor.checks import Status, all_checks

_STYLE = {Status.OK: "green", Status.WARN: "yellow", Status.FAIL: "bold red"}


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(as_json: bool) -> int:
    """Say what is installed, what is missing, and whether two processes can talk over DDS.

    Exit status 1 when something that a session needs is missing.
    """
    findings = all_checks()
    failed = any(f.status is Status.FAIL for f in findings)
    if as_json:
        click.echo(
            json.dumps(
                {
                    "ok": not failed,
                    "findings": [
                        {
                            "name": f.name,
                            "status": f.status.value,
                            "text": f.text,
                            "remedy": f.remedy,
                        }
                        for f in findings
                    ],
                }
            )
        )
        return 1 if failed else 0
    table = Table(box=None, pad_edge=False)
    for column in ("", "what", "found", "what to do"):
        table.add_column(column)
    for finding in findings:
        style = _STYLE[finding.status]
        table.add_row(
            f"[{style}]{finding.status.value}[/]", finding.name, finding.text, finding.remedy
        )
    console.out.print(table)
    console.out.print("something that a session needs is missing" if failed else "ready")
    return 1 if failed else 0
