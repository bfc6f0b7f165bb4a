"""Definitions of message types from the .msg files of whatever ROS packages are installed."""

from __future__ import annotations

import os
import re
from collections.abc import Container
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Constdefs, Fielddefs, FieldDesc, Typesdict
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import TypesysError

from ssp_core.errors import InputError

_MSGTYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)", re.ASCII)
# A definition is text that people write; these bound what a damaged installation can ask for.
_MOST_BYTES = 1 << 20
_MOST_TYPES = 500


def installed_file(msgtype: str) -> Path | None:
    """The .msg file of a type below AMENT_PREFIX_PATH; None when there is none.

    Args:
        msgtype: from anywhere; it is no path, whatever it says.
    """
    found = _MSGTYPE.fullmatch(msgtype)
    if found is None:
        return None
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "share", found[1], "msg", f"{found[2]}.msg")
        if prefix and path.is_file():
            return path
    return None


def installed_types(msgtype: str, known: Container[str]) -> Typesdict:
    """A type and all that it uses, read from their .msg files.

    Args:
        msgtype: full name.
        known: types that need no look.

    Raises:
        InputError: the file of one isn't there, or is no definition.
    """
    found: Typesdict = {}
    left = [msgtype]
    while left:
        name = left.pop()
        if name in found or name in known:
            continue
        if len(found) >= _MOST_TYPES:
            raise InputError(f"uses more than {_MOST_TYPES} types", field=msgtype)
        found[name] = _read(name)
        left += [used for _, kind in found[name][1] for used in _used(kind)]
    return found


def _read(msgtype: str) -> tuple[Constdefs, Fielddefs]:
    path = installed_file(msgtype)
    if path is None:
        raise InputError(
            "is no known message type",
            field=msgtype,
            remedy="install its package and source it, so that AMENT_PREFIX_PATH names it",
        )
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InputError("is too large for a message definition", file=path)
        types = get_types_from_msg(path.read_text("utf-8"), msgtype)
        return types[msgtype]
    except (OSError, ValueError, KeyError, RecursionError, TypesysError) as error:
        raise InputError(f"is no message definition: {error}", file=path) from error


def _used(kind: FieldDesc) -> list[str]:
    """Names of the types in a field."""
    if kind[0] == Nodetype.NAME:
        return [str(kind[1])]
    if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        inner = kind[1][0]
        return [str(inner[1])] if inner[0] == Nodetype.NAME else []
    return []
