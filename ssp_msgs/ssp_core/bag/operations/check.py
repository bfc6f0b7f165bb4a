"""Reading a whole bag, and reporting everything that is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.metadata import FILE_NAME, read_metadata, unlisted_files
from ssp_core.bag.pictures.stamps import LOG_LEAP_S, leap_text
from ssp_core.bag.reading.mcap_file import (
    BoundedFile,
    RecordFrame,
    UnpackBudget,
    chunk_parts,
    damage_of,
    data_crc,
    inner_records,
    open_bounded,
    parse_attachment,
    parse_message,
    parse_record,
    read_body,
    read_frame,
    unpack_chunk,
)
from ssp_core.bag.reading.reader import BagReader, bag_files, mcap_files
from ssp_core.bag.seals.seal import ALTERED, files_seal
from ssp_core.bag.seals.verdict import check_verdict
from ssp_core.bag.writing.split import REPEATED_KEY
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Result of a check.

    Args:
        messages: read, by topic.
        problems: everything found, as sentences; none when the bag is sound.
        undecoded: why messages were not decoded, by topic: their encoding or the definition of
            their type isn't understood, which is no damage.
        remarks: what is to be known of a bag that may be sound all the same.
        seal: how its seal stands to what is in it.
    """

    messages: dict[str, int]
    problems: tuple[str, ...]
    undecoded: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    seal: str = ""

    @property
    def ok(self) -> bool:
        return not self.problems

    @property
    def count(self) -> int:
        """Messages that were decoded."""
        return sum(n for topic, n in self.messages.items() if topic not in self.undecoded)


def check_bag(path: Path, advance: Callable[[int], None] = lambda _: None) -> CheckReport:
    """Check CRCs, indexes, counts and types of a bag directory or one .mcap file.

    Args:
        path: of the bag directory or the .mcap file.
        advance: called with the number of messages decoded since the last call.

    Raises:
        InputError: there is nothing at the path.
    """
    if not path.exists():
        raise InputError("is not there", file=path, remedy="name a bag directory or a .mcap file")
    problems: list[str] = []
    stored = _Pass()
    messages: Counter[str] = Counter()
    undecoded: dict[str, str] = {}
    remarks: list[str] = []
    try:
        with BagReader(path) as reader:
            for number, file in enumerate(reader.files):
                stored.file(file, later=number > 0)
            undecoded = {topic: str(why) for topic, why in reader.unreadable().items()}
            messages = _decode_all(reader, undecoded, problems, remarks, advance)
            index_counts = {name: info.count for name, info in reader.topics.items()}
            attachments = list(reader.attachments)
        reached = stored.messages - stored.repeated
        problems += _differences(reached, messages, "stored", "reached by index")
        problems += _differences(reached, index_counts, "stored", "in the summary")
        if Counter(attachments) != Counter(stored.attachments):
            problems.append(
                f"{len(stored.attachments)} attachments stored, {len(attachments)} in the summary,"
                " or under other names"
            )
        if path.is_dir():
            claimed = read_metadata(path)
            problems += [f"metadata.yaml doesn't name {name}" for name in unlisted_files(path)]
            problems += _differences(
                stored.messages, claimed.topic_counts, "stored", "in metadata.yaml"
            )
            if claimed.message_count != stored.messages.total():
                problems.append(
                    f"{stored.messages.total()} messages stored, "
                    f"{claimed.message_count} in metadata.yaml"
                )
    except InputError as error:
        problems.append(str(error))
    seal = _check_seal(path, problems, remarks)
    return CheckReport(dict(messages), tuple(problems), undecoded, tuple(remarks), seal)


