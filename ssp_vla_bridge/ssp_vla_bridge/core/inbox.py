"""Which requests wait, which one is worked on, and which waited too long."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from ssp_vla_bridge.core.request import Request


@dataclass(frozen=True)
class Ticket:
    """A request that was taken in, and when (ns, steady clock)."""

    number: int
    request: Request
    received_ns: int


class Inbox:
    """A bounded queue whose requests are answered exactly once: by the worker or by a deadline.

    It is not locked: whoever shares it between threads holds a lock around each call.

    Args:
        limit: requests that may wait, besides the one that is worked on.
        timeout_ns: from taking in to answering, ns.

    Raises:
        ValueError: limit or timeout is not positive.
    """

    def __init__(self, limit: int, timeout_ns: int) -> None:
        if limit < 1 or timeout_ns < 1:
            raise ValueError(f"limit {limit} and timeout {timeout_ns} ns must be positive")
        self._limit = limit
        self._timeout_ns = timeout_ns
        self._count = 0
        self._waiting: deque[Ticket] = deque()
        self._open: dict[int, Ticket] = {}

    def offer(self, request: Request, now_ns: int) -> Ticket | None:
        """Takes a request in; None when the queue is full."""
        if len(self._waiting) >= self._limit:
            return None
        self._count += 1
        ticket = Ticket(self._count, request, now_ns)
        self._waiting.append(ticket)
        self._open[ticket.number] = ticket
        return ticket

    @property
    def waiting(self) -> int:
        """Requests in the queue."""
        return len(self._waiting)

    @property
    def busy(self) -> bool:
        """True while a request is still to be answered."""
        return bool(self._open)

    def take(self) -> Ticket | None:
        """The oldest waiting request, None when there is none."""
        return self._waiting.popleft() if self._waiting else None

    def finish(self, ticket: Ticket) -> bool:
        """True when this request is still to be answered; from now on it is not."""
        return self._open.pop(ticket.number, None) is not None

    def expire(self, now_ns: int) -> list[Ticket]:
        """The requests whose time has run out, oldest first; they count as answered."""
        late = [t for t in self._open.values() if now_ns - t.received_ns > self._timeout_ns]
        for ticket in late:
            del self._open[ticket.number]
        self._waiting = deque(t for t in self._waiting if t.number in self._open)
        return late
