"""The output on the terminal: progress, tables, errors. The one place that knows rich."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

Item = TypeVar("Item")
# What a terminal obeys or what hides the order of a text: controls but tab and line feed, and the
# marks that turn the direction of writing round.
_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def visible(text: object) -> str:
    r"""Return the text with control characters as ``\x1b``, so that it can't steer a terminal."""
    return _UNSEEN.sub(lambda found: ascii(found[0])[1:-1], str(text))


class _Console(Console):
    """Shows the control characters in what is printed; a style comes from markup alone."""

    def print(self, *objects: Any, **options: Any) -> None:
        super().print(
            *(visible(item) if isinstance(item, str) else item for item in objects), **options
        )


# Without emoji: ``a:b:c`` in a message stays what somebody wrote.
out = _Console(highlight=False, soft_wrap=True, emoji=False)
err = _Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)


def report_error(message: str) -> None:
    """Print one message on standard error, without markup in it being interpreted."""
    err.print("[bold red]error:[/] ", end="")
    err.print(message, markup=False)


def note(message: str) -> None:
    """Print a line for people on standard error, so that standard output stays for results."""
    err.print(message, markup=False)


class _Description(ProgressColumn):
    """The description of a progress bar, with names from files in it."""

    def render(self, task: Task) -> Text:
        return Text(visible(task.description))


# Jobs of a campaign end in bursts: an estimate over few of them jumps.
_ESTIMATED_OVER_S = 600.0


class _RemainingTime(TimeRemainingColumn):
    """The time that is left, in words that tell it from the time that has passed."""

    def render(self, task: Task) -> Text:
        """Return the estimate of one task."""
        return Text("about ") + super().render(task) + Text(" left")


@contextmanager
def progress(description: str, total: int | None, *, estimated: bool = False) -> Iterator[Progress]:
    """Show a progress bar on standard error; on a pipe print nothing but its last line.

    Args:
        description: of what is counted.
        total: None: it isn't known yet.
        estimated: the time that is left is shown too.
    """
    columns: list[ProgressColumn] = [
        _Description(),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    ]
    if estimated:
        columns.append(_RemainingTime())
    with Progress(
        *columns,
        console=err,
        transient=False,
        speed_estimate_period=_ESTIMATED_OVER_S,
        disable=not sys.stderr.isatty(),
        # Else what is printed for a pipe or a file would go to standard error.
        redirect_stdout=sys.stdout.isatty(),
    ) as bar:
        bar.add_task(description, total=total)
        yield bar


def tracked(items: Iterable[Item], description: str, total: int | None) -> Iterator[Item]:
    """Yield the items, with a progress bar of those that are done."""
    with progress(description, total) as bar:
        for item in items:
            yield item
            bar.advance(bar.task_ids[0])
