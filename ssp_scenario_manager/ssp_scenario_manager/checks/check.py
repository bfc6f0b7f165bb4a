"""All checks of a K* (METHOD 1), all failures together, and what a person still has to decide."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.checks.base import Check, Fail, Failure, Predicate, View
from ssp_scenario_manager.checks.c1_relations import (
    MOTION_PREDICATES,
    PLACE_PREDICATES,
    TYPE_PREDICATES,
)
from ssp_scenario_manager.checks.c2_topology import TOPOLOGY_PREDICATES
from ssp_scenario_manager.checks.c3_events import TIME_PREDICATES, TRIGGER_PREDICATES
from ssp_scenario_manager.checks.c4_further import FURTHER_PREDICATES
from ssp_scenario_manager.checks.c4_interaction import INTERACTION_PREDICATES
from ssp_scenario_manager.checks.c5_executability import (
    EXECUTABILITY_PREDICATES,
    UNIT_PREDICATES,
)
from ssp_scenario_manager.checks.form import read
from ssp_scenario_manager.event_spec.fields import ROAD_FIELD, get, granules, has, leaves, owner
from ssp_scenario_manager.event_spec.load import body, safety_critical_fields, seals, uncovered
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Doubt, Event

_fail = Fail("review", "missing review")
_REVIEW = "`ssp spec review FILE --who NAME`"


def every_field_is_covered(view: View) -> Iterator[Failure]:
    """Check that every field has an entry in part U, of its own or of what holds it."""
    nothing = "" if view.event.uncertainty else "part U is missing: "
    remedy = "one entry in part U for each field, by `ssp spec review FILE --who NAME --all`"
    for path in uncovered(view.event, view.value):
        evidence = view.evidence(path) + "; no entry in uncertainty"
        reason = f"{nothing}the origin of this field isn't stated"
        yield _fail(view, reason, remedy, path, evidence=evidence)


def entries_name_fields(view: View) -> Iterator[Failure]:
    """Check that every entry of part U names a field that is there."""
    for path in view.event.uncertainty:
        if not has(view.value, path):
            yield _fail(
                view,
                "there is no such field: it was removed or renamed after its review",
                "put the field back, or remove the entry",
                path,
                evidence=f"uncertainty has an entry {path}",
            )


def seals_hold(view: View) -> Iterator[Failure]:
    """Check that a reviewed entry has a seal, and its field is as it was when it was reviewed."""
    expected = seals(view.event, view.value)
    for path, entry in view.event.uncertainty.items():
        if path not in expected:
            continue
        reviewed, remedy = entry.review != "unreviewed", _REVIEW
        if reviewed and entry.seal is None:
            reason = "is marked as reviewed and isn't sealed"
            evidence = f"review = {entry.review}, seal = null"
        elif not reviewed and entry.seal is not None:
            reason = "is sealed and marked as not reviewed"
            evidence = f"review = unreviewed, seal = {entry.seal[:19]}…"
        elif reviewed and entry.seal != expected[path]:
            reason, remedy = (
                "changed since it was reviewed",
                f"the value that was reviewed, or {_REVIEW}",
            )
            evidence = (
                f"{view.evidence(path)}; confidence = {entry.confidence:g}, provenance = "
                f"{entry.provenance}, source = {entry.source}, review = {entry.review}"
            )
        else:
            continue
        yield _fail(view, reason, remedy, path, evidence=evidence)


def critical_fields_are_decided(view: View) -> Iterator[Failure]:
    """Check that a person has decided every safety-critical field."""
    entries = view.event.uncertainty
    for path in view.critical:
        entry = owner(path, entries)
        if entry and entries[entry].review in ("unreviewed", "unresolved"):
            evidence = (
                f"{view.evidence(path)}; uncertainty.{entry}.review = {entries[entry].review}"
            )
            reason = "is safety-critical, and no person has decided it"
            yield _fail(view, reason, _REVIEW, path, evidence=evidence)


# In the order of a report.
PREDICATES: dict[Check, tuple[Predicate, ...]] = {
    "C1": TYPE_PREDICATES + PLACE_PREDICATES + MOTION_PREDICATES,
    "C2": TOPOLOGY_PREDICATES,
    "C3": TIME_PREDICATES + TRIGGER_PREDICATES,
    "C4": INTERACTION_PREDICATES + FURTHER_PREDICATES,
    "C5": UNIT_PREDICATES + EXECUTABILITY_PREDICATES,
    "review": (
        every_field_is_covered,
        entries_name_fields,
        seals_hold,
        critical_fields_are_decided,
    ),
}


def check_event(event: Event | Mapping[str, Any], *, reviewed: bool = True) -> list[Failure]:
    """Return every failed check, in a fixed order; [] for a K* that may be compiled.

    A file whose form is wrong has failures of its form alone.

    Args:
        event: typed, or a mapping as it was read from a file.
        reviewed: whether to check part U too; False for a candidate before its review.
    """
    if not isinstance(event, Event):
        typed_event, failures = read(event)
        if typed_event is None:
            return failures
        event = typed_event
    view = View(event)
    content_failures = (
        failure
        for check, predicates in PREDICATES.items()
        if reviewed or check != "review"
        for predicate in predicates
        for failure in predicate(view)
    )
    return list(dict.fromkeys(content_failures))


Why = Literal["unresolved", "not reviewed", "changed since its review", "origin not stated"]

_FRAMES = re.compile(r"\bframes? (\d+(?:(?:, ?|-| to )\d+)*)")


@dataclass(frozen=True)
class UndecidedField:
    """One field that waits for a person.

    Args:
        field: its path.
        value: as it stands.
        why: what is missing.
        critical: safety-critical, so that no K* is without a decision about it.
        confidence: of part U, None where it has no entry.
        provenance: of part U, or "".
        source: of part U, or "".
        frames: evidence frames on the clip's own count, as part U and part E name them.
    """

    field: str
    value: Any
    why: Why
    critical: bool
    confidence: float | None
    provenance: str
    source: str
    frames: tuple[int, ...]


def undecided(event: Event) -> list[UndecidedField]:
    """Return every field that waits for a decision, in the file's order.

    A field is what a person judges as one: a word, a quantity, a list, one participant in one
    phase. A field that isn't safety-critical may be left unresolved by a person.
    """
    value, sealed = body(event), seals(event)
    critical = set(safety_critical_fields(event))
    fields = []
    for path in granules(value):
        entry = owner(path, event.uncertainty)
        doubt = event.uncertainty[entry] if entry else None
        item, is_critical = get(value, path), path in critical
        why = _why(item, doubt, sealed.get(entry or ""), is_critical)
        if why is None:
            continue
        fields.append(
            UndecidedField(
                field=path,
                value=item,
                why=why,
                critical=is_critical,
                confidence=doubt.confidence if doubt else None,
                provenance=doubt.provenance if doubt else "",
                source=doubt.source if doubt else "",
                frames=frames_of(event, path),
            )
        )
    return fields


def contradictions(event: Event) -> list[Failure]:
    """Return failures of checks C1-C5, without those that say that a field is unresolved."""
    value = body(event)
    return [
        failure
        for failure in check_event(event, reviewed=False)
        if not (has(value, failure.field) and get(value, failure.field) == UNRESOLVED)
    ]


def frames_of(event: Event, path: str) -> tuple[int, ...]:
    """Return the evidence frames of a field on the clip's own count, as parts U and E name them."""
    entry = owner(path, event.uncertainty)
    match = _FRAMES.search(event.uncertainty[entry].source) if entry else None
    if match:
        return tuple(sorted({int(number) for number in re.findall(r"\d+", match.group(1))}))
    part, _, phase = path.partition(".")
    phase = phase.partition(".")[0]
    if part != "events" or phase not in PHASES:
        return ()
    evidence = getattr(event.events, phase).evidence
    return tuple(sorted({n for item in evidence for n in item.frames or ()}))


def is_unresolved(value: Any) -> bool:
    """Tell whether part of a field's value is unresolved.

    A field that varies in a range needs no value.
    """
    if isinstance(value, dict) and set(value) == ROAD_FIELD and value["varies"] is not None:
        return False
    return any(item == UNRESOLVED for _, item in leaves(value))


def _why(value: Any, doubt: Doubt | None, seal: str | None, critical: bool) -> Why | None:
    unresolved = is_unresolved(value)
    if doubt is None:
        return "origin not stated"
    if doubt.review == "unreviewed":
        return "unresolved" if unresolved else "not reviewed"
    if doubt.seal != seal:
        return "changed since its review"
    if critical and (unresolved or doubt.review == "unresolved"):
        return "unresolved"
    return None
