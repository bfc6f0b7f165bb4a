"""The failures of a pydantic model as errors of input: each with field, value and remedy."""

from __future__ import annotations

import dataclasses
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import BaseModel, RootModel, ValidationError
from pydantic_core import ErrorDetails
from typing_extensions import is_typeddict

from ssp_core.errors import InputError
from ssp_core.files.yaml_core import number_remedy

_NO_NUMBER = ("float_type", "float_parsing", "int_type", "int_parsing", "int_from_float")
_EXPECTED = "Input should be "
UNKNOWN_KEY = "is not a known key"
# Of pydantic's kinds of failures whose messages don't say what to write.
_REMEDIES = {
    "missing": "add it",
    "finite_number": "write a number",
    "model_type": "write a mapping of its fields",
    "model_attributes_type": "write a mapping of its fields",
    "dict_type": "write a mapping",
    "list_type": "write a list",
    "tuple_type": "write a list",
    "string_type": "write a text",
    "int_parsing_size": "write a smaller whole number",
    "bool_type": "write true or false",
}

_PATTERNS = {
    r"^[a-z][a-z0-9_]{0,31}$": "write a small letter, and then up to 31 small letters, digits "
    "and underscores",
}
# Beside the nearest ones, so many known keys are listed.
_MOST_KEYS = 20
_LONGEST_KEY = 100
_LONGEST_FIELD = 200

_NOT_GIVEN = object()


def field_path(
    location: Iterable[str | int], value: Any = _NOT_GIVEN, *, missing: bool = True
) -> str:
    """Name the field at the location of a pydantic error, such as ``labels[3].position``.

    Args:
        location: keys and indexes from the top of the value on.
        value: what was validated. Where pydantic names the chosen kind of a union, which is no
            key of the file, the part is left out.
        missing: whether the last part may be a key that isn't there. pydantic says by the
            error's type whether it is one.
    """
    text = ""
    parts = tuple(location)
    for index, part in enumerate(parts):
        absent = missing and index == len(parts) - 1 and isinstance(value, dict)
        is_present = isinstance(part, int) or (isinstance(value, dict) and part in value)
        if not is_present and not absent and value is not _NOT_GIVEN:
            continue
        if value is not _NOT_GIVEN:
            try:
                value = value[part]
            except (TypeError, LookupError):
                value = None
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
    return text


def failures(error: ValidationError, value: Any, model: type[BaseModel]) -> list[InputError]:
    """List the failures, one for each field, in the order of the model.

    Of a union pydantic names what each member lacks: of one place these become one failure, and
    what is wrong inside a member counts more than what is wrong with another one.

    Args:
        error: of the model.
        value: that was validated.
        model: that it was validated against.
    """
    by_field: dict[str, list[ErrorDetails]] = {}
    for failure in error.errors(include_url=False):
        location = [part for part in failure["loc"] if part != "[key]"]
        path = field_path(location, value, missing=failure["type"] == "missing")
        by_field.setdefault(path, []).append(failure)
    schema = by_field.get("schema")
    if schema is not None and schema[0]["type"] != "missing":
        # Of another schema, or another version of it, no other field means anything.
        by_field = {"schema": schema}
    fields = sorted(by_field)
    return [
        _failure(path, of_one, model)
        for path, of_one in by_field.items()
        if not (path and _has_inner(path, fields))
    ]


def _has_inner(path: str, fields: Sequence[str]) -> bool:
    """Tell whether one of the sorted fields lies inside the field at a path."""
    for opening in (f"{path}.", f"{path}["):
        at = bisect_left(fields, opening)
        if at < len(fields) and fields[at].startswith(opening):
            return True
    return False


def _failure(path: str, of_one: list[ErrorDetails], model: type[BaseModel]) -> InputError:
    first = of_one[0]
    kind, input_value = first["type"], first.get("input")
    if kind == "union_tag_invalid":
        words = first["ctx"]
        key, tag = words["discriminator"].strip("'"), words["tag"]
        return InputError(
            "is not known here",
            field=f"{path}.{key}" if path else key,
            value=tag,
            remedy=f"known: {words['expected_tags'].replace(chr(39), '')}",
        )
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return InputError(
            UNKNOWN_KEY,
            field=path[:_LONGEST_FIELD],
            value=input_value,
            remedy=known_keys(model, first["loc"]),
        )
    messages = list(dict.fromkeys(one["msg"].removeprefix("Value error, ") for one in of_one))
    problem = " or ".join([messages[0], *(one.removeprefix(_EXPECTED) for one in messages[1:])])
    remedy = number_remedy(input_value) if kind in _NO_NUMBER else None
    if kind == "string_pattern_mismatch":
        remedy = _PATTERNS.get(first["ctx"]["pattern"])
    return InputError(
        problem,
        field=path[:_LONGEST_FIELD],
        value=None if kind == "missing" else input_value,
        remedy=remedy or (_REMEDIES.get(kind) if len(messages) == 1 else None),
    )


def known_keys(model: type[Any], location: tuple[str | int, ...]) -> str:
    """Return the remedy of an unknown key: those that are nearest, or all known ones.

    Args:
        model: of the whole file.
        location: of the key, as pydantic has it.
    """
    *before, key = location
    forms = list(_forms(model))
    for part in before:
        inner = [form for one in forms for form in _within(one, part)]
        # A part that is no field names the member of a union.
        forms = inner or [form for form in forms if _names_member(form, part)] or forms
    keys = list(dict.fromkeys(name for form in forms for name in _keys(form)))
    near = get_close_matches(str(key)[:_LONGEST_KEY], keys, n=2, cutoff=0.6)
    sentences = [f"did you mean {' or '.join(near)}?"] if near else []
    if keys and (not near or len(keys) <= _MOST_KEYS):
        sentences.append(f"known: {', '.join(keys)}")
    return " ".join(sentences) or "remove it"


def _forms(annotation: Any) -> Iterator[Any]:
    """Yield the members of an annotation, without unions and what is annotated."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _forms(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _forms(member)
    elif isinstance(annotation, type) and issubclass(annotation, RootModel):
        yield from _forms(annotation.model_fields["root"].annotation)
    else:
        yield annotation


def _fields(form: Any) -> Mapping[str, Any]:
    """Return the annotations of a form's fields by the keys of a file."""
    if isinstance(form, type) and issubclass(form, BaseModel):
        return {info.alias or name: info.annotation for name, info in form.model_fields.items()}
    origin = get_origin(form) or form
    if dataclasses.is_dataclass(origin) or is_typeddict(origin):
        return get_type_hints(origin)
    return {}


def _within(form: Any, part: str | int) -> Iterator[Any]:
    """Yield the forms of what stands at a key or an index of a form."""
    if part in (fields := _fields(form)):
        yield from _forms(fields[str(part)])
        return
    origin, args = get_origin(form), get_args(form)
    if isinstance(part, int) and origin in (list, tuple, set, frozenset):
        for arg in args:
            yield from _forms(arg)
    elif origin in (dict, Mapping) and len(args) == 2:
        yield from _forms(args[1])


def _keys(form: Any) -> list[str]:
    return list(_fields(form))


def _names_member(form: Any, part: str | int) -> bool:
    """Tell whether a part of a location names this member of a union, by class or by its tag."""
    tags = (
        tag
        for annotation in _fields(form).values()
        if get_origin(annotation) is Literal
        for tag in get_args(annotation)
    )
    return getattr(form, "__name__", "") == part or part in tags
