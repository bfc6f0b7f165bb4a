"""Stage 3a: what left, right, ahead and behind are relative to, and whether they mean a place."""

from __future__ import annotations

from ssp_eval.extract.rules.words.ego_and_scene import EGO_WORDS
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.road_users import NOUNS

_FILLERS = frozenset(
    phrases(
        """
        our, my, the, your, its, their, his, her, adjacent, immediate, far, next, same,
        near, neighbouring, neighboring, other, outer, inner, immediately, directly,
        extreme, opposite, a, slightly, very, host, ego, adjoining, parallel, just,
        straight, hard, slight, gently, far, one, opposing, same, both, second, first, outermost,
        innermost, more, little, bit, somewhat, roughly, about, well, current, vut, vehicle, car
        """
    )
)
_FORMS = {
    "from": "from",
    "to": "to",
    "into": "into",
    "onto": "into",
    "toward": "into",
    "towards": "into",
    "on": "at",
    "in": "at",
    "at": "at",
    "along": "at",
    "near": "at",
    "by": "at",
    "beside": "at",
    "over": "into",
}
_HEADS = frozenset(
    phrases(
        """
        lane, lanes, shoulder, side, curb, kerb, sidewalk, pavement, edge, roadside,
        margin, verge, footpath, border, boundary, adjacent, kerbside, curbside, half, track,
        cycleway, walkway, footway, road, street, corner, bank, sidewalks, carriageway, adjoining,
        neighbouring, neighboring, parallel, cycle, bike, hand, most, parking, flank
        """
    )
)
# What a side may be "of" and still be seen from the VUT.
_FRAME_NOUNS = frozenset(
    phrases(
        """
        road, street, lane, image, frame, picture, view, roadway, intersection, scene,
        junction, crosswalk, highway, screen, us, me, ours, mine, carriageway, pavement, zebra,
        crossing, avenue, motorway, freeway, aisle, bridge, windscreen, windshield, camera,
        travel, lanes, track, boulevard, alley, passage
        """
    )
)
_NO_SIDE_AFTER_RIGHT = frozenset(
    phrases("of, now, away, ahead, behind, before, after, next, here, there, in")
)
_VERB_BEFORE_LEFT = frozenset(
    phrases(
        """
    has, have, had, just, already, is, was, having, been, are
    """
    )
)
_OPPOSITE = {
    "left": ("right", "r"),
    "right": ("left", "l"),
    "l": ("r", "right"),
    "r": ("l", "left"),
}
SIDES = {
    "left": "left",
    "right": "right",
    "l": "left",
    "r": "right",
    **{f"{side}ward{ending}": side for side in ("left", "right") for ending in ("", "s")},
}
_TO = frozenset(phrases("to, >, towards, toward, into, 2"))
_ARTICLES = frozenset(
    phrases(
        """
        the, a, an, that, this, its, another, their, it, them, him, her, which, these,
        those, some, two
        """
    )
)
_CLOSE = frozenset(phrases("close, closer, near, nearer, next, adjacent"))
_OTHERS = frozenset(phrases("its, their, his, her"))  # seen from somebody else
_PARTS = frozenset(
    phrases(
        """
        vehicle, car, agent, lane, path, bumper, bonnet, hood, front, driving, own, current, van,
        truck, driver, position, line, nose, trajectory
        """
    )
)
# Adjectives that look like places: the rear wheel, the front door.
_PLACE_NOUNS = frozenset(phrases("front, rear"))
_PLACED_PARTS = frozenset(
    phrases(
        """
        wheel, wheels, bumper, door, doors, end, axle, camera, cameras, window, windows, view,
        lights, light, lamps, half, part, seat, mirror, tyre, tyres, tire, tires, facing, quarter,
        overhang, corner, images, image, and, windscreen, plate, fender, wing
        """
    )
)
_ENDS = frozenset(phrases("side, hand, edge, kerb, curb"))
_ARTICLES_OF_SIDES = frozenset(phrases("the, our, my"))
_SIDED = frozenset(phrases("on, in, ahead, that, which, at, to, behind"))
_VEHICLES = frozenset(phrases("vehicle, car"))
MAX_BACK = 4
MAX_HEADS = 4
MAX_OF = 5


