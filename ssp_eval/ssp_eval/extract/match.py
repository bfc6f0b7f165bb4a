"""Finds the phrases of the lexicon in the words of a text, and the fields of structured answers."""

from __future__ import annotations

from typing import NamedTuple

from ssp_eval.extract.lexicon import Lexicon, lexicon

MARKS = frozenset({".", "?", "\n", ",", ";", ":", '"', "=", "|", "[", "(", "{", "<", ")", "}", ">"})
_SENTENCE = frozenset({".", "?", "\n"})
_LEVELS = frozenset({"lon_action", "lat_action", "action", "conflict"})
MAX_FIELD = 6  # words of a field's name
MAX_VALUE = 4
_BARE = {"straight": "straight", "maintain": "maintain", "left": "left", "right": "right",
         "keep lane": "straight", "stop": "stop", "decelerate": "decelerate", "keep": "maintain",
         "accelerate": "accelerate", "keep speed": "maintain", "hold": "maintain"}  # fmt: skip
_ORDINALS = frozenset({"1", "2", "3", "4", "5", "6", "a", "b", "first", "second", "third"})
_ACTIONS = {"stop": "lon", "decelerate": "lon", "maintain": "lon", "accelerate": "lon",
            "left": "lat", "straight": "lat", "right": "lat"}  # fmt: skip


class Hit(NamedTuple):
    """A phrase of the lexicon found in the text.

    Args:
        kind: the section of the lexicon, or mark, field, action.
        value: what it says.
        form: of a verb: base, s, ing, ed.
        first: index of its first word.
        stop: index after its last word.
    """

    kind: str
    value: str
    form: str
    first: int
    stop: int


NOTHING = Hit("", "", "", -1, -1)  # before a sentence and behind it


def find(words: list[str]) -> list[Hit]:
    """The hits of a text in order, not overlapping."""
    known = lexicon()
    hits: list[Hit] = []
    at = 0
    count = len(words)
    header: list[str] = []
    column = 0
    opening = _bare([*words, "\n"], 0)
    if opening is not None:
        hits.append(Hit("action", opening[0], "", 0, opening[1]))
        at = opening[1]
    while at < count:
        word = words[at]
        if word in MARKS:
            hits.append(Hit("mark", word, "", at, at + 1))
            if word in ".,\n)" and _heads(words, at, known):
                at = _field(words, at, hits, known)
                continue
            if word in ":=" or (word == "|" and _is_label(words, at, known)):
                at = _field(words, at, hits, known)
                continue
            if word == "|" and not header and words[max(at - 1, 0)] in ("\n", "|")[: 1 + (at == 0)]:
                header = _header(words, at, known)
                column = -1
            if word == "\n":
                if words[at + 1 : at + 2] != ["|"]:
                    header = []
                column = -1
            if word == "|" and header:
                column += 1
                if column < len(header) and header[column]:
                    hits.append(Hit("field", header[column], "cell", at, at + 1))
                    at = _value(words, at + 1, header[column], hits, known)
                    continue
            bare = _bare(words, at + 1)
            if bare is not None and not header:
                value, stop = bare
                hits.append(Hit("action", value, "", at + 1, stop))
                at = stop
                continue
            at += 1
            continue
        entry, stop = known.longest(words, at)
        if (
            entry is not None
            and entry.kind == "verb"
            and entry.form == "base"
            and _is_noun(words, at)
        ):
            entry = None
        if entry is not None and words[stop : stop + 1] and words[stop] in _LOW and (
            entry.value in ("keep_speed", "stationary")
        ):  # fmt: skip
            entry, stop = known.longest(words[: at + 1], at)  # keep speed low, not moving into ours
        if entry is None:
            at += 1
            continue
        crosses = words[at : at + 2] == ["pedestrian", "crossing"] and words[stop : stop + 1]
        if entry.kind == "skip" and crosses and words[stop] in _CROSSED:
            entry, stop = known.longest(words[: at + 1], at)
        if entry is not None and entry.kind == "user":
            _user(words, at, stop, entry.value, hits)
        elif entry is None:
            pass
        elif entry.kind == "riding":
            _riding(at, stop, hits)
        elif entry.kind != "skip":
            hits.append(Hit(entry.kind, entry.value, entry.form, at, stop))
        at = stop
    return hits


