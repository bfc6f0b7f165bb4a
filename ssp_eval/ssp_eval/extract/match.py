"""Stage 2: finds the phrases of the lexicon in the words of a text."""

from __future__ import annotations

from itertools import product
from typing import Any

from ssp_eval.extract import grammar, hazards, lanes, lexicon, movements, nouns, verbs
from ssp_eval.extract.directions import SIDES, own_end, place_stop, side
from ssp_eval.extract.free import RULES
from ssp_eval.extract.hits import MARKS, Hit, Kind

Entry = tuple[Kind, str, str]
_ENTRY = ""  # the key of a node's own entry; no word is empty

_PRONE_TO_NOUN = frozenset({"the", "a", "this", "that", "at", "zebra", "an", "marked"})


def _entries() -> dict[str, Entry]:
    """Every phrase with what it is; a phrase stands for one thing only."""
    table: dict[str, Entry] = {}

    def add(phrase: str, kind: Kind, value: str, form: str = "") -> None:
        table.setdefault(phrase, (kind, value, form))

    for phrase in lexicon.SKIPPED:
        add(phrase, Kind.SKIP, "")
    for phrase in lexicon.EGO:
        add(phrase, Kind.EGO, "")
    for name, listed in nouns.OBJECT_NOUNS.items():
        for noun in listed:
            add(noun, Kind.OBJECT, name)
    for value, listed in lexicon.STATES.items():
        for phrase in listed:
            add(phrase, Kind.STATE, value)
    for value, listed in lexicon.CONFLICTS.items():
        for phrase in listed:
            add(phrase, Kind.CONFLICT, value)
    for phrase in hazards.AFFECTS:
        add(phrase, Kind.RISK, "")
    for phrase in lexicon.RISK:
        add(phrase, Kind.RISK, "alone" if phrase in lexicon.RISK_ALONE else "")
    for kind, values in grammar.KINDS.items():
        for value, listed in values.items():
            for phrase in listed:
                add(phrase, kind, value)
    for value, listed in lexicon.PLACES.items():
        for phrase in listed:
            add(phrase, Kind.PLACE, value)
    for lemma, listed in (*verbs.VERBS.items(), *movements.MOVEMENTS.items()):
        for phrase in listed:
            for words, form in verbs.inflect(phrase):
                add(words, Kind.VERB, lemma, form)
    for lemma, forms in verbs.EXTRA_FORMS.items():
        for words, form in forms:
            add(words, Kind.VERB, lemma, form)
    for prep, owner in product(("in", "within", "inside", "on"), lanes.OWN_LANE):
        value = "own" if {"our", "my", "ego"} & set(owner.split()) else ""
        add(f"{prep} {owner} lane".replace("  ", " "), Kind.IN_LANE, value)
    for prep, owner in product(("in", "within", "inside"), ("our", "my", "its", "the ego")):
        add(f"{prep} {owner} path", Kind.IN_LANE, "path")
    for phrase in lanes.IN_PATH:
        add(phrase, Kind.IN_LANE, "path")
    for phrase in lanes.SAME_LANE:
        add(phrase, Kind.IN_LANE, "")
    for scene in lexicon.SCENE:
        add(scene, Kind.SCENE, "")
    return table


ENTRIES = _entries()
_KEYS = {phrase: slot for slot, listed in lexicon.KEYS.items() for phrase in listed}


def _trie() -> dict[str, Any]:
    root: dict[str, Any] = {}
    for phrase, entry in ENTRIES.items():
        node = root
        for word in phrase.split():
            node = node.setdefault(word, {})
        node[_ENTRY] = entry
    return root


_ROOT = _trie()
_DEFINITE = frozenset({"the", "this", "that", "these", "those", "same", "said"})
_INDEFINITE = frozenset(
    {
        "a",
        "an",
        "another",
        "one",
        "two",
        "three",
        "several",
        "some",
        "many",
        "few",
        "other",
        "multiple",
        "second",
        "no",
    }
)
_NP_ENDS = frozenset(
    {
        "of",
        "in",
        "on",
        "to",
        "and",
        "by",
        "for",
        "with",
        "from",
        "or",
        "at",
        "is",
        "are",
        "but",
    }
)
_CROSSED = frozenset({"from", "the", "our", "my", "in", "left", "right", "a", "slowly", "quickly"})
_NOUN_MARKERS = frozenset(
    {
        "the",
        "a",
        "an",
        "this",
        "that",
        "next",
        "bus",
        "tram",
        "at",
        "very",
        "sharp",
        "of",
        "its",
    }
    | {"their", "his", "her"}
)
_NOUNY = frozenset(
    {
        "stop",
        "turn",
        "turns",
        "change",
        "merge",
        "walk",
        "run",
        "shift",
        "start",
        "pass",
        "open",
        "edge",
        "bear",
        "drive",
        "ride",
        "cross",
        "offset",
        "stand",
        "park",
        "idle",
        "head",
        "nudge",
    }
)
_FRAMES = {"frame", "image", "picture", "timestep"}
_ORDINALS = {
    "first": 1,
    "second": 2,
    "third": 3,
    "fourth": 4,
    "fifth": 5,
    "last": 10**6,
    "final": 10**6,
    "current": 10**6,
    "latest": 10**6,
    "newest": 10**6,
    "previous": 0,
    "earlier": 0,
    "past": 0,
    "initial": 0,
    "oldest": 0,
    "one": 1,
    "two": 2,
    "three": 3,
    "four": 4,
    "five": 5,
}


