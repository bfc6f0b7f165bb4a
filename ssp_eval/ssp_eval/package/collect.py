"""Which files go into a package, and the paths that they have there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_core.errors import InputError
from ssp_eval.package.model import SCHEMA, TABLE_FILE

_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Source:
    """One file to take in.

    Args:
        path: in the package: the folder's name, and the path below it.
        file: where it lies now.
        bytes: its size.
    """

    path: str
    file: Path
    bytes: int


def collect(folders: Sequence[Path], out: Path) -> list[Source]:
    """All files of some folders, by path, but for hidden ones and for packages among them.

    Args:
        folders: none of which lies in another.
        out: the package that will be made, which is left out.

    Raises:
        InputError: a folder isn't there or is given twice, or holds what is no plain file.
    """
    _check_distinct(folders)
    names: dict[str, Path] = {}
    found: list[Source] = []
    for folder in folders:
        base = folder.resolve().name or "root"
        name = base
        for number in range(2, len(folders) + 2):
            if name not in names:
                break
            name = f"{base}-{number}"
        names[name] = folder
        for file in _files(folder, out.resolve()):
            path = "/".join((name, *file.relative_to(folder).parts))
            found.append(Source(_utf8(path, file), file, file.stat().st_size))
    if not found:
        raise InputError("holds no files", file=folders[0], remedy="name folders with evidence")
    return sorted(found, key=lambda source: source.path)


def _check_distinct(folders: Sequence[Path]) -> None:
    seen: list[tuple[Path, Path]] = []
    for folder in folders:
        if not folder.is_dir():
            raise InputError("is no folder", file=folder, remedy="name folders with evidence")
        real = folder.resolve()
        for other, given in seen:
            if real == other or other in real.parents or real in other.parents:
                raise InputError(
                    f"and {given} hold the same files", file=folder, remedy="name each folder once"
                )
        seen.append((real, folder))


def _files(folder: Path, out: Path) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=folder) from error
    for entry in entries:
        path = Path(entry.path)
        if entry.name.startswith(".") or path.resolve() == out or entry.name == "__pycache__":
            continue
        if entry.is_dir(follow_symlinks=False):
            if not is_package(path):
                yield from _files(path, out)
        elif entry.is_file():
            yield path
        else:
            kind = "a link to a folder or to nothing" if entry.is_symlink() else "no plain file"
            raise InputError(f"is {kind}", file=path, remedy="remove it, or put a file there")


def is_package(folder: Path) -> bool:
    """True for a folder that `ssp package make` left."""
    table = folder / TABLE_FILE
    if not table.is_file():
        return False
    try:
        with table.open("rb") as stream:
            data = stream.read()
        value = json.loads(data)
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(value, dict) and value.get("schema") == SCHEMA


def _utf8(path: str, file: Path) -> str:
    try:
        path.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError("has a name that is not UTF-8", file=str(file).encode("utf-8", "replace")
                         .decode()) from None  # fmt: skip
    return path
