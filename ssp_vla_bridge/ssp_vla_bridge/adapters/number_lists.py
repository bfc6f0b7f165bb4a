"""One row of numbers in a bracket, ``[3.2, -0.2]``, in the ways in which models write it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter

from ssp_vla_bridge.adapters.list_items import (
    BARE_LINE,
    Item,
    another_item,
    closing_brackets,
    continues,
    holds_element,
    item_of,
    lacks_first,
    lone_at_end,
    lone_element,
    next_object,
    remarks,
    stated_times,
)

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
    | {"lateral", "longitudinal", "forward", "left", "right", "t", "time", "z"}
    | {"time_s", "time_ms", "timestamp"}
    | {"yaw", "heading", "theta", "accel", "acceleration"}
    | {"confidence", "conf", "probability", "prob", "score", "likelihood"}
)
# Further ones of objects: ``{"index": 1, "x": 5.0, "y": 0.0}``.
_INDEX_NAMES = frozenset({"index", "idx", "step", "waypoint", "point", "wp", "frame", "timestep"})
_UNITS = frozenset(
    {"m", "meter", "meters", "metre", "metres", "m/s", "mps", "m/step", "rad/m", "m^-1", "m⁻¹"}
    | {"km/h", "kmh", "kph", "mph", "ft", "feet", "foot", "cm", "mm", "km", "yd", "px", "deg", "s"}
)
_DIGIT = re.compile("[0-9]|nan|inf", re.IGNORECASE)
_LONGEST_BEGUN = 80
_BRACKETS = {"[]": "square brackets", "()": "round brackets", "{}": "braces"}


@dataclass(frozen=True, slots=True)
class Row:
    """A bracket that is a row of numbers, or tries to be one.

    Args:
        numbers: empty if it holds digits, but can't be read as a row.
        names: that the numbers are given in the bracket, empty for none.
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
    """Yield the rows of a text, in its order."""
    for match in _GROUP.finditer(text):
        opening, inside, closing = match.groups()
        if _DIGIT.search(inside) is None:
            continue
        row = read_row(match.start(), match.end(), inside, opening + closing)
        if row is not None:
            yield row


def read_row(start: int, end: int, inside: str, brackets: str) -> Row | None:
    """Return the row in a bracket, None if it holds no number, or a single one, which is a label.

    Args:
        start: offset of its opening bracket.
        end: offset behind its closing one.
        inside: the text between them.
        brackets: both; empty for one that never closes.
    """
    marks = (_BRACKETS[brackets],) if brackets in _BRACKETS else ()
    usual = _USUAL_ROW.fullmatch(inside)
    if usual is not None and inside.isascii() and marks:
        return Row(start, end, brackets, (float(usual[1]), float(usual[2])), (), (), marks)
    return _unusual_row(start, end, inside, brackets, marks)


def may_begin_row(inside: str) -> bool:
    """Tell whether the text after an opened bracket may be a row that isn't finished."""
    if len(inside) > _LONGEST_BEGUN:
        return False
    begun = inside.rstrip().rstrip("+" + _MINUS)
    tokens = [token for token in _INSIDE.finditer(begun) if token.lastgroup != "space"]
    kinds = {token.lastgroup for token in tokens} - {"ignored"}
    words = [_plain_name(token.group()) for token in tokens if token.lastgroup == "word"]
    if kinds == {"number", "word"} and all(word in _NAMES | _INDEX_NAMES for word in words):
        return True
    return kinds <= {"number", "comma"} or kinds == {"number", "comma", "word"}


# A field of an object that is a text and names nobody: ``"note": "brakes on"``.
_TEXT_FIELD = re.compile(
    r"[\"'](?!(?:label|type|class|category|name|object|agent|kind|role|actor|id|track"
    r"|(?:t|time|timestamp)(?:_m?s)?)\b)"
    # Units and frames are no remarks, unless they are the plan's own.
    r"(?!(?:units?|frame(?:_id)?|coordinate_frame)[\"']\s*:\s*[\"'](?!(?:m|met(?:er|re)s?|ego\w*"
    r"|vehicle\w*|base_link|local|self|[^\"'\n]*\d)[\"']))"
    r"[\w ]{1,40}[\"']\s*:\s*(?:\"[^\"\n]*\"|'[^'\n]*'|true|false|null)\s*(?:,|$)"
)


