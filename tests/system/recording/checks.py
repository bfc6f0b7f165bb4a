"""The contents of a bag compared with the messages that were sent."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ssp_core.bag.reading.reader import BagReader

from .load import IMAGE, LoadTopic, Sent, encode

_NUMBER_AT = {IMAGE: 32}
_STAMP = struct.Struct("<iI")
LOSS_NS = 1_000_000_000
# The recorder has more to do than the load.
LATE_FACTOR = 3
# Messages of a topic that may be sent before its subscription is matched.
UNMATCHED = 3


@dataclass(frozen=True)
class ComparedRecording:
    """One message of a bag: its number in the load, and its times."""

    number: int
    log_ns: int
    publish_ns: int


def held(bag: Path, topics: Iterable[LoadTopic]) -> dict[str, list[ComparedRecording]]:
    """The load's messages in a bag by topic, in the order in which a reader gives them.

    Raises:
        AssertionError: the bytes of one are not those that were sent.
    """
    found: dict[str, list[ComparedRecording]] = {topic.name: [] for topic in topics}
    by_name = {topic.name: topic for topic in topics}
    with BagReader(bag) as reader:
        names = [name for name in found if name in reader.topics]
        for message in reader.messages(names) if names else ():
            topic = by_name[message.topic]
            at = _NUMBER_AT.get(topic.msgtype, 8)
            number = int(message.data[at : at + 10])
            second, nanosecond = _STAMP.unpack_from(message.data, 4)
            stamp_ns = second * 1_000_000_000 + nanosecond if topic.msgtype == IMAGE else 0
            assert message.data == encode(topic, number, stamp_ns), f"{topic.name} {number}"
            found[topic.name].append(
                ComparedRecording(number, message.log_time_ns, message.publish_time_ns)
            )
    return found


def kept_until_ns(sent: Sequence[Sent], struck_ns: int) -> int:
    """Return the time up to which all messages must be there, although the recorder was struck.

    A second is lost, and on a busy machine as much as the load itself was kept from sending.

    Args:
        sent: by the load, of a topic at 50 Hz or more.
        struck_ns: steady time.
    """
    times = sorted(s.steady_ns for s in sent)
    late_ns = max((b - a for a, b in pairwise(times)), default=0)
    return struck_ns - LOSS_NS - LATE_FACTOR * late_ns


def missing(
    bag: Path, topics: Sequence[LoadTopic], sent: Sequence[Sent], until_ns: int | None = None
) -> list[str]:
    """List what a bag lacks, or has too much, of the messages sent since its first of each topic.

    Args:
        bag: closed.
        topics: of the load.
        sent: by the load.
        until_ns: steady time; what was sent later may be missing, but nothing before something
            that is there.

    Returns:
        Sentences; none when all is there, in the order in which it was sent.
    """
    problems = []
    found = held(bag, topics)
    # Since when the recording surely listened: its first message, of whatever topic.
    there = {(name, one.number) for name, messages in found.items() for one in messages}
    since_ns = min((s.steady_ns for s in sent if (s.topic, s.number) in there), default=0)
    latched = {topic.name for topic in topics if topic.latched}
    for name, messages in found.items():
        numbers = [message.number for message in messages]
        due = [
            s.number
            for s in sent
            if s.topic == name and (until_ns is None or s.steady_ns <= until_ns)
        ]
        if not numbers:
            # A subscription is matched some time after another one's first message.
            listened = [s for s in sent if s.number in due and s.topic == name]
            listened = [s for s in listened if s.steady_ns >= since_ns]
            if due and (name in latched or len(listened) >= UNMATCHED):
                problems.append(f"{name}: nothing of {due[0]} to {due[-1]}")
            continue
        expected = list(range(numbers[0], max([numbers[-1], *due]) + 1))
        lost = sorted(set(expected) - set(numbers))
        if lost:
            problems.append(
                f"{name}: {len(lost)} missing, the first is {lost[0]} of {expected[-1]}"
            )
        elif numbers != expected:
            problems.append(f"{name}: out of order or twice: {numbers[:3]} to {numbers[-3:]}")
    return problems
