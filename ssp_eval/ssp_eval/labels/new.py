"""``ssp labels new``: labels proposed from recorded states, or a template where there are none.

A recording with states has the times of its phases measured. One without (a video alone) has those
that persons observed in it, or, if it is the K*'s own source clip, reviewed in the K* (METHOD 4.3);
its labels can't be proposed, so that it gets a template.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.hashing import sha256_file
from ssp_core.host.terminal import pasteable
from ssp_core.options import Domain, Number
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.audit import EVENT_PHASES
from ssp_eval.data.labels import FILL_IN, counts_text, phase_counts, template_json
from ssp_eval.data.provenance import bag_folder, find_bag, find_labels, labels_places
from ssp_eval.labels.check import response_problems
from ssp_eval.labels.plan import NoPlan, Plan, Timeline, plan_labels
from ssp_eval.labels.propose import Proposal, grid_times, locate, propose
from ssp_eval.labels.review import NewFile, proposed_file, write_files
from ssp_eval.labels.truth import (
    UNKNOWN_VERSION,
    KStar,
    Source,
    Truth,
    is_bag,
    load_k_star,
    read_source,
    shipped_event,
    truth_from_file,
    truth_of,
)
from ssp_eval.observations.agreement import agree
from ssp_eval.observations.files import Footage, load_observations
from ssp_eval.recordings.event import crop_of, rules_of, source_times
from ssp_eval.score.thresholds import DEFAULT

_PATH = click.Path(path_type=Path)
_MOST = 3


@dataclass(frozen=True)
class _UserValues:
    """The values that a user states where a recording doesn't.

    Args:
        truth: file of the states of the recording that holds none.
        start_s: of a video's clip in its file, s.
    """

    domain: str | None = None
    scenario: str | None = None
    event_version: str | None = None
    event: KStar | None = None
    truth: Path | None = None
    start_s: float = 0.0


@dataclass(frozen=True)
class _Recording:
    """A recording that is to be labelled; times on its clip clock.

    Args:
        path: of bag, video or truth file.
        event_version: K* version, or UNKNOWN_VERSION.
        origin: hash or name of what it is labelled from.
        truth: its states; None: it has none.
        timeline: its phases as persons observed them, or reviewed them in K*, where it has no
            states; None: they are unknown.
        source: what it says of itself; None: it is a truth file alone.
    """

    path: Path
    scenario: str
    domain: str
    event_version: str
    origin: str
    truth: Truth | None
    timeline: Timeline | None = None
    source: Source | None = None


@dataclass(frozen=True)
class _LabelPlan:
    """A recording with the plan of its labels; without states there is no proposal."""

    recording: _Recording
    timeline: Timeline
    plan: Plan
    proposal: Proposal | None

    @property
    def times_s(self) -> list[float]:
        """Return the times of its labels."""
        return [self.timeline.time_of(at) for at in self.plan.at]

    def file(self, path: Path, template: bool) -> NewFile:
        """Return the recording's labels file.

        Args:
            path: of the file.
            template: nothing is to be proposed, only the times and phases of the labels.
        """
        one = self.recording
        if self.proposal is not None and not template:
            return proposed_file(path, self.proposal, one.origin)
        onset_s = self.timeline.risk_s(self.plan)
        about = one.scenario, one.domain, one.event_version
        return NewFile(path, template_json(*about, self.times_s, self.plan.at, onset_s))

    @property
    def unanswered(self) -> str:
        """Describe the labels that every model misses; empty where there are none.

        Their clip shows no frame near enough for METHOD 6.1.
        """
        crop, limit_s = self.timeline.crop, DEFAULT.match_window_s
        shown_s = [t_s for t_s in self.timeline.frames_s if crop.holds(t_s)]
        missed = [
            f"{t_s:.3f}"
            for t_s in self.times_s
            if not any(t_s - s >= -1e-9 and DEFAULT.at_most(t_s - s, limit_s) for s in shown_s)
        ]
        if not missed:
            return ""
        return (
            f"{self.recording.path}: at {', '.join(missed)} s the clip's newest frame is more than "
            f"{limit_s:g} s old; no model is asked there, and all miss these labels"
        )


@click.command()
@click.argument("sources", metavar="[BAG|VIDEO]…", type=_PATH, nargs=-1)
@click.option(
    "--truth", type=_PATH, help="States of a clip (ssp.truth/1), as its maker wrote them."
)
@click.option("--out", type=_PATH, help="Labels file, or a folder for those of several recordings.")
@click.option("--domain", type=Domain(), help="Where the source doesn't say.")
@click.option("--scenario", help="Where the source doesn't say.")
@click.option("--event-version", help="K* version, where the source names none.")
@click.option("--event", help="K*, by name or file, where the recordings hold none.")
@click.option("--template", is_flag=True, help="Write templates even where states are recorded.")
@click.option(
    "--start", type=Number(0), default=0.0, help="Start of the clip in the file VIDEO, s."
)
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
    """Propose labels from recorded states, or write a template where there are none.

    Give all recordings of a scenario at once (SYN SIM PHY: bags, run folders, or the video that K*
    was reviewed on): their label times are planned together, so that each has as many labels in
    every phase (METHOD 5.2b) and the domains can be compared. One file is written beside each, or
    into the folder --out. A recording alone is planned by its own phases.

    What is proposed is marked in a sidecar (FILE.proposal.json) until `ssp spec review FILE` or an
    edit confirms it. A recording without states gets a template with the label times and no
    statements yet.

    The thresholds of a conflict are those of the K* in the bag, else of --event, else of the
    shipped K* of the scenario, unless another version is named. Without a K*, they are the run's.
    """
    if len(sources) > _MOST:
        raise click.UsageError(f"give at most {_MOST} recordings, one per domain")
    if not sources and (truth is None or template):
        raise click.UsageError("give a BAG or VIDEO, or --truth FILE")
    options = _UserValues(
        domain, scenario, event_version, None if event is None else load_k_star(event), truth, start
    )
    paths = [find_bag(path) if is_bag(path) else path for path in sources]
    recordings = _read(paths, options)
    targets = _targets(sources, recordings, out)
    _check_free(targets, force)
    _say_another_video(recordings, options)
    first = recordings[0]
    if first.event_version == UNKNOWN_VERSION:
        console.note(
            f"note: neither {first.path} nor --event or --event-version names a K* version; the "
            f"labels say {UNKNOWN_VERSION}, and fit no recording of a K*"
        )
    planned = _plan(recordings) if len(recordings) > 1 else _plan_alone(first)
    if planned:
        _write([one.file(path, template) for one, path in zip(planned, targets, strict=True)])
        _say_plan(planned, targets, template)
        return
    if first.truth is None or template:
        _grid_template(targets[0], first)
        return
    proposal = propose(first.truth)
    _write([proposed_file(targets[0], proposal, first.origin)])
    _say_proposal(targets[0], proposal, first.truth)


def _read(paths: Sequence[Path], options: _UserValues) -> list[_Recording]:
    """Read the parts of recordings that planning and proposing their labels need.

    Args:
        paths: of bags and videos; none: the truth file alone.
        options: of the command.

    Raises:
        InputError: one is no recording, or realises another K*; two are of one domain or not of one
            event; or the truth file belongs to none.
    """
    if not paths:
        return [_of_truth_file(options)]
    sources = [
        read_source(path, options.start_s)
        for path in console.tracked(paths, "reading recordings", len(paths))
    ]
    event = options.event or next((one.event for one in sources if one.event is not None), None)
    bare = [one for one in sources if not one.states.series]
    if options.truth is not None and len(bare) != 1:
        what = "all recordings hold states" if not bare else "several recordings hold no states"
        raise InputError(
            f"can't be used: {what}",
            file=options.truth,
            field="--truth",
            remedy="leave --truth out, or give one recording without states beside it",
        )
    recordings = [_of_source(one, event, options) for one in sources]
    _check_same_event(recordings)
    return recordings


def _of_truth_file(options: _UserValues) -> _Recording:
    if options.truth is None:
        raise InputError(
            "there is neither a recording nor a truth file",
            field="--truth",
            remedy="give a recording or --truth",
        )
    version = options.event_version or (None if options.event is None else options.event.version)
    truth = truth_from_file(options.truth, options.domain, version, options.event)
    return _Recording(
        options.truth,
        truth.scenario,
        truth.domain,
        truth.event_version,
        sha256_file(options.truth),
        truth,
    )


def _of_source(source: Source, event: KStar | None, options: _UserValues) -> _Recording:
    path, facts = source.path, source.provenance
    origin = source.origin or str(path)
    truth_file = None if source.states.series else options.truth
    if source.states.series or truth_file is not None:
        truth = truth_of(source, event, truth_file, options.event_version)
        return _Recording(
            path, truth.scenario, truth.domain, truth.event_version, origin, truth, source=source
        )
    scenario, domain, version = (
        options.scenario,
        options.domain or "synthetic",
        options.event_version,
    )
    if facts is not None:
        scenario, domain = facts.scenario or scenario, facts.domain
        version = facts.event_version or version
    k_star = event or shipped_event(scenario, version)
    if scenario is None and k_star is not None:
        scenario = k_star.event.name
    if scenario is None:
        raise InputError(
            "doesn't say which scenario it shows", file=path, remedy="give --scenario or --event"
        )
    if k_star is not None and options.event is None and version != k_star.version:
        k_star = None
    timeline = _phases(source, k_star, domain, is_named=options.event is not None)
    version = version or (None if k_star is None else k_star.version) or UNKNOWN_VERSION
    return _Recording(path, scenario, domain, version, origin, None, timeline, source)


def _phases(source: Source, k_star: KStar | None, domain: str, is_named: bool) -> Timeline | None:
    """Return the phases of a recording without states: its observers', else K*'s (METHOD 4.3).

    K* tells of its source clip alone. A synthetic video without observations is taken for that clip
    where a person says so: who names K* for it (``is_named``), or who imported it as one of K*'s
    where K* knows of no other file.
    """
    digest = None if k_star is None else k_star.event.source.sha256
    is_synthetic = domain == "synthetic"
    is_source = is_synthetic and digest is not None and digest == source.video_sha256
    starts: Mapping[str, float] | None = None
    if not is_source and source.provenance is not None:
        footage = Footage(source.provenance.bag_sha256, source.frames_s)
        if observations := [one for _, one in load_observations(source.path, footage)]:
            starts = agree(observations, footage.period_s).answers.phase_starts()
    may_be_it = is_source or (is_synthetic and (is_named or digest is None))
    if starts is None and k_star is not None and may_be_it:
        # K* has them on the source's clock.
        at = source_times(k_star.event)
        starts = {name: at[name].mid - source.zero_s for name in EVENT_PHASES if name in at}
    if starts is None or len(starts) < len(EVENT_PHASES):
        return None
    trigger_s, conflict_s, resolution_s = (starts[name] for name in EVENT_PHASES)
    window = None if k_star is None else rules_of(k_star.event).window
    crop = crop_of(source.first_s, source.last_s, trigger_s, resolution_s, window)
    return Timeline(domain, trigger_s, conflict_s, resolution_s, crop, source.frames_s)


def _check_same_event(recordings: Sequence[_Recording]) -> None:
    first = recordings[0]
    paths: dict[str, Path] = {}
    for one in recordings:
        for field, ours, theirs in (
            ("scenario", first.scenario, one.scenario),
            ("K* version", first.event_version, one.event_version),
        ):
            if ours != theirs and UNKNOWN_VERSION not in (ours, theirs):
                raise InputError(
                    f"is of the {field} {theirs}, {first.path} of {ours}",
                    file=one.path,
                    remedy="labels are planned together for recordings of one event",
                )
        if one.domain in paths:
            raise InputError(
                f"is of the domain {one.domain}, as {paths[one.domain]} is",
                file=one.path,
                remedy=f"give one recording per domain ({', '.join(DOMAINS)})",
            )
        paths[one.domain] = one.path


def _plan(recordings: Sequence[_Recording]) -> list[_LabelPlan]:
    """Return one plan for all (METHOD 5.2b), and a proposal for each that has states.

    Raises:
        InputError: there is no plan, or a recording's phases aren't known.
    """
    located = [
        None if one.truth is None else locate(one.truth)
        for one in console.tracked(recordings, "finding events", len(recordings))
    ]
    timelines = []
    for one, location in zip(recordings, located, strict=True):
        timeline = one.timeline if location is None else location.timeline()
        if timeline is None:
            raise InputError(
                "has no states, and the times of its phases are unknown",
                file=one.path,
                remedy="have a person look at it (`ssp audit observe`), give its clip's --truth "
                "file, or of K*'s own synthetic clip its K* with --event",
            )
        timelines.append(timeline)
    plan = plan_labels(timelines)
    return [
        _LabelPlan(one, timeline, plan, None if location is None else location.by_plan(plan))
        for one, timeline, location in zip(recordings, timelines, located, strict=True)
    ]


def _plan_alone(one: _Recording) -> list[_LabelPlan]:
    """Return the plan of a single recording; [] where there is none, and why is said."""
    if one.truth is None and one.timeline is None:
        return []
    try:
        return _plan([one])
    except NoPlan as error:
        console.note(f"note: {error}: a grid on the clock, which isn't aligned with the phases")
        return []


def _targets(
    sources: Sequence[Path], recordings: Sequence[_Recording], out: Path | None
) -> list[Path]:
    """Return the file of each recording; ``sources`` are as the user named them."""
    if out is not None:
        one = len(recordings) == 1
        return [out] if one else [out / f"{r.domain}.labels.json" for r in recordings]
    if not sources:
        raise click.UsageError("--truth FILE alone needs --out FILE")
    return [_beside(source, one.path) for source, one in zip(sources, recordings, strict=True)]


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
    """Return where evaluation finds the labels of a bag; those of a run folder in it."""
    if not is_bag(path):
        return path.with_name(f"{path.name}.labels.json")
    _, beside, in_run = labels_places(bag_folder(path))
    return find_labels(path) or (in_run if path != source else beside)


def _write(files: Sequence[NewFile]) -> None:
    for file in files:
        make_folder(file.path.parent)
    write_files(files)


def _say_another_video(recordings: Sequence[_Recording], options: _UserValues) -> None:
    event = None if options.event is None else options.event.event
    for one in recordings:
        video = None if one.source is None or one.truth is not None else one.source.video_sha256
        if event is not None and video != event.source.sha256 and video and event.source.sha256:
            console.note(
                f"note: the times of {event.name} are those of another video than {one.path}"
            )


def _say_plan(planned: Sequence[_LabelPlan], targets: Sequence[Path], template: bool) -> None:
    plan = planned[0].plan
    for one, target in zip(planned, targets, strict=True):
        truth = one.recording.truth
        if one.proposal is not None and truth is not None and not template:
            _say_proposal(target, one.proposal, truth)
        else:
            hint = _sheet_hint(one.recording.path, target)
            console.note(f"{target}: {FILL_IN} {len(plan.at)} labels; {hint}")
    counts = counts_text(plan.counts)
    text = f"plan: {counts} labels in approach/trigger/conflict/resolution"
    if len(planned) > 1:
        console.note(f"{text} of each of {len(planned)} recordings")
    else:
        console.note(
            f"{text}, by the durations of this recording alone: those of another domain may have "
            "others, and are not comparable then; `ssp labels new SYN SIM PHY` plans them together"
        )
    if plan.remark:
        console.note(f"note: {plan.remark}")
    for one in planned:
        if one.unanswered:
            console.note(f"warning: {one.unanswered}")


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
    console.note(f"conflict where {rule} ({truth.rules.origin})")
    for problem in response_problems(proposal.labels):
        console.note(f"warning: no model can get a risk response: {problem}")


def _conflict_rule(limits: ConflictThresholds) -> str:
    limit_by_name = {"TTC": limits.ttc_s, "the gap between the arrivals": limits.arrival_gap_s}
    rules = [
        f"{name} is under {limit:g} s" for name, limit in limit_by_name.items() if limit is not None
    ]
    return " or ".join(rules) or "no threshold is given"


def _sheet_hint(source: Path, labels: Path) -> str:
    command = pasteable("labels", "sheet", source, "--labels", labels, "--out", "sheet.html")
    return f"{command} shows the frames"


def _grid_template(out: Path, one: _Recording) -> None:
    """Write a template on a clock grid, around the event or, if unknown, the clip's middle."""
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
