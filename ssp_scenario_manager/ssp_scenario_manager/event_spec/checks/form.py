"""Form: whether a mapping can be read as a K*; all that is wrong, and the rest for further checks.

A field that can't be read gets a stopgap of its type, so that the checks C1–C5 still see the rest
of the event; what they say about a stopgap is dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ssp_scenario_manager.event_spec.checks.base import ORIGINS, Failure, View
from ssp_scenario_manager.event_spec.fields import Part, get, has, join, owner, split
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event, Interval

_ROUNDS = 6
# Beyond this many faults of form, what else is wrong doesn't matter yet.
_MOST_BROKEN = 100
_DEEPEST = 12
_MOST_NODES = 100_000


def read(value: Mapping[str, Any]) -> tuple[View | None, list[Failure]]:
    """The event for further checks, if it can be made one, and every failure of its form."""
    with suppress(ValidationError):
        return View(Event.model_validate(value)), []
    if not _is_shallow(value):
        return None, [
            _failure(value, "", "nested or long beyond measure", "is no K*", "seven flat parts")
        ]
    mended = _copy(value)
    failures: dict[str, Failure] = {}
    broken: set[str] = set()
    for _ in range(_ROUNDS):
        try:
            return View(Event.model_validate(mended), frozenset(broken)), list(failures.values())
        except ValidationError as error:
            for details in error.errors():
                parts, key = _place(details, mended)
                path = join(parts)
                if _is_other_choice(details, mended, path):
                    continue
                if path not in failures and path not in broken:
                    failures[path] = _describe(value, path, details, key)
                broken.add(path)
                if len(broken) > _MOST_BROKEN:
                    continue
                _mend(mended, parts, details["type"] == "extra_forbidden" or key)
            if len(broken) > _MOST_BROKEN:
                break
    return None, list(failures.values())


def vocabulary(path: str) -> tuple[str, ...]:
    """The words that a field may hold, () where it holds something else."""
    return tuple(word for word in _words(_annotation(split(path))) if isinstance(word, str))


def allowed(path: str) -> str:
    """What a field may hold once it is known, in words for a remedy."""
    return wanted(_annotation(split(path))).removesuffix(f" or {UNRESOLVED}")


def _place(details: ErrorDetails, value: Any) -> tuple[tuple[Part, ...], bool]:
    """Where an error stands in the file, and whether a key rather than its value is wrong."""
    parts: list[Part] = []
    for part in details["loc"]:
        if part == "[key]":
            return tuple(parts), True
        inside = isinstance(value, dict) and part in value
        if isinstance(part, str) and not inside and _names_a_choice(part):
            continue
        parts.append(part)
        try:
            value = value[part]
        except (TypeError, LookupError):
            value = None
    return tuple(parts), False


def _names_a_choice(part: str) -> bool:
    """Whether pydantic means a member of a union, which is no key of the file."""
    return part in ("Interval", "int") or part.startswith(("literal[", "list[", "constrained-"))


def _is_other_choice(details: ErrorDetails, value: Any, path: str) -> bool:
    """Whether pydantic complains that an interval, count or list isn't the word `unresolved`."""
    if not any(str(part).startswith("literal[") for part in details["loc"]) or not has(value, path):
        return False
    found, allowed = get(value, path), _members(_annotation(split(path)))
    if Interval in allowed:
        return isinstance(found, dict)
    several = any(get_origin(member) is list for member in allowed)
    return isinstance(found, list) if several else int in allowed and type(found) is int


def _describe(value: Mapping[str, Any], path: str, details: ErrorDetails, key: bool) -> Failure:
    kind, annotation = details["type"], _annotation(split(path))
    if key or kind == "extra_forbidden":
        parent = _annotation(split(path)[:-1])
        return _failure(value, path, "is there", "no field is called that", wanted(parent))
    if kind == "missing":
        return _failure(value, path, "not there", "is missing", wanted(annotation))
    try:
        found = get(value, path)
    except LookupError:
        found = details.get("input")
    words = _words(annotation)
    if found == "any" and split(path)[0] == "topology":
        remedy = f"what the source shows ({wanted(annotation)}), and what may differ in varies"
        failure = _failure(value, path, f"{path} = any", "says nothing about the source", remedy)
        return replace(failure, check="C2")
    reason = "is not in the vocabulary" if words else details["msg"].partition(" [")[0]
    if words and not isinstance(found, str):
        reason = "is of another type"
    return _failure(value, path, f"{path} = {_shown(found)}", reason, wanted(annotation))


