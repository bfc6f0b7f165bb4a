"""The runs of a campaign: one driver on one start, in the event and in its event-free twin."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

from ssp_core.world.driver import BUILT_IN
from ssp_scenario_manager.closed_loop.needless import needless_in
from ssp_scenario_manager.closed_loop.outcome import Outcome, outcome_of, severity_of
from ssp_scenario_manager.closed_loop.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.start import Start, from_facts
from ssp_scenario_manager.closed_loop.tables import Row, one_line, shown
from ssp_scenario_manager.run.in_process import Record, run_in_process

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
        for driver in plan.everybody:
            yield Job(text, driver, tuple(plan.latencies_s), plan.repeats, plan.seed)


def rows_of(job: Job) -> list[Row]:
    """Drive one driver on one start, in the event and in its event-free twin."""
    start, built_in = _start(job.start)
    identity = identity_of(job)
    rows: list[Row] = []
    for latency_s in job.latencies_s:
        for repeat in range(job.repeats):
            # In seeded random order: a driver can't tell from it which is the event.
            order = [True, False]
            name = f"{job.seed} {start.hash} {job.driver.shown} {latency_s:g} {repeat}"
            random.Random(name).shuffle(order)
            found = {event: _run(start, job.driver, latency_s, event=event) for event in order}
            outcome = found[True][0]
            free_outcome, free_record = found[False]
            if free_outcome.kind == "harness":
                outcome = free_outcome
            free = start.driven_by(job.driver.driver, job.driver.options, latency_s, event=False)
            if free.driven is None:
                raise ValueError("a driven run is driven by somebody")
            needless = needless_in(free, free.driven, free_record, built_in, free_outcome.at_s)
            v_i_mps = None if outcome.contact is None else outcome.contact.relative_mps
            rows.append(
                [
                    *identity[len(rows)],
                    *(outcome.kind, shown(outcome.at_s), one_line(outcome.why)),
                    *map(shown, (v_i_mps, start.v_r_mps, severity_of(outcome, start.v_r_mps))),
                    *map(shown, (outcome.response_s, outcome.unled_s)),
                    str(outcome.starved).lower(),
                    one_line(needless),
                ]
            )
    return rows


def identity_of(job: Job) -> list[Row]:
    """Return the columns of each of a job's rows that say which run it is."""
    facts = json.loads(job.start)
    of_start = [str(facts[name]) for name in ("event", "seed", "hash", "kind")]
    return [
        [*of_start, job.driver.shown, f"{latency_s:g}", str(repeat)]
        for latency_s, repeat in product(job.latencies_s, range(job.repeats))
    ]


def _run(
    start: Start, driver: CampaignDriver, latency_s: float, *, event: bool
) -> tuple[Outcome, Record]:
    """Drive once, and again while our side failed (METHOD 8.7)."""
    for _ in range(1 + _HARNESS_REPEATS):
        outcome, record = drive_start(start, driver, latency_s, event=event)
        if outcome.kind != "harness":
            break
    return outcome, record


def drive_start(
    start: Start, driver: CampaignDriver, latency_s: float, *, event: bool = True
) -> tuple[Outcome, Record]:
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
    return outcome_of(run, run.driven, result, record, start.twin), record


@lru_cache(maxsize=2)
def _start(text: str) -> tuple[Start, Record]:
    """Return a sealed start with its twin, and the built-in driver's event-free run."""
    start = from_facts(json.loads(text))
    _, record = drive_start(start, CampaignDriver(driver=BUILT_IN), 0.0, event=False)
    return start, record
