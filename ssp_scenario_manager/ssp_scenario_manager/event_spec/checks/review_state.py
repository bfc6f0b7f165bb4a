"""Review: part U covers every field, its seals hold, and people decided what is critical."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_scenario_manager.event_spec.checks.base import Fail, Failure, Predicate, View
from ssp_scenario_manager.event_spec.fields import has, owner
from ssp_scenario_manager.event_spec.load import seals, uncovered

_fail = Fail("review", "missing review")
_REVIEW = "`ssp spec review FILE --who NAME`"


def every_field_is_covered(view: View) -> Iterator[Failure]:
    """Every field has an entry in part U, of its own or of what holds it."""
    nothing = "" if view.event.uncertainty else "part U is missing: "
    remedy = "one entry in part U for each field, by `ssp spec review FILE --who NAME --all`"
    for path in uncovered(view.event, view.value):
        evidence = view.said(path) + "; no entry in uncertainty"
        reason = f"{nothing}nobody says where this comes from"
        yield _fail(view, reason, remedy, path, evidence=evidence)


def entries_name_fields(view: View) -> Iterator[Failure]:
    """Every entry of part U names a field that is there."""
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
    """A reviewed entry has a seal, and its field is as it was when it was reviewed."""
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
                f"{view.said(path)}; confidence = {entry.confidence:g}, provenance = "
                f"{entry.provenance}, source = {entry.source}, review = {entry.review}"
            )
        else:
            continue
        yield _fail(view, reason, remedy, path, evidence=evidence)


def critical_fields_are_decided(view: View) -> Iterator[Failure]:
    """A person has decided every safety-critical field."""
    entries = view.event.uncertainty
    for path in view.critical:
        entry = owner(path, entries)
        if entry and entries[entry].review in ("unreviewed", "unresolved"):
            evidence = f"{view.said(path)}; uncertainty.{entry}.review = {entries[entry].review}"
            reason = "is safety-critical, and no person has decided it"
            yield _fail(view, reason, _REVIEW, path, evidence=evidence)


REVIEW_PREDICATES: tuple[Predicate, ...] = (
    every_field_is_covered,
    entries_name_fields,
    seals_hold,
    critical_fields_are_decided,
)
