"""Keeps the newest bytes of the busy topics until a snapshot is made: most are never decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from ssp_core.motion.state import ObjectState


@dataclass
class Newest:
    """The newest message per source, decoded only when it is asked for.

    Args:
        decode: gives the states of a message; raises ValueError for bytes that are none.
    """

    decode: Callable[[bytes], Iterable[ObjectState]]
    _waiting: dict[str, tuple[bytes, int]] = field(default_factory=dict)

    def put(self, source: str, data: bytes, at_ns: int) -> None:
        """A message, with its time of arrival on the steady clock."""
        self._waiting[source] = (data, at_ns)

    def take(self) -> tuple[list[tuple[list[ObjectState], int]], list[str]]:
        """What came since the last time, with times of arrival; and what of it was no message."""
        waiting, self._waiting = self._waiting, {}
        states, problems = [], []
        for source, (data, at_ns) in waiting.items():
            try:
                states.append((list(self.decode(data)), at_ns))
            except ValueError as error:
                problems.append(f"{source}: {error}")
        return states, problems
