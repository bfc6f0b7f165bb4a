"""One run of a campaign again, as a run's own folder has it."""

from __future__ import annotations

from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.closed_loop.careful import CAREFUL
from ssp_scenario_manager.closed_loop.runs import drivable, identity_of, jobs_of
from ssp_scenario_manager.closed_loop.seal import TASKS_FOLDER, sealed_plan, sealed_starts
from ssp_scenario_manager.closed_loop.tables import RUNS_FILE, rows_there
from ssp_scenario_manager.compile.task import TASK_FOLDER


def run_of_row(folder: Path, number: int) -> tuple[RunSpec, Path]:
    """Return the run of one row of a campaign, and the folder of its event's task.

    Args:
        folder: of the campaign.
        number: of the row in ``runs.csv``, from 1.

    Raises:
        InputError: it is no campaign, or has no such row.
    """
    plan, _ = sealed_plan(folder)
    rows = rows_there(folder / RUNS_FILE)
    if not 1 <= number <= len(rows):
        raise InputError(
            f"has {len(rows)} runs", file=folder / RUNS_FILE, field="--again", value=number
        )
    starts = sealed_starts(folder)
    left = number - 1
    for job in jobs_of(plan, starts):
        wanted = identity_of(job)
        if left >= len(wanted):
            left -= len(wanted)
            continue
        if job.driver.driver == CAREFUL:
            raise InputError(
                "is a prescribed motion, and drives in no session",
                file=folder / RUNS_FILE,
                field="--again",
                value=number,
            )
        task = folder / TASKS_FOLDER / str(plan.events.index(wanted[left][0])) / TASK_FOLDER
        latency_s = job.latencies_s[left // job.repeats]
        return drivable(job.start).driven_by(job.driver.driver, job.driver.options, latency_s), task
    raise InputError("isn't of this campaign's plan", file=folder / RUNS_FILE, value=number)
