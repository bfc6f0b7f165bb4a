"""A campaign: starts that are sealed before a driver runs, then one row per run, resumable."""

from __future__ import annotations

import csv
import io
import json
import random
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice, product
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files import make_folder, parse_model, write_json, write_text
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import BUILT_IN
from ssp_scenario_manager.closed_loop.needless import needless_in
from ssp_scenario_manager.closed_loop.outcome import OUTCOMES, outcome_of, severity_of
from ssp_scenario_manager.closed_loop.plan_file import ZERO, CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.rates import Rates, RunRow, rates_of, refused_for, rising
from ssp_scenario_manager.closed_loop.single import MOST_SEEDS
from ssp_scenario_manager.closed_loop.start import (
    OffSpec,
    Start,
    from_facts,
    make_start,
)
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import Record, run_in_process
from ssp_scenario_manager.run.result import rounded
from ssp_scenario_manager.run.sweep import ordered_map

PLAN_FILE, TASKS_FOLDER = "plan.json", "tasks"
STARTS_FILE, RUNS_FILE, TABLE_FILE = "starts.json", "runs.csv", "table.csv"
STARTS_SCHEMA = "ssp.loop_starts/1"
KINDS = ("critical", "harmless", "unavoidable")
# A run that our side failed is repeated at most so often.
_HARNESS_REPEATS = 2
_MOST_WHY = 300  # characters of a row's reason
Row = list[str]

_HEADER = [
    *("event", "seed", "start", "kind", "driver", "latency_s", "repeat"),
    *("outcome", "outcome_s", "why", "v_i_mps", "v_r_mps", "severity"),
    *("response_s", "unled_s", "starved", "needless"),
]
_TABLE = [
    *("event", "driver", "privileged", "latency_s", "planned", "driven"),
    *("headline", "low", "high", "worst"),
    *OUTCOMES,
    *("needless", "starved"),
]


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


# -- starts ----------------------------------------------------------------------------------------


