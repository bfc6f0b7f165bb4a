"""Lists of number rows in prose, ``[3.2, -0.2], [3.1, -0.1]``, as models write them.

A row is a bracket without a bracket in it that holds at least two numbers; rows with nothing but
separators and short labels between them are a list. Nothing is guessed: a row that is no row of
numbers, an ellipsis and an end of the text before the list's end are faults of the list.

Every character is looked at a bounded number of times, whatever the text: no pattern here has a
repetition in a repetition, and a bracket's inside ends at the next bracket.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter

from ssp_vla_bridge.core.adapters.rows import PLAIN, SIGN, Row, find_rows, may_begin_row

CUT = "it is cut off by the end of the text"
ELIDED = "an ellipsis stands for rows"

_BETWEEN = re.compile(
    r"(?P<space>\s+)|(?P<comma>[,;])|(?P<ellipsis>[.]{2,}|…|⋯)"
    r"|(?P<group>\([a-zA-Z/ ]{0,12}\)|[\[(][0-9. ]{1,8}s?[\])]"
    r"|[\[(][a-zA-Z]{1,12}_?[0-9]{0,2}, ?[a-zA-Z]{1,12}_?[0-9]{0,2}[\])])"
    r"|(?P<open>[\[({])|(?P<close>[\])}])"
    rf"|(?P<number>{SIGN}{PLAIN})|(?P<word>[^\W\d]\w*)"
    r"|(?P<mark>[:=*_`>|#•·→$\\\"'+\-–])|(?P<other>.)",
    re.DOTALL,
)
# Words that may stand before a row of a list without being prose.
_LABELS = frozenset(
    {"t", "time", "s", "sec", "secs", "second", "seconds", "step", "steps", "timestep"}
    | {"timesteps", "frame", "frames", "waypoint", "waypoints", "point", "points", "pair"}
    | {"pairs", "at", "future", "and", "then", "wp", "p"}
)
_NO_NAMES: frozenset[str] = frozenset()
NESTED = frozenset({"a nested list"})
_LABELLED = frozenset({"labels between rows"})
_names_of = attrgetter("names")
# More of a text than this between two rows is no label.
_LABEL_LENGTH = 80


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
        names: per column, the names that its numbers were given.
        units: written behind numbers.
        marks: other ways of writing that were tolerated, a few words each.
    """

    rows: tuple[tuple[float, ...], ...]
    start: int
    end: int
    fault: str = ""
    cut: bool = False
    loose: tuple[int, ...] = ()
    names: tuple[frozenset[str], ...] = ()
    units: frozenset[str] = frozenset()
    marks: frozenset[str] = frozenset()


@dataclass(slots=True)
class _Gap:
    """What stands between two rows, before the first one, or behind the last one."""

    prose: bool = False
    comma: bool = False
    ellipsis: bool = False
    opened: int = -1  # offset of the first outer bracket that opens
    closed: bool = False
    label: bool = False


def scan_lists(text: str) -> tuple[NumberList, ...]:
    """The lists of number rows in a text, in its order; takes time linear in its length.

    Args:
        text: anything.
    """
    lists: list[NumberList] = []
    rows: list[Row] = []
    gaps: list[_Gap] = []  # gaps[i] stands before rows[i]
    end = 0
    for row in find_rows(text):
        gap = _gap(text, end, row.start)
        parted = gap.prose or gap.closed or gap.opened >= 0
        # "(12 m, 3 s) [3.2, 0.1]": another bracket without a comma is another thing.
        parted = parted or bool(rows and not gap.comma and rows[-1].brackets != row.brackets)
        if rows and parted:
            lists.extend(_finish(rows, gaps, gap))
            rows, gaps = [], []
        if not rows and gap.prose:
            gap = _gap(text, max(end, row.start - _LABEL_LENGTH), row.start, from_the_right=True)
        rows.append(row)
        gaps.append(gap)
        end = row.end
    lists.extend(_ending(text, rows, gaps, end))
    return tuple(lists)


def _finish(rows: list[Row], gaps: list[_Gap], after: _Gap, cut: bool = False) -> list[NumberList]:
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
    if any(gap.ellipsis for gap in gaps[1:]) or (after.ellipsis and not after.prose):
        fault = ELIDED
    if cut and not fault:
        fault = CUT
    marks = _joined(tuple({row.marks for row in rows}))
    if gaps[0].opened >= 0:
        marks |= NESTED
    if any(gap.label for gap in gaps[1:]):
        marks |= _LABELLED
    return [
        NumberList(
            rows=tuple(row.numbers for row in good),
            start=gaps[0].opened if gaps[0].opened >= 0 else rows[0].start,
            end=rows[-1].end,
            fault=fault,
            cut=cut,
            loose=tuple(i for i, gap in enumerate(gaps) if i and not gap.comma),
            names=_names(good, max(widths)),
            units=_joined(tuple({row.units for row in rows})),
            marks=marks,
        )
    ]


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


def _ending(text: str, rows: list[Row], gaps: list[_Gap], end: int) -> list[NumberList]:
    """The last list, and whether the text ends before it does."""
    last = max(text.rfind(bracket, end) for bracket in "[](){}")
    opener = last if last >= 0 and text[last] in "[({" else len(text)
    row_begun = opener < len(text) and may_begin_row(text[opener + 1 :])
    if not rows:
        if not row_begun:
            return []
        return [NumberList((), opener, len(text), CUT, cut=True)]
    gap = _gap(text, end, opener if row_begun else len(text))
    never_closed = gaps[0].opened >= 0 and not gap.closed
    cut = not gap.prose and (row_begun or gap.comma or never_closed)
    lists = _finish(rows, gaps, gap, cut)
    if row_begun and (gap.prose or not lists):
        lists.append(NumberList((), opener, len(text), CUT, cut=True))
    return lists


def _gap(text: str, start: int, end: int, from_the_right: bool = False) -> _Gap:
    gap = _Gap()
    between = text[start:end]
    if between.strip() == ",":
        gap.comma = True
        return gap
    if end - start > _LABEL_LENGTH:
        gap.prose = True
        return gap
    tokens = list(_BETWEEN.finditer(between))
    for token in reversed(tokens) if from_the_right else tokens:
        kind = token.lastgroup
        if kind == "other" or (kind == "word" and token.group().lower() not in _LABELS):
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
