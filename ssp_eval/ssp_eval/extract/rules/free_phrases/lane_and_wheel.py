"""Phrases about the ego's lane and wheel: wheels straight, no steering, lane is kept."""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases.found import ENDS, Found
from ssp_eval.extract.rules.words.notation import phrases

_WHEELS = frozenset(phrases("wheel, wheels, steering"))
_HELD = frozenset(
    phrases(
        """
        wheel, held, kept, is, stays, remains, be, should, stay, as, it, the, a, at, dead, all,
        completely, to, must, input, angle, command, pointed, pointing, set, of, remain
        """
    )
)
_NEUTRAL = frozenset(phrases("straight, neutral, centered, centred"))
_NO_STEERING = frozenset(
    phrases(
        """
        steer, evasive, active, further, additional, extra, lateral, steering, any, sudden, more,
        need, of, for, a, sideways, correction, corrections, sharp

        """
    )
)
_STEERING = frozenset(phrases("steering, steer"))
_SIDEWAYS = frozenset(phrases("lateral, sideways"))
_MOVES = frozenset(
    phrases(
        "movement, action, motion, maneuver, manoeuvre, shift, deviation, change, offset, input"
    )
)
_UNCHANGED = frozenset(phrases("unchanged, unaltered, same"))
_PASSIVE = frozenset(phrases("is, will, should, be, can, must, to, being, shall, also, then"))
_COURSES = frozenset(phrases("direction, heading, course, steering"))
_THROUGH = frozenset(phrases("on, through"))
_DIRECTIONS = (["direction"], ["heading"], ["course"], ["steering"])
_COURSE = tuple([word] for word in sorted(_COURSES))
HEADS = _WHEELS | frozenset(phrases("straight, no, zero, lane, direction, heading, course"))


def straight(words: list[str], at: int) -> Found | None:
    """wheels straight, steering stays straight, straight wheels, straight on, no steering."""
    word = words[at]
    count = len(words)
    after = words[at + 1] if at + 1 < count else "."
    if word == "straight":
        if after in _WHEELS:
            stop = at + 2
            if words[stop : stop + 1] == ["wheel"]:
                stop += 1
            return "keep_lane", "noun", at, stop
        before = words[at - 1] if at else "."
        alone = before in ENDS or before in ("go", "and")
        ends = at + 2 >= count or words[at + 2] in ENDS
        if words[at + 1 : at + 3] == ["it", "is"]:
            return "keep_lane", "value", at, at + 3
        named = (before in _COURSES or words[at - 2 : at - 1] in _COURSE) and after in (
            "ahead",
            "on",
        )
        if (before in _COURSES or words[at - 2 : at - 1] in _COURSE) and (
            before in _COURSES or before in ("is", "remains", "stays", "leave", "kept")
        ):
            return "keep_lane", "value", at, at + 1 + named
        if named or (after in _THROUGH and alone and ends):
            return "keep_lane", "value", at, at + 2
        return None
    if word == "no" or word == "zero":
        return _no_steering(words, at)
    if word in _COURSES or word == "lane":
        if words[at + 1 : at + 4] == ["stays", "the", "same"]:
            return "keep_lane", "noun", at, at + 4
        if after in _UNCHANGED and (at == 0 or words[at - 1] in ENDS or words[at - 1] == "and"):
            return "keep_lane", "noun", at, at + 2
        if word == "lane":
            return _lane_kept(words, at)
        if word not in _WHEELS:
            return None
    here = at + 1
    while here < min(at + 6, count) and words[here] in _HELD:
        here += 1
    if here < count and words[here] in _NEUTRAL:
        return "keep_lane", "noun", at, here + 1
    return None


def _lane_kept(words: list[str], at: int) -> Found | None:
    """The lane is held too; lane is kept."""
    here = at + 1
    while here < min(at + 5, len(words)) and words[here] in _PASSIVE:
        here += 1
    kept = here < len(words) and here > at + 1 and words[here] in ("kept", "held", "maintained")
    return ("keep_lane", "noun", at, here + 1) if kept else None


def _no_steering(words: list[str], at: int) -> Found | None:
    here = at + 1
    count = len(words)
    if words[here : here + 1] == ["change"] and words[here + 1 : here + 2] in (["of"], ["in"]):
        named = words[here + 2 : here + 3] in _DIRECTIONS
        return ("keep_lane", "noun", at, here + 3) if named else None
    sideways = False
    while here < min(at + 5, count):
        word = words[here]
        if word in _STEERING:
            stop = here + 1
            if words[stop : stop + 1] and words[stop] in ("input", "needed", "required", "wheel"):
                stop += 1
            after = words[stop] if stop < count else "."
            return ("keep_lane", "noun", at, stop) if after not in ("to", "towards") else None
        if sideways and word in _MOVES:
            return "keep_lane", "noun", at, here + 1
        if word not in _NO_STEERING:
            return None
        sideways = sideways or word in _SIDEWAYS
        here += 1
    return None
