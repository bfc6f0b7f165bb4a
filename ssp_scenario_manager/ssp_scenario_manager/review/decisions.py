"""The effect of a decision on an event, and a field's value as a person types it."""

from __future__ import annotations

import copy
import json
import re
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_value
from ssp_scenario_manager.checks.base import Failure
from ssp_scenario_manager.checks.check import check_event, frames_of, is_unresolved
from ssp_scenario_manager.event_spec.fields import ROAD_FIELD, get, owner, put, show, within
from ssp_scenario_manager.event_spec.load import body, flow, seal_event, seals
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Doubt, Event
from ssp_scenario_manager.scenarios.events.kinds import KINDS


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
    """Return the event with a field accepted as it is, even if it is unresolved."""
    doubt = _doubt(event, path)
    state = "unresolved" if is_unresolved(get(body(event), path)) else "accepted"
    return _decided(event, event, path, doubt.model_copy(update={"review": state}))


def leave_unresolved(event: Event, path: str) -> Event:
    """Return the event with a field marked unresolved; its value too, if the form has that word."""
    doubt = _doubt(event, path).model_copy(update={"review": "unresolved"})
    changed = event
    with suppress(NotAllowed):  # then the value stays, and its mark says that nobody stands by it
        changed = with_value(event, path, UNRESOLVED)
    return _decided(event, changed, path, doubt)


def edit(event: Event, path: str, value: Any, who: str) -> tuple[Event, list[Change]]:
    """Return the event with a field as a person knows it, and what had to follow.

    Raises:
        NotAllowed: the form has no such value, or its unit is of something else.
    """
    frames = frames_of(event, path)
    frames_text = f"; frames {', '.join(map(str, frames))}" if frames else ""
    doubt = Doubt(
        confidence=1.0, provenance="person", source=f"{who}{frames_text}", review="edited"
    )
    after = _decided(event, with_value(event, path, value), path, doubt)
    if path == "interaction.type" and event.interaction.type != after.interaction.type:
        return _follow_type(after)
    return after, []


def with_value(event: Event, path: str, value: Any) -> Event:
    """Return the event with another value of a field; part U is as it was.

    Raises:
        NotAllowed: the form has no such value, or its unit is of something else.
    """
    mapping = event.model_dump(mode="json", by_alias=True)
    put(mapping, path, copy.deepcopy(value))
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
    """Apply what a kind of interaction settles: relation, zone, trigger quantity, its manoeuvre."""
    kind = KINDS.get(event.interaction.type)
    if kind is None:
        return event, []
    mapping = event.model_dump(mode="json", by_alias=True)
    constraints = mapping["constraints"]
    quantity = constraints["trigger"]["quantity"]
    trigger_quantity = (
        quantity if quantity in kind.trigger_quantities else sorted(kind.trigger_quantities)[0]
    )
    old = constraints["manoeuvre"]
    kind_values: dict[str, Any] = {
        "interaction.relation": kind.relation,
        "interaction.zone": kind.zone,
        "constraints.trigger.quantity": trigger_quantity,
        "constraints.manoeuvre": {name: old.get(name, UNRESOLVED) for name in kind.manoeuvre},
    }
    if trigger_quantity != quantity:
        kind_values["constraints.trigger.below"] = UNRESOLVED
    changes = []
    for path, value in kind_values.items():
        before = get(mapping, path)
        if before != value:
            changes.append(Change(path, before, value))
            put(mapping, path, copy.deepcopy(value))
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
    """Return the event with the decision about a field in part U, sealed."""
    entries = {**after.uncertainty, path: doubt.model_copy(update={"seal": None})}
    entered = after.model_copy(update={"uncertainty": entries})
    return seal_event(_sealed_again(before, entered, [path]), [path])


def _sealed_again(before: Event, after: Event, touched: list[str]) -> Event:
    """Seal entries above the touched fields again, if they held and only lost these fields."""
    old_seals = seals(before)
    above = [
        path
        for path, doubt in before.uncertainty.items()
        if path not in touched
        and path in after.uncertainty
        and doubt.seal is not None
        and doubt.seal == old_seals.get(path)
        and any(within(field, path) for field in touched)
    ]
    return seal_event(after, above)


_NUMBER = r"[-+]?(?:\d+(?:\.\d+)?|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"(?:({_NUMBER})?\.\.({_NUMBER})?|({_NUMBER}))(?:\s+(\S+))?")
_WORDS = re.compile(r"[a-z][a-z0-9_]*(\s*,\s*[a-z][a-z0-9_]*)*")
_PAIRS = re.compile(r"(\w+)\s*=\s*(\w+)")


class Unreadable(Exception):
    """A line that is no value for its field; the message says what would be."""


