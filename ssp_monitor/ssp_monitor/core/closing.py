"""Opens the bag that was just closed and holds it against what the recorder received."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from ssp_core.bag.reader import BagReader
from ssp_core.errors import SspError
from ssp_monitor.core.records import RecorderState

# A session's end doesn't wait longer for its checksums; `ssp bag check` reads all of any bag.
MOST_S = 2.0
_LOOK_EVERY = 256
_NONE: Mapping[str, str] = MappingProxyType({})


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


@dataclass(frozen=True, slots=True)
class Closed:
    """A recording that has ended.

    Args:
        state: of the recorder.
        lost: never received, or not written, of the topics that must be complete.
        topics: in the bag.
        check: of the bag; None when it could not be closed.
        incomplete: sentences, about what the recording itself could not do.
        ambiguous: topics that are not recorded since they had several types.
    """

    state: RecorderState
    lost: int
    topics: tuple[str, ...]
    check: ClosingCheck | None
    incomplete: tuple[str, ...] = ()
    ambiguous: frozenset[str] = frozenset()

    @property
    def problems(self) -> tuple[str, ...]:
        """All that is wrong beside the number of lost messages; empty when nothing is."""
        found = self.check.problems if self.check is not None else (str(self.state.failure),)
        return (*self.incomplete, *found)


def check_closed(
    bag: Path,
    expected: Mapping[str, int],
    originals: Mapping[str, str] = _NONE,
    most_s: float = MOST_S,
) -> ClosingCheck:
    """Holds a closed bag against what was received: counts of all topics, checksums for a while.

    Args:
        bag: directory.
        expected: messages by topic that were received and not dropped; a picture that could not be
            encoded counts for its topic.
        originals: by topic, where its pictures are that could not be encoded.
        most_s: no more time than this goes into checksums; the rest of a large bag is left to
            ``ssp bag check``, and the text says so.
    """
    read = messages = 0
    problems: list[str] = []
    try:
        with BagReader(bag) as reader:
            messages = reader.count
            counts = {name: info.count for name, info in reader.topics.items()}
            problems += _wrong_counts(counts, expected, originals)
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


def _wrong_counts(
    counts: Mapping[str, int], expected: Mapping[str, int], originals: Mapping[str, str]
) -> list[str]:
    wrong = []
    for name, count in sorted(expected.items()):
        found = counts.get(name, 0)
        if name in originals:
            found += counts.get(originals[name], 0)
        if found != count:
            wrong.append(f"{name}: {found} messages in the bag, {count} were received")
    return wrong
