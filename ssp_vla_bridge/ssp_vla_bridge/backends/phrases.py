"""Full sentences for the closed slots, in words that LABELLING.md settles."""

from __future__ import annotations

_NOUNS = {
    "car": "a car",
    "truck": "a truck",
    "bus": "a bus",
    "motorcycle": "a motorcycle",
    "cyclist": "a cyclist",
    "pedestrian": "a pedestrian",
}
_PLACES = {
    "front": "directly ahead of me",
    "front_left": "ahead on the left",
    "front_right": "ahead on the right",
    "left": "alongside on my left",
    "right": "alongside on my right",
    "rear": "behind me",
    "rear_left": "behind me on the left",
    "rear_right": "behind me on the right",
}
_MOTIONS = {
    "stationary": "is stationary",
    "same_direction": "is moving in the same direction as me",
    "oncoming": "is oncoming",
    "cutting_in_from_left": "is cutting in from the left",
    "cutting_in_from_right": "is cutting in from the right",
    "cutting_out": "is cutting out of my lane",
    "crossing_from_left": "is crossing from the left",
    "crossing_from_right": "is crossing from the right",
    "receding": "is pulling away from me",
}
_CONFLICTS = {
    "no_conflict": "There is no risk of a collision.",
    "potential": "There is a risk of a collision{with_it}.",
    "active": "A collision{with_it} is imminent.",
    "resolved": "The conflict{with_it} has cleared.",
}
_LON = {
    "stop": "I stop",
    "decelerate": "I slow down",
    "maintain": "I keep my speed",
    "accelerate": "I accelerate",
}
_LAT = {
    "straight": "stay in my lane",
    "left": "steer to the left",
    "right": "steer to the right",
}


def noun(object_class: str) -> str:
    """``a car`` for ``car``; a class without a word of its own is an object."""
    return _NOUNS.get(object_class, "an object")


def action_sentence(lon_action: str, lat_action: str) -> str:
    """The VUT's own action: ``I slow down and stay in my lane.``"""
    return f"{_LON[lon_action]} and {_LAT[lat_action]}."


def object_sentence(object_class: str, position: str | None, motion: str | None) -> str:
    """Where an object is and how it moves; what is None is left out."""
    subject = noun(object_class)
    subject = subject[0].upper() + subject[1:]
    if position is None and motion is None:
        return f"{subject} matters to me."
    if position is None:
        return f"{subject} {_MOTIONS[motion or '']}."
    if motion is None:
        return f"{subject} is {_PLACES[position]}."
    return f"{subject} is {_PLACES[position]} and {_MOTIONS[motion]}."


def watch_sentence(classes: list[str]) -> str:
    """Further objects that matter: ``I also watch a car and a truck.``"""
    return f"I also watch {' and '.join(noun(word) for word in classes)}."


def conflict_sentence(conflict: str, object_class: str) -> str:
    """Whether there is a conflict with the object, or with anything if no class is given."""
    it = noun(object_class).split(" ", 1)[1]
    return _CONFLICTS[conflict].format(with_it=f" with the {it}" if object_class else "")


NOBODY_SENTENCE = "There are no road users that matter to me."
