"""The way from a K* and a place to a sealed task and its log: METHOD 2 without the files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.hashing import sha256_bytes
from ssp_core.run_file.shortlist import load_candidate
from ssp_scenario_manager.checks.base import Failure
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.choose import (
    Winner,
    choose_block,
    fitting_lanes,
    fitting_trigger,
)
from ssp_scenario_manager.compile.place import Order, Realisation, realise
from ssp_scenario_manager.compile.retrieval import score_blocks
from ssp_scenario_manager.compile.task import EventLink, PlaceLink, Target, Task, sealed
from ssp_scenario_manager.compile.validate import SimulationOutcome, read_validation
from ssp_scenario_manager.event_spec.load import event_version, read_event_file
from ssp_scenario_manager.event_spec.log import (
    EntryKind,
    Record,
    check_not_refused,
    log_path,
    read_log,
    utc_now,
)
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import with_routes
from ssp_scenario_manager.maps.site import find_shipped, load_site, site_library
from ssp_scenario_manager.maps.xml_input import Loading, untold

LOGGED_AS = "ssp compile"
# The compiler's own entries say the same whenever it runs, so that the same input gives the same
# bytes; only a person's decision has a time.
NO_TIME = "1970-01-01T00:00:00Z"


def entry(kind: EntryKind, event: EventLink, reason: str, **given: Any) -> Record:
    """Return an entry of the task's log about its event; its author is the compiler by default."""
    who = {"when": NO_TIME, "who": LOGGED_AS, **given}
    return Record(kind=kind, subject=event.name, version=event.version, reason=reason, **who)


def _source(event: Event, link: EventLink) -> Record:
    """Record the source of the event (METHOD 1, source gate)."""
    source = event.source.model_dump(mode="json", include={"generator", "original", "sha256"})
    crop = event.events.clip.model_dump(mode="json")
    reason = "the clip that the event was taken from, as its K* says"
    return entry("source", link, reason, details={**source, "crop": crop})


def _decisions(
    request: Request, task: Task, winner: Winner, validated: SimulationOutcome | None
) -> Iterator[Record]:
    """Record the values that were chosen, left out and taken over (METHOD 2.2, 2.3)."""
    event, version = task.event, {"task_version": task.version}
    for tuning in task.tunings:
        yield entry(
            "tuning",
            event,
            tuning.reason,
            field=tuning.field,
            old={"min": tuning.min, "max": tuning.max, "unit": tuning.unit},
            new=tuning.value,
            details={**version, "unit": tuning.unit},
        )
    for text in winner.realisation.left_out:
        reason = f"left out of the surroundings: {text}"
        yield entry("disclosure", event, reason, field="run.traffic", details=version)
    if winner.tied:
        yield entry(
            "choice",
            event,
            f"at least {len(winner.tied)} blocks of {task.place.name} score alike and fit",
            when=utc_now(),
            who=request.who or "",
            field="block",
            new=task.block.id,
            details={**version, "tied": list(winner.tied)},
        )
    if validated is not None:
        yield entry(
            "validation",
            event,
            "its chosen values are the preferred ones of this task",
            new=validated.validation.run_id,
            details={**version, **validated.validation.model_dump(mode="json")},
        )


class EventRefused(InputError):
    """The event doesn't pass its checks (METHOD 1); all failures are in it."""

    def __init__(self, file: Path, failures: Sequence[Failure]) -> None:
        self.failures = list(failures)
        lines = "".join(
            f"\n  {f.check} {f.field}: {f.reason} ({f.evidence}); {f.remedy}" for f in failures
        )
        super().__init__(f"doesn't pass {len(failures)} check(s):{lines}", file=file)


class WrongOptions(InputError):
    """Options that exclude each other, or one that is missing, whatever the files say."""


@dataclass(frozen=True)
class Request:
    """A request to compile an event.

    Args:
        site: name or file; None with a map.
        map_path: an OpenDRIVE or SUMO map; None with a site.
        choose: id of the block that a person chose among ties.
        validated_by: folder of a simulation run; None: the anchors aren't validated.
        shortlist: that the event must be a candidate of (ssp.shortlist/1); None: not asked for.
    """

    event: str
    target: Target
    site: str | None = None
    map_path: Path | None = None
    seed: int = 1
    choose: str | None = None
    who: str | None = None
    validated_by: Path | None = None
    shortlist: Path | None = None


@dataclass(frozen=True)
class CompiledEvent:
    """A compiled event, before it is written.

    Args:
        event_file: its text as it was read.
        site_file: the site's text, None with a map.
        shortlist: bytes of the list that the event was a candidate of.
    """

    task: Task
    event: Event
    event_file: bytes
    area: OperatingArea
    site_file: bytes | None
    winner: Winner
    log: tuple[Record, ...]
    shortlist: bytes | None = None

    @property
    def realisation(self) -> Realisation:
        return self.winner.realisation


