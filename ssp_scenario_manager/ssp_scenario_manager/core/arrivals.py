"""States of many objects that have arrived as bytes, and wait while something is more urgent.

To take in the states of twenty objects takes longer than to judge a trigger and send what it asks
for. So they are decoded and judged after that; what a trigger needs of them it gets at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ssp_core.cdr.states import find_state
from ssp_core.motion.state import ObjectState


class Arrivals:
    """ObjectStates messages in the order of their arrival, not decoded yet."""

    def __init__(self) -> None:
        self._waiting: list[tuple[bytes, int]] = []

    def put(self, data: bytes, steady_ns: int) -> None:
        """Takes a message, and when it arrived on the steady clock."""
        self._waiting.append((data, steady_ns))

    def take(self) -> list[tuple[bytes, int]]:
        """Gives the messages with their arrivals, and forgets them."""
        taken, self._waiting = self._waiting, []
        return taken

    def newest(self, object_id: str) -> ObjectState | None:
        """The state of an object that arrived last; None: none waits, or none that can be read."""
        for data, _ in reversed(self._waiting):
            try:
                state = find_state(data, object_id)
            except ValueError:
                continue
            if state is not None:
                return state
        return None

    def over(self, known: Mapping[str, ObjectState]) -> Mapping[str, ObjectState]:
        """The newest states by id, of those that wait and those that were taken in."""
        return _Over(known, self) if self._waiting else known


class _Over(Mapping[str, ObjectState]):
    """States that wait before those that are known; an older one doesn't replace a newer one."""

    def __init__(self, known: Mapping[str, ObjectState], arrivals: Arrivals) -> None:
        self._known = known
        self._arrivals = arrivals

    def __getitem__(self, object_id: str) -> ObjectState:
        known, state = self._known.get(object_id), self._arrivals.newest(object_id)
        if state is None or (known is not None and state.stamp_ns < known.stamp_ns):
            return self._known[object_id]
        return state

    def __contains__(self, object_id: object) -> bool:
        return object_id in self._known or (
            isinstance(object_id, str) and self._arrivals.newest(object_id) is not None
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)