def draw_starts(
    plan: LoopPlan, folder: Path, jobs: int, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return the sealed starts of a campaign, drawn unless they are there.

    Args:
        plan: the campaign.
        folder: of it.
        jobs: processes that share the work.
        say: takes the shares of starts, for people.

    Raises:
        InputError: the folder holds another campaign, or an event has too few critical starts.
    """
    sealed = {
        "version": __version__,
        "plan": sha256_json(plan.model_dump(mode="json", by_alias=True)),
    }
    _claim(folder, sealed)
    path = folder / STARTS_FILE
    if path.is_file():
        there = json.loads(path.read_text())
        if there.get("hash") != sha256_json(there.get("starts")):
            raise InputError(
                "was changed after it was sealed", file=path, remedy="name a new folder with --out"
            )
        return list(there["starts"])
    # Tasks of a call that was cut off before the seal may be half written.
    shutil.rmtree(folder / TASKS_FOLDER, ignore_errors=True)
    starts = []
    for number, event in enumerate(plan.events):
        draft = folder / TASKS_FOLDER / str(number)
        starts += _starts_of(plan, event, draft, jobs, say)
    kept = {"schema": STARTS_SCHEMA, "starts": starts}
    write_json(path, {**kept, "hash": sha256_json(starts)})
    return starts


def _claim(folder: Path, sealed: Mapping[str, str]) -> None:
    """Take a new folder for a campaign, or find that it is this campaign's.

    Raises:
        InputError: it is another campaign's, or holds something else.
    """
    path = folder / PLAN_FILE
    if path.is_file():
        if json.loads(path.read_text()) != sealed:
            raise InputError(
                "is of another campaign, or of another version of this software",
                file=path,
                remedy="name a new folder with --out",
            )
        return
    if any(not entry.name.startswith(".") for entry in folder.iterdir()):
        raise InputError(
            "holds something else than a campaign",
            file=folder,
            remedy="name a new folder with --out",
        )
    write_json(path, dict(sealed))


def _starts_of(
    plan: LoopPlan, event: str, draft: Path, jobs: int, say: Callable[[str], None]
) -> list[dict[str, Any]]:
    prepare_run(event, plan.site, make_folder(draft), seed=plan.seed, mode="lockstep")
    run = parse_model(
        RunSpec, json.loads((draft / TASK_FOLDER / "task.json").read_text())["run"], draft
    )
    event_file = str(draft / TASK_FOLDER / EVENT_FILE)
    judge = partial(_drawn, run.model_dump_json(by_alias=True), event_file, max(plan.latencies_s))
    kept: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    seen = dict.fromkeys((*KINDS, "off_spec"), 0)
    most = {"critical": plan.starts, "harmless": plan.others, "unavoidable": plan.others}
    seeds = iter(range(plan.seed, plan.seed + MOST_SEEDS * plan.starts))
    with ordered_map(jobs) as run_all:
        while len(kept["critical"]) < plan.starts:
            batch = list(islice(seeds, max(jobs, 1)))
            if not batch:
                break
            for kind, facts in run_all(judge, batch):
                if len(kept["critical"]) >= plan.starts:
                    break
                seen[kind] += 1
                if kind in kept and len(kept[kind]) < most[kind]:
                    kept[kind].append({"event": event, "kind": kind, **facts})
    shares = ", ".join(f"{count} {kind}" for kind, count in seen.items())
    say(f"starts of {event}, by seed from {plan.seed} on: {shares}")
    if len(kept["critical"]) < plan.starts:
        raise InputError(
            f"has {len(kept['critical'])} critical starts among {sum(seen.values())} seeds",
            field="starts",
            value=plan.starts,
            remedy="ask for fewer, for smaller latencies, or for a place with a longer run-up",
        )
    return [start for kind in KINDS for start in kept[kind]]


def _drawn(
    run_json: str, event_file: str, latency_max_s: float, seed: int
) -> tuple[str, dict[str, Any]]:
    """Return the kind of a seed's start (METHOD 8.1) and its facts; ``off_spec`` with a reason."""
    run = RunSpec.model_validate_json(run_json)
    try:
        start = make_start(run, load_event(event_file)[0], seed, latency_max_s)
    except OffSpec as error:
        return "off_spec", {"seed": seed, "why": str(error)}
    facts = {
        **start.facts(),
        "hash": start.hash,
        "run": start.run.model_dump(mode="json", by_alias=True),
    }
    if start.contact is None:
        return "harmless", facts
    outcome, _ = _driven(start, CampaignDriver(driver="oracle"), 0.0)
    return ("unavoidable" if outcome.contact is not None else "critical"), facts


# -- runs ------------------------------------------------------------------------------------------


def run_campaign(
    plan: LoopPlan,
    folder: Path,
    jobs: int,
    on_row: Callable[[int], None],
    say: Callable[[str], None],
) -> tuple[list[Rates], list[str]]:
    """Run a campaign, or what is left of it; return the rates, and why it is refused.

    Args:
        plan: the campaign.
        folder: new, or of the same campaign.
        jobs: processes that share the work.
        on_row: is given how many runs there are in all, for each one that is done.
        say: takes what doesn't end it, for people.

    Raises:
        InputError: as ``draw_starts``, or ``runs.csv`` is of another campaign.
    """
    starts = draw_starts(plan, folder, jobs, say)
    todo = list(_jobs(plan, starts))
    per_job = len(plan.latencies) * plan.repeats
    path = folder / RUNS_FILE
    rows = _rows_there(path)
    # A job that was cut off is run again as a whole.
    rows = rows[: len(rows) // per_job * per_job]
    _check_rows(path, rows, todo, per_job)
    write_text(path, _lines([_HEADER, *rows]))
    total = len(todo) * per_job
    for _ in rows:
        on_row(total)
    with ordered_map(min(jobs, len(todo))) as run_all, path.open("a", newline="") as stream:
        for done in run_all(_rows_of, todo[len(rows) // per_job :]):
            stream.write(_lines(done))
            stream.flush()
            rows += done
            for _ in done:
                on_row(total)
    rates = rates_of([_read(row) for row in rows])
    knowing = {one.shown for one in plan.everybody if one.is_privileged}
    table = [_table_row(one, one.driver in knowing) for one in rates]
    write_text(folder / TABLE_FILE, _lines([_TABLE, *table]))
    for text in rising(rates, ("oracle", "aeb")):
        say(f"gets better with latency: {text}")
    return rates, refused_for(rates, ZERO)


def _jobs(plan: LoopPlan, starts: Sequence[Mapping[str, Any]]) -> Iterator[Job]:
    for start in starts:
        text = json.dumps(start, sort_keys=True)
        for driver in plan.everybody:
            yield Job(text, driver, tuple(plan.latencies_s), plan.repeats, plan.seed)


def _rows_of(job: Job) -> list[Row]:
    """Drive one driver on one start, in the event and in its event-free twin."""
    start, built_in = _start(job.start)
    identity = _identity(job)
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
                    *(outcome.kind, _shown(outcome.at_s), _short(outcome.why)),
                    *map(_shown, (v_i_mps, start.v_r_mps, severity_of(outcome, start.v_r_mps))),
                    *map(_shown, (outcome.response_s, outcome.unled_s)),
                    str(outcome.starved).lower(),
                    _short(needless),
                ]
            )
    return rows


def _run(
    start: Start, driver: CampaignDriver, latency_s: float, *, event: bool
) -> tuple[Any, Record]:
    """Drive once, and again while our side failed (METHOD 8.7)."""
    for _ in range(1 + _HARNESS_REPEATS):
        outcome, record = _driven(start, driver, latency_s, event=event)
        if outcome.kind != "harness":
            break
    return outcome, record


def _driven(
    start: Start, driver: CampaignDriver, latency_s: float, *, event: bool = True
) -> tuple[Any, Record]:
    run = start.driven_by(driver.driver, driver.options, latency_s, event=event)
    if run.driven is None:
        raise ValueError("a driven run is driven by somebody")
    result, record = run_in_process(run)
    return outcome_of(run, run.driven, result, record, start.twin), record


@lru_cache(maxsize=2)
def _start(text: str) -> tuple[Start, Record]:
    """Return a sealed start with its twin, and the built-in driver's event-free run."""
    start = from_facts(json.loads(text))
    _, record = _driven(start, CampaignDriver(driver=BUILT_IN), 0.0, event=False)
    return start, record


# -- files -----------------------------------------------------------------------------------------


def _rows_there(path: Path) -> list[Row]:
    """Return the rows that an earlier call left, without one that was cut off."""
    if not path.is_file():
        return []
    text = path.read_bytes().decode(errors="replace")
    return list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))[1:]


