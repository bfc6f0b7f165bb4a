"""Stage 3b: keep, maintain, stay, continue: of speed, of lane, straight on, or of nothing."""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases.found import Found
from ssp_eval.extract.rules.free_phrases.speed_nouns import number
from ssp_eval.extract.rules.words.notation import phrases

_KEEP = frozenset(
    phrases("keep, keeps, keeping, maintain, maintains, maintaining, hold, holds, holding")
)
_STAY = frozenset(phrases("stay, stays, staying, remain, remains, remaining"))
_GO = frozenset(
    phrases(
        """
        continue, continues, continuing, drive, drives, driving, proceed, proceeds,
        proceeding, go, goes, going, travel, travels, traveling, travelling, head, heads,
        heading, move, moves, moving, cruise, cruises, cruising, steer, steers, steering,
        carry, carries, carrying, roll, rolls, rolling
        """
    )
)
HEADS = _KEEP | _STAY | _GO
_ON = frozenset(
    phrases(
        """
        going, driving, moving, traveling, travelling, on, heading, to, proceeding,
        cruising
        """
    )
)
_OWN = frozenset(
    phrases(
        """
        my, our, your, the, its, a, both, own, ego, this, current, constant, steady, same,
        up, present, existing, original, cruising, vehicle, through, initial, forward, set
        """
    )
)
_STEADY = frozenset(
    phrases("current, constant, steady, same, present, existing, cruising, original")
)
_SPEEDS = frozenset(phrases("speed, velocity, pace, speeds"))
_NOT_KEPT = frozenset(
    phrases(
        """
        low, below, under, down, reduced, slow, moderate, limit, limits, close,
        appropriate, safe, adapted, adjustment, reduction, in, as, differences, difference
        """
    )
)
_IN = frozenset(phrases("in, within, inside, to, on, of, along"))
_POSED = frozenset(phrases("put, centered, centred, positioned, centrally, firmly, safely, well"))
_SIDES = frozenset(
    phrases(
        """
        left, right, middle, center, centre, through, rightmost, leftmost, nearside, offside, slow,
        fast, outer, inner, outside, inside, travel, driving, ego, first, second, third, same
        """
    )
)
_LINES = frozenset(phrases("lane, course, heading, direction, line"))
MAX_SKIP = 5


def keep(words: list[str], at: int) -> tuple[Found, ...]:
    """The commitments of a keeping verb: (lemma, form, first word, stop word) each.

    ``keep_speed``, ``keep_lane`` (also for straight on), ``change_left`` and ``change_right``
    for ``keep left``. Empty where nothing definite is kept.
    """
    head = words[at]
    form = "ing" if head.endswith("ing") else "s" if head.endswith("s") else "base"
    here = at + 1
    count = len(words)
    if here < count and words[here] in _ON:
        here += 1
    if here >= count or (head.startswith("carr") and words[at + 1] != "on"):
        return ()
    if words[here] == "straight":
        return (("keep_lane", form, at, here + 1),)
    if head in ("keep", "keeping", "keeps"):
        sided = _keep_side(words, at, here)
        if sided:
            return ((f"change_{sided[0]}", form, at, sided[1]),)
    return _speed(words, at, form) or _lane(words, at, form)


_SOMEWHAT = frozenset(phrases("a, little, bit, slightly, well, far, further, more, to, the, hard"))


def _keep_side(words: list[str], at: int, here: int) -> tuple[str, int] | None:
    while here < len(words) and words[here] in _SOMEWHAT and here < at + 5:
        here += 1
    if here < len(words) and words[here] in ("left", "right"):
        stop = here + 1
        if stop < len(words) and words[stop] in ("lane", "of", "turn", "behind", "in"):
            return None
        return words[here], stop
    return None


def _speed(words: list[str], at: int, form: str) -> tuple[Found, ...]:
    here = at + 1
    count = len(words)
    steady = words[at] in _KEEP
    if steady and words[here] in _ON:  # keep going at the same speed
        here += 1
        if words[here : here + 1] == ["on"]:
            here += 1
        if here >= count or words[here] not in ("at", "with"):
            return ()
        here, steady = here + 1, False
    elif not steady:
        if here < count and words[here] in ("straight", "forward", "ahead", "on"):
            here += 1
        if here >= count or words[here] not in ("at", "with"):
            return ()
        here += 1
    for _ in range(MAX_SKIP):
        if here >= count or words[here] not in _OWN:
            break
        steady = steady or words[here] in _STEADY
        here += 1
    if here >= count:
        return ()
    if words[at] in _KEEP and words[here][0].isdigit():
        return _figure(words, at, here, form)
    if words[here] in _LINES and words[here + 1 : here + 2] == ["and"]:
        rest = _after_and(words, here + 2, _SPEEDS)
        if rest and words[at] in _KEEP:
            return (("keep_lane", form, at, here + 1), ("keep_speed", form, at, rest))
        return ()
    if words[here] not in _SPEEDS or not steady:
        return ()
    stop = here + 1
    if (
        stop < count
        and words[stop] in _NOT_KEPT
        and not (words[stop] == "as" and "same" not in words[at:stop])
    ):
        return ()
    kept: Found = ("keep_speed", form, at, stop)
    if stop < count and words[stop] == "and" and words[at] in _KEEP:
        lane = _after_and(words, stop + 1, _LINES)
        if lane:
            return (kept, ("keep_lane", form, at, lane))
    return (kept,)


def _figure(words: list[str], at: int, here: int, form: str) -> tuple[Found, ...]:
    """hold 50 km/h and our own lane."""
    stop = number(words, here)
    if stop is None:
        return ()
    kept: Found = ("keep_speed", form, at, stop)
    if words[stop : stop + 1] == ["and"]:
        lane = _after_and(words, stop + 1, _LINES)
        if lane:
            return (kept, ("keep_lane", form, at, lane))
    return (kept,)


def _after_and(words: list[str], here: int, nouns: frozenset[str]) -> int | None:
    for index in range(here, min(here + MAX_SKIP, len(words))):
        if words[index] in nouns:
            return index + 1
        if words[index] not in _OWN:
            return None
    return None


def _lane(words: list[str], at: int, form: str) -> tuple[Found, ...]:
    here = at + 1
    count = len(words)
    inside = False
    for _ in range(MAX_SKIP + 2):
        if here >= count:
            return ()
        word = words[here]
        if word in _IN:
            inside = True
        elif word == "lane":
            break
        elif word == "position" and words[at] in _KEEP:
            return (("keep_lane", form, at, here + 1),) if _in_lane(words, here) else ()
        elif word == "behind" and words[at] in _STAY:
            here = _behind(words, here)
            continue
        elif word not in _OWN and word not in _POSED and word not in _SIDES and word not in _ON:
            return ()
        here += 1
    else:
        return ()
    if words[at] not in _KEEP and (not inside or words[at + 1] == "to"):
        return ()
    stop = here + 1
    if stop < count and words[stop] in ("change", "changes", "departure", "discipline", "ahead"):
        return ()
    if stop < count and words[stop] in ("position", "positioning", "keeping"):
        stop += 1
    return (("keep_lane", form, at, stop),)


def _behind(words: list[str], here: int) -> int:
    """The word after "behind the slow truck", where "in our lane" may follow."""
    for stop in range(here + 1, min(here + 6, len(words))):
        if words[stop] in _IN or not words[stop].isalpha():
            return stop
    return len(words)


def _in_lane(words: list[str], position: int) -> bool:
    return (
        "lane" in words[position + 1 : position + 5]
        and position + 1 < len(words)
        and (words[position + 1] in _IN)
    )
