"""Stage 6: from what was read to the six slots, with the words that support each."""

from __future__ import annotations

from collections.abc import Callable

from ssp_core.vocabulary import OBJECTS
from ssp_eval.extract.rules.motion.verb_meaning import (
    COMES_FROM,
    CROSSING,
    CUTTING_IN,
    MOVING_BESIDE,
)
from ssp_eval.extract.rules.world import Actor, Commitment, Statement, World

Found = tuple[str | tuple[str, ...], tuple[Statement | Commitment, ...]]

_PARTNER = {"active": 3, "potential": 2, "resolved": 1}
_NEVER_ALONG = frozenset({"pedestrian"})


def decide(world: World) -> dict[str, Found]:
    """The value of each slot that the text fills, with its support in words (LABELLING.md)."""
    found: dict[str, Found] = {}
    nobody = _nobody(world)
    objects = _objects(world) if nobody is None else []
    if objects:
        names = tuple(name for name in OBJECTS if any(a.name == name for a in objects))
        support = tuple(next(_mention(a) for a in objects if a.name == name) for name in names)
        found["objects"] = names, support
    elif nobody is not None:
        found["objects"] = (), (nobody,)
    critical = _critical(objects)
    about = [world.loose] if critical is None else [critical, world.loose]
    readers: dict[str, Callable[[Actor], Found | None]] = {
        "position": _position,
        "motion": _motion,
        "conflict": _conflict,
    }
    for slot, read in readers.items():
        for actor in about:
            value = read(actor)
            if value is not None:
                found[slot] = value
                break
        if slot not in found and critical is not None and slot in ("position", "motion"):
            told = _told_before(world, critical, slot, read)
            if told is not None:
                found[slot] = told
    if critical is None and "conflict" not in found:
        for actor in world.actors:
            harmless = _conflict(actor)
            if harmless is not None and actor.mentions:
                found["conflict"] = harmless
    for slot in ("lon_action", "lat_action"):
        action = _action(world, slot)
        if action is not None:
            found[slot] = action
    return found


def _told_before(
    world: World, critical: Actor, slot: str, read: Callable[[Actor], Found | None]
) -> Found | None:
    """What was told of the only other mention of such a road user: most likely it is the same."""
    if critical.places if slot == "position" else critical.motions:
        return None
    others = [
        actor
        for actor in world.actors
        if actor.name == critical.name
        and actor is not critical
        and actor.mentions
        and actor.plural == critical.plural
        and not (actor.gone or actor.background or actor.parked)
        and not (actor.colour and critical.colour and actor.colour != critical.colour)
        and not _apart(actor, critical)
    ]
    told = [found for found in map(read, others) if found is not None]
    return told[0] if len(told) == 1 and len(others) == 1 else None


def _nobody(world: World) -> Statement | None:
    """The words that say that nobody is there, if nothing else speaks of anybody."""
    said = world.nobody
    if said is None or said.value == "listed":
        return said
    named = [actor for actor in world.actors if actor.mentions]
    if (said.value and named) or not all(a.gone or a.background for a in named):
        return None
    return said


def _apart(one: Actor, other: Actor) -> bool:
    """Whether two are in places that exclude each other."""
    if not one.places or not other.places:
        return False
    parts = set(f"{one.places[-1].value}_{other.places[-1].value}".split("_"))
    return {"left", "right"} <= parts or {"front", "rear"} <= parts


def _objects(world: World) -> list[Actor]:
    """Who is present and matters: marked as such, or all where the text marks nobody."""
    present = [a for a in world.actors if a.mentions or (a.first_named and _is_over(a))]
    present = [a for a in present if not (a.gone or (a.background and not _partner(a)))]
    present = [a for a in present if not a.parked or _marked(a)]
    if not any(_marked(actor) for actor in present):
        return present
    return [a for a in present if _marked(a) or (a.motions and a.places and not a.parked)]


def _mention(actor: Actor) -> Statement:
    """The words that name an actor as present, or those that name whom a conflict was with."""
    return next(iter(actor.mentions), actor.first_named or actor.conflicts[0])


