"""``ssp spec extract`` and ``ssp spec review``: a candidate K* from a video, and its review."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import click

from ssp_core import console
from ssp_core.chat.client import OpenAIChat, Policy
from ssp_core.credentials import check_key, is_http_address, without_userinfo
from ssp_core.errors import InputError
from ssp_core.files.folders import taken_folder
from ssp_core.files.reading import read_mapping
from ssp_core.options import Number, WholeNumber
from ssp_scenario_manager.checks.check import UndecidedField, check_event
from ssp_scenario_manager.event_spec.load import load_event, write_event
from ssp_scenario_manager.event_spec.log import check_not_refused, log_path, read_log, utc_now
from ssp_scenario_manager.event_spec.model import SCHEMA
from ssp_scenario_manager.extract.candidate import Origin
from ssp_scenario_manager.extract.clip import WIDE_SPACING_S, Crop
from ssp_scenario_manager.extract.extraction import ExtractedEvent, Order, extract
from ssp_scenario_manager.review.decisions import value_text
from ssp_scenario_manager.review.dialogue import Stdio, Terminal
from ssp_scenario_manager.review.session import (
    End,
    EventUnderReview,
    Session,
    open_evidence,
    to_decide,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_PATH = click.Path(path_type=Path)
_KEY_REMEDY = "name the variable that holds the key with --api-key-env"
_SIZE_REMEDY = "give fewer --frames or a smaller --width"
_SCHEMA_REMEDY = "where the server can't hold answers to a schema, give --no-schema"
_REMEDIES = {
    "unreachable": "start it, or give its --base-url",
    "lost": "is the model still being loaded? give a larger --timeout",
    "400": f"{_SCHEMA_REMEDY}; where it finds the request too long, {_SIZE_REMEDY}",
    "option": _SCHEMA_REMEDY,
    "length": _SIZE_REMEDY,
    "images": "give a model that takes pictures",
    "401": _KEY_REMEDY,
    "403": _KEY_REMEDY,
    "404": "--model must be a name that the server serves, and --base-url usually ends in /v1",
    "413": _SIZE_REMEDY,
}


@click.command("extract")
@click.argument("video", type=_PATH)
@click.option("--base-url", required=True, help="Address of the server, up to and with /v1.")
@click.option("--model", required=True, help="As the server names it.")
@click.option("--api-key-env", metavar="VAR", help="Environment variable that holds the key.")
@click.option("--start", type=Number(0), default=0.0, help="Start of the crop [default: 0].")
@click.option("--end", type=Number(0), help="End of the crop [default: the video's].")
@click.option("--name", help="Name of the event [default: from VIDEO's name].")
@click.option(
    "--type",
    "kind",
    type=click.Choice(sorted(KINDS)),
    help="Kind of interaction, stated by a person [default: the model's answer].",
)
@click.option("--annotation", type=_PATH, help="EMM-AU annotation, kept as provenance.")
@click.option("--show-annotation", is_flag=True, help="Show its descriptions to the model.")
@click.option(
    "--frames",
    type=WholeNumber(2, 200),
    default=16,
    show_default=True,
    help="Frames shown, evenly over the crop.",
)
@click.option(
    "--width",
    type=WholeNumber(64, 4096),
    default=960,
    show_default=True,
    help="Wider frames are scaled down to this, px.",
)
@click.option(
    "--timeout", type=Number(0.1), default=120.0, show_default=True, help="Time for one answer, s."
)
@click.option(
    "--tries",
    type=WholeNumber(1, 20),
    default=3,
    show_default=True,
    help="Attempts per request while the server is silent, unreachable or busy.",
)
@click.option("--no-schema", is_flag=True, help="Don't ask the server to hold answers to a schema.")
@click.option("--generator", default="unknown", show_default=True, help="What made the video.")
@click.option("--original", help="Version or name of the original [default: VIDEO's name].")
@click.option("--out", type=_PATH, default=Path(), help="Folder [default: the current one].")
@click.option("--force", is_flag=True, help="Replace an existing candidate.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def extract_command(
    video: Path,
    base_url: str,
    model: str,
    api_key_env: str | None,
    start: float,
    end: float | None,
    name: str | None,
    kind: str | None,
    annotation: Path | None,
    show_annotation: bool,
    frames: int,
    width: int,
    timeout: float,
    tries: int,
    no_schema: bool,
    generator: str,
    original: str | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Ask a vision model about VIDEO and write a candidate K*.

    Writes NAME.candidate.yaml, NAME.log.jsonl and NAME.extraction/ (frames, requests, raw answers).
    A candidate isn't a K* yet: `ssp spec review` turns it into one. Run the same command again to
    go on after an interruption; answered questions aren't asked again.
    """
    if show_annotation and annotation is None:
        raise click.UsageError("--show-annotation needs --annotation FILE")
    if end is not None and start >= end:
        raise click.UsageError(f"--start {start:g} must lie before --end {end:g}")
    order = Order(
        video=video,
        crop=Crop(start, end, frames, width),
        origin=Origin(_event_name(name, video), generator, original or video.name, kind),
        out=out,
        annotation=annotation,
        show_annotation=show_annotation,
        use_schema=not no_schema,
        server=_checked_url(base_url),
        force=force,
    )
    # Someone waits for the answers and keeps each, so that a lost one is worth asking for again.
    policy = Policy(timeout_s=timeout, tries=tries, retry_lost=True)
    key = _key(api_key_env)
    chat = OpenAIChat(base_url, model, key, policy, console.note, remedies=_REMEDIES)
    with taken_folder(order.store), console.progress(f"asking {model}", None) as bar:
        task = bar.task_ids[0]
        extraction = extract(
            order,
            chat,
            utc_now,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    if as_json:
        click.echo(
            json.dumps({"candidate": str(order.candidate), **extraction.as_dict()}, indent=1)
        )
    else:
        _report(order, extraction)
    for note in extraction.notes:
        console.note(f"note: {note}")


def _event_name(name: str | None, video: Path) -> str:
    event_name = name or re.sub(r"[^a-z0-9]+", "_", video.stem.lower()).strip("_")[:32]
    if not _NAME.fullmatch(event_name):
        raise click.UsageError(
            f"{event_name!r} is no name of an event: give --name with a letter first, then at most "
            "31 of a-z, 0-9 and _"
        )
    return event_name


def _checked_url(url: str) -> str:
    if not is_http_address(url):
        raise click.UsageError(
            f"--base-url {url!r} is no address; give one such as http://localhost:8000/v1"
        )
    return without_userinfo(url)  # a password is no business of the log's


def _key(variable: str | None) -> str | None:
    if variable is None:
        return None
    remedy = "leave --api-key-env out where the server wants no key"
    return check_key(variable, os.environ.get(variable), remedy)


def _report(order: Order, extraction: ExtractedEvent) -> None:
    out = console.out
    out.print(
        f"{order.candidate}: candidate {extraction.version[:19]}, "
        f"{extraction.clip.duration_s:.2f} s, {len(extraction.clip.shots)} frames shown",
        markup=False,
    )
    if extraction.clip.spacing_s > WIDE_SPACING_S:
        console.note(
            f"note: frames are {extraction.clip.spacing_s:.2f} s apart, and phases are known no "
            "better; give more --frames or a shorter crop"
        )
    critical = [item for item in extraction.undecided if item.critical]
    others = len(extraction.undecided) - len(critical)
    out.print(f"\nA person must decide {len(critical)} safety-critical fields:", markup=False)
    for line in _lines(critical):
        out.print(line, markup=False)
    out.print(f"and may accept {others} others together.", markup=False)
    doubts = [finding for finding in extraction.gate if finding.answer != "no"]
    if doubts:
        out.print("\nThe model doubts that the clip will do; a person may refuse it:", markup=False)
        for finding in doubts:
            frames = ", ".join(map(str, finding.frames))
            out.print(
                f"  {finding.reason}: {finding.answer} ({finding.confidence:.2f}, frames {frames})",
                markup=False,
            )
    if extraction.failures:
        out.print("\nChecks that don't hold yet:", markup=False)
        for failure in extraction.failures:
            text = f"  {failure.check} {failure.field}: {failure.reason} ({failure.evidence})"
            out.print(text, markup=False)
    files = [shlex.quote(str(path)) for path in (order.candidate, order.video)]
    out.print(f"\nNext: ssp spec review {files[0]} --who NAME --video {files[1]}", markup=False)


def _lines(items: list[UndecidedField]) -> list[str]:
    """Return one line per field: path, value, confidence, where from, evidence frames."""
    widths = [
        max((len(item.field) for item in items), default=0),
        min(24, max((len(value_text(item.value)) for item in items), default=0)),
    ]
    lines = []
    for item in items:
        frames = ", ".join(map(str, item.frames))
        confidence = "–" if item.confidence is None else f"{item.confidence:.2f}"
        line = f"  {item.field:<{widths[0]}}  {value_text(item.value):<{widths[1]}}  {confidence}  "
        lines.append(line + item.provenance + (f", frames {frames}" if frames else ""))
    return lines


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
@click.option("--reason", help="Reason for --accept-all.")
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
    contents = read_mapping(file)
    schema = contents.get("schema")
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
            remedy=f"known: {', '.join([SCHEMA, *REVIEWERS])}",
        )
    reviewed = EventUnderReview(file, log, who, utc_now)
    check_not_refused(file, reviewed.event.name, log)
    evidence = open_evidence(
        reviewed.event, read_log(log), video, file.with_name(f"{_stem(file)}.review")
    )
    stored = file.with_name(f"{_stem(file)}.extraction") / "frames"
    session = Session(reviewed, Stdio(), evidence, stored if stored.is_dir() else None)
    session.name_authors()
    if accept_all and reason:
        count = session.accept_all(reason.strip())
        console.out.print(f"accepted {count} fields that aren't safety-critical", markup=False)
    end = session.run(everything)
    return _finish(reviewed, end)


