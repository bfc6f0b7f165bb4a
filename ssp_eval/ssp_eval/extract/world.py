"""The facts gathered from a text: the road users with their attributes, and the VUT's plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import Hit, slot_of
from ssp_eval.extract.scope import Scope

_BOTH = (("lon_action", "maintain"), ("lat_action", "straight"))
_MOST_BETWEEN = 3  # words between "and" and the second of two road users, and of its own
_SPEEDS = frozenset({"decelerate", "stop", "maintain", "accelerate"})


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
        said: the action; instead of a sentence it has the number of its plan, of which a later one
            revises an earlier one.
        later: it is a later step of its plan.
        final: it stands under a heading such as "Final plan", or in a field.
    """

    slot: str
    said: Statement
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
    hints: list[Statement] = field(default_factory=list)  # places that follow from something else
    origin: Statement | None = None  # the side that it is said to be from, without a verb
    parked: bool = False
    critical: bool = False
    matters: bool = False
    background: bool = False
    intruding: bool = False
    ongoing: bool = False  # its last movement is stated in the present: is crossing
    reaction: int = 0


@dataclass(slots=True)
class World:
    """Everything that was gathered."""

    actors: list[Actor] = field(default_factory=list)
    loose: list[Statement] = field(default_factory=list)  # conflicts with nobody in particular
    commitments: list[Commitment] = field(default_factory=list)
    revised: list[int] = field(default_factory=list)  # plans that take earlier ones back
    nobody: list[Statement] = field(default_factory=list)
    sentences: int = 0
    frames: bool = False  # it goes through several frames, of which the last counts


def share_between_joined(world: World, hits: Sequence[Hit]) -> None:
    """Give road users that are named together what is said of one: "a car and a truck ahead".

    They matter alike, and the first has the places, motions and conflicts that follow behind the
    last one in the same sentence, where it has none of its own.
    """
    by_mention = {one.first: actor for actor in world.actors for one in actor.mentions}
    for user, joint, other in zip(hits, hits[1:], hits[2:], strict=False):
        if (user.kind, joint.kind, joint.value, other.kind) != ("user", "cue", "and", "user"):
            continue
        first, second = by_mention.get(user.first), by_mention.get(other.first)
        between, long = other.first - joint.stop, other.stop - other.first
        close = joint.first == user.stop and max(between, long) <= _MOST_BETWEEN
        if first is None or second is None or first.name == second.name or not close:
            continue
        sentence = next(one for one in second.mentions if one.first == other.first).sentence
        for name in ("places", "motions", "conflicts"):
            statements = [
                one
                for one in getattr(second, name)
                if one.sentence == sentence and one.first >= other.stop
            ]
            if not getattr(first, name):
                getattr(first, name).extend(statements)
        for name in ("critical", "matters", "intruding", "reaction"):
            most = max(getattr(first, name), getattr(second, name))
            setattr(first, name, most)
            setattr(second, name, most)


class Plan:
    """The plan so far, unit by unit: a sentence with a commitment is one."""

    def __init__(self, words: list[str], world: World) -> None:
        self.words, self.world = words, world
        self.final = False
        self.sequence: set[str] | None = None  # slots of a list of meta actions that are given

    def act(self, hit: Hit, flags: Scope, unit: int, strong: bool = False) -> bool:
        """Take an action of the VUT; tell whether it is a commitment of the present.

        Args:
            hit: a verb, a noun of action or a field's value.
            flags: in force at it.
            unit: number of the sentence.
            strong: it is the value of a field, or stands under a heading of the plan.
        """
        if flags & ~(Scope.FUTURE | Scope.LATER | Scope.INTENDED):
            return False
        action = lexicon().verbs[hit.value].ego if hit.kind == "verb" else hit.value
        if not action or hit.form == "ed":
            return False
        if self._is_purpose(hit, unit) and action not in _SPEEDS:
            return False
        straight = action == "maintain" and "straight" in self.words[hit.first : hit.stop]
        pairs = _BOTH if action == "both" or straight else ((slot_of(action), action),)
        for slot, value in pairs:
            later = bool(flags & Scope.LATER)
            if self.sequence is not None:
                later = later or slot in self.sequence
                self.sequence.add(slot)
            final = self.final or strong
            statement = Statement(value, hit.first, hit.stop, unit)
            self.world.commitments.append(Commitment(slot, statement, later, final))
        return True

    def made(self) -> bool:
        """Tell whether there is a commitment in a sentence before."""
        return bool(self.world.commitments)

    def _last(self, unit: int) -> Commitment | None:
        """Return the last commitment, where it stands in the same sentence."""
        last = self.world.commitments[-1] if self.world.commitments else None
        return last if last is not None and last.said.sentence == unit else None

    def _is_purpose(self, hit: Hit, unit: int) -> bool:
        """Tell whether an action is only the purpose of the one before: accelerate to merge."""
        last = self._last(unit)
        return (
            hit.form == "base"
            and self.words[hit.first - 1 : hit.first] == ["to"]
            and self.words[hit.first - 2] not in ("and", "or", ",")
            and last is not None
            and hit.first - last.said.stop < 4
        )

    def in_lane(self, hit: Hit, unit: int) -> None:
        """Brakes in its lane: the lane is kept."""
        last = self._last(unit)
        if last is not None and last.said.value in _SPEEDS:
            statement = Statement("straight", hit.first, hit.stop, unit)
            self.world.commitments.append(last._replace(slot="lat_action", said=statement))
