"""The bags that a campaign lacks: runs of its rows, driven again and recorded.

Runs leave their bags as they are driven. One that has none, as of a campaign that was done without
bags, or on a cluster, is the same again, a model's by its kept answers, so that recording costs no
time of what is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from ssp_core.run_file.verdict import RESULT_FILE
from ssp_scenario_manager.closed_loop.answers import repeated
from ssp_scenario_manager.closed_loop.campaigns.again import run_of_row
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.row_bags import Bags, bag_folder, has_bag, leave_bag
from ssp_scenario_manager.closed_loop.campaigns.runs import driven_again
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, Row, read_row
from ssp_scenario_manager.run.kept_session import KeptSession
from ssp_scenario_manager.run.ordered_map import ordered_map
from ssp_scenario_manager.run.sweep import for_one_process


def bag_rows(plan: LoopPlan, rows: Sequence[Row], which: Bags) -> Iterator[int]:
    """Yield the numbers of the rows whose runs are recorded, from 1.

    Args:
        plan: of the campaign.
        rows: of ``runs.csv``.
        which: as for ``has_bag``.
    """
    kind_of = {one.display_name: one for one in plan.everybody}
    first: dict[str, str] = {}
    for number, row in enumerate(rows, 1):
        one = read_row(row)
        is_first = first.setdefault(one.event, one.start) == one.start
        if has_bag(one, kind_of[one.driver], which, is_first=is_first):
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
    bag_count = len(numbers) - len(todo)
    on_done(bag_count, len(numbers))
    wrong = []
    with ordered_map(min(jobs, len(todo))) as run_all:
        for why in run_all(partial(_record, folder), todo):
            bag_count += 1
            on_done(bag_count, len(numbers))
            if why:
                wrong.append(why)
    return wrong


def _record(folder: Path, number: int) -> str:
    again = run_of_row(folder, number)
    place = bag_folder(folder, number)
    run = for_one_process(again.run, camera=True)
    drive = driven_again(run, again.start, repeated(again.model_answers), KeptSession())
    needless = dict(zip(RUN_COLUMNS, again.row, strict=True))["needless"]
    why = leave_bag(
        place, again.task, drive, again.model_answers, again.start.v_r_mps, needless, again.before
    )
    return f"{place}: {why}" if why else ""
