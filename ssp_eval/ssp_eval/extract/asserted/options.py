"""Options: of alternatives of one slot only the chosen one counts (METHOD 5.5)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ssp_eval.extract.asserted.labels import NAME, Values, words

_ROMAN = ("i", "ii", "iii", "iv", "v", "vi", "vii", "viii")
_MARKS = r"(?:viii|vii|vi|iv|v|iii|ii|i|[A-Ha-h]|[0-9])"
_ITEM = re.compile(
    r"(?:(?<=\s)|(?<=^))\*{0,2}(?:(?:option|choice|action|candidate)\s+)?[(\[]?"
    rf"(?P<mark>{_MARKS})(?:\*\*)?(?P<close>[).:\]]|\s?=)(?:\*\*)?:?\s+(?=\S)",
    re.MULTILINE | re.IGNORECASE,
)
# "Plan A - brake; Plan B - keep": a dash closes the mark of one that is called an option.
_CALLED_ITEM = re.compile(
    rf"\b(?:option|choice|candidate|plan|strategy)\s+(?P<mark>{_MARKS})(?P<close>\s[-–—])\s+(?=\S)",
    re.IGNORECASE,
)
# Lines that begin with a letter beside signs, where one is picked: "A - brake", "| A | brake |".
_LINE_ITEM = re.compile(
    r"^[^A-Za-z0-9\n]{0,4}(?P<mark>[A-H])[ \t]{0,2}[^A-Za-z0-9\s][^A-Za-z0-9\n]{0,4}(?=\w)",
    re.MULTILINE,
)
# Marks that are drawn as one sign, and key by key: Ⓐ, 🅰, 🇦, ①, 1️⃣; each run in its order.
_DRAWN_RUNS = (
    *((first, "ABCDEFGH") for first in (0x24B6, 0x24D0, 0x249C, 0x1F110, 0x1F130, 0x1F150, 0x1F170,
                                        0x1F1E6)),
    *((first, "12345678") for first in (0x2460, 0x2474, 0x2488, 0x2776, 0x2780, 0x278A)),
)  # fmt: skip
_DRAWN = {first + i: mark for first, marks in _DRAWN_RUNS for i, mark in enumerate(marks)}
_DRAWN_MARK = re.compile(
    rf"(?P<sign>[{''.join(map(chr, _DRAWN))}]\ufe0f?|[0-9]\ufe0f?\u20e3)(?P<close>)"
    r"[ \t]*[).:\-–—]?[ \t]*(?=\S)"
)
# {"A": "brake", "B": "keep", "answer": "A"}
_KEYED_MARK = re.compile(
    r"(?<=[{,\n])\s*(?P<quote>[\"'])(?P<mark>[A-H0-9])(?P=quote)(?P<close>\s*:)\s*[\"'](?=\S)"
)
_PICK = re.compile(
    r"(?:\b(?:answer|choice|option|selection|selected|decision|chosen|choose|pick|select"
    r"|(?:go|going) (?:with|for)|best)\b"
    r"(?:\s+(?:is|would be|option|answer|number|action|plan))*[\"']?\s*(?:[:=]|→|[=-]>)?"
    r"\s*(?:is\s+)?(?:option\s+)?"
    r"|\\boxed\{(?:\\text\{)?|<answer>\s*|^(?=\W*\w\W*$)"
    r"|\b(?:therefore|thus|hence|so),?\s+(?:option\s+)?(?=\w[.)\s]*$)"
    r"|\b(?:action|output|prediction|command)\s*[:=]\s*(?=[(\[]?[0-9]\b)"
    r"|(?<!\w)(?=(?-i:[A-H])\)?\s+is\s+(?:the\s+)?(?:safest|best|correct|right|chosen)\b))"
    rf"[(\[\"'*{{]{{0,3}}(?P<mark>{_MARKS})\b(?![.]\d)(?P<rest>[)\]\"'*.]*)"
    # "choose a lower speed" picks no option A.
    r"(?:(?-i:(?<![a-hiv]))|(?=\W*$|[)\]\"'.,;:}<]))"
    r"(?P<more>(?-i:\s*(?:,|and\b|&|\+)\s*\(?[A-H0-9]\)?(?![\w.]\w?)(?=\W*(?:$|,|and\b)))*)",
    re.IGNORECASE | re.MULTILINE,
)
# A list that is called one of options: none of it is chosen there.
_CALLED_LIST = re.compile(
    r"\b(?:(?:possible|available|candidate|allowed)[ _](?:actions?|man(?:o?eu|eu)vers?|manoeuvres?)"
    r"|options|choices|alternatives|candidates|action[ _]space)[\"']?\s*[:=]\s*"
    r"\[[^\[\],]*,[^\[\]]*\]",
    re.IGNORECASE,
)
# Alternatives as the heading of the chosen one: "accelerate / brake: brake".
_SLASHES = re.compile(
    rf"^\W{{0,4}}(?P<list>{NAME}(?:\s*/\s*{NAME})+)\s*:(?=\s*\w)"
    rf"|[{{(\[](?P<set>{NAME}(?:\s*,\s*{NAME})+)[}})\]]\s*(?:=|:|→|[-=]>)(?=\s*\w)",
    re.MULTILINE,
)
_CALLED = re.compile(r"\b(?:options|choices|alternatives|candidates)\b\W*$", re.IGNORECASE)
_STEPS = re.compile(
    r"\b(?:then|next|first|finally|after|until|afterwards|step|now|once|later|i|we)\b",
    re.IGNORECASE,
)
_SENTENCE_END = re.compile(r"\n|[.!?](?=\s|$)")
_VALUE_END = re.compile(r"[\"']\s*[,}\n]|\n")
_MOST_WORDS = 6  # of an option that isn't called one
_BEGINNINGS = (("number", 0), ("number", 1), ("roman", 1), ("letter", 1))


class _Mark(NamedTuple):
    """The mark of an item: where it stands, its letter or number, and what closes it."""

    start: int
    end: int
    name: str
    close: str


@dataclass(frozen=True)
class _Option:
    mark: str
    start: int
    begin: int  # behind the mark
    end: int
    loose: bool  # options only where one of them is picked


def other_options(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the options that aren't chosen."""
    for start, end in _option_spans(text, values_of):
        yield start, " " * (end - start)


