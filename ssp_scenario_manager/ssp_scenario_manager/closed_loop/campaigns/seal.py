"""The starts of a campaign, drawn and sealed before a driver runs (METHOD 8.1, 8.7)."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import InputError, SspError
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import parse_model
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_json, sha256_sources
from ssp_core.run_file.latency import ZERO_LATENCY
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.closed_loop.campaigns.forms import SealedStarts, check_form, read_sealed
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.runs import TASKS_FOLDER, drive_start
from ssp_scenario_manager.closed_loop.outcomes.rates import KINDS
from ssp_scenario_manager.closed_loop.single_run.single import MOST_SEEDS
from ssp_scenario_manager.closed_loop.starts.start import (
    OffSpec,
    ShortRunUp,
    left_out_of,
    make_start,
)
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FOLDER, load_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.ordered_map import Engine, ordered_map

PLAN_FILE, STARTS_FILE = "plan.json", "starts.json"
STARTS_SCHEMA = "ssp.loop_starts/6"
# Their sources decide how a run goes and what it is rated.
_PACKAGES = (
    "ssp_core",
    "ssp_ot_controller",
    "ssp_scenario_manager",
    "ssp_vla_bridge",
    "ssp_eval.evaluate",
)
_OTHER = {
    "version": "is of another version of this software",
    "sources": "is of other sources of this software, under the same version",
    "plan": "is of another campaign",
}
# Seeds that give no start.
_OFF_SPEC, _SHORT = "off_spec", "short_run_up"
_DRAWN = (*KINDS, _OFF_SPEC, _SHORT)


@dataclass(frozen=True, slots=True)
class Draw:
    """The seeds that were drawn for the starts of an event, counted by what they gave.

    Args:
        event: as the plan names it.
        first_seed: from which seeds count up.
        critical: starts of this kind, also those that aren't run.
        harmless: likewise.
        unavoidable: likewise.
        off_spec: seeds whose event isn't K*'s.
        short_run_up: seeds whose place has no room for the hand-over before the event; the larger
            the largest latency, the more.
        left_out: parts of the compiled run that its driven runs have none of.
    """

    event: str
    first_seed: int
    critical: int
    harmless: int
    unavoidable: int
    off_spec: int
    short_run_up: int
    left_out: list[str]

    @property
    def words(self) -> str:
        """The shares in words."""
        counts = {kind: getattr(self, kind) for kind in _DRAWN}
        total = sum(counts.values())
        shares = [f"{n} {kind} ({100 * n / total:.0f} %)" for kind, n in counts.items()]
        return f"{', '.join(shares)}, of {total} drawn by seed from {self.first_seed} on"


def draw_starts(
    plan: LoopPlan,
    folder: Path,
    jobs: int,
    say: Callable[[str], None],
    engine: Engine = "processes",
) -> list[dict[str, Any]]:
    """Return the sealed starts of a campaign, drawn unless they are there.

    Args:
        plan: the campaign.
        folder: of it.
        jobs: workers that share the work.
        say: takes the shares of starts, also of those that are there, for people.
        engine: where the workers are.

    Raises:
        InputError: the folder holds another campaign, or an event doesn't fit the site or has too
            few critical starts, which leaves no campaign.
    """
    sealed = {**software(), "plan": plan.model_dump(mode="json", by_alias=True)}
    _claim(folder, sealed)
    path = folder / STARTS_FILE
    if path.is_file():
        starts = sealed_starts(folder)
        for draw in sealed_draws(folder):
            _tell(draw, say)
        return starts
    # Tasks of a call that was cut off before the seal may be half written.
    shutil.rmtree(folder / TASKS_FOLDER, ignore_errors=True)
    starts, draws = [], []
    try:
        for number, event in enumerate(plan.events):
            draft = folder / TASKS_FOLDER / str(number)
            event_starts, draw = _starts_of(plan, event, draft, say, jobs, engine)
            starts += event_starts
            draws.append(asdict(draw))
        content = {"starts": starts, "drawn": draws}
        write_json(path, {"schema": STARTS_SCHEMA, **content, "hash": sha256_json(content)})
    except SspError:
        # Nothing is sealed: the mended plan may take the same folder.
        shutil.rmtree(folder / TASKS_FOLDER, ignore_errors=True)
        (folder / PLAN_FILE).unlink()
        raise
    return starts


def sealed_starts(folder: Path) -> list[dict[str, Any]]:
    """Return the starts of a campaign as they were sealed.

    Raises:
        InputError: there are none, they were changed since, or they are of another schema, by which
            other things of a start were drawn.
    """
    return list(_sealed_starts(folder)["starts"])


def sealed_draws(folder: Path) -> list[Draw]:
    """Return what the seeds of each event of a campaign gave, in the order of the plan.

    Raises:
        InputError: as ``sealed_starts``.
    """
    return [Draw(**one) for one in _sealed_starts(folder)["drawn"]]


def _sealed_starts(folder: Path) -> dict[str, Any]:
    path = folder / STARTS_FILE
    there = read_sealed(path)
    if there.get("schema") != STARTS_SCHEMA:
        raise InputError(
            f"must be {STARTS_SCHEMA}",
            file=path,
            field="schema",
            value=there.get("schema"),
            remedy="use the version of this software that drew these starts, or drive the campaign "
            "anew",
        )
    content: dict[str, Any] = {name: there[name] for name in ("starts", "drawn") if name in there}
    check_form(SealedStarts, content, path)
    if there.get("hash") != sha256_json(content):
        raise InputError(
            "was changed after it was sealed", file=path, remedy="name a new folder with --out"
        )
    return content


def sealed_plan(folder: Path) -> tuple[LoopPlan, str]:
    """Return the plan of a campaign, and the version of the software that began it.

    Raises:
        InputError: it is no campaign's folder.
    """
    path = folder / PLAN_FILE
    there = read_sealed(path)
    return parse_model(LoopPlan, there.get("plan"), path), str(there.get("version", ""))


def check_sources(folder: Path) -> None:
    """Refuse a campaign that other sources of this software began: they drive other runs.

    Raises:
        InputError: it is one, or no campaign's folder.
    """
    path = folder / PLAN_FILE
    there, ours = read_sealed(path), software()
    for name, value in ours.items():
        if there.get(name) != value:
            raise InputError(
                _OTHER[name],
                file=path,
                field=name,
                remedy="use the software that drove it, or drive the campaign anew",
            )


def software() -> dict[str, Any]:
    """Return what decides how a run goes: the version, and the hashes of the sources."""
    return {"version": __version__, "sources": _sources()}


def _sources() -> dict[str, str]:
    """Return the hash of the sources of each package that decides how a run goes."""
    hashes = {}
    for name in _PACKAGES:
        spec = importlib.util.find_spec(name)
        for place in () if spec is None else spec.submodule_search_locations or ():
            hashes[name] = sha256_sources(Path(place))
    return hashes


def _claim(folder: Path, sealed: Mapping[str, Any]) -> None:
    """Take a new folder for a campaign, or find that it is this campaign's.

    Raises:
        InputError: it is another campaign's, or holds something else.
    """
    path = folder / PLAN_FILE
    if path.is_file():
        there = read_sealed(path)
        changed = [name for name in sealed if there.get(name) != sealed[name]]
        if changed:
            raise InputError(_OTHER[changed[0]], file=path, remedy="name a new folder with --out")
        return
    if any(not entry.name.startswith(".") for entry in folder.iterdir()):
        raise InputError(
            "holds something else than a campaign",
            file=folder,
            remedy="name a new folder with --out",
        )
    write_json(path, dict(sealed))


def _starts_of(
    plan: LoopPlan,
    event: str,
    draft: Path,
    say: Callable[[str], None],
    jobs: int,
    engine: Engine,
) -> tuple[list[dict[str, Any]], Draw]:
    prepare_run(event, plan.site, make_folder(draft), seed=plan.seed, mode="lockstep")
    run = load_task(draft / TASK_FOLDER).run
    event_file = str((draft / TASK_FOLDER / EVENT_FILE).resolve())
    room_s = plan.room_s, plan.history_s
    judge = partial(_draw_facts, run.model_dump_json(by_alias=True), event_file, room_s)
    starts_by_kind: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    counts = dict.fromkeys(_DRAWN, 0)
    most = {"critical": plan.starts, "harmless": plan.others, "unavoidable": plan.others}
    seeds = iter(range(plan.seed, plan.seed + MOST_SEEDS * plan.starts))
    with ordered_map(jobs, engine, software) as run_all:
        while len(starts_by_kind["critical"]) < plan.starts:
            batch = list(islice(seeds, max(jobs, 1)))
            if not batch:
                break
            for kind, facts in run_all(judge, batch):
                if len(starts_by_kind["critical"]) >= plan.starts:
                    break
                counts[kind] += 1
                if kind in starts_by_kind and len(starts_by_kind[kind]) < most[kind]:
                    starts_by_kind[kind].append({"event": event, "kind": kind, **facts})
    draw = Draw(event, plan.seed, **counts, left_out=list(left_out_of(run)))
    _tell(draw, say)
    if len(starts_by_kind["critical"]) < plan.starts:
        raise InputError(
            f"has {len(starts_by_kind['critical'])} critical starts among "
            f"{sum(counts.values())} seeds",
            field="starts",
            value=plan.starts,
            remedy="ask for fewer, for smaller latencies, or for a place with a longer run-up",
        )
    return [start for kind in KINDS for start in starts_by_kind[kind]], draw


def _tell(draw: Draw, say: Callable[[str], None]) -> None:
    say(f"starts of {draw.event}: {draw.words}")
    if draw.left_out:
        parts = " and ".join(draw.left_out)
        say(f"{draw.event} is driven without {parts}, which no driven session has")


def _draw_facts(
    run_json: str, event_file: str, room_s: tuple[float, float], seed: int
) -> tuple[str, dict[str, Any]]:
    """Return the kind of a seed's start (METHOD 8.1) and its facts; of none, the reason.

    Args:
        run_json: as it was compiled.
        event_file: K*.
        room_s: the largest latency and the longest history, for which the hand-over leaves time.
        seed: of the start.
    """
    run = RunSpec.model_validate_json(run_json)
    try:
        tunings = load_task(Path(event_file).parent).tunings_of(run)
        start = make_start(run, load_event(event_file)[0], seed, *room_s, tunings)
    except OffSpec as error:
        return _OFF_SPEC, {"seed": seed, "why": str(error)}
    except ShortRunUp as error:
        return _SHORT, {"seed": seed, "why": str(error)}
    facts = start.sealed()
    if start.contact is None:
        return "harmless", facts
    outcome = drive_start(start, CampaignDriver(driver="oracle"), ZERO_LATENCY).outcome
    if outcome.kind == "avoided":
        return "critical", facts
    if outcome.contact is not None:
        return "unavoidable", facts
    return _OFF_SPEC, {"seed": seed, "why": f"the oracle ends by {outcome.kind}: {outcome.why}"}
