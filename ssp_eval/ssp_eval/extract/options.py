"""Blanks what a text names without asserting it: denied fields, options that weren't chosen.

A label that is the *name* of a field is asserted or denied by its value; of several with shares the
clear maximum counts; of options only the chosen one (METHOD 5.5). What isn't asserted becomes
spaces, so that spans keep their places and the rules read the rest as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from ssp_eval.extract.tokens import HUMP

_CHOSEN = ("accepted", "chosen", "selected")
_FOUND, _NOT_FOUND = ("present", "positive"), ("absent", "negative")
_YES = frozenset({"true", "yes", "✓", "✔", "☑", "✅", "on", "t", "y", *_CHOSEN, *_FOUND})
_REFUSED = ("rejected", "cancelled", "canceled", "denied", "aborted", "refused", "discarded")
_NO = frozenset(
    {"false", "no", "✗", "✘", "☒", "❌", "n", "off", "f", "none", "null", *_REFUSED, *_NOT_FOUND}
)
# Words that deny a manoeuvre; of nobody's presence the rules read them.
_NO_ACTION = frozenset({"none", "null", "off"})
_FEW_WORDS = 3
_ACTIONS = frozenset({"lon_action", "lat_action"})
_SIDES = {"left": ("lat_action",), "right": ("lat_action",)}  # which alone the rules don't read
_OF_NUMBER = frozenset("-−0123456789")  # its first sign
_CLEAR = 0.2  # by which the largest share leads
_NAME = r"(?:[^\W\d_]|[^\W\d][\w /-]{0,28}\w)"
_SHARE = r"[-−]?\d+(?:\.\d+)?\s*%?"
_SIGN = "[✓✔☑✅✗✘☒❌]"
_WORD_VALUE = (
    r"(?:(?:true|false|yes|no|on|off|none|null|present|absent|positive|negative|"
    + "|".join((*_CHOSEN, *_REFUSED))
    + rf")\b|{_SIGN}"
    r"|(?-i:[TFYN])\b)"
)
# Behind a sign, or two blanks, may stand the next field.
_FIELD_END = (
    r"(?=\s*(?:[,;}\]\n|(]|\.(?:\s|$)|$)|\s{2}|(?<=[✓✔☑✅✗✘☒❌])\s"
    r"|(?<=[\"'])\s*/?>|(?<=[\"'])\s+[\w-]{2,30}=[\"'])"  # of a tag's attribute
)
# {"pedestrian": {"present": false}}
_NESTED = r"(?:\{\s*[\"'](?:present|detected|visible|exists|active|selected|needed)[\"']\s*:\s*)"
_QUOTES = r"[\"'*_]{0,2}"
_FIELD = re.compile(
    rf"(?P<key>{_QUOTES}{_NAME}{_QUOTES})(?:\s*[:=]{_QUOTES}\s*{_NESTED}?"
    rf"(?P<value>{_QUOTES}(?:{_WORD_VALUE}|{_SHARE}){_QUOTES})"
    rf"|(?:\s*(?:→|[=-]>)|[ \t]+[-–—](?=\s))\s*(?P<word>{_QUOTES}{_WORD_VALUE}{_QUOTES})"
    r"|\?[ \t]+(?P<reply>yes|no))"
    rf"{_FIELD_END}"
    # <brake>false</brake>, | brake | no |, P(brake) = 0.8
    rf"|<(?P<tag>\w{{2,30}})>\s*(?P<in_tag>{_WORD_VALUE}|{_SHARE})\s*</(?P=tag)>"
    rf"|(?<=\|)[ \t*]*(?P<cell>{_NAME})[ \t*]*\|"
    rf"[ \t*]*(?P<in_cell>{_WORD_VALUE}|{_SHARE})[ \t*]*(?=\|)"
    rf"|\bp(?:rob(?:ability)?)?\((?P<of>{_NAME})\)\s*[:=]\s*(?P<share>{_SHARE}){_FIELD_END}"
    # {"action": "brake", "score": 0.8}
    r"|\{\s*[\"'](?:action|label|name|option|class|man(?:o?eu|eu)ver|manoeuvre|plan)[\"']\s*:\s*"
    rf"[\"'](?P<label>{_NAME})[\"']\s*,\s*[\"'](?:score|prob\w*|confidence|p|weight|likelihood)[\"']"
    rf"\s*:\s*(?P<score>{_SHARE})\s*\}}"
    # brake (80 %), 80 % brake
    rf"|(?P<before>{_NAME})\s*[(\[](?P<beside>{_SHARE}|{_WORD_VALUE})[)\]]"
    rf"|(?P<first>\d+(?:\.\d+)?\s*%)\s+(?:for\s+|to\s+)?(?P<behind>{_NAME}){_FIELD_END}"
    # brake 80 %, keep 20 %
    rf"|(?P<ahead>{_NAME})\s+(?P<follows>\d+(?:\.\d+)?\s*%){_FIELD_END}"
    # brake ✗, keep ✓
    rf"|(?P<ticked>{_NAME})[ \t]+(?P<sign>{_SIGN}){_FIELD_END}",
    re.IGNORECASE,
)
# A line whose signs stand before the names: "✅ brake ❌ keep".
_SIGN_FIRST = re.compile(rf"[^\w\n✓✔☑✅✗✘☒❌]*{_SIGN}")
_PARTS = (
    ("key", "value"),
    ("key", "word"),
    ("key", "reply"),
    ("tag", "in_tag"),
    ("cell", "in_cell"),
    ("of", "share"),
    ("label", "score"),
    ("before", "beside"),
    ("behind", "first"),
    ("ahead", "follows"),
    ("ticked", "sign"),
)
# Of the last four forms one alone is a remark: "I brake (80 %)".
_NEVER_ALONE = frozenset({"label", "before", "behind", "ahead"})
_ROMAN = ("i", "ii", "iii", "iv", "v", "vi", "vii", "viii")
_MARKS = r"(?:viii|vii|vi|iv|v|iii|ii|i|[A-Ha-h]|[0-9])"
_ITEM = re.compile(
    r"(?:(?<=\s)|(?<=^))\*{0,2}(?:(?:option|choice|action|candidate)\s+)?\(?"
    rf"(?P<mark>{_MARKS})(?P<close>[).:]|\s?=)\s+(?=\S)",
    re.MULTILINE | re.IGNORECASE,
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
    r"|go (?:with|for)|best)\b"
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
# A question about the own action or about somebody's presence, and its answer.
_OWN = r"(?:we|i|you|(?:the\s+)?(?:ego(?:[ -](?:vehicle|car))?|vut|av))"
_NEED = r"(?:need(?:s|ed)?|have|has|required|going|supposed)\s+to"
_ASKS = re.compile(
    rf"(?:(?:do|does|should|shall|must|will|is|are)\s+{_OWN}\s+(?:now\s+)?(?:{_NEED}\s+)?"
    rf"|(?:is\s+it\s+)?(?:necessary|advisable|{_NEED[:-5]})\s+(?:for\s+{_OWN}\s+)?to\s+"
    r"|is\s+(?=\w+ing\b[\w ]*\b(?:needed|required|necessary|advisable)$))",
    re.IGNORECASE,
)
_REPLIED = re.compile(
    r"(?:^|(?<=[\n.!?:;)]))[ \t*]*(?P<question>[A-Za-z][\w ,'-]{3,70}?)\s*\?\**\s{1,3}\**"
    r"(?P<reply>yes|no)\b\**"
    r"(?!\W{0,3}(?:if|unless|but|when|once|only|as|in|provided|not|until)\b)",
    re.IGNORECASE,
)
_PRESENT = re.compile(
    r"(?:(?:is|are) there|(?:do|can) (?:you|we|i) see) (?:an?|any)\b", re.IGNORECASE
)
# "Is a pedestrian crossing? Yes."
_MOVES = re.compile(r"(?:is|are)\s+(?:any\s+|(?=(?:an?|the)\s))", re.IGNORECASE)
_CROSSES = re.compile(r"(?<=pedestrian|edestrians) (?=crossing$)", re.IGNORECASE)
# A vector of shares or truths, one for each label of a list beside it: "[keep, brake] = [0, 1]".
_ELEMENT = r"(?:[01](?:\.\d+)?|\.\d+|true|false)"
_VECTOR = re.compile(
    rf"[\[(]\s*(?P<values>{_ELEMENT}(?:\s*,\s*{_ELEMENT}){{1,11}})\s*[\])]", re.IGNORECASE
)
_LISTED = rf"{_QUOTES}[^\W\d](?:[\w -]{{0,28}}\w)?{_QUOTES}"
_LEGEND = re.compile(
    rf"[\[({{]\s*(?P<listed>{_LISTED}(?:\s*[,|/;]\s*{_LISTED})+)\s*[\])}}]"
    rf"|(?P<line>{_LISTED}(?:\s*[,|/;]\s*{_LISTED})+)"
)
_FAR = 200  # of a legend, before its vector
# Between the two stands a key at most; and a vector is no row of a list.
_JUST_A_KEY = re.compile(r"\W{0,6}(?:[\w -]{1,24}[\"']?\s*[:=])?[^\w\[({]{0,6}")
_IN_LIST = re.compile(r"[\[(,]\s{0,9}\Z")
_AMONG_ROWS = re.compile(r"\s*,?\s*[\[(]\s*[-+]?\d")
# The same as a table: names in its header, values in its only row.
_TABLE = re.compile(
    r"^[ \t]*\|(?P<names>[^\n]+)\|[ \t]*\n[ \t]*\|[ \t:|-]+\|[ \t]*\n"
    rf"[ \t]*\|(?P<values>\s*{_ELEMENT}(?:\s*\|\s*{_ELEMENT})+\s*)\|[ \t]*$",
    re.IGNORECASE | re.MULTILINE,
)
# Boxes and rings before alternatives, ticked or empty.
_BOX = re.compile(r"\[(?P<in>[ xX✓✔])\]|(?<![\w)])\((?P<round>[ xX•✓])\)|(?P<sign>[☐☑☒⬜○●◯◉])")
_READ_TICKS = ("[x]", "☑")  # the rules know them
_MOST_BOXES = 64  # of a form
_TICKED = frozenset("xX✓✔•☑☒●◉")
# A label as a mark of its own: "<DECELERATE>".
_TOKEN = re.compile(r"<(?P<label>[A-Z]{2,}(?:[_ ][A-Z]{2,}){0,3})>")
# Alternatives as the heading of the chosen one: "accelerate / brake: brake".
_SLASHES = re.compile(
    rf"^\W{{0,4}}(?P<list>{_NAME}(?:\s*/\s*{_NAME})+)\s*:(?=\s*\w)"
    rf"|[{{(\[](?P<set>{_NAME}(?:\s*,\s*{_NAME})+)[}})\]]\s*(?:=|:|→|[-=]>)(?=\s*\w)",
    re.MULTILINE,
)
# Labels alone, one for each action: "KEEP | STRAIGHT".
_LABEL = r"[A-Za-z][A-Za-z_]{2,24}(?: [A-Za-z_]{2,20})?"
_BARE = re.compile(
    rf"^(?:[^\n:]{{0,30}}:)?[ \t*\"'\[(]*(?P<list>{_LABEL}(?:[ \t]*[|/;+&\n][ \t]*{_LABEL}){{1,3}})"
    r"[ \t*\"'\])]*\.?$",
    re.MULTILINE,
)
_CALLED = re.compile(r"\b(?:options|choices|alternatives|candidates)\b\W*$", re.IGNORECASE)
_STEPS = re.compile(
    r"\b(?:then|next|first|finally|after|until|afterwards|step|now|once|later|i|we)\b",
    re.IGNORECASE,
)
_SENTENCE_END = re.compile(r"\n|[.!?](?=\s|$)")
_VALUE_END = re.compile(r"[\"']\s*[,}\n]|\n")
_LEAST_RATED = 2  # conflicts in one object
_MOST_WORDS = 6  # of an option that isn't called one

# {"conflict": {"potential": 0.2, "active": 0.8}}
_RATED_CONFLICTS = re.compile(
    r"\bconflict(?:[ _](?:status|state|level|type))?[\"']\s*:\s*(?P<inside>\{[^{}]*\})",
    re.IGNORECASE,
)
_RATED = re.compile(
    rf"[\"'](?P<name>[\w ]{{3,24}})[\"']\s*:\s*(?P<value>[\"']?(?:{_WORD_VALUE}|{_SHARE})[\"']?)"
    r"\s*(?=[,}])",
    re.IGNORECASE,
)

_MAY_HOLD_FIELD = re.compile(
    rf"(?:[:=>|→?]|[-–—]\s)[\s\"'*_]{{0,4}}(?:{_WORD_VALUE}|{_SHARE}[\"'*]*(?:[\s,;}}\])|<]|$))"
    rf"|[(\[](?:{_SHARE}|{_WORD_VALUE})[)\]]|%[\s,;.]|=[\"']|\w[ \t]+{_SIGN}",
    re.IGNORECASE,
)
# Behind a field that says no more than its name.
_BEHIND_FIELD = re.compile(r"\s*(?:$|[\n}\]|;<]|,\s*(?:[\"'\n]|$|[\w ]{1,24}[:=])|\.\s*(?:\n|$))")

Values = Callable[[str], dict[str, object]]


@dataclass(frozen=True)
class _Field:
    value: str
    span: tuple[int, int]
    key_span: tuple[int, int]
    slots: frozenset[str]
    never_alone: bool

    @property
    def start(self) -> int:
        return self.span[0]

    @property
    def end(self) -> int:
        return self.span[1]

    def named(self, text: str) -> str:
        """Its name as a sentence, with blanks for the rest."""
        start, end = self.key_span
        return " " * (start - self.start) + text[start:end] + "." + " " * (self.end - end - 1)


def asserted(text: str, values_of: Values) -> str:
    """Blank the parts of a text that it names without asserting them; the length stays.

    Args:
        text: a model's text.
        values_of: what the rules read in a piece of text: values by slot.
    """
    for step in (
        _questions,
        _vectors,
        _conflicts,
        _fields,
        _boxes,
        _tokens,
        _other_options,
        _bare_labels,
    ):
        for start, given in list(step(text, values_of)):
            text = text[:start] + given + text[start + len(given) :]
    return text


def _fields(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the fields whose name isn't asserted, and for the values of those that are."""
    if _MAY_HOLD_FIELD.search(text) is None:
        return
    fields = []
    for match in _FIELD.finditer(text):
        name, value = next((n, v) for n, v in _PARTS if match[v] is not None)
        key = _words(match[name].strip("\"'*_"))
        said = match[value].strip("\"'*_ ").lower()
        slots = frozenset(_SIDES.get(key) or values_of(key))
        words = len(key.split())
        if said in _NO_ACTION and (words > _FEW_WORDS or slots - _ACTIONS):
            continue
        if name == "ticked" and _SIGN_FIRST.match(text, text.rfind("\n", 0, match.start()) + 1):
            continue
        # "Brake? Yes." is a field, and a question of several words is none.
        if value == "reply" and (words > 2 or slots - _ACTIONS):
            continue
        if slots:
            alone = name in _NEVER_ALONE
            bare = re.search(r"[^\"'*_ ].*[^\"'*_ ]|[^\"'*_ ]", match[name], re.DOTALL)
            start, end = bare.span() if bare is not None else (0, len(match[name]))
            span = match.start(name) + start, match.start(name) + end
            fields.append(_Field(said, match.span(), span, slots, alone))
    for group in _groups(text, fields):
        for one, holds in zip(group, _holding(group), strict=True):
            if holds is False:
                yield one.start, " " * (one.end - one.start)
            elif holds and _says_name_alone(one, text, values_of):
                yield one.start, one.named(text)


