"""The terminal: what people see on it (progress, tables, errors), and how it may end a program."""

from __future__ import annotations

import errno
import io
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
)
from rich.text import Text

# Ctrl-C, a service manager, a closed terminal, Ctrl-\.
_ASK_TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
# Only these say more when they come again; a shell passes on the SIGHUP that its jobs had already.
_INSIST = (signal.SIGINT, signal.SIGTERM)
# `timeout` signals a process and then its group: what comes so soon is the same wish.
_SAME_WISH_S = 0.5
_NOBODY_READS = (errno.EPIPE, errno.EIO)


def catch_stop_signals(handler: Callable[[signal.Signals], None]) -> dict[signal.Signals, Any]:
    """Has a handler called for each wish of somebody that this process ends.

    Of a closed terminal and Ctrl-\\ a program that was started to ignore them (``nohup``, in the
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
    for number, known in before.items():
        if number in _INSIST or known is not signal.SIG_IGN:
            signal.signal(number, on_signal)
    return before


@contextmanager
def on_stop_signals(handler: Callable[[signal.Signals], None]) -> Iterator[None]:
    """As catch_stop_signals, as long as the block runs."""
    before = catch_stop_signals(handler)
    try:
        yield
    finally:
        for number, known in before.items():
            signal.signal(number, known)


def ignore_stop_signals() -> None:
    """For a process of a pool: they reach the whole group, and who leads it ends it in order."""
    for number in _ASK_TO_END:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)


class _Output(io.FileIO):
    """A stream that drops what can't be written: nobody reads it any more, or the disk is full."""

    failure = ""

    def write(self, data: Any) -> Any:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _NOBODY_READS:
                self.failure = error.strerror or str(error)
            return memoryview(data).nbytes


def survive_lost_output() -> None:
    """From here on no failure of standard output or error raises in who prints.

    A pipe that nobody reads, a terminal that is gone, and a full disk are no reason to leave a
    session or a recording behind. Streams that a test has put there stay.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None or stream is not getattr(sys, f"__{name}__"):
            continue
        stream.flush()
        made = io.TextIOWrapper(
            io.BufferedWriter(_Output(stream.fileno(), "wb", closefd=False)),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.line_buffering or stream.write_through,
        )
        setattr(sys, name, made)


def lost_output() -> str:
    """Why not all that was printed on standard output could be written; empty for unread output."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    if not isinstance(raw, _Output):
        return ""
    sys.stdout.flush()
    return raw.failure


# What a terminal obeys or what hides the order of a text: controls but tab and line feed, and the
# marks that turn the direction of writing round.
_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def visible(text: object) -> str:
    """The text with control characters as ``\\x1b``, so that no file can steer a terminal."""
    return _UNSEEN.sub(lambda found: ascii(found[0])[1:-1], str(text))


class _Console(Console):
    """Shows the control characters in what is printed; a style comes from markup alone."""

    def print(self, *objects: Any, **options: Any) -> None:
        super().print(
            *(visible(item) if isinstance(item, str) else item for item in objects), **options
        )


out = _Console(highlight=False, soft_wrap=True)
err = _Console(stderr=True, highlight=False, soft_wrap=True)


def report_error(message: str) -> None:
    """One message on standard error, without markup in it being interpreted."""
    err.print("[bold red]error:[/] ", end="")
    err.print(message, markup=False)


def note(message: str) -> None:
    """A line for people on standard error, so that standard output stays for results."""
    err.print(message, markup=False)


class _Description(ProgressColumn):
    """What is being done, with names from files in it."""

    def render(self, task: Task) -> Text:
        return Text(visible(task.description))


@contextmanager
def progress(description: str, total: int | None) -> Iterator[Progress]:
    """A progress bar on standard error; on a pipe it prints nothing but its last line."""
    columns = (
        _Description(),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=False, disable=not sys.stderr.isatty()) as bar:
        bar.add_task(description, total=total)
        yield bar