# A time that is a text: ``"t": "T+1 s"``.
_TIME_TEXT = re.compile(
    r"[\"'](?:t|time|time_?stamp|time_?offset|at|after|when)(?P<of>_m?s)?[\"']\s*:\s*[\"'](?:t\s*[=+]?\s*)?\+?\s*"
    r"(?P<value>\d*\.?\d+)\s*(?:(?P<milli>ms|msecs?|milliseconds?)|(?P<unit>s|secs?|seconds?))?[\"']",
    re.IGNORECASE,
)
_TIME_NAME = re.compile(
    r"(?:(?:t|time|time_?stamp|time_?offset)_)?"
    r"(?:(?P<milli>ms|msec|millis|milliseconds)|s|sec|secs|seconds)"
)


# An axis with its direction, or with what it is an axis of: "x_forward", "pos_x".
_NAMED_AXIS = re.compile(
    r"(?:[xyz]_)?(forward|left|right|lateral|longitudinal)(?:_[xyz])?"
    r"|(?:pos|position|ego)_([xy])|([xy])_(?:pos|position|ego)"
)


def _plain_name(word: str) -> str:
    """Return a column's name without a number or a unit, but for times: ``x_m``, ``v1``."""
    word = word.lower()
    timed = _TIME_NAME.fullmatch(word)
    if timed is not None:
        return "time_ms" if timed["milli"] else "time_s"
    plain = re.sub(r"_(?:m|mps|meters?|metres?)$", "", word).rstrip("0123456789_")
    axis_match = _NAMED_AXIS.fullmatch(plain)
    return next(filter(None, axis_match.groups())) if axis_match is not None else plain


def _time(match: re.Match[str]) -> str:
    unit = "_ms" if match["milli"] else "_s" if match["unit"] else match["of"] or ""
    return f'"t{unit.lower()}": {match["value"]}'


def _unusual_row(
    start: int, end: int, inside: str, brackets: str, marks: tuple[str, ...]
) -> Row | None:
    numbers: list[float] = []
    names: list[str] = []
    units: list[str] = []
    row_marks = set(marks)
    names_known = _NAMES
    if brackets == "{}":
        names_known = _NAMES | _INDEX_NAMES
        inside = _TEXT_FIELD.sub("", _TIME_TEXT.sub(_time, inside)).rstrip(" \n\t,")
    # "[0, 5)" is an interval.
    name, parted, spaced, bad = "", True, True, brackets not in _BRACKETS
    for token in _INSIDE.finditer(inside):
        kind, word = token.lastgroup, token.group()
        if kind == "number":
            if not parted:
                row_marks.add("a space for a comma")
                bad = bad or not spaced
            if not word.isascii():
                word = word.translate(_TO_ASCII)
                row_marks.add("a Unicode minus")
            numbers.append(float(word))
            names.append(name)
            name, parted = "", False
        elif kind == "word" and word.lower() in _UNITS and name == "" and numbers and not parted:
            units.append(word.lower())
        elif kind == "word" and _plain_name(word) in names_known:
            name = _plain_name(word)
            row_marks.add("names in rows")
        elif kind == "unit":
            units.append(word)
        elif kind == "comma":
            bad = bad or parted or name != ""
            parted = True
        elif kind in ("word", "other"):
            bad = True
        spaced = kind == "space" or (spaced and kind == "ignored")
    bad = bad or name != ""
    if not numbers or (len(numbers) == 1 and not bad and not {"x", "y"} & set(names)):
        return None
    return Row(
        start,
        end,
        brackets,
        () if bad else tuple(numbers),
        tuple(names),
        tuple(units),
        tuple(sorted(row_marks)),
    )


CUT = "it is cut off by the end of the text"
ELIDED = "an ellipsis stands for rows"
UNREAD = "one of its rows can't be read"

