"""A one-way link that delays, loses and overtakes, counted in steps so that it repeats exactly."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class LineQuality:
    """How well a link carries in one step.

    Args:
        delay_s: each message arrives that much later, to the nearest step.
        jitter_s: one sigma that is added to the delay; messages keep their order.
        loss: share of the steps whose messages are lost.
        reorder: share of the steps whose messages are overtaken by the next ones.
        cut: nothing that is sent or under way arrives.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    reorder: float = 0.0
    cut: bool = False


PERFECT = LineQuality()


class Line(Generic[Item]):
    """Messages under way. What is sent in one step shares its fate.

    Args:
        step_ns: length of a step.
        losses: numbers in [0, 1), one is drawn a step.
        jitters: standard normal numbers, one is drawn a step.
        overtakings: numbers in [0, 1), one is drawn a step.
    """

    def __init__(
        self,
        step_ns: int,
        losses: Iterator[float],
        jitters: Iterator[float],
        overtakings: Iterator[float],
    ) -> None:
        self._step_ns = step_ns
        self._losses, self._jitters, self._overtakings = losses, jitters, overtakings
        self._under_way: deque[tuple[int, Sequence[Item]]] = deque()
        self._overtaken: Sequence[Item] = ()
        self._last_due_ns = 0

    def clear(self) -> None:
        """Nothing is under way any more."""
        self._under_way.clear()
        self._overtaken = ()
        self._last_due_ns = 0

    def pass_on(self, items: Sequence[Item], now_ns: int, quality: LineQuality) -> list[Item]:
        """Takes in what is sent in this step, and gives what arrives, in order of arrival."""
        lost = next(self._losses) < quality.loss
        jitter = next(self._jitters)
        overtaken = next(self._overtakings) < quality.reorder
        if quality.cut:
            self.clear()
            return []
        if items and not lost:
            late_s = max(quality.delay_s + quality.jitter_s * jitter, 0.0)
            late_steps = round(late_s * 1e9 / self._step_ns)
            due_ns = max(now_ns + late_steps * self._step_ns, self._last_due_ns)
            self._last_due_ns = due_ns
            if overtaken and not self._overtaken:
                self._overtaken = items
            else:
                self._under_way.append((due_ns, items))
                if self._overtaken:
                    self._under_way.append((due_ns, self._overtaken))
                    self._overtaken = ()
        arrived: list[Item] = []
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived += self._under_way.popleft()[1]
        return arrived
