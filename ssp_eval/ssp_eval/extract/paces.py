"""Stage 3c: phrases about the ego's pace: lower the speed, at an unchanged 25 km/h, back to 80.

They are too free for a list: verb, articles, adjectives and then a speed, as a noun or a number.
"""

from __future__ import annotations

from ssp_eval.extract.lexicon import phrases

Found = tuple[str, str, int, int]

_GOING = frozenset(phrases("go, goes, going, come, comes, coming"))
_LOWER = frozenset(
    phrases(
        """
        reduce, reduces, reducing, lower, lowers, lowering, decrease, decreases, decreasing,
        cut, cuts, cutting, drop, drops, dropping, lessen, lessens, lessening, shed, sheds,
        shedding, moderate, moderates, moderating, scrub, lose, loses, losing, trim, trims,
        trimming, slacken
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
_RELEASE = frozenset(
    phrases(
        """
        take, takes, taking, lift, lifts, lifting, ease, eases, easing, let, lets, letting, come,
        coming, get, getting, release, releases, releasing, off, apply, applies, applying, press,
        presses, pressing, hit, tap, taps, tapping, squeeze, squeezing, slam, touch, use, using
        """
    )
)
_BRING = frozenset(phrases("bring, brings, bringing, take, takes, taking, get, build"))
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
_STEADY = frozenset(
    phrases(
        """
        constant, const, steady, unchanged, same, current, present, existing, unaltered, uniform,
        stable, unvarying, consistent, cruising, unmodified
        """
    )
)
_UNCHANGED = frozenset(phrases("constant, const, steady, unchanged, stable, same, unaltered"))
_SPEEDS = frozenset(phrases("speed, velocity, pace, speeds, tempo, v"))
_FORCES = frozenset(phrases("firm, hard, on, light, strong, gentle, soft, emergency"))
_SOFTLY = frozenset(phrases("smoothly, gently, back, slowly, up"))
_AFTER_BARE = frozenset(phrases("and, with, in"))
_PEDALS = frozenset(phrases("gas, accelerator, throttle, foot, brakes, brake, pedal"))
_GO_FORCES = frozenset(phrases("firm, hard, on, light, strong, gentle, soft, emergency"))
_SOFTLY = frozenset(phrases("smoothly, gently, back, slowly, up"))
_AFTER_BARE = frozenset(phrases("and, with, in"))
_PEDALS = frozenset(phrases("gas, accelerator, throttle, gas pedal"))
_FILLERS = frozenset(
    phrases(
        """
        the, a, an, my, our, its, your, this, that, ego, vehicle, car, own, set, target, normal,
        original, former, previous, travel, travelling, traveling, cruise, cruising, driving,
        desired, usual, initial, old, lost, full, regular, forward, general, some, little, bit,
        walking, crawling, low, high, moderate, slow, of, exactly, about, around, roughly,
        approximately, slightly, gently, smoothly, gradually,
        down, back, up, all, overall, longitudinal, moderate, planned, earlier, reference, legal,
        permitted, allowed, standard, nearly, right, more, no, vut, host
        """
    )
)
_UNITS = frozenset(phrases("km, kmh, kph, m, ms, mph, mps, kilometers, kilometres, meters, metres"))
_PER = frozenset(phrases("h, s, per, hour, second"))
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
_OWNERS = frozenset(
    phrases("the, our, my, ego, own, its, your, vehicle, travel, driving, cruising, car, and")
)
_MARKS = frozenset({".", "?", "\n", ",", ";", ":", '"', "|", "[", "("})
_OF_EGO = frozenset(phrases("of, the, ego, car, vehicle, our, vut"))
HEADS = (
    _GOING | _LOWER | _RAISE | _BACK | _RELEASE | _BRING | _LET | _KEPT | _AT | _UNCHANGED | _SPEEDS
)
MAX_FILLERS = 6


def pace(words: list[str], at: int) -> Found | None:
    """What a phrase that begins at a word does with the ego's speed: (lemma, form, first, stop).

    ``reduce``, ``accelerate``, ``keep_speed`` or ``brake``; None where the words say no such thing.
    """
    word = words[at]
    form = "ing" if word.endswith("ing") and word != "bring" else "base"
    if word.endswith("s") and word != "pass":
        form = "s"
    if word in _SPEEDS:
        return _passive(words, at)
    if word in _GOING:
        return _down(words, at, form)
    if word in _LOWER:
        stop = _speed(words, at + 1, numbers=False)
        if stop:
            return "reduce", form, at, stop
    if word in _RAISE:
        stop = _speed(words, at + 1, numbers=word.startswith(("res", "reg", "rec")))
        if stop:
            return "accelerate", form, at, stop
    if word in _KEPT:
        return _kept(words, at, form)
    if word in _BRING or word in _LET:
        found = _brought(words, at, form)
        if found:
            return found
    if word in _RELEASE:
        return _pedal(words, at, form)
    if word in _BACK:
        return _back(words, at, form)
    if word in _AT:
        stop = _steady(words, at + 1)
        return ("keep_speed", "noun", at, stop) if stop else None
    if word in _UNCHANGED:
        stop = _steady(words, at)
        return ("keep_speed", "noun", at, stop) if stop else None
    return None


def number(words: list[str], at: int) -> int | None:
    """The word after a speed in figures: 25 km/h, 7.5 m/s, 40 mph; None if there is none."""
    if at >= len(words) or not words[at][0].isdigit():
        return None
    here = at + 1
    if here >= len(words) or words[here] not in _UNITS:
        return None
    unit = words[here]
    here += 1
    if unit in ("km", "m", "meters", "metres", "kilometers", "kilometres"):
        stop = here
        while stop < min(here + 2, len(words)) and words[stop] in _PER:
            stop += 1
        return stop if stop > here else None
    return here


def _speed(words: list[str], here: int, numbers: bool) -> int | None:
    """The word after an optional article, adjectives and a speed."""
    for _ in range(MAX_FILLERS):
        if here >= len(words):
            return None
        word = words[here]
        if word in _SPEEDS:
            return here + 1
        if numbers and word[0].isdigit():
            return number(words, here)
        if word not in _FILLERS and word not in _STEADY:
            return None
        here += 1
    return None


def _steady(words: list[str], here: int) -> int | None:
    """The word after "an unchanged speed" or "the same 25 km/h"."""
    steady = False
    for _ in range(MAX_FILLERS):
        if here >= len(words):
            return None
        word = words[here]
        if word in _STEADY:
            steady = True
        elif word in _SPEEDS:
            compared = words[here + 1 : here + 2] == ["as"] and "same" in words[here - 2 : here]
            limit = words[here + 1 : here + 2] == ["limit"]
            return here + 1 if steady and not compared and not limit else None
        elif word[0].isdigit():
            return number(words, here) if steady else None
        elif word not in _FILLERS:
            return None
        here += 1
    return None


def _down(words: list[str], at: int, form: str) -> Found | None:
    """go down to 25 km/h, drop to 40."""
    here = at + 1
    if words[here : here + 1] == ["down"]:
        here += 1
    if words[here : here + 1] != ["to"] or (here == at + 1 and words[at] not in ("drop", "drops")):
        return None
    stop = _speed(words, here + 1, numbers=True)
    return ("reduce", form, at, stop) if stop else None


def _kept(words: list[str], at: int, form: str) -> Found | None:
    """keep 45 km/h, hold our 49 km/h, leave the speed as it is, keep speed constant."""
    here = at + 1
    while here < min(at + 5, len(words)) and (words[here] in _FILLERS or words[here] in _STEADY):
        here += 1
    stop = number(words, here)
    if stop:
        return "keep_speed", form, at, stop
    if words[at].startswith("leav") and here < len(words) and words[here] in _SPEEDS:
        return "keep_speed", form, at, here + 1
    return None


def _brought(words: list[str], at: int, form: str) -> Found | None:
    """bring the speed back up, take some speed off, let the speed drop."""
    noun = _speed(words, at + 1, numbers=False)
    if noun is None:
        return None
    for here in range(noun, min(noun + 3, len(words))):
        word = words[here]
        if word == "up":
            return "accelerate", form, at, here + 1
        if word in ("down", "off", "drop", "fall", "decay", "bleed"):
            return "reduce", form, at, here + 1
    between = words[at + 1 : noun]
    if "off" in between or "down" in between:
        return "reduce", form, at, noun
    return ("accelerate", form, at, noun) if "up" in between else None


def _pedal(words: list[str], at: int, form: str) -> Found | None:
    """off the gas, lift the foot, take the foot off the accelerator, apply the brakes gently."""
    off = words[at] in ("off", "release", "releases", "releasing", "lift", "lifts", "lifting")
    braking = words[at].startswith(("appl", "press", "hit", "tap", "squeez", "slam", "us", "touch"))
    if words[at + 1 : at + 2] == ["of"]:
        return None  # the release of the accelerator
    for here in range(at + 1, min(at + 8, len(words))):
        word = words[here]
        if word in ("off", "from"):
            off = True
        elif word in ("gas", "accelerator", "throttle"):
            return ("slow", form, at, here + 1) if off else None
        elif word in ("brake", "brakes", "braking"):
            return ("brake", form, at, here + 1) if braking else None
        elif word in ("foot", "right"):
            if words[at].startswith("lift") and word == "foot":
                off = True
        elif word not in _FILLERS and word not in (
            "firm",
            "hard",
            "on",
            "light",
            "strong",
            "gentle",
        ):
            break
    if words[at].startswith("lift") and "foot" in words[at + 1 : at + 4]:
        return "slow", form, at, words.index("foot", at) + 1
    return None


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
    stop = _speed(words, here + 1, numbers=True)
    return ("accelerate", form, at, stop) if stop else None


def _passive(words: list[str], at: int) -> Found | None:
    """speed should be reduced, speed stays constant; but not what the speed of somebody is."""
    before = words[at - 1] if at else "."
    if before not in _OWNERS and before not in _MARKS:
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
    lemma = _DONE.get(words[here]) if here < len(words) else None
    if lemma is None:
        return None
    after = words[here + 1] if here + 1 < len(words) else "."
    bare = (
        here == at + 1
        and (before in _MARKS or before == "and")
        and (after in _MARKS or after in ("and", "with", "in"))
    )
    done = words[here].endswith("ed") or words[here] in ("kept", "held")
    if not ought and not bare and not (done and words[here - 1] in ("is", "now")):
        return None
    return lemma, "noun", at, here + 1