def value_text(value: Any) -> str:
    """Write a value as read_value takes it back: a cell as its words, a quantity as a range."""
    if isinstance(value, dict) and set(value) == ROAD_FIELD:
        return flow(value)
    if isinstance(value, dict) and "heading" in value:
        return " ".join(f"{key}={word}" for key, word in value.items() if word is not None)
    if isinstance(value, list):
        words = all(isinstance(item, str) for item in value)
        return ", ".join(value) if words and value else json.dumps(value)
    if isinstance(value, dict) and value.keys() >= {"min", "max"}:
        low, high = ("" if end is None else f"{end:g}" for end in (value["min"], value["max"]))
        ends = low if low == high else f"{low}..{high}"
        return f"{ends} {value.get('unit', '')}".strip()
    return show(value)


def read_value(text: str, old: Any, quantity: bool) -> Any:
    """Read the value in a line, in the shape of the one that it replaces.

    Quantities are ``2..3 s`` (``..3 s`` and ``2.. s`` are open, ``2 s`` is exact), counts ``2..3``,
    lists ``a, b``; of one participant in one phase, ``motion=stationary lateral=none`` changes
    these words and leaves the others. For a field of the road a line is what the source shows;
    whether it is identity or varies stands in braces. Text in braces or brackets is YAML.

    Args:
        text: as typed.
        old: the value that stands.
        quantity: whether the field is one; any other line stands for itself where a word stood.

    Raises:
        Unreadable: the line can't be read.
    """
    text = text.strip()
    if not text:
        raise Unreadable("type a value")
    if isinstance(old, dict) and set(old) == ROAD_FIELD:
        return _road_field(text, old)
    if text == UNRESOLVED:
        return UNRESOLVED
    if text == "null" and (old is None or isinstance(old, str) or quantity):
        return None
    if isinstance(old, str | None) and not quantity:
        return text
    if text[0] in "{[":
        return _yaml(text)
    if isinstance(old, dict) and "heading" in old:
        return _cell(text, old)
    if isinstance(old, list):
        if not _WORDS.fullmatch(text):
            raise Unreadable("type words with commas between them, such as: decelerate, stop")
        return [word.strip() for word in text.split(",")]
    interval = _quantity(text)
    if interval is not None:
        return interval
    if isinstance(old, dict):
        shape = "2..3" if set(old) == {"min", "max"} else "2..3 s"
        raise Unreadable(f"type a range, such as {shape}, or {UNRESOLVED}")
    if quantity:
        raise Unreadable(f"type a range with its unit, such as 2..3 s, or {UNRESOLVED}")
    return text


def _road_field(text: str, old: dict[str, Any]) -> Any:
    """Read a whole field in braces, else what the source shows, leaving whether it varies."""
    if text[0] == "{":
        content = _yaml(text)
        nothing = {"identity": False, "varies": None, "why": None}
        is_field = isinstance(content, dict) and "value" in content
        return nothing | content if is_field else {**old, "value": content}
    inside, varies = old["value"], old["varies"]
    is_list = isinstance(inside, list)
    measured = any(isinstance(item, dict) and "unit" in item for item in (inside, varies))
    if text.isdecimal() and not measured:
        return {**old, "value": int(text)}
    value = read_value(text, inside if is_list else None, measured and not is_list)
    return {**old, "value": value}


def _quantity(text: str) -> Any:
    """Read an interval, a count where there is no unit, or None."""
    match = _QUANTITY.fullmatch(text)
    if match is None:
        return None
    low, high, one, unit = match.groups()
    low, high = one or low, one or high
    if unit is None:
        if not all(re.fullmatch(r"\d+", end or "") for end in (low, high)):
            raise Unreadable("type the unit as well, such as 2..3 m/s")
        return {"min": int(low), "max": int(high)}
    ends = [None if end is None else float(end) for end in (low, high)]
    return {"min": ends[0], "max": ends[1], "unit": unit}


def _cell(text: str, old: dict[str, Any]) -> dict[str, Any]:
    pairs = _PAIRS.findall(text)
    if not pairs or _PAIRS.sub("", text).replace(",", " ").strip():
        raise Unreadable("type words to change, such as: motion=stationary lateral=none")
    unknown = [key for key, _ in pairs if key not in old]
    if unknown:
        raise Unreadable(f"there is no {unknown[0]!r} here; known: {', '.join(old)}")
    return {**old, **{key: None if word == "null" else word for key, word in pairs}}


def _yaml(text: str) -> Any:
    try:
        return parse_value(text, "typed")
    except InputError as error:
        raise Unreadable(f"this is no YAML: {error.problem}") from error
