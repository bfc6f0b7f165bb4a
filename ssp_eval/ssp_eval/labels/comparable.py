"""Whether the labels of a scenario's recordings let its domains be compared (METHOD 5.2b)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ssp_core.vocab import PHASES
from ssp_eval.labels.model import Labels
from ssp_eval.labels.place import BY_PHASE, At

NOT_COMPARABLE, NOT_ALIGNED = "not comparable", "not phase-aligned"
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LabelComparison:
    """What several recordings' labels allow.

    Args:
        comparable: whether a difference between their scores can be one between domains.
        aligned: whether their labels lie at the same places of the phases.
        text: how many labels each has per phase, and what keeps them apart; for people.
    """

    comparable: bool
    aligned: bool
    text: str


def phase_counts(labels: Labels) -> dict[str, int]:
    """How many labels each phase has."""
    return {phase: sum(label.phase == phase for label in labels.labels) for phase in PHASES}


def counts_text(counts: Mapping[str, int]) -> str:
    """``3/1/4/1``: labels in approach, trigger, conflict and resolution."""
    return "/".join(str(counts[phase]) for phase in PHASES)


def compare_labels(by_name: Mapping[str, Labels]) -> LabelComparison:
    """Whether recordings of one event are comparable at label level (METHOD 5.2b).

    Args:
        by_name: labels of each recording, by its domain or another name.
    """
    counts = {name: counts_text(phase_counts(labels)) for name, labels in by_name.items()}
    told = ", ".join(f"{name} {text}" for name, text in counts.items())
    plans = {labels.plan for labels in by_name.values()}
    if len(plans) > 1:
        parts = [f"{name} by {labels.plan}" for name, labels in by_name.items()]
        text = f"{told}; label times differ in kind: {', '.join(parts)}"
        return LabelComparison(False, False, text)
    if plans != {BY_PHASE}:
        same = len(set(counts.values())) <= 1
        return LabelComparison(same, False, told)
    places = {name: [label.at for label in labels.labels] for name, labels in by_name.items()}
    first = next(iter(places.values()))
    differing = [name for name, other in places.items() if not _are_equal(first, other)]
    if not differing:
        return LabelComparison(True, True, told)
    if len(set(counts.values())) == 1:
        told = f"{told}, at other places of the phases in {', '.join(differing)}"
    return LabelComparison(False, False, told)


def _are_equal(one: list[At | None], other: list[At | None]) -> bool:
    return len(one) == len(other) and all(
        a is not None
        and b is not None
        and a.phase == b.phase
        and math.isclose(a.value, b.value, rel_tol=0.0, abs_tol=_TOLERANCE)
        for a, b in zip(one, other, strict=True)
    )
