"""Stage 2: words that look like verbs and are nouns: the stop, a turn, a parking bay."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Kind
from ssp_eval.extract.rules.words.vocabulary import ENTRIES

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
        "exit",
        "approach",
        "step",
        "steps",
        "trail",
        "cycle",
        "queue",
        "pause",
        "halt",
        "rest",
        "load",
    }
)
# A place where one parks or waits: the verb before it only says what it is for.
_PLACES_FOR = frozenset({"park", "serve", "wait", "step", "rest", "turn", "cross", "stop", "merge"})
_SPOTS = frozenset(
    {"bay", "bays", "space", "spaces", "spot", "spots", "lot", "lots", "area", "areas", "zone"}
    | {"zones", "place", "places", "garage", "pocket", "strip", "island", "islands", "pace"}
)
_MAKE_ADJECTIVES = frozenset({"is", "are", "too", "rather", "quite", "but", "be"})


def is_noun(words: list[str], at: int, value: str) -> bool:
    """The stop, a turn, slow traffic: words that look like verbs and aren't."""
    word = words[at]
    before = words[at - 1] if at else ""
    after = words[at + 1] if at + 1 < len(words) else ""
    if word == "slow":
        entry = ENTRIES.get(after)
        return (
            before in _NOUN_MARKERS
            or before in _MAKE_ADJECTIVES  # it is slow, safe but slow
            or after in ("speed", "moving", "pace")
            or (entry is not None and entry[0] in (Kind.OBJECT, Kind.SCENE))
        )
    if value in _PLACES_FOR and after in _SPOTS:
        return True  # out of a parking bay
    return word in _NOUNY and before in _NOUN_MARKERS
