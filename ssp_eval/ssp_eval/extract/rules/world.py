"""What the reader gathers from a text: the actors with what is said of them, and the ego's plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


class Statement(NamedTuple):
    """Something that the text says, with the words that say it.

    Args:
        value: a word of the slot's vocabulary, or a part of one (see decide.py).
        first: index of the first word.
        stop: index after the last word.
        sentence: index of the sentence.
    """

    value: str
    first: int
    stop: int
    sentence: int


class Commitment(NamedTuple):
    """An action that the ego commits itself to.

    Args:
        slot: lon_action or lat_action.
        value: the action.
        first: index of the first word.
        stop: index after the last word.
        unit: number of the plan unit; a later unit revises an earlier one.
        later: it is a later step of its plan (then, afterwards).
        final: it stands under a heading such as "Final plan".
        linked: joined to the one before by and, to or then.
    """

    slot: str
    value: str
    first: int
    stop: int
    unit: int
    later: bool
    final: bool
    linked: bool


@dataclass(eq=False, slots=True)
class Actor:
    """A road user of the text.

    ``label`` is the A of "Vehicle A"; ``noun`` is what it was called first, in the singular;
    ``reaction`` is 0 for none, 1 for one named in a sentence with a plan, 2 for the plan's object.
    """

    name: str
    order: int
    label: str = ""
    noun: str = ""
    colour: str = ""
    plural: bool = False
    mentions: list[Statement] = field(default_factory=list)
    places: list[Statement] = field(default_factory=list)
    motions: list[Statement] = field(default_factory=list)
    conflicts: list[Statement] = field(default_factory=list)
    first_named: Statement | None = None
    parked: bool = False
    critical: bool = False
    matters: bool = False
    background: bool = False
    gone: bool = False
    intruding: bool = False
    reaction: int = 0


@dataclass(slots=True)
class World:
    """Everything that the reader found."""

    actors: list[Actor] = field(default_factory=list)
    loose: Actor = field(default_factory=lambda: Actor("", -1))  # said of nobody in particular
    commitments: list[Commitment] = field(default_factory=list)
    revised: list[int] = field(default_factory=list)  # units that take earlier plans back
    nobody: Statement | None = None
