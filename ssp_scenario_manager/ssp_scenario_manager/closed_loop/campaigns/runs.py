"""The runs of a campaign: one driver on one start, in the event and in its event-free twin."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from ssp_core.errors import HostError
from ssp_core.files.folders import make_folder
from ssp_core.run_file.driven import BUILT_IN, COMMANDED
from ssp_core.run_file.latency import ZERO_LATENCY, Latency
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import RecordedAnswer
from ssp_scenario_manager.closed_loop.answers import (
    KeptAnswers,
    Question,
    load_answers,
    repeated,
    row_file,
    save_answers,
)
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.row_bags import (
    Bags,
    bag_folder,
    has_bag,
    leave_bag,
)
from ssp_scenario_manager.closed_loop.campaigns.tries import Failure, Tries, load_tries, tries_file
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL, careful_motion, is_defined
from ssp_scenario_manager.closed_loop.outcomes.needless import needless_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import (
    CHAIN,
    HARNESS,
    DriverRun,
    Outcome,
    chain_of,
    measured_of,
    outcome_of,
    severity_of,
)
from ssp_scenario_manager.closed_loop.outcomes.severity import Severity, severity_facts
from ssp_scenario_manager.closed_loop.outcomes.tables import Row, number_cell, one_line, read_row
from ssp_scenario_manager.closed_loop.outcomes.texts import KeptAnswer, texts_of
from ssp_scenario_manager.closed_loop.starts.start import Start, from_facts
from ssp_scenario_manager.compile.task import TASK_FOLDER
from ssp_scenario_manager.run.in_process import Record, run_in_process
from ssp_scenario_manager.run.kept_session import KeptSession

TASKS_FOLDER = "tasks"


@dataclass(frozen=True, slots=True)
class Recording:
    """The bags of a job.

    Args:
        which: of its runs have one.
        folder: of the campaign.
        task: folder of the event's task.
        is_first: the job's start is the first one of its event.
    """

    which: Bags
    folder: Path
    task: Path
    is_first: bool


@dataclass(frozen=True, slots=True)
class Job:
    """One driver on one start, at all latencies.

    Args:
        start: as ``starts.json`` has it.
        first_row: of ``runs.csv``, from 1.
        folder: of the campaign, which takes a model's answers; None: none are kept.
        recording: what is recorded; None: nothing is.
    """

    start: str
    driver: CampaignDriver
    latencies: tuple[Latency, ...]
    repeats: int
    seed: int
    first_row: int = 1
    folder: Path | None = None
    recording: Recording | None = None

    @property
    def count(self) -> int:
        """Rows of the job."""
        return len(self.latencies) * self.repeats


def task_of(folder: Path, plan: LoopPlan, event: str) -> Path:
    """Return the folder of an event's task in a campaign's folder."""
    return folder / TASKS_FOLDER / str(plan.events.index(event)) / TASK_FOLDER


def jobs_of(
    plan: LoopPlan,
    starts: Sequence[Mapping[str, Any]],
    folder: Path | None = None,
    bags: Bags = "none",
) -> Iterator[Job]:
    """Yield the jobs of a campaign in the order of its table.

    Args:
        plan: the campaign.
        starts: sealed ones.
        folder: takes a model's answers, and bags; None: none are kept.
        bags: of which runs.
    """
    first_row = 1
    first: dict[str, str] = {}
    for start in starts:
        text = json.dumps(start, sort_keys=True)
        event = start["event"]
        is_first = first.setdefault(event, start["hash"]) == start["hash"]
        recording = None
        if folder is not None and bags != "none":
            task = task_of(folder, plan, event)
            recording = Recording(bags, folder, task, is_first)
        drives_carefully = is_defined(RunSpec.model_validate(start["run"]))
        for driver in plan.everybody:
            if driver.driver == CAREFUL and not drives_carefully:
                continue
            job = Job(
                text,
                driver,
                tuple(plan.latencies),
                plan.repeats,
                plan.seed,
                first_row,
                folder,
                recording,
            )
            yield job
            first_row += job.count


@dataclass(frozen=True, slots=True)
class _RunFindings:
    """The findings on one run, as its row has them.

    Args:
        answers: with texts.
        took: what is known of a measured latency; None: it was given.
        states: hash of the true states; empty: it was driven in no session.
        drive: in the event; None: there was no sound drive, or it was a prescribed motion.
        model_answers: a model's answers, with which it is driven again.
    """

    outcome: Outcome
    chain: Mapping[str, float | None]
    severity: Severity
    needless: str
    answers: tuple[KeptAnswer, ...] = ()
    took: Mapping[str, Any] | None = None
    states: str = ""
    drive: DriverRun | None = None
    model_answers: KeptAnswers | None = None


@dataclass(frozen=True, slots=True)
class JobRows:
    """The rows of a job, and for each the answers that have texts."""

    rows: list[Row]
    answers: list[tuple[KeptAnswer, ...]]


def rows_of(job: Job) -> JobRows:
    """Drive one driver on one start, in the event and in its event-free twin."""
    start, built_in = _start(job.start)
    identity = identity_of(job)
    rows: list[Row] = []
    answers: list[tuple[KeptAnswer, ...]] = []
    findings: _RunFindings | None = None
    for latency in job.latencies:
        for repeat in range(job.repeats):
            if job.driver.driver == CAREFUL:
                findings = _careful(job.start)
            elif (
                findings is None
                or findings.outcome.kind == HARNESS
                or job.driver.driver not in COMMANDED
            ):
                # Without plans nothing depends on a latency, and one sound drive stands for all.
                row = job.first_row + len(rows)
                findings = _both(job, start, built_in, latency, repeat, row)
            rows.append([*identity[len(rows)], *_cells(start, findings)])
            answers.append(findings.answers)
            _leave_bag(job, start, latency, repeat, findings, rows)
    return JobRows(rows, answers)


def _leave_bag(
    job: Job,
    start: Start,
    latency: Latency,
    repeat: int,
    findings: _RunFindings,
    rows: Sequence[Row],
) -> None:
    """Leave the bag of the last row, if it has one; what the disk doesn't take has none."""
    recording, drive = job.recording, findings.drive
    if recording is None or drive is None:
        return
    one = read_row(rows[-1])
    if not has_bag(one, job.driver, recording.which, is_first=recording.is_first):
        return
    # A drive without plans stands for those at other latencies.
    run = start.driven_by(job.driver.driver, job.driver.options, latency, repeat=repeat)
    drive = replace(drive, run=run, driven=run.driven or drive.driven)
    place = bag_folder(recording.folder, job.first_row + len(rows) - 1)
    try:
        leave_bag(place, recording.task, drive, findings.model_answers, start.v_r_mps, one.needless)
    except HostError:
        # Its row is worth more. Whoever records what has no bag meets the same disk, and says so.
        shutil.rmtree(place, ignore_errors=True)


