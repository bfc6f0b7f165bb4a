"""Labels of a scenario's recordings by one plan: proposals, or templates where states are missing.

A recording with states has the times of its phases measured. One without (a video alone) has those
that persons observed in it, or, if it is the K*'s own source clip, reviewed in the K* (METHOD 4.3);
its labels can't be proposed, so that it gets a template.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.audit import EVENT_PHASES
from ssp_eval.data.labels import template_json
from ssp_eval.labels.plan import Plan, Timeline
from ssp_eval.labels.propose import Proposal, propose_planned
from ssp_eval.labels.review import NewFile, proposed_file
from ssp_eval.labels.truth import (
    UNKNOWN_VERSION,
    KStar,
    Source,
    Truth,
    read_source,
    shipped_event,
    truth_from_file,
    truth_of,
)
from ssp_eval.observations.agreement import agree
from ssp_eval.observations.files import Footage, load_observations
from ssp_eval.recordings.event import crop_of, rules_of, source_times
from ssp_eval.score.thresholds import DEFAULT


@dataclass(frozen=True)
class Given:
    """What a user says where a recording doesn't.

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
class Recording:
    """A recording that is to be labelled; times on its clip clock.

    Args:
        path: of bag, video or truth file.
        event_version: K* version, or UNKNOWN_VERSION.
        origin: hash or name of what it is labelled from.
        truth: its states; None: it has none.
        timeline: its phases as persons observed them, or reviewed them in K*, where it has no
            states; None: nobody knows them.
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
class Planned:
    """One plan, and what it gives for each recording.

    Args:
        proposals: in the order of the recordings; None where there are no states.
    """

    plan: Plan
    proposals: tuple[Proposal | None, ...]


def read_recordings(paths: Sequence[Path], given: Given) -> list[Recording]:
    """What is needed of recordings to plan and propose their labels.

    Args:
        paths: of bags and videos; none: the truth file alone.

    Raises:
        InputError: one is no recording, or realises another K*; two are of one domain or not of one
            event; or the truth file belongs to none.
    """
    if not paths:
        return [_of_truth_file(given)]
    sources = [read_source(path, given.start_s) for path in paths]
    event = given.event or next((one.event for one in sources if one.event is not None), None)
    bare = [one for one in sources if not one.states.series]
    if given.truth is not None and len(bare) != 1:
        what = "all recordings hold states" if not bare else "several recordings hold no states"
        raise InputError(f"can't be used: {what}", file=given.truth, field="--truth")
    found = [_of_source(one, event, given) for one in sources]
    _check_same_event(found)
    return found


def _of_truth_file(given: Given) -> Recording:
    if given.truth is None:
        raise InputError("there is neither a recording nor a truth file", field="--truth")
    version = given.event_version or (None if given.event is None else given.event.version)
    truth = truth_from_file(given.truth, given.domain, version, given.event)
    return Recording(
        given.truth, truth.scenario, truth.domain, truth.event_version, sha256_file(given.truth),
        truth,
    )  # fmt: skip


def _of_source(source: Source, event: KStar | None, given: Given) -> Recording:
    path, facts = source.path, source.provenance
    origin = source.origin or str(path)
    truth_file = None if source.states.series else given.truth
    if source.states.series or truth_file is not None:
        truth = truth_of(source, event, truth_file, given.event_version)
        return Recording(
            path, truth.scenario, truth.domain, truth.event_version, origin, truth, source=source
        )
    scenario, domain, version = given.scenario, given.domain or "synthetic", given.event_version
    if facts is not None:
        scenario, domain = facts.scenario or scenario, facts.domain
        version = facts.event_version or version
    known = event or shipped_event(scenario, version)
    if scenario is None and known is not None:
        scenario = known.event.name
    if scenario is None:
        raise InputError(
            "doesn't say which scenario it shows", file=path, remedy="give --scenario or --event"
        )
    if known is not None and given.event is None and version != known.version:
        known = None
    timeline = _phases(source, known, domain, named=given.event is not None)
    version = version or (None if known is None else known.version) or UNKNOWN_VERSION
    return Recording(path, scenario, domain, version, origin, None, timeline, source)


def _phases(source: Source, k_star: KStar | None, domain: str, named: bool) -> Timeline | None:
    """The phases of a recording without states, by whoever may say so (METHOD 4.3).

    K* tells of its source clip alone. A synthetic video that nobody observed is taken for that clip
    where a person says so: who names K* for it (``named``), or who imported it as one of K*'s where
    K* knows of no other file.
    """
    digest = None if k_star is None else k_star.event.source.sha256
    is_synthetic = domain == "synthetic"
    is_source = is_synthetic and digest is not None and digest == source.video_sha256
    starts: Mapping[str, float] | None = None
    if not is_source and source.provenance is not None:
        footage = Footage(source.provenance.bag_sha256, source.frames_s)
        if told := [one for _, one in load_observations(source.path, footage)]:
            starts = agree(told, footage.period_s).answers.phase_starts()
    may_be_it = is_source or (is_synthetic and (named or digest is None))
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


def _check_same_event(recordings: Sequence[Recording]) -> None:
    first = recordings[0]
    seen: dict[str, Path] = {}
    for one in recordings:
        for field, ours, theirs in (
            ("scenario", first.scenario, one.scenario),
            ("K* version", first.event_version, one.event_version),
        ):
            if ours != theirs and UNKNOWN_VERSION not in (ours, theirs):
                raise InputError(
                    f"is of the {field} {theirs}, {first.path} of {ours}", file=one.path,
                    remedy="labels are planned together for recordings of one event",
                )  # fmt: skip
        if one.domain in seen:
            raise InputError(
                f"is of the domain {one.domain}, as {seen[one.domain]} is", file=one.path,
                remedy=f"give one recording per domain ({', '.join(DOMAINS)})",
            )  # fmt: skip
        seen[one.domain] = one.path


def plan_recordings(recordings: Sequence[Recording]) -> Planned:
    """One plan for all (METHOD 5.2b), and a proposal for each that has states.

    Raises:
        InputError: there is no plan, or a recording's phases aren't known.
    """
    for one in recordings:
        if one.truth is None and one.timeline is None:
            raise InputError(
                "holds no states, and nobody says when its phases begin", file=one.path,
                remedy="have a person look at it (`ssp audit observe`), give its clip's --truth "
                "file, or of K*'s own synthetic clip its K* with --event",
            )  # fmt: skip
    truths = [one.truth for one in recordings if one.truth is not None]
    said = [one.timeline for one in recordings if one.timeline is not None]
    plan, made = propose_planned(truths, others=said)
    proposals = iter(made)
    return Planned(
        plan, tuple(None if one.truth is None else next(proposals) for one in recordings)
    )


def unanswered(recordings: Sequence[Recording], planned: Planned) -> list[str]:
    """Labels that every model misses, for people: their clip shows no frame near enough for
    METHOD 6.1."""
    found = []
    for one, proposal in zip(recordings, planned.proposals, strict=True):
        if proposal is not None and one.truth is not None:
            times_s = [label.t_s for label in proposal.labels.labels]
            crop, frames_s = proposal.crop, one.truth.frames_s
        elif one.timeline is not None:
            times_s = [one.timeline.time_of(at) for at in planned.plan.at]
            crop, frames_s = one.timeline.crop, one.timeline.frames_s
        else:
            continue
        shown_s = [t_s for t_s in frames_s if crop.holds(t_s)]
        limit_s = DEFAULT.match_window_s
        missed = [
            f"{t_s:.3f}"
            for t_s in times_s
            if not any(t_s - s >= -1e-9 and DEFAULT.at_most(t_s - s, limit_s) for s in shown_s)
        ]
        if missed:
            found.append(
                f"{one.path}: at {', '.join(missed)} s the clip's newest frame is more than "
                f"{limit_s:g} s old; no model is asked there, and all miss these labels"
            )
    return found


def planned_files(
    recordings: Sequence[Recording], planned: Planned, targets: Sequence[Path], template: bool
) -> list[NewFile]:
    """The labels files of a plan.

    Args:
        template: nothing is to be proposed, only the times and phases of the labels.
    """
    files = []
    for one, proposal, path in zip(recordings, planned.proposals, targets, strict=True):
        if proposal is not None and not template:
            files.append(proposed_file(path, proposal, one.origin))
            continue
        if proposal is not None:
            times_s = [label.t_s for label in proposal.labels.labels]
            onset_s = proposal.labels.risk_time_s
        elif one.timeline is not None:
            times_s = [one.timeline.time_of(at) for at in planned.plan.at]
            onset_s = one.timeline.risk_s(planned.plan)
        else:
            raise ValueError(f"{one.path} was not planned")
        content = template_json(
            one.scenario, one.domain, one.event_version, times_s, planned.plan.at, onset_s
        )
        files.append(NewFile(path, content))
    return files
