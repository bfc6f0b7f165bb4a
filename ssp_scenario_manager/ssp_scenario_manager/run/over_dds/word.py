"""A person's word at the terminal: what is typed after the prompt that asks for it.

Only the word ``start``, alone on its line and typed after the prompt, starts a live session.
``abort`` counts whenever it is typed, in small letters or capitals. What was typed before the
prompt is discarded; after the word, each line that isn't ``abort`` is one that doesn't count.
"""

from __future__ import annotations

import os
import re
import select
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum

from ssp_core.clock import seconds_to_ns

START = "start"
ABORT = "abort"
# How long a word holds: what can't be armed and started by then asks again.
HOLDS_S = 10.0
# Lines that follow each other faster than this are one paste, and a paste is one answer.
PASTE_S = 0.3
_MOST_BYTES = 4096
# A pipe holds no more; one that never runs dry must not keep a caller.
_MOST_READ = 1 << 20
_LINE_END = re.compile(rb"[\r\n]")


class Word(Enum):
    """The answer of a person."""

    START = "start"
    ABORT = "abort"
    END_OF_INPUT = "end of input"
    OTHER = "something else"


def word_of(text: bytes) -> Word | None:
    """Read the word in a text that came in one piece; None while no line of it is ended.

    Args:
        text: all that came since the prompt, with line ends.
    """
    lines = text.decode(errors="replace").splitlines(keepends=True)
    ended = [line.strip() for line in lines if line.endswith(("\n", "\r"))]
    if not ended:
        return None
    if ABORT in map(str.casefold, ended):
        return Word.ABORT
    return Word.START if ended == [START] and len(lines) == 1 else Word.OTHER


def _bounded(text: bytes) -> bytes:
    """Return a text, or one short enough with the same word in it: too long a one is no answer."""
    if len(text) <= _MOST_BYTES:
        return text
    if word_of(text) is Word.ABORT:
        return b"abort\n"
    return b"\n" + text.rpartition(b"\n")[2][-_MOST_BYTES:]


class TypedWords:
    """The words that are typed on a stream, which a terminal or a pipe may be. Waits for nothing.

    Args:
        fd: file descriptor of the stream; None: of standard input.

    Attributes:
        typed_after_ns: the last look before the end of the newest line, on the steady clock.
    """

    def __init__(self, fd: int | None = None) -> None:
        if fd is None:
            with suppress(AttributeError, OSError, ValueError):
                fd = sys.stdin.fileno()
        self._fd = fd
        self._ended = fd is None
        self._text = b""
        self._newest_ns = self._looked_ns = self.typed_after_ns = 0
        self._is_asking = False
        self._is_begun = False

    def ask(self, now_ns: int) -> None:
        """Begin a question: only ``abort`` counts of what was typed before it.

        A terminal discards a line that isn't ended; on a pipe it ends after the question began, and
        doesn't count either.

        Args:
            now_ns: on the steady clock.
        """
        self._looked_ns = now_ns
        self._read()
        is_aborted = word_of(self._text) is Word.ABORT
        begun = self._text.rpartition(b"\n")[2]
        if self._is_terminal():
            begun = b""
            with suppress(termios.error):
                termios.tcflush(self._fd or 0, termios.TCIFLUSH)
        self._text = b"abort\n" if is_aborted else begun
        self._is_begun = bool(begun) and not is_aborted
        self._is_asking = True

    def poll(self, now_ns: int) -> Word | None:
        """Return the answer to the question, once it is there.

        Without a question it is ABORT, or OTHER for ended lines that don't count: once for those
        that came in one piece. A word that may lie there for longer than it holds starts nothing:
        this process may have stood still.

        Args:
            now_ns: on the steady clock.
        """
        looked_ns, self._looked_ns = self._looked_ns, now_ns
        if self._read():
            self._newest_ns, self.typed_after_ns = now_ns, looked_ns
        word = word_of(self._text)
        # An input that ends within the line ends the line too, but for a word that starts.
        ending = word_of(self._text + b"\n") if self._ended else word
        if Word.ABORT in (word, ending):
            return self._take(Word.ABORT)
        if not self._is_asking:
            self._text = _LINE_END.split(self._text)[-1]
            return None if word is None else Word.OTHER
        if self._is_begun and word is not None:
            self._text, self._is_begun = self._text.partition(b"\n")[2], False
            word = word_of(self._text)
        if word is None:
            return self._take(Word.END_OF_INPUT) if self._ended else None
        if not self._ended and now_ns - self._newest_ns < seconds_to_ns(PASTE_S):
            return None
        self._text += self._line_not_ended()
        holds = now_ns - self.typed_after_ns <= seconds_to_ns(HOLDS_S)
        return self._take((word_of(self._text) if holds else None) or Word.OTHER)

    def aborts_unasked(self, now_ns: int) -> bool:
        """Tell whether ``abort`` was typed while no question is asked; others are left as they are.

        Args:
            now_ns: on the steady clock.
        """
        return not self._is_asking and self.poll(now_ns) is Word.ABORT

    def _take(self, word: Word) -> Word:
        self._text, self._is_asking, self._is_begun = b"", False, False
        return word

    def _is_terminal(self) -> bool:
        """Tell whether this is a terminal that may be read; a background one would stop us."""
        if self._fd is None or not os.isatty(self._fd):
            return False
        try:
            return os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:  # no job control of ours stops who reads it
            return True

    def _read(self) -> bool:
        """Take what is there; return True if it was something."""
        if self._ended or self._fd is None or (os.isatty(self._fd) and not self._is_terminal()):
            return False
        read = 0
        while read < _MOST_READ and select.select([self._fd], [], [], 0.0)[0]:
            try:
                data = os.read(self._fd, _MOST_BYTES)
            except OSError:  # of a terminal that was closed
                data = b""
            if not data:
                # Of a terminal it is Ctrl-D, which ends nothing where nothing was asked.
                self._ended = self._is_asking or not self._is_terminal()
                break
            read += len(data)
            self._text = _bounded(self._text + data)
        return read > 0

    def _line_not_ended(self) -> bytes:
        """Read what a terminal holds back until its line is ended: the rest of a paste."""
        if not self._is_terminal() or self._fd is None:
            return b""
        with suppress(termios.error, OSError), _unbuffered(self._fd):
            if select.select([self._fd], [], [], 0.0)[0]:
                return os.read(self._fd, 1024)
        return b""


@contextmanager
def _unbuffered(fd: int) -> Iterator[None]:
    attributes = termios.tcgetattr(fd)
    changed = [*attributes[:6], list(attributes[6])]
    changed[3] &= ~termios.ICANON
    changed[6][termios.VMIN], changed[6][termios.VTIME] = 0, 0
    termios.tcsetattr(fd, termios.TCSANOW, changed)
    try:
        yield
    finally:
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