def _option_spans(text: str, values_of: Values) -> Iterator[tuple[int, int]]:
    for match in _CALLED_LIST.finditer(text) if "[" in text else ():
        yield match.span()
    for match in _SLASHES.finditer(text):
        group = "list" if match["list"] is not None else "set"
        names = re.split(r"[/,]", match[group])
        read = [tuple(values_of(words(name.strip())).items()) for name in names]
        if all(read) and len({one[0][0] for one in read}) == 1 and len(set(read)) == len(read):
            yield match.span() if group == "set" else match.span(group)
    plain = text.translate(_DRAWN)
    for options in _lists(text):
        behind = plain[options[-1].begin :]
        picks = list(_PICK.finditer(behind))
        marks = {one.mark.upper() for one in options}
        picked = next((_picked(m) for m in reversed(picks) if _picked(m) <= marks), frozenset())
        if not picked:  # the line before may choose, too
            line = plain[: options[0].start].rstrip().rpartition("\n")[2]
            before = _PICK.search(line)
            picked = _picked(before) if before and _picked(before) <= marks else picked
        if not picked and (options[0].loose or not _are_options(text, options, values_of)):
            continue
        called = _CALLED.search(text, max(0, options[0].start - 40), options[0].start)
        if picked and called:  # it would make a quotation of the chosen
            yield called.span()
        end = options[-1].end
        if picks:
            end = min(end, options[-1].begin + picks[0].start())
        for one in options:
            if one.mark.upper() in picked:
                yield one.start, one.begin
            else:
                yield one.start, min(one.end, end) if one is options[-1] else one.end


def _picked(match: re.Match[str]) -> frozenset[str]:
    """Collect the marks of the options that a line picks."""
    return frozenset({match["mark"].upper(), *re.findall(r"[A-H0-9]", match["more"])})


def _lists(text: str) -> Iterator[list[_Option]]:
    """Yield each run of marks A, B, … or 1, 2, …, with the text up to the next mark."""
    items = list(_ITEM.finditer(text))
    marks = [_Mark(m.start(), m.end(), m["mark"], m["close"]) for m in items]
    marks += [_Mark(m.start(), m.end(), m["mark"], "dash") for m in _CALLED_ITEM.finditer(text)]
    if not text.isascii():
        marks += [
            _Mark(m.start(), m.end(), m["sign"].translate(_DRAWN)[0], "drawn")
            for m in _DRAWN_MARK.finditer(text)
        ]
    mark_starts = {m.start("mark") for m in items}
    marks += [
        _Mark(m.start(), m.end(), m["mark"], "line")
        for m in _LINE_ITEM.finditer(text)
        if m.start("mark") not in mark_starts
    ]
    if "{" in text:
        marks += [_Mark(m.start(), m.end(), m["mark"], "key") for m in _KEYED_MARK.finditer(text)]
    run: list[_Mark] = []
    for mark in [*sorted(marks), None]:
        follows = mark is not None and bool(run) and _is_next(run[-1], mark)
        if run and not follows:
            if len(run) > 1:
                yield _options(text, run)
            run = []
        if mark is not None and (follows or _place(mark.name) in _BEGINNINGS):
            run.append(mark)


def _is_next(before: _Mark, mark: _Mark) -> bool:
    kind, place = _place(before.name)
    return _place(mark.name) == (kind, place + 1) and mark.close == before.close


def _place(mark: str) -> tuple[str, int]:
    """Kind of a mark, and its place in the order of that kind, from 1."""
    if mark.isdigit():
        return "number", int(mark)
    if mark.lower() in _ROMAN:
        return "roman", _ROMAN.index(mark.lower()) + 1
    return "letter", ord(mark.lower()) - ord("a") + 1


def _options(text: str, run: Sequence[_Mark]) -> list[_Option]:
    options = []
    for i, mark in enumerate(run):
        if i + 1 < len(run):
            end = run[i + 1].start
        else:
            ends = _VALUE_END if mark.close == "key" else _SENTENCE_END
            stop = ends.search(text, mark.end)
            end = len(text) if stop is None else stop.start()
        options.append(_Option(mark.name, mark.start, mark.end, end, mark.close == "line"))
    return options


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
