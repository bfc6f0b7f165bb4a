"""What people see on the terminal: progress, tables, errors. The one place that knows rich."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def report_error(message: str) -> None:
    """One message on standard error, without markup in it being interpreted."""
    err.print("[bold red]error:[/] ", end="")
    err.print(message, markup=False)


def note(message: str) -> None:
    """A line for people on standard error, so that standard output stays for results."""
    err.print(message, markup=False)


@contextmanager
def progress(description: str, total: int | None) -> Iterator[Progress]:
    """A progress bar on standard error; on a pipe it prints nothing but its last line."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=False, disable=not sys.stderr.isatty()) as bar:
        bar.add_task(description, total=total)
        yield bar