def _check_seal(path: Path, problems: list[str], remarks: list[str]) -> str:
    """Return the state of a bag's seal, even of an open bag, and of the verdict beside it."""
    try:
        is_open = path.is_dir() and not (path / FILE_NAME).is_file()
        files = mcap_files(path) if is_open else bag_files(path)
        seal = files_seal(files, whole=path.is_dir())
        remarks.extend(seal.lineage)
        if seal.altered:
            problems.append(f"{path}: {ALTERED}: {seal.altered}")
        elif (source := seal.altered_source) is not None:
            problems.append(f"{path}: was made of {source.name}, which {ALTERED}")
        elif not is_open and path.is_dir():
            with BagReader(path) as reader:
                note = check_verdict(reader, seal, path)
            if note:
                remarks.append(note)
    except InputError as error:
        if str(error) not in problems:
            problems.append(str(error))
        return ""
    return seal.text


class _Pass:
    """Result of one pass through the files, from their first bytes on, with every CRC checked.

    Args:
        messages: all of them, by topic.
        repeated: those of them with which a later file repeats what an earlier one holds.
        attachments: names.
    """

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        self.repeated: Counter[str] = Counter()
        self.attachments: list[str] = []

    def file(self, path: Path, *, later: bool) -> None:
        """Count what a file holds.

        Args:
            path: of one .mcap file of the bag.
            later: it is not the bag's first one.

        Raises:
            InputError: the file is damaged or not closed; the message names the record.
        """
        self._later = later
        self._channels: dict[int, Channel] = {}
        with open_bounded(path) as stream, damage_of(path):
            budget = UnpackBudget(stream.size)
            offset = len(MCAP0_MAGIC)
            while True:
                try:
                    frame = read_frame(stream, offset)
                    if frame.opcode == Opcode.DATA_END:
                        break
                    self._frame(stream, frame, budget)
                except ValueError as error:
                    raise ValueError(f"record at byte {offset}: {error}") from error
                offset = frame.end
            # Last, since it doesn't say where the damage is.
            if data_crc(stream) is False:
                raise ValueError("the CRC over all its data is wrong")

    def _frame(self, stream: BoundedFile, frame: RecordFrame, budget: UnpackBudget) -> None:
        if frame.opcode == Opcode.CHUNK:
            parts = chunk_parts(read_body(stream, frame))
            budget.take(parts.unpacked_bytes)
            for record in inner_records(unpack_chunk(parts)):
                self._record(record.opcode, record.body)
        elif frame.opcode == Opcode.ATTACHMENT:
            self.attachments.append(parse_attachment(read_body(stream, frame)).name)
        elif frame.opcode in (Opcode.CHANNEL, Opcode.MESSAGE):
            self._record(frame.opcode, read_body(stream, frame))

    def _record(self, opcode: int, body: memoryview) -> None:
        if opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, body)
            if self._channels.setdefault(channel.id, channel) != channel:
                raise ValueError(f"two topics have number {channel.id}")
        elif opcode == Opcode.MESSAGE:
            number = parse_message(body).channel_id
            message_channel = self._channels.get(number)
            if message_channel is None:
                raise ValueError(f"a message of topic number {number}, which is not known")
            self.messages[message_channel.topic] += 1
            if self._later and REPEATED_KEY in message_channel.metadata:
                self.repeated[message_channel.topic] += 1


def _decode_all(
    reader: BagReader,
    undecoded: Container[str],
    problems: list[str],
    remarks: list[str],
    advance: Callable[[int], None],
) -> Counter[str]:
    last_ns: int | None = None
    messages: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    for message in reader.messages():
        messages[message.topic] += 1
        at_ns = message.log_time_ns
        if last_ns is not None and at_ns - last_ns > LOG_LEAP_S * NS_PER_S:
            remarks.append(leap_text(last_ns, at_ns))
        last_ns = at_ns
        if message.topic in undecoded:
            continue
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


def _differences(
    one: Mapping[str, int], other: Mapping[str, int], name: str, other_name: str
) -> list[str]:
    return [
        f"{topic}: {one.get(topic, 0)} messages {name}, {other.get(topic, 0)} {other_name}"
        for topic in sorted({*one, *other})
        if one.get(topic, 0) != other.get(topic, 0)
    ]
