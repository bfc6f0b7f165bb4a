"""Form: the check whether a mapping can be read as a K*, with every obstacle."""

from __future__ import annotations

from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ssp_core.files.model_errors import field_path
from ssp_scenario_manager.checks.base import ORIGINS, Check, Failure
from ssp_scenario_manager.event_spec.fields import Part, owner, split
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event


def read(value: Mapping[str, Any]) -> tuple[Event | None, list[Failure]]:
    """Return the event, or every failure of its form."""
    try:
        return Event.model_validate(value), []
    except ValidationError as error:
        failures: dict[str, Failure] = {}
        for details in error.errors():
            missing = details["type"] == "missing"
            location = [part for part in details["loc"] if part != "[key]"]
            path = field_path(location, value, missing=missing)
            failures.setdefault(path, _failure(value, path, details))
    # Of a union pydantic names every member; what is wrong inside one of them says more.
    outer = {split(path)[:end] for path in failures for end in range(1, len(split(path)))}
    innermost_failures = (failure for path, failure in failures.items() if split(path) not in outer)
    return None, list(innermost_failures)


def vocabulary(path: str) -> tuple[str, ...]:
    """List the words that a field may hold, () where it holds something else."""
    return tuple(word for word in _words(_annotation(split(path))) if isinstance(word, str))


def allowed(path: str) -> str:
    """Describe the values that a field may hold once it is known, in words for a remedy."""
    return describe_type(_annotation(split(path))).removesuffix(f" or {UNRESOLVED}")


def _failure(value: Mapping[str, Any], path: str, details: ErrorDetails) -> Failure:
    kind, annotation = details["type"], _annotation(split(path))
    check: Check = "form"
    raw_value = details.get("input")
    evidence, remedy = f"{path} = {_excerpt(raw_value)}", describe_type(annotation)
    words = _words(annotation)
    if kind == "extra_forbidden" or "[key]" in details["loc"]:
        evidence, reason = "is there", "no field is called that"
        remedy = describe_type(_annotation(split(path)[:-1]))
    elif kind == "missing":
        evidence, reason = "not there", "is missing"
    elif raw_value == "any" and path.startswith("topology."):
        check, reason = "C2", "says nothing about the source"
        remedy = f"what the source shows ({remedy}), and what may differ in varies"
    elif words:
        reason = "is not in the vocabulary" if isinstance(raw_value, str) else "is of another type"
    else:
        reason = details["msg"].partition(" [")[0]
    entries = value.get("uncertainty")
    entries = entries if isinstance(entries, dict) else {}
    entry = entries.get(owner(path, entries) or "")
    provenance = entry.get("provenance") if isinstance(entry, dict) else None
    origin = ORIGINS.get(str(provenance), "contradiction in the structure")
    return Failure(check, path or "(top)", evidence, reason, origin, remedy)


def _excerpt(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _annotation(parts: tuple[Part, ...]) -> Any:
    """Return the type of what stands at a place, None where the form knows no such place."""
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
    """Return the types that a union allows, without what is annotated to them."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _members(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return tuple(inner for member in get_args(annotation) for inner in _members(member))
    return (annotation,)


def _words(annotation: Any) -> tuple[Any, ...]:
    """Return words of the literals that a type allows, if these are all that it allows."""
    members = [member for member in _members(annotation) if member is not NoneType]
    if any(get_origin(member) is not Literal for member in members):
        return ()
    return tuple(word for member in members for word in get_args(member))


def describe_type(annotation: Any) -> str:
    """Describe the values that a type allows, in words for a remedy."""
    texts = [text for member in _members(annotation) if (text := _member_text(member))]
    return " or ".join(dict.fromkeys(texts)) or "nothing"


def _member_text(member: Any) -> str:
    origin, arguments = get_origin(member), get_args(member)
    if origin is Literal:
        return ", ".join(map(str, arguments))
    if origin is list:
        return f"a list of {describe_type(arguments[0])}"
    if origin is tuple:
        return f"a list of {len(arguments)}: {describe_type(arguments[0])} each"
    if origin is dict:
        return f"a mapping of {describe_type(arguments[0])} to {describe_type(arguments[1])}"
    if isinstance(member, type) and issubclass(member, BaseModel):
        return "{" + ", ".join(i.alias or k for k, i in member.model_fields.items()) + "}"
    return {NoneType: "null", str: "a name", int: "a whole number", float: "a number"}.get(
        member, ""
    )
