"""The bags of a campaign: runs of its rows, driven again and recorded.

A run is the same again, a model's by its kept answers, so that recording costs no time of what is
measured, and a campaign that is done can be given the bags that it has not.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from ssp_core.files.folders import make_folder
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_scenario_manager.closed_loop.answers import ANSWERS_FILE, repeated, save_answers
from ssp_scenario_manager.closed_loop.campaigns.again import run_of_row
from ssp_scenario_manager.closed_loop.campaigns.plan_file import ZERO, LoopPlan
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS, outcome_of, told_of
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, Row, read_row
from ssp_scenario_manager.closed_loop.single_run.before import Before
from ssp_scenario_manager.closed_loop.single_run.top_view import leave_view
from ssp_scenario_manager.closed_loop.starts.start import Start
from ssp_scenario_manager.compile.task import copy_task
from ssp_scenario_manager.run.in_process import InProcessResult, Record
from ssp_scenario_manager.run.ordered_map import ordered_map
from ssp_scenario_manager.run.sweep import for_one_process, run_one

BAGS_FOLDER = "bags"
Bags = Literal["all", "failed", "none"]


def bag_rows(plan: LoopPlan, rows: Sequence[Row], which: Bags) -> Iterator[int]:
    """Yield the numbers of the rows whose runs are recorded, from 1.

    A prescribed motion drives in no session. A model has no answers to repeat if the harness failed
    in its run.

    Args:
        plan: of the campaign.
        rows: of ``runs.csv``.
        which: ``failed``: those on critical starts that are no success, without the drivers that
            must fail, and each run on the first start of an event.
    """
    kind_of = {one.shown: one for one in plan.everybody}
    first: dict[str, str] = {}
    for number, row in enumerate(rows, 1):
        one = read_row(row)
        start = first.setdefault(one.event, one.start)
        driver = kind_of[one.driver]
        if which == "none" or driver.driver == CAREFUL:
            continue
        if one.outcome == HARNESS and driver.is_model:
            continue
        fails = one.kind == "critical" and not one.succeeds and driver.driver not in ZERO
        if which == "all" or fails or one.start == start:
            yield number


def write_bags(
    folder: Path,
    numbers: Sequence[int],
    jobs: int,
    on_done: Callable[[int, int], None],
) -> list[str]:
    """Record the runs of rows that have no bag yet, each in a folder as `ssp run` leaves it.

    Returns:
        Which of the runs weren't those of their rows any more, and what of them; their results
        are not valid.

    Args:
        folder: of the campaign, all of whose rows are there.
        numbers: of the rows.
        jobs: processes that share the work.
        on_done: is given how many are done, at first those that were, and of how many.
    """
    todo = [n for n in numbers if not (bag_folder(folder, n) / RESULT_FILE).is_file()]
    done = len(numbers) - len(todo)
    on_done(done, len(numbers))
    wrong = []
    with ordered_map(min(jobs, len(todo))) as run_all:
        for why in run_all(partial(_record, folder), todo):
            done += 1
            on_done(done, len(numbers))
            if why:
                wrong.append(why)
    return wrong


def bag_folder(folder: Path, number: int) -> Path:
    """Return the folder of a row's run, with its bag.

    Args:
        folder: of the campaign.
        number: of the row, from 1.
    """
    return folder / BAGS_FOLDER / f"{number:06d}"


def _record(folder: Path, number: int) -> str:
    again = run_of_row(folder, number)
    place = bag_folder(folder, number)
    # What a call that was cut off left.
    shutil.rmtree(place, ignore_errors=True)
    make_folder(place)
    copy_task(again.task, place)
    if again.kept is not None:
        save_answers(place / ANSWERS_FILE, again.kept)
    spec = for_one_process(again.run.model_copy(update={"run_id": place.name}), camera=True)
    needless = dict(zip(RUN_COLUMNS, again.row, strict=True))["needless"]
    told = run_one(
        spec,
        place,
        as_json=False,
        recorded=True,
        further=partial(_told, place, again.start, again.before, needless),
        answers=repeated(again.kept),
        quiet=True,
    )
    differs = again.before is not None and told["driven"]["outcome"] == HARNESS
    return f"{place}: {told['driven']['why']}" if differs else ""


def _told(
    place: Path,
    start: Start,
    before: Before | None,
    needless: str,
    run: RunSpec,
    result: InProcessResult,
    record: Record,
) -> tuple[dict[str, Any], str]:
    if run.driven is None:
        raise ValueError("a driven run has a driver")
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    told = told_of(run.driven, record, outcome, start.v_r_mps) | {"needless": needless}
    told, why = (told, "") if before is None else before.judged(told)
    leave_view(place, run, record, told)
    return {"driven": told}, why
