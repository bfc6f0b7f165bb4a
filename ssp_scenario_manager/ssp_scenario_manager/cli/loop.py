"""``ssp loop``: a campaign of driven runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import click
from rich.progress import Progress

from ssp_core import console
from ssp_core.files.folders import taken_folder
from ssp_core.host.locks import beside_measuring, measuring_alone
from ssp_core.options import WholeNumber
from ssp_scenario_manager.closed_loop.answers import repeated
from ssp_scenario_manager.closed_loop.campaigns.again import run_of_row
from ssp_scenario_manager.closed_loop.campaigns.bags import bag_rows, write_bags
from ssp_scenario_manager.closed_loop.campaigns.campaign import run_campaign
from ssp_scenario_manager.closed_loop.campaigns.cards import CARDS_FILE, load_cards
from ssp_scenario_manager.closed_loop.campaigns.groups import (
    group_numbers,
    groups_of,
    headings_of,
)
from ssp_scenario_manager.closed_loop.campaigns.plan_file import (
    CampaignDriver,
    load_plan,
    try_drivers,
)
from ssp_scenario_manager.closed_loop.campaigns.row_bags import Bags
from ssp_scenario_manager.closed_loop.campaigns.seal import check_sources
from ssp_scenario_manager.closed_loop.outcomes.rates import Rates
from ssp_scenario_manager.closed_loop.outcomes.tables import RUNS_FILE, TABLE_FILE, rows_there
from ssp_scenario_manager.closed_loop.single_run.single import named_driver
from ssp_scenario_manager.closed_loop.single_run.top_view import summary_with_view
from ssp_scenario_manager.compile.task import run_folder
from ssp_scenario_manager.run.ordered_map import ENGINES, Engine
from ssp_scenario_manager.run.sweep import for_one_process, run_one

# Runs of a campaign that were driven again lie here, by row.
AGAIN_FOLDER = "again"


@click.command()
@click.argument("plan_file", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder of the campaign; an interrupted one is resumed. With --again, a new folder for "
    "the run.",
)
@click.option("--jobs", type=WholeNumber(1, 1024), default=1, help="Workers that share the runs.")
@click.option(
    "--engine",
    type=click.Choice(ENGINES),
    default=ENGINES[0],
    show_default=True,
    help="Where workers run: on this machine, or on the Ray cluster that RAY_ADDRESS names "
    "(without one, a local one is started). Bags are written here.",
)
@click.option(
    "--again",
    type=WholeNumber(1),
    metavar="ROW",
    help="With a campaign's folder instead of its plan: drive the run of this row of runs.csv "
    "again, and write its bag and a top view.",
)
@click.option(
    "--bags",
    type=click.Choice(["all", "failed", "none"]),
    default="all",
    show_default=True,
    help="Runs whose bags are kept in OUT/bags; failed: those without success, and all runs on "
    "the first start of each event. A finished campaign gets the bags that it lacks.",
)
@click.option(
    "--drive",
    "drive_texts",
    multiple=True,
    metavar="NAME[=JSON]",
    help="A further driver of the campaign, as with `ssp run`: also grpc://HOST:PORT, a policy "
    "written for AlpaSim (docs/drivers.md); may be repeated. Give it again to resume a "
    "campaign.",
)
@click.option(
    "--drive-insecure",
    is_flag=True,
    help="With --drive grpc://…: plain text to a host that isn't loopback.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def loop(
    plan_file: Path,
    out: Path | None,
    jobs: int,
    engine: Engine,
    again: int | None,
    bags: Bags,
    drive_texts: tuple[str, ...],
    drive_insecure: bool,
    as_json: bool,
) -> int:
    """Run the campaign of PLAN_FILE: events × drivers × latencies × starts × repeats.

    It leaves plan.json, starts.json and cards.json (sealed before a driver runs), runs.csv (a row
    per run) and table.csv (a row per event, driver and latency, with the number of the group of
    like cards); `ssp report` makes a page of them. The bags of runs lie in bags/ROW, each in a
    folder as `ssp run` leaves it. Exit status 1 if a baseline whose headline must be 0 has another
    one, or if a recorded run isn't that of its row.

    \b
    For example:
      ssp loop plan.yaml --out out/loop --jobs 2
      ssp loop plan.yaml --out out/policy --drive grpc://127.0.0.1:50051
      ssp report out/loop
      ssp loop out/loop --again 17
    """
    if drive_insecure and not drive_texts:
        raise click.UsageError("--drive-insecure is of a driver's connection: it needs --drive")
    if again is not None:
        if drive_texts:
            raise click.UsageError("--again drives a row again, with the driver that it has")
        return _again(plan_file, again, out, as_json)
    if out is None:
        raise click.UsageError("give the folder of the campaign with --out")
    driver_pairs = [named_driver(text, insecure=drive_insecure) for text in drive_texts]
    further = [CampaignDriver(driver=name, options=options) for name, options in driver_pairs]
    plan = load_plan(plan_file, further)
    # Models that are loaded, starts and bags would disturb what another command measures, too.
    alone = measuring_alone if plan.is_measured else beside_measuring
    click.get_current_context().with_resource(alone(console.note))
    try_drivers(plan)
    with taken_folder(out):
        with console.progress("runs", None, estimated=True) as bar:
            rates, refused = run_campaign(
                plan, out, jobs, _progress_counter(bar), console.note, engine, bags
            )
        # Said first: recording can fail, as on a full disk.
        _say(rates, refused, out, as_json)
        recorded = list(bag_rows(plan, rows_there(out / RUNS_FILE), bags))
        with console.progress("bags", None, estimated=True) as bar:
            wrong = write_bags(out, recorded, jobs, _progress_counter(bar))
    for text in wrong:
        console.report_error(text)
    return 1 if refused or wrong else 0


def _say(rates: Sequence[Rates], refused: Sequence[str], out: Path, as_json: bool) -> None:
    """Print the result of a campaign, the groups of drivers with like cards apart."""
    cards = load_cards(out / CARDS_FILE)
    if as_json:
        numbers = group_numbers(cards)
        rows = [
            {**asdict(one), "latency": str(one.latency), "group": numbers[one.driver]}
            for one in rates
        ]
        click.echo(json.dumps(rows))
    else:
        groups = zip(groups_of(cards), headings_of(cards), strict=True)
        for k, (group, words) in enumerate(groups, 1):
            own = [one for one in rates if one.driver in group]
            if own:
                console.out.print(f"group {k}: {words}", markup=False)
            for one in own:
                console.out.print(_line(one), markup=False)
        console.out.print(f"{out / TABLE_FILE}; ssp report {out} makes its page", markup=False)
    for text in refused:
        console.report_error(f"the campaign is refused: {text}")


def _progress_counter(bar: Progress) -> Callable[[int, int], None]:
    """Return what shows the runs that are done; those of an earlier call took no time of this."""
    begun = False

    def count(run_count: int, total: int) -> None:
        nonlocal begun
        show = bar.update if begun else bar.reset
        show(bar.task_ids[0], total=total, completed=run_count)
        begun = True

    return count


def _again(campaign: Path, row: int, out: Path | None, as_json: bool) -> int:
    """Drive one run of a campaign again."""
    check_sources(campaign)
    again = run_of_row(campaign, row)
    folder = out or campaign / AGAIN_FOLDER / str(row)
    with run_folder(folder, again.task):
        spec = for_one_process(again.run.model_copy(update={"run_id": folder.name}), camera=True)
        measures = again.asks_anew and spec.driven is not None and spec.driven.latency.measured
        if again.asks_anew:
            console.note("SSP failed in this run and kept no answers: the model is asked again")
        alone = measuring_alone if measures else beside_measuring
        with alone(console.note):
            result_fields = run_one(
                spec,
                folder,
                as_json,
                recorded=True,
                further=partial(summary_with_view, folder, again.model_answers, again.before),
                answers=repeated(again.model_answers),
            )
    return 0 if result_fields["verdict"] == "valid" else 1


def _line(one: Rates) -> str:
    place = f"{one.event:18} {one.driver:18} L {one.latency.cell_text:<8} "
    if one.headline is None or one.low is None or one.high is None:
        return place + f"no rate: SSP failed in {one.planned - one.driven} of {one.planned}"
    return place + f"{one.headline:.2f} [{one.low:.2f}, {one.high:.2f}] of {one.driven}"
