"""Text, JSON and YAML files from outside, read strictly and within bounds."""

from __future__ import annotations

import os
import pickle
import re
import stat
from contextlib import suppress
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from ssp_core.errors import InputError, not_read
from ssp_core.files.model_errors import failures
from ssp_core.files.strict_json import parse_lenient, parse_strict
from ssp_core.files.yaml_core import MOST_VALUES, CoreLoader, TooManyValuesError

MAX_TEXT_BYTES = 8 << 20
# Of one file; naming each with its remedy takes some 50 microseconds.
MOST_ERRORS = 20_000
_MOST_TAG_DIRECTIVES = 100
_BLOCK_BYTES = 1 << 16
# An escape for half of a surrogate pair, in JSON or in YAML.
_SURROGATE = re.compile(r"\\[uU]0*[dD][89a-fA-F]")

Model = TypeVar("Model", bound=BaseModel)


def refuse_named_pipe(path: str | Path) -> None:
    """Refuse a named pipe, which may never be written to, and a link to one.

    Raises:
        InputError: it is one. A shell's <(…) isn't: that pipe has no name.
    """
    real_path = os.path.realpath(path)
    if os.path.lexists(real_path) and stat.S_ISFIFO(os.lstat(real_path).st_mode):
        raise InputError(
            "is a named pipe, not a file", file=path, remedy="write its content to a file"
        )


def read_text(path: str | Path, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a UTF-8 file of at most 8 MiB.

    Args:
        path: of the file.
        most_bytes: where it may be larger.

    Raises:
        InputError: it isn't there, is too large or isn't UTF-8, or is a named pipe, to which
            no process may ever write.
    """
    try:
        refuse_named_pipe(path)
        with open(path, "rb") as stream:
            if os.fstat(stream.fileno()).st_size > most_bytes:
                raise _too_large(path, most_bytes)
            # In blocks: a single read would take the memory of the largest file for each.
            blocks = iter(partial(stream.read, _BLOCK_BYTES), b"")
            data = b"".join(islice(blocks, most_bytes // _BLOCK_BYTES + 1))
    except OSError as error:
        raise not_read(path, error) from error
    except ValueError as error:  # a name with a NUL byte
        raise InputError(
            f"can't be read: {error}", file=path, remedy="name a file that is there"
        ) from error
    return _text(data, path, most_bytes)


def _too_large(file: str | Path, most_bytes: int) -> InputError:
    problem = f"is larger than {most_bytes >> 20} MiB"
    return InputError(problem, file=file, remedy="give a smaller file")


def _text(data: bytes, file: str | Path, most_bytes: int = MAX_TEXT_BYTES) -> str:
    if len(data) > most_bytes:
        raise _too_large(file, most_bytes)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not UTF-8 (byte {error.start})", file=file, remedy="save it as UTF-8"
        ) from error


# Texts of so many characters are remembered: the event and the site of a campaign stand in each of
# its recordings, and YAML takes milliseconds for them.
_MOST_REMEMBERED = 1 << 16
# PyYAML's constructors raise whatever they stumble over in a scalar with a tag of its own.
_PARSE_ERRORS = (
    yaml.YAMLError,
    RecursionError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
)


def _parse(text: str) -> Any:
    """Parse JSON by JSON's rules (YAML reads surrogate pairs otherwise), all else as YAML 1.2.

    What isn't JSON goes to the YAML loader, which also says in which line something is wrong.
    """
    if text.lstrip().startswith("{"):
        with suppress(ValueError):
            return parse_strict(text)
    if text.count("\n%TAG") > _MOST_TAG_DIRECTIVES:  # libyaml compares each with all before it
        raise ValueError(f"it has more than {_MOST_TAG_DIRECTIVES} %TAG directives")
    if len(text) > _MOST_REMEMBERED:
        return yaml.load(text, Loader=CoreLoader)
    return pickle.loads(_pickled(text))


@lru_cache(maxsize=32)
def _pickled(text: str) -> bytes:
    """Return the value of a YAML text in a form from which each caller gets one of its own."""
    return pickle.dumps(yaml.load(text, Loader=CoreLoader))


def check_characters(value: Any, text: str) -> None:
    """Raise ValueError where a string has half of a surrogate pair, which no file can hold."""
    if not _SURROGATE.search(text):
        return
    left = [value]
    while left:
        item = left.pop()
        if isinstance(item, dict):
            left += [*item, *item.values()]
        elif isinstance(item, list):
            left += item
        elif isinstance(item, str) and any("\ud800" <= c <= "\udfff" for c in item):
            raise ValueError(f"{item[:40]!a} has half of a surrogate pair, which is no character")


def read_mapping(path: str | Path) -> dict[str, Any]:
    """Return the mapping at the top of a YAML or JSON file.

    Raises:
        InputError: the file can't be read or parsed, or its top is no mapping.
    """
    return _mapping(parse_value(read_text(path), path), path)


def read_json_mapping(path: str | Path, most_bytes: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Return the mapping at the top of a JSON file that a program of ours wrote.

    Args:
        path: of the file.
        most_bytes: where it may be larger than 8 MiB.

    Raises:
        InputError: the file can't be read, is no JSON or has a NaN, or its top is no mapping.
    """
    text = read_text(path, most_bytes)
    try:
        value = parse_strict(text)
        check_characters(value, text)
    except ValueError as error:
        raise InputError(
            f"is not valid JSON: {error}", file=path, remedy="mend it there, or put the file back"
        ) from error
    return _mapping(value, path)


def read_json(path: str | Path, remedy: str, most_bytes: int = MAX_TEXT_BYTES) -> Any:
    """Return the value of a JSON file that a program of ours wrote; numbers may be NaN or infinite.

    Raises:
        InputError: it can't be read, is no JSON, or has a key twice in an object; with the remedy.
    """
    try:
        text = read_text(path, most_bytes)
        value = parse_lenient(text)
        check_characters(value, text)
    except InputError as error:
        raise InputError(error.problem, file=path, remedy=remedy) from error
    except (ValueError, RecursionError) as error:
        why = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"can't be read: {why}", file=path, remedy=remedy) from error
    return value