_ADVERBS = frozenset({"still", "yet", "though", "therefore", "thus", "hence", "however"})
_OVERTAKING = frozenset({"overtaking", "passing"})
_ARTICLES = frozenset({"a", "an", "the", "this", "another"})
_VERB, _OBJECT, _PLACE, _SKIP = Kind.VERB, Kind.OBJECT, Kind.PLACE, Kind.SKIP
_AS_LISTED = frozenset(Kind) - {
    _VERB,
    _OBJECT,
    _PLACE,
    _SKIP,
    Kind.PRONOUN,
    Kind.JOIN,
    Kind.REACT,
}
_OTHERS = frozenset({"its", "their", "his", "her"})  # its rear is no place of its own
_AFTER_SIDES = frozenset({"in", "behind", "after", "now", "next", "here", "there"})
_RIDERS = frozenset({"pedestrian", "rider"})

# Words with which a rule can begin; the rest is passed over at once.
_FREE = frozenset(RULES) | frozenset(SIDES) | frozenset(_FRAMES)
_STARTS = frozenset(_ROOT) | MARKS | _FREE


def find(words: list[str]) -> list[Hit]:
    """The hits of a text in order, not overlapping but for a verb that keeps two things."""
    hits: list[Hit] = []
    count = len(words)
    at = 0
    while at < count:
        word = words[at]
        if word not in _STARTS:
            at += 1
            continue
        if word in MARKS:
            named = word in ":=" or (word == "[" and _heads_line(words, at))
            slot = _key(words, at, hits) if named else ""
            hits.append(Hit(Kind.MARK, "," if word == ">" else word, "", at, at + 1))
            at += 1
            if slot:
                value = lanes.field_value(words, at, slot)
                if value is not None:
                    hits.append(Hit(Kind.VERB, *value))
                    at = value[3]
            continue
        if word in _FREE:
            after = _free(words, at, hits)
            if after:
                at = after
                continue
        node: Any = _ROOT.get(word, {})
        entry: Entry | None = node.get(_ENTRY)
        here = stop = at + 1
        while here < count:
            node = node.get(words[here])
            if node is None:
                break
            here += 1
            if _ENTRY in node:
                entry, stop = node[_ENTRY], here
        at = _add(words, at, stop, entry, hits) if entry is not None else at + 1
    return hits


def _free(words: list[str], at: int, hits: list[Hit]) -> int:
    """The word after what the rules for free phrases find at a word, 0 if they find nothing."""
    word = words[at]
    for rule in RULES.get(word, ()):
        after = rule(words, at, hits)
        if after:
            return after
    if word in SIDES:
        return _side(words, at, hits)
    return _frame(words, at, hits) if word in _FRAMES else 0


