"""Campaigns of driven runs whose process is killed, with rows that were driven before.

A moment is a call of a function, and so the same on each machine, however busy it is.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import statsmodels.stats.proportion  # noqa: F401

# A campaign imports these when it needs them: once here, not after each fork.
from ssp_scenario_manager.closed_loop.campaigns import campaign
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, JobRows
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, RUNS_FILE, Row, rows_there

_DRIVER = RUN_COLUMNS.index("driver")


class Moment(NamedTuple):
    """The moment at which a campaign is killed.

    Args:
        done: rows that are there before.
        call: of a function behind them.
        torn: bytes by which the file of rows is shortened afterwards.
    """

    done: int
    call: int
    torn: int


class RecordedRows:
    """The drive of a job from the rows of a campaign that is done.

    Args:
        rows: of ``runs.csv``, without its head.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = rows

    def __call__(self, job: Job) -> JobRows:
        found = [row for row in self._rows if row[_DRIVER] == job.driver.display_name]
        return JobRows(found, [() for _ in found])


def kill_campaign(plan: LoopPlan, folder: Path, done: Path, moments: Sequence[Moment]) -> list[int]:
    """Goes on with a campaign once a moment, each time in a process of its own; the exit codes.

    Args:
        plan: the campaign.
        folder: of it.
        done: folder of the same campaign, with all rows.
        moments: at which one process after the other ends by SIGKILL.
    """
    asked = json.dumps([plan.model_dump_json(by_alias=True), str(folder), str(done), moments])
    command = [sys.executable, "-m", __name__]
    said = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
    codes: list[int] = json.loads(said.stdout)
    return codes


def _killed(plan: LoopPlan, folder: Path, rows: Sequence[Row], moment: Moment) -> int:
    pid = os.fork()
    if pid:
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        path = folder / RUNS_FILE
        written = path.read_bytes()
        path.write_bytes(written[: len(written) - moment.torn])
        return code
    try:
        _run(plan, folder, rows, moment)
    finally:
        os._exit(0)


def _run(plan: LoopPlan, folder: Path, rows: Sequence[Row], moment: Moment) -> None:
    campaign.rows_of = RecordedRows(rows)  # type: ignore[assignment]
    calls = 0

    def follow(_frame: FrameType, event: str, _argument: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")
        if calls == moment.call:
            os.kill(os.getpid(), signal.SIGKILL)

    def on_rows(there: int, _total: int) -> None:
        if there >= moment.done:
            sys.setprofile(follow)

    campaign.run_campaign(plan, folder, 1, on_rows, lambda _: None)


def main() -> None:
    """Kill the campaign that standard input names; print the exit codes."""
    # A campaign's cards import it: once here, not after each fork.
    import ssp_eval.evaluate.driving  # noqa: F401

    plan_json, folder, done, moments = json.load(sys.stdin)
    plan, rows = LoopPlan.model_validate_json(plan_json), rows_there(Path(done) / RUNS_FILE)
    print(json.dumps([_killed(plan, Path(folder), rows, Moment(*one)) for one in moments]))


if __name__ == "__main__":
    main()
