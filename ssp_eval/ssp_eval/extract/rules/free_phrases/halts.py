"""Stage 3f: phrases for coming to a stop and for staying at one, too free for a list.

Brake smoothly to a complete standstill, down to zero, remain at rest, keep standing.
"""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases.found import Found
from ssp_eval.extract.rules.words.notation import phrases

_COMING = frozenset(
    phrases(
        """
        come, comes, coming, bring, brings, bringing, brake, brakes, braking, slow, slows, slowing,
        decelerate, decelerates, decelerating, roll, rolls, rolling, get, getting, reduce,
        reducing, decel, go, coast, coasting, ease
        """
    )
)
_OURS = (["we"], ["i"], ["ego"])
_STAYING = frozenset(
    phrases(
        """
        remain, remains, remaining, stay, stays, staying, stand, stands, standing, keep, keeps,
        keeping, wait, waits, waiting, hold, holds, holding
        """
    )
)
_FILLERS = frozenset(
    phrases(
        """
        the, a, an, us, it, our, my, its, ego, vehicle, car, down, gently, hard, smoothly, firmly,
        softly, gradually, immediately, full, complete, controlled, smooth, gentle, immediate,
        safe, total, quick, slowly, quickly, now, all, way, on, speed, further, dead, comfortably,
        moderately, sharply, promptly, progressively, hold, in, time, swift, emergency, and
        """
    )
)
_REST = frozenset(phrases("standstill, halt, stop, rest, zero"))
_STILL = frozenset(
    phrases("stopped, stationary, still, standing, halted, waiting, motionless, immobile")
)
_PLACES = frozenset(phrases("at, a, the, in, our, safely, completely, fully, on, firmly, where"))
_SIGNS = frozenset(phrases("sign, signs, line, lines, light, bar, and"))
_WAITING = frozenset(phrases("wait, stay, stop, remain"))
_DOWN = (["down"], ["way"], ["braking"], ["brake"], ["deceleration"], ["decelerate"])
_UNTIL = frozenset(phrases("until, till"))
HEADS = _COMING | _STAYING | _UNTIL | {"to", "all", "wait"}
MAX_FILLERS = 7


def halt(words: list[str], at: int) -> Found | None:
    """What a phrase that begins at a word makes of the ego's stop: ("stop", form, first, stop)."""
    word = words[at]
    form = "ing" if word.endswith("ing") and word != "bring" else "base"
    if word.endswith("s"):
        form = "s"
    if word == "to" or word == "all":
        stop = _to_rest(words, at, bare=True)
        return ("stop", "noun", at, stop) if stop else None
    if word in _UNTIL:
        return _until(words, at)
    if word in _COMING:
        stop = _to_rest(words, at + 1, bare=False)
        if stop:
            return "stop", form, at, stop
    if word in _STAYING:
        return _stays(words, at, form)
    return None


def _to_rest(words: list[str], here: int, bare: bool) -> int | None:
    """The word after "gently to a full stop"; bare: "to a standstill", with no verb before."""
    to = False
    for _ in range(MAX_FILLERS):
        if here >= len(words):
            return None
        word = words[here]
        if word == "to":
            to = True
        elif to and (word in _REST or word == "0"):
            after = words[here + 1] if here + 1 < len(words) else ""
            if after in _SIGNS and (word == "stop" and after != "and"):
                return None
            if bare and word in ("stop", "rest"):
                return None
            if bare and word in ("zero", "0") and words[here - 2 : here - 1] not in _DOWN:
                return None
            return here + 1
        elif word not in _FILLERS:
            return None
        here += 1
    return None


def _until(words: list[str], at: int) -> Found | None:
    """brake hard until standstill, till a full stop, until we stand."""
    here = at + 1
    ours = words[here : here + 1] in _OURS
    if ours:
        here += 1 + (words[here] == "the")
    while here < min(at + 5, len(words)) and words[here] in _FILLERS:
        here += 1
    if here >= len(words):
        return None
    word = words[here]
    after = words[here + 1] if here + 1 < len(words) else ""
    if word in _REST or (ours and word in ("stand", "stands", "stopped", "stops", "halt")):
        return ("stop", "noun", at, here + 1) if after not in _SIGNS else None
    bare = here == at + 1 and word in ("stopped", "stationary", "standing")
    return ("stop", "noun", at, here + 1) if bare else None


def _stays(words: list[str], at: int, form: str) -> Found | None:
    here = at + 1
    while here < min(at + 4, len(words)) and words[here] in _PLACES:
        here += 1
    if here >= len(words):
        return None
    if words[at] in _WAITING and words[here] in ("here", "there"):
        return "rest", form, at, here + 1  # wait here, stay put
    held = words[here] in _STILL or (words[here] in _REST and words[here - 1] in ("at", "a", "the"))
    if not held or words[here] in ("waiting",):
        return None
    return "rest", form, at, here + 1
