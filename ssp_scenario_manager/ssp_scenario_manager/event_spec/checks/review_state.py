"""Review: part U covers every field, its seals hold, and people decided what is critical."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_scenario_manager.event_spec.checks.base import Fail, Failure, Predicate, View
from ssp_scenario_manager.event_spec.fields import has, owner, within
from ssp_scenario_manager.event_spec.load import seals, uncovered

_fail = Fail("review")
_REVIEW = "`ssp spec review FILE --who NAME`"


def every_field_is_covered(view: View) -> Iterator[Failure]:
    """Every field has an entry in part U, of its own or of what holds it."""
    nothing = "" if view.event.uncertainty else "part U is missing: "
    for path in uncovered(view.event, view.value):
        if not view.is_broken(path):
            yield _fail(
                path,
                view.said(path) + "; no entry in uncertainty",
                f"{nothing}nobody says where this comes from",
                "one entry in part U for each field, by `ssp spec review FILE --who NAME --all`",
            )


def entries_name_fields(view: View) -> Iterator[Failure]:
    """Every entry of part U names a field that is there."""
    for path in view.event.uncertainty:
        if not has(view.value, path) and not view.is_broken(path):
            yield _fail(
                path,
                f"uncertainty has an entry {path}",
                "there is no such field: it was removed or renamed after its review",
                "put the field back, or remove the entry",
            )


def seals_hold(view: View) -> Iterator[Failure]:
    """A reviewed entry has a seal, and its field is as it was when it was reviewed."""
    expected = seals(view.event, view.value)
    for path, entry in view.event.uncertainty.items():
        if path not in expected or view.is_broken(path) or _is_broken_entry(view, path):
            continue
        reviewed = entry.review != "unreviewed"
        if reviewed and entry.seal is None:
            yield _fail(
                path,
                f"review = {entry.review}, seal = null",
                "is marked as reviewed and isn't sealed",
                _REVIEW,
            )
        elif not reviewed and entry.seal is not None:
            yield _fail(
                path,
                f"review = unreviewed, seal = {entry.seal[:19]}…",
                "is sealed and marked as not reviewed",
                _REVIEW,
            )
        elif reviewed and entry.seal != expected[path]:
            yield _fail(
                path,
                f"{view.said(path)}; confidence = {entry.confidence:g}, provenance = "
                f"{entry.provenance}, source = {entry.source}, review = {entry.review}",
                "changed since it was reviewed",
                f"the value that was reviewed, or {_REVIEW}",
            )


def critical_fields_are_decided(view: View) -> Iterator[Failure]:
    """A person has decided every safety-critical field."""
    entries = view.event.uncertainty
    for path in view.critical:
        if view.is_broken(path):
            continue
        entry = owner(path, entries)
        if entry and entries[entry].review in ("unreviewed", "unresolved"):
            yield _fail(
                path,
                f"{view.said(path)}; uncertainty.{entry}.review = {entries[entry].review}",
                "is safety-critical, and no person has decided it",
                _REVIEW,
            )


def _is_broken_entry(view: View, path: str) -> bool:
    return any(within(bad, f"uncertainty.{path}") for bad in view.broken)


REVIEW_PREDICATES: tuple[Predicate, ...] = (
    every_field_is_covered,
    entries_name_fields,
    seals_hold,
    critical_fields_are_decided,
)
