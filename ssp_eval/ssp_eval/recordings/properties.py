"""Discrete properties of an event, q(d, k), in words that can be compared (METHOD 4.2)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

TOPOLOGY = "topology"
ROLES = "participant_roles"
MOTION = "dominant_motion"
CONFLICT = "conflict_type"
ORDER = "passing_order"
# The fields of KPR, all of them mandatory.
FIELDS = (TOPOLOGY, ROLES, MOTION, CONFLICT, ORDER)
EVENT_PHASES = ("trigger", "conflict", "resolution")


@dataclass(frozen=True)
class Property:
    """One q(d, k).

    Args:
        words: per part of the field, the words that hold of it; None: it could not be determined.
            A recording has one word for a part as a rule, a specification any number of them: each
            is as good as the other (2 to 4 lanes).
        how: how it was determined, for people.
    """

    words: Mapping[str, tuple[str, ...]] | None
    how: str

    def without(self, parts: Collection[str]) -> Property:
        """The same without these parts: what may differ between domains isn't compared."""
        if self.words is None or not parts:
            return self
        return Property({k: v for k, v in self.words.items() if k not in parts}, self.how)

    @property
    def text(self) -> str:
        """For people: ``straight, 2 to 4 …`` without repeating what is obvious."""
        if self.words is None:
            return "not determined"
        return "; ".join(f"{part} {_either(words)}" for part, words in self.words.items())


def _either(words: tuple[str, ...]) -> str:
    if len(words) > 2 and all(word.isdigit() for word in words):
        return f"{words[0]} to {words[-1]}"
    return " or ".join(words)


def differences(found: Property, reference: Property) -> dict[str, tuple[str, str]] | None:
    """The parts in which two values of one field differ, as (found, reference).

    Two words for a part agree when they share one. An empty answer means that the fields are equal;
    None means that one of them isn't determined, so that nobody can say.
    """
    if found.words is None or reference.words is None:
        return None
    parts = {}
    for part in [*reference.words, *(p for p in found.words if p not in reference.words)]:
        ours = found.words.get(part, ())
        theirs = reference.words.get(part, ())
        if not set(ours) & set(theirs):
            parts[part] = (_either(ours) or "absent", _either(theirs) or "absent")
    return parts


def is_equal(found: Property, reference: Property) -> bool:
    """[q(d, k) = q(Syn, k)]; what isn't determined equals nothing."""
    return differences(found, reference) == {}
