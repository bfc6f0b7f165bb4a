"""The slots that follow from what was gathered."""

from __future__ import annotations

from ssp_eval.extract.movement import (
    ALONG,
    BLOCKING,
    COMING,
    CROSSING,
    CUTTING_IN,
    OTHER_SIDE,
)
from ssp_eval.extract.world import Actor, Statement, World

Found = tuple[str | tuple[str, ...], tuple[Statement, ...]]
_PARTNER = {"active": 3, "potential": 2, "resolved": 1}
MAX_OTHERS = 3
FEW_SENTENCES = 2
MAX_SENTENCES = 6  # of a text in which nobody is named by the way
_NEVER_ALONG = frozenset({"pedestrian"})


def decide(world: World) -> dict[str, Found]:
    """Each slot that the text fills, with the words that say so."""
    slots: dict[str, Found | None] = {}
    objects = _objects(world)
    critical = _critical(objects)
    road_users = objects if _sure(objects, world) else _described(objects, world)
    bare = not any(_has(actor) or actor.reaction or actor.critical for actor in road_users)
    if world.nobody and road_users and bare:
        slots["objects"] = ((), (world.nobody[0],))  # it names them, and says that nobody is there
    elif road_users:
        names = tuple(sorted({actor.name for actor in road_users}))
        mentions = tuple(
            next(a for a in road_users if a.name == name).mentions[0] for name in names
        )
        slots["objects"] = (names, mentions)
    elif (
        not objects
        and world.nobody
        and not [a for a in world.actors if a.mentions and not a.background]
    ):
        slots["objects"] = ((), (world.nobody[0],))
    if critical is not None:
        slots["position"] = _unmixed(_position(critical, world.frames), critical, world)
        if _is_outdone(slots["position"], critical, objects):
            slots["position"] = None
        slots["motion"] = _unmixed(_motion(critical), critical, world)
    slots["conflict"] = _conflict(critical, world)
    for slot in ("lon_action", "lat_action"):
        slots[slot] = _action(world, slot)
    return {slot: value for slot, value in slots.items() if value is not None}


def critical_of(world: World) -> Actor | None:
    """Return the critical road user of a text, if it has one."""
    return _critical(_objects(world))


def _unmixed(finding: Found | None, critical: Actor, world: World) -> Found | None:
    """Drop what may be said of another, where the text is about many."""
    others = [a for a in world.actors if a is not critical and (a.mentions or a.first)]
    if finding is None or not others or world.sentences <= MAX_SENTENCES:
        return finding
    sentence = finding[1][-1].sentence
    has_mention = sentence > 0 and any(
        one.sentence == sentence for a in others for one in a.mentions
    )
    present = [a for a in others if a.mentions and not a.background]
    return None if (has_mention and present) or len(present) >= MAX_OTHERS else finding


def _is_outdone(position: Found | None, critical: Actor, objects: list[Actor]) -> bool:
    """Tell whether one behind us is the critical one only because it is named first."""
    weak = critical.reaction < 2 and not critical.critical and not critical.conflicts
    behind = position is not None and position[0] == "rear"
    return behind and weak and any(one.order > critical.order for one in objects)


def _described(objects: list[Actor], world: World) -> list[Actor]:
    """List the road users of a short text that it describes: where they are, or what they do."""
    if world.sentences > MAX_SENTENCES:
        return []
    others = [a for a in world.actors if a.mentions and a not in objects]
    few = world.sentences <= FEW_SENTENCES
    described = [a for a in objects if few or _has(a) or a.reaction or a.critical]
    moving = [a for a in others if a.motions or a.conflicts]
    return described + [a for a in moving if not (a.background or a.parked)]


def _has(actor: Actor) -> bool:
    return bool(actor.places or actor.motions or actor.conflicts)


def _strong(actor: Actor) -> bool:
    """Tell whether a road user counts beside others, by more than a word that may mean another."""
    return bool(
        actor.critical
        or actor.reaction == 2
        or any(conflict.value in _PARTNER for conflict in actor.conflicts)
        or (actor.matters and (actor.parked or actor.reaction))
        or (actor.intruding and actor.reaction)
    )


def _sure(objects: list[Actor], world: World) -> bool:
    """Tell whether all who are present are accounted for: as objects, or as of no importance."""
    left = [a for a in world.actors if a.mentions and a not in objects]
    names = {actor.name for actor in objects}
    if any(not (a.background or a.parked or a.name in names) for a in left):
        return False
    return len(names) == 1 or all(_strong(actor) for actor in objects)


def _marked(actor: Actor) -> bool:
    partner = any(conflict.value in _PARTNER for conflict in actor.conflicts)
    if actor.parked:
        return actor.critical or actor.matters or actor.reaction == 2 or partner
    return bool(actor.critical or actor.matters or actor.reaction or actor.intruding or partner)


def _objects(world: World) -> list[Actor]:
    """List the actors that matter: those marked as such, or all where none is marked."""
    present = [
        actor
        for actor in world.actors
        if actor.mentions
        and not (
            actor.background
            and not any(s.value in ("active", "potential") for s in actor.conflicts)
        )
        and (not actor.parked or _marked(actor))
    ]
    if not present and any(one.said.value in ("left", "right") for one in world.commitments):
        return [a for a in world.actors if a.mentions and a.parked and not a.background]
    if not any(_marked(actor) for actor in present):
        return present
    return [a for a in present if _marked(a) or (a.motions and a.places and not a.parked)]