def side(words: list[str], at: int) -> tuple[str, str, int, int] | None:
    """What the ``left`` or ``right`` at an index means: (side, form, first word, stop word).

    The forms: ``from`` a motion's origin; ``to`` a place or a target; ``into`` a target; ``at`` a
    place; ``bare``; ``lane`` a lane or side named before a noun. None where it is no direction, or
    one that is relative to somebody else.
    """
    word = SIDES[words[at]]
    if len(words[at]) > 5:
        return word, "into", at, at + 1  # leftwards
    across = _across(words, at)
    if across is not None:
        return word, "from", *across
    if len(words[at]) == 1 and not _initial(words, at):
        return None
    first = at
    form = "bare"
    for back in range(at - 1, max(at - 1 - MAX_BACK, -1), -1):
        if words[back] in _FORMS:
            first, form = back, _FORMS[words[back]]
            break
        if words[back] not in _FILLERS:
            break
    count = len(words)
    stop = at + 1
    if form == "bare":
        if word == "right" and stop < count and words[stop] in _NO_SIDE_AFTER_RIGHT:
            return None
        if word == "left" and at and words[at - 1] in _VERB_BEFORE_LEFT:
            return None
    stop = _heads(words, stop)
    if stop > at + 1 and form == "bare":
        form = "lane"
    if form == "to" and first and words[first - 1] in _CLOSE:
        form = "at"
    between = set(words[first:at])
    if not _VEHICLES.isdisjoint(between) and EGO_WORDS.isdisjoint(between):
        return None  # on the car's left
    whose = _OTHERS & between
    if whose and (form == "at" or (form == "to" and whose != {"its"})):
        return None
    if stop < count and words[stop] == "of":
        end = _of_ours(words, stop + 1)
        if end is None:
            return None
        stop = end
        beside = form == "bare" and first and words[first - 1] in ("lane", "just", "slightly")
        form = "at" if form == "to" or beside else form
    return word, form, first, stop


def _initial(words: list[str], at: int) -> bool:
    """from R, on L: a letter that stands for a side."""
    return at > 0 and words[at - 1] in _FORMS


def _across(words: list[str], at: int) -> tuple[int, int] | None:
    """The words of "left to right", "from the left side to the right", "L -> R"."""
    count = len(words)
    here = at + 1
    while here < count and here <= at + 2 and words[here] in _ENDS:
        here += 1
    if here >= count or words[here] not in _TO:
        return None
    here += 1
    while here < count and words[here] in _ARTICLES_OF_SIDES:
        here += 1
    if here >= count or words[here] not in _OPPOSITE[words[at]]:
        return None
    stop = here + 1
    while stop < count and words[stop] in _ENDS:
        stop += 1
    first = at
    while first > 0 and at - first < 3 and words[first - 1] in _ARTICLES_OF_SIDES:
        first -= 1
    if first > 0 and words[first - 1] == "from":
        first -= 1
    else:
        first = at
    return first, stop


def own_end(words: list[str], stop: int) -> bool:
    """Whether the vehicle that a place ends with is said to be the ego's."""
    return bool(EGO_WORDS & set(words[max(stop - 3, 0) : stop]))


def _the_car(words: list[str], at: int) -> bool:
    """in front of the car, in front of car: the VUT's, if no other car has been named."""
    at += words[at] == "the"
    if at >= len(words) or words[at] not in ("car", "vehicle"):
        return False
    return words[at - 1] in ("of", "the") and not (at + 1 < len(words) and words[at + 1] in _SIDED)


def _heads(words: list[str], stop: int) -> int:
    """The word after lane, kerb, adjacent lane … that a side stands before."""
    for _ in range(MAX_HEADS):
        if stop >= len(words) or words[stop] not in _HEADS:
            break
        stop += 1
    return stop


def _of_ours(words: list[str], at: int) -> int | None:
    """The word after what a side is of, if that is the ego, the road or the picture."""
    for here in range(at, min(at + MAX_OF, len(words))):
        word = words[here]
        if word in EGO_WORDS or word in _FRAME_NOUNS:
            return _own_part(words, here + 1)
        if not word.isalpha() or word in _OTHERS:
            return None
    return None


def _own_part(words: list[str], stop: int) -> int:
    """The word after vehicle, lane, bumper … behind a word for the ego."""
    for _ in range(MAX_HEADS):
        if stop >= len(words) or words[stop] not in _PARTS:
            break
        stop += 1
    return stop


def place_stop(words: list[str], stop: int, value: str) -> int | None:
    """The word after a place such as ``ahead`` with its ``of us``; None if it is of another.

    Args:
        words: all words.
        stop: word after the place itself.
        value: the place; ``behind the van`` is no place relative to the VUT, ``ahead`` alone is.
    """
    count = len(words)
    if stop >= count:
        return stop
    after = words[stop]
    if words[stop - 1] in _PLACE_NOUNS and after in _PLACED_PARTS:
        return None
    if after == "of":
        stop += 1
        if stop >= count:
            return None
        after = words[stop]
    elif value != "rear":
        return stop
    if after in EGO_WORDS:
        return _own_part(words, stop + 1)
    if after == "the" and stop + 1 < count and (words[stop + 1] in EGO_WORDS):
        return _own_part(words, stop + 2)
    if value.startswith("front") and _the_car(words, stop):
        return stop + 1 + (after == "the")
    if (
        words[stop - 1] == "of"
        or after in _ARTICLES
        or after in NOUNS
        or after in ("parked", "stopped")
    ):
        return None
    return stop
