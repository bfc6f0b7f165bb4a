"""One row of numbers in a bracket, ``[3.2, -0.2]``, in the ways in which models write it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

# Signs that models write for a minus; the first is ASCII's.
_MINUS = "-\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d"
SIGN = rf"[+\{_MINUS}]?"
PLAIN = "(?:[0-9]+(?:[.][0-9]*)?|[.][0-9]+)(?:[eE][+-]?[0-9]+)?"
_TO_ASCII = str.maketrans(dict.fromkeys(_MINUS, "-"))

_GROUP = re.compile(r"([\[({])([^\[\](){}]+)([\])}])")
_USUAL_ROW = re.compile(rf"\s*({SIGN}{PLAIN})\s*,\s*({SIGN}{PLAIN})\s*")
_INSIDE = re.compile(
    rf"(?P<space>\s+)|(?P<comma>[,;])|(?P<unit>1/m\b)"
    rf"|(?P<number>{SIGN}(?:{PLAIN}|(?i:nan|inf(?:inity)?)\b))"
    r"|(?P<word>[^\W\d]\w*(?:/\w+)?(?:\^-1|⁻¹)?)|(?P<ignored>[:=*`$\\\"'])|(?P<other>.)",
    re.DOTALL,
)
_NAMES = frozenset(
    {"v", "k", "c", "x", "y", "speed", "velocity", "vel", "curvature", "curv", "kappa", "κ"}
    | {"lateral", "longitudinal", "forward", "left"}
)
_UNITS = frozenset(
    {"m", "meter", "meters", "metre", "metres", "m/s", "mps", "m/step", "rad/m", "m^-1", "m⁻¹"}
    | {"km/h", "kmh", "kph", "mph", "ft", "deg", "s"}
)
_DIGIT = re.compile("[0-9]|nan|inf", re.IGNORECASE)
_LONGEST_BEGUN = 80
_BRACKETS = {"[]": "square brackets", "()": "round brackets", "{}": "braces"}


@dataclass(frozen=True, slots=True)
class Row:
    """A bracket that is a row of numbers, or tries to be one.

    Args:
        start: offset of the opening bracket.
        end: offset behind the closing one.
        brackets: both.
        numbers: empty if it holds digits, but can't be read as a row.
        names: that the numbers are given in the bracket, empty for none.
        units: behind numbers.
        marks: ways of writing, a few words each.
    """

    start: int
    end: int
    brackets: str
    numbers: tuple[float, ...]
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()


def find_rows(text: str) -> Iterator[Row]:
    """The rows of a text, in its order.

    Args:
        text: anything.
    """
    for match in _GROUP.finditer(text):
        opening, inside, closing = match.groups()
        if _DIGIT.search(inside) is None:
            continue
        row = read_row(match.start(), match.end(), inside, opening + closing)
        if row is not None:
            yield row


def read_row(start: int, end: int, inside: str, brackets: str) -> Row | None:
    """The row in a bracket; None if it holds no number, or a single one, which is a label.

    Args:
        start: offset of the opening bracket.
        end: offset behind the closing one.
        inside: of the bracket.
        brackets: both; empty for one that never closes.
    """
    marks = (_BRACKETS[brackets],) if brackets in _BRACKETS else ()
    usual = _USUAL_ROW.fullmatch(inside)
    if usual is not None and inside.isascii() and marks:
        return Row(start, end, brackets, (float(usual[1]), float(usual[2])), (), (), marks)
    return _unusual_row(start, end, inside, brackets, marks)


def may_begin_row(inside: str) -> bool:
    """Whether what follows an opened bracket may be a row that isn't finished.

    Args:
        inside: up to the end of the text.
    """
    if len(inside) > _LONGEST_BEGUN:
        return False
    begun = inside.rstrip().rstrip("+" + _MINUS)
    kinds = {token.lastgroup for token in _INSIDE.finditer(begun)} - {"space", "ignored"}
    return kinds <= {"number", "comma"} or kinds == {"number", "comma", "word"}


def _unusual_row(
    start: int, end: int, inside: str, brackets: str, marks: tuple[str, ...]
) -> Row | None:
    numbers: list[float] = []
    names: list[str] = []
    units: list[str] = []
    found = set(marks)
    # "[0, 5)" is an interval.
    name, parted, spaced, bad = "", True, True, brackets not in _BRACKETS
    for token in _INSIDE.finditer(inside):
        kind, word = token.lastgroup, token.group()
        if kind == "number":
            if not parted:
                found.add("a space for a comma")
                bad = bad or not spaced
            if not word.isascii():
                word = word.translate(_TO_ASCII)
                found.add("a Unicode minus")
            numbers.append(float(word))
            names.append(name)
            name, parted = "", False
        elif kind == "word" and word.lower() in _UNITS and name == "" and numbers and not parted:
            units.append(word.lower())
        elif kind == "word" and word.lower().rstrip("0123456789_") in _NAMES:
            name = word.lower().rstrip("0123456789_")
            found.add("names in rows")
        elif kind == "unit":
            units.append(word)
        elif kind == "comma":
            bad = bad or parted or name != ""
            parted = True
        elif kind in ("word", "other"):
            bad = True
        spaced = kind == "space" or (spaced and kind == "ignored")
    bad = bad or name != ""
    if not numbers or (len(numbers) == 1 and not bad):
        return None
    return Row(
        start,
        end,
        brackets,
        () if bad else tuple(numbers),
        tuple(names),
        tuple(units),
        tuple(sorted(found)),
    )
