"""Stage 3c: phrases about the ego's pace: lower the speed, at an unchanged 25 km/h, back to 80.

They are too free for a list: verb, articles, adjectives and then a speed, as a noun or a number.
"""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases import pedals
from ssp_eval.extract.rules.free_phrases.found import Found
from ssp_eval.extract.rules.free_phrases.speed_nouns import (
    ENDS,
    FILLERS,
    SPEEDS,
    STEADY,
    bare_number,
    number,
    speed_stop,
    steady_stop,
)
from ssp_eval.extract.rules.words.notation import phrases

_GOING = frozenset(phrases("go, goes, going, come, comes, coming"))
_LOWER = frozenset(
    phrases(
        """
        reduce, reduces, reducing, lower, lowers, lowering, decrease, decreases, decreasing,
        cut, cuts, cutting, drop, drops, dropping, lessen, lessens, lessening, shed, sheds,
        shedding, moderate, moderates, moderating, scrub, lose, loses, losing, trim, trims,
        trimming, slacken, scrubs, scrubbing
        """
    )
)
_RAISE = frozenset(
    phrases(
        """
        increase, increases, increasing, raise, raises, raising, regain, regains, regaining,
        resume, resumes, resuming, recover, recovers, recovering, restore, restores, restoring,
        rebuild, rebuilds, rebuilding, gain, gains, gaining
        """
    )
)
_BACK = frozenset(
    phrases("return, returns, returning, back, accelerate, accelerates, accelerating, resume")
)
_BRING = frozenset(
    phrases("bring, brings, bringing, take, takes, taking, get, build, make, makes, making")
)
_FALL = frozenset(phrases("down, off, drop, fall, decay, bleed, lower, slower, smaller, less"))
_LET = frozenset(phrases("let, lets, letting, allow, allows, allowing"))
_KEPT = frozenset(
    phrases(
        """
        keep, keeps, keeping, hold, holds, holding, maintain, maintains, maintaining, leave,
        leaves, leaving, retain, retains, retaining, preserve, preserving
        """
    )
)
_AT = frozenset(phrases("at, with"))
_UNCHANGED = frozenset(phrases("constant, const, steady, unchanged, stable, same, unaltered"))
_OWN_CAR = frozenset(phrases("the, our, my, car, vehicle, ego, vut, it"))
_BE = frozenset(
    phrases("is, are, be, to, should, must, needs, need, will, shall, being, has, gets, stays, "
            "remains, stay, remain, staying, remaining, now, can, simply, just")
)  # fmt: skip
_OUGHT = frozenset(
    phrases("should, must, needs, need, will, shall, to, stays, remains, stay, remain, can")
)
_STAYS = frozenset(phrases("stays, remains, stay, remain"))
_DONE = {
    **dict.fromkeys(phrases("reduced, lowered, decreased, cut, lessened, dropped"), "reduce"),
    **dict.fromkeys(phrases("increased, raised, restored, regained, resumed"), "accelerate"),
    **dict.fromkeys(
        phrases(
            "kept, held, maintained, unchanged, constant, const, steady, stable, same, unaltered"
        ),
        "keep_speed",
    ),
}
_AS_IT_IS = (["as", "is"], ["as", "before"], ["as", "now"], ["as", "it"])
_OWNERS = frozenset(
    phrases("the, our, my, ego, own, its, your, vehicle, travel, driving, cruising, car, and")
)
_OF_EGO = frozenset(phrases("of, the, ego, car, vehicle, our, vut"))
HEADS = (
    _GOING
    | _LOWER
    | _RAISE
    | _BACK
    | pedals.HEADS
    | _BRING
    | _LET
    | _KEPT
    | _AT
    | _UNCHANGED
    | SPEEDS
)


def pace(words: list[str], at: int) -> Found | None:
    """What a phrase that begins at a word does with the ego's speed: (lemma, form, first, stop).

    ``reduce``, ``accelerate``, ``keep_speed`` or ``brake``; None where the words say no such thing.
    """
    word = words[at]
    form = "ing" if word.endswith("ing") and word != "bring" else "base"
    if word.endswith("s") and word not in ("pass", "press"):
        form = "s"
    if word in SPEEDS:
        return _passive(words, at)
    if word in _GOING:
        return _down(words, at, form)
    if word in _LOWER:
        off = words[at + 1 : at + 2] == ["off"]  # scrub off some speed
        stop = speed_stop(words, at + 1 + off, numbers=False)
        if stop:
            return "reduce", form, at, stop
        return _down(words, at, form)
    if word in _RAISE:
        stop = speed_stop(words, at + 1, numbers=word.startswith(("res", "reg", "rec")))
        if stop:
            return "accelerate", form, at, stop
    if word in _KEPT:
        return _kept(words, at, form)
    if word in _BRING or word in _LET:
        found = _brought(words, at, form)
        if found:
            return found
    if word in pedals.HEADS:
        return pedals.pedal(words, at, form)
    if word in _BACK:
        return _back(words, at, form)
    if word in _AT:
        stop = steady_stop(words, at + 1)
        return ("keep_speed", "noun", at, stop) if stop else None
    if word in _UNCHANGED:
        stop = steady_stop(words, at)
        return ("keep_speed", "noun", at, stop) if stop else None
    return None


