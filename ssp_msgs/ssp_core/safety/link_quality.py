"""Quality of the links to the objects: clock offset, delay, states that were lost."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns

WINDOW_S = 1.0
# A rate of heartbeats that a lockstep session can reach must not fill the memory.
_MOST_EXCHANGES = 64
_REMEMBERED_BEATS = 4096
# A reply can't take less than no time; a clock that was set in between makes it seem so.
_IMPOSSIBLE_DELAY_S = -0.001


@dataclass(frozen=True, slots=True)
class LinkEstimate:
    """The estimate of the link to one object.

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
        self._answer_ns: int | None = None
        # All objects of a process are asked about at the same instant.
        self._cached_estimate: tuple[int, LinkEstimate] | None = None

    def add(self, exchange: Exchange, steady_ns: int) -> None:
        """Take an answer, and when it came on the steady clock."""
        if exchange.delay_s < _IMPOSSIBLE_DELAY_S:
            return
        self._answer_ns = steady_ns
        self._cached_estimate = None
        self._window.append((steady_ns, exchange))

    def link(self, steady_ns: int) -> LinkEstimate:
        """Return the offset and delay of the fastest exchange of the last WINDOW_S."""
        if self._cached_estimate is None or self._cached_estimate[0] != steady_ns:
            self._cached_estimate = steady_ns, self._estimate_at(steady_ns)
        return self._cached_estimate[1]

    def _estimate_at(self, steady_ns: int) -> LinkEstimate:
        if self._answer_ns is None:
            return LinkEstimate()
        oldest_ns = steady_ns - seconds_to_ns(WINDOW_S)
        recent = [exchange for at_ns, exchange in self._window if at_ns >= oldest_ns]
        age_s = (steady_ns - self._answer_ns) / NS_PER_S
        if not recent:
            return LinkEstimate(age_s=age_s)
        best = min(recent, key=lambda exchange: exchange.delay_s)
        return LinkEstimate(best.offset_s, best.delay_s, age_s)


class LinkClocks:
    """The links to all objects. One process answers for all of its objects at once."""

    def __init__(self) -> None:
        self._beats: OrderedDict[int, int] = OrderedDict()
        self._clocks: dict[tuple[str, ...], LinkClock] = {}
        self._serving: dict[str, LinkClock] = {}

    def on_sent(self, sequence: int, sent_ns: int) -> None:
        """Remember a heartbeat that went out."""
        self._beats[sequence] = sent_ns
        if len(self._beats) > _REMEMBERED_BEATS:
            self._beats.popitem(last=False)

    def on_reply(
        self, object_ids: Sequence[str], sequence: int, exchange: Exchange, steady_ns: int
    ) -> bool:
        """Take an answer to a heartbeat; tell whether it is one to a heartbeat of ours.

        Args:
            object_ids: of the process that answers.
            sequence: of the heartbeat that it answers.
            exchange: times of the heartbeat and of its answer.
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

    def link(self, object_id: str, steady_ns: int) -> LinkEstimate:
        """Return the present estimate of the link to an object."""
        clock = self._serving.get(object_id)
        return LinkEstimate() if clock is None else clock.link(steady_ns)


# A number so far below the highest doesn't come late: its sender has begun anew.
_RESTART = 1000
# Nor does the first one when so many have come already.
_BEGUN = 20


@dataclass(slots=True)
class LossCounter:
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
        """Count a state that arrived.

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
class LossCounters:
    """States of everybody, and what has been said about losses so far."""

    of: dict[str, LossCounter] = field(default_factory=dict)
    _reported_counts: dict[str, int] = field(default_factory=dict)

    def see(self, object_id: str, sequence: int) -> None:
        self.of.setdefault(object_id, LossCounter()).see(sequence)

    def forget(self) -> None:
        """Forget all counts: a new run counts anew."""
        self.of.clear()
        self._reported_counts.clear()

    def news(self) -> list[str]:
        """Return one line for people per object that has lost states since the last call."""
        lines = []
        for object_id, count in sorted(self.of.items()):
            previous_count = self._reported_counts.get(object_id, 0)
            if count.lost > previous_count:
                lines.append(
                    f"{object_id}: {count.lost - previous_count} states lost, "
                    f"{count.lost} of {count.lost + count.received} so far"
                )
            self._reported_counts[object_id] = max(previous_count, count.lost)
        return lines