_BETWEEN = re.compile(
    r"(?P<space>\s+|</?(?:br|p|li|ul|ol|div|td|tr)\s*/?>)|(?P<comma>[,;])"
    r"|(?P<ellipsis>[.]{2,}|…|⋯)|(?P<group>(?<![\w.])[0-9]{1,3}\)(?=[ \t])"
    r"|\([a-zA-Z/ ]{0,12}\)|[\[(][0-9. ]{1,8}s?[\])]"
    r"|\([a-z ]{0,9}[=:≈]? ?\+?[0-9.]{1,6} ?(?:ms|s|sec|secs|seconds|m/s|mps|km/h|mph)?\)"
    r"|[\[(][a-zA-Z]{1,12}_?[0-9]{0,2}, ?[a-zA-Z]{1,12}_?[0-9]{0,2}[\])])"
    r"|(?P<remark>\([^()\n]*[^\W\d][^()\n]*\))|(?P<open>[\[({])|(?P<close>[\])}])"
    rf"|(?P<number>{SIGN}{PLAIN})|(?P<word>[^\W\d]\w*)"
    r"|(?P<mark>[:=*_`>|#•·→$\\\"'+\-–@])|(?P<other>.)",
    re.DOTALL,
)
# Words that may stand before a row of a list without being prose.
_LABELS = frozenset(
    {"t", "time", "s", "sec", "secs", "second", "seconds", "step", "steps", "timestep"}
    | {"timesteps", "frame", "frames", "waypoint", "waypoints", "point", "points", "pair"}
    | {"pairs", "at", "after", "in", "future", "and", "then", "wp", "p", "ms"}
)
# In a heading's bracket: "(m, from 0.5 s to 2 s, every 0.5 s):".
_SECONDS = frozenset({"s", "sec", "secs", "second", "seconds"})
_OF_SPANS = frozenset(
    {"from", "to", "until", "till", "through", "up", "every", "each", "in", "of", "at", "over"}
    | {"the", "next", "t", "time", "times", "step", "steps", "apart", "horizon", "dt"}
    | {"m", "metre", "metres", "meter", "meters"}
)
_WORD = re.compile(r"[^\W\d_]+")
_BEHIND_HEADING = re.compile(r"[ \t*_]*:")
_NO_NAMES: frozenset[str] = frozenset()
NESTED = frozenset({"a nested list"})
_LABELLED = frozenset({"labels between rows"})
_REMARKS = frozenset({"remarks between rows"})
_names_of = attrgetter("names")
# More rows that aren't written, behind the last one.
_AND_SO_ON = re.compile(
    r"\s*[,;]?\s*(?:etc|and (?:etc|so (?:on|forth)))\b|\s*,\s*(?:\.{2,}|…)",
    re.IGNORECASE,
)
# More of a text than this between two rows is no label.
_LABEL_LENGTH = 80
# So much of a remark is looked at.
_REMARK_LENGTH = 400


@dataclass(frozen=True)
class NumberList:
    """One list of rows as it stands in a text.

    Args:
        rows: the numbers that are whole, also of a list with a fault.
        start: offset of its first row, or of the bracket that opens it.
        end: offset behind its last row.
        fault: why it is no list that can be read, empty for a good one.
        cut: whether the text ends before the list does.
        loose: indices of rows that no comma parts from the row before.
        unread_after: an item of the same numbering or bullet follows that holds no row.
        times_s: stated beside the rows, one each, s; empty where they aren't.
        times_have_unit: whether they state that they are seconds, or what they are converted from.
        names: per column, the names that its numbers were given.
        marks: other ways of writing that were tolerated, a few words each.
    """

    rows: tuple[tuple[float, ...], ...]
    start: int
    end: int
    fault: str = ""
    cut: bool = False
    loose: tuple[int, ...] = ()
    unread_after: bool = False
    times_s: tuple[float, ...] = ()
    times_have_unit: bool = False
    names: tuple[frozenset[str], ...] = ()
    units: frozenset[str] = frozenset()
    marks: frozenset[str] = frozenset()


