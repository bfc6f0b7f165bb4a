"""The terminal's effects on a program: it may ask it to end, close, or stop reading its output."""

from __future__ import annotations

import errno
import io
import os
import shlex
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from types import FrameType
from typing import Any, NoReturn

# Ctrl-C, a service manager, a closed terminal, Ctrl-\.
_ASK_TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
# Only these say more when they come again; a shell passes on the SIGHUP that its jobs had already.
_INSIST = (signal.SIGINT, signal.SIGTERM)
# `timeout` signals a process and then its group: what comes so soon is the same wish.
_SAME_WISH_S = 0.5
_NOBODY_READS = (errno.EPIPE, errno.EIO)


def catch_stop_signals(handler: Callable[[signal.Signals], None]) -> dict[signal.Signals, Any]:
    r"""Have a handler called for each signal that asks this process to end.

    Of a closed terminal and Ctrl-\ a program that was started to ignore them (``nohup``, in the
    background of a script) hears nothing.

    Args:
        handler: takes the signal: the first, and each SIGINT or SIGTERM that comes 0.5 s or more
            after it.

    Returns:
        What handled the signals before.
    """
    last_s: float | None = None

    def on_signal(number: int, _: FrameType | None) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if last_s is None or (number in _INSIST and now_s - last_s >= _SAME_WISH_S):
            last_s = now_s
            handler(signal.Signals(number))

    before = {number: signal.getsignal(number) for number in _ASK_TO_END}
    for number, former_handler in before.items():
        if number in _INSIST or former_handler is not signal.SIG_IGN:
            signal.signal(number, on_signal)
    return before


@contextmanager
def on_stop_signals(handler: Callable[[signal.Signals], None]) -> Iterator[None]:
    """Catch the stop signals as catch_stop_signals does, as long as the block runs."""
    before = catch_stop_signals(handler)
    try:
        yield
    finally:
        for number, former_handler in before.items():
            signal.signal(number, former_handler)


@contextmanager
def on_suspension(handler: Callable[[], bool]) -> Iterator[None]:
    """Have a handler called when the terminal asks this process to stand still (Ctrl-Z).

    Args:
        handler: returns True where the process goes on; False: it stands still, until it is woken.
    """

    def on_signal(_: int, __: FrameType | None) -> None:
        if not handler():
            os.kill(os.getpid(), signal.SIGSTOP)

    before = signal.getsignal(signal.SIGTSTP)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGTSTP, on_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)


class LineWriter:
    """Lines for people, written by a thread of their own.

    A terminal that is stopped (Ctrl-S), or a reader that takes nothing, holds up that thread alone.

    Args:
        write: writes a line, and may wait for as long as it likes.
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._line_count = self._written = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __call__(self, line: str) -> None:
        """Have a line written, behind all before it."""
        with self._lock:
            self._line_count += 1
            self._lines.put(line)

    def mark(self) -> Callable[[], bool]:
        """Return a function that tells whether all lines until now are written."""
        line_count = self._line_count
        return lambda: self._written >= line_count

    def close(self) -> None:
        """Wait until all lines are written."""
        self._lines.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (line := self._lines.get()) is not None:
            with suppress(OSError, ValueError):  # of a stream that was closed
                self._write(line)
            self._written += 1


def end_at_once(status: int) -> NoReturn:
    """End this process without the interpreter's own end, once all is said and closed.

    There the middleware's threads and static objects have hung for good on a busy machine, where no
    watchdog of Python's runs any more.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def own_command() -> str:
    """Return our command line as a shell calls it: installed, or by this environment's launcher."""
    root = os.environ.get("SSP_ROOT")
    installed = shutil.which("ssp") or root is None
    return "ssp" if installed else shlex.quote(str(Path(str(root)) / "ssp"))


def pasteable(*words: object) -> str:
    """Return one of our commands in backquotes, with its words quoted as a shell wants them."""
    return f"`{shlex.join(['ssp', *map(str, words)])}`"


def ignore_stop_signals() -> None:
    """Ignore stop signals in a process of a pool: the leader of the group ends it in order."""
    for number in _ASK_TO_END:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)


class _Output(io.FileIO):
    """A stream that drops what can't be written: its reader is gone, or the disk is full."""

    failure = ""

    def write(self, data: Any) -> Any:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _NOBODY_READS:
                self.failure = error.strerror or str(error)
            return memoryview(data).nbytes


def survive_lost_output() -> None:
    """Let no failure of standard output or error raise from here on in the code that prints.

    A pipe without a reader, a terminal that is gone, and a full disk are no reason to leave a
    session or a recording behind. Streams that a test has put there stay.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and stream is getattr(sys, f"__{name}__"):
            setattr(sys, name, _surviving(stream, stream.fileno()))


def keep_output_to_ourselves() -> None:
    """Have what libraries print to the standard output go to the standard error from here on.

    DDS prints its errors there by itself, and programs read ours with ``--json``. A process that
    is started from here on and inherits the standard output prints to the standard error as well.
    """
    if not isinstance(getattr(getattr(sys.stdout, "buffer", None), "raw", None), _Output):
        return
    with suppress(OSError):  # a closed standard error
        os.fstat(2)
        if sys.stdout.fileno() == 1:
            sys.stdout = _surviving(sys.stdout, os.dup(1))
            os.dup2(2, 1)


def _surviving(stream: Any, descriptor: int) -> io.TextIOWrapper:
    """Return a stream like another one, to a file descriptor, that no failed write raises from."""
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Output(descriptor, "wb", closefd=False)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering or stream.write_through,
    )


def lost_output() -> str:
    """Say why part of the standard output couldn't be written; empty for unread output."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    if not isinstance(raw, _Output):
        return ""
    sys.stdout.flush()
    return raw.failure
