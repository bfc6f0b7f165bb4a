"""A failed check with all that a person needs to mend it; shared by the predicates of C1–C5."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.event_spec.fields import (
    ROAD_FIELD,
    UNITS,
    Rule,
    Span,
    get,
    granules,
    owner,
    rule_of,
    show,
)
from ssp_scenario_manager.event_spec.load import body, safety_critical_fields
from ssp_scenario_manager.event_spec.model import (
    UNRESOLVED,
    Event,
    Interval,
    MotionCell,
    Participant,
    QuantityField,
)
from ssp_scenario_manager.scenarios.base import Kind
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# form: the file isn't readable as K*; C1–C5: METHOD 1; review: part U and the seals in it.
Check = Literal["form", "C1", "C2", "C3", "C4", "C5", "review"]
Origin = Literal[
    "source video",
    "extraction",
    "contradiction in the structure",
    "platform limit",
    "missing review",
    "open decision",
]


@dataclass(frozen=True, slots=True)
class Failure:
    """One check that doesn't hold.

    Args:
        check: which one.
        field: dotted path of the field, such as ``motion.ot1.trigger.lateral``.
        evidence: the value found, and what it was held against.
        reason: why that is wrong, one clause.
        origin: where it comes from (METHOD 1), or that it isn't decided or reviewed yet.
        remedy: what would be right.
    """

    check: Check
    field: str
    evidence: str
    reason: str
    origin: Origin
    remedy: str

    def as_dict(self) -> dict[str, str]:
        return asdict(self)


# So many failures with the same reason and remedy are said one by one.
_FEW = 2


def summed_up(failures: Iterable[Failure]) -> list[list[Failure]]:
    """Group failures by the one action that mends them, in the order of the first of each.

    Open decisions are one group; so are more than two failures of a check with the same reason,
    origin and remedy.
    """
    groups: dict[tuple[str, ...], list[Failure]] = {}
    for failure in failures:
        key: tuple[str, ...] = (failure.check, failure.reason, failure.origin, failure.remedy)
        if failure.origin == "open decision":
            key = (failure.origin,)
        groups.setdefault(key, []).append(failure)
    report_groups = []
    for key, group in groups.items():
        few = len(group) <= _FEW and key != ("open decision",)
        report_groups += [[failure] for failure in group] if few else [group]
    return report_groups


# Where a wrong value comes from, by its provenance in part U.
ORIGINS: dict[str, Origin] = {"frame": "source video", "model": "extraction"}


@dataclass(frozen=True)
class View:
    """An event under check."""

    event: Event
    _spans: dict[str, Span | None] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def value(self) -> dict[str, Any]:
        """The event's canonical mapping, without part U."""
        return body(self.event)

    @property
    def kind(self) -> Kind | None:
        """Facts about the kind of interaction, None where it is unknown."""
        return KINDS.get(self.event.interaction.type)

    @property
    def initiator(self) -> str:
        return self.event.interaction.initiator

    @cached_property
    def critical(self) -> list[str]:
        """Paths of the safety-critical fields."""
        return safety_critical_fields(self.event, self.value)

    @cached_property
    def quantities(self) -> dict[str, Interval]:
        """Every interval, by its path."""
        candidates: dict[str, Any] = {}
        for path in granules(self.value):
            item = get(self.value, path)
            is_road = isinstance(item, dict) and set(item) == ROAD_FIELD
            inside = ("value", "varies") if is_road else ()
            candidates |= {f"{path}.{name}": item[name] for name in inside} or {path: item}
        return {
            path: Interval.model_construct(**item)
            for path, item in candidates.items()
            if isinstance(item, dict) and set(item) == {"min", "max", "unit"}
        }

    def rule(self, path: str) -> Rule | None:
        """Return the rule of the quantity at a path."""
        units = self.kind.manoeuvre if self.kind else {}
        return rule_of(path, self.event.constraints.trigger.quantity, units)

    def measured(self, path: str) -> Span | None:
        """Return a quantity in SI units, None where it is missing, null or in a wrong unit."""
        interval, rule = self.quantities.get(path), self.rule(path)
        unit = UNITS.get(interval.unit) if interval else None
        right = unit is not None and rule is not None and unit.dimension == rule.dimension
        return interval.si if interval and right else None

    def span(self, path: str) -> Span | None:
        """Return a quantity in SI units for comparisons, None where C5 refuses it by itself."""
        if path not in self._spans:
            span, rule = self.measured(path), self.rule(path)
            sound = span is not None and rule is not None and _is_sound(span, rule)
            self._spans[path] = span if sound else None
        return self._spans[path]

    def spans(self, *paths: str) -> tuple[Span, ...] | None:
        """Return several quantities as ``span``, None where one of them is None."""
        present_spans = tuple(span for path in paths if (span := self.span(path)) is not None)
        return present_spans if len(present_spans) == len(paths) else None

    def road(self, name: str) -> str:
        """Return the path of the interval in which a place may have a measured field of T."""
        field = self.event.topology.by_name[name]
        varies = isinstance(field, QuantityField) and field.varies is not None
        return f"topology.{name}.{'varies' if varies else 'value'}"

    def cell(self, who: str, phase: PhaseWord) -> MotionCell | None:
        """Return the motion of one participant in one phase, None where part M lacks it."""
        return self.event.motion.get(who, {}).get(phase)

    def cells(self) -> Iterator[tuple[str, Participant, PhaseWord, MotionCell]]:
        """Yield every cell of part M with its participant."""
        for who, participant in self.event.participants.items():
            for phase in PHASES:
                cell = self.cell(who, phase)
                if cell is not None:
                    yield who, participant, phase, cell

    def evidence(self, *paths: str) -> str:
        """Return ``path = value`` of each, as the evidence of a failure."""
        return "; ".join(f"{path} = {self._value_text(path)}" for path in paths)

    def origin(self, path: str) -> Origin:
        """Name the origin of a wrong value of this one field, by its provenance in part U."""
        entry = owner(path, self.event.uncertainty)
        provenance = self.event.uncertainty[entry].provenance if entry else ""
        return ORIGINS.get(provenance, "contradiction in the structure")

    def _value_text(self, path: str) -> str:
        try:
            return show(get(self.value, path))
        except LookupError:
            return "not there"


