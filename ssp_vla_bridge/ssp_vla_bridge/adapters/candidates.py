"""Lists that an answer gives as options, of which only the chosen one is the own plan.

Options are lists under one label that differ by a number or letter ("Mode 1", "Plan B"), or that
stand in one list of candidates. One is chosen by a line that picks it, or by the clear maximum of
the shares that all of them state (METHOD 5.4b, *Own plan*, and 5.5).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_KIND = (
    r"(?:options?|modes?|candidates?|hypothes[ie]s|proposals?|samples?|alternatives?|plans?"
    r"|trajector(?:y|ies)|paths?|routes?)"
)
_NAME = r"(?:\d{1,2}|[a-h])"
_NAMED = re.compile(
    rf"\b(?P<kind>{_KIND})[ _]*[#:\-]?[ _]*(?P<name>{_NAME})(?![\w.]*\w)", re.IGNORECASE
)
# Words whose lists are options even where nothing tells them apart.
_CALLED = re.compile(
    r"\b(?:options?|modes?|candidates?|hypothes[ie]s|proposals?|samples?)\b|\bplan[ _][a-h]\b"
)
_SHARE = re.compile(
    r"\b(?:confidence|probability|prob|score|likelihood|weight|p)\b[\"']?\s*(?:=|:|of|is)?\s*[\"']?"
    r"(?P<value>\d*\.?\d+)\s*(?P<percent>%?)",
    re.IGNORECASE,
)
_CLEAR = 0.2  # as of shares in METHOD 5.5
_LOOKED_AT = 400
_CHOICE = r"(?:best|chosen|selected|choice|pick|final|decision|preferred|optimal|recommended)"
_PICKED = re.compile(
    rf"(?:\b(?:choos\w+|chose|select\w*|pick\w*|(?:go|going) (?:for|with)|prefer\w*|recommend\w*"
    rf"|tak(?:e|ing)|execut\w+|follow\w*|us(?:e|ing)|{_CHOICE})\b[^.\n\[\](){{}}]{{0,30}}?"
    rf"\b(?:{_KIND})[ _]*[#:]?[ _]*(?P<name>{_NAME})"
    rf"|\b{_CHOICE}\b[\w ]{{0,20}}[\"']?\s*(?:is|:|=)\s*[\"'(*]*(?P<bare>{_NAME}))"
    r"(?![\w.]*\w)",
    re.IGNORECASE,
)
_IS_PICKED = re.compile(
    rf"\b{_KIND}[ _]*[#:]?[ _]*(?P<name>{_NAME})\s*[\"']?\s*(?:is|was|:|,|-|–|—)?\s*\(?\s*"
    rf"(?:the |my |our )?{_CHOICE}\b",
    re.IGNORECASE,
)
_DENIED = re.compile(r"(?:\b(?:not|never|neither|no)\b|n['’]t\b)[^.,;\n]{0,20}\Z", re.IGNORECASE)


@dataclass(frozen=True)
class LabelledList:
    """A list in a text.

    Args:
        label: its label, in lower case.
        start: offset of its first row.
        end: offset behind its last row.
    """

    label: str
    start: int
    end: int


def find_options(text: str, lists: Sequence[LabelledList]) -> tuple[frozenset[int], int | None]:
    """Find the options among lists.

    Args:
        text: the answer's.
        lists: that may be the own plan, in the text's order.

    Returns:
        Indices of options that aren't chosen, and of the one that is, None: there is none.
    """
    groups: dict[str, list[int]] = {}
    for i, one in enumerate(lists):
        groups.setdefault(_base(one.label), []).append(i)
    for group in groups.values():
        if len(group) < 2:
            continue
        matches = [_NAMED.search(lists[i].label) for i in group]
        names = [match["name"].lower() for match in matches if match is not None]
        told_apart = len(set(names)) == len(group)
        shares = [_share(text, lists, i) for i in group]
        by_share = _clear_maximum([one for one in shares if one is not None])
        picked = _picked(text, lists, names) if told_apart else None
        called = all(_CALLED.search(lists[i].label) for i in group)
        # Two that nothing but their shares calls options are a plan and the one that replaces it.
        rated = None not in shares and (
            told_apart
            or called
            or all(_object(text, lists[i].start, lists[i].end)[0] >= 0 for i in group)
        )
        if not (picked or rated or (called and (told_apart or not names))):
            continue
        chosen_index = group[names.index(picked)] if picked else None
        if chosen_index is None and rated and by_share is not None:
            chosen_index = group[by_share]
        return frozenset(i for i in group if i != chosen_index), chosen_index
    return frozenset(), None


def _base(label: str) -> str:
    """Return a label without its number, shares and remarks in brackets."""
    plain = re.sub(r"\([^()]*\)", " ", _SHARE.sub(" ", label))
    words = re.findall(r"[^\W_]+", _NAMED.sub(lambda found: found["kind"], plain))
    return " ".join(dict.fromkeys(words))


def _share(text: str, lists: Sequence[LabelledList], i: int) -> float | None:
    """Return the share of 1 that an option states in its label, object or line."""
    one = lists[i]
    begin, stop = _object(text, one.start, one.end)
    if begin >= 0:
        statement = f"{text[begin : one.start]} {text[one.end : stop]}"
    else:
        limit = lists[i + 1].start if i + 1 < len(lists) else len(text)
        statement = f"{one.label} {text[one.end : limit].partition(chr(10))[0]}"
    match = _SHARE.search(statement)
    if match is None:
        return None
    value = float(match["value"]) / (100.0 if match["percent"] else 1.0)
    return value if value <= 1.0 else None


def _object(text: str, start: int, end: int) -> tuple[int, int]:
    """Return the offsets of the braces around a list, -1 for none near."""
    begin, depth = -1, 0
    for at in range(start - 1, max(-1, start - _LOOKED_AT), -1):
        depth += {"}": 1, "{": -1}.get(text[at], 0)
        if depth < 0:
            begin = at
            break
    stop = text.find("}", end, end + _LOOKED_AT)
    return (begin, stop) if begin >= 0 and stop >= 0 else (-1, -1)


def _clear_maximum(shares: Sequence[float]) -> int | None:
    first, second, *_ = [*sorted(shares, reverse=True), 0.0, 0.0]
    return shares.index(first) if shares and first - second >= _CLEAR - 1e-9 else None


def _picked(text: str, lists: Sequence[LabelledList], names: Sequence[str]) -> str | None:
    """Return the only name that a line picks."""
    picks: set[str] = set()
    text = text.replace("_", " ")  # "best_option": 1
    for pattern in (_PICKED, _IS_PICKED):
        for match in pattern.finditer(text):
            groups = match.groupdict()
            name = (groups["name"] or groups.get("bare") or "").lower()
            in_list = any(one.start <= match.start() < one.end for one in lists)
            denied = _DENIED.search(text, max(0, match.start() - 30), match.start())
            if name in names and not in_list and denied is None:
                picks.add(name)
    return picks.pop() if len(picks) == 1 else None
