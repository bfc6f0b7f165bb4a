"""A failed check with everything that a person needs to mend it, and what the predicates of C1–C5
share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal

from ssp_core.vocabulary import PhaseWord
from ssp_scenario_manager.event_spec.fields import (
    ROAD_FIELD,
    UNITS,
    Dimension,
    Span,
    dimension_of,
    get,
    granules,
    limit_of,
    owner,
    rule_of,
    show,
    si,
    within,
)
from ssp_scenario_manager.event_spec.load import body, safety_critical_fields
from ssp_scenario_manager.event_spec.model import (
    UNRESOLVED,
    Event,
    Interval,
    MotionCell,
    QuantityField,
)
from ssp_scenario_manager.scenarios.base import Kind
from ssp_scenario_manager.scenarios.kinds import KINDS

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
        origin: where it comes from (METHOD 1), or that nobody has decided or reviewed it yet.
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
    """Failures in groups of what one action mends, in the order of the first of each.

    Open decisions are one group; so are more than two failures of a check with the same reason,
    origin and remedy.
    """
    groups: dict[tuple[str, ...], list[Failure]] = {}
    for failure in failures:
        key: tuple[str, ...] = (failure.check, failure.reason, failure.origin, failure.remedy)
        if failure.origin == "open decision":
            key = (failure.origin,)
        groups.setdefault(key, []).append(failure)
    found = []
    for key, group in groups.items():
        few = len(group) <= _FEW and key != ("open decision",)
        found += [[failure] for failure in group] if few else [group]
    return found


_QUANTITY = {"min", "max", "unit"}
# Where a wrong value comes from, by its provenance in part U.
ORIGINS: dict[str, Origin] = {"frame": "source video", "model": "extraction"}


@dataclass(frozen=True)
class View:
    """An event under check.

    Args:
        event: its typed form; fields that can't be read hold a stopgap.
        broken: paths of those fields. They are reported as such, and nothing is concluded from
            a stopgap.
    """

    event: Event
    broken: frozenset[str] = field(default_factory=frozenset)
    _spans: dict[str, Span | None] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def value(self) -> dict[str, Any]:
        """The event's canonical mapping, without part U."""
        return body(self.event)

    @property
    def kind(self) -> Kind | None:
        """Facts about the kind of interaction, None where nobody knows it."""
        return KINDS.get(self.event.interaction.type)

    @property
    def initiator(self) -> str:
        return self.event.interaction.initiator

    @cached_property
    def critical(self) -> list[str]:
        """Paths of the safety-critical fields."""
        return safety_critical_fields(self.event, self.value)

    @cached_property
    def quantities(self) -> dict[str, dict[str, Any]]:
        """Every interval that could be read, by its path."""
        found: dict[str, Any] = {}
        for path in granules(self.value):
            item = get(self.value, path)
            is_road = isinstance(item, dict) and set(item) == ROAD_FIELD
            inside = ("value", "varies") if is_road else ()
            found |= {f"{path}.{name}": item[name] for name in inside} or {path: item}
        return {
            path: item
            for path, item in found.items()
            if isinstance(item, dict) and set(item) == _QUANTITY and not self.is_broken(path)
        }

    def measured(self, path: str) -> Span | None:
        """A quantity in SI units; None where it is missing, null or in a wrong unit."""
        try:
            found = get(self.value, path)
        except LookupError:
            return None
        if not isinstance(found, dict) or self.is_broken(path):
            return None
        unit = UNITS.get(found["unit"])
        if unit is None or unit.dimension != self.dimension(path):
            return None
        return si(Interval.model_construct(**found))

    def span(self, path: str) -> Span | None:
        """A quantity in SI units, to hold others against; None where C5 refuses it by itself."""
        if path not in self._spans:
            self._spans[path] = self._sound(path)
        return self._spans[path]

    def _sound(self, path: str) -> Span | None:
        span, rule = self.measured(path), rule_of(path, self.dimension(path) or "")
        if span is None or rule is None or span.low > span.high:
            return None
        limit = limit_of(rule)
        given = [end for end in (span.low, span.high) if math.isfinite(end)]
        closed = len(given) == (1 if rule.shape in ("floor", "ceiling") else 2)
        return span if closed and all(limit.holds(Span(end, end)) for end in given) else None

    def road(self, name: str) -> str:
        """Path of the interval that a place's value of a measured field of T may lie in."""
        field = self.event.topology.by_name[name]
        varies = isinstance(field, QuantityField) and field.varies is not None
        return f"topology.{name}.{'varies' if varies else 'value'}"

    def dimension(self, path: str) -> Dimension | None:
        """What the quantity at a path measures."""
        units = dict(self.kind.manoeuvre) if self.kind else {}
        return dimension_of(path, self.event.constraints.trigger.quantity, units)

    def cell(self, who: str, phase: PhaseWord) -> MotionCell | None:
        """Motion of one participant in one phase, None where part M lacks it."""
        return self.event.motion.get(who, {}).get(phase)

    def said(self, *paths: str) -> str:
        """``path = value`` of each, as the evidence of a failure."""
        return "; ".join(f"{path} = {self._shown(path)}" for path in paths)

    def is_broken(self, path: str) -> bool:
        """Whether a field, something in it, or what holds it couldn't be read."""
        return any(within(path, bad) or within(bad, path) for bad in self.broken)

    def origin(self, path: str) -> Origin:
        """Where a wrong value of this one field comes from, by its provenance in part U."""
        entry = owner(path, self.event.uncertainty)
        provenance = self.event.uncertainty[entry].provenance if entry else ""
        return ORIGINS.get(provenance, "contradiction in the structure")

    def _shown(self, path: str) -> str:
        try:
            return show(get(self.value, path))
        except LookupError:
            return "not there"


Predicate = Callable[[View], Iterator[Failure]]


@dataclass(frozen=True, slots=True)
class Fail:
    """Makes the failures of one check."""

    check: Check

    def __call__(
        self,
        path: str,
        evidence: str,
        reason: str,
        remedy: str,
        origin: Origin | None = None,
    ) -> Failure:
        usual: Origin = "contradiction in the structure"
        if self.check == "review":
            usual = "missing review"
        return Failure(self.check, path, evidence, reason, origin or usual, remedy)


def known(word: str | None) -> bool:
    """Whether a word says something: neither missing nor unresolved nor `any`."""
    return word not in (None, UNRESOLVED, "any")


def one_of(words: Iterable[str]) -> str:
    """A vocabulary for a remedy, in a fixed order."""
    return ", ".join(sorted(words))