def _is_sound(span: Span, rule: Rule) -> bool:
    """Tell whether a span is in order, closed where the rule wants it, and inside the platform."""
    finite_ends = [end for end in (span.low, span.high) if math.isfinite(end)]
    in_order = span.low <= span.high and len(finite_ends) == len(rule.needs)
    return in_order and all(rule.limit.holds(end) for end in finite_ends)


Predicate = Callable[[View], Iterator[Failure]]


@dataclass(frozen=True, slots=True)
class Fail:
    """Makes the failures of one check."""

    check: Check
    usual: Origin = "contradiction in the structure"

    def __call__(
        self,
        view: View,
        reason: str,
        remedy: str,
        *paths: str,
        evidence: str = "",
        origin: Origin | None = None,
    ) -> Failure:
        """Return a failure of the field at the first path.

        Args:
            view: of the event.
            reason: why it fails, for people.
            remedy: what a person may do about it.
            paths: of the field, and of what it was compared with.
            evidence: where it isn't simply the values at these paths.
            origin: where it isn't the usual one.
        """
        evidence_text = evidence or view.evidence(*paths)
        return Failure(self.check, paths[0], evidence_text, reason, origin or self.usual, remedy)

    def unless(
        self, view: View, word: str | None, choices: Iterable[str], reason: str, *paths: str
    ) -> Iterator[Failure]:
        """Yield the failure of a word that isn't one of the choices."""
        words = list(choices)
        if word not in words:
            yield self(view, reason, one_of(words), *paths)


def has_meaning(word: str | None) -> bool:
    """Tell whether a word has a meaning: it is neither missing nor unresolved nor `any`."""
    return word not in (None, UNRESOLVED, "any")


def one_of(words: Iterable[str]) -> str:
    """List a vocabulary for a remedy, in a fixed order."""
    return ", ".join(sorted(words))
