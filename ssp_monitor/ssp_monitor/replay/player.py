"""A replay's messages, read ahead, and the thread that sends them on time and counts lateness.

This file owns how far a replay is: ``ReadAhead`` the messages that are read and not sent,
``Playback`` the bag time of one lap and what is due next, ``Player`` laps, lateness and the thread.
A command takes effect between two messages, under the lock of ``Player``.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ssp_core.bag.pictures.stamps import LOG_LEAP_S, PAUSE_S
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.latched import LatchedMessage, StaticTransforms, is_static
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_monitor.replay.plan import Plan, PlannedTopic, ReplayOptions

if TYPE_CHECKING:
    from ssp_core.bag.reading.reader import BagReader

AHEAD_BYTES = 64 << 20
AHEAD_MESSAGES = 20_000


class MessageSource:
    """The stretch of a bag that is asked for.

    Args:
        reader: stays open as long as this is used.

    Raises:
        InputError: the stretch lies outside the bag.
    """

    def __init__(
        self, reader: BagReader, lines: tuple[PlannedTopic, ...], wishes: ReplayOptions
    ) -> None:
        start_s, end_s = wishes.start_s, wishes.end_s
        first_ns, last_ns = reader.start_ns, reader.end_ns
        if first_ns is None or last_ns is None:
            raise InputError(
                "holds no message", file=reader.path, remedy="give a bag with messages"
            )
        self._reader = reader
        self._lines = lines
        self._static: dict[str, StaticTransforms] = {}
        self.bag_start_ns = first_ns
        self.start_ns = first_ns + seconds_to_ns(start_s)
        self.end_ns = last_ns if end_s is None else min(last_ns, first_ns + seconds_to_ns(end_s))
        if not self.start_ns <= self.end_ns:
            raise InputError(
                "lies behind the end",
                file=reader.path,
                field="--start",
                value=start_s,
                remedy=f"the bag is {ns_to_seconds(last_ns - first_ns):.3f} s long"
                + ("" if end_s is None else f", --end is {end_s:g}"),
            )

    def latched_messages(self) -> list[BagMessage]:
        """Return the messages that latched publishers kept from before the start, in order of time.

        They are the newest of each publisher, as many as it offered.
        """
        self._static = {
            line.recorded: StaticTransforms()
            for line in self._lines
            if is_static(line.recorded, line.msgtype)
        }
        if self.start_ns <= self.bag_start_ns:
            return []
        newest_by_topic = {
            line.recorded: deque[BagMessage](maxlen=line.offer.depth)
            for line in self._lines
            if line.offer.latched
        }
        for message in (
            self._reader.messages(frozenset(newest_by_topic), self.bag_start_ns, self.start_ns)
            if newest_by_topic
            else ()
        ):
            newest_by_topic[message.topic].append(self._with_others(message))
        latched_messages = [
            message for messages in newest_by_topic.values() for message in messages
        ]
        return sorted(latched_messages, key=lambda message: message.log_time_ns)

    def messages(self) -> ReadAhead:
        """Return the stretch from its beginning; ``latched_messages`` goes before it."""
        topics = frozenset(line.recorded for line in self._lines)
        stretch = self._reader.messages(topics, self.start_ns, self.end_ns + 1)
        return ReadAhead(map(self._with_others, stretch))

    def _with_others(self, message: BagMessage) -> BagMessage:
        """Return the message; static transforms with those of all publishers, as tf2 sends them."""
        static = self._static.get(message.topic)
        if static is None:
            return message
        data = static.take(LatchedMessage(message.data, message.publish_time_ns, message.sequence))
        return message._replace(data=data)


class ReadAhead(Iterator[BagMessage]):
    """Messages that a thread of its own takes from an iterator before they are asked for.

    What the iterator raises is raised here in the place of the message that it has instead.

    Args:
        messages: used by that thread alone.
        limit_bytes: message data that may wait.
    """

    def __init__(self, messages: Iterator[BagMessage], limit_bytes: int = AHEAD_BYTES) -> None:
        self._messages = messages
        self._limit_bytes = limit_bytes
        self._waiting: deque[BagMessage] = deque()
        self._bytes = 0
        self._over = False
        self._closed = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)
        self._thread.start()

    def __next__(self) -> BagMessage:
        with self._changed:
            while not self._waiting:
                if self._error is not None:
                    raise self._error
                if self._over:
                    raise StopIteration
                self._changed.wait()
            message = self._waiting.popleft()
            was_full = self._is_full
            self._bytes -= len(message.data)
            if was_full and not self._is_full:
                self._changed.notify_all()
            return message

    def close(self) -> None:
        """End the thread; messages that weren't asked for are forgotten."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def _is_full(self) -> bool:
        # One message is taken however large it is.
        return self._bytes >= self._limit_bytes or len(self._waiting) >= AHEAD_MESSAGES

    def _run(self) -> None:
        try:
            for message in self._messages:
                with self._changed:
                    while self._is_full and not self._closed:
                        self._changed.wait()
                    if self._closed:
                        return
                    self._waiting.append(message)
                    self._bytes += len(message.data)
                    self._changed.notify_all()
        except BaseException as error:  # whatever it is belongs to whoever asks for messages
            self._error = error
        finally:
            with self._changed:
                self._over = True
                self._changed.notify_all()


