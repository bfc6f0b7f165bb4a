"""The text between a list's rows, and the statements beside them (METHOD 5.4b, *Whole*)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

_CLOSES = {"]": "[", ")": "(", "}": "{"}
# A line's numbering or bullet, and what may stand between it and the row.
_ITEM = re.compile(
    r"(?P<indent>[ \t]*)(?:\(?(?P<number>\d{1,3})(?:[.):]|[ \t]+[-–—])|(?P<bullet>[-*•–+·])"
    r"|(?:\*\*)?(?P<word>step|waypoint|point|wp|p|t|frame|pair|row)[ _#]*(?P<count>\d{1,3})"
    r"(?:\*\*)?[ \t]*[.):=\-–](?:\*\*)?)[ \t]+"
    r"(?P<label>[^\n]{0,60})",
    re.IGNORECASE,
)
BARE_LINE = "\n"  # in the place of a bullet, where the row itself begins the line
_REMARK = re.compile(r"[ \t,;]*(?:(?:#|//|[-–—←(]|<[-!]|\*|/\*)[^\n]*)?\n[ \t]*")
_LABEL = re.compile(r"[\w\s.:=+*`\"'@()\-–>→,/]{0,60}\Z")
_NUMBER_FIELD = (
    r"\s*[\"'](?:[\w ]{1,30}[\"']\s*:\s*-?\d*\.?\d+"
    r"|(?:t|time|timestamp)(?:_m?s)?[\"']\s*:\s*[\"'][^\"'\n]{1,12}[\"'])\s*"
)
_NEXT_OBJECT = re.compile(
    rf"\s*(?:,{_NUMBER_FIELD})*\}}\s*,\s*\{{(?:{_NUMBER_FIELD},)*\s*[\"'][\w ]{{1,30}}[\"']\s*:\s*"
)
_TIME_FIELD = re.compile(
    r"[\"'](?:t|time|timestamp|seconds|at|after)(?:_(?:from_start|offset))?(?:_(?P<unit>m?s))?[\"']\s*:\s*(?:[\"'](?:[tT]\s*=?\s*)?\+?)?"
    r"(?P<named>\d*\.?\d+)(?:\s*(?P<of>ms|s)\b)?"
)
_COMMENT = re.compile(r"(?:#|//|--|—|–|<!--)[^\n]*|/\*.*?\*/|\([^()]*\)", re.DOTALL)
_ELEMENTS = re.compile(r"[,;][^,;]*[^\W_][^,;]*[,;]")
# A bracket in a row's place that holds a single number, none, names or no digit at all:
# "[5, 0], [9], [x3, y3], [null, null]"; words in round brackets may be a remark.
_LONE = (
    r"(?:[\[(]\s*(?:[-+]?\d*\.?\d*|[^\W\d_]+_?\d+\s*,\s*[^\W\d_]+_?\d+)\s*[\])]"
    r"|\[[^\[\](){}\d]{1,40}\]|\([^\[\](){}\d\w]{1,40}\)"
    r"|\(\s*[^\W\d]+(?:/[^\W\d]+)?\s*,\s*[^\W\d]+(?:/[^\W\d]+)?\s*\))"
)
_LONE_BETWEEN = re.compile(rf"\s*,\s*{_LONE}\s*(?:,\s*{_LONE}\s*)*,\s*")
_LONE_FIRST = re.compile(rf"[\[(]\s*{_LONE}\s*(?:,\s*{_LONE}\s*)*,\s*\Z")
_LONE_LAST = re.compile(rf"\s*,\s*{_LONE}\s*(?:,\s*{_LONE}\s*)*,?\s*[\])]")
_PLAN = re.compile(r"\b(?:trajector(?:y|ies)|paths?|plans?)\b", re.IGNORECASE)
_MOST_IN_REMARK = 8  # brackets
_LETTER = re.compile(r"[^\W\d]")
# A remark behind a row on its own line: " - the car is at (20, 3)".
_REMARK_BEHIND = re.compile(r"[ \t]*(?:[-–—:;,#(]|//)[ \t]*[^\W\d][^\n]*")
_LONGEST_COMMENT = 200  # characters
_IN_COMMENT = re.compile(r"[ \t]*[,;]?[ \t]*(?:#|//)[^\n]*[^\W\d][^\n]*")
_TIME = (  # "t_1" is an index
    r"(?:\b(?:t|time)(?:\b\s*[_=:≈]?|_(?=\d*\.\d|\d+\s*m?s\b))\s*\+?\s*(?P<named>\d*\.?\d+)\s*(?P<unit>ms|s|secs?|seconds?)?\b"
    r"|\bsecond[ _](?P<second>\d+)\b"
    r"|(?<![\w.])\+?(?P<timed>\d*\.?\d+)\s*(?P<of>ms|s|secs?|seconds?)\b"
    r"|(?<![\w.])(?P<decimal>\d*\.\d+)(?=[\"'*]*\s*(?::|=|→|->)))"
)
_BEFORE = re.compile(_TIME + r"[^\w\n]*\Z", re.IGNORECASE)
# A time alone in round brackets at the end of a remark: "# braking (1.0 s)". Remarks hold other
# spans too, so that these are the rows' only where they are even and begin with a step or at 0.
_IN_REMARK = re.compile(r"[^\n()]{0,60}\([^\w\n()]*(?:at\s+)?" + _TIME + r"\s*\)", re.IGNORECASE)
_EVEN_S = 1e-6
_BEHIND = re.compile(r"[^\w\n]*(?:(?:at|after|in)\s+)?" + _TIME, re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Item:
    """A line's mark before its row.

    Args:
        number: None for a bullet.
        bullet: empty for a bare number; the word of one such as "Step 1:"; a line end where the
            row itself begins the line.
        label: what stands between the mark and the row.
    """

    indent: str
    number: int | None
    bullet: str
    label: str = field(default="", compare=False)


def closing_brackets(text: str) -> dict[int, int]:
    """Return offsets of closing brackets by those of their opening ones, each kind for itself."""
    closings: dict[int, int] = {}
    opened: dict[str, list[int]] = {"[": [], "(": [], "{": []}
    for match in re.finditer(r"[\[\](){}]", text):
        mark = match.group()
        if mark in opened:
            opened[mark].append(match.start())
        elif opened[_CLOSES[mark]]:
            closings[opened[_CLOSES[mark]].pop()] = match.start()
    return closings


def item_of(text: str, start: int) -> Item | None:
    """Return the numbering, bullet or line that begins with the row at an offset, or None."""
    line = text.rfind("\n", max(0, start - 80), start) + 1
    if line == 0 and start > 80:
        return None
    if not text[line:start].strip(" \t"):
        return Item(text[line:start], None, BARE_LINE)
    match = _ITEM.match(text, line, start)
    if match is None or _LABEL.match(text, match.start("label"), start) is None:
        return None
    return replace(_item(match), label=text[match.start("label") : start])


def _item(match: re.Match[str]) -> Item:
    number = match["number"] or match["count"]
    mark = match["bullet"] or (match["word"] or "").lower()
    return Item(match["indent"], int(number) if number else None, mark)


def continues(
    text: str, end: int, start: int, before: Item | None, item: Item | None
) -> bool | None:
    """Tell whether a row goes on with the numbering or bullet of the row before it.

    Args:
        text: the answer's.
        end: offset behind the row before.
        start: offset of the row.
        before: item of the row before, None: it has none.
        item: of this row, None: it has none.

    Returns:
        None where it doesn't; else whether an item without a row stands between the two.
    """
    if before is None or item is None:
        return None
    if (before.indent, before.bullet) != (item.indent, item.bullet):
        return None
    if _is_plan(item) != _is_plan(before) and _LETTER.search(item.label) is not None:
        return None
    if item.bullet == BARE_LINE:
        return False if _REMARK.fullmatch(text, end, start) is not None else None
    if before.number is not None and item.number is not None:
        return item.number > before.number + 1 if item.number > before.number else None
    if text.find("\n", end, start) < 0:
        return False
    unread = False
    for line in text[end : text.rfind("\n", end, start)].split("\n")[1:]:
        match = _ITEM.match(line)
        if match is None:
            indent = line[: len(line) - len(line.lstrip())]
            if line.strip() and len(indent) <= len(item.indent):
                return None
        elif replace(_item(match), number=None) == replace(item, number=None):
            unread = True
    return unread


def _is_plan(item: Item) -> bool:
    return _PLAN.search(item.label) is not None


def another_item(after: str, item: Item | None) -> bool:
    """Tell whether the next line goes on with a row's numbering or bullet, without a row."""
    if item is None:
        return False
    for line in after.split("\n")[1:]:
        match = _ITEM.match(line)
        if match is not None:
            after_it = _item(match)
            same = replace(after_it, number=None) == replace(item, number=None)
            number = after_it.number
            return same and (number is None or number == (item.number or 0) + 1)
        if line.strip() and not line.startswith((" ", "\t")):
            return False
    return False


