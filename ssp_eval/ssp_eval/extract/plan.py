"""What the VUT commits itself to."""

from __future__ import annotations

from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import Hit, slot_of
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.world import Commitment, World

_BOTH = (("lon_action", "maintain"), ("lat_action", "straight"))
_SPEEDS = frozenset({"decelerate", "stop", "maintain", "accelerate"})


class Plan:
    """The plan so far, unit by unit: a sentence with a commitment is one."""

    def __init__(self, words: list[str], world: World) -> None:
        self.words, self.world = words, world
        self.final = False
        self.sequence: set[str] | None = None  # slots of a list of meta actions that are given

    def act(self, hit: Hit, flags: Scope, unit: int, strong: bool = False) -> bool:
        """Takes an action of the VUT; whether it is a commitment of the present.

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
            self.world.commitments.append(
                Commitment(
                    slot, value, hit.first, hit.stop, unit, later, self.final or strong,
                )
            )  # fmt: skip
        return True

    def _is_purpose(self, hit: Hit, unit: int) -> bool:
        """Whether an action is only what the one before is for: accelerate to merge left."""
        last = self.world.commitments[-1] if self.world.commitments else None
        return (
            hit.form == "base"
            and self.words[hit.first - 1 : hit.first] == ["to"]
            and self.words[hit.first - 2] not in ("and", "or", ",")
            and last is not None
            and last.unit == unit
            and hit.first - last.stop < 4
        )

    def in_lane(self, hit: Hit, unit: int) -> None:
        """Brakes in its lane: the lane is kept."""
        last = self.world.commitments[-1] if self.world.commitments else None
        if last is not None and last.unit == unit and last.value in _SPEEDS:
            self.world.commitments.append(
                Commitment(
                    "lat_action", "straight", hit.first, hit.stop, unit, last.later, last.final
                )
            )
