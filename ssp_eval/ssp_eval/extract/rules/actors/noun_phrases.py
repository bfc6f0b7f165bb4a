"""What stands around a road user's noun: its preposition, its place, its lead."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.place_phrases import LEADING

PREPOSITIONS = frozenset(
    {
        "of",
        "from",
        "for",
        "to",
        "behind",
        "with",
        "by",
        "around",
        "at",
        "near",
        "past",
        "toward",
        "towards",
        "into",
        "on",
        "between",
        "beside",
        "than",
        "against",
        "after",
        "before",
        "in",
    }
)
_CLAUSES = frozenset(
    {"and", "but", "so", "because", "as", "that", "since", "while", "whereas", "though", "when"}
    | {"although", "if", "until", "where", "is", "are", "was", "there", "then", "unless"}
)
COLOURS = frozenset(
    phrases(
        "white, black, silver, grey, gray, red, blue, green, yellow, orange, brown, beige, maroon"
    )
)
_PARTITIVES = frozenset(
    phrases(
        """
        pack, group, row, couple, number, pair, lot, lots, line, queue, stream, bunch, series,
        crowd, column, class, file, cluster, plenty, handful, platoon, convoy, one, two, three,
        both, some
        """
    )
)
# A preposition before one of these governs it and not the noun that comes next.
_UNGOVERNING = frozenset(
    {Kind.PLACE, Kind.SIDE, Kind.IN_LANE, Kind.FRAME, Kind.AUX, Kind.PRONOUN, Kind.EGO}
)
MAX_PHRASE = 5


def own_place(hits: list[Hit], index: int, stop: int) -> str | None:
    """The place that follows a noun at once: the car on the left."""
    following = hits[index + 1] if index + 1 < stop else None
    if following is None or following.first != hits[index].stop:
        return None
    part = hits[index].form == "definite" and following.stop - following.first == 1
    if part and following.value in ("front", "rear"):
        return None  # the taxi's rear
    if following.kind is Kind.PLACE or (following.kind is Kind.SIDE and following.form == "at"):
        return following.value
    return None


def leading(words: list[str], hit: Hit) -> int | None:
    """Index of ``lead`` in front of a noun: the lead vehicle, the leading white car."""
    for before in range(hit.first - 1, max(hit.first - 4, -1), -1):
        if words[before] in LEADING:
            return before
        if words[before] in PREPOSITIONS or not words[before].isalpha():
            return None
    return None


def governed(hits: list[Hit], index: int, start: int, stop: int, words: list[str]) -> bool:
    """Whether a noun stands after a preposition, so that it isn't the subject of what follows."""
    hit = hits[index]
    first = max(hit.first - MAX_PHRASE, 0)
    previous = hits[index - 1] if index > start else None
    if (
        previous is not None
        and previous.stop > first
        and (
            previous.kind in _UNGOVERNING
            or (previous.kind is Kind.JOIN and _finite(hits, index, stop))
        )
    ):
        first = previous.stop  # due to pedestrian is crossing
    for before in range(hit.first - 1, first - 1, -1):
        word = words[before]
        if word in PREPOSITIONS:
            return not (word == "of" and before and words[before - 1] in _PARTITIVES)
        if not word.isalpha() or word in _CLAUSES:
            return False
    return False


def preposition(words: list[str], hit: Hit) -> str:
    """The preposition that governs a noun, or nothing."""
    for before in range(hit.first - 1, max(hit.first - MAX_PHRASE, -1), -1):
        if words[before] in PREPOSITIONS:
            return words[before]
        if not words[before].isalpha():
            break
    return ""


def _finite(hits: list[Hit], index: int, stop: int) -> bool:
    """Whether the verb of a clause follows a noun and its places."""
    for after in range(index + 1, min(index + MAX_PHRASE, stop)):
        hit = hits[after]
        if hit.kind not in (Kind.PLACE, Kind.SIDE, Kind.IN_LANE):
            return hit.kind is Kind.AUX or (hit.kind is Kind.VERB and hit.form == "s")
    return False