def compile_task(
    request: Request,
    on_block: Callable[[str], None] = lambda _text: None,
    loading: Loading = untold,
) -> CompiledEvent:
    """Compile an event.

    Args:
        request: event, place, target and options.
        on_block: called with each block that is tried.
        loading: called with how many roads of the map were read, and of how many.

    Raises:
        EventRefused: the event doesn't pass its checks.
        NoBlockChosen: no block fits, or several do and none was chosen.
        InputError: a file is not valid, or options don't fit each other.
    """
    check_options(request)
    event, version, event_path = checked_event(request.event)
    candidate = None
    if request.shortlist is not None:
        candidate = load_candidate(request.shortlist, event.name, version)
    area, site_file = load_area(request.site, request.map_path, loading)
    _check_area(request, area)
    check_not_refused(event_path, event.name)
    before = read_log(log_path(event_path))
    validated = None
    if request.validated_by is not None:
        validated = read_validation(request.validated_by, version)
    if "junction" in event.topology.segment.words:
        area = replace(area, library=with_routes(area.library))
    order = Order(
        event=event,
        version=version,
        area=area,
        target=request.target,
        seed=request.seed,
        preferred=validated.values if validated is not None else {},
    )
    library = area.library
    winner = choose_block(
        library,
        score_blocks(event, library),
        partial(realise, order),
        choice=request.choose,
        who=request.who,
        on_block=on_block,
        would_do=lambda block: fitting_trigger(
            event, lambda other: realise(replace(order, event=other), block)
        ),
        other_lanes=lambda blocks: fitting_lanes(
            event,
            request.event,
            blocks,
            lambda other, block: realise(replace(order, event=other), block),
        ),
    )
    how = {
        "chosen_by": winner.chosen_by,
        "retrieval": winner.scores,
        "validated_by": validated.validation if validated is not None else None,
    }
    task = sealed(winner.realisation.task.model_copy(update=how))
    log = list(before)
    if not any(record.kind == "source" and record.subject == event.name for record in before):
        log.append(_source(event, task.event))
    log += _decisions(request, task, winner, validated)
    listed = None if request.shortlist is None else request.shortlist.read_bytes()
    if candidate is not None and listed is not None:
        details = {
            "task_version": task.version,
            "sha256": sha256_bytes(listed),
            "rank": candidate.rank,
            "priority": candidate.priority,
        }
        log.append(entry("shortlist", task.event, "; ".join(candidate.reasons), details=details))
    return CompiledEvent(
        task=task,
        event=event,
        event_file=event_path.read_bytes(),
        area=area,
        site_file=site_file,
        winner=winner,
        log=tuple(log),
        shortlist=listed,
    )


def checked_event(name_or_path: str) -> tuple[Event, str, Path]:
    """Return a K* that passes all its checks, its version and its file.

    Raises:
        EventRefused: it doesn't; with every failure.
        InputError: there is no such event.
    """
    value, path = read_event_file(name_or_path)
    failures = check_event(value)
    if failures:
        raise EventRefused(path, failures)
    event = parse_model(Event, value, path)
    return event, event_version(event), path


def load_area(
    site: str | None, map_path: Path | None, loading: Loading = untold
) -> tuple[OperatingArea, bytes | None]:
    """Return a site by name or file, with its text, or a map.

    Raises:
        InputError: it is not valid.
    """
    if site is not None:
        site_spec, version = load_site(site)
        link = PlaceLink(kind="site", name=site_spec.name, sha256=version)
        path = find_shipped(site, "site")
        return OperatingArea(link, site_library(site_spec, path), site_spec), path.read_bytes()
    if map_path is None:
        raise WrongOptions("needs a place", remedy="give --site SITE or --map FILE")
    library = load_library(map_path, loading)
    if library.kind == "site":
        raise InputError("is a site, no map", file=map_path, remedy="give it with --site")
    link = PlaceLink(kind=library.kind, name=map_path.name, sha256=library.sha256)
    return OperatingArea(link, library, None, map_path.read_bytes(), map_path.name), None


def check_options(request: Request) -> None:
    """Raise WrongOptions where options don't go together."""
    if request.site is None and request.map_path is None:
        raise WrongOptions("needs a place", remedy="give --site SITE or --map FILE")
    if request.site is not None and request.map_path is not None:
        raise WrongOptions("is either a site or a map", remedy="give either --site or --map")
    if request.target == "track" and request.map_path is not None:
        raise WrongOptions(
            "a track is a site: a map says nothing about what is reachable and safe there",
            field="--map",
            value=str(request.map_path),
            remedy="give --site SITE, or compile for sumo, openscenario or carla",
        )
    for field, option, why in (
        ("--validated-by", request.validated_by, "aren't validated by a simulation"),
        ("--shortlist", request.shortlist, "need no choice among events"),
    ):
        if option is not None and request.target != "track":
            remedy = "leave it out, or give --target track"
            raise WrongOptions(f"is for the track: other targets {why}", field=field, remedy=remedy)
    if request.choose is not None and not (request.who or "").strip():
        raise WrongOptions(
            "is missing: a person's choice goes into the log with a name",
            field="--who",
            remedy="give --who NAME",
        )


def _check_area(request: Request, area: OperatingArea) -> None:
    if request.target == "track" and area.site is not None and area.site.domain != "physical":
        raise InputError(
            f"is a site of the domain {area.site.domain}; a track task is for a physical one",
            field="--site",
            value=area.site.name,
            remedy="give a physical site, or --target sumo",
        )
