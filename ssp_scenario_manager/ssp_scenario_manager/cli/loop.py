"""``ssp loop``: a campaign of driven runs."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from ssp_core import console
from ssp_core.files import make_folder, taken_folder
from ssp_core.options import WholeNumber
from ssp_scenario_manager.closed_loop.campaign import run_campaign
from ssp_scenario_manager.closed_loop.plan_file import load_plan
from ssp_scenario_manager.closed_loop.rates import Rates
from ssp_scenario_manager.closed_loop.tables import TABLE_FILE


@click.command()
@click.argument("plan_file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder of the campaign; one that was interrupted goes on where it stopped.",
)
@click.option("--jobs", type=WholeNumber(1), default=1, help="Processes that share the runs.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def loop(plan_file: Path, out: Path, jobs: int, as_json: bool) -> int:
    """Run the campaign of PLAN_FILE: events × drivers × latencies × starts × repeats.

    It leaves starts.json (sealed before a driver runs), runs.csv (a row per run) and table.csv (a
    row per event, driver and latency). Exit status 1 where a baseline that must have a headline of
    0 has another one.
    """
    plan = load_plan(plan_file)
    make_folder(out)
    with taken_folder(out), console.progress("runs", None) as bar:

        def count(total: int) -> None:
            bar.update(bar.task_ids[0], total=total, advance=1)

        rates, refused = run_campaign(plan, out, jobs, count, console.note)
    if as_json:
        click.echo(json.dumps([asdict(one) for one in rates]))
    else:
        for one in rates:
            console.out.print(_line(one), markup=False)
        console.out.print(f"{out / TABLE_FILE}", markup=False)
    for text in refused:
        console.report_error(f"the campaign is refused: {text}")
    return 1 if refused else 0


def _line(one: Rates) -> str:
    place = f"{one.event:18} {one.driver:18} L {one.latency_s:<5g} "
    if one.headline is None or one.low is None or one.high is None:
        return place + f"no rate, {one.planned - one.driven} of {one.planned} failed on our side"
    return place + f"{one.headline:.2f} [{one.low:.2f}, {one.high:.2f}] of {one.driven}"
