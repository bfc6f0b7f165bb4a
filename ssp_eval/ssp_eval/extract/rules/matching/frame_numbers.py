"""Stage 2: which frame of several a text speaks of: frame 3, the last image."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind

FRAMES = {"frame", "image", "picture", "timestep"}
_ORDINALS = {
    "first": 1,
    "second": 2,
    "third": 3,
    "fourth": 4,
    "fifth": 5,
    "last": 10**6,
    "final": 10**6,
    "current": 10**6,
    "latest": 10**6,
    "newest": 10**6,
    "previous": 0,
    "earlier": 0,
    "past": 0,
    "initial": 0,
    "oldest": 0,
    "one": 1,
    "two": 2,
    "three": 3,
    "four": 4,
    "five": 5,
}


def frame(words: list[str], at: int, hits: list[Hit]) -> int:
    """Adds a frame by its number, or a picture as part of the scene; the word after it."""
    number: int | None = None
    stop = at + 1
    if at and words[at - 1] in _ORDINALS:
        number = _ORDINALS[words[at - 1]]
    elif stop < len(words):
        after = words[stop]
        number = (
            int(after)
            if after.isascii() and after.isdigit() and len(after) < 6
            else (_ORDINALS.get(after))
        )
        stop += number is not None
    if number is None:
        hits.append(Hit(Kind.SCENE, "", "", at, at + 1))
    else:
        hits.append(Hit(Kind.FRAME, str(number), "", at, stop))
    return stop
