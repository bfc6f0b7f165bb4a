"""Keys on the terminal: what they mean, and how they are read without waiting."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from enum import Enum
from types import TracebackType
from typing import Any, Self


class Key(Enum):
    """What a person wants of a replay under way."""

    TOGGLE = "pause or go on"
    STEP = "one message"
    STEP_FRAME = "one camera frame"
    FASTER = "faster"
    SLOWER = "slower"
    QUIT = "end"


KEYS: dict[str, Key] = {
    " ": Key.TOGGLE,
    "\x1b[C": Key.STEP,  # right arrow, in both of a terminal's modes
    "\x1bOC": Key.STEP,
    "s": Key.STEP_FRAME,
    "+": Key.FASTER,
    "-": Key.SLOWER,
    "q": Key.QUIT,
}
HELP = "space: pause · →: one message · s: one camera frame · + -: rate · q: end"


def parse_keys(text: str) -> Iterator[Key]:
    """The known keys in what a terminal sent; everything else is passed over."""
    at = 0
    while at < len(text):
        word = text[at : at + 3] if text[at] == "\x1b" else text[at]
        if word in KEYS:
            yield KEYS[word]
        elif word[:1] == "\x1b":
            word = word[:1]
        at += len(word)


def _is_in_front() -> bool:
    """Whether this process has a terminal's keys; in the background a change of the terminal's mode
    would stop it."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):  # another session's terminal, or no standard input at all
        return False


class Keyboard:
    """Standard input without waiting for ends of lines; a context manager that puts it right again.

    Where standard input is no terminal, no key ever comes.
    """

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._before: Any = None

    def __enter__(self) -> Self:
        if _is_in_front():
            self._descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._descriptor is not None:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)
            self._descriptor = None

    @property
    def is_there(self) -> bool:
        return self._descriptor is not None

    def pressed(self) -> Iterator[Key]:
        """The keys since the last call."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0)[0]:
            return
        yield from parse_keys(os.read(self._descriptor, 1024).decode("utf-8", "replace"))
