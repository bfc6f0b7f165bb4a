"""Stage 5a: what a verb says about the motion of somebody else."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.words.ego_and_scene import EGO_WORDS
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.others_verbs import ACROSS, ALONG, INTO_LANE, MOVING, STANDING

_STOPPERS = frozenset({Kind.VERB, Kind.OBJECT, Kind.EGO, Kind.JOIN, Kind.REACT, Kind.KEY})
_PLACED = frozenset({Kind.IN_LANE, Kind.PLACE, Kind.EGO})
_OTHER = {"left": "right", "right": "left"}
_ROADS = frozenset(
    phrases(
        """
        road, street, path, roadway, crosswalk, crossing, zebra, carriageway, aisle, junction,
        intersection, highway, alley, track, tracks, lanes, boulevard, avenue
        """
    )
)
_LINES = frozenset(phrases("line, lines, marking, markings, divider"))
_INSIDE = frozenset(phrases("in, within, inside, on, along, of, from, outside, beside, by, near"))
_GOES_ON = (["into"], ["onto"], ["from"])
_ENDS = frozenset(phrases("to, >, towards, toward"))
_ONTO_WORDS = frozenset(phrases("into, onto, in, on"))
_OVER = frozenset(phrases("across, over, through"))
_STILL = frozenset(
    phrases("still, at, by, parked, stopped, stationary, idle, there, waiting, beside, on")
)
_TOWARDS = frozenset(phrases("towards, toward, at, for"))
_NOT_US = frozenset(phrases("lane, path, side, speed, pace, left, right"))
_OPPOSITE = frozenset(phrases("opposite, oncoming, opposing"))
_STRAIGHT = frozenset(phrases("straight, directly, quickly, fast, slowly, right, head, on"))
_PEOPLE = frozenset({"pedestrian"})
_LIGHT = frozenset({"pedestrian", "cyclist"})
_OUR = EGO_WORDS | {"ours", "mine"}
REACH = 8

# The reader's own words for decide.py, which makes motions of them with what else is known.
MOVING_BESIDE = "moving"  # in our direction if it is ahead or beside us
CUTTING_IN = "cutting_in"  # direction open
CROSSING = "crossing"  # direction open
COMES_FROM = "comes_from_"  # where it came from, for an open direction
INTRUSIONS = ("crossing", "cutting_in")
# What has stopped stands still: the only finished movements that last.
FINISHED_STANDING = frozenset({"stop", "park", "stall", "queue"})


def motion_of(
    words: list[str], hits: list[Hit], index: int, start: int, stop: int, name: str
) -> tuple[str, Hit | None] | None:
    """The motion that a verb of somebody else asserts, and the hit with its direction.

    Args:
        words: words of the text.
        hits: all hits.
        index: the verb's.
        start: first hit of its sentence.
        stop: hit after the sentence.
        name: the class of who moves.

    Returns:
        A motion of the vocabulary or one of the reader's own words, and the hit that gives the
        direction; None if the verb says nothing in the vocabulary.
    """
    verb = hits[index]
    lemma = verb.value
    if lemma == "sit" and not _STILL & set(words[verb.stop : verb.stop + 2]):
        return None  # it sits in front of us by now
    if lemma in STANDING:
        if lemma == "stop" and verb.form == "ing":
            return MOVING_BESIDE, None
        return "stationary", None
    if lemma == "recede":
        beyond = words[verb.stop : verb.stop + 3]
        return (
            None if beyond[:1] == ["from"] and not EGO_WORDS & set(beyond) else ("receding", None)
        )
    if lemma in ALONG:
        return "same_direction", None
    origin = _origin(hits, index, start, stop)
    if lemma == "approach":
        return ("oncoming", None) if origin is None else None
    if (lemma in MOVING or lemma == "step") and origin is None and _towards_us(words, verb.stop):
        return "oncoming", None
    if lemma == "near":
        around = words[max(verb.first - 12, 0) : verb.stop + 8]
        return ("oncoming", None) if _OPPOSITE & set(around) and origin is None else None
    if lemma == "cross" and name not in _PEOPLE and _over_line(words, verb.stop):
        lemma = "cut_in"
    if lemma == "cross":
        return (f"crossing_from_{origin[0]}", origin[1]) if origin else (CROSSING, None)
    if lemma == "cut_out":
        return None if name in _PEOPLE else ("cutting_out", None)
    if lemma == "cut_in" and words[verb.stop - 1] in ("into", "on") and not _ours(words, verb.stop):
        lemma = "move"
    if lemma in INTO_LANE and name not in _PEOPLE and _out_of_ours(words, verb.stop):
        return "cutting_out", None
    if lemma == "come_over":
        if words[verb.stop : verb.stop + 1] and words[verb.stop] in ("the", "a", "from"):
            lemma = "move"
        else:
            lemma = "cut_in"
    into_ours = lemma in INTO_LANE and _into_ours(words, verb.stop)
    if into_ours and name in _LIGHT and _OVER & set(words[verb.stop : verb.stop + 2]):
        return (f"crossing_from_{origin[0]}", origin[1]) if origin else (CROSSING, None)
    if lemma == "cut_in" or into_ours:
        kind = "crossing" if name in _PEOPLE else "cutting_in"
        return (f"{kind}_from_{origin[0]}", origin[1]) if origin else (kind, None)
    if lemma == "merge":
        return (f"cutting_in_from_{origin[0]}", origin[1]) if origin else None
    if lemma in ACROSS:
        if origin and (_over_road(words, verb.stop - 1, name) or passes(words, origin[1], name)):
            return f"crossing_from_{origin[0]}", origin[1]
        if origin is None and name in _LIGHT and "across" in words[verb.stop : verb.stop + 3]:
            return CROSSING, None
        if origin and origin[1].form == "from":
            return COMES_FROM + origin[0], origin[1]
    if (lemma in MOVING or (lemma == "step" and name not in _PEOPLE)) and origin is None:
        return MOVING_BESIDE, None
    return None


def _origin(hits: list[Hit], index: int, start: int, stop: int) -> tuple[str, Hit] | None:
    """The side that a movement comes from: ``from the left``, or ``to the right`` turned round."""
    for after in range(index + 1, min(index + REACH, stop)):
        hit = hits[after]
        if hit.kind is Kind.SIDE:
            if hit.form == "from":
                return hit.value, hit
            beside = hit.form == "to" and hits[after - 1].kind in _PLACED
            if hit.form in ("to", "into", "bare") and not beside:
                follows = hits[after + 1] if after + 1 < stop else None
                if follows is None or follows.kind is not Kind.SIDE:
                    return _OTHER[hit.value], hit
        elif hit.kind in _STOPPERS or (hit.kind is Kind.MARK and hit.value != ","):
            break
    for before in range(index - 1, max(index - REACH, start - 1), -1):
        hit = hits[before]
        if hit.kind is Kind.SIDE and hit.form == "from":
            return hit.value, hit
        if hit.kind in (Kind.VERB, Kind.JOIN, Kind.EGO):
            break
    return None


def passes(words: list[str], side: Hit, name: str) -> bool:
    """Whether a direction has both ends (left to right), so that nothing but a crossing has it."""
    return name in _LIGHT and bool(_ENDS & set(words[side.first : side.stop]))


def _ours(words: list[str], at: int) -> bool:
    return any(word in _OUR or word == "front" for word in words[at : at + 2])


def _into_ours(words: list[str], at: int) -> bool:
    """into our lane, in front of us, within the next few words."""
    near = words[at : at + 9]
    for position, word in enumerate(near):
        if word in ("and", ",") and near[position + 1 : position + 2] in _GOES_ON:
            continue
        if word in (",", ".", "so", "and", "but", "because"):
            return False
        if word in ("into", "onto"):
            return _ours(words, at + position + 1)
        if word in ("to", "toward", "towards") and _ours(words, at + position + 1):
            return "lane" in near[position + 2 : position + 4]
        if (word == "our" or word == "my") and not (position and near[position - 1] in _INSIDE):
            return position + 1 < len(near) and near[position + 1] in ("lane", "path")
    return False


def _out_of_ours(words: list[str], at: int) -> bool:
    """out of our lane, over to the exit."""
    near = words[at : at + 5]
    return "out" in near and "of" in near and bool(EGO_WORDS & set(near))


def _over_line(words: list[str], at: int) -> bool:
    """the lane marking, into our lane: what a vehicle crosses when it changes lanes."""
    near = words[at : at + 5]
    if near and near[0] in _OUR:
        return False  # crosses our lane
    return bool(_LINES & set(near)) or _into_ours(words, at)


def _over_road(words: list[str], at: int, name: str) -> bool:
    near = words[at : at + 10]
    if "across" in near[:3] and "from" in near[:4]:
        return True
    if name not in _LIGHT:
        return "across" in near and bool(_ROADS & set(near))
    if "across" in near or "over" in near:
        return "across" in near[:3] or bool(_ROADS & set(near)) or "lane" in near or "us" in near
    return bool(_ONTO_WORDS & set(near)) and ("lane" in near or bool(_ROADS & set(near)))


def _towards_us(words: list[str], at: int) -> bool:
    """towards us, straight at our car; not towards our lane."""
    for here in range(at, min(at + 3, len(words))):
        if words[here] in _TOWARDS:
            beyond = words[here + 1 : here + 4]
            if words[here] != "towards" and words[here] != "toward":
                return bool({"us", "me", "ego"} & set(beyond[:2]))
            return bool(EGO_WORDS & set(beyond[:2])) and not _NOT_US & set(beyond)
        if words[here] not in _STRAIGHT:
            return False
    return False
