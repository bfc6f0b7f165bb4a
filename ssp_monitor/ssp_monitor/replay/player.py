"""Plays a tape in a thread of its own: keeps the deadlines that the schedule gives."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

from ssp_core.bag.types import BagMessage
from ssp_core.clock import seconds_to_ns
from ssp_monitor.replay.lateness import Lateness
from ssp_monitor.replay.playback import End, Playback, Rest, Send, Tick
from ssp_monitor.replay.tape import Tape
from ssp_monitor.replay.timeline import Timeline, faster, slower


@dataclass(frozen=True, slots=True)
class Settings:
    """How a tape is played.

    Args:
        rate: bag seconds per second.
        paused: it begins with a pause.
        loop: from the beginning again at the end.
        delay_s: before the first message.
        clock_hz: ticks a second; 0: none.
        frames: recorded topics with camera frames.
    """

    rate: float = 1.0
    paused: bool = False
    loop: bool = False
    delay_s: float = 0.0
    clock_hz: float = 0.0
    frames: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the replay is.

    Args:
        bag_ns: bag time.
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
    """Plays until the tape's end, or until it is told to stop. Commands may come from any thread.

    Args:
        tape: what is played.
        settings: how.
        send: publishes one message.
        tick: publishes a time on /clock.
        over: called at the end, from the player's thread.
    """

    def __init__(
        self,
        tape: Tape,
        settings: Settings,
        send: Callable[[BagMessage], None],
        tick: Callable[[int], None],
        over: Callable[[], None] = lambda: None,
    ) -> None:
        self._tape = tape
        self._settings = settings
        self._send = send
        self._tick = tick
        self._over = over
        self.lateness = Lateness()
        self.error: BaseException | None = None
        self._sent = 0
        self._lap = 0
        self._stopped = False
        self._begin = Timeline(tape.start_ns, 0, settings.rate, settings.paused)
        self._playback: Playback | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the replay and waits for the end of its thread."""
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

    def set_paused(self, paused: bool) -> None:
        self._command(lambda playback, now_ns: playback.set_paused(paused, now_ns))

    def toggle_paused(self) -> None:
        self._command(lambda play, now_ns: play.set_paused(not play.timeline.paused, now_ns))

    def set_rate(self, rate: float) -> None:
        """Raises ValueError for a rate that can't be."""
        self._command(lambda playback, now_ns: playback.set_rate(rate, now_ns))

    def faster(self) -> None:
        self._command(lambda play, now_ns: play.set_rate(faster(play.timeline.rate), now_ns))

    def slower(self) -> None:
        self._command(lambda play, now_ns: play.set_rate(slower(play.timeline.rate), now_ns))

    def step(self) -> None:
        """One more message, then a pause."""
        self._command(Playback.step)

    def step_frame(self) -> None:
        """Messages up to and with the next camera frame, then a pause."""
        self._command(Playback.step_frame)

    @property
    def _timeline(self) -> Timeline:
        return self._begin if self._playback is None else self._playback.timeline

    def _command(self, do: Callable[[Playback, int], None]) -> None:
        with self._changed:
            if self._playback is not None:
                do(self._playback, time.monotonic_ns())
                self._changed.notify_all()

    def _run(self) -> None:
        try:
            while self._play_once() and self._settings.loop and not self._stopped:
                pass
        except BaseException as error:  # whoever waits for the end is told of it
            self.error = error
        finally:
            self._over()

    def _play_once(self) -> bool:
        """One lap; False when it was stopped before its end."""
        for message in self._tape.kept():
            self._publish(message)
        with closing(self._tape.messages()) as messages:
            delay_ns = 0 if self._lap else seconds_to_ns(self._settings.delay_s)
            hz = self._settings.clock_hz
            with self._changed:
                last = self._timeline
                begin = Timeline(
                    self._tape.start_ns, time.monotonic_ns() + delay_ns, last.rate, last.paused
                )
                tick_ns = seconds_to_ns(1.0 / hz) if hz else None
                self._playback = Playback(messages, begin, tick_ns, self._settings.frames)
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
                case Tick(bag_ns):
                    self._tick(bag_ns)
                case End():
                    return True

    def _publish(self, message: BagMessage) -> None:
        self._send(message)
        self._sent += 1
