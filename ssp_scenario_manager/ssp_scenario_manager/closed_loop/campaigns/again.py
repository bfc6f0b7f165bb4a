"""One run of a campaign again, as a run's own folder has it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.closed_loop.answers import KeptAnswers, load_answers, row_file
from ssp_scenario_manager.closed_loop.campaigns.runs import (
    drivable,
    identity_of,
    jobs_of,
    task_of,
)
from ssp_scenario_manager.closed_loop.campaigns.seal import sealed_plan, sealed_starts
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL
from ssp_scenario_manager.closed_loop.outcomes.tables import (
    RUN_COLUMNS,
    RUNS_FILE,
    Row,
    rows_there,
)
from ssp_scenario_manager.closed_loop.single_run.before import Before, before_of_row
from ssp_scenario_manager.closed_loop.starts.start import Start


@dataclass(frozen=True, slots=True)
class RowRun:
    """One row of a campaign, to be driven again.

    Args:
        start: with its twin.
        row: of ``runs.csv``.
        run: as it was driven.
        task: folder of its event's task.
        model_answers: that it repeats; None: it is asked anew, or the driver is a baseline.
        asks_anew: a model whose answers aren't kept, since the harness failed in its run.
        before: what the row says of it; None: the harness failed in it.
    """

    start: Start
    row: Row
    run: RunSpec
    task: Path
    model_answers: KeptAnswers | None
    asks_anew: bool
    before: Before | None


def run_of_row(folder: Path, number: int) -> RowRun:
    """Return the run of one row of a campaign.

    Args:
        folder: of the campaign.
        number: of the row in ``runs.csv``, from 1.

    Raises:
        InputError: it is no campaign, or has no such row, or the row's answers were removed, or are
            of another run.
    """
    plan, _ = sealed_plan(folder)
    rows = rows_there(folder / RUNS_FILE)
    if not 1 <= number <= len(rows):
        raise InputError(
            f"has {len(rows)} runs",
            file=folder / RUNS_FILE,
            field="--again",
            value=number,
            remedy="give the number of one of them, from 1",
        )
    starts = sealed_starts(folder)
    left = number - 1
    for job in jobs_of(plan, starts):
        identities = identity_of(job)
        if left >= len(identities):
            left -= len(identities)
            continue
        if job.driver.driver == CAREFUL:
            raise InputError(
                "is a prescribed motion, and drives in no session",
                file=folder / RUNS_FILE,
                field="--again",
                value=number,
                remedy="give a row of another driver",
            )
        task = task_of(folder, plan, identities[left][0])
        latency, repeat = job.latencies[left // job.repeats], left % job.repeats
        start = drivable(job.start)
        run = start.driven_by(job.driver.driver, job.driver.options, latency, repeat=repeat)
        row = rows[number - 1]
        if len(row) != len(RUN_COLUMNS) or row[: len(identities[left])] != identities[left]:
            raise InputError(
                "isn't the run of this place in the plan",
                file=folder / RUNS_FILE,
                line=number + 1,
                remedy="put runs.csv back, or begin the campaign in a new folder",
            )
        before = before_of_row(folder / RUNS_FILE, number, row)
        is_model = job.driver.is_model
        is_kept = is_model and before is not None
        path = row_file(folder, number)
        remedy = "let the campaign be driven anew"
        answers = load_answers(path, remedy, run.driven) if is_kept else None
        return RowRun(start, row, run, task, answers, is_model and not is_kept, before)
    raise InputError(
        "isn't of this campaign's plan",
        file=folder / RUNS_FILE,
        value=number,
        remedy="put runs.csv back, or begin the campaign in a new folder",
    )
