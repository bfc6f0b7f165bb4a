"""The reports of a recorder: ``recording.json``, the check of its closed bag, the run's verdict."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ssp_core import __version__
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.errors import SspError
from ssp_core.hashing import sha256_bytes
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_monitor.recorder.plan import Attachment
from ssp_monitor.recorder.recorder import RecorderState, TopicRecord

SCHEMA = "ssp.recording/1"


def seals(attachments: Iterable[Attachment]) -> dict[str, str]:
    """Return the hash of each attachment by name, so that a bag says what was put into it."""
    return {name: sha256_bytes(data) for name, _, data in attachments}


@dataclass(frozen=True, slots=True)
class TopicCounts:
    """Messages by topic.

    Args:
        received: by the recorder; none of a topic that only the recorder itself writes.
        lost: published and never received, as far as known.
        dropped: received and not written.
        passed_over: pictures that came while a live session waited, and weren't to be kept.
    """

    received: Mapping[str, int]
    lost: Mapping[str, int]
    dropped: Mapping[str, int]
    passed_over: Mapping[str, int] = field(default_factory=dict)


def report_attachment(
    records: Iterable[TopicRecord],
    counted: TopicCounts,
    *,
    run_id: str | None,
    missing: int,
    lost_limit: int,
    warnings: Sequence[str],
    sealed: Mapping[str, str],
) -> Attachment:
    """Return the report as it is put into the bag.

    Args:
        records: of the topics, in the order of the bag.
        counted: of these topics.
        run_id: of the run, None for a recording without one.
        missing: messages lost or dropped that count (``Recording.lost``).
        lost_limit: as many may be.
        warnings: sentences, in the order in which they were said.
        sealed: hashes of the other attachments.
    """
    topics: list[dict[str, Any]] = [
        {
            "name": record.name,
            "type": record.msgtype,
            "received": counted.received.get(record.name, 0),
            "written": record.messages,
            "bytes": record.bytes,
            "lost": counted.lost.get(record.name, 0),
            "dropped": counted.dropped.get(record.name, 0),
            "passed_over": counted.passed_over.get(record.name, 0),
            "first_ns": record.first_ns,
            "last_ns": record.last_ns,
        }
        for record in records
    ]
    sums = {
        key: sum(topic[key] for topic in topics)
        for key in ("received", "written", "lost", "dropped")
    }
    value: dict[str, Any] = {
        "schema": SCHEMA,
        "recorder": f"ssp {__version__}",
        "run_id": run_id,
        **sums,
        "missing": missing,
        "lost_limit": lost_limit,
        "warnings": list(warnings),
        "seals": dict(sealed),
        "sealed": True,
        "topics": topics,
    }
    return REPORT_NAME, "application/json", (json.dumps(value, indent=1) + "\n").encode()


# A session's end doesn't wait longer for its checksums; `ssp bag check` reads all of any bag.
MOST_S = 2.0
_LOOK_EVERY = 256
_NONE: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ClosingCheck:
    """The findings of the check.

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
class ClosedRecording:
    """A recording that has ended.

    Args:
        lost: never received, or not written, of the topics that must be complete.
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
        check_problems = (
            self.check.problems if self.check is not None else (str(self.state.failure),)
        )
        return (*self.incomplete, *check_problems)


def check_closed(
    bag: Path,
    expected: Mapping[str, int],
    originals: Mapping[str, str] = _NONE,
    most_s: float = MOST_S,
) -> ClosingCheck:
    """Compare a closed bag with what was received: counts of all topics, checksums for a while.

    Args:
        bag: folder of the bag.
        expected: messages by topic that were received and not dropped; a picture that could not be
            encoded counts for its topic.
        originals: by topic, where its pictures are that could not be encoded.
        most_s: no more time than this goes into checksums; the rest of a large bag is left to ``ssp
            bag check``, and the text says so.
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
        bag_count = counts.get(name, 0)
        if name in originals:
            bag_count += counts.get(originals[name], 0)
        if bag_count != count:
            wrong.append(f"{name}: {bag_count} messages in the bag, {count} were received")
    return wrong