SLOWEST, FASTEST = 0.01, 1000.0


@dataclass(frozen=True, slots=True)
class Timeline:
    """A straight line: bag time advances ``rate`` times as fast as the steady clock.

    Every change gives a new timeline that goes on from where the old one was, so that nothing is
    repeated, left out or drifts away.

    Args:
        bag_ns: bag time at ``steady_ns``; before it bag time stands there.
        steady_ns: steady clock.
        rate: bag seconds per second, above 0.
    """

    bag_ns: int
    steady_ns: int
    rate: float = 1.0
    paused: bool = False

    def at(self, steady_ns: int) -> int:
        """Return the bag time at a time of the steady clock."""
        if self.paused or steady_ns <= self.steady_ns:
            return self.bag_ns
        return self.bag_ns + math.floor((steady_ns - self.steady_ns) * self.rate)

    def due_ns(self, bag_ns: int) -> int | None:
        """Return when a time of the bag is due, steady clock; None while paused."""
        if self.paused:
            return None
        return self.steady_ns + math.ceil((bag_ns - self.bag_ns) / self.rate)

    def set_paused(self, paused: bool, now_ns: int) -> Timeline:
        """Return a timeline that stands from now on, or goes on from where it stands."""
        if paused == self.paused:
            return self
        return Timeline(self.at(now_ns), max(now_ns, self.steady_ns), self.rate, paused)

    def set_rate(self, rate: float, now_ns: int) -> Timeline:
        """Return the timeline at another rate from now on.

        Raises:
            ValueError: the rate is outside SLOWEST to FASTEST.
        """
        if not SLOWEST <= rate <= FASTEST:
            raise ValueError(f"the rate must be from {SLOWEST:g} to {FASTEST:g}, got {rate:g}")
        return Timeline(self.at(now_ns), max(now_ns, self.steady_ns), rate, self.paused)

    def moved_to(self, bag_ns: int) -> Timeline:
        """Return a paused timeline at another bag time; a timeline that runs stays as it is."""
        return replace(self, bag_ns=bag_ns) if self.paused else self


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
class Leap:
    """Bag time goes on at the next message: log times leap, which would be waits of years."""

    before_ns: int
    after_ns: int


@dataclass(frozen=True, slots=True)
class Pause:
    """Nothing was recorded for long before the next message, which is waited for."""

    before_ns: int
    after_ns: int


@dataclass(frozen=True, slots=True)
class Rest:
    """Nothing to do before this time of the steady clock; None: before somebody commands."""

    until_ns: int | None


@dataclass(frozen=True, slots=True)
class End:
    """Everything was sent."""


Action = Send | Tick | Leap | Pause | Rest | End


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
        self._reached_ns = timeline.bag_ns

    def behind_ns(self, now_ns: int) -> int:
        """Return how long the next message has been due; 0 when it isn't yet."""
        due_ns = None if self._next is None else self.timeline.due_ns(self._next.log_time_ns)
        return 0 if due_ns is None else max(now_ns - due_ns, 0)

    def set_paused(self, paused: bool, now_ns: int) -> None:
        self.timeline = self.timeline.set_paused(paused, now_ns)
        if not paused:
            self._steps, self._to_frame = 0, False

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Set the rate; raise ValueError for one that is impossible."""
        self.timeline = self.timeline.set_rate(rate, now_ns)

    def step(self, now_ns: int) -> None:
        """Play one more message, then pause."""
        self.set_paused(True, now_ns)
        self._steps += 1

    def step_frame(self, now_ns: int) -> None:
        """Play up to and with the next camera frame, then pause.

        In a bag without a camera this is one message.
        """
        if not self._frames:
            self.step(now_ns)
            return
        self.set_paused(True, now_ns)
        self._to_frame = True

    def act(self, now_ns: int) -> Action:
        """Choose the action at this time of the steady clock."""
        # Fetched only now: damage in the bag must not keep the message before it from going out.
        if self._next is None:
            self._next = next(self._messages, None)
        message = self._next
        if message is None:
            return End()
        before_ns, self._reached_ns = self._reached_ns, message.log_time_ns
        if self._reached_ns - before_ns > LOG_LEAP_S * NS_PER_S:
            line, steady_ns = self.timeline, max(now_ns, self.timeline.steady_ns)
            self.timeline = Timeline(self._reached_ns, steady_ns, line.rate, line.paused)
            return Leap(before_ns, self._reached_ns)
        if self._reached_ns - before_ns > PAUSE_S * NS_PER_S:
            return Pause(before_ns, self._reached_ns)
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


# Each step of the scale is a twentieth of a factor of two: 3.5 %.
_STEPS = 20


@dataclass(slots=True)
class Lateness:
    """Counts on a logarithmic scale; the largest value and the number are exact."""

    count: int = 0
    most_ns: int = 0
    _counts: Counter[int] = field(default_factory=Counter)

    def add(self, late_ns: int) -> None:
        """Count one more message; one that was sent early counts as in time."""
        late_ns = max(late_ns, 0)
        self.count += 1
        self.most_ns = max(self.most_ns, late_ns)
        self._counts[math.ceil(_STEPS * math.log2(late_ns)) if late_ns else -1] += 1

    def quantile_ns(self, share: float) -> int:
        """Return a lateness that at least this share of the messages keeps; at most 4 % too large.

        Args:
            share: from 0 to 1.
        """
        rank = math.ceil(share * self.count)
        cumulative_count = 0
        for step in sorted(self._counts):
            cumulative_count += self._counts[step]
            if cumulative_count >= rank:
                return min(round(2.0 ** (step / _STEPS)) if step >= 0 else 0, self.most_ns)
        return self.most_ns


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of the replay.

    Args:
        behind_ns: how long the next message has been due.
        sent: messages, of all laps.
        lap: from 1.
    """

    bag_ns: int
    rate: float
    paused: bool
    behind_ns: int
    sent: int
    lap: int