def _finish(reviewed: EventUnderReview, end: End) -> int:
    out = console.out
    if end is End.REJECTED:
        out.print(
            f"\n{reviewed.path}: the clip is refused; {reviewed.log} says why, and this event is "
            "not compiled",
            markup=False,
        )
        return 1
    left = to_decide(reviewed.event)
    if left:
        out.print(f"\n{reviewed.path}: {len(left)} fields are left to decide:", markup=False)
        for item in left:
            out.print(f"  {item.field}: {value_text(item.value)} ({item.why})", markup=False)
        return 1
    failures = check_event(reviewed.event)
    if failures:
        out.print(f"\n{reviewed.path}: all is decided, and these checks don't hold:", markup=False)
        for failure in failures:
            text = f"  {failure.check} {failure.field}: {failure.reason} ({failure.evidence})"
            out.print(f"{text}; right would be: {failure.remedy}", markup=False)
        return 1
    path = _promoted(reviewed)
    out.print(f"\n{path}: K* {reviewed.version}", markup=False)
    return 0


def _promoted(reviewed: EventUnderReview) -> Path:
    """Name the file of the K*: a candidate's own file keeps its name, the K* gets its own."""
    if not reviewed.path.name.endswith(_CANDIDATE):
        return reviewed.path
    path = reviewed.path.with_name(f"{_stem(reviewed.path)}.event.yaml")
    if path.exists():
        _, version = load_event(str(path))
        ours = {record.details.get("version_after") for record in read_log(reviewed.log)}
        if version != reviewed.version and version not in ours:
            raise InputError(
                f"exists already and is no earlier version of {reviewed.path.name}",
                file=path,
                remedy="move one of them away",
            )
    write_event(path, reviewed.event)
    return path


def _stem(path: Path) -> str:
    return path.stem.removesuffix(".candidate").removesuffix(".event")


def _reviewer(schema: str) -> Reviewer:
    module, function = REVIEWERS[schema].split(":")
    reviewer: Reviewer = getattr(importlib.import_module(module), function)
    return reviewer
