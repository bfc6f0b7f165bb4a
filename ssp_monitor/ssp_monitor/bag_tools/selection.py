"""The part of a bag that a command is about: a span of time and some topics."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import Any, TypeVar

import click

from ssp_core.bag.reading.reader import BagReader
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.options import usage_errors

_SECONDS = re.compile(r"([+-]?)(\d{1,11})(?:\.(\d{1,9})\d*)?\s*s?")
_NANOSECONDS = re.compile(r"(\d{1,19})\s*ns")

Command = TypeVar("Command", bound=Callable[..., Any])


def _a_time(_: click.Context, param: click.Parameter, text: str | None) -> str | None:
    """Refuse text that is no time for any bag, before the bag is opened."""
    if text is not None:
        with usage_errors():
            parse_time(text, param.opts[0], 0, 0)
    return text


def span_options(command: Command) -> Command:
    """Add --start, --end, --topics and --exclude."""
    for option in (
        click.option(
            "--exclude", multiple=True, metavar="TOPIC", help="Topics to leave out; as --topics."
        ),
        click.option(
            "--topics",
            multiple=True,
            metavar="TOPIC",
            help="Only these: names, or patterns in which * stands for any text (`ssp replay` "
            "takes regular expressions instead). May be given several times.",
        ),
        click.option("--end", metavar="TIME", callback=_a_time, help="Last time; as --start."),
        click.option(
            "--start",
            metavar="TIME",
            callback=_a_time,
            help="First time: seconds from the beginning of the bag (12.5, or -3 from its end), "
            "or nanoseconds as in the bag (1700000000000000000ns).",
        ),
    ):
        command = option(command)
    return command


def parse_time(text: str, field: str, start_ns: int, end_ns: int) -> int:
    """Return a time on the command line as a log time, ns.

    Args:
        text: seconds from the beginning, negative from the end; or nanoseconds with ``ns``.
        field: the option's name, for messages.
        start_ns: log time of the bag's first message.
        end_ns: log time of its last one.

    Raises:
        InputError: it is none.
    """
    absolute = _NANOSECONDS.fullmatch(text.strip())
    if absolute:
        return int(absolute[1])
    relative = _SECONDS.fullmatch(text.strip())
    if relative is None:
        raise InputError(
            "is no time",
            field=field,
            value=text,
            remedy="give seconds from the bag's beginning such as 12.5, or 1700000000000000000ns",
        )
    sign, whole, fraction = relative.groups()
    offset_ns = int(whole) * NS_PER_S + int((fraction or "").ljust(9, "0"))
    return max(0, end_ns - offset_ns) if sign == "-" else start_ns + offset_ns


def select_span(
    bag: BagReader, start: str | None, end: str | None
) -> tuple[int | None, int | None]:
    """Return the first log time, and the first that no longer belongs; None where not given.

    Raises:
        InputError: no times, or none in which the bag has anything.
    """
    first_ns, last_ns = bag.start_ns, bag.end_ns
    if first_ns is None or last_ns is None:
        return None, None
    start_ns = None if start is None else parse_time(start, "--start", first_ns, last_ns)
    end_ns = None if end is None else parse_time(end, "--end", first_ns, last_ns)
    if start_ns is not None and end_ns is not None and end_ns < start_ns:
        raise InputError(
            "lies before --start", field="--end", value=end, remedy="give an --end behind --start"
        )
    length_s = (last_ns - first_ns) / NS_PER_S
    if start_ns is not None and start_ns > last_ns:
        raise InputError(
            "lies behind the end of the bag",
            file=bag.path,
            field="--start",
            value=start,
            remedy=f"it is {length_s:.3f} s long",
        )
    if end_ns is not None and end_ns < first_ns:
        raise InputError(
            "lies before the beginning of the bag",
            file=bag.path,
            field="--end",
            value=end,
            remedy="give an --end behind the beginning of the bag",
        )
    return start_ns, None if end_ns is None else end_ns + 1


def select_topics(bag: BagReader, only: Sequence[str], exclude: Sequence[str]) -> list[str]:
    """Return the bag's topics that were asked for, by name.

    Raises:
        InputError: a pattern fits none of them, or nothing is left.
    """
    for field, patterns in (("--topics", only), ("--exclude", exclude)):
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in bag.topics):
                raise InputError(
                    "fits no topic of this bag",
                    file=bag.path,
                    field=field,
                    value=pattern,
                    remedy="`ssp bag info` lists them",
                )
    topic_names = [
        name
        for name in sorted(bag.topics)
        if (not only or any(fnmatchcase(name, p) for p in only))
        and not any(fnmatchcase(name, p) for p in exclude)
    ]
    if bag.topics and not topic_names:
        raise InputError(
            "leave no topic over",
            file=bag.path,
            field="--topics and --exclude",
            remedy="exclude less; `ssp bag info` lists the topics",
        )
    return topic_names
