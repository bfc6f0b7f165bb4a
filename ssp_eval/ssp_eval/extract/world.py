"""What is gathered from a text: the road users with what is said of them, and the VUT's plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


class Statement(NamedTuple):
    """Something that the text says, with the words that say it.

    Args:
        value: a label, or one of the open motions of bind.py.
        first: index of the first word.
        stop: index after the last word.
        sentence: index of the sentence.
    """

    value: str
    first: int
    stop: int
    sentence: int


class Commitment(NamedTuple):
    """An action that the VUT commits itself to.

    Args:
        slot: lon_action or lat_action.
        value: the action.
        first: index of the first word.
        stop: index after the last word.
        unit: the plan's number; a later plan revises an earlier one.
        later: it is a later step of its plan.
        final: it stands under a heading such as "Final plan", or in a field.
    """

    slot: str
    value: str
    first: int
    stop: int
    unit: int
    later: bool
    final: bool


@dataclass(eq=False, slots=True)
class Actor:
    """A road user; reaction is 0 for none, 1 where a plan's sentence names it, 2 as its object."""

    name: str
    order: int
    noun: str = ""
    colour: str = ""
    plural: bool = False
    first: Statement | None = None
    mentions: list[Statement] = field(default_factory=list)
    places: list[Statement] = field(default_factory=list)
    motions: list[Statement] = field(default_factory=list)
    conflicts: list[Statement] = field(default_factory=list)
    parked: bool = False
    critical: bool = False
    matters: bool = False
    background: bool = False
    intruding: bool = False
    reaction: int = 0


@dataclass(slots=True)
class World:
    """Everything that was gathered."""

    actors: list[Actor] = field(default_factory=list)
    loose: list[Statement] = field(default_factory=list)  # conflicts with nobody in particular
    commitments: list[Commitment] = field(default_factory=list)
    revised: list[int] = field(default_factory=list)  # plans that take earlier ones back
    nobody: list[Statement] = field(default_factory=list)
    frames: bool = False  # it goes through several frames, of which the last counts
