"""Clock offset and delay of the links to the objects, from the four stamps of a heartbeat's reply.

offset = ((t2 - t1) + (t3 - t4)) / 2 and delay = (t4 - t1) - (t3 - t2), with the heartbeat sent at
t1 and the reply received at t4 on the manager's clock, the heartbeat received at t2 and the reply
sent at t3 on the object's. Whatever waits in a queue makes an exchange slow and its offset wrong by
at most half of that, so that of a window the fastest exchange is believed.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns

WINDOW_S = 1.0
# A rate of heartbeats that a lockstep session can reach must not fill the memory.
_MOST_EXCHANGES = 64
_REMEMBERED_BEATS = 4096
# A reply can't take less than no time; a clock that was set in between makes it seem so.
_IMPOSSIBLE_DELAY_S = -0.001


@dataclass(frozen=True, slots=True)
class Link:
    """What is known of the link to one object.

    Args:
        offset_s: the object's clock minus the manager's; NaN: not measured.
        delay_s: there and back; NaN: not measured.
        age_s: since the last answer, on the steady clock; inf before the first.
    """

    offset_s: float = math.nan
    delay_s: float = math.nan
    age_s: float = math.inf


@dataclass(frozen=True, slots=True)
class Exchange:
    """One heartbeat and its answer, ns; see the module's text."""

    sent_ns: int
    received_ns: int
    replied_ns: int
    arrived_ns: int

    @property
    def offset_s(self) -> float:
        ahead_ns = (self.received_ns - self.sent_ns) + (self.replied_ns - self.arrived_ns)
        return ns_to_seconds(ahead_ns) / 2.0

    @property
    def delay_s(self) -> float:
        return ns_to_seconds(
            (self.arrived_ns - self.sent_ns) - (self.replied_ns - self.received_ns)
        )


class LinkClock:
    """The exchanges with one process of objects. Reads no clock: times are given."""

    def __init__(self) -> None:
        self._window: deque[tuple[int, Exchange]] = deque(maxlen=_MOST_EXCHANGES)
        self._answered_ns: int | None = None
        # All objects of a process are asked about at the same instant.
        self._known: tuple[int, Link] | None = None

    def add(self, exchange: Exchange, steady_ns: int) -> None:
        """Takes an answer, and when it came on the steady clock."""
        if exchange.delay_s < _IMPOSSIBLE_DELAY_S:
            return
        self._answered_ns = steady_ns
        self._known = None
        self._window.append((steady_ns, exchange))

    def link(self, steady_ns: int) -> Link:
        """Offset and delay of the fastest exchange of the last WINDOW_S."""
        if self._known is None or self._known[0] != steady_ns:
            self._known = steady_ns, self._measured(steady_ns)
        return self._known[1]

    def _measured(self, steady_ns: int) -> Link:
        if self._answered_ns is None:
            return Link()
        oldest_ns = steady_ns - seconds_to_ns(WINDOW_S)
        recent = [exchange for at_ns, exchange in self._window if at_ns >= oldest_ns]
        age_s = (steady_ns - self._answered_ns) / NS_PER_S
        if not recent:
            return Link(age_s=age_s)
        best = min(recent, key=lambda exchange: exchange.delay_s)
        return Link(best.offset_s, best.delay_s, age_s)


class LinkClocks:
    """The links to all objects. One process answers for all of its objects at once."""

    def __init__(self) -> None:
        self._beats: OrderedDict[int, int] = OrderedDict()
        self._clocks: dict[tuple[str, ...], LinkClock] = {}
        self._serving: dict[str, LinkClock] = {}

    def on_sent(self, sequence: int, sent_ns: int) -> None:
        """A heartbeat went out."""
        self._beats[sequence] = sent_ns
        if len(self._beats) > _REMEMBERED_BEATS:
            self._beats.popitem(last=False)

    def on_reply(
        self, object_ids: Sequence[str], sequence: int, exchange: Exchange, steady_ns: int
    ) -> bool:
        """An answer came.

        Args:
            object_ids: of the process that answers.
            sequence: of the heartbeat that it answers.
            exchange: the four stamps.
            steady_ns: when it came, on the steady clock.

        Returns:
            False for an answer to a heartbeat that we didn't send: it says nothing of our links.
        """
        if self._beats.get(sequence) != exchange.sent_ns:
            return False
        process = tuple(object_ids)
        clock = self._clocks.setdefault(process, LinkClock())
        clock.add(exchange, steady_ns)
        for object_id in process:
            self._serving[object_id] = clock
        return True

    def link(self, object_id: str, steady_ns: int) -> Link:
        """What is known of the link to an object now."""
        clock = self._serving.get(object_id)
        return Link() if clock is None else clock.link(steady_ns)
