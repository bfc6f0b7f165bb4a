"""Stage 3c: a speed as a noun phrase or a number: the same speed, an unchanged 30 km/h, 20."""

from __future__ import annotations

from ssp_eval.extract.rules.words.notation import phrases

STEADY = frozenset(
    phrases(
        """
        constant, const, steady, unchanged, same, current, present, existing, unaltered, uniform,
        stable, unvarying, consistent, cruising, unmodified
        """
    )
)
SPEEDS = frozenset(phrases("speed, velocity, pace, speeds, tempo, v"))
FILLERS = frozenset(
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
_AS_BEFORE = (["before"], ["now"], ["so"], ["usual"], ["earlier"], ["until"], ["currently"])
HEADS = frozenset({"not"})
_CHANGE = (["change"], ["alter"], ["modify"], ["adjust"], ["touch"], ["vary"])
ENDS = frozenset({".", "?", "\n", ",", ";", ":", '"', "|", "[", "("})
MAX_FILLERS = 6


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


def bare_number(words: list[str], at: int) -> int | None:
    """The word after a speed without its unit: reduce to 20, hold 50."""
    if at >= len(words) or not words[at].isdigit() or len(words[at]) < 2:
        return None
    after = words[at + 1] if at + 1 < len(words) else "."
    return at + 1 if after in ENDS or after in ("and", "for", "now") else None


def unchanged(words: list[str], at: int) -> tuple[str, str, int, int] | None:
    """Not change the speed."""
    if words[at + 1 : at + 2] not in _CHANGE:
        return None
    stop = speed_stop(words, at + 2, numbers=False)
    return ("keep_speed", "base", at, stop) if stop else None


def speed_stop(words: list[str], here: int, numbers: bool) -> int | None:
    """The word after an optional article, adjectives and a speed."""
    for _ in range(MAX_FILLERS):
        if here >= len(words):
            return None
        word = words[here]
        if word in SPEEDS:
            return here + 1
        if numbers and word[0].isdigit():
            return number(words, here)
        if word not in FILLERS and word not in STEADY:
            return None
        here += 1
    return None


def steady_stop(words: list[str], here: int) -> int | None:
    """The word after "an unchanged speed" or "the same 25 km/h"."""
    steady = False
    for _ in range(MAX_FILLERS):
        if here >= len(words):
            return None
        word = words[here]
        if word in STEADY:
            steady = True
        elif word in SPEEDS:
            compared = (
                words[here + 1 : here + 2] == ["as"]
                and "same" in words[here - 2 : here]
                and words[here + 2 : here + 3] not in _AS_BEFORE
            )
            limit = words[here + 1 : here + 2] == ["limit"]
            return here + 1 if steady and not compared and not limit else None
        elif word[0].isdigit():
            return (number(words, here) or bare_number(words, here)) if steady else None
        elif word not in FILLERS:
            return None
        here += 1
    return None