def _down(words: list[str], at: int, form: str) -> Found | None:
    """go down to 25 km/h, drop to 40."""
    here = at + 1
    if words[here : here + 1] == ["down"]:
        here += 1
    if words[here : here + 1] != ["to"] or (here == at + 1 and words[at] not in _LOWER):
        return None
    stop = speed_stop(words, here + 1, numbers=True) or bare_number(words, here + 1)
    return ("reduce", form, at, stop) if stop else None


def _kept(words: list[str], at: int, form: str) -> Found | None:
    """keep 45 km/h, hold our 49 km/h, leave the speed as it is, keep speed constant."""
    here = at + 1
    while here < min(at + 5, len(words)) and (words[here] in FILLERS or words[here] in STEADY):
        here += 1
    stop = number(words, here) or bare_number(words, here)
    if stop:
        return "keep_speed", form, at, stop
    if words[at].startswith("leav") and here < len(words) and words[here] in SPEEDS:
        return "keep_speed", form, at, here + 1
    return None


def _brought(words: list[str], at: int, form: str) -> Found | None:
    """bring the speed back up, take some speed off, let the speed drop."""
    noun = speed_stop(words, at + 1, numbers=False)
    if noun is None:
        return _rolling(words, at, form) if words[at] in _LET else None
    for here in range(noun, min(noun + 3, len(words))):
        word = words[here]
        if word in ("up", "higher", "faster"):
            return "accelerate", form, at, here + 1
        if word in _FALL:
            return "reduce", form, at, here + 1
    between = words[at + 1 : noun]
    if "off" in between or "down" in between:
        return "reduce", form, at, noun
    return ("accelerate", form, at, noun) if "up" in between else None


def _rolling(words: list[str], at: int, form: str) -> Found | None:
    """let the car coast, let it roll out."""
    here = at + 1
    while here < min(at + 5, len(words)) and words[here] in _OWN_CAR:
        here += 1
    coasts = at + 1 < here < len(words) and words[here] in ("coast", "roll", "slow", "decelerate")
    return ("slow", form, at, here + 1) if coasts else None


def _back(words: list[str], at: int, form: str) -> Found | None:
    """return to 40 km/h, back to the travel speed, accelerate back to the limit."""
    here = at + 1
    while here < min(at + 4, len(words)) and words[here] in (
        "smoothly",
        "gently",
        "back",
        "slowly",
        "up",
    ):
        here += 1
    if here >= len(words) or words[here] != "to":
        return None
    stop = speed_stop(words, here + 1, numbers=True)
    return ("accelerate", form, at, stop) if stop else None


def _passive(words: list[str], at: int) -> Found | None:
    """speed should be reduced, speed stays constant; but not what the speed of somebody is."""
    before = words[at - 1] if at else "."
    if before not in _OWNERS and before not in ENDS:
        return None
    here = at + 1
    ought = False
    if words[here : here + 1] == ["of"]:
        while here < min(at + 6, len(words)) and words[here] in _OF_EGO:
            here += 1
    while here < min(at + 9, len(words)) and (words[here] in _BE or words[here] == "the"):
        ought = ought or words[here] in _OUGHT
        here += 1
    if ought and words[here : here + 1] == ["at"] and words[here - 1] in _STAYS:
        stop = number(words, here + 1)
        return ("keep_speed", "noun", at, stop) if stop else None
    if here == at + 1 and before in ENDS and words[here : here + 2] in _AS_IT_IS:
        return "keep_speed", "noun", at, here + 2
    lemma = _DONE.get(words[here]) if here < len(words) else None
    if lemma is None:
        return None
    after = words[here + 1] if here + 1 < len(words) else "."
    bare = (
        here == at + 1
        and (before in ENDS or before == "and")
        and (after in ENDS or after in ("and", "with", "in"))
    )
    done = words[here].endswith("ed") or words[here] in ("kept", "held")
    if not ought and not bare and not (done and words[here - 1] in ("is", "now")):
        return None
    return lemma, "noun", at, here + 1
