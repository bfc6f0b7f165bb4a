"""Stage 5b: which road user a noun or pronoun names."""

from __future__ import annotations

from ssp_eval.extract.hits import Hit, Kind
from ssp_eval.extract.lexicon import LEADING, phrases
from ssp_eval.extract.nouns import plurals
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
_CLAUSES = frozenset(
    {"and", "but", "so", "because", "as", "that", "since", "while", "whereas", "though", "when"}
    | {"although", "if", "until", "where", "is", "are", "was", "there", "then", "unless"}
)
_OTHERS = frozenset({"another", "other", "second", "additional"})
_AFTER_LABEL = frozenset({"is", "has", "may", "might", "could", "will", ",", ":", ")", "(", "."})
COLOURS = frozenset(
    phrases(
        "white, black, silver, grey, gray, red, blue, green, yellow, orange, brown, beige, maroon"
    )
)
_SINGULARS = plurals()
# Kinds that no vehicle is two of; a car or a vehicle may be any of them.
_KINDS = frozenset(
    phrases(
        "sedan, hatchback, suv, van, taxi, pickup, cab, jeep, coupe, convertible, minivan, mpv, "
        "campervan, camper, saloon, wagon"
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
MAX_RECENT = 12
MAX_PHRASE = 5


def resolve(
    world: World,
    words: list[str],
    hit: Hit,
    place: str | None,
    fresh: bool = False,
    ahead: bool = False,
) -> Actor:
    """The actor that a noun names: one known already, or a new one.

    Args:
        world: what has been read so far; a new actor is added.
        words: words of the text.
        hit: the noun, form definite, indefinite or empty (bare).
        place: where the noun's own phrase puts it; a known actor elsewhere is another one.
        fresh: it opens an item of a list, so that it isn't one that has been listed.
        ahead: it is called the lead vehicle.
    """
    recent = world.actors[-MAX_RECENT:]
    label = _label(words, hit.stop)
    named = _describe(words, hit)
    if label:
        for actor in reversed(recent):
            if actor.name == hit.value and actor.label == label:
                return actor
    elif hit.form != "indefinite" and not _OTHERS & set(words[max(hit.first - 3, 0) : hit.first]):
        for actor in reversed(recent):
            known = actor.name == hit.value and _fits(actor, place) and _same(actor, *named)
            another = (fresh and actor.critical) or (ahead and not _is_ahead(actor))
            if known and not another:
                return actor
        if words[hit.stop - 1] in ("bike", "rider") and hit.form == "definite":
            for actor in reversed(recent):
                if actor.name in ("motorcycle", "cyclist"):
                    return actor
        if words[hit.stop - 1] in _GENERIC and hit.form == "definite":
            for actor in reversed(recent):
                if actor.name in _MOTORISED and _fits(actor, place):
                    return actor
    actor = Actor(hit.value, len(world.actors), label, *named)
    actor.first_named = Statement(hit.value, hit.first, hit.stop, -1)
    world.actors.append(actor)
    return actor


def _describe(words: list[str], hit: Hit) -> tuple[str, str, bool]:
    """The noun in the singular, its colour, and whether it stood in the plural."""
    noun = words[hit.stop - 1]
    colour = ""
    for before in range(hit.first - 1, max(hit.first - 5, -1), -1):
        if words[before] in COLOURS:
            colour = words[before]
            break
        if words[before] in PREPOSITIONS or not words[before].isalpha():
            break
    return _SINGULARS.get(noun, noun), colour, noun in _SINGULARS


def _same(actor: Actor, noun: str, colour: str, plural: bool) -> bool:
    """Whether a description doesn't contradict the one that an actor was introduced with."""
    if actor.plural != plural or (colour and actor.colour and colour != actor.colour):
        return False
    if actor.parked and colour and not actor.colour and actor.noun != noun:
        return False  # the parked van, and the white car
    return actor.noun == noun or not (actor.noun in _KINDS and noun in _KINDS)


def _is_ahead(actor: Actor) -> bool:
    return not actor.places or actor.places[-1].value == "front"


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
