"""Reads a bag from end to end and says everything that is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from ssp_core.bag.mcap_file import damage_of, open_bounded
from ssp_core.bag.metadata import read_metadata
from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Result of a check.

    Args:
        messages: read and decoded, by topic.
        problems: everything found, as sentences; none when the bag is sound.
    """

    messages: dict[str, int]
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return not self.problems

    @property
    def count(self) -> int:
        return sum(self.messages.values())


def check_bag(path: Path, advance: Callable[[int], None] = lambda _: None) -> CheckReport:
    """Checks CRCs, indexes, counts and types of a bag directory or one .mcap file.

    Args:
        path: the bag.
        advance: called with the number of messages decoded since the last call.

    Raises:
        InputError: there is no bag at that path.
    """
    if not path.exists():
        raise InputError("is not there", file=path, remedy="name a bag directory or a .mcap file")
    problems: list[str] = []
    stored: Counter[str] = Counter()
    messages: Counter[str] = Counter()
    try:
        with BagReader(path) as reader:
            for file in reader.files:
                stored += _linear_counts(file)
            messages = _decode_all(reader, problems, advance)
            for name in reader.attachments:
                reader.attachment(name)
            index_counts = {name: info.count for name, info in reader.topics.items()}
        problems += _differences(stored, messages, "stored", "reached by index")
        problems += _differences(stored, index_counts, "stored", "in the summary")
        if path.is_dir():
            claimed = read_metadata(path)
            problems += _differences(stored, claimed.topic_counts, "stored", "in metadata.yaml")
            if claimed.message_count != stored.total():
                problems.append(
                    f"{stored.total()} messages stored, {claimed.message_count} in metadata.yaml"
                )
    except InputError as error:
        problems.append(str(error))
    return CheckReport(dict(messages), tuple(problems))


def _linear_counts(file: Path) -> Counter[str]:
    """Messages by topic, from one pass through the file with every CRC checked.

    Raises:
        InputError: the file is damaged or not closed.
    """
    counts: Counter[str] = Counter()
    topics: dict[int, str] = {}
    with open_bounded(file) as stream, damage_of(file):
        reader = StreamReader(stream, validate_crcs=True, record_size_limit=stream.size)
        for record in reader.records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                counts[topics[record.channel_id]] += 1
    return counts


def _decode_all(
    reader: BagReader, problems: list[str], advance: Callable[[int], None]
) -> Counter[str]:
    messages: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    for message in reader.messages():
        messages[message.topic] += 1
        try:
            reader.decode(message)
        except InputError as error:
            failed[message.topic] += 1
            if failed[message.topic] == 1:
                problems.append(str(error))
        advance(1)
    problems += [
        f"{topic}: {count} of {messages[topic]} messages can't be decoded"
        for topic, count in failed.items()
    ]
    return messages


def _differences(one: Counter[str], other: dict[str, int], name: str, other_name: str) -> list[str]:
    return [
        f"{topic}: {one.get(topic, 0)} messages {name}, {other.get(topic, 0)} {other_name}"
        for topic in sorted({*one, *other})
        if one.get(topic, 0) != other.get(topic, 0)
    ]
