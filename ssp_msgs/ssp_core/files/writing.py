"""Files that are the old one or wholly the new one."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError, not_written
from ssp_core.files.folders import make_folder


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
