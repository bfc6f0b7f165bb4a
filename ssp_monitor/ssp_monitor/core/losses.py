"""Counts messages that were published and never arrived, from gaps in sequence numbers."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class SequenceGaps:
    """Losses per topic. What was published before the first message that arrived is no loss."""

    lost: dict[str, int] = field(default_factory=dict)
    _last: dict[str, int] = field(default_factory=dict)

    def seen(self, topic: str, sequence: int) -> int:
        """Notes a message that arrived and returns how many are missing right before it.

        Args:
            topic: name of the topic, which has one publisher.
            sequence: the publisher's number; one that is not above the last one comes from a
                new publisher, whose count starts over.
        """
        last = self._last.get(topic)
        self._last[topic] = sequence
        if last is None or sequence <= last + 1:
            return 0
        missing = sequence - last - 1
        self.lost[topic] = self.lost.get(topic, 0) + missing
        return missing

    @property
    def total(self) -> int:
        return sum(self.lost.values())
