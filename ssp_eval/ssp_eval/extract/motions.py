"""Stage 5a: what a verb says about the motion of somebody else."""

from __future__ import annotations

from ssp_eval.extract.hits import Hit, Kind
from ssp_eval.extract.lexicon import EGO_WORDS
from ssp_eval.extract.verbs import ACROSS, ALONG, INTO_LANE, MOVING, STANDING

_STOPPERS = frozenset({Kind.VERB, Kind.OBJECT, Kind.EGO, Kind.JOIN, Kind.REACT, Kind.KEY})
_OTHER = {"left": "right", "right": "left"}
_ROADS = frozenset({"road", "street", "lane", "path", "roadway", "crosswalk", "crossing"})
_ACROSS_WORDS = frozenset({"across", "into", "onto", "in"})
REACH = 8

# A movement in our direction if it is ahead or beside us; the reader's word for decide.py.
MOVING_BESIDE = "moving"
CUTTING_IN = "cutting_in"  # direction open


def motion_of(
    words: list[str], hits: list[Hit], index: int, start: int, stop: int
) -> tuple[str, Hit | None] | None:
    """The motion that a verb of somebody else asserts, and the hit with its direction.

    Args:
        words: words of the text.
        hits: all hits.
        index: the verb's.
        start: first hit of its sentence.
        stop: hit after the sentence.

    Returns:
        A motion of the vocabulary, ``moving`` or ``cutting_in``, and the hit that gives the
        direction; None if the verb says nothing in the vocabulary.
    """
    verb = hits[index]
    lemma = verb.value
    if lemma in STANDING:
        if lemma == "stop" and verb.form == "ing":
            return MOVING_BESIDE, None
        return "stationary", None
    if lemma == "recede":
        beyond = words[verb.stop : verb.stop + 3]
        return (
            None if beyond[:1] == ["from"] and not EGO_WORDS & set(beyond) else ("receding", None)
        )
    if lemma == "approach":
        return ("oncoming", None) if _origin(hits, index, start, stop) is None else None
    if lemma == "cut_out":
        return "cutting_out", None
    if lemma in ALONG:
        return "same_direction", None
    origin = _origin(hits, index, start, stop)
    if lemma == "cross":
        return (f"crossing_from_{origin[0]}", origin[1]) if origin else None
    if lemma == "cut_in":
        if words[verb.stop - 1] in ("into", "on") and not _ours(words, verb.stop):
            return None
        return (f"cutting_in_from_{origin[0]}", origin[1]) if origin else (CUTTING_IN, None)
    if lemma in INTO_LANE and _into_ours(words, verb.stop):
        return (f"cutting_in_from_{origin[0]}", origin[1]) if origin else (CUTTING_IN, None)
    if lemma == "merge":
        return (f"cutting_in_from_{origin[0]}", origin[1]) if origin else None
    if lemma in ACROSS and origin and _over_road(words, verb.stop):
        return f"crossing_from_{origin[0]}", origin[1]
    if lemma in MOVING and origin is None:
        return MOVING_BESIDE, None
    return None


def _origin(hits: list[Hit], index: int, start: int, stop: int) -> tuple[str, Hit] | None:
    """The side that a movement comes from: ``from the left``, or ``to the right`` turned round."""
    for after in range(index + 1, min(index + REACH, stop)):
        hit = hits[after]
        if hit.kind is Kind.SIDE:
            if hit.form == "from":
                return hit.value, hit
            if hit.form in ("to", "into", "bare"):
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


def _ours(words: list[str], at: int) -> bool:
    return any(word in EGO_WORDS or word == "front" for word in words[at : at + 2])


def _into_ours(words: list[str], at: int) -> bool:
    """into our lane, in front of us, within the next few words."""
    near = words[at : at + 9]
    for position, word in enumerate(near):
        if word in (",", ".", "so", "and", "but", "because"):
            return False
        if word in ("into", "onto", "toward", "towards"):
            return _ours(words, at + position + 1)
        if word == "our" or word == "my":
            return position + 1 < len(near) and near[position + 1] in ("lane", "path")
    return False


def _over_road(words: list[str], at: int) -> bool:
    near = words[at : at + 9]
    return bool(_ACROSS_WORDS & set(near)) and bool(_ROADS & set(near))