def _failure(
    value: Mapping[str, Any], path: str, evidence: str, reason: str, remedy: str
) -> Failure:
    entries = value.get("uncertainty")
    entries = entries if isinstance(entries, dict) else {}
    entry = entries.get(owner(path, entries) or "")
    provenance = entry.get("provenance") if isinstance(entry, dict) else None
    origin = ORIGINS.get(str(provenance), "contradiction in the structure")
    return Failure("form", path or "(top)", evidence, reason, origin, remedy)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _is_shallow(value: Any) -> bool:
    """Whether something is no deeper and no larger than a K* can be; cycles are not."""
    level, nodes = [value], 0
    for _ in range(_DEEPEST):
        below: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                below.extend(item.values())
            elif isinstance(item, list | tuple):
                below.extend(item)
            if nodes + len(below) > _MOST_NODES:
                return False
        nodes += len(below)
        level = below
    return not level


def _copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copy(item) for key, item in value.items()}
    return [_copy(item) for item in value] if isinstance(value, list | tuple) else value


def _mend(value: Any, parts: tuple[Part, ...], remove: bool) -> None:
    """Puts a stopgap at a place, or takes away what has no business there."""
    for part in parts[:-1]:
        try:
            value = value[part]
        except (TypeError, LookupError):
            return
    if not parts:
        return
    if remove:
        if isinstance(value, dict):
            value.pop(parts[-1], None)
        return
    try:
        value[parts[-1]] = _stopgap(_annotation(parts))
    except (TypeError, LookupError):
        return


def _annotation(parts: tuple[Part, ...]) -> Any:
    """The type of what stands at a place, None where the form knows no such place."""
    at: Any = Event
    for part in parts:
        at = _inside(_members(at), part)
        if at is None:
            return None
    return at


def _inside(members: tuple[Any, ...], part: Part) -> Any:
    for member in members:
        if isinstance(member, type) and issubclass(member, BaseModel):
            for name, info in member.model_fields.items():
                if part == (info.alias or name):
                    return info.annotation
        origin, arguments = get_origin(member), get_args(member)
        if origin is dict:
            return arguments[1]
        if origin is list:
            return arguments[0]
        if origin is tuple and isinstance(part, int) and part < len(arguments):
            return arguments[part]
    return None


def _members(annotation: Any) -> tuple[Any, ...]:
    """The types that a union allows, without what is annotated to them."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _members(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return tuple(inner for member in get_args(annotation) for inner in _members(member))
    return (annotation,)


def _words(annotation: Any) -> tuple[Any, ...]:
    """Words of the literals that a type allows, if these are all that it allows."""
    members = [member for member in _members(annotation) if member is not NoneType]
    if any(get_origin(member) is not Literal for member in members):
        return ()
    return tuple(word for member in members for word in get_args(member))


def _stopgap(annotation: Any) -> Any:
    members = _members(annotation)
    words = [word for m in members if get_origin(m) is Literal for word in get_args(m)]
    if NoneType in members:
        return None
    if UNRESOLVED in words:
        return UNRESOLVED
    if words:
        return words[0]
    first = members[0]
    origin, arguments = get_origin(first), get_args(first)
    if isinstance(first, type) and issubclass(first, BaseModel):
        needed = {k: info for k, info in first.model_fields.items() if info.is_required()}
        return {info.alias or k: _stopgap(info.annotation) for k, info in needed.items()}
    if origin in (list, tuple):
        return [_stopgap(argument) for argument in arguments]
    if origin is dict:
        return {}
    return {str: "unknown", int: 1, float: 1.0}.get(first)


def wanted(annotation: Any) -> str:
    """What a type allows, in words for a remedy."""
    texts = [text for member in _members(annotation) if (text := _wanted(member))]
    return " or ".join(dict.fromkeys(texts)) or "nothing"


def _wanted(member: Any) -> str:
    origin, arguments = get_origin(member), get_args(member)
    if origin is Literal:
        return ", ".join(map(str, arguments))
    if origin is list:
        return f"a list of {wanted(arguments[0])}"
    if origin is tuple:
        return f"a list of {len(arguments)}: {wanted(arguments[0])} each"
    if origin is dict:
        return f"a mapping of {wanted(arguments[0])} to {wanted(arguments[1])}"
    if isinstance(member, type) and issubclass(member, BaseModel):
        return "{" + ", ".join(i.alias or k for k, i in member.model_fields.items()) + "}"
    return {NoneType: "null", str: "a name", int: "a whole number", float: "a number"}.get(
        member, ""
    )
