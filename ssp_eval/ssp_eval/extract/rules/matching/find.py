"""Stage 2: finds the phrases of the tables in the words of a text."""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases import field_values
from ssp_eval.extract.rules.hits import MARKS, Hit, Kind
from ssp_eval.extract.rules.matching.by_first_word import RULES
from ssp_eval.extract.rules.matching.field_headings import field_name, heads_line
from ssp_eval.extract.rules.matching.frame_numbers import FRAMES, frame
from ssp_eval.extract.rules.matching.homonyms import is_noun
from ssp_eval.extract.rules.matching.sides import SIDES, own_end, place_stop, side
from ssp_eval.extract.rules.words import road_users
from ssp_eval.extract.rules.words.vocabulary import ENTRIES, TREE, Entry, longest

_PRONE_TO_NOUN = frozenset({"the", "a", "this", "that", "at", "zebra", "an", "marked"})


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
_ADVERBS = frozenset({"still", "yet", "though", "therefore", "thus", "hence", "however"})
_ROADS = frozenset({"road", "street", "lane", "path", "traffic"})
_HEDGES = frozenset({"maybe", "perhaps", "probably", "possibly", "likely"})
_FIGURES = frozenset(
    {"two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "twelve", "fifteen"}
    | {"twenty", "thirty", "forty", "fifty", "sixty", "about", "around", "half"}
)
_OVERTAKING = frozenset({"overtaking", "passing"})
_ARTICLES = frozenset({"a", "an", "the", "this", "another"})
_VERB, _OBJECT, _PLACE, _SKIP = Kind.VERB, Kind.OBJECT, Kind.PLACE, Kind.SKIP
_MARK = Kind.MARK
_AS_LISTED = frozenset(Kind) - {
    _VERB,
    _OBJECT,
    _PLACE,
    _SKIP,
    Kind.PRONOUN,
    Kind.JOIN,
    Kind.REACT,
    Kind.MODAL,
}
_OTHERS = frozenset({"its", "their", "his", "her"})  # its rear is no place of its own
_AFTER_SIDES = frozenset({"in", "behind", "after", "now", "next", "here", "there"})
_RIDERS = frozenset({"pedestrian", "rider"})

# Words with which a rule can begin; the rest is passed over at once.
_FREE = frozenset(RULES) | frozenset(SIDES) | frozenset(FRAMES)
_STARTS = frozenset(TREE) | MARKS | _FREE


def find(words: list[str]) -> list[Hit]:
    """The hits of a text in order, not overlapping but for a verb that keeps two things."""
    hits: list[Hit] = []
    past = 0  # the word after what has been taken already
    for at, word in enumerate(words):
        if at < past or word not in _STARTS:
            continue
        if word in MARKS:
            past = _mark(words, at, hits)
            continue
        if word in _FREE:
            past = _free(words, at, hits)
            if past:
                continue
        entry, stop = longest(words, at)
        if entry is not None:
            past = _add(words, at, stop, entry, hits)
    return hits


def _mark(words: list[str], at: int, hits: list[Hit]) -> int:
    """Adds a mark, with the field that it names and that field's value; the word after them."""
    word = words[at]
    slot = ""
    if word in ":=" or (word == "[" and heads_line(words, at)):
        slot = field_name(words, at, hits)
    hits.append(Hit(_MARK, "," if word == ">" else word, "", at, at + 1))
    value = field_values.field_value(words, at + 1, slot) if slot else None
    if value is None:
        return at + 1
    hits.append(Hit(_VERB, *value))
    return value[3]


def _free(words: list[str], at: int, hits: list[Hit]) -> int:
    """The word after what the rules for free phrases find at a word, 0 if they find nothing."""
    word = words[at]
    for rule in RULES.get(word, ()):
        after = rule(words, at, hits)
        if after:
            return after
    if word in SIDES:
        return _side(words, at, hits)
    return frame(words, at, hits) if word in FRAMES else 0


def _add(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    """Adds what a phrase of the tables is in its place; the word after it."""
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
    elif kind is Kind.MODAL:
        if words[at] in _HEDGES and stop < len(words) and _counts(words[stop]):
            return stop  # at maybe 40 km/h
    elif words[at] in _ADVERBS:
        if _parenthetic(words, at, stop):
            return stop  # is still crossing, has not yet stopped
    elif words[at] in _OVERTAKING and at and words[at - 1] in _ARTICLES:
        kind, value = Kind.STATE, "same_direction"  # an overtaking motorbike
    hits.append(Hit(kind, value, form, at, stop))
    return stop


def _counts(word: str) -> bool:
    return "0" <= word[0] <= "9" or word in _FIGURES


def _add_verb(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    kind, value, form = entry
    if stop == at + 1:
        if is_noun(words, at, value):
            return stop
        if value == "wait" and words[at : stop + 1] == ["wait", ","]:
            kind = Kind.REVISE
        elif value == "cross" and form == "ing" and at and words[at - 1] in _PRONE_TO_NOUN:
            next_word = words[stop] if stop < len(words) else ""
            if next_word not in ENTRIES or next_word in _ROADS:
                return stop
    hits.append(Hit(kind, value, form, at, stop))
    return stop


def _add_object(words: list[str], at: int, stop: int, entry: Entry, hits: list[Hit]) -> int:
    kind, value, _ = entry
    ridden = road_users.together(words, stop, value) if value in _RIDERS else None
    if ridden is not None:
        kind = _OBJECT
        value, stop = ridden
    if road_users.vague(words, at) or road_users.is_part(words, at, stop):
        return stop
    form = _article(words, at)
    if kind is _OBJECT and hits and hits[-1].stop == at and hits[-1].kind is _OBJECT:
        hits.pop()  # flatbed tow truck: the last noun is the head
    hits.append(Hit(kind, value, form, at, stop))
    return stop


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


def _side(words: list[str], at: int, hits: list[Hit]) -> int:
    entry, stop = longest(words, at)
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
