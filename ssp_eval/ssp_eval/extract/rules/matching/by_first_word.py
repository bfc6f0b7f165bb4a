"""Stage 2b: the rules for phrases that are too free to list, by the word that such one begins with.

A rule adds what it finds to the hits and returns the word after it, 0 if it finds nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ssp_eval.extract.rules.free_phrases import (
    halts,
    keeping,
    lane_and_wheel,
    pace,
    settling,
    speed_nouns,
)
from ssp_eval.extract.rules.hits import MARKS, Hit, Kind
from ssp_eval.extract.rules.words import ego_verbs

Rule = Callable[[list[str], int, list[Hit]], int]

_BARE_VALUES = {
    "straight": "keep_lane",
    "maintain": "keep_speed",
    "left": "change_left",
    "right": "change_right",
    "keep": "keep_speed",
}
_BOXES = frozenset({"ticked", "unticked"})
_PACED = frozenset({"decelerate", "maintain", "accelerate", "stop", "brake", "slow", "cruise"})
_INSIDE = (["in"], ["within"], ["inside"])
_SLIGHTLY = frozenset({"slightly", "a", "bit", "little", "gently", "somewhat"})
_STATUSES = {"potential": "potential", "possible": "potential", "active": "active"}
_CELL_OPENS = (["|"], [";"])
_CELL_CLOSES = (["|"], [";"], ["}"])
_INITIALS = {"l": "left", "r": "right"}


def _value(words: list[str], at: int, hits: list[Hit]) -> int:
    """A value that stands alone between marks, as in ['STRAIGHT', 'MAINTAIN']."""
    before = words[at - 1] if at else "."
    if before == ">" or words[at + 1 : at + 2] == [">"]:
        return 0  # from left > right
    joined = before == "and" and words[at] == "straight" and at > 1 and words[at - 2] in _PACED
    if not (joined or before in MARKS or before == "ticked") or (
        at + 1 < len(words) and words[at + 1] not in MARKS and words[at + 1] not in _BOXES
    ):
        return 0
    hits.append(Hit(Kind.VERB, _BARE_VALUES[words[at]], "value", at, at + 1))
    return at + 1


def _turned(words: list[str], at: int, hits: list[Hit]) -> int:
    """Shift right in the lane: behind a steering verb it is a direction."""
    last = hits[-1] if hits else None
    ours = words[at + 1 : at + 2] in _INSIDE and words[at + 2 : at + 3] not in (["front"], ["time"])
    if last is None or last.kind is not Kind.VERB or last.value != "steer" or not ours:
        return 0
    if any(word not in _SLIGHTLY for word in words[last.stop : at]):
        return 0
    hits.append(Hit(Kind.SIDE, words[at], "bare", at, at + 1))
    return at + 1


def _status(words: list[str], at: int, hits: list[Hit]) -> int:
    """A status that stands alone in a cell: | front | potential | stop |."""
    before, after = words[at - 1 : at], words[at + 1 : at + 2]
    if before not in _CELL_OPENS or after not in _CELL_CLOSES:
        return 0
    hits.append(Hit(Kind.CONFLICT, _STATUSES[words[at]], "", at, at + 1))
    return at + 1


def _keeping(words: list[str], at: int, hits: list[Hit]) -> int:
    kept = keeping.keep(words, at)
    if not kept:
        return 0
    hits.extend(Hit(Kind.VERB, lemma, form, a, b) for lemma, form, a, b in kept)
    return kept[-1][3]


def _settling(words: list[str], at: int, hits: list[Hit]) -> int:
    over = settling.settled(words, at)
    if over is None:
        return 0
    hits.append(Hit(Kind.CONFLICT, settling.outcome(words, over), "", at, over))
    return at + 1 if "with" in words[at:over] else over  # the conflict with the jogger is over


def _verb(find: Callable[[list[str], int], tuple[str, str, int, int] | None]) -> Rule:
    def rule(words: list[str], at: int, hits: list[Hit]) -> int:
        found = find(words, at)
        if found is None:
            return 0
        hits.append(Hit(Kind.VERB, *found))
        return found[3]

    return rule


def _initial(words: list[str], at: int, hits: list[Hit]) -> int:
    """nudge R: a letter right behind a steering verb."""
    last = hits[-1] if hits else None
    if last is None or last.kind is not Kind.VERB or last.stop != at:
        return 0
    if last.value not in ego_verbs.STEERING:
        return 0
    hits.append(Hit(Kind.SIDE, _INITIALS[words[at]], "bare", at, at + 1))
    return at + 1


_ORDER: tuple[tuple[Iterable[str], Rule], ...] = (
    (_BARE_VALUES, _value),
    (_STATUSES, _status),
    (("left", "right"), _turned),
    (keeping.HEADS, _keeping),
    (settling.HEADS, _settling),
    (halts.HEADS, _verb(halts.halt)),
    (pace.HEADS, _verb(pace.pace)),
    (speed_nouns.HEADS, _verb(speed_nouns.unchanged)),
    (lane_and_wheel.HEADS, _verb(lane_and_wheel.straight)),
    (_INITIALS, _initial),
)
RULES: dict[str, tuple[Rule, ...]] = {
    word: tuple(rule for heads, rule in _ORDER if word in heads)
    for word in {word for heads, _ in _ORDER for word in heads}
}
