"""Reads files and JSON from outside strictly, and writes files that are whole or not there."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import pickle
import re
import shutil
import stat
import tempfile
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from ssp_core.errors import SYSTEM_REMEDIES, HostError, InputError, not_read, not_written
from ssp_core.model_errors import failures
from ssp_core.yaml_core import MOST_VALUES, CoreLoader, TooManyValuesError


class KeyTwiceError(ValueError):
    """A JSON object has a key twice, of which a reader would take either."""

    def __init__(self, key: str) -> None:
        self.key = key
        super().__init__(f"key {key!r} stands twice")


def parse_strict(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Unlike ``json.loads`` it takes no NaN or infinity and no key twice in an object, and nesting
    that is too deep is an error like any other.

    Args:
        text: as it came; bytes must be UTF-8.

    Raises:
        ValueError: it is no JSON; says what and, where that is known, at which character.
    """
    try:
        plain = text.decode("utf-8") if isinstance(text, bytes) else text
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8 (byte {error.start})") from None
    try:
        return json.loads(plain, object_pairs_hook=_once, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        raise KeyTwiceError(next(key for key, count in counts.items() if count > 1))
    return mapping


def parse_json_line(line: str | bytes, file: str | Path, number: int) -> Any:
    """Return the value of a line of a JSON Lines file; NaN and infinity are read as such.

    Raises:
        InputError: it is no JSON, or an object of it has a key twice; with line and key.
    """
    try:
        return json.loads(line, object_pairs_hook=_once)
    except KeyTwiceError as error:
        raise InputError(
            "stands twice in an object",
            file=file,
            line=number,
            field=error.key,
            remedy="keep one of the two",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"is not valid JSON: {error}",
            file=file,
            line=number,
            remedy="write one JSON value a line",
        ) from error


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is no number")


class Closing(ABC):
    """A context manager that closes itself at its end, also after an exception."""

    @abstractmethod
    def close(self) -> None:
        """End the use; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
    named = os.path.realpath(path)
    if os.path.lexists(named) and stat.S_ISFIFO(os.lstat(named).st_mode):
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
        value = json.loads(text, object_pairs_hook=_once)
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
            known = (one.alias or name for name, one in model.model_fields.items())
            raise InputError(
                f"has {count} errors, and at most {MOST_ERRORS} are named",
                file=file,
                remedy=f"give a file with the fields {', '.join(islice(known, 10))}",
            ) from error
        raise InputError.of_all(failures(error, value, model), file) from error


def load_model(model: type[Model], path: str | Path) -> Model:
    """Read and validate a YAML or JSON file; see read_mapping and parse_model."""
    return parse_model(model, read_mapping(path), path)


def make_folder(path: str | Path) -> Path:
    """Return the folder, made with its parents where it isn't there yet, and writable.

    Raises:
        InputError: it or a parent is a file, or permission is missing.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        there = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
        why = error.strerror if there.is_dir() else f"{there} is no folder"
        raise InputError(
            f"can't be made: {why}", file=path, remedy="name another folder"
        ) from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError("can't be written to", file=path, remedy="name another folder")
    return path


def check_folder(path: str | Path, remedy: str) -> None:
    """Refuse what is no folder.

    Raises:
        InputError: it isn't there, or is a file.
    """
    if not os.path.isdir(path):
        problem = "is no folder" if os.path.lexists(path) else "is not there"
        raise InputError(problem, file=path, remedy=remedy)


# In a folder that a command writes into, until it has ended.
TAKEN_FILE = ".ssp-taken"


@contextmanager
def taken_folder(path: str | Path, *, empty: bool = False) -> Iterator[Path]:
    """Make a folder and keep it from other commands until the end of the block.

    A file that is created exclusively says that it is taken. One whose writer died is taken over.

    Args:
        path: of the folder.
        empty: what holds anything is refused.

    Raises:
        InputError: another command writes into it, it holds something, or it can't be made.
    """
    made = not Path(path).exists()
    folder = make_folder(path)
    file = folder / TAKEN_FILE
    handle = _created_alone(file)
    try:
        if empty and any(entry.name != TAKEN_FILE for entry in folder.iterdir()):
            raise InputError("is not empty", file=folder, remedy="name a new folder")
        yield folder
    finally:
        with suppress(OSError):
            file.unlink()
            if made:  # a command that fails before it writes leaves nothing
                folder.rmdir()
        os.close(handle)


def _created_alone(file: Path) -> int:
    """Create a file that isn't there, and lock it for as long as this process lives.

    Raises:
        InputError: another process has, or it can't be made.
    """
    while True:
        try:
            handle = os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            if _is_left_behind(file):
                continue
            raise InputError(
                "is what another command writes into just now",
                file=file.parent,
                remedy=f"wait until that has ended, or name another folder ({file.name} says so)",
            ) from None
        except OSError as error:
            raise InputError(
                f"can't be written to: {error.strerror}",
                file=file.parent,
                remedy="get permission, or name another folder",
            ) from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:  # somebody takes it for one that was left behind
            os.close(handle)
            continue
        except OSError:  # some network file systems have no locks
            return handle
        if _is_still(file, handle):
            return handle
        os.close(handle)


def _is_left_behind(file: Path) -> bool:
    """Tell whether the process that created a file is gone; the file is removed then."""
    try:
        handle = os.open(file, os.O_WRONLY)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_still(file, handle):
            file.unlink()
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


def _is_still(file: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.stat(file), os.fstat(handle))
    except FileNotFoundError:
        return False


def remove_folder(folder: Path) -> None:
    """Remove a folder, if it is there, so that no part of it is ever found without the others.

    Raises:
        HostError: it can't be moved.
    """
    try:
        aside = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", dir=folder.parent))
    except FileNotFoundError:
        return
    except OSError as error:
        raise HostError(f"{folder} can't be removed: {error.strerror}") from error
    try:
        folder.rename(aside)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise HostError(f"{folder} can't be removed: {error.strerror}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def scratch_beside(target: Path) -> Path:
    """Make a hidden folder beside a target that is made in it and then renamed.

    Raises:
        InputError: it can't be made, or no file can have the target's name.
    """
    parent = make_folder(target.absolute().parent)
    try:
        with suppress(FileNotFoundError):
            os.lstat(target)
        return Path(tempfile.mkdtemp(dir=parent, prefix=f".{target.name[:50]}."))
    except OSError as error:
        remedy = SYSTEM_REMEDIES.get(error.errno or 0, "name another folder")
        raise InputError(
            f"can't be made: {error.strerror or error}", file=target, remedy=remedy
        ) from error


@contextmanager
def new_folder(target: Path, remedy: str = "name a new directory") -> Iterator[Path]:
    """Yield a path at which a folder is made; it becomes the target, or there is none.

    Raises:
        InputError: the target exists or can't be made.
        HostError: the disk doesn't take it.
    """
    if os.path.lexists(target):
        raise InputError("exists already", file=target, remedy=remedy)
    scratch = scratch_beside(target)
    try:
        yield scratch / "new"
        (scratch / "new").rename(target)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):  # made in the meantime
            raise InputError("exists already", file=target, remedy=remedy) from error
        raise not_written(target, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def put_in_place(made: Path, target: Path) -> None:
    """Rename a finished folder to its place; an earlier one there goes once the new one stands.

    Raises:
        HostError: the system doesn't let it, such as where the target is a mount; the earlier
            folder is there as it was.
    """
    aside = scratch_beside(target)
    old = aside / "old"
    try:
        if os.path.lexists(target):
            target.rename(old)
        made.rename(target)
    except BaseException as error:
        if os.path.lexists(old):
            old.rename(target)
        if isinstance(error, OSError):
            raise not_written(target, error) from error
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def new_files(folder: Path) -> Iterator[Path]:
    """Yield a folder for files that belong together; at the end they go to ``folder``, or none do.

    Files of the same names that are there are replaced.

    Raises:
        InputError: the folder can't be made.
        HostError: the disk doesn't take them.
    """
    made = not folder.exists()
    make_folder(folder)
    try:
        scratch = Path(tempfile.mkdtemp(dir=folder, prefix=".new."))
    except OSError as error:
        raise not_written(folder, error) from error
    try:
        yield scratch
        for file in sorted(scratch.iterdir()):
            file.replace(folder / file.name)
    except HostError as error:  # names a file by the place that it was to have
        raise HostError(str(error).replace(str(scratch), str(folder))) from error
    except OSError as error:
        raise not_written(folder, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        if made:
            with suppress(OSError):  # it holds something: a file was put there
                folder.rmdir()


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file that is either the old one or wholly the new one.

    Raises:
        InputError: it can't be put there: a parent is a file, it is a folder, it is forbidden.
        HostError: the disk doesn't take it.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError("is a folder", file=path, remedy="name a file")
    make_folder(path.parent)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:50]}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise not_written(path, error) from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text as write_bytes does, in UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write indented JSON with sorted keys and a final newline; refuse NaN with ValueError."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n")