def lacks_first(before: str, items: Sequence[Item | None]) -> bool:
    """Tell whether an item without a row stands before the first one of a numbered list.

    Args:
        before: the text before the first row.
        items: of the list's rows, in order; None: a row without one.
    """
    numbers = [item.number for item in items[:2] if item is not None and item.number]
    if len(numbers) < 2 or numbers[0] == 1 or numbers[1] != numbers[0] + 1:
        return False
    lines = [line for line in before.split("\n")[:-1] if line.strip()]
    match = _ITEM.match(lines[-1]) if lines else None
    return match is not None and _item(match).number == numbers[0] - 1


def next_object(between: str) -> bool:
    """Tell whether a row stands in the next object of a list: ``}, {"t": 1.0, "position": ``."""
    return _NEXT_OBJECT.fullmatch(between) is not None


def lone_element(between: str) -> bool:
    """Tell whether a bracket that is no row, as it holds one number or none, parts two rows."""
    return _LONE_BETWEEN.fullmatch(between) is not None


def lone_at_end(before: str, after: str) -> bool:
    """Tell whether such a bracket is the first or the last element of a list.

    Args:
        before: the text before its first row, at most from its outer bracket on.
        after: the text behind its last row.
    """
    return _LONE_FIRST.search(before) is not None or _LONE_LAST.match(after) is not None