def _add(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    """Adds what a phrase of the lexicon is in its place; the word after it."""
    kind, value, form = entry
    if kind in _AS_LISTED:
        hits.append(Hit(kind, value, form, at, stop))
        return stop
    if kind is _VERB:
        return _add_verb(words, at, stop, entry, hits)
    if kind is _OBJECT or value == "rider":
        return _add_object(words, at, stop, entry, hits)
    if kind is _PLACE:
        end = None if at and words[at - 1] in _OTHERS else place_stop(words, stop, value)
        if end is None:
            return stop
        form = "car" if words[end - 1] in ("car", "vehicle") and not own_end(words, end) else form
        stop = end
    elif kind is _SKIP:
        crossed = stop < len(words) and words[stop] in _CROSSED
        if crossed and words[at:stop] == ["pedestrian", "crossing"]:
            return _add(words, at, at + 1, ENTRIES["pedestrian"], hits)
        return stop
    elif words[at] in _ADVERBS:
        if _parenthetic(words, at, stop):
            return stop  # is still crossing, has not yet stopped
    elif words[at] in _OVERTAKING and at and words[at - 1] in _ARTICLES:
        kind, value = Kind.STATE, "same_direction"  # an overtaking motorbike
    hits.append(Hit(kind, value, form, at, stop))
    return stop


def _add_verb(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    kind, value, form = entry
    if stop == at + 1:
        if _is_noun(words, at):
            return stop
        if value == "wait" and words[at : stop + 1] == ["wait", ","]:
            kind = Kind.REVISE
        elif value == "cross" and form == "ing" and at and words[at - 1] in _PRONE_TO_NOUN:
            next_word = words[stop] if stop < len(words) else ""
            if next_word not in ENTRIES:
                return stop
    hits.append(Hit(kind, value, form, at, stop))
    return stop


def _add_object(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    kind, value, _ = entry
    ridden = nouns.together(words, stop, value) if value in _RIDERS else None
    if ridden is not None:
        kind = _OBJECT
        value, stop = ridden
    if nouns.vague(words, at):
        return stop
    form = _article(words, at)
    if kind is _OBJECT and hits and hits[-1].stop == at and hits[-1].kind is _OBJECT:
        hits.pop()  # flatbed tow truck: the last noun is the head
    hits.append(Hit(kind, value, form, at, stop))
    return stop


def _heads_line(words: list[str], at: int) -> bool:
    """[Intent] at the start of a line: whether a bracket closes there."""
    for first in range(at - 2, max(at - 6, -1), -1):
        if words[first] == "[":
            return first == 0 or words[first - 1] == "\n"
    return False


def _parenthetic(words: list[str], at: int, stop: int) -> bool:
    """Whether an adverb stands inside its clause: is still crossing; the SUV, however, waits."""
    if not at:
        return False
    commas = words[at - 1] == "," and words[stop : stop + 1] == [","]
    return commas or (words[at - 1] not in MARKS and words[at] != "however")


def _article(words: list[str], at: int) -> str:
    """Whether a noun is introduced (indefinite), known (definite) or bare."""
    for back in range(at - 1, max(at - 6, -1), -1):
        word = words[back]
        if word in _DEFINITE:
            return "definite"
        if word in _INDEFINITE:
            return "indefinite"
        if word in MARKS or word in _NP_ENDS:
            return ""
    return ""


def _is_noun(words: list[str], at: int) -> bool:
    """The stop, a turn, slow traffic: words that look like verbs and aren't."""
    word = words[at]
    before = words[at - 1] if at else ""
    after = words[at + 1] if at + 1 < len(words) else ""
    if word == "slow":
        entry = ENTRIES.get(after)
        return (
            before in _NOUN_MARKERS
            or after in ("speed", "moving", "pace")
            or (entry is not None and entry[0] in (Kind.OBJECT, Kind.SCENE))
        )
    return word in _NOUNY and before in _NOUN_MARKERS


def _side(words: list[str], at: int, hits: list[Hit]) -> int:
    node: Any = _ROOT.get(words[at], {})
    entry: Entry | None = None
    here = stop = at + 1
    while here < len(words) and (node := node.get(words[here])) is not None:
        here += 1
        if _ENTRY in node:
            entry, stop = node[_ENTRY], here
    named = at > 0 and words[at - 1] in (
        "the",
        "our",
        "my",
        "from",
    )  # on the right ahead
    if entry is not None and not (
        named and (entry[0] is Kind.PLACE or words[at + 1] in _AFTER_SIDES)
    ):
        return _add(words, at, stop, entry, hits)
    found = side(words, at)
    if found is None:
        return at + 1
    value, form, first, stop = found
    while hits and hits[-1].stop > first:
        if hits[-1].kind is Kind.VERB:
            first = hits[-1].stop
            break
        hits.pop()  # "to", "on" and "by" belong to the direction now
    hits.append(Hit(Kind.SIDE, value, form, first, stop))
    return stop


def _frame(words: list[str], at: int, hits: list[Hit]) -> int:
    number: int | None = None
    stop = at + 1
    if at and words[at - 1] in _ORDINALS:
        number = _ORDINALS[words[at - 1]]
    elif stop < len(words):
        after = words[stop]
        number = (
            int(after)
            if after.isascii() and after.isdigit() and len(after) < 6
            else (_ORDINALS.get(after))
        )
        stop += number is not None
    if number is None:
        hits.append(Hit(Kind.SCENE, "", "", at, at + 1))
    else:
        hits.append(Hit(Kind.FRAME, str(number), "", at, stop))
    return stop


def _key(words: list[str], colon: int, hits: list[Hit]) -> str:
    """Turns the words before a colon into a field name, if they are one and stand alone.

    Returns:
        The field: a slot of KEYS, or one of the looser names of lanes.py; "" if there is none.
    """
    stop = colon
    while stop and words[stop - 1] in ('"', ")", "|"):
        stop -= 1
    if stop > 2 and words[stop - 1].isdigit():
        stop -= 1  # Critical object 1:
    for length in (4, 3, 2, 1):
        first = stop - length
        before = words[first - 1] if first > 0 else "."
        if first < 0 or not (before in MARKS or "0" <= before[0] <= "9"):
            continue
        name = " ".join(words[first:stop])
        slot = _KEYS.get(name)
        if slot:
            while hits and hits[-1].stop > first:
                hits.pop()
            hits.append(Hit(Kind.KEY, slot, "", first, stop))
            return slot
        loose = lanes.FIELDS.get(name)
        if loose:
            return loose
    return ""