def parse_mapping(data: bytes, file: str | Path) -> dict[str, Any]:
    """Read a mapping as read_mapping does, from data in a bag or an archive.

    Args:
        data: UTF-8, at most 8 MiB.
        file: that an error names.

    Raises:
        InputError: the data can't be parsed, or its top is no mapping.
    """
    return _mapping(parse_value(_text(data, file), file), file)


def _mapping(value: Any, file: str | Path) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(
            "must hold a mapping at its top",
            file=file,
            value=value,
            remedy="write names and values: `name: value`",
        )
    return value


def parse_value(text: str, file: str | Path) -> Any:
    """Read the value of a YAML or JSON text: no aliases, no tags, no key twice.

    Args:
        text: at most 8 MiB, which the caller sees to.
        file: that an error names.

    Raises:
        InputError: it can't be parsed.
    """
    try:
        value = _parse(text)
        check_characters(value, text)
    except TooManyValuesError as error:
        raise InputError(
            f"has more than {MOST_VALUES} keys and values, the most that are read as YAML",
            file=file,
            line=error.line,
            remedy=f"give fewer, or {_as_json(text)}",
        ) from error
    except _PARSE_ERRORS as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).partition("\n")[0]
        if isinstance(error, RecursionError):
            problem = "it is nested too deeply"
        raise InputError(
            f"is not valid YAML or JSON: {problem}",
            file=file,
            line=mark.line + 1 if mark is not None else None,
            remedy="mend it there",
        ) from error
    return value


def _as_json(text: str) -> str:
    """Say how a text becomes JSON, which may have more values."""
    if text.lstrip().startswith("{"):
        try:
            parse_strict(text)
        except ValueError as error:
            return f"mend the JSON, which may have more: {error}"
    return "write the file as JSON, which may have more"


def parse_model(model: type[Model], value: Any, file: str | Path) -> Model:
    """Validate a mapping against a pydantic model.

    Raises:
        InputError: all failures, each with its field path, value and remedy; of too many, how many
            there are.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        if (count := error.error_count()) > MOST_ERRORS:
            field_names = (one.alias or name for name, one in model.model_fields.items())
            raise InputError(
                f"has {count} errors, and at most {MOST_ERRORS} are named",
                file=file,
                remedy=f"give a file with the fields {', '.join(islice(field_names, 10))}",
            ) from error
        raise InputError.of_all(failures(error, value, model), file) from error


def load_model(model: type[Model], path: str | Path) -> Model:
    """Read and validate a YAML or JSON file; see read_mapping and parse_model."""
    return parse_model(model, read_mapping(path), path)
