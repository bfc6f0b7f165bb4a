"""A campaign: starts that are sealed before a driver runs, then one row per run, resumable."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.closed_loop.campaigns.cards import (
    CARDS_FILE,
    complete_cards,
    seal_cards,
)
from ssp_scenario_manager.closed_loop.campaigns.disk_room import check_room
from ssp_scenario_manager.closed_loop.campaigns.groups import group_numbers
from ssp_scenario_manager.closed_loop.campaigns.plan_file import ZERO, LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.row_bags import Bags
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, identity_of, jobs_of, rows_of
from ssp_scenario_manager.closed_loop.campaigns.seal import (
    PLAN_FILE,
    STARTS_FILE,
    draw_starts,
    software,
)
from ssp_scenario_manager.closed_loop.outcomes.outcome import OUTCOMES
from ssp_scenario_manager.closed_loop.outcomes.rates import Rates, rates_of, refusal_reasons, rising
from ssp_scenario_manager.closed_loop.outcomes.tables import (
    RATE_COLUMNS,
    RUN_COLUMNS,
    RUNS_FILE,
    TABLE_FILE,
    Row,
    lines_of,
    off_the_twin,
    rates_row,
    read_row,
    rows_there,
)
from ssp_scenario_manager.closed_loop.outcomes.texts import write_texts
from ssp_scenario_manager.run.ordered_map import Engine, cluster, ordered_map


def run_campaign(
    plan: LoopPlan,
    folder: Path,
    jobs: int,
    on_rows: Callable[[int, int], None],
    say: Callable[[str], None],
    engine: Engine = "processes",
    bags: Bags = "none",
) -> tuple[list[Rates], list[str]]:
    """Run a campaign, or what is left of it; return the rates, and why it is refused.

    Args:
        plan: the campaign.
        folder: new, or of the same campaign.
        jobs: workers that share the work; one where a latency is measured.
        on_rows: is given how many runs are done, at first those that were, and of how many.
        say: takes what doesn't end it, for people.
        engine: where the workers are.
        bags: of runs that are recorded as they are driven; on a cluster none are.

    Raises:
        InputError: as ``draw_starts``, or ``runs.csv`` is of another campaign, or runs with a
            measured latency would go side by side, or on another machine.
        HostError: as ``ordered_map``, or the disk has no room for the bags.
    """
    if plan.is_measured and jobs > 1:
        raise InputError(
            "goes with one process: a measured latency is that of a run that goes alone",
            field="--jobs",
            value=jobs,
            remedy="leave --jobs out, or give the fixed latencies a plan of their own",
        )
    if plan.is_measured and engine != "processes":
        raise InputError(
            "goes on this machine: a measured latency is that of the hardware on the driver's card",
            field="--engine",
            value=engine,
            remedy="leave --engine out, or give the fixed latencies a plan of their own",
        )
    with cluster(engine, jobs):
        return _run(plan, folder, jobs, on_rows, say, engine, bags)


def _run(
    plan: LoopPlan,
    folder: Path,
    jobs: int,
    on_rows: Callable[[int, int], None],
    say: Callable[[str], None],
    engine: Engine,
    bags: Bags,
) -> tuple[list[Rates], list[str]]:
    starts = draw_starts(plan, folder, jobs, say, engine)
    numbers = group_numbers(seal_cards(folder, plan, starts))
    # A worker on a cluster works in a folder of its own.
    todo = list(jobs_of(plan, starts, folder.resolve(), "none" if engine == "ray" else bags))
    check_room(todo, folder, bags, say)
    per_job = len(plan.latencies) * plan.repeats
    path = folder / RUNS_FILE
    rows = rows_there(path)
    # A job that was cut off is run again as a whole.
    rows = rows[: len(rows) // per_job * per_job]
    _check_rows(path, rows, todo, per_job)
    campaign_files = _CampaignFiles(folder, lines_of([RUN_COLUMNS, *rows]))
    total = len(todo) * per_job
    on_rows(len(rows), total)
    with (
        ordered_map(min(jobs, len(todo)), engine, software) as run_all,
        path.open("a", newline="") as stream,
    ):
        for job_rows in run_all(rows_of, todo[len(rows) // per_job :]):
            # Before its rows: a job without rows is run again, and writes them anew.
            write_texts(folder, len(rows) // per_job, per_job, job_rows.answers)
            campaign_files.check()
            lines = lines_of(job_rows.rows)
            stream.write(lines)
            stream.flush()
            campaign_files.add(lines)
            rows += job_rows.rows
            on_rows(len(rows), total)
    campaign_files.check(whole=True)
    if plan.is_measured:
        complete_cards(folder, rows)
    rates = rates_of([read_row(row) for row in rows])
    knowing = {one.display_name for one in plan.everybody if one.is_privileged}
    table = [rates_row(one, one.driver in knowing, numbers[one.driver]) for one in rates]
    write_text(folder / TABLE_FILE, lines_of([RATE_COLUMNS, *table]))
    for text in rising(rates, [one.display_name for one in plan.everybody]):
        say(f"gets better with latency: {text}")
    for text in off_the_twin(dict(zip(RUN_COLUMNS, row, strict=True)) for row in rows):
        say(f"isn't as no_response: {text}")
    return rates, refusal_reasons(rates, ZERO)


class _CampaignFiles:
    """Files of a campaign that its own command alone may change while it runs.

    A driver of it could, too, where it runs as the same user. Each check compares what the system
    says of the files, and reads only those of which that changed, so that the bytes read don't grow
    with the square of the rows.

    Args:
        folder: of the campaign, with plan, starts and cards.
        lines: that its rows begin with; they are written.
    """

    def __init__(self, folder: Path, lines: str) -> None:
        self._rows = hashlib.sha256(lines.encode())
        self._path = folder / RUNS_FILE
        write_text(self._path, lines)
        sealed = [folder / name for name in (PLAN_FILE, STARTS_FILE, CARDS_FILE)]
        self._states = {path: _state_of(path) for path in (*sealed, self._path)}
        self._sealed = {path: sha256_file(path) for path in sealed}

    def add(self, lines: str) -> None:
        """Take further rows that were written."""
        self._rows.update(lines.encode())
        self._states[self._path] = _state_of(self._path)

    def check(self, *, whole: bool = False) -> None:
        """Raise InputError where a file isn't as it was written.

        Args:
            whole: read also the files of which the system says that nothing changed; it counts time
                in steps of milliseconds, and may miss a change right behind a row.
        """
        rows = {self._path: f"sha256:{self._rows.hexdigest()}"}
        for path, digest in {**self._sealed, **rows}.items():
            state = _state_of(path)
            if state == self._states[path] and not whole:
                continue
            if not path.is_file() or sha256_file(path) != digest:
                raise InputError(
                    "was changed while the campaign ran, by something else than this command",
                    file=path,
                    remedy="name a new folder with --out; a driver that isn't trusted goes "
                    "behind HTTP, under another user",
                )
            self._states[path] = state


def _state_of(path: Path) -> tuple[int, ...]:
    """Return what differs after each write to a file, or its replacement; empty without one.

    The time of the last change of status can't be set, as that of the content can.
    """
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _check_rows(path: Path, rows: Sequence[Row], todo: Sequence[Job], per_job: int) -> None:
    for i, row in enumerate(rows):
        job = todo[i // per_job] if i // per_job < len(todo) else None
        identity = [] if job is None else identity_of(job)[i % per_job]
        if (
            len(row) != len(RUN_COLUMNS)
            or row[: len(identity)] != identity
            or row[7] not in OUTCOMES
        ):
            raise InputError(
                "holds another campaign's run",
                file=path,
                line=i + 2,
                remedy="name a new folder with --out",
            )
