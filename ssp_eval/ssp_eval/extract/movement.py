"""The motion that a verb with its goals says of a road user, and when it is over."""

from __future__ import annotations

from ssp_eval.extract.clause import PASSES, PEOPLE
from ssp_eval.extract.match import Hit
from ssp_eval.extract.world import Actor

# Motions that need company or a side, see decide.py.
ALONG, CROSSING, CUTTING_IN, COMING = "along", "crossing", "cutting_in", "coming"
BLOCKING = "blocking"
OTHER_SIDE = {"left": "right", "right": "left"}
_STOOD = frozenset({"stood", "waited", "sat", "lingered", "loitered", "hovered", "hesitated"})
_LIES = frozenset({"lie", "lies", "lay"})
_PERFECT = frozenset({"has", "have", "just"})
_BEGUN = frozenset({"entered", "started", "begun"})
_ONTO = frozenset({"onto", "on", "into", "out", "off", "from"})
_EMERGES = ("com", "approach", "circul", "emerg", "dart", "shoot", "shot", "burst")
_MERGES = ("merg", "join", "intrud", "encroach", "filter")
_FROM = frozenset({"from", "of"})
_INTO = frozenset({"into", "onto", "over", "across"})
_OVER = frozenset({"over", "across"})
_NAMES = frozenset({"user", "pronoun", "relative"})
_GAPS = frozenset({"gap", "gaps", "break", "opening", "space", "chance"})


def motion_of(actor: Actor, kind: str, goals: list[Hit], hit: Hit, words: list[str]) -> str | None:  # noqa: C901  # a table of cases, one a line
    """Return the motion that a verb says, None where it says none.

    Args:
        actor: who moves.
        kind: of movement that the verb is as another's.
        goals: the places and directions that belong to it.
        hit: the verb.
        words: of the text.
    """
    names = {goal.value for goal in goals if goal.kind == "goal"}
    side = next((g.value for g in goals if g.kind in ("across", "from")), "")
    both = any(goal.kind == "across" for goal in goals)
    end = next((goal.value for goal in goals if goal.kind == "towards"), "")
    people = actor.name in PEOPLE
    light = people or actor.name == "cyclist"
    if kind in ("stand", "parked"):
        return ALONG if hit.value == "stop" and hit.form == "ing" else "stationary"
    if passed_side(hit, words):
        return "same_direction"
    if words[hit.first].startswith("wait") and not _GAPS.isdisjoint(words[hit.stop : hit.stop + 3]):
        return "stationary"  # waits for a gap
    if kind in ("oncoming", "recede", "with"):
        return {"recede": "receding", "with": "same_direction"}.get(kind, kind)
    if kind == "leave":
        return None if people else "cutting_out"
    over = any(
        goal.value == "line"
        or (goal.value == "into_ours" and _INTO.intersection(words[goal.first : goal.stop]))
        for goal in goals
    )
    if kind == "cross" and over and not light:
        kind = "intrude"  # but crossing in front of us
    if kind == "cross":
        side = side or OTHER_SIDE.get(end, "")
        return f"crossing_from_{side}" if side else CROSSING
    if kind in ("go", "drift", "step", "along") and not side:
        if "towards_us" in names and kind != "drift":
            return "oncoming"
        if "away" in names:
            return "receding"
    if (
        kind == "drift"
        and not light
        and any(goal.value == "line" and words[goal.first - 1] in _OVER for goal in goals)
    ):
        kind = "intrude"
    if "out_of_ours" in names and not people:
        return "cutting_out"
    if kind == "intrude" or (kind in ("drift", "go", "step") and "into_ours" in names):
        word = CROSSING if people else CUTTING_IN
        return f"{word}_from_{side}" if side else word
    enters = light and words[hit.first].startswith("enter")
    if kind == "drift" and not both and not enters:
        names.discard("across")
    if kind in ("step", "go", "drift") and (both or "across" in names):
        side = side or OTHER_SIDE.get(end, "")
        return f"crossing_from_{side}" if side else CROSSING if people else None
    if not people and not _FROM.isdisjoint(words[hit.stop - 1 : hit.stop + 1]):
        side = side or _side_of_origin(goals)
    if kind == "drift" and side:
        merges = words[hit.first].startswith(_MERGES) or "over" in words[hit.first : hit.stop]
        if people:
            return f"{CROSSING}_from_{side}" if merges else None
        return f"{CUTTING_IN}_from_{side}" if merges else None
    if people and kind in ("go", "step") and side:
        return f"{CROSSING}_from_{side}"
    if kind in ("go", "near", "step") and side and _comes_straight(actor, hit, goals, words):
        return f"{COMING}_from_{side}"
    if kind == "near" and not side and is_behind(actor, goals):
        return "same_direction"
    if kind in ("along", "go") and not side:
        return ALONG
    return None


def _side_of_origin(goals: list[Hit]) -> str:
    """Return the side of what somebody comes from: merges from the ramp on the right."""
    places = (g.value for g in goals if g.kind == "place" and not g.value.startswith("rear"))
    return next((side for place in places if (side := place.rpartition("_")[2]) in OTHER_SIDE), "")


def passed_side(hit: Hit, words: list[str]) -> str:
    """Return the side on which somebody overtakes: is overtaking on the left; empty: none."""
    side = hit.value.removeprefix("to_")
    passes = side in OTHER_SIDE and words[hit.first].startswith(PASSES)
    return side if passes and "on" in words[hit.first : hit.stop] else ""


def is_behind(actor: Actor, goals: list[Hit]) -> bool:
    """Tell whether one who comes nearer comes from behind us."""
    places = [goal.value for goal in goals if goal.kind == "place"]
    last = (places or [place.value for place in actor.places] or [""])[-1]
    return last.startswith("rear")


def _comes_straight(actor: Actor, hit: Hit, goals: list[Hit], words: list[str]) -> bool:
    """Tell whether somebody comes from the side, as on the cross street, not from a lane."""
    lane = any("lane" in words[goal.first : goal.stop] for goal in goals)
    return not lane and not is_behind(actor, goals) and words[hit.first].startswith(_EMERGES)


def is_over_by_then(hit: Hit, kind: str, before: Hit, words: list[str]) -> bool:
    """Tell whether a verb tells of the past, or of a thing: stood there; the road lies open.

    Args:
        hit: the verb.
        kind: of movement that it is as another's.
        before: the hit before it.
        words: of the text.
    """
    word = words[hit.first]
    if word in _LIES:
        return before.kind not in _NAMES or hit.first - before.stop > 1
    begins = word in _BEGUN or (
        kind == "step" and not _ONTO.isdisjoint(words[hit.stop : hit.stop + 1])
    )
    if begins and words[hit.first - 1] in _PERFECT:
        return False  # has stepped onto the crossing, and is there now
    stands = kind in ("stand", "parked")
    return hit.form == "ed" and (not stands or (word in _STOOD and before.value != "is"))


def rear_side(hit: Hit, words: list[str]) -> str:
    """Return the place from which somebody comes up: approaches from the rear left."""
    side = words[hit.stop] if hit.stop < len(words) else ""
    ends = words[hit.stop - 1] in ("rear", "behind")
    return f"rear_{side}" if ends and side in OTHER_SIDE else "rear"
