"""``ssp ablate``: one event with and without its structure."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import click
from rich.progress import Progress
from rich.table import Table as Shown

from ssp_core import console
from ssp_core.files.folders import new_files, taken_folder
from ssp_core.options import WholeNumber
from ssp_eval.ablation.campaign import Plan, Realisation, run_ablation
from ssp_eval.ablation.figure import figures
from ssp_eval.ablation.ground import SOURCE_PLACE
from ssp_eval.ablation.tables import arms_table, findings, tables_of
from ssp_eval.figures.write import written_drawings
from ssp_eval.statistics.table import Table, texts, to_data, write_tables


@click.command("ablate")
@click.argument("event")
@click.option("--sites", multiple=True, metavar="SITE", help="Site by name or file; repeatable.")
@click.option(
    "--maps",
    multiple=True,
    type=click.Path(path_type=Path),
    help="OpenDRIVE or SUMO map; repeatable.",
)
@click.option(
    "--source",
    type=click.Path(path_type=Path),
    help="Recording of the source, with states and a road  [default: the project's clip].",
)
@click.option(
    "--realisations",
    type=WholeNumber(1, 100000),
    default=100,
    show_default=True,
    help="Per arm, spread over the places.",
)
@click.option(
    "--seed", type=WholeNumber(1, 2**31), default=1, show_default=True, help="First seed."
)
@click.option("--jobs", type=WholeNumber(1, 1024), default=1, help="Processes that share the work.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder; an interrupted ablation is resumed.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the tables as JSON.")
def ablate(
    event: str,
    sites: tuple[str, ...],
    maps: tuple[Path, ...],
    source: Path | None,
    realisations: int,
    seed: int,
    jobs: int,
    out: Path,
    as_json: bool,
) -> int:
    """Realise EVENT with and without its structure, and show what is lost without it.

    \b
    structure  the compiler, with all of K*
    relations  classes, relative positions and speeds alone
    tracks     the observed tracks, played by the clock

    Each arm gets the same places, tuning budget and sessions in one process, and is judged on
    measured states. It writes realisations.csv (a row each), tables as CSV, and a figure.
    Exit status 1, and no table, if an arm doesn't keep the event at the source's own place.

    \b
    For example:
      ssp ablate cut_in --sites boulevard --sites north_track --jobs 2 --out out/ablation
    """
    plan = Plan(event, sites, maps, source, realisations, seed)
    if not plan.places:
        raise click.UsageError("give places with --sites and --maps")
    with taken_folder(out):
        with console.progress("realisations", None, estimated=True) as bar:
            outcomes = run_ablation(plan, out, jobs, _counted(bar))
        placed = [one for one in outcomes if one.place != SOURCE_PLACE]
        tables = tables_of(placed)
        with new_files(out) as scratch:
            written_drawings(figures(event, placed), scratch, lambda _name: None)
            write_tables(out, tables, ["csv"])
    _say(outcomes, placed, tables, out, as_json)
    return 0


def _say(
    outcomes: Sequence[Realisation],
    placed: Sequence[Realisation],
    tables: Sequence[Table],
    out: Path,
    as_json: bool,
) -> None:
    if as_json:
        document = {table.name: to_data(table) for table in tables}
        document["findings"] = findings(placed)  # type: ignore[assignment]  # a list beside tables
        click.echo(json.dumps(document))
        return
    console.out.print(_console_table(placed))
    control = ", ".join(
        f"{one.arm} {one.judgement.kpr:.2f}"
        for one in outcomes
        if one.place == SOURCE_PLACE and one.judgement is not None and one.judgement.kpr is not None
    )
    console.out.print(f"KPR at {SOURCE_PLACE}: {control}", markup=False)
    for text in findings(placed):
        console.out.print(text, markup=False)
    console.out.print(f"{out}: realisations.csv, tables and figure", markup=False)


def _console_table(placed: Sequence[Realisation]) -> Shown:
    """Return the arms side by side, each value with its interval."""
    table = arms_table(placed)
    keys = [column.key for column in table.columns]
    arms = [dict(zip(keys, texts(table, row), strict=True)) for row in table.rows]
    grid = Shown(title=table.title)
    grid.add_column("")
    for arm in arms:
        grid.add_column(arm["arm"], justify="right")
    grid.add_row("N", *(arm["n"] for arm in arms))
    for column in table.columns:
        low, high = f"{column.key}_low", f"{column.key}_high"
        if low in keys:
            grid.add_row(
                column.title, *(f"{arm[column.key]} ({arm[low]} to {arm[high]})" for arm in arms)
            )
    return grid


def _counted(bar: Progress) -> Callable[[int, int], None]:
    """Return what shows the realisations that are done."""
    begun = False

    def count(row_count: int, total: int) -> None:
        nonlocal begun
        show = bar.update if begun else bar.reset
        show(bar.task_ids[0], total=total, completed=row_count)
        begun = True

    return count
