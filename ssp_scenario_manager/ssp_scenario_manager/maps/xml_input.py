"""Map files as XML: read piece by piece, bounded, and every fault named by file and element."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree.ElementTree import Element, ParseError
from xml.parsers.expat import errors as expat_errors

import defusedxml.ElementTree as safe_xml
from defusedxml.common import DefusedXmlException

from ssp_core.decimals import decimal, whole_number
from ssp_core.errors import InputError, not_read

# The largest real maps have some 100 MB.
MAX_MAP_BYTES = 256 << 20
_CHUNK_BYTES = 1 << 20
# One road or one junction of a real map has a few thousand elements.
MAX_PART_ELEMENTS = 500_000
_MAX_DEPTH = 64
# What packed files begin with, and what unpacks them.
_PACKED = {b"\x1f\x8b": "gunzip", b"PK\x03\x04": "unzip", b"BZh": "bunzip2", b"\xfd7zXZ": "unxz"}
_INVALID_TOKEN = expat_errors.codes[expat_errors.XML_ERROR_INVALID_TOKEN]
# No road network lies farther from its origin, m; longer lengths are slips.
FARTHEST_M = 1e8
# Called with how many roads of a map have been read, and of how many; None: nobody can say.
Loading = Callable[[int, int | None], None]


def untold(read: int, total: int | None) -> None:
    """Ignore how far the reading of a map is."""


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
    """Name an element by its tag and id: ``road 12``."""
    identity = element.get("id")
    return element.tag if identity is None else f"{element.tag} {identity[:40]}"


def _path(top: Element, target: Element) -> str:
    """Return where an element stands: ``road 12 / planView / geometry[3]``."""
    stack = [(top, name_of(top))]
    while stack:
        element, path = stack.pop()
        if element is target:
            return path
        counts: dict[str, int] = {}
        for child in element:
            number = counts.get(child.tag, 0)
            counts[child.tag] = number + 1
            name = name_of(child) if child.get("id") else f"{child.tag}[{number}]"
            stack.append((child, f"{path} / {name}"))
    return name_of(target)


def input_error(path: Path, top: Element, bad: BadElement) -> InputError:
    """Return the error for people: file, element, attribute and its text."""
    field = _path(top, bad.element)
    value = None
    if bad.attribute is not None:
        field += f" / {bad.attribute}"
        value = bad.element.get(bad.attribute)
    return InputError(bad.problem, file=path, field=field, value=value, remedy=bad.remedy or None)


def outermost(path: Path) -> Element:
    """Return a file's outermost element, with its attributes and nothing in it.

    Raises:
        InputError: the file can't be read, or isn't XML.
    """
    return next(_events(path, ("start",)))[1]


def parts(path: Path, root: str, counted: str = "", loading: Loading = untold) -> Iterator[Element]:
    """Yield the elements right under the root one by one; each is gone when the next is read.

    Args:
        path: the file.
        root: tag that the outermost element must have.
        counted: tag of the parts that ``loading`` counts.
        loading: called with how many of the counted parts were read, and of how many.

    Raises:
        InputError: the file can't be read, is too large, isn't XML, holds entities, or has another
            root; or one part is larger or deeper than any real one.
    """
    depth = 0
    elements = read = 0
    total = None if loading is untold else count_tags(path, counted)
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
                raise InputError(
                    f"elements are nested more than {_MAX_DEPTH} deep",
                    file=path,
                    remedy="export the map again, or a part of it",
                )
            elif elements > MAX_PART_ELEMENTS:
                raise InputError(
                    f"one part has more than {MAX_PART_ELEMENTS} elements",
                    file=path,
                    remedy="export a part of the map",
                )
        else:
            depth -= 1
            if depth == 1 and top is not None:
                yield element
                if element.tag == counted:
                    read += 1
                    loading(read, total)
                del top[:]
                elements = 0


def count_tags(path: Path, tag: str) -> int | None:
    """Count the elements of a tag without parsing; None where the file's encoding hides them."""
    pattern = re.compile(rb"<" + tag.encode() + rb"[\s>/]")
    count, tail = 0, b""
    try:
        with open(path, "rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                data = tail + chunk
                count += len(pattern.findall(data))
                # One byte less than a match: what was counted isn't counted again.
                tail = data[-len(tag) - 1 :]
    except OSError:  # whoever reads it says so
        return None
    return count or None


class _Chunks:
    """A file that is read a megabyte at a time.

    The parser goes back to a token's start whenever more of it arrives, so that small pieces of a
    huge attribute take minutes.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, _size: int = -1) -> bytes:
        """Return the next piece, regardless of the wanted size."""
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
            _refuse_packed(stream.read(8), path)
            stream.seek(0)
            parser_events = safe_xml.iterparse(_Chunks(stream), events=(*events, "start-ns"))
            yield from _in_own_namespace(parser_events, path)
    except OSError as error:
        raise not_read(path, error) from error
    except DefusedXmlException as error:
        raise InputError(
            "declares entities, which a map has no use for and which can expand without end",
            file=path,
            remedy="remove the declarations",
        ) from error
    except ParseError as error:
        line = error.position[0] if hasattr(error, "position") else None
        remedy = "save it as UTF-8, if it isn't" if error.code == _INVALID_TOKEN else None
        raise InputError(
            f"is not valid XML: {error}", file=path, line=line, remedy=remedy
        ) from error
    except (ValueError, LookupError) as error:  # an encoding that the parser lacks, a NUL in a name
        remedy = "save it as UTF-8" if "encoding" in str(error) else None
        raise InputError(f"is not valid XML: {error}", file=path, remedy=remedy) from error


def _refuse_packed(head: bytes, path: Path) -> None:
    for mark, tool in _PACKED.items():
        if head.startswith(mark):
            raise InputError("is packed", file=path, remedy=f"unpack it first, as by {tool}")


def _in_own_namespace(
    events: Iterator[tuple[str, Any]], path: Path
) -> Iterator[tuple[str, Element]]:
    """Drop the outermost element's XML namespace from all tags in it, and no other namespace.

    Raises:
        InputError: its name has a prefix, which players of the map would take for a part of it.
    """
    defaults: set[str] = set()
    own: str | None = None
    for event, element in events:
        if event == "start-ns":
            prefix, uri = element
            defaults |= set() if prefix else {uri}
            continue
        if own is None:
            own = element.tag.partition("}")[0] + "}" if element.tag.startswith("{") else ""
            if own and own[1:-1] not in defaults:
                raise InputError(
                    f"has a prefix before its elements, for the XML namespace {own[1:-1][:80]}",
                    file=path,
                    remedy="make that the default namespace (xmlns=…), or write plain names",
                )
        if own and element.tag.startswith(own):
            element.tag = element.tag[len(own) :]
        yield event, element


def document(data: bytes) -> Element:
    """Return the outermost element of an XML text, in its own namespace.

    Raises:
        InputError: it isn't XML, or declares entities.
    """
    try:
        root: Element = safe_xml.fromstring(data)
    except (ValueError, LookupError, ParseError) as error:
        raise InputError(f"is not valid XML: {error}", remedy="export the map again") from error
    own = root.tag.rpartition("}")[0]
    for element in root.iter():
        element.tag = element.tag.removeprefix(own + "}") if own else element.tag
    return root


def text(element: Element, attribute: str, default: str | None = None) -> str:
    """Return an attribute.

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
    """Return a finite number from an attribute, within bounds.

    Raises:
        BadElement: it is missing without a default, no number, or out of bounds.
    """
    value = element.get(attribute)
    if value is None:
        if default is None:
            raise BadElement(element, f"has no attribute {attribute!r}")
        return default
    try:
        decimal_number = decimal(value)
    except ValueError:
        is_nonfinite = value.strip().lower().lstrip("+-") in ("inf", "infinity", "nan")
        problem = "is not finite" if is_nonfinite else "is not a number"
        raise BadElement(
            element, problem, attribute, "give a number" if is_nonfinite else ""
        ) from None
    if not math.isfinite(decimal_number):
        raise BadElement(element, "is not finite", attribute, "give a number")
    if not low <= decimal_number <= high:
        raise BadElement(
            element, "is out of bounds", attribute, f"from {low:g} to {high:g} can be read"
        )
    return decimal_number


def whole(element: Element, attribute: str, *, most: int = 1000) -> int:
    """Return a whole number from an attribute, at most that large either way.

    Raises:
        BadElement: it is missing, no whole number, or larger.
    """
    value = text(element, attribute)
    try:
        integer = whole_number(value)
    except ValueError:
        raise BadElement(element, "is not a whole number", attribute) from None
    if abs(integer) > most:
        raise BadElement(element, "is out of bounds", attribute, f"at most {most} can be read")
    return integer
