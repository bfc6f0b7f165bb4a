"""The demonstration's own folder: locked while it works, emptied of nothing but its own."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_json
from ssp_core.hashing import sha256_bytes

MARKER = ".ssp-demo.json"
SCHEMA = "ssp.demo/1"
LOGS = "logs/steps"
# All that a demonstration leaves in its folder.
MADE = frozenset(
    {
        MARKER, "audits", "cells", "clips", "frames", "index.html", "logs", "package",
        "report", "requests", "runs", "tasks",
    }
)  # fmt: skip
_MOST = 99


@contextmanager
def own_folder(out: Path) -> Iterator[Path]:
    """The folder, or the next free number beside it while another demonstration works there.

    Raises:
        InputError: it holds something that no demonstration made.
    """
    for number in range(1, _MOST + 1):
        folder = out if number == 1 else out.with_name(f"{out.name}-{number}")
        handle = os.open(_lock_file(folder), os.O_CREAT | os.O_RDONLY, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            _clear(folder)
            write_json(folder / MARKER, {"schema": SCHEMA})
            yield folder
        finally:
            os.close(handle)
        return
    raise InputError(f"and {_MOST - 1} folders beside it are in use", file=out)


def _lock_file(folder: Path) -> Path:
    """A lock that lies beside nobody's files."""
    locks = Path(tempfile.gettempdir()) / "ssp-demos"
    if not locks.is_dir():
        locks.mkdir(exist_ok=True)
        locks.chmod(0o1777)  # for all users of the host
    return locks / sha256_bytes(str(folder.resolve()).encode()).removeprefix("sha256:")[:32]


def _clear(folder: Path) -> None:
    """Makes the folder, or empties it of what an earlier demonstration left, and of nothing else.

    Raises:
        InputError: it can't be made, or holds something that no demonstration made.
    """
    found = {entry.name for entry in make_folder(folder).iterdir()}
    foreign = sorted(found - MADE)
    if foreign or (found and not _is_ours(folder / MARKER)):
        raise InputError(
            "holds something that no demonstration made",
            file=folder,
            value=", ".join(foreign) or None,
            remedy="name another folder with --out",
        )
    for name in found:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _is_ours(marker: Path) -> bool:
    try:
        value = json.loads(marker.read_text())
    except (OSError, ValueError):
        return False
    return isinstance(value, dict) and value.get("schema") == SCHEMA
