"""Lists that a remark tears into pieces (METHOD 5.4b, *Whole*).

Rows behind the same bullet at the same indent are one list, whatever remark stands between them.
Other pieces that words tear are no list that can be read, where together they have the rows asked
for: a piece is never read for the whole.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from ssp_vla_bridge.adapters.list_items import BARE_LINE, item_of
from ssp_vla_bridge.adapters.number_lists import CUT, NESTED, UNREAD, NumberList
from ssp_vla_bridge.adapters.plan_label import PLAN_WORDS

# Words between two pieces of a list: no new line, sentence or label.
_TEARS = re.compile(r"\s*,(?:[^\n.:;!?=\[\](){}]|[.](?=\w))*")
_LINKS = re.compile(
    r"\s*,?\s*(?:and|then|followed by|afterwards?|after that|next|finally)"
    r"(?:,? (?:then|finally|next))?,?\s*",
    re.IGNORECASE,
)
# A line between bullets that begins something else: a label, a heading, a plan or a correction.
_BEGINS_ANEW = re.compile(
    rf":[*_\s]*\Z|\A\s*#|\b{PLAN_WORDS}\b|\b(?:too|instead|alternativ\w+|correct\w*|rather|wait|option"
    r"|or|no|wrong|another|other|second|revised?|position\w*|objects?|detect\w+)\b|[\[{\"=]",
    re.IGNORECASE,
)
_WORD = re.compile(r"[^\W\d_]+")
# What a bullet may hold before its row.
_OF_ROW = frozenset(
    {"t", "time", "at", "after", "s", "sec", "secs", "second", "seconds", "step", "point"}
    | {"waypoint", "ms"}
)
_LONGEST = 400  # characters of a remark
_REMARKS = frozenset({"remarks between rows"})


def whole_lists(text: str, lists: Sequence[NumberList], count: int) -> list[NumberList]:
    """Join the pieces of lists, or mark them where they aren't known to be one list.

    Args:
        text: the answer's.
        lists: in the text's order.
        count: of the rows asked for.
    """
    joined_lists: list[NumberList] = []
    for one in lists:
        joined = _joined(joined_lists[-1], one, text, count) if joined_lists else None
        if joined is None:
            joined_lists.append(one)
        else:
            joined_lists[-1] = joined
    return _marked(text, joined_lists, count)


def _joined(one: NumberList, two: NumberList, text: str, count: int) -> NumberList | None:
    """Return two pieces behind the same bullet as one list, None where they aren't one."""
    if one.fault or two.fault not in ("", CUT) or not (one.rows and two.rows):
        return None
    rows = one.rows + two.rows
    if len(rows) > count + int(not any(one.rows[0])) or len({len(row) for row in rows}) > 1:
        return None
    if not _same_bullet(text, one, two) or bool(one.times_s) != bool(two.times_s):
        return None
    if len(one.names) == len(two.names):
        names = tuple(a | b for a, b in zip(one.names, two.names, strict=True))
    else:
        return None
    loose = tuple(len(one.rows) + i for i in two.loose)
    return replace(
        two,
        rows=rows,
        start=one.start,
        loose=(*one.loose, *loose),
        times_s=one.times_s + two.times_s,
        times_have_unit=one.times_have_unit and two.times_have_unit,
        names=names,
        units=one.units | two.units,
        marks=one.marks | two.marks | _REMARKS,
    )


def _same_bullet(text: str, one: NumberList, two: NumberList, bare: bool = False) -> bool:
    """Tell whether nothing but a remark stands between pieces of one bullet, or of bare lines."""
    if two.start - one.end > _LONGEST or not NESTED.isdisjoint(one.marks | two.marks):
        return False
    before, after = item_of(text, one.start), item_of(text, two.start)
    if before is None or after is None or (before.bullet == BARE_LINE) != bare:
        return False
    if (before.indent, before.bullet) != (after.indent, after.bullet):
        return False
    if before.number is not None or after.number is not None:
        return False
    if not _OF_ROW.issuperset(_WORD.findall(after.label.lower())):
        return False
    lines = text[one.end : text.rfind("\n", one.end, two.start) + 1].split("\n")[1:]
    return not any(_BEGINS_ANEW.search(line) for line in lines if line.strip())


def _marked(text: str, lists: Sequence[NumberList], count: int) -> list[NumberList]:
    """Mark lists that words tear, where all of them have the rows asked for."""
    marked_lists: list[NumberList] = []
    run: list[NumberList] = []
    for i, one in enumerate(lists):
        run.append(one)
        following = lists[i + 1] if i + 1 < len(lists) else None
        if following is not None and _is_torn(text, one, following):
            continue
        if len(run) > 1 and sum(len(part.rows) for part in run) == count:
            run = [replace(part, fault=part.fault or UNREAD) for part in run]
        marked_lists += run
        run = []
    return marked_lists


def _is_torn(text: str, one: NumberList, two: NumberList) -> bool:
    place = one.end, two.start
    if _TEARS.fullmatch(text, *place) is not None:
        return True
    closed = re.compile(r"\s*[\])}]?").match(text, one.end)
    end = closed.end() if closed is not None else one.end
    return _LINKS.fullmatch(text, end, two.start) is not None or _same_bullet(text, one, two, True)
