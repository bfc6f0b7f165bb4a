"""What a decision does to an event: the field's value, its entry in part U, the seals.

Pure: an event and a decision in, an event out. A field that was covered by the entry of what holds
it gets an entry of its own.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ssp_scenario_manager.interactions import KINDS
from ssp_scenario_manager.spec.checks import check_event
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.fields import Part, get, owner, split, within
from ssp_scenario_manager.spec.model import UNRESOLVED, Doubt, Event
from ssp_scenario_manager.spec.review.undecided import describe, is_unresolved
from ssp_scenario_manager.spec.seal import body, seal_event, seals


@dataclass(frozen=True)
class Change:
    """A field that took another value because of a decision about another one."""

    field: str
    old: Any
    new: Any


class NotAllowed(Exception):
    """An edit that the form of K* doesn't allow; the failures say why."""

    def __init__(self, failures: list[Failure]) -> None:
        self.failures = failures
        super().__init__("; ".join(f.reason for f in failures))


def accept(event: Event, path: str) -> Event:
    """The event with a field accepted as it is; what is unresolved is accepted as that."""
    doubt = _doubt(event, path)
    state = "unresolved" if is_unresolved(get(body(event), path)) else "accepted"
    return _decided(event, event, path, doubt.model_copy(update={"review": state}))


def leave_unresolved(event: Event, path: str) -> Event:
    """The event with a field marked unresolved, and its value too where the form has that word."""
    doubt = _doubt(event, path).model_copy(update={"review": "unresolved"})
    changed = event
    with suppress(NotAllowed):  # then the value stays, and its mark says that nobody stands by it
        changed = with_value(event, path, UNRESOLVED)
    return _decided(event, changed, path, doubt)


def edit(event: Event, path: str, value: Any, who: str) -> tuple[Event, list[Change]]:
    """The event with a field as a person knows it, and what had to follow.

    Args:
        event: before.
        path: of the field.
        value: as it stands in a file.
        who: the person, for part U.

    Raises:
        NotAllowed: the form has no such value, or its unit is of something else.
    """
    frames = describe(event, path, "not reviewed", critical=True).frames
    seen = f"; frames {', '.join(map(str, frames))}" if frames else ""
    doubt = Doubt(confidence=1.0, provenance="person", source=f"{who}{seen}", review="edited")
    after = _decided(event, with_value(event, path, value), path, doubt)
    if path == "interaction.type" and event.interaction.type != after.interaction.type:
        return _follow_type(after)
    return after, []


def with_value(event: Event, path: str, value: Any) -> Event:
    """The event with another value of a field; part U is as it was.

    Raises:
        NotAllowed: the form has no such value, or its unit is of something else.
    """
    mapping = copy.deepcopy(event.model_dump(mode="json", by_alias=True))
    _put(mapping, split(path), value)
    failures = check_event(mapping, reviewed=False)
    unit = f"{path}.unit"
    bad = [
        failure
        for failure in failures
        if failure.check == "form" or (failure.check == "C5" and failure.field == unit)
    ]
    if bad:
        raise NotAllowed(bad)
    return Event.model_validate(mapping)


def _follow_type(event: Event) -> tuple[Event, list[Change]]:
    """What a kind of interaction settles: relation, zone, trigger quantity, its manoeuvre."""
    kind = KINDS.get(event.interaction.type)
    if kind is None:
        return event, []
    mapping = event.model_dump(mode="json", by_alias=True)
    constraints = mapping["constraints"]
    quantity = constraints["trigger"]["quantity"]
    kept = quantity if quantity in kind.trigger_quantities else sorted(kind.trigger_quantities)[0]
    old = constraints["manoeuvre"]
    wanted: dict[str, Any] = {
        "interaction.relation": kind.relation,
        "interaction.zone": kind.zone,
        "constraints.trigger.quantity": kept,
        "constraints.manoeuvre": {name: old.get(name, UNRESOLVED) for name in kind.manoeuvre},
    }
    if kept != quantity:
        wanted["constraints.trigger.below"] = UNRESOLVED
    changes = []
    for path, value in wanted.items():
        before = get(mapping, path)
        if before != value:
            changes.append(Change(path, before, value))
            _put(mapping, split(path), value)
    mapping["uncertainty"] = {
        path: doubt.model_dump()
        for path, doubt in event.uncertainty.items()
        if not any(within(path, change.field) for change in changes)
    } | {change.field: _following(change, kind.name) for change in changes}
    after = Event.model_validate(mapping)
    return _sealed_again(event, after, [change.field for change in changes]), changes


def _following(change: Change, kind: str) -> dict[str, Any]:
    return {
        "confidence": 0.0 if UNRESOLVED in str(change.new) else 1.0,
        "provenance": "derived",
        "source": f"interaction.type {kind}",
        "review": "unreviewed",
    }


def _doubt(event: Event, path: str) -> Doubt:
    entry = owner(path, event.uncertainty)
    if entry is None:
        # Nobody has said where it comes from; whoever decides now does.
        return Doubt(confidence=1.0, provenance="person", source="review", review="unreviewed")
    return event.uncertainty[entry]


def _decided(before: Event, after: Event, path: str, doubt: Doubt) -> Event:
    """The event with the decision about a field in part U, sealed."""
    entries = {**after.uncertainty, path: doubt.model_copy(update={"seal": None})}
    entered = after.model_copy(update={"uncertainty": entries})
    return seal_event(_sealed_again(before, entered, [path]), [path])


def _sealed_again(before: Event, after: Event, touched: list[str]) -> Event:
    """Seals of entries above the touched fields, where they held and only lost these fields."""
    held = seals(before)
    above = [
        path
        for path, doubt in before.uncertainty.items()
        if path not in touched
        and path in after.uncertainty
        and doubt.seal is not None
        and doubt.seal == held.get(path)
        and any(within(field, path) for field in touched)
    ]
    return seal_event(after, above)


def _put(value: Any, parts: tuple[Part, ...], new: Any) -> None:
    for part in parts[:-1]:
        value = value[part]
    value[parts[-1]] = copy.deepcopy(dict(new) if isinstance(new, Mapping) else new)