def _marked(actor: Actor) -> bool:
    if actor.parked:
        return actor.critical or actor.matters or actor.reaction == 2 or _partner(actor)
    return bool(
        actor.critical or actor.matters or actor.reaction or actor.intruding or _partner(actor)
    )


def _is_over(actor: Actor) -> bool:
    return any(said.value == "resolved" for said in actor.conflicts)


def _partner(actor: Actor) -> bool:
    return any(said.value in _PARTNER for said in actor.conflicts)


def _critical(objects: list[Actor]) -> Actor | None:
    """The conflict partner, else what the plan reacts to, else the first critical object."""
    if not objects:
        return None
    return max(
        objects,
        key=lambda a: (
            max((_PARTNER.get(said.value, 0) for said in a.conflicts[-1:]), default=0),
            a.reaction == 2 and not a.parked,
            a.intruding and a.reaction > 0,
            a.critical and not a.parked,
            a.reaction == 2,
            a.reaction,
            a.intruding,
            a.critical,
            -a.order,
        ),
    )


def _position(actor: Actor) -> Found | None:
    """The last sentence's place, put together from its parts: ahead + on the right."""
    if not actor.places:
        return None
    last = actor.places[-1].sentence
    said = [place for place in actor.places if place.sentence == last]
    parts = {part for place in said for part in place.value.split("_")}
    if {"left", "right"} <= parts or {"front", "rear"} <= parts:
        return None
    order = ("front", "rear", "left", "right")
    return "_".join(part for part in order if part in parts), tuple(said)


def _motion(actor: Actor) -> Found | None:
    """The last motion that is complete: some need company (ahead, beside) or a side."""
    values: dict[str, Statement] = {}
    for said in actor.motions:
        value = _complete(said.value, actor)
        weak = said.value == MOVING_BESIDE and set(values) - {"same_direction"}
        if value is not None and not weak:
            values.pop(value, None)
            values[value] = said
    if not values:
        return None
    value, said = list(values.items())[-1]
    for specific, other in values.items():
        if value == "same_direction" and specific != value and other.sentence == said.sentence:
            return specific, (other,)
    return value, (said,)


def _complete(value: str, actor: Actor) -> str | None:
    places = _position(actor)
    place = str(places[0]) if places is not None else ""
    if value == MOVING_BESIDE:
        along = place and not place.startswith("rear") and actor.name not in _NEVER_ALONG
        return "same_direction" if along else None
    if value == CUTTING_IN:
        side = _origin(actor) or (
            "left" if "left" in place else "right" if "right" in place else ""
        )
        return f"cutting_in_from_{side}" if side else None
    if value == CROSSING:
        side = _origin(actor)
        return f"crossing_from_{side}" if side else None
    if value.startswith(COMES_FROM):
        return None
    return value


def _origin(actor: Actor) -> str:
    """Where an actor came from, if that was told apart from its crossing or cutting in."""
    told = {said.value for said in actor.motions if said.value.startswith(COMES_FROM)}
    return told.pop().removeprefix(COMES_FROM) if len(told) == 1 else ""


def _conflict(actor: Actor) -> Found | None:
    if not actor.conflicts:
        return None
    said = actor.conflicts[-1]
    if said.value == "potential":  # a possible turn of what is active already
        said = next((one for one in actor.conflicts if one.value == "active"), said)
    for other in actor.conflicts:
        if other.sentence == said.sentence and other.value == "active":
            said = other
    return said.value, (said,)


def _action(world: World, slot: str) -> Found | None:
    """The final plan's first step; slowing down and then stopping is a stop."""
    said = [one for one in world.commitments if one.slot == slot]
    units = {one.unit for one in world.commitments}
    revision = max((unit for unit in world.revised if unit in units), default=0)
    said = [one for one in said if one.unit >= revision]
    said = [one for one in said if one.final] or said
    now = [one for one in said if not one.later]
    if slot == "lat_action":  # a later manoeuvre counts when it is the only lateral one
        now = now or said
    if not now:
        return None
    last = now[-1].unit
    steps = [one for one in said if one.unit == last]
    first = next((one for one in steps if not one.later), steps[0])
    if first.value == "decelerate":
        for step in steps:
            if step.value == "stop" and step.linked and step.first >= first.first:
                return "stop", (first, step)
    return first.value, (first,)