def remarks(text: str, starts: Sequence[int], ends: Sequence[int]) -> frozenset[int]:
    """Find the brackets that stand in remarks between the rows of one numbering or bullet.

    A remark stands behind a row on its line, or on lines that are indented deeper than the row's; a
    comment of code stands behind any row.

    Args:
        text: the answer's.
        starts: offsets of the brackets, rising.
        ends: offsets behind them.

    Returns:
        their indices.
    """
    indices: set[int] = set()
    items = [
        None if i and text.find("\n", ends[i - 1], start) < 0 else item_of(text, start)
        for i, start in enumerate(starts)
    ]
    last: dict[tuple[str, str], int] = {}
    for i, item in enumerate(items):
        if item is None or item.bullet == BARE_LINE:
            continue
        key = item.indent, item.bullet
        before = items[last[key]] if key in last else None
        if before is not None and item.number == (before.number and before.number + 1):
            inner = range(last[key] + 1, i)[: _MOST_IN_REMARK + 1]
            gaps = [text[ends[k] : starts[k + 1]] for k in inner[:-1]]
            is_list = any(_LETTER.search(between) is None for between in gaps)
            if (
                len(inner) <= _MOST_IN_REMARK
                and not is_list
                and all(_in_remark(text, ends[last[key]], starts[k], item.indent) for k in inner)
            ):
                indices.update(inner)
        last[key] = i
    row_end = 0
    for i, start in enumerate(starts):  # in the comment behind a row of code
        near = i > 0 and start - row_end <= _LONGEST_COMMENT
        holds_words = near and _LETTER.search(text, start, ends[i]) is not None
        if holds_words and _IN_COMMENT.fullmatch(text, row_end, start) is not None:
            indices.add(i)
        else:
            row_end = ends[i]
    return frozenset(indices)


def _in_remark(text: str, end: int, start: int, indent: str) -> bool:
    line = text.rfind("\n", end, start)
    if line < 0:
        return _REMARK_BEHIND.fullmatch(text, end, start) is not None
    between = text[line + 1 : start]
    deeper = len(between) - len(between.lstrip(" \t")) > len(indent)
    return deeper and _LETTER.search(between) is not None


def holds_element(between: str) -> bool:
    """Tell whether an element that is no row stands between two rows, not just a remark."""
    return _ELEMENTS.search(_COMMENT.sub("", between)) is not None


def stated_times(gaps: Sequence[str]) -> tuple[tuple[float, ...], bool]:
    """Return the times beside the rows of a list, one for each row; empty: none are stated.

    Args:
        gaps: the text before the first row, between the rows, and behind the last one.

    Returns:
        Times, in s where their unit is stated, and whether it is.
    """
    before = [gap[-120:].rpartition("{")[2] for gap in gaps[:-1]]
    behind = [gap.partition("}")[0] for gap in gaps[1:] if "}" in gap]
    for beside in (before, behind):
        fields = [[*_TIME_FIELD.finditer(one)][-1:] for one in beside]
        if all(fields) and len(fields) == len(gaps) - 1:
            return _with_units([(one["named"], one["unit"] or one["of"]) for one, *_ in fields])
    for some, at in ((gaps[:-1], _BEFORE), (gaps[1:], _BEHIND)):
        matches = [at.search(gap[-60:]) if at is _BEFORE else at.match(gap) for gap in some]
        if all(matches):
            return _with_units([_time(match) for match in matches if match is not None])
    remarked = [match for gap in gaps[1:] if (match := _IN_REMARK.match(gap)) is not None]
    if len(remarked) == len(gaps) - 1 > 1:
        times, have_unit = _with_units([_time(match) for match in remarked])
        step_s = times[1] - times[0]
        even = all(abs(b - a - step_s) <= _EVEN_S for a, b in pairwise(times))
        if even and step_s > 0 and min(abs(times[0]), abs(times[0] - step_s)) <= _EVEN_S:
            return times, have_unit
    return (), False


def _time(match: re.Match[str]) -> tuple[str, str | None]:
    if match["second"]:
        return match["second"], "s"
    return match["named"] or match["timed"] or match["decimal"], match["unit"] or match["of"]


def _with_units(quantities: Sequence[tuple[str, str | None]]) -> tuple[tuple[float, ...], bool]:
    times = tuple(
        float(value) * (0.001 if unit and unit.lower() == "ms" else 1.0)
        for value, unit in quantities
    )
    return times, all(unit for _, unit in quantities)
