"""An ablation: jobs of one arm on one place, in processes that share them, resumable.

The source's own place comes first: where an arm doesn't keep the event there, nothing else is run.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import ssp_core
import ssp_eval
import ssp_ot_controller
import ssp_scenario_manager
from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping
from ssp_core.files.writing import write_json, write_text
from ssp_core.hashing import sha256_file, sha256_sources
from ssp_core.run_file.model import RunSpec
from ssp_eval.ablation.ground import (
    SOURCE_PLACE,
    Frame,
    Ground,
    NoRun,
    Trials,
    frame_of,
    ground_of,
    run_of,
    session,
    share_of,
    source_ground,
    varied,
)
from ssp_eval.ablation.judge import Judgement, judge_trial
from ssp_eval.ablation.relations import by_relations
from ssp_eval.ablation.source import (
    Relations,
    Tracks,
    cast_of,
    read_source,
    relations_of,
    tracks_of,
)
from ssp_eval.ablation.structure import by_structure
from ssp_eval.ablation.tracks import by_tracks
from ssp_eval.audit.evidence.recording import ROAD_WORDS
from ssp_eval.data.audit import FIELDS
from ssp_scenario_manager.closed_loop.outcomes.tables import Row, cell, lines_of, rows_there
from ssp_scenario_manager.compile.compiler import checked_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.ordered_map import ordered_map
from ssp_scenario_manager.scenarios.events.kinds import KINDS

Arm = Literal["structure", "relations", "tracks"]
ARMS: tuple[Arm, ...] = ("structure", "relations", "tracks")
PLAN_FILE, ROWS_FILE = "ablation.json", "realisations.csv"
SCHEMA = "ssp.ablation/1"
COLUMNS = [
    *("place", "arm", "seed", "share", "block", "compiled", "verdict", "valid", "off_spec"),
    *FIELDS,
    *("located", "kpr", "epd", "time_gap_s", "admitted", "why"),
]
_YES_OR_NO = ("compiled", "valid", "off_spec", *FIELDS, "located", "admitted")
_NUMBERS = ("kpr", "epd", "time_gap_s")
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")
# The positive control: an arm below it at the source's own place can't play the event at all.
LEAST_KPR = 0.9
_SOUND = frozenset({"valid", "off_spec"})
_PACKAGES = (ssp_core, ssp_eval, ssp_ot_controller, ssp_scenario_manager)


class ControlFailed(InputError):
    """An arm doesn't keep the event at the source's own place, so that nothing is compared."""


@dataclass(frozen=True)
class Plan:
    """An ablation.

    Args:
        event: name or file of K*.
        sites: names or files.
        maps: files.
        source: recording of the source; None: the clip generator's ground truth.
        realisations: per arm, spread over the places.
        seed: first one of each place.
    """

    event: str
    sites: tuple[str, ...]
    maps: tuple[Path, ...]
    source: Path | None = None
    realisations: int = 100
    seed: int = 1

    @property
    def places(self) -> list[tuple[str | None, Path | None]]:
        """Return sites and maps, in this order, as ``ground_of`` takes them."""
        return [*((site, None) for site in self.sites), *((None, path) for path in self.maps)]


@dataclass(frozen=True)
class Job:
    """An arm on a place.

    Args:
        place: site and map as ``Plan.places`` has them; None: the source's own.
        seeds: of the realisations.
    """

    plan: Plan
    arm: Arm
    place: tuple[str | None, Path | None] | None
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class Realisation:
    """A row of ``realisations.csv``.

    Args:
        judgement: None: the arm made no run for the place.
    """

    place: str
    arm: str
    seed: int
    compiled: bool
    judgement: Judgement | None
    why: str


def control_jobs(plan: Plan) -> list[Job]:
    """Return the positive control of each arm: nothing is varied."""
    return [Job(plan, arm, None, (0,)) for arm in ARMS]


def place_jobs(plan: Plan) -> list[Job]:
    """Return the jobs on the places; the k-th realisation is on place k modulo their number."""
    places, jobs = plan.places, []
    for number, place in enumerate(places):
        count = len(range(number, plan.realisations, len(places)))
        seeds = tuple(range(plan.seed, plan.seed + count))
        jobs += [Job(plan, arm, place, seeds) for arm in ARMS if seeds]
    return jobs


def rows_of(job: Job) -> list[Row]:
    """Let an arm make its run for a place, and realise it by each seed."""
    event, version, _ = checked_event(job.plan.event)
    source = read_source(event, job.plan.source)
    ground = source_ground(source.road, event)
    if job.place is not None:
        ground = ground_of(*job.place, event)
    try:
        run, block = _run_of_arm(job, event, version, ground)
    except NoRun as error:
        rest = [""] * (len(COLUMNS) - 7)
        return [
            [*_head(job, ground, seed), "", "false", *rest, cell(str(error))] for seed in job.seeds
        ]
    about = next(one for one in ground.blocks if one.block_id == block)
    words = {name: str(getattr(about, name)) for name in ROAD_WORDS}
    words = {name: word for name, word in words.items() if word != "any"}
    rows = []
    for seed in job.seeds:
        judgement = judge_trial(event, run.road, words, session(varied(run, seed)))
        rows.append([*_head(job, ground, seed), block, "true", *_cells(judgement)])
    return rows


def _run_of_arm(job: Job, event: Event, version: str, ground: Ground) -> tuple[RunSpec, str]:
    """Let an arm make its run; each is given what it may know, and nothing else."""
    if job.arm == "structure":
        return by_structure(event, version, ground)
    cast, fixed = cast_of(event), frame_of(event, version)
    source = read_source(event, job.plan.source)
    knowledge = relations_of(source, cast) if job.arm == "relations" else tracks_of(source, cast)
    return unstructured(knowledge, fixed, ground)


def unstructured(
    knowledge: Relations | Tracks, fixed: Frame, ground: Ground
) -> tuple[RunSpec, str]:
    """Return the run of an arm without structure, and the block.

    Args:
        knowledge: all that the arm knows of the event.
        fixed: what judge and executor need, which the arm doesn't read.
        ground: the place.

    Raises:
        NoRun: the arm makes none.
    """
    trials = Trials(fixed, ground)
    if isinstance(knowledge, Relations):
        answer = by_relations(knowledge, ground, trials)
    else:
        answer = by_tracks(knowledge, ground, trials)
    return run_of(fixed, ground, answer), answer.block.block_id


def _head(job: Job, ground: Ground, seed: int) -> Row:
    return [ground.name, job.arm, str(seed), cell(share_of(seed))]


def _cells(judgement: Judgement) -> Row:
    return [
        judgement.verdict,
        cell(judgement.valid),
        cell(judgement.off_spec),
        *(cell(judgement.retention.get(name)) for name in FIELDS),
        cell(judgement.located),
        cell(judgement.kpr),
        cell(judgement.epd),
        cell(judgement.time_gap_s),
        cell(judgement.admitted),
        cell(judgement.why),
    ]


def read_realisation(row: Row) -> Realisation:
    """Return a row as it was judged.

    Raises:
        ValueError: it has other columns.
    """
    one = dict(zip(COLUMNS, row, strict=True))
    head = (one["place"], one["arm"], int(one["seed"]))
    if one["compiled"] != "true":
        return Realisation(*head, False, None, one["why"])

    def number(name: str) -> float | None:
        return float(one[name]) if one[name] else None

    judgement = Judgement(
        verdict=one["verdict"],
        off_spec=one["off_spec"] == "true",
        retention={name: one[name] == "true" for name in FIELDS if one[name]},
        kpr=number("kpr"),
        epd=number("epd"),
        located=one["located"] == "true",
        time_gap_s=number("time_gap_s"),
        admitted=one["admitted"] == "true",
        why=one["why"],
    )
    return Realisation(*head, True, judgement, one["why"])


def run_ablation(
    plan: Plan, folder: Path, jobs: int, on_rows: Callable[[int, int], None]
) -> list[Realisation]:
    """Run an ablation, or what is left of it; return its realisations, the control's first.

    Args:
        plan: the ablation.
        folder: new, or of the same ablation.
        jobs: processes that share the work.
        on_rows: is given how many realisations are done, and of how many.

    Raises:
        ControlFailed: an arm doesn't keep the event at the source's own place.
        InputError: the folder holds something else, or a file isn't valid.
    """
    sealed = sealed_plan(plan)
    _claim(folder, sealed)
    control, todo = control_jobs(plan), place_jobs(plan)
    path = folder / ROWS_FILE
    names = [SOURCE_PLACE] * len(control)
    names += [name for name, _ in sealed["places"] for _ in ARMS]
    rows = _whole_jobs(rows_there(path), [*control, *todo], names, path)
    write_text(path, lines_of([COLUMNS, *rows]))
    total = sum(len(job.seeds) for job in (*control, *todo))
    on_rows(len(rows), total)
    for part in (control, todo):
        left = _left(rows, [*control, *todo], part)
        with (
            ordered_map(min(jobs, max(len(left), 1))) as run_all,
            path.open("a", newline="") as stream,
        ):
            for job_rows in run_all(rows_of, left):
                stream.write(lines_of(job_rows))
                stream.flush()
                rows += job_rows
                on_rows(len(rows), total)
        check_control([read_realisation(row) for row in rows[: len(control)]])
    return [read_realisation(row) for row in rows]


def check_control(realisations: Sequence[Realisation]) -> None:
    """Refuse a comparison of arms that don't keep the event at the source's own place.

    Args:
        realisations: of the positive control.

    Raises:
        ControlFailed: one has KPR below LEAST_KPR, an unsound session, a phase that isn't located,
            an event that isn't admitted, or no run.
    """
    failed = []
    for one in realisations:
        judgement = one.judgement
        kpr = None if judgement is None else judgement.kpr
        if judgement is None or kpr is None:
            shortfall = "no KPR"
        elif kpr < LEAST_KPR:
            shortfall = f"KPR {kpr:.2f}"
        elif judgement.verdict not in _SOUND:
            shortfall = f"verdict {judgement.verdict}"
        elif not judgement.located:
            shortfall = "a phase that isn't located"
        elif not judgement.admitted:
            shortfall = "an event that isn't admitted"
        else:
            continue
        failed.append(f"{one.arm} has {shortfall} ({one.why or 'nothing was measured'})")
    if failed:
        raise ControlFailed(
            f"no table: at {SOURCE_PLACE} each arm must end soundly, with each phase located and "
            f"KPR {LEAST_KPR:g} or more, and be admitted; {'; '.join(failed)}",
            remedy="the arms can't be compared on this event; name another source with --source",
        )


def sealed_plan(plan: Plan) -> dict[str, Any]:
    """Return what an ablation's folder is of: plan, files by their hashes, and sources."""
    event, version, _ = checked_event(plan.event)
    if KINDS[event.interaction.type].at_junction:
        raise InputError(
            "takes place at a junction, and the arms without structure know no routes through one",
            file=plan.event,
            field="interaction.type",
            value=event.interaction.type,
            remedy="give an event of the open road: "
            + ", ".join(name for name, kind in sorted(KINDS.items()) if not kind.at_junction),
        )
    # What can't be read is told before a folder is claimed.
    read_source(event, plan.source)
    grounds = [ground_of(*place, event) for place in plan.places]
    names = [ground.name for ground in grounds]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"stands twice: {', '.join(twice)}",
            field="--sites, --maps",
            remedy="name each place once; places are told apart by their names",
        )
    sources = {
        package.__name__: sha256_sources(Path(next(iter(package.__path__))))
        for package in _PACKAGES
    }
    return {
        "schema": SCHEMA,
        "version": __version__,
        "sources": sources,
        "event": event.name,
        "event_version": version,
        "places": [[ground.name, ground.area.link.sha256] for ground in grounds],
        "source": None if plan.source is None else _hash_of(plan.source),
        "realisations": plan.realisations,
        "seed": plan.seed,
    }


