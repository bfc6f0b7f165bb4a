"""Whether the labels of a scenario's recordings let its domains be compared (METHOD 5.2b)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ssp_core.vocabulary import PHASES
from ssp_eval.labels.model import Labels
from ssp_eval.labels.place import BY_PHASE, At

_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LabelComparison:
    """What several recordings' labels allow.

    Args:
        domains: how many recordings there are; one alone has nobody to be compared with.
        comparable: whether a difference between their scores can be one between domains.
        aligned: whether their labels lie at the same places of the phases.
        text: how many labels each has per phase, and what keeps them apart; for people.
    """

    domains: int
    comparable: bool
    aligned: bool
    text: str

    @property
    def line(self) -> str:
        """The text with its verdict, for people."""
        if self.domains > 1 and not self.comparable:
            return f"{self.text}: not comparable"
        if self.domains > 1 and not self.aligned:
            return f"{self.text}: not phase-aligned"
        return self.text


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
    count = len(by_name)
    counts = {name: counts_text(phase_counts(labels)) for name, labels in by_name.items()}
    told = ", ".join(f"{name} {text}" for name, text in counts.items())
    plans = {labels.plan for labels in by_name.values()}
    if len(plans) > 1:
        parts = [f"{name} by {labels.plan}" for name, labels in by_name.items()]
        text = f"{told}; label times differ in kind: {', '.join(parts)}"
        return LabelComparison(count, False, False, text)
    if plans != {BY_PHASE}:
        same = len(set(counts.values())) <= 1
        return LabelComparison(count, same, False, told)
    places = {name: [label.at for label in labels.labels] for name, labels in by_name.items()}
    first = next(iter(places.values()))
    differing = [name for name, other in places.items() if not _are_equal(first, other)]
    if not differing:
        return LabelComparison(count, True, True, told)
    if len(set(counts.values())) == 1:
        told = f"{told}, at other places of the phases in {', '.join(differing)}"
    return LabelComparison(count, False, False, told)


def compare_by_scenario(
    labelled: Iterable[tuple[str, str, Labels]],
) -> dict[str, LabelComparison]:
    """What the labels of each scenario allow.

    Args:
        labelled: scenario, domain and labels of recordings; of several with the same scenario and
            domain the first counts.
    """
    found: dict[str, dict[str, Labels]] = {}
    for scenario, domain, labels in labelled:
        found.setdefault(scenario, {}).setdefault(domain, labels)
    return {scenario: compare_labels(found[scenario]) for scenario in sorted(found)}


def _are_equal(one: list[At | None], other: list[At | None]) -> bool:
    return len(one) == len(other) and all(
        a is not None
        and b is not None
        and a.phase == b.phase
        and math.isclose(a.value, b.value, rel_tol=0.0, abs_tol=_TOLERANCE)
        for a, b in zip(one, other, strict=True)
    )
