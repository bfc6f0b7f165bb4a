"""Map files as XML: read piece by piece, bounded, and every fault named by file and element."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree as safe_xml
from defusedxml.common import DefusedXmlException

from ssp_core.errors import InputError

# The largest real maps have some 100 MB.
MAX_MAP_BYTES = 256 << 20
_CHUNK_BYTES = 1 << 20
# One road or one junction of a real map has a few thousand elements.
MAX_PART_ELEMENTS = 500_000
_MAX_DEPTH = 64
# No road network lies farther from its origin, m; longer lengths are slips.
FARTHEST_M = 1e8


class BadElement(Exception):
    """Something is wrong in an element; the reader of the file says where that element stands.

    Args:
        problem: as a clause.
        remedy: what would be right.
    """

    def __init__(
        self, element: Element, problem: str, attribute: str | None = None, remedy: str = ""
    ) -> None:
        super().__init__(problem)
        self.element = element
        self.problem = problem
        self.attribute = attribute
        self.remedy = remedy


def name_of(element: Element) -> str:
    """``road 12``: an element by its tag and id."""
    identity = element.get("id")
    return element.tag if identity is None else f"{element.tag} {identity[:40]}"


def _path(top: Element, wanted: Element) -> str:
    """``road 12 / planView / geometry[3]``: where an element stands under another."""
    stack = [(top, name_of(top))]
    while stack:
        element, path = stack.pop()
        if element is wanted:
            return path
        counts: dict[str, int] = {}
        for child in element:
            number = counts.get(child.tag, 0)
            counts[child.tag] = number + 1
            name = name_of(child) if child.get("id") else f"{child.tag}[{number}]"
            stack.append((child, f"{path} / {name}"))
    return name_of(wanted)


def input_error(path: Path, top: Element, bad: BadElement) -> InputError:
    """The error for people: file, element, attribute and its text."""
    field = _path(top, bad.element)
    value = None
    if bad.attribute is not None:
        field += f" / {bad.attribute}"
        value = bad.element.get(bad.attribute)
    return InputError(bad.problem, file=path, field=field, value=value, remedy=bad.remedy or None)


def root_tag(path: Path) -> str:
    """Tag of a file's outermost element.

    Raises:
        InputError: the file can't be read, or isn't XML.
    """
    return next(_events(path, ("start",)))[1].tag


def parts(path: Path, root: str) -> Iterator[Element]:
    """The elements right under the root, one after the other; each is gone when the next is read.

    Args:
        root: tag that the outermost element must have.

    Raises:
        InputError: the file can't be read, is too large, isn't XML, holds entities, or has another
            root; or one part is larger or deeper than any real one.
    """
    depth = 0
    elements = 0
    top: Element | None = None
    for event, element in _events(path, ("start", "end")):
        if event == "start":
            depth += 1
            elements += 1
            if top is None:
                if element.tag != root:
                    raise InputError(
                        f"its outermost element is <{element.tag[:40]}>",
                        file=path,
                        remedy=f"a map of this kind has <{root}>",
                    )
                top = element
            elif depth > _MAX_DEPTH:
                raise InputError(f"elements are nested more than {_MAX_DEPTH} deep", file=path)
            elif elements > MAX_PART_ELEMENTS:
                raise InputError(f"one part has more than {MAX_PART_ELEMENTS} elements", file=path)
        else:
            depth -= 1
            if depth == 1 and top is not None:
                yield element
                del top[:]
                elements = 0


class _Chunks:
    """A file that is read a megabyte at a time.

    The parser goes back to a token's start whenever more of it arrives, so that small pieces of a
    huge attribute take minutes.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int = -1) -> bytes:
        """The next piece, whatever size is asked for."""
        return self._stream.read(_CHUNK_BYTES)


def _events(path: Path, events: tuple[str, ...]) -> Iterator[tuple[str, Element]]:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise InputError("is no file", file=path, remedy="give a map's file")
        if size > MAX_MAP_BYTES:
            raise InputError(
                f"has {size >> 20} MiB", file=path, remedy=f"at most {MAX_MAP_BYTES >> 20} MiB"
            )
        with open(path, "rb") as stream:
            yield from safe_xml.iterparse(_Chunks(stream), events=events)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error
    except DefusedXmlException as error:
        raise InputError(
            "declares entities, which a map has no use for and which can expand without end",
            file=path,
            remedy="remove the declarations",
        ) from error
    except ParseError as error:
        line = error.position[0] if hasattr(error, "position") else None
        raise InputError(f"is not valid XML: {error}", file=path, line=line) from error
    except (ValueError, LookupError) as error:  # an encoding that nobody knows, a NUL in the name
        raise InputError(f"is not valid XML: {error}", file=path) from error


def text(element: Element, attribute: str, default: str | None = None) -> str:
    """An attribute.

    Raises:
        BadElement: it is missing, and there is no default.
    """
    value = element.get(attribute)
    if value is None:
        if default is None:
            raise BadElement(element, f"has no attribute {attribute!r}")
        return default
    return value


def number(
    element: Element,
    attribute: str,
    default: float | None = None,
    *,
    low: float = -FARTHEST_M,
    high: float = FARTHEST_M,
) -> float:
    """A finite number from an attribute, within bounds.

    Raises:
        BadElement: it is missing without a default, no number, or out of bounds.
    """
    value = element.get(attribute)
    if value is None:
        if default is None:
            raise BadElement(element, f"has no attribute {attribute!r}")
        return default
    try:
        found = float(value)
    except ValueError:
        raise BadElement(element, "is not a number", attribute) from None
    if not math.isfinite(found):
        raise BadElement(element, "is not finite", attribute, "give a number")
    if not low <= found <= high:
        raise BadElement(
            element, "is out of bounds", attribute, f"from {low:g} to {high:g} can be read"
        )
    return found


def whole(element: Element, attribute: str, *, most: int = 1000) -> int:
    """A whole number from an attribute, at most that large either way.

    Raises:
        BadElement: it is missing, no whole number, or larger.
    """
    value = text(element, attribute)
    try:
        found = int(value)
    except ValueError:
        raise BadElement(element, "is not a whole number", attribute) from None
    if abs(found) > most:
        raise BadElement(element, "is out of bounds", attribute, f"at most {most} can be read")
    return found