def _hash_of(source: Path) -> str:
    files = [source] if source.is_file() else sorted(source.rglob("*.mcap"))
    return " ".join(sha256_file(file) for file in files)


def _claim(folder: Path, sealed: Mapping[str, Any]) -> None:
    """Take a new folder for an ablation, or find that it is this one's."""
    path = folder / PLAN_FILE
    if path.is_file():
        there = read_mapping(path)
        changed = [name for name in sealed if there.get(name) != sealed[name]]
        if changed:
            raise InputError(
                f"is of another ablation: {', '.join(changed)} differ",
                file=path,
                field=changed[0],
                remedy="name a new folder with --out",
            )
        return
    if any(not entry.name.startswith(".") for entry in folder.iterdir()):
        raise InputError(
            "holds something else than an ablation",
            file=folder,
            remedy="name a new folder with --out",
        )
    write_json(path, json.loads(json.dumps(sealed)))


def _whole_jobs(
    rows: Sequence[Row], jobs: Sequence[Job], names: Sequence[str], path: Path
) -> list[Row]:
    """Return the rows of jobs that were finished; a job that was cut off is run again."""
    whole_rows: list[Row] = []
    for job, name in zip(jobs, names, strict=False):
        part = list(rows[len(whole_rows) : len(whole_rows) + len(job.seeds)])
        if len(part) < len(job.seeds):
            break
        for line, (seed, row) in enumerate(zip(job.seeds, part, strict=True), len(whole_rows) + 2):
            if len(row) != len(COLUMNS) or row[:3] != [name, job.arm, str(seed)]:
                raise InputError(
                    "holds another ablation's realisation",
                    file=path,
                    line=line,
                    remedy="name a new folder with --out",
                )
            wrong = _wrong_column(row)
            if wrong is not None:
                raise InputError(
                    "is not what an ablation writes",
                    file=path,
                    line=line,
                    field=wrong,
                    value=row[COLUMNS.index(wrong)],
                    remedy="remove this line and all below it, so that they are made again",
                )
        whole_rows += part
    return whole_rows


def _wrong_column(row: Row) -> str | None:
    """Return the column that holds what no realisation has; None: each is readable."""
    one = dict(zip(COLUMNS, row, strict=True))
    for name in (*_YES_OR_NO, *_NUMBERS):
        is_readable = (
            one[name] in ("true", "false") if name in _YES_OR_NO else _NUMBER.fullmatch(one[name])
        )
        if one[name] and not is_readable:
            return name
    return None


def _left(rows: Sequence[Row], jobs: Sequence[Job], part: Sequence[Job]) -> list[Job]:
    end_row, left = 0, []
    for job in jobs:
        end_row += len(job.seeds)
        if end_row > len(rows) and job in part:
            left.append(job)
    return left