@dataclass(slots=True)
class _Gap:
    """The text between two rows, before the first one, or behind the last one."""

    prose: bool = False
    comma: bool = False
    ellipsis: bool = False
    opened: int = -1  # offset of the first outer bracket that opens
    closed: bool = False
    label: bool = False
    unread: bool = False
    text: str = ""


def scan_lists(text: str) -> tuple[NumberList, ...]:
    """Find the lists of number rows in a text, in its order, in time linear in its length.

    Rows inside one outer bracket, of one numbering, or behind the same bullet at the same indent
    are one list, whatever remark stands between them.
    """
    lists: list[NumberList] = []
    rows: list[Row] = []
    gaps: list[_Gap] = []  # gaps[i] stands before rows[i]
    items: list[Item | None] = []
    closings = closing_brackets(text)
    end = 0
    brackets = list(find_rows(text))
    remarked = remarks(text, [row.start for row in brackets], [row.end for row in brackets])
    if remarked:
        pieces: list[str] = []
        at = 0
        for start, stop in ((brackets[i].start, brackets[i].end) for i in sorted(remarked)):
            pieces += text[at:start], " " * (stop - start)
            at = stop
        text = "".join(pieces) + text[at:]
    for row in (row for i, row in enumerate(brackets) if i not in remarked):
        gap = _gap(text, end, row.start)
        item = item_of(text, row.start)
        outer = gaps[0].opened if gaps else -1
        if rows and lone_element(gap.text):
            gap.unread, parted = True, False
        elif rows and row.start < closings.get(outer, -1) and gap.opened < 0 and not gap.closed:
            gap.unread = gap.prose and holds_element(gap.text)
            parted = False
        else:
            # "(12 m, 3 s) [3.2, 0.1]": another bracket without a comma is another thing.
            parted = gap.prose or gap.closed or gap.opened >= 0
            parted = parted or bool(rows and not gap.comma and rows[-1].brackets != row.brackets)
            if rows and next_object(gap.text):
                parted = False
            follows = continues(text, end, row.start, items[-1] if items else None, item)
            if follows is not None and gap.opened < 0 and not gap.closed:
                parted, gap.unread = False, follows
        if rows and parted:
            lists.extend(_finish(rows, gaps, gap, items=items))
            rows, gaps, items = [], [], []
        if not rows and _is_stated_span(text, row):
            end = row.end
            continue
        if not rows and gap.prose:
            gap = _gap(text, max(end, row.start - _LABEL_LENGTH), row.start, from_the_right=True)
        rows.append(row)
        gaps.append(gap)
        items.append(item)
        end = row.end
    lists.extend(_ending(text, rows, gaps, items, end))
    return tuple(lists)


def _finish(
    rows: list[Row], gaps: list[_Gap], after: _Gap, items: list[Item | None], cut: bool = False
) -> list[NumberList]:
    good = [row for row in rows if row.numbers]
    # Digits in round brackets are prose as a rule: "(12 m away), (15 m away)".
    if not good and (len(rows) < 2 or rows[0].brackets != "[]"):
        return []
    fault = ""
    widths = {len(row.numbers) for row in rows}
    if len(widths) > 1:
        bad = next(i for i, row in enumerate(rows) if len(row.numbers) != len(rows[0].numbers))
        fault = f"row {bad + 1} isn't like the others"
    if not good:
        fault = "its rows aren't numbers"
    lone = lone_at_end(gaps[0].text, after.text) and gaps[0].opened >= 0
    if lone or any(gap.unread for gap in gaps[1:]) or lacks_first(gaps[0].text, items):
        fault = UNREAD
    elided = after.ellipsis and not after.prose
    if elided or any(gap.ellipsis for gap in gaps[1:]) or _AND_SO_ON.match(after.text):
        fault = ELIDED
    if cut and not fault:
        fault = CUT
    marks = _joined(tuple({row.marks for row in rows}))
    if gaps[0].opened >= 0:
        marks |= NESTED
    if any(gap.label for gap in gaps[1:]):
        marks |= _LABELLED
    if any(gap.prose for gap in gaps[1:]):
        marks |= _REMARKS
    times_s, have_unit = stated_times([gap.text for gap in (*gaps, after)])
    return [
        NumberList(
            rows=tuple(row.numbers for row in good),
            start=gaps[0].opened if gaps[0].opened >= 0 else rows[0].start,
            end=rows[-1].end,
            fault=fault,
            cut=cut,
            loose=tuple(
                i for i, gap in enumerate(gaps) if i and not gap.comma and not _marked(items[i])
            ),
            unread_after=another_item(after.text, items[-1]),
            times_s=() if fault else times_s,
            times_have_unit=have_unit,
            names=_names(good, max(widths)),
            units=_joined(tuple({row.units for row in rows})),
            marks=marks,
        )
    ]


