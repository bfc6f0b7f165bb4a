"""``ssp labels new``: labels proposed from recorded states, or a template where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_core.options import Domain, Number
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.data.labels import FILL_IN, counts_text, phase_counts, template_json
from ssp_eval.data.provenance import bag_folder, find_bag, find_labels, labels_places
from ssp_eval.labels.check import response_problems
from ssp_eval.labels.plan import NoPlan
from ssp_eval.labels.planned import (
    Given,
    Planned,
    Recording,
    plan_recordings,
    planned_files,
    read_recordings,
    unanswered,
)
from ssp_eval.labels.propose import Proposal, grid_times, propose
from ssp_eval.labels.review import NewFile, proposed_file, write_files
from ssp_eval.labels.truth import UNKNOWN_VERSION, Truth, given_event, is_bag

_PATH = click.Path(path_type=Path)
_MOST = 3


@click.command()
@click.argument("sources", metavar="[BAG|VIDEO]…", type=_PATH, nargs=-1)
@click.option(
    "--truth", type=_PATH, help="States of a clip (ssp.truth/1), as its maker wrote them."
)
@click.option("--out", type=_PATH, help="Labels file, of several recordings a folder for them.")
@click.option("--domain", type=Domain(), help="Where the source doesn't say.")
@click.option("--scenario", help="Where the source doesn't say.")
@click.option("--event-version", help="K* version, where the source names none.")
@click.option("--event", help="K*, by name or file, where the recordings hold none.")
@click.option("--template", is_flag=True, help="Templates, even where states are recorded.")
@click.option("--start", type=Number(0), default=0.0, help="Of VIDEO's clip in the file, s.")
@click.option("--force", is_flag=True, help="Overwrite existing files.")
def new(
    sources: tuple[Path, ...],
    truth: Path | None,
    out: Path | None,
    domain: str | None,
    scenario: str | None,
    event_version: str | None,
    event: str | None,
    template: bool,
    start: float,
    force: bool,
) -> None:
    """Proposes labels from recorded states, or writes a template where there are none.

    Give all recordings of a scenario at once (SYN SIM PHY: bags, run folders, or the video that K*
    was reviewed on): their label times are planned together, so that each has as many labels in
    every phase (METHOD 5.2b) and the domains can be compared. One file is written beside each, or
    into the folder --out. A recording alone is planned by its own phases.

    What is proposed is marked in a sidecar (FILE.proposal.json) until `ssp spec review FILE` or an
    edit confirms it. A recording without states gets a template with the label times, at which
    nothing is said yet.

    The thresholds of a conflict are those of the K* in the bag, else of the run, else of --event or
    of the shipped K* of the scenario, unless another version is named.
    """
    if len(sources) > _MOST:
        raise click.UsageError(f"give at most {_MOST} recordings, one per domain")
    if not sources and (truth is None or template):
        raise click.UsageError("give a BAG or VIDEO, or --truth FILE")
    given = Given(
        domain, scenario, event_version, None if event is None else given_event(event), truth, start
    )
    paths = [find_bag(path) if is_bag(path) else path for path in sources]
    recordings = read_recordings(paths, given)
    targets = _targets(sources, recordings, out)
    _check_free(targets, force)
    _say_another_video(recordings, given)
    first = recordings[0]
    if first.event_version == UNKNOWN_VERSION:
        console.note(
            f"note: neither {first.path} nor --event or --event-version names a K* version; the "
            f"labels say {UNKNOWN_VERSION}, and fit no recording of a K*"
        )
    planned = _plan(recordings)
    if planned is not None:
        _write(planned_files(recordings, planned, targets, template))
        _say_plan(recordings, planned, targets, template)
        return
    if first.truth is None or template:
        _grid_template(targets[0], first)
        return
    proposal = propose(first.truth)
    _write([proposed_file(targets[0], proposal, first.origin)])
    _say_proposal(targets[0], proposal, first.truth)


def _plan(recordings: Sequence[Recording]) -> Planned | None:
    """The plan of all recordings; one alone may do without, and why there is none is said.

    Raises:
        InputError: there is no plan for several.
    """
    one = recordings[0]
    if len(recordings) > 1:
        return plan_recordings(recordings)
    if one.truth is None and one.timeline is None:
        return None
    try:
        return plan_recordings(recordings)
    except NoPlan as error:
        console.note(f"note: {error}: a grid on the clock, which isn't aligned with the phases")
        return None


def _targets(
    sources: Sequence[Path], recordings: Sequence[Recording], out: Path | None
) -> list[Path]:
    """The file of each recording; ``sources`` are as the user named them."""
    if out is not None:
        one = len(recordings) == 1
        return [out] if one else [out / f"{r.domain}.labels.json" for r in recordings]
    if not sources:
        raise click.UsageError("--truth FILE alone needs --out FILE")
    return [_beside(named, one.path) for named, one in zip(sources, recordings, strict=True)]


def _check_free(targets: Sequence[Path], force: bool) -> None:
    for target in targets:
        if target.is_dir():
            raise InputError("is a folder", file=target, remedy="name a file with --out")
        if target.exists() and not force:
            raise InputError(
                "exists already",
                file=target,
                remedy="give --force to overwrite what may be reviewed",
            )


def _beside(source: Path, path: Path) -> Path:
    """Where evaluation finds the labels of a bag; those of a run folder in it."""
    if not is_bag(path):
        return path.with_name(f"{path.name}.labels.json")
    _, beside, in_run = labels_places(bag_folder(path))
    return find_labels(path) or (in_run if path != source else beside)


def _write(files: Sequence[NewFile]) -> None:
    for file in files:
        make_folder(file.path.parent)
    write_files(files)


def _say_another_video(recordings: Sequence[Recording], given: Given) -> None:
    event = None if given.event is None else given.event.event
    for one in recordings:
        video = None if one.source is None or one.truth is not None else one.source.video_sha256
        if event is not None and video != event.source.sha256 and video and event.source.sha256:
            console.note(
                f"note: the times of {event.name} are those of another video than {one.path}"
            )


def _say_plan(
    recordings: Sequence[Recording], planned: Planned, targets: Sequence[Path], template: bool
) -> None:
    for one, proposal, target in zip(recordings, planned.proposals, targets, strict=True):
        if proposal is not None and one.truth is not None and not template:
            _say_proposal(target, proposal, one.truth)
        else:
            times_s = f"{len(planned.plan.at)} labels"
            console.note(f"{target}: {FILL_IN} {times_s}; {_sheet_hint(one.path, target)}")
    counts = counts_text(planned.plan.counts)
    text = f"plan: {counts} labels in approach/trigger/conflict/resolution"
    if len(recordings) > 1:
        console.note(f"{text} of each of {len(recordings)} recordings")
    else:
        console.note(
            f"{text}, by the durations of this recording alone: those of another domain may have "
            "others, and are not comparable then; `ssp labels new SYN SIM PHY` plans them together"
        )
    if planned.plan.remark:
        console.note(f"note: {planned.plan.remark}")
    for problem in unanswered(recordings, planned):
        console.note(f"warning: {problem}")


def _say_proposal(out: Path, proposal: Proposal, truth: Truth) -> None:
    event, crop = proposal.event, proposal.crop
    conflict = "none" if event.conflict_s is None else f"{event.conflict_s:.2f} s"
    end = "not within the clip" if event.resolution_s is None else f"{event.resolution_s:.2f} s"
    counts = counts_text(phase_counts(proposal.labels))
    console.note(
        f"{out}: {len(proposal.labels.labels)} labels ({counts}); trigger {event.trigger_s:.2f} s, "
        f"conflict {conflict}, resolution {end}; clip "
        f"{crop.start_s:.2f} to {crop.end_s:.2f} s, {crop.chosen_by}"
        f"{', ' + crop.shortfall if crop.shortfall else ''}. Look them over: they are a proposal."
    )
    rule = _conflict_rule(truth.rules.thresholds)
    console.note(f"conflict where {rule} ({truth.rules.said_by})")
    for problem in response_problems(proposal.labels):
        console.note(f"warning: no model can get a risk response: {problem}")


def _conflict_rule(limits: ConflictThresholds) -> str:
    named = {"TTC": limits.ttc_s, "the gap between the arrivals": limits.arrival_gap_s}
    rules = [f"{name} is under {limit:g} s" for name, limit in named.items() if limit is not None]
    return " or ".join(rules) or "no threshold is given"


def _sheet_hint(source: Path, labels: Path) -> str:
    return f"`ssp labels sheet {source} --labels {labels} --out sheet.html` shows the frames"


def _grid_template(out: Path, one: Recording) -> None:
    """A template on a clock grid, around the event or, where it isn't known, the clip's middle."""
    facts = one.source
    if facts is None:
        raise ValueError(f"{one.path} has no frames to write a template for")
    if not facts.states.series:
        console.note(f"note: {one.path} holds no states to propose labels from: a template")
    middle_s = (facts.first_s + facts.last_s) / 2.0
    span_s, around = (middle_s, middle_s), "the middle of the clip"
    if one.timeline is not None:
        span_s = one.timeline.trigger_s, one.timeline.conflict_s
        around = f"{span_s[0]:.2f} to {span_s[1]:.2f} s"
    times_s = grid_times(facts.first_s, facts.last_s, span_s, str(one.path))
    _write([NewFile(out, template_json(one.scenario, one.domain, one.event_version, times_s))])
    console.note(
        f"{out}: {FILL_IN} {len(times_s)} labels from {times_s[0]:g} to {times_s[-1]:g} s, around "
        f"{around}; {_sheet_hint(one.path, out)}"
    )
