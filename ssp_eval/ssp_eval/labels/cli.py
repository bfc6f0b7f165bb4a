"""``ssp labels``: propose a labels file or write a template, check one, show its frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files import make_folder, read_mapping, write_bytes, write_json, write_text
from ssp_core.hashing import sha256_file
from ssp_core.options import Domain, Number
from ssp_eval.evaluate.truth import UNKNOWN_VERSION, truth_from_bag, truth_from_file
from ssp_eval.labels.basis import ProposalRules, Truth
from ssp_eval.labels.boxes_command import boxes
from ssp_eval.labels.check import event_problems, middle_s, phase_problems, risk_warnings
from ssp_eval.labels.footage import About, about, pictures
from ssp_eval.labels.model import load_labels
from ssp_eval.labels.proposal_file import is_unreviewed, sidecar, write_proposal
from ssp_eval.labels.propose import label_times, propose
from ssp_eval.labels.response import response_problems
from ssp_eval.labels.sheet import LEAST_WIDTH_PX, html_sheet, picture_sheet, read_rows
from ssp_eval.labels.template import FILL_IN, template_json, unfilled
from ssp_eval.recordings.phases import Event
from ssp_scenario_manager.spec.load import load_event

_PATH = click.Path(path_type=Path)
_SHEETS = (".html", ".png", ".jpg")


@click.group()
def labels() -> None:
    """Proposes labels files, checks them, shows the frames to label from (METHOD 5.2)."""


labels.add_command(boxes)


@labels.command()
@click.argument("source", metavar="[BAG|VIDEO]", type=_PATH, required=False)
@click.option("--truth", type=_PATH, help="Truth file of a clip (ssp.truth/1), in place of a bag.")
@click.option("--out", type=_PATH, required=True, help="Labels file to write.")
@click.option("--domain", type=Domain(), help="Where the source doesn't say.")
@click.option("--scenario", help="Where the source doesn't say.")
@click.option("--event-version", help="K* version, where the source names none.")
@click.option("--event", help="K* of the clip, by name or file: its times, name and version.")
@click.option("--template", is_flag=True, help="A template, even where states are recorded.")
@click.option("--trigger", type=Number(0), help="Clip time to centre a template on, s.")
@click.option("--conflict", type=Number(0), help="Likewise; between both if both are given.")
@click.option("--start", type=Number(0), default=0.0, help="Of VIDEO's clip in the file, s.")
@click.option("--count", type=click.IntRange(1, 1000), default=9, show_default=True)
@click.option(
    "--spacing",
    type=click.FloatRange(0.1, 60.0),
    default=0.5,
    show_default=True,
    help="Seconds between labels.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def new(
    source: Path | None,
    truth: Path | None,
    out: Path,
    domain: str | None,
    scenario: str | None,
    event_version: str | None,
    event: str | None,
    template: bool,
    trigger: float | None,
    conflict: float | None,
    start: float,
    count: int,
    spacing: float,
    force: bool,
) -> None:
    """Proposes labels from recorded states, or writes a template where there are none.

    From the ground truth in BAG, or in a clip's truth file, labels are proposed; they are marked in
    a sidecar (FILE.proposal.json) until `ssp spec review FILE` or an edit confirms them, and
    results and reports say so. A video, or a bag without states, gets a template: the label times,
    with nothing said; it must be filled in before it is of any use.

    The thresholds of a conflict are the run's in BAG. For a truth file they are those of --event,
    else of the shipped K* of its scenario, unless another version is named.
    """
    if source is not None and truth is not None:
        raise click.UsageError("give either BAG or VIDEO, or --truth FILE")
    if out.is_dir():
        raise InputError("is a folder", file=out, remedy="name a file with --out")
    if out.exists() and not force:
        raise InputError(
            "exists already", file=out, remedy="give --force to overwrite what may be reviewed"
        )
    rules = ProposalRules(count=count, spacing_s=spacing)
    centre: dict[str, object] = {"--trigger": trigger, "--conflict": conflict, "--event": event}
    if truth is not None:
        if template:
            raise click.UsageError("--template is for BAG or VIDEO, not for --truth")
        _refuse({**centre, "--event": None}, "need BAG or VIDEO and --template")
        given = None
        if event is not None:
            given, version = load_event(event)
            event_version = event_version or version
        found = truth_from_file(truth, domain, event_version, given)
        if found.event_version == UNKNOWN_VERSION:
            console.note(
                f"note: neither {truth} nor --event or --event-version names a K* version; the "
                f"labels say {UNKNOWN_VERSION}, and fit no recording of a K*"
            )
        _propose(out, rules, found, sha256_file(truth))
        return
    if source is None:
        raise click.UsageError("give either BAG or VIDEO, or --truth FILE")
    facts = about(source, start)
    if facts.has_states and not template:
        _refuse(centre, "need --template: labels are proposed around the event that is recorded")
        _propose(out, rules, truth_from_bag(source), facts.bag_sha256 or str(source))
        return
    if not template:
        console.note(f"note: {source} holds no states to propose labels from: a template")
    _template(
        out, rules, source, facts,
        {"domain": domain, "scenario": scenario, "event_version": event_version},
        event, trigger, conflict,
    )  # fmt: skip


def _refuse(options: dict[str, object], why: str) -> None:
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise click.UsageError(f"{', '.join(given)} {why}")


def _propose(out: Path, rules: ProposalRules, ground_truth: Truth, origin: str) -> None:
    make_folder(out.parent)
    proposal = propose(ground_truth, rules)
    write_proposal(out, proposal, origin)
    event = proposal.event
    end = "not within the clip" if event.resolution_s is None else f"{event.resolution_s:.2f} s"
    console.note(
        f"{out}: {len(proposal.labels.labels)} labels; trigger {event.trigger_s:.2f} s, conflict "
        f"{event.conflict_s:.2f} s, resolution {end}. Look them over: they are a proposal."
    )
    console.note(f"conflict where {_conflict_rule(ground_truth)} ({ground_truth.rules_of})")
    for problem in response_problems(proposal.labels):
        console.note(f"warning: no model can get a risk response: {problem}")


def _conflict_rule(ground_truth: Truth) -> str:
    limits = ground_truth.thresholds
    named = {"TTC": limits.ttc_s, "the gap between the arrivals": limits.arrival_gap_s}
    rules = [f"{name} is under {limit:g} s" for name, limit in named.items() if limit is not None]
    return " or ".join(rules) or "no threshold is given"


def _template(
    out: Path,
    rules: ProposalRules,
    source: Path,
    facts: About,
    given: dict[str, str | None],
    event: str | None,
    trigger_s: float | None,
    conflict_s: float | None,
) -> None:
    name, version = None, None
    if event is not None:
        found, version = load_event(event)
        name = found.name
        if facts.video_sha256 and found.source.sha256 not in (None, facts.video_sha256):
            console.note(f"note: the times of {name} are those of another video")
        if trigger_s is None and conflict_s is None:
            trigger_s = middle_s(found.events.trigger.start)
            conflict_s = middle_s(found.events.conflict.start)
    scenario = facts.scenario or given["scenario"] or name
    if scenario is None:
        raise InputError(
            "doesn't say which scenario it shows", file=source, remedy="give --scenario or --event"
        )
    known = [t_s for t_s in (trigger_s, conflict_s) if t_s is not None]
    for t_s in known:
        if not facts.first_s <= t_s <= facts.last_s:
            raise InputError(
                f"{t_s:g} s lies outside the clip",
                file=source,
                remedy=f"it runs from {facts.first_s:g} s to {facts.last_s:g} s",
            )
    middle = (facts.first_s + facts.last_s) / 2.0
    first_s, last_s = (min(known), max(known)) if known else (middle, middle)
    centre = Event(
        object_id="", trigger_s=first_s, arrival_s=first_s, conflict_s=last_s, resolution_s=None
    )
    times_s = label_times(facts.first_s, facts.last_s, centre, rules, str(source))
    value = template_json(
        scenario,
        facts.domain or given["domain"] or "synthetic",
        facts.event_version or given["event_version"] or version or UNKNOWN_VERSION,
        times_s,
    )
    make_folder(out.parent)
    write_json(out, value)
    sidecar(out).unlink(missing_ok=True)  # of a proposal that this file replaces
    around = "the middle of the clip" if not known else f"{first_s:.2f} to {last_s:.2f} s"
    console.note(
        f"{out}: {FILL_IN} {len(times_s)} labels from {times_s[0]:g} to {times_s[-1]:g} s, around "
        f"{around}; `ssp labels sheet {source} --labels {out} --out sheet.html` shows the frames"
    )


@labels.command()
@click.argument("file", type=_PATH)
@click.option("--event", help="K* of the labelled clip itself: its times and version.")
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def check(file: Path, event: str | None, as_json: bool) -> int:
    """Checks FILE after METHOD 5.2 and 1, and warns when no risk response could be reached.

    Exit status 1: it is a template, or its phases contradict each other or the event's times.
    """
    waiting = unfilled(read_mapping(file))
    if waiting:
        if as_json:
            click.echo(json.dumps({"file": str(file), "template": True, "unfilled": waiting}))
        else:
            click.echo(f"{file}: {FILL_IN} {len(waiting)} fields:")
            for field in waiting:
                click.echo(f"  {field}")
        return 1
    loaded = load_labels(file)
    problems = phase_problems(loaded)
    if event is not None:
        found, version = load_event(event)
        problems += event_problems(loaded, found, version)
    responses = response_problems(loaded)
    warnings = risk_warnings(loaded)
    unreviewed = is_unreviewed(file)
    if as_json:
        value: dict[str, Any] = {
            "file": str(file),
            "template": False,
            "scenario": loaded.scenario,
            "domain": loaded.domain,
            "labels": len(loaded.labels),
            "risk_onset_s": loaded.risk_onset_s,
            "unreviewed": unreviewed,
            "problems": problems,
            "warnings": [*responses, *warnings],
        }
        click.echo(json.dumps(value, sort_keys=True))
        return 1 if problems else 0
    click.echo(
        console.visible(
            f"{file}: {loaded.scenario} in {loaded.domain}, {len(loaded.labels)} labels, risk from "
            f"{loaded.risk_onset_s:g} s"
        )
    )
    for problem in problems:
        click.echo(console.visible(f"  {problem}"))
    if unreviewed:
        console.note(
            f"note: as proposed and not reviewed ({sidecar(file).name}); `ssp spec review {file}`"
        )
    for problem in responses:
        console.note(f"warning: no model can get a risk response: {problem}")
    for warning in warnings:
        console.note(f"warning: {warning}")
    return 1 if problems else 0


@labels.command()
@click.argument("source", metavar="BAG|VIDEO", type=_PATH)
@click.option("--labels", "file", type=_PATH, required=True, help="Labels file or template.")
@click.option("--out", type=_PATH, required=True, help="Sheet to write: .html, .png or .jpg.")
@click.option("--start", type=Number(0), default=0.0, help="Of VIDEO's clip in the file, s.")
@click.option(
    "--width",
    type=click.IntRange(LEAST_WIDTH_PX, 4096),
    default=LEAST_WIDTH_PX,
    show_default=True,
    help="Of each frame, px; on a page at least this.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def sheet(source: Path, file: Path, out: Path, start: float, width: int, force: bool) -> None:
    """Writes a contact sheet: the frames of BAG or VIDEO at the labels' times, with the labels."""
    suffix = out.suffix.lower().replace(".jpeg", ".jpg")
    if suffix not in _SHEETS:
        raise click.UsageError(f"--out {out}: name a file that ends in {', '.join(_SHEETS)}")
    if out.exists() and not force:
        raise InputError("exists already", file=out, remedy="give --force to overwrite it")
    rows = read_rows(file)
    with console.progress("frames", None):
        found = pictures(source, [row.t_s for row in rows.rows], start)
    missing = [f"{row.t_s:g}" for row, one in zip(rows.rows, found, strict=True) if one is None]
    make_folder(out.parent)
    if suffix == ".html":
        if len(missing) == len(found):
            raise InputError("no label's time lies inside the clip", file=file, field="labels")
        write_text(out, html_sheet(rows, found, str(source), width))
    else:
        write_bytes(out, picture_sheet(rows, found, suffix, width))
    if missing:
        console.note(f"warning: no frame at {', '.join(missing)} s")
    console.note(f"{out}: {len(found) - len(missing)} frames")
