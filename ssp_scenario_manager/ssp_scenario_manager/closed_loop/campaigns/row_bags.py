"""The bag of one row of a campaign: which rows have one, and its folder as `ssp run` leaves it.

The states of a run stand in its bag, so that the folder has no file of them.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Literal

from ssp_core.compiled import core_in_use
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json, write_text
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_scenario_manager.closed_loop.answers import ANSWERS_FILE, KeptAnswers, save_answers
from ssp_scenario_manager.closed_loop.campaigns.plan_file import ZERO, CampaignDriver
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS, DriverRun, driven_summary
from ssp_scenario_manager.closed_loop.outcomes.rates import RunRow
from ssp_scenario_manager.closed_loop.single_run.before import Before
from ssp_scenario_manager.closed_loop.single_run.top_view import leave_view
from ssp_scenario_manager.compile.task import copy_task
from ssp_scenario_manager.run.in_process import leave_recording, result_json
from ssp_scenario_manager.run.sweep import for_one_process

BAGS_FOLDER = "bags"
Bags = Literal["all", "failed", "none"]


def has_bag(one: RunRow, driver: CampaignDriver, which: Bags, *, is_first: bool) -> bool:
    """Tell whether the run of a row is recorded.

    A prescribed motion drives in no session. A model has no answers to repeat if the harness failed
    in its run.

    Args:
        one: the row.
        driver: of the row.
        which: ``failed``: runs on critical starts that are no success, without the drivers that
            must fail, and each run on the first start of an event.
        is_first: the row's start is that one.
    """
    if which == "none" or driver.driver == CAREFUL:
        return False
    if one.outcome == HARNESS and driver.is_model:
        return False
    fails = one.kind == "critical" and not one.succeeds and driver.driver not in ZERO
    return which == "all" or fails or is_first


def bag_folder(folder: Path, number: int) -> Path:
    """Return the folder of a row's run, with its bag.

    Args:
        folder: of the campaign.
        number: of the row, from 1.
    """
    return folder / BAGS_FOLDER / f"{number:06d}"


def leave_bag(
    place: Path,
    task: Path,
    drive: DriverRun,
    answers: KeptAnswers | None,
    v_r_mps: float | None,
    needless: str,
    before: Before | None = None,
) -> str:
    """Leave the bag of a drive and the files beside it; the file of its result comes last.

    Args:
        place: folder of the row's run, which a call that was cut off may have begun.
        task: folder of the event's task.
        drive: the drive, with what was said in it.
        answers: of a model.
        v_r_mps: of its start.
        needless: why it is in the event-free twin, as its row says it.
        before: what it was, where it was driven again; None: it is held against nothing.

    Returns:
        Why it isn't the run that it must be; empty: it is.

    Raises:
        InputError: a file of the task can't be taken.
        HostError: the disk doesn't take it.
    """
    if drive.session is None:
        raise ValueError("nothing was kept of the session")
    shutil.rmtree(place, ignore_errors=True)
    copy_task(task, make_folder(place))
    if answers is not None:
        save_answers(place / ANSWERS_FILE, answers)
    spec = for_one_process(drive.run.model_copy(update={"run_id": place.name}), camera=True)
    run_file = place / "run.yaml"
    write_text(run_file, spec.model_dump_json(by_alias=True, indent=1) + "\n")
    summary = driven_summary(drive.driven, drive.record, drive.outcome, v_r_mps) | {
        "needless": needless
    }
    summary, why = (summary, "") if before is None else before.judge(summary)
    result = drive.result.failed_for(why) if why else drive.result
    recorded = leave_recording(spec, run_file, place / "bag", drive.session, result)
    leave_view(place, spec, drive.record, summary, drive.outcome.contact)
    own = {"compiled_core": core_in_use(), "driven": summary}
    write_json(place / RESULT_FILE, result_json(spec, result) | recorded | own)
    return why
