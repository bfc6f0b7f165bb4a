"""The texts of a campaign's answers beside their plans, for words against deeds (METHOD 8.9)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_text
from ssp_core.motion.reference import Reference
from ssp_core.run_file.driven import Driven
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.contact import until
from ssp_scenario_manager.closed_loop.values import EPSILON_S

TEXTS_FOLDER = "texts"
# METHOD 8.9: a plan slows if its speed falls by enough within this.
SLOWS_S = 2.0
_MOST_TEXT = 4000  # characters of an answer
KeptAnswer = dict[str, Any]


def texts_of(
    driven: Driven, reports: Sequence[StepReport], decided_s: float
) -> Iterator[KeptAnswer]:
    """Yield each answer that has a text and a plan that was driven, at or after T_obs.

    ``slows_mps`` is by how much its plan slows within 2 s of its frame.

    Args:
        driven: the driver.
        reports: of the run.
        decided_s: time of the deciding fact, or T_end.
    """
    if driven.observable_s is None:
        return
    texts: dict[str, str] = {}
    for report in until(reports, driven.first_request_s, min(decided_s, driven.end_s)):
        if report.drive is None:
            continue
        answered, plan = report.drive.effective_answer, report.drive.effective
        if answered is not None and answered.answer.text.strip():
            texts[f"plan-{answered.number}"] = answered.answer.text
        if plan is None or plan.reference_id not in texts:
            continue
        stamp_s = ns_to_seconds(plan.execute_at_ns)
        if stamp_s >= driven.observable_s - EPSILON_S:
            begins_mps, slows_mps = _speeds(plan)
            yield {
                "stamp_s": stamp_s,
                "text": texts[plan.reference_id][:_MOST_TEXT],
                "speed_mps": round(begins_mps, 3),
                "slows_mps": round(slows_mps, 3),
            }


def _speeds(plan: Reference) -> tuple[float, float]:
    t, speed = plan.columns[0], plan.columns[4]
    begins_mps = float(speed[0])
    return begins_mps, begins_mps - float(np.min(speed[t <= SLOWS_S]))


def write_texts(
    folder: Path, job: int, per_job: int, answers: Sequence[Sequence[KeptAnswer]]
) -> None:
    """Write the answers of a job's runs, one a line with its row's number; none leaves no file.

    Args:
        folder: of the campaign.
        job: its place, from 0.
        per_job: rows of a job.
        answers: of each of its runs.
    """
    lines = [
        json.dumps({"row": job * per_job + k + 1, **one})
        for k, each in enumerate(answers)
        for one in each
    ]
    if lines:
        place = make_folder(folder / TEXTS_FOLDER) / f"{job:06d}.jsonl"
        write_text(place, "".join(f"{line}\n" for line in lines))
