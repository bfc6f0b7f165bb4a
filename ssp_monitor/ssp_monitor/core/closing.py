"""Opens the bag that was just closed and holds it against what the recorder received."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag import BagReader
from ssp_core.errors import SspError
from ssp_monitor.core.encoding import ORIGINAL

# A session's end doesn't wait longer for its checksums; `ssp bag check` reads all of any bag.
MOST_S = 2.0
_LOOK_EVERY = 256


@dataclass(frozen=True, slots=True)
class ClosingCheck:
    """What was found.

    Args:
        problems: sentences; empty when all that was looked at is as it must be.
        read: messages whose checksums were verified.
        messages: in the bag.
    """

    problems: tuple[str, ...]
    read: int
    messages: int

    @property
    def text(self) -> str:
        """One clause for the recorder's last line."""
        if self.problems:
            return f"problems: {'; '.join(self.problems)}"
        if self.read < self.messages:
            return f"counts checked, checksums of the first {self.read} messages"
        return "counts and checksums checked"


def check_closed(bag: Path, expected: Mapping[str, int], most_s: float = MOST_S) -> ClosingCheck:
    """Holds a closed bag against what was received: counts of all topics, checksums for a while.

    Args:
        bag: directory.
        expected: messages by topic that were received and not dropped; a picture that could not be
            encoded counts for its topic.
        most_s: no more time than this goes into checksums; the rest of a large bag is left to
            ``ssp bag check``, and the text says so.
    """
    read = messages = 0
    problems: list[str] = []
    try:
        with BagReader(bag) as reader:
            messages = reader.count
            counts = {name: info.count for name, info in reader.topics.items()}
            problems += _wrong_counts(counts, expected)
            until_s = time.monotonic() + most_s
            for _ in reader.messages():
                read += 1
                if read % _LOOK_EVERY == 0 and time.monotonic() > until_s:
                    break
            else:
                if read != messages:
                    problems.append(f"{read} messages can be read, {messages} are in its index")
    except SspError as error:
        problems.append(f"the bag can't be read: {error}")
    return ClosingCheck(tuple(problems), read, messages)


def _wrong_counts(counts: Mapping[str, int], expected: Mapping[str, int]) -> list[str]:
    wrong = []
    for name, count in sorted(expected.items()):
        found = counts.get(name, 0) + counts.get(name + ORIGINAL, 0)
        if found != count:
            wrong.append(f"{name}: {found} messages in the bag, {count} were received")
    return wrong
