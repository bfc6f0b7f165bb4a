"""A label's place in its phase, and which labels have one (METHOD 5.2b)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ssp_core.vocabulary import PHASES
from ssp_eval import strict
from ssp_eval.strict import Place

# Where the label times of a file come from: a plan by phase, or a grid on the clock.
BY_PHASE, BY_CLOCK = "phase", "clock"
# How a place is given: in seconds beside the event, or as a fraction of the phase.
_KEYS = {"approach": "s", "trigger": "u", "conflict": "u", "resolution": "s"}


@dataclass(frozen=True)
class At:
    """A label's place in its phase.

    Args:
        phase: one of approach, trigger, conflict, resolution.
        value: seconds before the trigger (approach) or after the resolution's start (resolution);
            the fraction of its phase, in (0, 1), in trigger and conflict.
    """

    phase: str
    value: float

    def __str__(self) -> str:
        return f"{self.phase} {_KEYS[self.phase]}={self.value:.4g}"

    def to_json(self) -> dict[str, Any]:
        """As it stands in a labels file."""
        return {"phase": self.phase, _KEYS[self.phase]: self.value}


def read_at(label: dict[str, Any], place: Place, plan: str) -> At | None:
    """The place of a label: there must be one if the plan is by phase, and none on a clock grid.

    Args:
        label: parsed.
        place: of the label, for messages.
        plan: of its file.

    Raises:
        InputError: it is missing, forbidden or no place.
    """
    where = place.at("at")
    if plan == BY_CLOCK:
        if "at" in label:
            raise where.error(
                "stands in a label on a clock grid",
                remedy='write "plan": "phase" at the top of the file, or leave it out',
            )
        return None
    if "at" not in label:
        raise where.error(
            "is missing", remedy='a label of a plan by phase says its place in it, "at": {…}'
        )
    found = strict.mapping(label["at"], where, ("phase",), ("s", "u"))
    phase = strict.choice(found["phase"], where.at("phase"), PHASES)
    key = _KEYS[phase]
    strict.mapping(found, where, ("phase", key))
    value = strict.finite(found[key], where.at(key))
    if key == "u" and not 0.0 < value < 1.0:
        remedy = "give one between 0 and 1, both excluded"
        raise where.at(key).error("is no fraction of the phase", value, remedy)
    if key == "s" and value < 0.0:
        remedy = "give seconds before the trigger, or after the resolution's start"
        raise where.at(key).error("must not be negative", value, remedy)
    return At(phase, value)
