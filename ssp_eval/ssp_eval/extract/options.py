"""Blanks what a text names without asserting it: denied fields, options that weren't chosen.

A label that is the *name* of a field is asserted or denied by its value; of several with shares the
clear maximum counts; of options only the chosen one (METHOD 5.5). What isn't asserted becomes
spaces, so that spans keep their places and the rules read the rest as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

_YES = frozenset({"true", "yes", "✓", "✔", "☑"})
_REFUSED = ("rejected", "cancelled", "canceled", "denied", "aborted", "refused", "discarded")
_NO = frozenset({"false", "no", "✗", "✘", "☒", "n", *_REFUSED})
_SIDES = {"left": ("lat_action",), "right": ("lat_action",)}  # which alone the rules don't read
_CLEAR = 0.2  # by which the largest share leads
_FIELD = re.compile(
    r"(?P<key>[\"']?(?:[^\W\d_]|[^\W\d][\w /-]{0,28}\w)[\"']?)\s*[:=]\s*"
    r"(?P<value>[\"']?(?:true|false|yes|no|"
    + "|".join(_REFUSED)
    + r"|[✓✔☑✗✘☒]|\d+(?:\.\d+)?\s*%?)[\"']?)"
    r"(?=\s*(?:[,;}\]\n|(]|\.(?:\s|$)|$))",
    re.IGNORECASE,
)
_ITEM = re.compile(
    r"(?:(?<=\s)|(?<=^))(?P<open>\(?)(?P<mark>[A-Ha-h]|[1-9])(?P<close>[).:])\s+(?=\S)",
    re.MULTILINE,
)
_PICK = re.compile(
    r"\b(?:answer|choice|option|selection|selected|decision|chosen|choose|pick|select|go with"
    r"|best)\b"
    r"(?:\s+(?:is|would be|option|answer|number))*\s*[:=]?\s*(?:is\s+)?[(\[\"'*]{0,3}"
    r"(?P<mark>[A-Ha-h]|[1-9])\b(?![.]\d)(?P<rest>[)\]\"'*.]*)",
    re.IGNORECASE,
)
_CALLED = re.compile(r"\b(?:options|choices|alternatives|candidates)\b\W*$", re.IGNORECASE)
_STEPS = re.compile(
    r"\b(?:then|next|first|finally|after|until|afterwards|step|now|once|later|i|we)\b",
    re.IGNORECASE,
)
_SENTENCE_END = re.compile(r"\n|[.!?](?=\s|$)")
_MOST_WORDS = 6  # of an option that isn't called one

Values = Callable[[str], dict[str, object]]


@dataclass(frozen=True)
class _Field:
    key: str
    value: str
    start: int
    end: int
    slots: frozenset[str]


def asserted(text: str, values_of: Values) -> str:
    """Blank the parts of a text that it names without asserting them; the length stays.

    Args:
        values_of: what the rules read in a piece of text: values by slot.
    """
    blanks = [*_denied_fields(text, values_of), *_other_options(text, values_of)]
    for start, end in blanks:
        text = text[:start] + " " * (end - start) + text[end:]
    return text


def _denied_fields(text: str, values_of: Values) -> Iterator[tuple[int, int]]:
    """The fields whose name isn't asserted, and the values of those that are."""
    if ":" not in text and "=" not in text:
        return
    fields = []
    for match in _FIELD.finditer(text):
        key = match["key"].strip("\"'").replace("_", " ")
        slots = frozenset(_SIDES.get(key.lower()) or values_of(key.lower()))
        if slots:
            value = match["value"].strip("\"' ").lower()
            fields.append(_Field(key, value, match.start(), match.end(), slots))
    for group in _groups(text, fields):
        for one, holds in zip(group, _holding(group), strict=True):
            if holds is False:
                yield one.start, one.end


def _groups(text: str, fields: Sequence[_Field]) -> Iterator[list[_Field]]:
    """Fields side by side, of the same slots."""
    group: list[_Field] = []
    for one in fields:
        between = text[group[-1].end : one.start] if group else ""
        if group and (len(between) > 8 or re.search(r"[\w}\]]", between)):
            yield group
            group = []
        group.append(one)
    if group:
        yield group