def _cells(start: Start, findings: _RunFindings) -> Row:
    outcome, severity = findings.outcome, findings.severity
    v_i_mps = None if outcome.contact is None else outcome.contact.relative_mps
    return [
        *(outcome.kind, number_cell(outcome.at_s), one_line(outcome.why)),
        *map(number_cell, (v_i_mps, start.v_r_mps, severity_of(outcome, start.v_r_mps))),
        *map(number_cell, findings.chain.values()),
        number_cell(outcome.unled_s),
        str(outcome.starved).lower(),
        one_line(findings.needless),
        *(
            number_cell(None if findings.took is None else findings.took[key])
            for key in ("p50_s", "p99_s")
        ),
        findings.states,
        *map(number_cell, astuple(severity)),
    ]


def order_of(name: str) -> tuple[bool, bool]:
    """Return in which order the event, True, and its event-free twin are driven.

    It is random by the name of the pair, so that a driver can't tell from it which is which.
    """
    order = [True, False]
    random.Random(name).shuffle(order)
    return order[0], order[1]


def _both(
    job: Job, start: Start, built_in: Record, latency: Latency, repeat: int, row: int
) -> _RunFindings:
    order = order_of(f"{job.seed} {start.hash} {job.driver.display_name} {latency} {repeat}")
    keeps = job.folder is not None and job.driver.is_model
    path = row_file(job.folder, row) if job.folder is not None and keeps else None
    row_answers = failed = None
    if path is not None and path.is_file():
        driver_spec = start.driven_by(
            job.driver.driver, job.driver.options, latency, repeat=repeat
        ).driven
        row_answers = load_answers(
            path, f"remove it, and the model is asked again in row {row}", driver_spec
        )
    elif job.folder is not None and keeps:
        failed = tries_file(job.folder, row)
    tries = Tries() if failed is None else load_tries(failed)
    drives = {}
    for event in order:
        drive = _run(
            job, start, latency, repeat, tries, failed, event=event, row_answers=row_answers
        )
        if isinstance(drive, Failure):
            return _lost(drive)
        drives[event] = drive
    driven, free = drives[True], drives[False]
    if path is not None and row_answers is None:
        make_folder(path.parent)
        question = Question.of(driven.driven)
        row_answers = KeptAnswers(question, driven.answers, free.answers)
        save_answers(path, row_answers)
    return _RunFindings(
        driven.outcome,
        chain_of(driven.driven, driven.record, driven.outcome),
        severity_facts(
            driven.run,
            driven.driven,
            driven.record.reports,
            driven.result,
            driven.outcome.contact,
            driven.outcome.at_s,
        ),
        needless_of(driven, free, built_in, start.contact),
        tuple(texts_of(driven.driven, driven.record.reports, driven.outcome.at_s)),
        measured_of(driven.driven, driven.record),
        driven.record.sha256,
        driven,
        row_answers,
    )


