"""Stage 5c: the direction of an action: beside its verb, in the verb, or after a comma."""

from __future__ import annotations

from typing import NamedTuple

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.words.ego_verbs import LAT_ACTIONS, STEERING

_BETWEEN = frozenset({Kind.PURPOSE, Kind.SCENE, Kind.IN_LANE, Kind.AUX})
_TOWARDS = frozenset({"to", "toward", "towards"})
_DIRECTED = frozenset({"bare", "to", "into", "lane"})
_BARS = frozenset({"|", ";", "}"})
REACH = 5
MAX_WORDS = 6


class Lateral(NamedTuple):
    """A lateral action.

    Args:
        value: the action.
        stop: index after its last word.
        side: index of the hit that is the direction; None if the verb says it.
    """

    value: str
    stop: int
    side: int | None


def lateral(words: list[str], hits: list[Hit], index: int, stop: int) -> Lateral | None:
    """What a verb does with the ego's lane, if it and its direction say so.

    Args:
        words: words of the text.
        hits: all hits.
        index: the verb's.
        stop: hit after its sentence.
    """
    hit = hits[index]
    value = LAT_ACTIONS.get(hit.value)
    if value is not None:
        return Lateral(value, hit.stop, None)
    if hit.value not in STEERING:
        return None
    for after in range(index + 1, min(index + REACH, stop)):
        following = hits[after]
        if following.first - hit.stop > MAX_WORDS:
            return None
        if following.kind is Kind.SIDE:
            if following.form not in _DIRECTED and words[following.first] not in _TOWARDS:
                return None
            if hit.value == "cut_in" and following.form == "to":
                return None
            return Lateral(following.value, following.stop, after)
        if following.kind not in _BETWEEN and words[following.first] != "around":
            return None
    return None


def straight_ahead(words: list[str], hits: list[Hit], index: int, stop: int) -> Hit | None:
    """Accelerate gently, straight ahead: the place that is a direction here."""
    for after in range(index + 1, min(index + 3, stop)):
        hit = hits[after]
        if hit.kind is Kind.PLACE and words[hit.first] == "straight":
            ends = after + 1 == stop or hits[after + 1].kind is Kind.MARK
            return hit if ends and hits[index].form != "noun" else None
        if hit.value != ",":
            return None
    return None


def fills_cell(words: list[str], hits: list[Hit], index: int) -> bool:
    """Whether an action fills a cell of a table or a record: | front | brake |."""
    stop = hits[index].stop
    return hits[index - 1].value in _BARS and stop < len(words) and words[stop] in _BARS
