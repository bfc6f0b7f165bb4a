"""What the stages hand on: the words of a text that mean something to a rule."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

MARKS = frozenset({".", "?", "\n", ",", ";", ":", '"', "=", "|", "[", "(", "{", "<", ")", "}", ">"})


class Kind(IntEnum):
    """What a hit is to the rules."""

    __hash__ = int.__hash__  # the one of Enum is slow, and kinds are keys in the hot path

    SKIP = 0  # a fixed phrase that only looks like something ("bus stop", "right of way")
    OBJECT = 1  # a road user; value: its class
    EGO = 2  # the VUT
    PRONOUN = 3  # it, they, he, she
    RELATIVE = 4  # who, which, that, whose
    SCENE = 5  # another noun that can be a subject: road, light, traffic
    PLACE = 6  # a position relative to the VUT; value: front, rear, front_left …
    SIDE = 7  # left or right; form: how it is meant, see matching/sides.py
    VERB = 8  # an action or a movement; value: the lemma, form: base, s, ing, ed or noun
    STATE = 9  # an adjective that is a motion; value: the motion
    RISK = 10  # risk, danger, collision: potential, or no_conflict when denied
    CONFLICT = 11  # a phrase that settles the conflict; value: the status
    NOT = 12  # value: not, no, without, never
    NO_LONGER = 13
    MODAL = 14  # value: may, will, must
    CONDITION = 15  # value: if, after, until, needed
    AUX = 16  # value: be, have, past
    HISTORY = 17  # previously, earlier
    READY = 18  # prepare to, about to, in a position to
    REJECT = 19  # instead of, rather than, avoid, without
    REJECTED = 20  # ruled out, unnecessary: denies the action before it
    JOIN = 21  # a conjunction; value: and, or, but, so, because
    MARK = 22  # punctuation; value: the mark
    CRITICAL = 23  # says that what follows matters
    BACKGROUND = 24  # says that it doesn't
    MATTERS = 25  # obstacle, clearance, hiding: a parked vehicle with this counts
    REACT = 26  # the plan is about what follows: yield to, distance to, pass
    NOBODY = 27  # says that there is no road user
    KEY = 28  # a field name before a colon; value: the slot
    FINAL = 29  # opens the final plan
    THEN = 30  # opens a later step of the same plan
    REVISE = 31  # takes back what was planned before
    FRAME = 32  # names a frame; value: its number, or last or earlier
    QUOTE = 33  # opens a prompt, a question, options, an example
    HYPOTHETICAL = 34  # imagined, possible: what follows isn't there
    PURPOSE = 35  # to, before a verb
    IN_LANE = 36  # in our lane: with a braking it says that the lane is kept


class Hit(NamedTuple):
    """A phrase of the tables found in the text.

    Args:
        kind: what it is.
        value: what it says.
        form: the grammatical form or a refinement, ``""`` if none.
        first: index of its first word.
        stop: index after its last word.
    """

    kind: Kind
    value: str
    form: str
    first: int
    stop: int