class Player:
    """Plays until the tape's end, or until it is stopped. Commands may come from any thread.

    Args:
        tape: what is played.
        send: publishes a message, in the player's thread.
        tick: publishes a bag time, ns, in that thread.
        over: called at the end, in that thread.
        listener: called with a gap of the log times that was skipped or is waited for, in that
            thread.
    """

    def __init__(
        self,
        tape: MessageSource,
        plan: Plan,
        wishes: ReplayOptions,
        send: Callable[[BagMessage], None],
        tick: Callable[[int], None],
        over: Callable[[], None] = lambda: None,
        listener: Callable[[Leap | Pause], None] = lambda _: None,
    ) -> None:
        self._tape = tape
        self._plan = plan
        self._wishes = wishes
        self._send = send
        self._tick = tick
        self._over = over
        self._listener = listener
        self.lateness = Lateness()
        self.error: BaseException | None = None
        self._sent = 0
        self._lap = 0
        self._stopped = False
        self._playback: Playback | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the replay and wait for the end of its thread."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    def progress(self) -> Progress:
        with self._changed:
            now_ns = time.monotonic_ns()
            line, playback = self._timeline, self._playback
            return Progress(
                bag_ns=min(line.at(now_ns), self._tape.end_ns),
                rate=line.rate,
                paused=line.paused,
                behind_ns=playback.behind_ns(now_ns) if playback else 0,
                sent=self._sent,
                lap=max(self._lap, 1),
            )

    def pause(self) -> None:
        self._command(lambda playback, now_ns: playback.set_paused(True, now_ns))

    def resume(self) -> None:
        self._command(lambda playback, now_ns: playback.set_paused(False, now_ns))

    def set_rate(self, rate: float) -> None:
        """Set the rate; raise ValueError for one that is impossible."""
        self._command(lambda playback, now_ns: playback.set_rate(rate, now_ns))

    def step(self) -> None:
        """Play one more message, then pause."""
        self._command(Playback.step)

    def step_frame(self) -> None:
        """Play up to and with the next camera frame, then pause."""
        self._command(Playback.step_frame)

    @property
    def _timeline(self) -> Timeline:
        if self._playback is not None:
            return self._playback.timeline
        return Timeline(self._tape.start_ns, 0, self._wishes.rate, self._wishes.paused)

    def _command(self, do: Callable[[Playback, int], None]) -> None:
        with self._changed:
            if self._playback is not None:
                do(self._playback, time.monotonic_ns())
                self._changed.notify_all()

    def _run(self) -> None:
        try:
            while self._play_once() and self._wishes.loop and not self._stopped:
                pass
        except BaseException as error:  # whoever waits for the end is told of it
            self.error = error
        finally:
            self._over()

    def _play_once(self) -> bool:
        """Play one lap; return False when it was stopped before its end."""
        for message in self._tape.latched_messages():
            self._publish(message)
        clock_hz, frames = self._plan.clock_hz, self._plan.frames
        tick_ns = seconds_to_ns(1.0 / clock_hz) if clock_hz else None
        with closing(self._tape.messages()) as messages:
            with self._changed:
                last = self._timeline
                begin = Timeline(self._tape.start_ns, time.monotonic_ns(), last.rate, last.paused)
                self._playback = Playback(messages, begin, tick_ns, frames)
                self._lap += 1
            return self._play(self._playback)

    def _play(self, playback: Playback) -> bool:
        while True:
            with self._changed:
                if self._stopped:
                    return False
                now_ns = time.monotonic_ns()
                action = playback.act(now_ns)
                if isinstance(action, Rest):
                    until_ns = action.until_ns
                    self._changed.wait(None if until_ns is None else (until_ns - now_ns) / 1e9)
                    continue
            match action:
                case Send(message, late_ns):
                    self._publish(message)
                    if late_ns is not None:
                        self.lateness.add(late_ns)
                case Leap() | Pause():
                    self._listener(action)
                case Tick(bag_ns):
                    self._tick(bag_ns)
                case End():
                    return True

    def _publish(self, message: BagMessage) -> None:
        self._send(message)
        self._sent += 1
