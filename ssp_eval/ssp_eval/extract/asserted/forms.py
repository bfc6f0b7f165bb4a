"""Forms that are filled in: questions, vectors and tables, boxes, marks, labels alone."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from ssp_eval.extract.asserted.labels import ACTIONS, CLEAR, QUOTES, SIDES, Values, words

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
# What asks for something else than for an order: "Keep the lane? Yes."
_NO_ORDER = re.compile(
    r"(?:is|are|was|were|can|could|may|might|would|will|do|does|did|should|shall|must|has|have|had"
    r"|why|what|which|how|when|where|who|any|safe|ok|okay|possible|able|allowed|room|time|clear)\b",
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
_LISTED = rf"{QUOTES}[^\W\d](?:[\w -]{{0,28}}\w)?{QUOTES}"
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
# Labels alone, one for each action: "KEEP | STRAIGHT".
_LABEL = r"[A-Za-z][A-Za-z_]{2,24}(?: [A-Za-z_]{2,20})?"
_BARE = re.compile(
    rf"^(?:[^\n:]{{0,30}}:)?[ \t*\"'\[(]*(?P<list>{_LABEL}(?:[ \t]*[|/;+&\n][ \t]*{_LABEL}){{1,3}})"
    r"[ \t*\"'\])]*\.?$",
    re.MULTILINE,
)


def questions(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Replace a question by a statement where it is answered by yes, by blanks where by no."""
    if "?" not in text:
        return
    for match in _REPLIED.finditer(text):
        question, yes = match["question"], match["reply"].lower() == "yes"
        present, moves = _PRESENT.match(question), _MOVES.match(question) if yes else None
        asks = present or _ASKS.match(question) or moves
        if asks is None and _NO_ORDER.match(question) is not None:
            continue
        begin = 0 if asks is None else asks.end()
        rest = question[begin:]
        is_of_motion = moves is not None and asks is moves
        if is_of_motion:  # it is no crosswalk
            rest = _CROSSES.sub(",", rest)
        read = values_of(f"a {rest}." if present is not None else f"{rest}.")
        if present is not None or is_of_motion:
            is_relevant = bool(read.get("objects")) and (present or not ACTIONS & read.keys())
        else:
            is_relevant = bool(read) and read.keys() <= ACTIONS
        if not is_relevant:
            continue
        denied = "no" if present is not None else ""
        body = rest if yes or denied else " " * len(rest)
        head = ("" if yes else denied).ljust(begin)
        stop = match.end() - match.start("question") - len(question) - 1
        yield match.start("question"), head + body + "." + " " * stop


def vectors(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
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
            if (label_index := _asserted_of(names, values, values_of)) is not None:
                yield from _blank_but(text, names, label_index)
                yield match.start(), " " * len(match.group())
                break
    for match in _TABLE.finditer(text):
        names = _names_of(match["names"], match.start("names"))
        label_index = _asserted_of(names, match["values"].split("|"), values_of)
        if label_index is not None:
            yield from _blank_but(text, names, label_index)
            yield match.start("values"), " " * len(match["values"])


def _names_of(listed: str, offset: int) -> list[tuple[str, int]]:
    """Part a list into its names, each with its offset in the text."""
    names = []
    for match in re.finditer(r"[^,|/;]+", listed):
        plain = match.group().strip().strip("\"'*_ ")
        names.append((plain, offset + match.start() + match.group().find(plain)))
    return names


def _asserted_of(
    names: Sequence[tuple[str, int]], values: Sequence[str], values_of: Values
) -> int | None:
    """Find the label of one slot that a vector asserts; -1: none; None: it is no such vector."""
    if len(names) != len(values):
        return None
    read = [values_of(words(name)) for name, _ in names]
    sides = [set(SIDES.get(words(name), ())) for name, _ in names]
    slots = set.intersection(*(side | set(one) for side, one in zip(sides, read, strict=True)))
    if not slots & ACTIONS or len({str(sorted(one.items())) for one in read}) < len(read):
        return None
    truths = {"true": "1", "false": "0"}
    plain = [value.strip().lower() for value in values]
    numbers = [float(truths.get(value, value)) for value in plain]
    first, second = sorted(numbers, reverse=True)[:2]
    if not first:
        return None
    return numbers.index(first) if first - second >= CLEAR - 1e-9 else -1


def _blank_but(
    text: str, names: Sequence[tuple[str, int]], label_index: int
) -> Iterator[tuple[int, str]]:
    for i, (name, start) in enumerate(names):
        if i != label_index:
            yield start, " " * len(name)
    # What parts the labels, and their brackets, would bind the one that is left to its neighbours.
    end = names[-1][1] + len(names[-1][0])
    for (name, start), (_, after) in pairwise(names):
        yield start + len(name), " " * (after - start - len(name))
    if label_index >= 0 and end < len(text) and text[end : end + 1] in "])}":
        yield end, "."


def boxes(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the alternatives whose box is empty, and for ticks that the rules don't know."""
    matches = list(_BOX.finditer(text))
    if not 2 <= len(matches) <= _MOST_BOXES:
        return
    items = []
    for i, box in enumerate(matches):
        stop = matches[i + 1].start() if i + 1 < len(matches) else len(text)
        line = text.find("\n", box.end(), stop)
        end = line if line >= 0 else stop
        mark = box["in"] or box["round"] or box["sign"]
        slots = set(values_of(words(text[box.end() : end]))) & ACTIONS
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


def tokens(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Blanks for the angle brackets around a label that stands as a mark."""
    for match in _TOKEN.finditer(text):
        label = match["label"].replace("_", " ").lower()
        if f"</{match['label']}>" not in text and set(values_of(label)) & ACTIONS:
            yield match.start(), f" {label} "


def bare_labels(text: str, values_of: Values) -> Iterator[tuple[int, str]]:
    """Commas for what parts labels of different actions, which stand alone on their lines."""
    for match in _BARE.finditer(text):
        labels = re.split(r"[|/;+&\n]", match["list"])
        read = [values_of(words(label.strip())) for label in labels]
        slots = sorted(slot for one in read for slot in one)
        if all(len(one) == 1 for one in read) and slots == ["lat_action", "lon_action"]:
            yield match.start("list"), re.sub(r"[|/;+&\n]", ",", match["list"])