def _marked(item: Item | None) -> bool:
    return item is not None and item.bullet != BARE_LINE


@lru_cache(maxsize=256)
def _joined(words: tuple[tuple[str, ...], ...]) -> frozenset[str]:
    # A hostile text has a list per row; most of them have the same words.
    return frozenset(word for some in words for word in some)


def _names(rows: list[Row], width: int) -> tuple[frozenset[str], ...]:
    if not any(map(_names_of, rows)):
        return (_NO_NAMES,) * width
    return tuple(
        frozenset(row.names[i] for row in rows if i < len(row.names) and row.names[i])
        for i in range(width)
    )


def _ending(
    text: str, rows: list[Row], gaps: list[_Gap], items: list[Item | None], end: int
) -> list[NumberList]:
    """Return the last list, and tell whether the text ends before it does."""
    last = max(text.rfind(bracket, end) for bracket in "[](){}")
    opener = last if last >= 0 and text[last] in "[({" else len(text)
    row_begun = opener < len(text) and may_begin_row(text[opener + 1 :])
    if not rows:
        if not row_begun:
            return []
        return [NumberList((), opener, len(text), CUT, cut=True)]
    gap = _gap(text, end, opener if row_begun else len(text))
    never_closed = gaps[0].opened >= 0 and not gap.closed
    cut = not gap.prose and (row_begun or (gap.comma and not gap.closed) or never_closed)
    lists = _finish(rows, gaps, gap, items, cut)
    if row_begun and (gap.prose or not lists):
        lists.append(NumberList((), opener, len(text), CUT, cut=True))
    return lists


def _is_stated_span(text: str, row: Row) -> bool:
    """Tell whether a bracket in a heading says over which times a list goes."""
    if row.numbers or row.brackets != "()" or _BEHIND_HEADING.match(text, row.end) is None:
        return False
    line = text.rfind("\n", max(0, row.start - _LABEL_LENGTH), row.start) + 1
    if row.end - row.start > _LABEL_LENGTH or _WORD.search(text, line, row.start) is None:
        return False
    words = frozenset(_WORD.findall(text[row.start : row.end].lower()))
    return bool(words & _SECONDS) and words <= _SECONDS | _OF_SPANS


def _is_label(word: str) -> bool:
    """Tell whether a word may stand before a row without being prose, also with a number."""
    return word.lower().rstrip("0123456789").rstrip("_") in _LABELS


def _gap(text: str, start: int, end: int, from_the_right: bool = False) -> _Gap:
    between = text[start:end]
    gap = _Gap(text=between if len(between) <= _REMARK_LENGTH else between[:_REMARK_LENGTH])
    if between.strip() == ",":
        gap.comma = True
        return gap
    if end - start > _LABEL_LENGTH:
        gap.prose = True
        return gap
    tokens = list(_BETWEEN.finditer(between))
    for token in reversed(tokens) if from_the_right else tokens:
        kind = token.lastgroup
        if kind in ("other", "remark") or (kind == "word" and not _is_label(token.group())):
            gap.prose = True
            if from_the_right:
                break
        elif kind == "open":
            gap.opened = start + token.start()
        elif kind == "close":
            gap.closed = True
        elif kind == "comma":
            gap.comma = True
        elif kind == "ellipsis":
            gap.ellipsis = True
        elif kind in ("word", "number", "group"):
            gap.label = True
    return gap
