"""Stage 5b: which road user a noun names: one known already, or a new one."""

from __future__ import annotations

from ssp_eval.extract.rules.actors.noun_phrases import COLOURS, PREPOSITIONS
from ssp_eval.extract.rules.hits import Hit
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.road_users import plurals
from ssp_eval.extract.rules.world import Actor, Statement, World

_MOTORISED = frozenset({"truck", "bus", "motorcycle"})
_GENERIC = frozenset({"vehicle", "vehicles"})
_OTHERS = frozenset({"another", "other", "second", "additional"})
_AFTER_LABEL = frozenset({"is", "has", "may", "might", "could", "will", ",", ":", ")", "(", "."})
_SINGULARS = plurals()
# Kinds that no vehicle is two of; a car or a vehicle may be any of them.
_KINDS = frozenset(
    phrases(
        "sedan, hatchback, suv, van, taxi, pickup, cab, jeep, coupe, convertible, minivan, mpv, "
        "campervan, camper, saloon, wagon"
    )
)
MAX_RECENT = 12


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
