"""Examines one recording of any origin: its event, and what is wrong with it (METHOD 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_eval.audit.checks import CHECKS
from ssp_eval.audit.evidence.evidence import (
    Evidence,
    Source,
    Subject,
    combined,
    is_source_clip,
    observed,
    reviewed,
)
from ssp_eval.audit.evidence.history import History, examine_history
from ssp_eval.audit.evidence.holding import holding_initiator
from ssp_eval.audit.evidence.leaving import leaving_occluder
from ssp_eval.audit.evidence.measure import Measurements, Phases, Scene, measure
from ssp_eval.audit.evidence.pictures import PictureExamination, examine_pictures
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.audit.evidence.recording import Recording
from ssp_eval.audit.evidence.visibility import examine_coverage
from ssp_eval.data.audit import (
    EVENT_PHASES,
    FIELDS,
    CoverageEntry,
    Property,
    phase_fraction,
)
from ssp_eval.recordings.event import Crop, crop_of, rules_of, source_times
from ssp_eval.recordings.states import STATE_AGE_S
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.scenarios.further import further_ids


@dataclass(frozen=True)
class Examination(Subject):
    """One recording, examined.

    Args:
        phi: φ(d, e) per event that could be located.
        phi_half: half width of φ where a K* gives intervals.
        contradictions: between what was announced and what was measured, and what a person saw
            otherwise and refuses nothing.
    """

    phi: Mapping[str, float]
    phi_half: Mapping[str, float]
    findings: tuple[Finding, ...]
    coverage: CoverageEntry
    pictures: PictureExamination
    history: History
    contradictions: tuple[str, ...]

    @property
    def phases_source(self) -> Source:
        """Return the source that says when the phases begin."""
        return "unverified" if self.located is None else self.located.source

    @property
    def properties(self) -> dict[str, Property]:
        """q(d, k) per field; words are None where it isn't determined."""
        return {name: self.values[name].property for name in FIELDS}

    @property
    def is_verified(self) -> bool:
        """True when every q(d, k) was measured, observed or reviewed."""
        return all(self.values[name].source != "unverified" for name in FIELDS)

    @property
    def evidence(self) -> Source:
        """The weakest source of any q(d, k)."""
        order: tuple[Source, ...] = ("states", "reviewed", "observed", "unverified")
        return max((self.values[name].source for name in FIELDS), key=order.index)


# Phases that a run announced and phases measured from states may lie this far apart.
PHASE_TOLERANCE_S = 0.15


def examine(recording: Recording, event: Event | None, version: str | None) -> Examination:
    """Examine what a recording shows by METHOD 4.3, and what is wrong with it by itself.

    Args:
        recording: as read_recording returns it.
        event: the K* of the audit, None: there is none at hand.
        version: version of the K*; None: there is no K*.

    Raises:
        InputError: its states can't be used at all, or it was changed since it was read.
    """
    with recording.files.watched():
        return _examine(recording, event, version)


def _examine(recording: Recording, event: Event | None, version: str | None) -> Examination:
    one = _subject(recording, event, version)
    coverage, blind = examine_coverage(one)
    pictures = examine_pictures(one)
    history = examine_history(one)
    located, phases = one.located, one.phases
    is_cropped = event is not None and one.rules.window is not None
    is_reviewed = located is not None and located.source == "reviewed"
    return Examination(
        **vars(one),
        phi=_phi(phases) if phases is not None and is_cropped else {},
        phi_half=_half_phi(event, phases) if is_reviewed else {},
        findings=(
            *(f for check in CHECKS for f in check(one)),
            *history.findings,
            *blind,
            *pictures.findings,
        ),
        coverage=coverage,
        pictures=pictures,
        history=history,
        contradictions=(
            *(() if one.measured is None else _announced(recording, phases)),
            *(d.text for d in one.observed_differences if not d.refuses),
        ),
    )


def _subject(recording: Recording, event: Event | None, version: str | None) -> Subject:
    """Gather all that is known of a recording before it is judged."""
    is_source = is_source_clip(recording, event)
    evidence: list[Evidence] = []
    crop, measured = _measured(recording, event, is_source)
    if measured is not None:
        by_states = measured.properties, _starts(measured.phases)
        evidence.append(Evidence("states", recording.source, *by_states))
    if event is not None and is_source:
        evidence.append(reviewed(event))
    if recording.agreement is not None:
        evidence.append(observed(recording.agreement))
    starts = next((one.starts for one in evidence if one.starts is not None), None)
    if crop is None:
        crop = _crop(recording, event, is_source, starts or {})
    phases = None
    if crop is not None and starts is not None:
        phases = Phases(crop.start_s, crop.end_s, *(starts.get(name) for name in EVENT_PHASES))
    within = recording if crop is None else recording.within(crop)
    return Subject(
        whole=recording if crop is None else recording.near(crop),
        recording=within,
        event=event,
        version=version,
        is_source=is_source,
        rules=rules_of(event, recording.provenance.run),
        evidence_sources=tuple(evidence),
        values=combined(evidence),
        crop=crop,
        measured=measured,
        phases=phases,
        moments=within.moments(),
    )