def _conflicts(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the values of an object of conflicts, but for the one that it asserts."""
    for match in _RATED_CONFLICTS.finditer(text):
        start, end = match.span("inside")
        group = []
        for one in _RATED.finditer(text, start, end):
            said = one["value"].strip("\"'").lower()
            if "conflict" in values_of(f"conflict: {_words(one['name'])}"):
                slots = frozenset({"conflict"})
                group.append(_Field(said, one.span(), one.span("name"), slots, False))
        held = [one for one, holds in zip(group, _holding(group), strict=True) if holds]
        if len(group) < _LEAST_RATED:
            continue
        yield start, " " * (end - start)
        if len(held) == 1:
            (name_start, name_end) = held[0].key_span
            yield name_start, text[name_start:name_end] + "."


def _questions(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Replace a question by a statement where it is answered by yes, by blanks where by no."""
    if "?" not in text:
        return
    for match in _REPLIED.finditer(text):
        question, yes = match["question"], match["reply"].lower() == "yes"
        present, moves = _PRESENT.match(question), _MOVES.match(question) if yes else None
        asks = present or _ASKS.match(question) or moves
        if asks is None:
            continue
        rest = question[asks.end() :]
        if asks is moves:  # it is no crosswalk
            rest = _CROSSES.sub(",", rest)
        read = values_of(f"a {rest}." if present is not None else f"{rest}.")
        if present is not None or asks is moves:
            told = bool(read.get("objects")) and (present or not _ACTIONS & read.keys())
        else:
            told = bool(read) and read.keys() <= _ACTIONS
        if not told:
            continue
        denied = "no" if present is not None else ""
        kept = rest if yes or denied else " " * len(rest)
        head = ("" if yes else denied).ljust(asks.end())
        stop = match.end() - match.start("question") - len(question) - 1
        yield match.start("question"), head + kept + "." + " " * stop


def _words(label: str) -> str:
    """Write a label as words: turn_left and turnLeft are turn left."""
    return HUMP.sub(" ", label).replace("_", " ").lower()


def _vectors(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for a legend and its vector, but for the label that the vector asserts."""
    for match in _VECTOR.finditer(text):
        if _AMONG_ROWS.match(text, match.end()) or _IN_LIST.search(
            text[max(0, match.start() - 10) : match.start()]
        ):
            continue
        values = match["values"].split(",")
        begin = max(0, match.start() - _FAR)
        before = list(_LEGEND.finditer(text, begin, match.start()))
        gap = re.compile(r"[^\w\n]{0,3}?(?=[\[({])").match(text, match.end())
        behind = _LEGEND.match(text, gap.end()) if gap is not None else None
        legends = [one for one in before if _JUST_A_KEY.fullmatch(text, one.end(), match.start())]
        for legend in [*legends, *([behind] if behind is not None else [])]:
            group = "listed" if legend["listed"] is not None else "line"
            names = _names_of(legend[group], legend.start(group))
            if (kept := _asserted_of(names, values, values_of)) is not None:
                yield from _blank_but(text, names, kept)
                yield match.start(), " " * len(match.group())
                break
    for match in _TABLE.finditer(text):
        names = _names_of(match["names"], match.start("names"))
        kept = _asserted_of(names, match["values"].split("|"), values_of)
        if kept is not None:
            yield from _blank_but(text, names, kept)
            yield match.start("values"), " " * len(match["values"])


def _names_of(listed: str, offset: int) -> list[tuple[str, int]]:
    """Part a list into its names, each with its offset in the text."""
    found = []
    for match in re.finditer(r"[^,|/;]+", listed):
        plain = match.group().strip().strip("\"'*_ ")
        found.append((plain, offset + match.start() + match.group().find(plain)))
    return found


def _asserted_of(
    names: Sequence[tuple[str, int]], values: Sequence[str], values_of: Values
) -> int | None:
    """Find the label of one slot that a vector asserts; -1: none; None: it is no such vector."""
    if len(names) != len(values):
        return None
    read = [values_of(_words(name)) for name, _ in names]
    sides = [set(_SIDES.get(_words(name), ())) for name, _ in names]
    slots = set.intersection(*(side | set(one) for side, one in zip(sides, read, strict=True)))
    if not slots & _ACTIONS or len({str(sorted(one.items())) for one in read}) < len(read):
        return None
    truths = {"true": "1", "false": "0"}
    plain = [value.strip().lower() for value in values]
    numbers = [float(truths.get(value, value)) for value in plain]
    first, second = sorted(numbers, reverse=True)[:2]
    if not first:
        return None
    return numbers.index(first) if first - second >= _CLEAR - 1e-9 else -1


def _blank_but(text: str, names: Sequence[tuple[str, int]], kept: int) -> Iterator[tuple[int, str]]:
    for i, (name, start) in enumerate(names):
        if i != kept:
            yield start, " " * len(name)
    # What parts the labels, and their brackets, would bind the one that is left to its neighbours.
    end = names[-1][1] + len(names[-1][0])
    for (name, start), (_, after) in pairwise(names):
        yield start + len(name), " " * (after - start - len(name))
    if kept >= 0 and end < len(text) and text[end : end + 1] in "])}":
        yield end, "."


def _boxes(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the alternatives whose box is empty, and for ticks that the rules don't know."""
    boxes = list(_BOX.finditer(text))
    if not 2 <= len(boxes) <= _MOST_BOXES:
        return
    items = []
    for i, box in enumerate(boxes):
        stop = boxes[i + 1].start() if i + 1 < len(boxes) else len(text)
        line = text.find("\n", box.end(), stop)
        end = line if line >= 0 else stop
        mark = box["in"] or box["round"] or box["sign"]
        slots = set(values_of(_words(text[box.end() : end]))) & _ACTIONS
        items.append((box, end, mark in _TICKED, slots))
    ticked = {slot for _, _, is_ticked, slots in items if is_ticked for slot in slots}
    for box, end, is_ticked, slots in items:
        if is_ticked and slots:
            if box.group().lower() not in _READ_TICKS:
                yield box.start(), " " * len(box.group())
            if text[end : end + 1] != "\n" and text[end - 1 : end] == " ":
                yield end - 1, "."
        elif slots & ticked:
            yield box.start(), " " * (end - box.start())


def _tokens(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the angle brackets around a label that stands as a mark."""
    for match in _TOKEN.finditer(text):
        label = match["label"].replace("_", " ").lower()
        if f"</{match['label']}>" not in text and set(values_of(label)) & _ACTIONS:
            yield match.start(), f" {label} "


def _says_name_alone(one: _Field, text: str, values_of: Values) -> bool:
    """Tell whether a field says no more than its name, which the rules don't read in it."""
    if "objects" in one.slots or _BEHIND_FIELD.match(text, one.end) is None:
        return False
    return not one.slots <= values_of(text[one.start : one.end]).keys()


def _bare_labels(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Commas for what parts labels of different actions, which stand alone on their lines."""
    for match in _BARE.finditer(text):
        labels = re.split(r"[|/;+&\n]", match["list"])
        read = [values_of(_words(label.strip())) for label in labels]
        slots = sorted(slot for one in read for slot in one)
        if all(len(one) == 1 for one in read) and slots == ["lat_action", "lon_action"]:
            yield match.start("list"), re.sub(r"[|/;+&\n]", ",", match["list"])


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
        if one.never_alone and len(group) == 1:
            found.append(None)
        elif one.value in _YES | _NO:
            found.append(one.value in _YES)
        elif "objects" in one.slots:
            found.append(one.value[0] not in "-−" and float(one.value.rstrip("% ")) > 0)
        else:
            found.append(_leads(one, group))
    return found


def _leads(one: _Field, group: Sequence[_Field]) -> bool | None:
    """Tell whether a share is the clear maximum of those of its slot."""
    same = [other for other in group if other.slots & one.slots and other.value[:1] in _OF_NUMBER]
    if any(other.value[0] in "-−" for other in same):  # no shares, but scores of another kind
        return None if len(same) == 1 else False
    shares = [(float(other.value.rstrip("% ")), "%" in other.value) for other in same]
    whole = 100.0 if any(p for _, p in shares) or max(v for v, _ in shares) > 1.0 else 1.0
    own = float(one.value.rstrip("% ")) / whole
    if len(same) == 1:
        return own >= 0.5 + _CLEAR / 2 if whole == 100.0 or one.value not in "01" else own == 1.0
    others = [v / whole for other, (v, _) in zip(same, shares, strict=True) if other is not one]
    return own - max(others) >= _CLEAR - 1e-9


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


def _other_options(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the options that aren't chosen."""
    for start, end in _option_spans(text, values_of):
        yield start, " " * (end - start)


def _option_spans(text: str, values_of: Values) -> Iterator[tuple[int, int]]:
    for match in _CALLED_LIST.finditer(text) if "[" in text else ():
        yield match.span()
    for match in _SLASHES.finditer(text):
        group = "list" if match["list"] is not None else "set"
        names = re.split(r"[/,]", match[group])
        read = [tuple(values_of(_words(name.strip())).items()) for name in names]
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
        if not picked and not _are_options(text, options, values_of):
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
    marks = [_Mark(m.start(), m.end(), m["mark"], m["close"]) for m in _ITEM.finditer(text)]
    if not text.isascii():
        marks += [
            _Mark(m.start(), m.end(), m["sign"].translate(_DRAWN)[0], "drawn")
            for m in _DRAWN_MARK.finditer(text)
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


_BEGINNINGS = (("number", 0), ("number", 1), ("roman", 1), ("letter", 1))


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
    found = []
    for i, mark in enumerate(run):
        if i + 1 < len(run):
            end = run[i + 1].start
        else:
            ends = _VALUE_END if mark.close == "key" else _SENTENCE_END
            stop = ends.search(text, mark.end)
            end = len(text) if stop is None else stop.start()
        found.append(_Option(mark.name, mark.start, mark.end, end))
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