_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)
# What the session says in these states is the end of a run, or leads to it.
_SPOKEN = (*_OVER, SessionPhase.ABORTING)
# In these states the session has more to say.
_UNDER_WAY = (
    SessionPhase.ARMED,
    SessionPhase.RUNNING,
    SessionPhase.STOPPING,
    SessionPhase.ABORTING,
)


class RunOutcome:
    """Follows the recorded session states."""

    def __init__(self, run_id: str) -> None:
        self._run_id = run_id
        self._state = SessionPhase.UNKNOWN
        self._runs = 0
        self._others: list[str] = []
        self._end: tuple[Verdict, tuple[str, ...]] | None = None

    @property
    def is_due(self) -> bool:
        """Tell whether the session is under way, so that its last word is still to come."""
        return self._state in _UNDER_WAY

    def hear(
        self, state: SessionPhase, verdict: Verdict, reasons: tuple[str, ...], run_id: str
    ) -> None:
        """Take a session state as it was recorded (SessionState.msg)."""
        if state is SessionPhase.RUNNING and state is not self._state:
            self._runs += 1
        self._state = state
        if run_id and run_id != self._run_id and run_id not in self._others:
            self._others.append(run_id)
        if state in _SPOKEN and verdict is not Verdict.NONE:
            self._end = (verdict, reasons)

    def verdict(
        self, lost: int, lost_limit: int = 0, problems: tuple[str, ...] = ()
    ) -> tuple[Verdict, tuple[str, ...]]:
        """Return the verdict of the recording, with its reasons, the session's own first.

        Args:
            lost: messages that the recorder knows to be missing.
            lost_limit: as many may be.
            problems: what is wrong with the bag that was written.
        """
        ours: list[str] = []
        if self._state is SessionPhase.UNKNOWN:
            ours.append("no session was heard")
        elif self._end is None or self.is_due:
            ours.append(f"the recording ends while the session is {self._state.name}")
        if self._runs > 1:
            ours.append(f"{self._runs} runs are in one recording")
        ours += [f"the session ran {i}, the recording is of {self._run_id}" for i in self._others]
        if lost > lost_limit:
            limit = f", limit {lost_limit}" if lost_limit else ""
            ours.append(f"the recorder lost {lost} messages{limit}")
        ours += problems
        verdict, reasons = self._end or (Verdict.INVALID_HARNESS, ())
        if ours and verdict is Verdict.VALID:
            verdict = Verdict.INVALID_HARNESS
        return verdict, (*reasons, *ours)


MOST = 1000
# A number that stands by itself; one within a name is part of the name.
_FIGURES = re.compile(r"(?<![\w/])\d+(?:\.\d+)?(?!\w)")


class RepeatedWarnings:
    """The warnings given, at most MOST different ones, in the order of their first appearance."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def say(self, text: str) -> bool:
        """Note a sentence; return whether it is new, other than by its figures."""
        key = _FIGURES.sub("#", text)
        fresh = key not in self._texts
        if not fresh or len(self._texts) < MOST:
            self._texts[key] = text
        return fresh

    def texts(self) -> list[str]:
        return list(self._texts.values())


class MessageRates:
    """Messages a second of each topic, from one call to the next.

    Args:
        now_s: on the steady clock.
    """

    def __init__(self, now_s: float) -> None:
        self._before: tuple[float, dict[str, int]] = (now_s, {})

    def take(self, now_s: float, received: Mapping[str, int]) -> dict[str, float]:
        """Return the rates since the call before.

        Args:
            now_s: on the steady clock.
            received: how many messages of each topic were received until now.
        """
        then_s, before = self._before
        self._before = now_s, dict(received)
        span_s = max(now_s - then_s, 1e-3)
        return {name: (count - before.get(name, 0)) / span_s for name, count in received.items()}