def _critical(objects: list[Actor]) -> Actor | None:
    """Return the conflict partner, else what the plan reacts to, else the first critical object."""
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


def _position(actor: Actor, frames: bool) -> Found | None:
    """Return the last sentence's place, put together from its parts: ahead + on the right."""
    places = [place for place in actor.places if place.value != "beside"]
    if not places and actor.hints and not actor.places and not actor.parked:
        hint = actor.hints[-1]
        # One that overtakes on a side and pulls in isn't there any more.
        return None if hint.value in OTHER_SIDE and actor.intruding else (hint.value, (hint,))
    if not places:
        return None
    parts: dict[int, set[str]] = {}
    for place in places:
        parts.setdefault(place.sentence, set()).update(place.value.split("_"))
    best = last = places[-1].sentence
    if not frames and len({place.sentence for place in actor.places}) <= 2:
        best = max(
            (at for at in parts if parts[at] >= parts[last]), key=lambda at: (len(parts[at]), at)
        )
        if any(not (one <= parts[best] or parts[best] <= one) for one in parts.values()):
            return None
    support = tuple(place for place in places if place.sentence == best)
    order = ("front", "rear", "left", "right")
    return "_".join(part for part in order if part in parts[best]), support


def _motion(actor: Actor) -> Found | None:
    """Return the last motion that is complete: some need company or a side."""
    values: dict[str, Statement] = {}
    over = not actor.ongoing and any(one.value == "resolved" for one in actor.conflicts)
    for statement in actor.motions:
        value = _complete(statement.value, actor)
        if over and value is not None and value.startswith(("crossing", "cutting")):
            continue  # a finished crossing is no motion
        if statement.value == "oncoming" and _has_passed(actor, statement):
            continue
        if value is None or (statement.value == ALONG and set(values) - {"same_direction"}):
            continue
        if statement.value == BLOCKING and values:
            continue
        values.pop(value, None)
        values[value] = statement
    if not values and actor.origin is not None and not actor.motions and not over:
        return f"{CROSSING}_from_{actor.origin.value}", (actor.origin,)
    if not values:
        return None
    value, statement = list(values.items())[-1]
    earlier = {old for old, one in values.items() if one.sentence != statement.sentence}
    if value in ("same_direction", "stationary", "oncoming") and earlier - {value}:
        return None
    for specific, other in values.items():
        if value == "same_direction" and specific != value and other.sentence == statement.sentence:
            return specific, (other,)
    return value, (statement,)


def _has_passed(actor: Actor, statement: Statement) -> bool:
    """Tell whether what was said of a road user is over at the sentence's end: has passed."""
    return any(
        one.value == "resolved"
        and one.sentence == statement.sentence
        and one.first > statement.first
        for one in actor.conflicts
    )


def _complete(value: str, actor: Actor) -> str | None:
    place = "_".join(one.value for one in (*actor.places, *actor.hints))
    if value == ALONG:
        last = actor.places[-1].value if actor.places else ""
        along = last and not last.startswith("rear") and actor.name not in _NEVER_ALONG
        return "same_direction" if along else None
    if value.startswith(COMING):
        enters = any(motion.value.startswith(CUTTING_IN) for motion in actor.motions)
        return value.replace(COMING, CUTTING_IN if enters else CROSSING)
    if value == BLOCKING:
        return (
            "stationary"
            if actor.motions == [one for one in actor.motions if one.value == BLOCKING]
            else None
        )
    if value == CUTTING_IN:
        sides = {side for side in ("left", "right") if side in place}
        return f"cutting_in_from_{sides.pop()}" if len(sides) == 1 else None
    return None if value == CROSSING else value


def _conflict(actor: Actor | None, world: World) -> Found | None:
    statements = list(actor.conflicts) if actor is not None else []
    statements = sorted([*statements, *world.loose], key=lambda one: one.first)
    if not statements:
        return None
    last = statements[-1]
    if actor is not None and _is_of_earlier(last, actor, world):
        return None
    if last.value == "potential":  # a possible turn of what is active already
        last = next((one for one in statements if one.value == "active"), last)
    return last.value, (last,)


def _is_of_earlier(statement: Statement, critical: Actor, world: World) -> bool:
    """Tell whether the end of a conflict is of one who was named before the critical one."""
    return (
        statement.value in ("resolved", "no_conflict")
        and statement in world.loose
        and all(one.sentence > statement.sentence for one in critical.mentions)
        and any(a.order < critical.order and a.mentions for a in world.actors)
    )


def _action(world: World, slot: str) -> Found | None:
    """Return the final plan's first step; slowing down and then stopping is a stop."""
    units = {one.said.sentence for one in world.commitments}
    revision = max((unit for unit in world.revised if unit in units), default=0)
    plan = [c for c in world.commitments if c.slot == slot and c.said.sentence >= revision]
    plan = [one for one in plan if one.final] or plan
    now = [one for one in plan if not one.later] or (plan if slot == "lat_action" else [])
    if not now:
        return None
    unit = now[-1].said.sentence
    first = next(one.said for one in now if one.said.sentence == unit)
    for step in (one.said for one in plan if one.said.sentence == unit):
        if (first.value, step.value) == ("decelerate", "stop") and 0 < step.first - first.stop < 5:
            return "stop", (step,)
    return first.value, (first,)
