"""What is to be done next: the schedule of one pass through a bag, without clock and threads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ssp_core.bag.types import BagMessage
from ssp_monitor.replay.timeline import Timeline


@dataclass(frozen=True, slots=True)
class Send:
    """Publish this message now.

    Args:
        late_ns: after it was due; None for one that was asked for by a step.
    """

    message: BagMessage
    late_ns: int | None


@dataclass(frozen=True, slots=True)
class Tick:
    """Publish this bag time on /clock now."""

    bag_ns: int


@dataclass(frozen=True, slots=True)
class Rest:
    """Nothing to do before this time of the steady clock; None: before somebody commands."""

    until_ns: int | None


@dataclass(frozen=True, slots=True)
class End:
    """Everything was sent."""


Action = Send | Tick | Rest | End


class Playback:
    """One pass; ``act`` says what to do at a time, and takes it for done.

    Args:
        messages: in order of log time.
        timeline: where it begins.
        tick_ns: steady time between two ticks of /clock; None: no ticks.
        frames: topics whose messages are camera frames, for ``step_frame``.
    """

    def __init__(
        self,
        messages: Iterator[BagMessage],
        timeline: Timeline,
        tick_ns: int | None = None,
        frames: frozenset[str] = frozenset(),
    ) -> None:
        self._messages = messages
        self._frames = frames
        self._tick_ns = tick_ns
        self._tick_at_ns = timeline.steady_ns
        self._steps = 0
        self._to_frame = False
        self.timeline = timeline
        self._next: BagMessage | None = None

    def behind_ns(self, now_ns: int) -> int:
        """How long the next message has been due; 0 when it isn't yet."""
        due_ns = None if self._next is None else self.timeline.due_ns(self._next.log_time_ns)
        return 0 if due_ns is None else max(now_ns - due_ns, 0)

    def set_paused(self, paused: bool, now_ns: int) -> None:
        self.timeline = self.timeline.set_paused(paused, now_ns)
        if not paused:
            self._steps, self._to_frame = 0, False

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Raises ValueError for a rate that can't be."""
        self.timeline = self.timeline.set_rate(rate, now_ns)

    def step(self, now_ns: int) -> None:
        """One more message, then a pause."""
        self.set_paused(True, now_ns)
        self._steps += 1

    def step_frame(self, now_ns: int) -> None:
        """Messages up to and with the next camera frame, then a pause; in a bag without a camera
        one message."""
        if not self._frames:
            self.step(now_ns)
            return
        self.set_paused(True, now_ns)
        self._to_frame = True

    def act(self, now_ns: int) -> Action:
        """What to do at this time of the steady clock."""
        # Fetched only now: damage in the bag must not keep the message before it from going out.
        if self._next is None:
            self._next = next(self._messages, None)
        message = self._next
        if message is None:
            return End()
        if self._steps or self._to_frame:
            return self._send_step(message)
        if self._tick_ns is not None and self._tick_at_ns <= now_ns:
            # Ticks that were missed are not made up for: the time that they'd tell is over.
            self._tick_at_ns = max(self._tick_at_ns, now_ns - self._tick_ns + 1) + self._tick_ns
            # Never ahead of a message that is still to come, however late that is.
            return Tick(min(self.timeline.at(now_ns), message.log_time_ns))
        due_ns = self.timeline.due_ns(message.log_time_ns)
        if due_ns is not None and due_ns <= now_ns:
            self._next = None
            return Send(message, now_ns - due_ns)
        if self._tick_ns is None:
            return Rest(due_ns)
        return Rest(self._tick_at_ns if due_ns is None else min(due_ns, self._tick_at_ns))

    def _send_step(self, message: BagMessage) -> Send:
        if self._steps:
            self._steps -= 1
        elif message.topic in self._frames:
            self._to_frame = False
        self._next = None
        self.timeline = self.timeline.moved_to(max(message.log_time_ns, self.timeline.bag_ns))
        return Send(message, None)