def _check_rows(path: Path, rows: Sequence[Row], todo: Sequence[Job], per_job: int) -> None:
    for i, row in enumerate(rows):
        job = todo[i // per_job] if i // per_job < len(todo) else None
        wanted = [] if job is None else _identity(job)[i % per_job]
        if len(row) != len(_HEADER) or row[: len(wanted)] != wanted or row[7] not in OUTCOMES:
            raise InputError(
                "holds another campaign's run",
                file=path,
                line=i + 2,
                remedy="name a new folder with --out",
            )


def _identity(job: Job) -> list[Row]:
    """Return the columns of each of a job's rows that say which run it is."""
    facts = json.loads(job.start)
    of_start = [str(facts[name]) for name in ("event", "seed", "hash", "kind")]
    return [
        [*of_start, job.driver.shown, f"{latency_s:g}", str(repeat)]
        for latency_s, repeat in product(job.latencies_s, range(job.repeats))
    ]


def _short(text: str) -> str:
    """Return a text as one line of bounded length: a driver's error may be anything."""
    return " ".join(text.split())[:_MOST_WHY]


def _lines(rows: Sequence[Row]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def _shown(value: float | None) -> str:
    kept = rounded(value)
    return "" if kept is None else str(kept)


def _read(row: Row) -> RunRow:
    one = dict(zip(_HEADER, row, strict=True))
    return RunRow(
        one["event"],
        one["start"],
        one["driver"],
        float(one["latency_s"]),
        one["kind"],
        one["outcome"],
        one["needless"],
        one["starved"] == "true",
    )


def _table_row(one: Rates, is_privileged: bool) -> Row:
    return [
        one.event,
        one.driver,
        str(is_privileged).lower(),
        f"{one.latency_s:g}",
        str(one.planned),
        str(one.driven),
        *map(_shown, (one.headline, one.low, one.high, one.worst)),
        *map(str, (*one.outcomes, one.needless, one.starved)),
    ]