def _measured(
    recording: Recording, event: Event | None, is_source: bool
) -> tuple[Crop | None, Measurements | None]:
    """Return the clip by the states, and their measurements within it; None without states."""
    who, (start_s, end_s) = recording.provenance.participants, _covered(recording)
    if who is None or start_s is None or end_s is None or end_s <= start_s or not recording.series:
        return None, None
    rules = rules_of(event, recording.provenance.run)

    # A session begins where part A has its participants; any other recording, with its clip.
    begin = None
    if recording.provenance.run is not None:
        names = {who.vut, *who.targets}
        begin = next((now for _, now in recording.series if names <= set(now)), None)

    def scene(part: Recording, first_s: float, last_s: float) -> Scene:
        return Scene(
            part.series,
            who.vut,
            tuple(who.targets),
            part.road,
            first_s,
            last_s,
            rules,
            () if event is None else further_ids(event),
            begin,
            None if event is None else leaving_occluder(event),
            None if event is None else holding_initiator(event),
        )

    try:
        whole = measure(scene(recording, start_s, end_s))
        crop = (
            _source_crop(recording, event)
            if is_source
            else crop_of(
                start_s, end_s, whole.phases.trigger_s, whole.phases.resolution_s, rules.window
            )
        )
        part = recording.within(crop)
        if len(part.series) == len(recording.series) and (crop.start_s, crop.end_s) == (
            start_s,
            end_s,
        ):
            return crop, whole
        return crop, measure(scene(part, crop.start_s, crop.end_s))
    except ValueError as error:
        raise InputError(
            f"can't be measured: {error}",
            file=recording.path,
            remedy="leave the recording out, or record it again",
        ) from error


def _covered(recording: Recording) -> tuple[float | None, float | None]:
    """Return where the part of a recording that its states cover begins and ends, s.

    Without states that is where the recording itself does, None where it doesn't say.
    """
    start_s, end_s = recording.start_s, recording.end_s
    if start_s is None or end_s is None or not recording.series:
        return start_s, end_s
    first_s, last_s = recording.series[0][0], recording.series[-1][0]
    return (
        first_s if first_s - start_s > STATE_AGE_S else start_s,
        last_s if end_s - last_s > STATE_AGE_S else end_s,
    )


def _source_crop(recording: Recording, event: Event | None) -> Crop:
    """Return the crop of a source clip, which was made with its K* and which the import holds."""
    at = {} if event is None else source_times(event)
    if {"start", "end"} <= set(at):
        length_s = at["end"].mid - at["start"].mid
        return Crop(0.0, length_s, "the K*'s crop of its source (events.clip)")
    return Crop(
        recording.start_s or 0.0, recording.end_s or 0.0, "the whole clip: the K* names no crop"
    )


def _crop(
    recording: Recording, event: Event | None, is_source: bool, starts: Mapping[str, float]
) -> Crop | None:
    """Return the clip of a recording without states."""
    first_s, last_s = recording.start_s, recording.end_s
    if first_s is None or last_s is None or last_s <= first_s:
        return None
    if is_source:
        return _source_crop(recording, event)
    window = rules_of(event).window
    return crop_of(first_s, last_s, starts.get("trigger"), starts.get("resolution"), window)


def _starts(phases: Phases) -> dict[str, float]:
    times = {name: getattr(phases, f"{name}_s") for name in EVENT_PHASES}
    return {name: t_s for name, t_s in times.items() if t_s is not None}


def _phi(phases: Phases) -> dict[str, float]:
    return {
        name: phase_fraction(t_s, phases.start_s, phases.end_s)
        for name, t_s in _starts(phases).items()
        if phases.start_s <= t_s <= phases.end_s
    }


def _half_phi(event: Event | None, phases: Phases | None) -> dict[str, float]:
    if event is None or phases is None:
        return {}
    length_s, at = phases.end_s - phases.start_s, source_times(event)
    halves_s = {name: (at[name].high - at[name].low) / 2.0 for name in EVENT_PHASES if name in at}
    return {name: min(1.0, half_s / length_s) for name, half_s in halves_s.items() if half_s > 0.0}


def _announced(recording: Recording, phases: Phases | None) -> tuple[str, ...]:
    """List the announced phases of the run that aren't those that its states show."""
    mismatches = []
    for name in EVENT_PHASES:
        event_s = recording.phase_events.get(name)
        measured = None if phases is None else getattr(phases, f"{name}_s")
        if event_s is None and (measured is None or recording.provenance.run is None):
            continue
        if event_s is None or measured is None:
            who = "the run announced" if measured is None else "the states show"
            other = "the states don't show it" if measured is None else "the run didn't announce it"
            t_s = event_s if measured is None else measured
            mismatches.append(f"{who} the {name} at {t_s:.2f} s, {other}")
        elif abs(event_s - measured) > PHASE_TOLERANCE_S:
            mismatches.append(
                f"the run announced the {name} at {event_s:.2f} s, the states show it at "
                f"{measured:.2f} s"
            )
    return tuple(mismatches)
