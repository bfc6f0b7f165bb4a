"""Finds the phrases of the lexicon in the words of a text, and the fields of structured answers."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from ssp_eval.extract.lexicon import lexicon

MARKS = frozenset({".", "?", "\n", ",", ";", ":", '"', "=", "|", "[", "(", "{", "<", ")", "}", ">"})
_SENTENCE = frozenset({".", "?", "\n"})
_LEVELS = frozenset({"lon_action", "lat_action", "action", "conflict"})
MAX_FIELD = 6  # words of a field's name
MAX_VALUE = 4
_BARE = {
    "straight": "straight",
    "maintain": "maintain",
    "left": "left",
    "right": "right",
    "keep lane": "straight",
    "stop": "stop",
    "decelerate": "decelerate",
    "keep": "maintain",
    "accelerate": "accelerate",
    "keep speed": "maintain",
    "hold": "maintain",
    "go": "accelerate",
    "resume": "accelerate",
    "standstill": "stop",
    "halt": "stop",
    "accel": "accelerate",
    "decel": "decelerate",
    "coast": "decelerate",
}
_ORDINALS = frozenset({"1", "2", "3", "4", "5", "6", "a", "b", "first", "second", "third"})
_ACTIONS = {
    "stop": "lon",
    "decelerate": "lon",
    "maintain": "lon",
    "accelerate": "lon",
    "left": "lat",
    "straight": "lat",
    "right": "lat",
}
_DETERMINERS = frozenset(
    {
        "its",
        "the",
        "a",
        "an",
        "this",
        "that",
        "their",
        "his",
        "no",
        "any",
        "right",
        "left",
        "at",
        "from",
        "into",
        "of",
    }
)
_CROSSED = frozenset({"from", "the", "our", "in", "left", "right", "l", "r", "slowly"})
_NOT_RELEVANT = frozenset({"no", "none", "low", "irrelevant", "not", "background", "ignore"})
_LOW = frozenset({"low", "down", "safe", "appropriate", "into", "moderate"})
_BEFORE_NAMES = frozenset({"the", "our", "ego", "its", "now", "and", "3", "2", "1", "4"})
_OPEN = frozenset({"none", "keep", "hold", "same"})  # of speed, or of the lane
_MOTOR = frozenset(
    {"motorbike", "motorcycle", "moped", "scooter", "dirt", "motorbikes", "motorcycles", "mopeds"}
)
_UNITS = frozenset({"km", "h", "kph", "mph", "kmh", "m", "s"})
_LENGTHS = frozenset({"m", "o", "s", "metres", "meters", "metre", "meter", "seconds", "clock"})
_SPEED_LABELS = frozenset({"speed", "velocity"})
_MODALS = frozenset({"to", "we", "i", "must", "should", "will", "and"})
_LEADING = frozenset({"lead", "leading", "preceding", "front"})
_PLACES = {
    "left": "left",
    "right": "right",
    "front": "front",
    "rear": "rear",
    "ahead": "front",
    "behind": "rear",
    "beside": "beside",
    "l": "left",
    "r": "right",
}
_DEFINITE = frozenset({"the", "this", "that", "these", "those", "same", "said"})
_OTHERS = frozenset({"another", "second", "other", "third"})
_INDEFINITE = (
    frozenset(
        {"a", "an", "one", "two", "three", "several", "some", "many", "few", "multiple", "no"}
    )
    | _OTHERS
)
_ENDS = frozenset(
    {"of", "in", "on", "to", "and", "by", "for", "with", "from", "or", "at", "is", "are", "but"}
)


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


_OPENING = frozenset({"\n", ".", ";", "|", "-"})  # before a heading
_COUNTED = frozenset({"two", "three", "four", "five", "few"})  # the two vans
_NOBODY = frozenset({"none", "nobody", "nil"})
_ONE = frozenset({"the", "a", "this", "that", "lead", "leading", "another"})  # the bus stops
_RIDERS = frozenset({"rider", "riders", "somebody", "someone", "one"})
NOTHING = Hit("", "", "", -1, -1)  # before a sentence and behind it


def find(words: list[str]) -> list[Hit]:
    """Return the hits of a text in order, not overlapping."""
    return _Reader(words).run()


class _Reader:
    """One pass over the words; a table's head names the fields of the columns below it."""

    def __init__(self, words: list[str]) -> None:
        self.count, self.words = len(words), [*words, "\n"]
        self.known = lexicon()
        self.hits: list[Hit] = []
        self.header: list[str] = []
        self.column = 0
        self.named = False  # a road user was named

    def run(self) -> list[Hit]:
        """Read all words."""
        at = self._bare(0) or 0
        while at < self.count:
            at = self._mark(at) if self.words[at] in MARKS else self._phrase(at)
        return self.hits

    def _put(self, kind: str, value: str, form: str, first: int, stop: int) -> int:
        self.hits.append(Hit(kind, value, form, first, stop))
        return stop

    # --- phrases

    def _phrase(self, at: int) -> int:
        words = self.words
        changed = self._change(at)
        if changed is not None:
            return changed
        entry, stop = self.known.longest(words, at)
        if words[at] in ("left", "right") and stop <= at + 1 and self._follows_user(at):
            return self._put("place", words[at], "", at, at + 1)
        heads = at == 0 or words[at - 1] in _OPENING
        if words[at] in ("left", "right") and words[at + 1] == ":" and heads:
            return self._put("place", words[at], "", at, at + 1)
        if entry is None or (
            entry.kind == "verb" and entry.form == "base" and at and words[at - 1] in _DETERMINERS
        ):
            turn = entry is not None and entry.value.startswith("to_") and words[at - 1] != "no"
            return stop if turn else at + 1  # its stop, a turn, a nudge to the right: a noun
        if (
            entry.value == "slow"
            and words[at:stop] == ["slow"]
            and (
                words[stop] not in MARKS
                and words[stop] not in self.known.sets["after_the_verb_slow"]
                and not (at and words[at - 1] in _MODALS)
            )
        ):
            return self._put("state", "same_direction", "slow", at, stop)  # slow lorry ahead
        # Keep speed low, not moving into ours; a pedestrian crossing from the left.
        low = entry.value in ("keep_speed", "stationary") and words[stop] in _LOW
        crosses = entry.kind == "skip" and words[at : at + 2] == ["pedestrian", "crossing"]
        halts = entry.kind == "skip" and words[stop - 1] == "stops" and words[at - 1] in _ONE
        if low or halts or (crosses and words[stop] in _CROSSED):
            entry, stop = self.known.longest(words[: at + 1], at)
        if entry is None or entry.kind == "skip":
            return stop
        if entry.kind == "user":
            self._user(at, stop, entry.value)
        elif entry.kind == "riding":
            self._riding(at, stop)
        else:
            stop -= entry.kind == "goal" and words[stop - 1] == "from"  # it begins the origin
            self._put(entry.kind, entry.value, entry.form, at, stop)
        return stop

    def _change(self, at: int) -> int | None:
        """Take a change of speed in numbers: 50 > 35, from 50 to 35."""
        words = self.words
        opens = words[at] == "from"
        at_first = at + opens
        if not _is_number(words[at_first : at_first + 1]):
            return None
        here = at_first + 1
        while words[here : here + 1] and words[here] in _UNITS:
            here += 1
        if words[here : here + 1] != (["to"] if opens else [">"]):
            return None
        last = here + 1
        if not _is_number(words[last : last + 1]):
            return None
        while words[last + 1 : last + 2] == [">"] and _is_number(words[last + 2 : last + 3]):
            last += 2
        unit = words[last + 1 : last + 3]
        if unit[:1] and unit[0] in _LENGTHS and unit != ["m", "s"]:
            return None
        old, new = float(words[at_first]), float(words[last])
        action = "accelerate" if new > old else "decelerate" if new < old else "maintain"
        return self._put("noun", action if new else "stop", "", at, last + 1)

    def _follows_user(self, at: int) -> bool:
        """Tell whether a bare side is a road user's place: pedestrian, left, waiting.

        So it is in brackets: van (right).
        """
        if self.words[at + 1] not in MARKS and self.words[at - 1] not in ("(", ","):
            return False
        last = [hit for hit in self.hits[-2:] if hit.kind != "state"]
        if (
            last
            and last[-1].kind == "mark"
            and last[-1].value in (",", "(")
            and last[-1].stop == at
        ):
            last = last[:-1]
        if len(last) > 1 and last[-1].kind == "verb" and last[-1].value in ("wait", "park"):
            last = last[:-1]
        return (
            bool(last)
            and (last[-1].kind == "user" or last[-1].value == "beside")
            and (at - last[-1].stop <= 2)
        )

    def _user(self, at: int, stop: int, name: str) -> None:
        if self.hits and self.hits[-1].stop == at and self.hits[-1].kind == "user":
            self.hits.pop()  # flatbed tow truck: the last noun is the head
        form = ""
        for word, before in pairwise([*self.words[max(at - 6, 0) : at][::-1], ""][:6]):
            if word in _DEFINITE or word in _INDEFINITE:
                definite = word in _DEFINITE or (word in _COUNTED and before in _DEFINITE)
                form = "the" if definite else "another" if word in _OTHERS else "a"
                break
            if word in MARKS or word in _ENDS:
                break
        for back in range(max(at - 2, 0), at):
            if self.words[back] in _LEADING:
                self._put("place", "front", "lead", back, stop)
        self.named = True
        self._put("user", name, form, at, stop)

    def _riding(self, at: int, stop: int) -> None:
        """Make the rider of a bicycle a cyclist: a boy on a bicycle."""
        name = "cyclist" if _MOTOR.isdisjoint(self.words[at:stop]) else "motorcycle"
        for index in range(len(self.hits) - 1, max(len(self.hits) - 3, -1), -1):
            hit = self.hits[index]
            if hit.kind == "user" and at - hit.stop < 4:
                self.hits[index] = Hit("user", name, hit.form, hit.first, stop)
                return
        if self.words[at - 1] in _RIDERS:
            self._put("user", name, "a", at - 1, stop)

    # --- marks, and the fields of structured answers

    def _mark(self, at: int) -> int:
        words, word = self.words, self.words[at]
        self._put("mark", word, "", at, at + 1)
        heads = word in ".,\n)" and self._heads(at)
        if heads or word in ":=" or (word == "|" and self._is_label(at)):
            return self._field(at)
        if word == "|" and not self.header and (at == 0 or words[at - 1] == "\n"):
            self.header = self._header_at(at)
            self.column = -1
        if word == "\n":
            self.header = self.header if words[at + 1] == "|" else []
            self.column = -1
        if word == "|" and self.header:
            self.column += 1
            slot = self.header[self.column] if self.column < len(self.header) else ""
            if slot:
                self._put("field", slot, "cell", at, at + 1)
                return self._value(at + 1, slot)
        return (None if self.header else self._bare(at + 1)) or at + 1

    def _label(self, mark: int) -> tuple[int, str | None]:
        """Return the field that the words before a colon name, and where they begin."""
        first = mark
        while first > 0 and self.words[first - 1] == '"':
            first -= 1
        stop = first
        while first > 0 and stop - first < MAX_FIELD and self.words[first - 1] not in MARKS:
            first -= 1
        return first, self._slot(self.words[first:stop])

    def _slot(self, label: list[str]) -> str | None:
        while label and (label[-1].isdigit() or label[-1] in _ORDINALS):
            label = label[:-1]
        whole: str | None = self.known.fields.get(" ".join(label))
        if whole is not None:
            return whole
        while label and label[0] in _BEFORE_NAMES:
            label = label[1:]
        return self.known.fields.get(" ".join(label))

    def _heads(self, mark: int) -> bool:
        """Tell whether the words before a mark are a heading: a line that is a field's name."""
        first, slot = self._label(mark)
        while first > 0 and (self.words[first - 1] in "[()." or self.words[first - 1].isdigit()):
            first -= 1
        opens = first == 0 or self.words[first - 1] == "\n"
        return opens and slot in ("objects", "action")

    def _is_label(self, at: int) -> bool:
        """Tell whether a bar parts a field's name from its value: | Lateral | straight |."""
        first, slot = self._label(at)
        row = self.words[at + 1 : self.words.index("\n", at)]
        opens = self.words[first - 1] == "|" and (first < 2 or self.words[first - 2] == "\n")
        value = row[:-1] if row[-1:] == ["|"] else row
        return opens and slot is not None and "|" not in value and self._slot(value) is None

    def _header_at(self, at: int) -> list[str]:
        """Return the fields of a table's columns, if the row that begins here is its head."""
        cells: list[list[str]] = [[]]
        for word in self.words[at + 1 : self.words.index("\n", at)]:
            if word == "|":
                cells.append([])
            else:
                cells[-1].append(word)
        slots = [self._slot(cell) or "" for cell in cells]
        return slots if sum(bool(slot) for slot in slots) >= 2 else []

    def _field(self, mark: int) -> int:
        first, slot = self._label(mark)
        if slot == "forecast" and not self.named:
            slot = None
        if slot is None:
            return self._put("field", "", "", mark, mark + 1)
        last = self.hits.pop()
        while self.hits and self.hits[-1].first >= first and self.hits[-1].kind != "cue":
            self.hits.pop()
        self.hits.append(last)
        self._put("field", slot, "", first, mark)
        return self._value(mark + 1, slot)

    def _value(self, at: int, slot: str) -> int:
        """Add a value that stands in the field's own words; return the next word's index."""
        words = self.words
        if slot == "relevance":
            word = next((one for one in words[at : at + 2] if one.isalpha()), "")
            if word:
                kind = "background" if word in _NOT_RELEVANT else "critical"
                self._put(kind, "", "value", at, at + 1)
            return at
        if slot == "position" and words[at] in _PLACES and words[at + 1] in MARKS:
            return self._put("place", _PLACES[words[at]], "value", at, at + 1)
        if (
            slot == "objects"
            and words[at] in _NOBODY
            and words[at + 1 : at + 2]
            and (words[at + 1] in MARKS)
        ):
            return self._put("nobody", "", "", at, at + 1)
        if slot not in _LEVELS:
            return at
        if _is_number(words[at : at + 1]) and float(words[at]) == 0.0 and slot != "conflict":
            speed = not _SPEED_LABELS.isdisjoint(words[self.hits[-1].first : at])
            if slot == "lat_action" or (speed and words[at + 1] in MARKS):
                action = "straight" if slot == "lat_action" else "stop"
                return self._put("action", action, "value", at, at + 1)
        while at < self.count and words[at] in ('"', "[", "("):
            at = self._put("mark", words[at], "", at, at + 1)
        stop = at
        while words[stop : stop + 1] and words[stop] not in MARKS:
            stop += 1
        if words[stop : stop + 1] == ["|"] and words[stop + 1] in _BARE:
            return (
                at if slot == "action" else words.index("\n", stop)
            )  # accelerate | maintain | stop: one is open
        slots = ("lon_action", "lat_action") if slot == "action" else (slot,)
        kind = "conflict" if slot == "conflict" else "action"
        for end in range(min(stop, at + MAX_VALUE), at, -1):
            phrase = " ".join(words[at:end])
            for name in slots:
                value = self.known.values[name].get(phrase)
                whole = end == stop or slot in ("lon_action", "lat_action")
                if value is not None and whole and not (slot == "action" and phrase in _OPEN):
                    return self._put(kind, value, "value", at, end)
        return at

    def _bare(self, at: int) -> int | None:
        """Take a value that stands alone between marks, as in ['STRAIGHT', 'MAINTAIN']."""
        for stop in (at + 2, at + 1):
            phrase = " ".join(self.words[at:stop])
            paired = stop == self.count and self._pairs(at)
            ends = stop < self.count or at == 0 or paired
            if phrase in _BARE and ends and self.words[stop] in MARKS:
                marked = self.words[stop] in "\"'|][" or paired
                side = phrase in ("left", "right") and not marked
                if self.words[stop] in ":=" or side:
                    return None
                return self._put("action", _BARE[phrase], "", at, stop)
        return None

    def _pairs(self, at: int) -> bool:
        """Tell whether the word at the end of a text follows a bare action and a comma."""
        last = self.hits[-2:]
        return (
            [hit.kind for hit in last] == ["action", "mark"]
            and last[1].value == ","
            and last[0].stop == at - 1
        )


def _is_number(words: list[str]) -> bool:
    return bool(words) and words[0].replace(".", "", 1).isdecimal()


def sentences(hits: list[Hit]) -> list[tuple[int, int]]:
    """Ranges of hits, each a sentence or a line."""
    ranges, start = [], 0
    for index, hit in enumerate(hits):
        if hit.kind == "mark" and hit.value in _SENTENCE:
            if index > start:
                ranges.append((start, index + 1))
            start = index + 1
    if start < len(hits):
        ranges.append((start, len(hits)))
    return ranges


def slot_of(action: str) -> str:
    """Tell whether an action's value is one of speed or of the lane."""
    return f"{_ACTIONS[action]}_action"
