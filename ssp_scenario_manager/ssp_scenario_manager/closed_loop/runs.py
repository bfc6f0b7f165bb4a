"""The runs of a campaign: one driver on one start, in the event and in its event-free twin."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from itertools import product
from typing import Any

from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import BUILT_IN, COMMANDED
from ssp_scenario_manager.closed_loop.careful import CAREFUL, careful_motion, is_defined
from ssp_scenario_manager.closed_loop.needless import needless_in
from ssp_scenario_manager.closed_loop.outcome import (
    Outcome,
    chain_of,
    outcome_of,
    severity_of,
)
from ssp_scenario_manager.closed_loop.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.severity import Severity, severity_facts
from ssp_scenario_manager.closed_loop.start import Start, from_facts
from ssp_scenario_manager.closed_loop.tables import Row, one_line, shown
from ssp_scenario_manager.closed_loop.texts import Kept, texts_of
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process

# A run that our side failed is repeated at most so often.
_HARNESS_REPEATS = 2


@dataclass(frozen=True, slots=True)
class Job:
    """One driver on one start, at all latencies.

    Args:
        start: as ``starts.json`` has it.
    """

    start: str
    driver: CampaignDriver
    latencies_s: tuple[float, ...]
    repeats: int
    seed: int


def jobs_of(plan: LoopPlan, starts: Sequence[Mapping[str, Any]]) -> Iterator[Job]:
    """Yield the jobs of a campaign in the order of its table."""
    for start in starts:
        text = json.dumps(start, sort_keys=True)
        drives_carefully = is_defined(RunSpec.model_validate(start["run"]))
        for driver in plan.everybody:
            if driver.driver == CAREFUL and not drives_carefully:
                continue
            yield Job(text, driver, tuple(plan.latencies_s), plan.repeats, plan.seed)


@dataclass(frozen=True, slots=True)
class _Found:
    """The findings on one run, as its row has them."""

    outcome: Outcome
    chain: Mapping[str, float | None]
    severity: Severity
    needless: str
    answers: tuple[Kept, ...] = ()


@dataclass(frozen=True, slots=True)
class Done:
    """The rows of a job, and for each the answers that have texts."""

    rows: list[Row]
    answers: list[tuple[Kept, ...]]


def rows_of(job: Job) -> Done:
    """Drive one driver on one start, in the event and in its event-free twin."""
    start, built_in = _start(job.start)
    identity = identity_of(job)
    rows: list[Row] = []
    answers: list[tuple[Kept, ...]] = []
    found: _Found | None = None
    for latency_s in job.latencies_s:
        for repeat in range(job.repeats):
            if job.driver.driver == CAREFUL:
                found = _careful(job.start)
            elif (
                found is None
                or found.outcome.kind == "harness"
                or job.driver.driver not in COMMANDED
            ):
                # Without plans nothing depends on a latency, and one sound drive stands for all.
                found = _both(job, start, built_in, latency_s, repeat)
            rows.append([*identity[len(rows)], *_cells(start, found)])
            answers.append(found.answers)
    return Done(rows, answers)


def _cells(start: Start, found: _Found) -> Row:
    outcome, severity = found.outcome, found.severity
    v_i_mps = None if outcome.contact is None else outcome.contact.relative_mps
    return [
        *(outcome.kind, shown(outcome.at_s), one_line(outcome.why)),
        *map(shown, (v_i_mps, start.v_r_mps, severity_of(outcome, start.v_r_mps))),
        *map(shown, found.chain.values()),
        shown(outcome.unled_s),
        str(outcome.starved).lower(),
        one_line(found.needless),
        *map(shown, astuple(severity)),
    ]


def order_of(name: str) -> tuple[bool, bool]:
    """Return in which order the event, True, and its event-free twin are driven.

    It is random by the name of the pair, so that a driver can't tell from it which is which.
    """
    order = [True, False]
    random.Random(name).shuffle(order)
    return order[0], order[1]


def _both(job: Job, start: Start, built_in: Record, latency_s: float, repeat: int) -> _Found:
    name = f"{job.seed} {start.hash} {job.driver.shown} {latency_s:g} {repeat}"
    order = order_of(name)
    drives = {event: _run(start, job.driver, latency_s, event=event) for event in order}
    driven, free = drives[True], drives[False]
    outcome = free.outcome if free.outcome.kind == "harness" else driven.outcome
    return _Found(
        outcome,
        chain_of(driven.driven, driven.record, driven.outcome),
        severity_facts(
            driven.run,
            driven.driven,
            driven.record.reports,
            driven.result,
            driven.outcome.contact,
            driven.outcome.at_s,
        ),
        needless_in(free.run, free.driven, free.record, built_in, free.outcome),
        tuple(texts_of(driven.driven, driven.record.reports, driven.outcome.at_s)),
    )


@lru_cache(maxsize=2)
def _careful(text: str) -> _Found:
    """Return the careful driver's run, which has no latency, on the objects of the oracle's."""
    start, _ = _start(text)
    oracle = drive_start(start, CampaignDriver(driver="oracle"), 0.0)
    outcome, reports = careful_motion(start, oracle.record)
    severity = severity_facts(
        oracle.run, oracle.driven, reports, None, outcome.contact, outcome.at_s
    )
    return _Found(outcome, chain_of(oracle.driven, Record(reports), outcome), severity, "")


def identity_of(job: Job) -> list[Row]:
    """Return the columns of each of a job's rows that say which run it is."""
    facts = json.loads(job.start)
    of_start = [str(facts[name]) for name in ("event", "seed", "hash", "kind")]
    return [
        [*of_start, job.driver.shown, f"{latency_s:g}", str(repeat)]
        for latency_s, repeat in product(job.latencies_s, range(job.repeats))
    ]


@dataclass(frozen=True, slots=True)
class Drove:
    """One drive of a driver on a start."""

    run: RunSpec
    driven: Driven
    result: InProcessResult
    record: Record
    outcome: Outcome


def _run(start: Start, driver: CampaignDriver, latency_s: float, *, event: bool) -> Drove:
    """Drive once, and again while our side failed (METHOD 8.7)."""
    for _ in range(1 + _HARNESS_REPEATS):
        drove = drive_start(start, driver, latency_s, event=event)
        if drove.outcome.kind != "harness":
            break
    return drove


def drive_start(
    start: Start, driver: CampaignDriver, latency_s: float, *, event: bool = True
) -> Drove:
    """Drive one driver on a start once.

    Args:
        start: with its twin.
        driver: of the campaign.
        latency_s: L.
        event: False: the event-free twin.
    """
    run = start.driven_by(driver.driver, driver.options, latency_s, event=event)
    if run.driven is None:
        raise ValueError("a driven run is driven by somebody")
    result, record = run_in_process(run)
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    return Drove(run, run.driven, result, record, outcome)


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
    drove = drive_start(start, CampaignDriver(driver=BUILT_IN), 0.0, event=False)
    return start, drove.record
