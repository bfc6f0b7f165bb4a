"""The objections to a labels file of the right form: phases, times, marks, risk response."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from ssp_core.motion.event import TOLERANCE_S
from ssp_core.vocabulary import PHASES
from ssp_eval.data.labels import Labels, PhasePosition
from ssp_eval.labels.plan import APART_S
from ssp_eval.recordings.event import source_times
from ssp_eval.score.thresholds import DEFAULT
from ssp_scenario_manager.event_spec.model import Event, Interval

_TOLERANCE_S = 1e-6


def phase_problems(labels: Labels) -> list[str]:
    """Find phases that go back: they follow each other as METHOD 1 says."""
    problems = []
    for i, (before, after) in enumerate(pairwise(labels.labels), start=1):
        if PHASES.index(after.phase) < PHASES.index(before.phase):
            problems.append(
                f"labels[{i}].phase: {after.phase} at {after.t_s:g} s comes after "
                f"{before.phase} at {before.t_s:g} s; phases don't go back"
            )
    return problems


def plan_problems(labels: Labels) -> list[str]:
    """List where labels of a plan by phase depart from METHOD 5.2b; [] for a clock grid."""
    problems = []
    for i, label in enumerate(labels.labels):
        if label.at is not None and label.phase != label.at.phase:
            problems.append(
                f"labels[{i}].phase: {label.phase}, and its place in the plan is {label.at}"
            )
    for i, (before, after) in enumerate(pairwise(labels.labels), start=1):
        if before.at is None or after.at is None:
            continue
        if not _follows(before.at, after.at):
            problems.append(f"labels[{i}].at: {after.at} stands after {before.at}")
        if after.t_s - before.t_s < APART_S - _TOLERANCE_S:
            problems.append(
                f"labels[{i}].t_s: {after.t_s - before.t_s:.3f} s after the label before; a plan "
                f"keeps {APART_S:g} s"
            )
    return problems


def _follows(before: PhasePosition, after: PhasePosition) -> bool:
    if before.phase != after.phase:
        return PHASES.index(before.phase) < PHASES.index(after.phase)
    is_approach = before.phase == "approach"
    return after.value < before.value if is_approach else after.value > before.value


def risk_warnings(labels: Labels) -> list[str]:
    """Return each risk that is visible before its onset or no longer while the conflict lasts."""
    warnings = []
    onset_s = labels.risk_onset_s
    for i, label in enumerate(labels.labels):
        at = f"labels[{i}]"
        if label.risk_visible and label.t_s < onset_s - _TOLERANCE_S:
            warnings.append(
                f"{at}.risk_visible: true at {label.t_s:g} s, before risk_time_s ({onset_s:g} s)"
            )
        if label.risk_visible and label.phase == "approach":
            warnings.append(
                f"{at}.risk_visible: true in the approach, before anything is to be seen"
            )
    for i, (before, after) in enumerate(pairwise(labels.labels), start=1):
        lasting = after.phase in ("trigger", "conflict")
        if before.risk_visible and not after.risk_visible and lasting:
            warnings.append(
                f"labels[{i}].risk_visible: false in the {after.phase} after it was true"
            )
    return warnings


def event_problems(labels: Labels, event: Event, version: str) -> list[str]:
    """List phases that K*'s times don't allow, and a version other than K*'s.

    Args:
        labels: of the clip that K* was taken from; other clips have other times. Their time 0 is
            the start of K*'s crop.
        event: the K*.
        version: of the K*.
    """
    problems = []
    if labels.event_version != version:
        problems.append(f"event_version: {labels.event_version} is not the event's, {version}")
    starts: dict[str, Any] = {p: getattr(event.events, p).start for p in PHASES}
    clip = source_times(event).get("start")
    zero_s = 0.0 if clip is None else clip.mid
    for i, label in enumerate(labels.labels):
        index = PHASES.index(label.phase)
        begins = _span(starts[label.phase], zero_s)
        if begins and label.t_s < begins[0] - _TOLERANCE_S:
            problems.append(
                f"labels[{i}].phase: {label.phase} at {label.t_s:g} s, but it starts at "
                f"{begins[0]:g} s at the earliest"
            )
        after = _span(starts[PHASES[index + 1]], zero_s) if index + 1 < len(PHASES) else None
        if after and label.t_s > after[1] + _TOLERANCE_S:
            problems.append(
                f"labels[{i}].phase: {label.phase} at {label.t_s:g} s, but {PHASES[index + 1]} "
                f"starts by {after[1]:g} s"
            )
    return problems


def _span(start: Interval | str, zero_s: float) -> tuple[float, float] | None:
    if isinstance(start, str):
        return None
    span = start.si
    return span.low - zero_s, span.high - zero_s


def response_problems(labels: Labels) -> list[str]:
    """List why no model could get a risk response (METHOD 6.9) under these labels.

    Empty if one can.

    It takes two labels, at or after risk onset, adjacent among those whose conflict is potential
    or active, that admit a defensive action and lie at most 0.6 s apart.
    """
    onset_s = labels.risk_onset_s
    defensive = {"decelerate", "stop"}
    candidates = [
        label
        for label in labels.labels
        if label.t_s >= onset_s - TOLERANCE_S and label.conflict in ("potential", "active")
    ]
    if len(candidates) < 2:
        return [
            f"only {len(candidates)} label(s) at or after the risk onset ({onset_s:g} s) have "
            "conflict potential or active; a risk response needs two"
        ]
    gaps_s = []
    for before, after in pairwise(candidates):
        if defensive.intersection(before.lon_actions) and defensive.intersection(after.lon_actions):
            gaps_s.append(after.t_s - before.t_s)
    if not gaps_s:
        return ["no two adjacent labels in the conflict admit decelerate or stop"]
    if not DEFAULT.at_most(min(gaps_s), DEFAULT.response_gap_s):
        return [
            f"labels in the conflict are {min(gaps_s):g} s apart; a risk response needs two at "
            f"most {DEFAULT.response_gap_s} s apart"
        ]
    return []
