"""Stage 5b: which road user a noun or pronoun names."""

from __future__ import annotations

from ssp_eval.extract.hits import Hit, Kind
from ssp_eval.extract.lexicon import LEADING
from ssp_eval.extract.world import Actor, Statement, World

_MOTORISED = frozenset({"truck", "bus", "motorcycle"})
_GENERIC = frozenset({"vehicle", "vehicles"})
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
_OTHERS = frozenset({"another", "other", "second", "additional"})
_AFTER_LABEL = frozenset({"is", "has", "may", "might", "could", "will", ",", ":", ")", "(", "."})
MAX_RECENT = 12


def resolve(world: World, words: list[str], hit: Hit, place: str | None) -> Actor:
    """The actor that a noun names: one known already, or a new one.

    Args:
        world: what has been read so far; a new actor is added.
        words: words of the text.
        hit: the noun, form definite, indefinite or empty (bare).
        place: where the noun's own phrase puts it; a known actor elsewhere is another one.
    """
    recent = world.actors[-MAX_RECENT:]
    label = _label(words, hit.stop)
    if label:
        for actor in reversed(recent):
            if actor.name == hit.value and actor.label == label:
                return actor
    elif hit.form != "indefinite" and not _OTHERS & set(words[max(hit.first - 3, 0) : hit.first]):
        for actor in reversed(recent):
            if actor.name == hit.value and _fits(actor, place):
                return actor
        if words[hit.stop - 1] in _GENERIC and hit.form == "definite":
            for actor in reversed(recent):
                if actor.name in _MOTORISED and _fits(actor, place):
                    return actor
    actor = Actor(hit.value, len(world.actors), label)
    actor.first_named = Statement(hit.value, hit.first, hit.stop, -1)
    world.actors.append(actor)
    return actor


def _label(words: list[str], at: int) -> str:
    """The A of "Vehicle A", the 2 of "car 2"."""
    word = words[at] if at < len(words) else ""
    if len(word) != 1 or not word.isascii() or not word.isalnum():
        return ""
    after = words[at + 1] if at + 1 < len(words) else ""
    return "" if word in ("a", "i", "m", "s") and after not in _AFTER_LABEL else word


def _fits(actor: Actor, place: str | None) -> bool:
    """Whether a place in the noun's own phrase doesn't contradict where the actor was put."""
    if place is None or not actor.places:
        return True
    known = set(actor.places[-1].value.split("_"))
    told = set(place.split("_"))
    return not ({"left", "right"} <= known | told or {"front", "rear"} <= known | told)


def own_place(hits: list[Hit], index: int, stop: int) -> str | None:
    """The place that follows a noun at once: the car on the left."""
    following = hits[index + 1] if index + 1 < stop else None
    if following is None or following.first != hits[index].stop:
        return None
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


def governed(words: list[str], hit: Hit) -> bool:
    """Whether a noun stands after a preposition, so that it isn't the subject of what follows."""
    for before in range(hit.first - 1, max(hit.first - 6, -1), -1):
        word = words[before]
        if word in PREPOSITIONS:
            return True
        if not word.isalpha() or word in ("and", "but", "so", "because", "as", "that"):
            return False
    return False
