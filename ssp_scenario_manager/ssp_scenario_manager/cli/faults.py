"""``ssp faults``: every fault at every stage of a run, with its result."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
from ssp_core.files.writing import write_json, write_text
from ssp_core.options import WholeNumber
from ssp_scenario_manager.faults.campaign import (
    CellResult,
    FaultScenario,
    Mode,
    Way,
    prepare_scene,
    run_cells,
)
from ssp_scenario_manager.faults.matrix import MATRIX, Row, Stage
from ssp_scenario_manager.faults.report import (
    as_json,
    junit_cases,
    measured_parts,
    page,
)
from ssp_scenario_manager.maps.site import find_shipped
from ssp_scenario_manager.run.junit import write_junit

SCENARIOS = ("cut_in", "vru_crossing")
DEFAULT_OUT = Path("out") / "faults"


@click.command()
@click.option(
    "--scenario",
    "scenarios",
    multiple=True,
    help=f"Event, by name or K* file; may be given again. [default: {', '.join(SCENARIOS)}]",
)
@click.option("--site", default="boulevard", show_default=True, help="Site, by name or file.")
@click.option("--seed", type=WholeNumber(0, 2**31 - 1), default=1, show_default=True)
@click.option(
    "--only",
    multiple=True,
    metavar="REGEX",
    help="Only rows whose name matches this somewhere; repeatable.",
)
@click.option(
    "--stage",
    "stages",
    multiple=True,
    type=click.Choice([stage.value for stage in Stage]),
    help="Only this stage; repeatable. [default: all]",
)
@click.option(
    "--mode",
    type=click.Choice(["lockstep", "realtime"]),
    default="lockstep",
    show_default=True,
    help="Mode of the sessions.",
)
@click.option(
    "--in-process",
    is_flag=True,
    help="Without processes: only the faults of objects, links and session; takes a minute.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=DEFAULT_OUT,
    show_default=True,
    help="Folder of runs and table; finished cells in it are judged again, not run again.",
)
@click.option("--junit", type=click.Path(path_type=Path), help="Also write JUnit XML here.")
@click.option("--list", "show", is_flag=True, help="Only list rows and stages.")
@click.option("--json", "json_wanted", is_flag=True, help="Print the table as JSON.")
def faults(
    scenarios: tuple[str, ...],
    site: str,
    seed: int,
    only: tuple[str, ...],
    stages: tuple[str, ...],
    mode: str,
    in_process: bool,
    out: Path,
    junit: Path | None,
    show: bool,
    json_wanted: bool,
) -> int:
    """Run the fault matrix and write its table.

    Every cell is one session with one injected fault. It leaves its bag, logs and result below the
    folder of its row; the table is written as faults.html and faults.json. Exit status 1
    when any cell is not as expected.
    """
    cells = _select_cells(only, stages)
    if show:
        for row, stage in cells:
            console.out.print(f"{row.name} {stage.value}", markup=False)
        return 0
    if in_process and mode != "lockstep":
        raise click.UsageError("--in-process is lockstep; leave out --mode")
    for scenario in scenarios:
        find_shipped(scenario, "event")
    find_shipped(site, "site")
    click.get_current_context().with_resource(taken_folder(out))
    way: Way = "in_process" if in_process else "sessions"
    results = _run(
        scenarios or SCENARIOS,
        cells,
        lambda scenario: prepare_scene(scenario, site, seed, cast(Mode, mode), out, way),
    )
    run = results[0].scene.run
    facts = as_json(results)
    write_json(out / "faults.json", facts)
    write_text(out / "faults.html", page(results, run))
    if junit is not None:
        write_junit(junit, "faults", junit_cases(results))
    if json_wanted:
        click.echo(json.dumps(facts))
    else:
        _tell(results, out)
    if all(result.judgement is None for result in results):
        console.note("none of these cells is applicable, so that nothing was tested")
        return 1
    return 0 if facts["as_expected"] else 1


def _select_cells(only: Sequence[str], stages: Sequence[str]) -> list[tuple[Row, Stage]]:
    try:
        patterns = [re.compile(text) for text in only]
    except re.error as error:
        raise InputError(
            f"is no regular expression: {error}",
            field="--only",
            value=error.pattern,
            remedy="give a part of a row's name; --list shows them",
        ) from error
    cells = [
        (row, stage)
        for row in MATRIX
        if not patterns or any(pattern.search(row.name) for pattern in patterns)
        for stage in Stage
        if not stages or stage.value in stages
    ]
    if not cells:
        raise InputError(
            "fits no row",
            field="--only",
            value=", ".join(only),
            remedy="--list shows the rows' names",
        )
    return cells


def _run(
    scenarios: Sequence[str],
    cells: list[tuple[Row, Stage]],
    prepare: Callable[[str], FaultScenario],
) -> list[CellResult]:
    results = []
    with console.progress("cells", len(scenarios) * len(cells)) as bar:
        task = bar.task_ids[0]
        for scenario in scenarios:
            bar.update(task, description=f"{scenario}: without a fault")
            scene = prepare(scenario)
            for cell in cells:
                bar.update(task, description=f"{scene.name}: {cell[0].name} {cell[1].title}")
                for result in run_cells(scene, [cell]):
                    results.append(result)
                    _note(result)
                bar.advance(task)
    return results


def _note(result: CellResult) -> None:
    """Print one line per cell, and one per finding."""
    name = f"{result.scene.name} {result.row.name} {result.stage.title}"
    if result.judgement is None:
        console.note(f"{name}: not applicable")
        return
    word = "as expected" if result.ok else "NOT AS EXPECTED"
    console.note(f"{name}: {word}: {', '.join(measured_parts(result.judgement))}")
    for finding in result.judgement.findings:
        console.note(f"  - {finding}")


def _tell(results: Sequence[CellResult], out: Path) -> None:
    counted = [result for result in results if result.judgement is not None]
    bad = [result for result in counted if not result.ok]
    console.out.print(
        f"{len(counted) - len(bad)} of {len(counted)} cells as expected, "
        f"{len(results) - len(counted)} not applicable: {out / 'faults.html'}",
        markup=False,
    )
    for result in bad:
        findings = result.judgement.findings if result.judgement else ()
        console.out.print(
            f"  {result.scene.name} {result.row.name} {result.stage.title}: {findings[0]}",
            markup=False,
        )
