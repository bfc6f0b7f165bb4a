"""Stage 3a: what left, right, ahead and behind are relative to, and whether they mean a place."""

from __future__ import annotations

from ssp_eval.extract.lexicon import EGO_WORDS, phrases

_FILLERS = frozenset(
    phrases(
        """
        our, my, the, your, its, their, his, her, adjacent, immediate, far, next, same,
        near, neighbouring, neighboring, other, outer, inner, immediately, directly,
        extreme, opposite, a, slightly, very, host, ego, adjoining, parallel, just,
        straight, hard, slight, gently
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
        margin, verge, footpath, border, boundary, adjacent, kerbside, curbside
        """
    )
)
# What a side may be "of" and still be seen from the VUT.
_FRAME_NOUNS = frozenset(
    phrases(
        """
        road, street, lane, image, frame, picture, view, roadway, intersection, scene,
        junction, crosswalk, highway, screen, us, me
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
_OPPOSITE = {"left": "right", "right": "left"}
_ARTICLES = frozenset(
    phrases(
        """
        the, a, an, that, this, its, another, their, it, them, him, her, which, these,
        those, some, two
        """
    )
)
MAX_BACK = 4


def side(words: list[str], at: int) -> tuple[str, str, int, int] | None:
    """What the ``left`` or ``right`` at an index means: (side, form, first word, stop word).

    The forms: ``from`` a motion's origin; ``to`` a place or a target; ``into`` a target; ``at`` a
    place; ``bare``; ``lane`` a lane or side named before a noun. None where it is no direction, or
    one that is relative to somebody else.
    """
    word = words[at]
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
        if stop + 1 < count and words[stop] == "to" and words[stop + 1] == _OPPOSITE[word]:
            return word, "from", first, stop + 2
    if stop < count and words[stop] in ("most", "hand"):
        stop += 1
    if stop < count and words[stop] in _HEADS:
        stop += 1
        if form == "bare":
            form = "lane"
    if stop + 1 < count and words[stop] == "of":
        after = words[stop + 1]
        if after in EGO_WORDS or after in _FRAME_NOUNS:
            stop += 2
        elif after in ("the", "my", "our") and stop + 2 < count:
            noun = words[stop + 2]
            if noun not in _FRAME_NOUNS and noun not in EGO_WORDS:
                return None
            stop += 3
        else:
            return None
        if form == "to":
            form = "at"
    return word, form, first, stop


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
    if after == "of":
        stop += 1
        if stop >= count:
            return None
        after = words[stop]
    elif value != "rear":
        return stop
    if after in EGO_WORDS:
        return stop + 1
    if after == "the" and stop + 1 < count and (words[stop + 1] in EGO_WORDS):
        return stop + 2
    if words[stop - 1] == "of" or after in _ARTICLES or after in ("parked", "stopped"):
        return None
    return stop
