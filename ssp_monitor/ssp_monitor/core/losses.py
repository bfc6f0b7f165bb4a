"""Counts messages that were published and never arrived: what is known for certain, and no more.

Three things tell of losses on a topic, and none of them tells of all:

- Publishers number their messages, and a gap between two that arrived is what is missing there. It
  is silent about what is missing behind the last one.
- The middleware counts what it knows that it could not deliver, at the end too. It is silent about
  what it delivered into a history that nobody emptied in time.
- Some publishers say in their other messages how many they have sent (``core.claims``).

The first two overlap, so that the greater of them counts. All of them are lower bounds: what is
reported as lost was lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field

# A warning names so many topics.
MOST_NAMED = 5


@dataclass(slots=True)
class Arrivals:
    """What arrived of one topic, by publisher, and what is missing.

    What a publisher sent before its first message that arrived is no loss: it may have been sent
    before anybody listened.

    Args:
        received: messages that arrived.
        gaps: messages missing between two that arrived.
        told: messages that the middleware says it could not deliver.
        behind: messages missing behind the last one that arrived.
    """

    received: int = 0
    gaps: int = 0
    told: int = 0
    behind: int = 0
    _last: dict[bytes, int] = field(default_factory=dict)

    @property
    def lost(self) -> int:
        return max(self.gaps, self.told) + self.behind

    @property
    def publishers(self) -> int:
        """How many different ones were heard."""
        return len(self._last)

    def seen(self, publisher: bytes, sequence: int) -> int:
        """Notes a message that arrived and returns how many are missing right before it.

        Args:
            publisher: what tells its publisher from others; a restarted one is another.
            sequence: the publisher's number for it, 0 where there is none; one that is not above
                the last one comes from a count that started over.
        """
        self.received += 1
        if not sequence:
            return 0
        last = self._last.get(publisher)
        self._last[publisher] = sequence
        if last is None or sequence <= last + 1:
            return 0
        missing = sequence - last - 1
        self.gaps += missing
        return missing

    def claimed(self, sent: int) -> None:
        """Notes at the end that the topic's publisher says to have sent at least so many.

        With several publishers it proves nothing, since the claim is one publisher's; with none
        heard, since it may have been sent before anybody listened.
        """
        if len(self._last) == 1:
            (last,) = self._last.values()
            self.behind = max(0, sent - last)


def losses_beside(counts: Mapping[str, int], own: Set[str]) -> list[str]:
    """A sentence about losses that don't make a run invalid, so that nothing else tells of them.

    Args:
        counts: messages that are missing, by topic.
        own: the run's topics; without any, all topics must be complete, and there is no sentence.
    """
    others = {name: n for name, n in sorted(counts.items()) if n and name not in own}
    if not own or not others:
        return []
    some = ", ".join(list(others)[:MOST_NAMED]) + (", ..." if len(others) > MOST_NAMED else "")
    return [f"{sum(others.values())} messages of topics beside the run's are missing: {some}"]
