"""How many states of each object arrived, and how many are missing, by their sequence numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

# A number so far below the highest doesn't come late: its sender has begun anew.
_RESTART = 1000
# Nor does the first one when so many have come already.
_BEGUN = 20


@dataclass(slots=True)
class Tally:
    """States of one object.

    Args:
        received: all that arrived, repeated ones included.
        lost: numbers that didn't arrive between the first and the highest that did. One that
            comes late after all is no longer lost.
    """

    received: int = 0
    lost: int = 0
    _highest: int | None = None

    def see(self, sequence: int) -> None:
        """Counts a state that arrived.

        Args:
            sequence: ObjectState.sequence; 0 where the source doesn't count.
        """
        self.received += 1
        if sequence == 0:
            return
        highest = self._highest
        anew = _BEGUN if sequence == 1 else _RESTART
        if highest is None or sequence <= highest - anew:
            self._highest = sequence
        elif sequence > highest:
            self.lost += sequence - highest - 1
            self._highest = sequence
        elif sequence < highest and self.lost:
            self.lost -= 1


@dataclass
class Tallies:
    """States of everybody, and what has been said about losses so far."""

    of: dict[str, Tally] = field(default_factory=dict)
    _told: dict[str, int] = field(default_factory=dict)

    def see(self, object_id: str, sequence: int) -> None:
        self.of.setdefault(object_id, Tally()).see(sequence)

    def forget(self) -> None:
        """A new run counts anew."""
        self.of.clear()
        self._told.clear()

    def news(self) -> list[str]:
        """One line for people per object that has lost states since the last call."""
        lines = []
        for object_id, tally in sorted(self.of.items()):
            told = self._told.get(object_id, 0)
            if tally.lost > told:
                lines.append(
                    f"{object_id}: {tally.lost - told} states lost, "
                    f"{tally.lost} of {tally.lost + tally.received} so far"
                )
            self._told[object_id] = max(told, tally.lost)
        return lines