def _is_noun(words: list[str], at: int) -> bool:
    """Whether a word that may be a verb is a noun here: its stop, a turn."""
    return at > 0 and words[at - 1] in _DETERMINERS


def _user(words: list[str], at: int, stop: int, name: str, hits: list[Hit]) -> None:
    if hits and hits[-1].stop == at and hits[-1].kind == "user":
        hits.pop()  # flatbed tow truck: the last noun is the head
    form = ""
    for back in range(at - 1, max(at - 6, -1), -1):
        word = words[back]
        if word in _DEFINITE or word in _INDEFINITE:
            form = "the" if word in _DEFINITE else "another" if word in _OTHERS else "a"
            break
        if word in MARKS or word in _ENDS:
            break
    hits.extend(
        Hit("place", "front", "lead", back, stop)
        for back in range(max(at - 2, 0), at)
        if words[back] in _LEADING
    )
    hits.append(Hit("user", name, form, at, stop))


def _riding(at: int, stop: int, hits: list[Hit]) -> None:
    """A boy on a bicycle is a cyclist."""
    for index in range(len(hits) - 1, max(len(hits) - 3, -1), -1):
        hit = hits[index]
        if hit.kind == "user" and at - hit.stop < 4:
            hits[index] = Hit("user", "cyclist", hit.form, hit.first, stop)
            return


def _label(words: list[str], mark: int) -> tuple[int, list[str]]:
    """The words before a colon that may be a field's name, and where they begin."""
    first = mark
    while first > 0 and words[first - 1] == '"':
        first -= 1
    stop = first
    while first > 0 and stop - first < MAX_FIELD and words[first - 1] not in MARKS:
        first -= 1
    return first, words[first:stop]


def _slot(label: list[str], known: Lexicon) -> str | None:
    while label and (label[-1].isdigit() or label[-1] in _ORDINALS):
        label = label[:-1]
    while label and label[0] in ("the", "our", "ego", "its", "now", "and", "3", "2", "1", "4"):
        label = label[1:]
    return known.fields.get(" ".join(label)) if label else None


def _heads(words: list[str], mark: int, known: Lexicon) -> bool:
    """Whether the words before a mark are a heading: a line that is a field's name."""
    first, label = _label(words, mark)
    while first > 0 and (words[first - 1] in "[()." or words[first - 1].isdigit()):
        first -= 1
    opens = first == 0 or words[first - 1] == "\n"
    return opens and bool(label) and _slot(label, known) in ("objects", "action")


def _is_label(words: list[str], at: int, known: Lexicon) -> bool:
    """Whether a bar parts a field's name from its value: | Lateral | straight |."""
    first, label = _label(words, at)
    slot = _slot(label, known)
    if slot is None or words[first - 1 : first] != ["|"] or words[first - 2 : first - 1] not in (
        ["\n"], []
    ):  # fmt: skip
        return False
    stop = at + 1
    while stop < len(words) and words[stop] not in ("|", "\n"):
        stop += 1
    rest = words[stop + 1 : stop + 2]
    return _slot(words[at + 1 : stop], known) is None and rest in (["\n"], [])


def _header(words: list[str], at: int, known: Lexicon) -> list[str]:
    """The fields of a table's columns, if the row that begins here is its head."""
    stop = at
    while stop < len(words) and words[stop] != "\n":
        stop += 1
    cells: list[list[str]] = [[]]
    for word in words[at + 1 : stop]:
        if word == "|":
            cells.append([])
        else:
            cells[-1].append(word)
    slots = [_slot(cell, known) or "" for cell in cells]
    return slots if sum(bool(slot) for slot in slots) >= 2 else []


