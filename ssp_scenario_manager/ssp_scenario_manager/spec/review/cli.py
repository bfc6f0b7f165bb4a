"""``ssp spec review``: from a candidate to a K*, or from proposed labels to reviewed ones."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files import read_mapping
from ssp_scenario_manager.spec.checks import check_event
from ssp_scenario_manager.spec.load import load_event, refuse_old
from ssp_scenario_manager.spec.log_file import check_not_refused, log_path, read_log, utc_now
from ssp_scenario_manager.spec.model import SCHEMA
from ssp_scenario_manager.spec.review.desk import Desk
from ssp_scenario_manager.spec.review.pictures import open_evidence
from ssp_scenario_manager.spec.review.session import End, Session, to_decide
from ssp_scenario_manager.spec.review.terminal import Stdio, Terminal
from ssp_scenario_manager.spec.review.values import shown
from ssp_scenario_manager.spec.write import write_event

# Who reviews files of another schema: module:function. They live in packages that this one doesn't
# depend on, so they are found by name when such a file is given.
REVIEWERS: dict[str, str] = {"ssp.labels/1": "ssp_eval.labels.review:review_labels"}

_CANDIDATE = ".candidate.yaml"
Reviewer = Callable[[Path, Path, str, Callable[[], str], Terminal], int]


@click.command("review")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--who", required=True, help="Who decides; goes into the log.")
@click.option("--log", type=click.Path(path_type=Path), help="Log L [default: beside FILE].")
@click.option("--video", type=click.Path(path_type=Path), help="Source video, to show evidence.")
@click.option("--all", "everything", is_flag=True, help="Go through every field that is undecided.")
@click.option("--accept-all", is_flag=True, help="First accept all that isn't safety-critical.")
@click.option("--reason", help="For --accept-all.")
def review_command(
    file: Path,
    who: str,
    log: Path | None,
    video: Path | None,
    everything: bool,
    accept_all: bool,
    reason: str | None,
) -> int:
    """Decide what FILE leaves to a person: a candidate K*, or proposed labels.

    Every decision goes to the log and into FILE at once. Exit status 0: all is decided and every
    check holds; 1: something is left, a check fails, or the clip is refused.
    """
    who = " ".join(who.split())
    if not who:
        raise click.UsageError("--who must name somebody")
    if accept_all and not (reason and reason.strip()):
        raise click.UsageError("--accept-all needs --reason TEXT")
    if reason and not accept_all:
        raise click.UsageError("--reason belongs to --accept-all")
    log = log or log_path(file)
    found = read_mapping(file)
    refuse_old(found, file)
    schema = found.get("schema")
    if schema in REVIEWERS:
        if video or everything or accept_all:
            raise click.UsageError("--video, --all and --accept-all are for events, not for labels")
        return _reviewer(str(schema))(file, log, who, utc_now, Stdio())
    if schema != SCHEMA:
        raise InputError(
            "is nothing that can be reviewed",
            file=file,
            field="schema",
            value=schema,
            remedy=f"known are {', '.join([SCHEMA, *REVIEWERS])}",
        )
    desk = Desk(file, log, who, utc_now)
    check_not_refused(file, desk.event.name, log)
    evidence = open_evidence(
        desk.event, read_log(log), video, file.with_name(f"{_stem(file)}.review")
    )
    stored = file.with_name(f"{_stem(file)}.extraction") / "frames"
    session = Session(desk, Stdio(), evidence, stored if stored.is_dir() else None)
    if accept_all and reason:
        count = session.accept_all(reason.strip())
        console.out.print(f"accepted {count} fields that aren't safety-critical", markup=False)
    end = session.run(everything)
    return _finish(desk, end)


def _finish(desk: Desk, end: End) -> int:
    out = console.out
    if end is End.REJECTED:
        out.print(
            f"\n{desk.path}: the clip is refused; {desk.log} says why, and this event is not "
            "compiled",
            markup=False,
        )
        return 1
    left = to_decide(desk.event)
    if left:
        out.print(f"\n{desk.path}: {len(left)} fields are left to decide:", markup=False)
        for item in left:
            out.print(f"  {item.field}: {shown(item.value)} ({item.why})", markup=False)
        return 1
    failures = check_event(desk.event)
    if failures:
        out.print(f"\n{desk.path}: all is decided, and these checks don't hold:", markup=False)
        for failure in failures:
            text = f"  {failure.check} {failure.field}: {failure.reason} ({failure.evidence})"
            out.print(f"{text}; right would be: {failure.remedy}", markup=False)
        return 1
    path = _promoted(desk)
    out.print(f"\n{path}: K* {desk.version}", markup=False)
    return 0


def _promoted(desk: Desk) -> Path:
    """Where the K* stands: a candidate's own file keeps its name, the K* gets its."""
    if not desk.path.name.endswith(_CANDIDATE):
        return desk.path
    path = desk.path.with_name(f"{_stem(desk.path)}.event.yaml")
    if path.exists():
        _, version = load_event(str(path))
        ours = {record.details.get("version_after") for record in read_log(desk.log)}
        if version != desk.version and version not in ours:
            raise InputError(
                f"exists already and is no earlier version of {desk.path.name}",
                file=path,
                remedy="move one of them away",
            )
    write_event(path, desk.event)
    return path


def _stem(path: Path) -> str:
    return path.stem.removesuffix(".candidate").removesuffix(".event")


def _reviewer(schema: str) -> Reviewer:
    module, function = REVIEWERS[schema].split(":")
    found: Any = getattr(importlib.import_module(module), function)
    reviewer: Reviewer = found
    return reviewer