def _lost(failure: Failure) -> _RunFindings:
    """Return the result of a row in which every try ended in a harness failure: no measure."""
    outcome = Outcome(HARNESS, failure.at_s, failure.why, None, None, 0.0, starved=False)
    severity = Severity(None, None, None, None, None, None)
    return _RunFindings(outcome, dict.fromkeys(CHAIN), severity, "")


@lru_cache(maxsize=2)
def _careful(text: str) -> _RunFindings:
    """Return the careful driver's run, which has no latency, on the objects of the oracle's."""
    start, _ = _start(text)
    oracle = drive_start(start, CampaignDriver(driver="oracle"), ZERO_LATENCY)
    outcome, reports = careful_motion(start, oracle.record)
    severity = severity_facts(
        oracle.run, oracle.driven, reports, None, outcome.contact, outcome.at_s
    )
    return _RunFindings(outcome, chain_of(oracle.driven, Record(reports), outcome), severity, "")


def identity_of(job: Job) -> list[Row]:
    """Return the columns of each of a job's rows that say which run it is."""
    facts = json.loads(job.start)
    of_start = [str(facts[name]) for name in ("event", "seed", "hash", "kind")]
    return [
        [*of_start, job.driver.display_name, str(latency), str(repeat)]
        for latency, repeat in product(job.latencies, range(job.repeats))
    ]


Answers = Sequence[RecordedAnswer] | None


def _run(
    job: Job,
    start: Start,
    latency: Latency,
    repeat: int,
    tries: Tries,
    failed: Path | None,
    *,
    event: bool,
    row_answers: KeptAnswers | None,
) -> DriverRun | Failure:
    """Drive once, and repeat after a harness failure while tries are left (METHOD 8.7).

    Args:
        job: names the driver.
        start: with its twin.
        latency: L.
        repeat: of the start under this driver, from 0.
        tries: failed ones of the row, which takes those that fail here.
        failed: file of them; None: they aren't kept.
        event: False: the event-free twin.
        row_answers: answers that a model repeats; None: it is asked.
    """
    answers = repeated(row_answers, event=event)
    listens = event and job.recording is not None
    while (lost := tries.lost(event=event)) is None:
        drive = drive_start(
            start,
            job.driver,
            latency,
            event=event,
            repeat=repeat,
            answers=answers,
            session=KeptSession() if listens else None,
        )
        if drive.outcome.kind != HARNESS:
            return drive
        tries.fail(drive.outcome, failed, event=event)
    return lost


def drive_start(
    start: Start,
    driver: CampaignDriver,
    latency: Latency,
    *,
    event: bool = True,
    repeat: int = 0,
    answers: Answers = None,
    session: KeptSession | None = None,
) -> DriverRun:
    """Drive one driver on a start once.

    Args:
        start: with its twin.
        driver: of the campaign.
        latency: L.
        event: False: the event-free twin.
        repeat: of the start under this driver, from 0.
        answers: that a model gave before, and repeats; None: it is asked.
        session: keeps what its session says, of which a bag can be made; None: nothing does.
    """
    run = start.driven_by(driver.driver, driver.options, latency, event=event, repeat=repeat)
    return driven_again(run, start, answers, session)


def driven_again(
    run: RunSpec, start: Start, answers: Answers, session: KeptSession | None
) -> DriverRun:
    """Drive the run of a driver on a start.

    Args:
        run: as ``driven_by`` gives it.
        start: with its twin.
        answers: as for ``drive_start``.
        session: as for ``drive_start``.
    """
    if run.driven is None:
        raise ValueError("a driven run has a driver")
    result, record = run_in_process(run, listener=session, answers=answers)
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    return DriverRun(run, run.driven, result, record, outcome, session)


@lru_cache(maxsize=2)
def drivable(text: str) -> Start:
    """Return a sealed start, with its twin.

    Args:
        text: as a job has it.
    """
    return from_facts(json.loads(text))


@lru_cache(maxsize=2)
def _start(text: str) -> tuple[Start, Record]:
    """Return a sealed start with its twin, and the built-in driver's event-free run."""
    start = drivable(text)
    drive = drive_start(start, CampaignDriver(driver=BUILT_IN), ZERO_LATENCY, event=False)
    return start, drive.record
