"""What waits for the disk: bounded, in order, and the least important is dropped first.

- Memory is bounded: data and OVERHEAD_BYTES of each message that waits or is being written count.
- A message is dropped only when all that is as important as it, or more, would not fit with it.
  So nothing is dropped while something less important waits whose place would be enough.
- Of the same importance, what came last is dropped: what is recorded stays in one piece.
- What remains comes out in the order in which it came.
- Every drop is counted by topic.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable, Mapping

from ssp_core.bag.types import BagMessage
from ssp_monitor.core.importance import Importance

# What a waiting message takes beside its data: objects, a place in the queue.
OVERHEAD_BYTES = 256
BATCH_MESSAGES = 256


class DropQueue:
    """Between the one thread that receives and the one that writes.

    Args:
        limit_bytes: what may wait.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._dropped: Counter[str] = Counter()
        self._importance: dict[str, int] = {}
        self._waiting: tuple[deque[tuple[int, BagMessage]], ...] = tuple(
            deque() for _ in Importance
        )
        self._bytes_of = [0] * len(Importance)
        self._bytes = 0
        self._writing = 0
        self._number = 0
        self._lock = threading.Lock()

    def announce(self, topics: Mapping[str, Importance]) -> None:
        """Says how important topics are; one that is not announced counts as OTHER."""
        self._importance = {**self._importance, **topics}

    def dropped(self) -> Counter[str]:
        """How many of each topic came in and don't come out."""
        with self._lock:
            return Counter(self._dropped)

    def give_up(self, messages: Iterable[BagMessage]) -> None:
        """Counts messages as dropped that were taken and can't be written."""
        with self._lock:
            self._dropped.update(message.topic for message in messages)

    @property
    def bytes(self) -> int:
        """What waits or is being written."""
        return self._bytes

    def __len__(self) -> int:
        return sum(map(len, self._waiting))

    def put(self, message: BagMessage) -> None:
        """Takes a message, or drops it or less important ones."""
        self.put_all((message,))

    def put_all(self, messages: Iterable[BagMessage]) -> None:
        """Takes messages in their order, each as ``put`` does."""
        ranks, waiting, bytes_of = self._importance, self._waiting, self._bytes_of
        with self._lock:
            for message in messages:
                rank = ranks.get(message.topic, Importance.OTHER)
                size = len(message.data) + OVERHEAD_BYTES
                if self._bytes + size > self.limit_bytes and not self._make_room(rank, size):
                    self._dropped[message.topic] += 1
                    continue
                self._bytes += size
                bytes_of[rank] += size
                self._number += 1
                waiting[rank].append((self._number, message))

    def _make_room(self, rank: int, size: int) -> bool:
        """Drops of less important ones, least first, as many as needed; none if that can't do."""
        needed = self._bytes + size - self.limit_bytes
        if sum(self._bytes_of[:rank]) < needed:
            return False
        for lower in range(rank):
            queue = self._waiting[lower]
            while needed > 0 and queue:
                _, victim = queue.pop()
                freed = len(victim.data) + OVERHEAD_BYTES
                self._dropped[victim.topic] += 1
                self._bytes_of[lower] -= freed
                self._bytes -= freed
                needed -= freed
        return True

    def take(self, most_bytes: int) -> list[BagMessage]:
        """The oldest messages, in the order in which they came; what was taken before is done with.

        Args:
            most_bytes: no more are taken once they hold this much.
        """
        taken: list[BagMessage] = []
        size = 0
        with self._lock:
            self._bytes -= self._writing
            ranks = [rank for rank, queue in enumerate(self._waiting) if queue]
            while ranks and size < most_bytes and len(taken) < BATCH_MESSAGES:
                rank = min(ranks, key=self._first_number) if len(ranks) > 1 else ranks[0]
                queue = self._waiting[rank]
                message = queue.popleft()[1]
                taken.append(message)
                own = len(message.data) + OVERHEAD_BYTES
                self._bytes_of[rank] -= own
                size += own
                if not queue:
                    ranks.remove(rank)
            self._writing = size
        return taken

    def _first_number(self, rank: int) -> int:
        return self._waiting[rank][0][0]