def _field(words: list[str], mark: int, hits: list[Hit], known: Lexicon) -> int:
    first, label = _label(words, mark)
    slot = _slot(label, known)
    if slot is None:
        hits.append(Hit("field", "", "", mark, mark + 1))
        return mark + 1
    last = hits.pop()
    while hits and hits[-1].first >= first and hits[-1].kind != "cue":
        hits.pop()
    hits.append(last)
    hits.append(Hit("field", slot, "", first, mark))
    return _value(words, mark + 1, slot, hits, known)


def _value(words: list[str], at: int, slot: str, hits: list[Hit], known: Lexicon) -> int:
    """Adds what a field says in one of its own words; the word after that."""
    if slot == "relevance":
        word = next((one for one in words[at : at + 2] if one.isalpha()), "")
        if word:
            kind = "background" if word in _NOT_RELEVANT else "critical"
            hits.append(Hit(kind, "", "value", at, at + 1))
        return at
    if slot not in _LEVELS:
        return at
    while at < len(words) and words[at] in ('"', "[", "("):
        hits.append(Hit("mark", words[at], "", at, at + 1))
        at += 1
    stop = at
    while stop < len(words) and words[stop] not in MARKS:
        stop += 1
    if words[stop : stop + 1] == ["|"] and " ".join(words[stop + 1 : stop + 2]) in _BARE:
        while slot != "action" and stop < len(words) and words[stop] != "\n":
            stop += 1
        return at if slot == "action" else stop  # accelerate | maintain | stop: one that is open
    for end in range(min(stop, at + MAX_VALUE), at, -1):
        phrase = " ".join(words[at:end])
        whole = end == stop
        if slot == "conflict":
            value = known.values[slot].get(phrase) if whole else None
            if value is not None:
                hits.append(Hit("conflict", value, "value", at, end))
                return end
            continue
        slots = ("lon_action", "lat_action") if slot == "action" else (slot,)
        for name in slots:
            value = known.values[name].get(phrase)
            if value is not None and (whole or len(slots) == 1) and not (
                slot == "action" and phrase in ("none", "keep", "hold", "same")
            ):  # fmt: skip
                hits.append(Hit("action", value, "value", at, end))
                return end
    return at


def _bare(words: list[str], at: int) -> tuple[str, int] | None:
    """A value that stands alone between marks, as in ['STRAIGHT', 'MAINTAIN']."""
    for stop in (at + 2, at + 1):
        phrase = " ".join(words[at:stop])
        if phrase in _BARE and words[stop : stop + 1] and words[stop] in MARKS:
            if words[stop] in ":=" or (phrase in ("left", "right") and words[stop] not in "\"'|]["):
                return None
            return _BARE[phrase], stop
    return None


_DETERMINERS = frozenset(
    {"its", "the", "a", "an", "this", "that", "their", "his", "no", "any", "right", "left", "at"}
)
_CROSSED = frozenset({"from", "the", "our", "in", "left", "right", "l", "r", "slowly"})
_NOT_RELEVANT = frozenset({"no", "none", "low", "irrelevant", "not", "background", "ignore"})
_LOW = frozenset({"low", "down", "safe", "appropriate", "into", "moderate"})
_LEADING = frozenset({"lead", "leading", "preceding"})
_DEFINITE = frozenset({"the", "this", "that", "these", "those", "same", "said"})
_OTHERS = frozenset({"another", "second", "other", "third"})
_INDEFINITE = (
    frozenset(
        {"a", "an", "one", "two", "three", "several", "some", "many", "few", "multiple", "no"}
    )
    | _OTHERS
)
_ENDS = frozenset({"of", "in", "on", "to", "and", "by", "for", "with", "from", "or", "at", "is",
                   "are", "but"})  # fmt: skip


def sentences(hits: list[Hit]) -> list[tuple[int, int]]:
    """Ranges of hits, each a sentence or a line."""
    found, start = [], 0
    for index, hit in enumerate(hits):
        if hit.kind == "mark" and hit.value in _SENTENCE:
            if index > start:
                found.append((start, index + 1))
            start = index + 1
    if start < len(hits):
        found.append((start, len(hits)))
    return found


def slot_of(action: str) -> str:
    """Whether an action's value is one of speed or of the lane."""
    return f"{_ACTIONS[action]}_action"