def _holding(group: Sequence[_Field]) -> list[bool | None]:
    """Tell whether each field of a group asserts its name; None where its value can't say."""
    found: list[bool | None] = []
    for one in group:
        if one.value in _YES | _NO:
            found.append(one.value in _YES)
        elif "objects" in one.slots:
            found.append(float(one.value.rstrip("% ")) > 0)
        else:
            found.append(_leads(one, group))
    return found


def _leads(one: _Field, group: Sequence[_Field]) -> bool | None:
    """Tell whether a share is the clear maximum of those of its slot."""
    same = [other for other in group if other.slots & one.slots and other.value[:1].isdigit()]
    shares = [(float(other.value.rstrip("% ")), "%" in other.value) for other in same]
    whole = 100.0 if any(p for _, p in shares) or max(v for v, _ in shares) > 1.0 else 1.0
    own = float(one.value.rstrip("% ")) / whole
    if len(same) == 1:
        return own >= 0.5 + _CLEAR / 2 if whole == 100.0 or one.value not in "01" else own == 1.0
    others = [v / whole for other, (v, _) in zip(same, shares, strict=True) if other is not one]
    return own - max(others) >= _CLEAR - 1e-9


@dataclass(frozen=True)
class _Option:
    mark: str
    start: int
    begin: int  # behind the mark
    end: int


def _other_options(text: str, values_of: Values) -> Iterator[tuple[int, int]]:
    for options in _lists(text):
        behind = text[options[-1].begin :]
        picks = list(_PICK.finditer(behind))
        marks = {one.mark.upper() for one in options}
        picked = next(
            (m["mark"].upper() for m in reversed(picks) if m["mark"].upper() in marks), ""
        )
        if not picked and not _are_options(text, options, values_of):
            continue
        end = options[-1].end
        if picks:
            end = min(end, options[-1].begin + picks[0].start())
        for one in options:
            if one.mark.upper() != picked:
                yield one.start, min(one.end, end) if one is options[-1] else one.end


def _lists(text: str) -> Iterator[list[_Option]]:
    """Runs of marks A, B, … or 1, 2, …, each with the text up to the next one."""
    run: list[re.Match[str]] = []
    matches = list(_ITEM.finditer(text))
    for match in [*matches, None]:
        follows = (
            match is not None
            and bool(run)
            and ord(match["mark"]) == ord(run[-1]["mark"]) + 1
            and match["close"] == run[-1]["close"]
        )
        if run and not follows:
            if len(run) > 1:
                yield _options(text, run)
            run = []
        if match is not None and (follows or match["mark"] in "Aa1"):
            run.append(match)


def _options(text: str, run: Sequence[re.Match[str]]) -> list[_Option]:
    found = []
    for i, match in enumerate(run):
        if i + 1 < len(run):
            end = run[i + 1].start()
        else:
            stop = _SENTENCE_END.search(text, match.end())
            end = len(text) if stop is None else stop.start()
        found.append(_Option(match["mark"], match.start(), match.end(), end))
    return found


def _are_options(text: str, options: Sequence[_Option], values_of: Values) -> bool:
    """Tell whether items are alternatives: called so, or short and contradicting each other."""
    if _CALLED.search(text[max(0, options[0].start - 40) : options[0].start]):
        return True
    items = [text[one.begin : one.end].strip() for one in options]
    if any(len(item.split()) > _MOST_WORDS or _STEPS.search(item) for item in items):
        return False
    read = [
        {slot: value for slot, value in values_of(item).items() if slot.endswith("_action")}
        for item in items
    ]
    slots = {slot for one in read for slot in one}
    contradict = any(len({one[slot] for one in read if slot in one}) > 1 for slot in slots)
    # Numbers count steps as a rule: they are alternatives where all answer one question, and
    # each in its own way.
    if options[0].mark.isdigit():
        values = [tuple(one.items()) for one in read]
        return len(slots) == 1 and all(values) and len(set(values)) == len(values)
    return contradict
