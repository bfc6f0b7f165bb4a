"""Which heartbeats are our manager's: one sender whose sequence rises. Any other is a stranger's.

Two managers that both lead would pull an object to and fro, each with good heartbeats. An object
follows the one that it heard first, and stops when it hears another beside it. It follows a new one
only when the old one has fallen silent and the object stands.
"""

from __future__ import annotations

from ssp_core.clock import seconds_to_ns

# A stranger counts for so long after its last heartbeat.
_REMEMBERED_S = 1.0


class ManagerLine:
    """Tells our manager's heartbeats from others'. Reads no clock.

    Args:
        silence_s: our manager has gone when it wasn't heard for longer.
    """

    def __init__(self, silence_s: float) -> None:
        self._silence_ns = seconds_to_ns(silence_s)
        self._sender: str | None = None
        self._sequence = 0
        self._heard_ns = 0
        self._strangers: dict[str, int] = {}

    def is_ours(self, sender: str, sequence: int, steady_ns: int, *, may_move: bool) -> bool:
        """True for a heartbeat that is to be obeyed.

        Args:
            sender: node that sent it.
            sequence: of the heartbeat.
            steady_ns: when it came, on the steady clock.
            may_move: an object moves or is about to, so that nobody new may take over.
        """
        gone = not may_move and steady_ns - self._heard_ns > self._silence_ns
        if self._sender is None or gone:
            self._sender, self._sequence = sender, 0
            self._strangers.pop(sender, None)
        if sender != self._sender or sequence <= self._sequence:
            self._strangers[sender] = steady_ns
            return False
        self._sequence, self._heard_ns = sequence, steady_ns
        return True

    def strangers(self, steady_ns: int) -> int:
        """How many others were heard of late."""
        if not self._strangers:
            return 0
        oldest_ns = steady_ns - seconds_to_ns(_REMEMBERED_S)
        return sum(heard_ns >= oldest_ns for heard_ns in self._strangers.values())
