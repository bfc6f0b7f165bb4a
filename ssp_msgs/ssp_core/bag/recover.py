"""Makes a closed, indexed bag of a recording that was cut off or is damaged in places."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.mcap_file import (
    DAMAGE,
    BoundedFile,
    framed_records,
    open_bounded,
    parse_record,
)
from ssp_core.bag.qos import parse_offered_qos
from ssp_core.bag.reader import type_definition
from ssp_core.bag.writer import BagWriter
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What recover kept of one or several files.

    Args:
        messages: kept, by topic.
        attachments: names of those kept.
        complete: every file was read up to its regular end, and nothing was damaged.
        bytes_read: up to where the files could be read.
        bytes_total: size of the files.
        damage: per place that could not be used, what was wrong there.
    """

    messages: dict[str, int]
    attachments: tuple[str, ...]
    complete: bool
    bytes_read: int
    bytes_total: int
    damage: tuple[str, ...]

    @property
    def count(self) -> int:
        return sum(self.messages.values())


@dataclass(slots=True)
class _Copy:
    """Copies the records of one file after the other into a new bag."""

    writer: BagWriter
    messages: Counter[str] = field(default_factory=Counter)
    attachments: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    bytes_read: int = 0
    bytes_total: int = 0
    _types: dict[str, str] = field(default_factory=dict)

    def file(self, path: Path) -> None:
        """Copies one file until the end of its data or the first place that can't be passed.

        Raises:
            InputError: the file is no MCAP at all.
        """
        with open_bounded(path) as stream:
            if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise InputError("is no MCAP file", file=path)
            self.bytes_total += stream.size
            self.bytes_read += self._records(stream, path.name)

    def _records(self, stream: BoundedFile, name: str) -> int:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        end = len(MCAP0_MAGIC)
        try:
            for offset, raw in framed_records(stream):
                if raw[0] == Opcode.DATA_END:
                    return stream.size
                try:
                    self._record(parse_record(raw), schemas, channels)
                except DAMAGE as error:
                    text = str(error) or type(error).__name__
                    self.damage.append(f"{name}: record at byte {offset} left out: {text}")
                end = offset + len(raw)
            raise ValueError("the file was not closed")
        except ValueError as error:
            self.damage.append(f"{name}: stopped at byte {end}: {error}")
            return end

    def _record(
        self, record: McapRecord | None, schemas: dict[int, Schema], channels: dict[int, Channel]
    ) -> None:
        if isinstance(record, Chunk):
            for inner in breakup_chunk(record, validate_crc=True):
                self._record(inner, schemas, channels)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Attachment):
            self.writer.attach(record.name, record.data, record.media_type)
            self.attachments.append(record.name)
        elif isinstance(record, Message):
            self._message(record, schemas, channels)

    def _message(
        self, message: Message, schemas: dict[int, Schema], channels: dict[int, Channel]
    ) -> None:
        channel = channels[message.channel_id]
        known = self._types.get(channel.topic)
        schema = schemas[channel.schema_id]
        if known is None:
            self.writer.add_topic(
                channel.topic,
                schema.name,
                _usable_qos(channel.metadata.get("offered_qos_profiles", "")),
                written=type_definition(schema, channel),
            )
            self._types[channel.topic] = schema.name
        elif known != schema.name:
            raise ValueError(f"{channel.topic} has messages of two types")
        self.writer.write(
            channel.topic, message.data, message.log_time, message.publish_time, message.sequence
        )
        self.messages[channel.topic] += 1


def _usable_qos(text: str) -> str:
    try:
        parse_offered_qos(text)
    except ValueError:
        return ""  # the messages matter more than what their publisher once offered
    return text


def source_files(source: Path) -> tuple[Path, ...]:
    """The MCAP files below a directory by name, or the file itself.

    Raises:
        InputError: there are none.
    """
    if source.is_dir():
        files = tuple(sorted(source.glob("*.mcap")))
        if not files:
            raise InputError("has no .mcap file", file=source)
        return files
    if not source.exists():
        raise InputError("is not there", file=source)
    return (source,)


def recover(source: str | Path, target: str | Path) -> RecoverReport:
    """Copies every message that can be read into a new bag; the source stays as it is.

    A chunk counts only when its CRC is right, so nothing damaged gets into the new bag. The
    target is whole or not there.

    Args:
        source: bag directory (with or without metadata.yaml) or .mcap file.
        target: directory of the new bag; must not exist.

    Raises:
        InputError: the source is no MCAP, or the target exists.
    """
    source, target = Path(source), Path(target)
    files = source_files(source)
    if target.exists():
        raise InputError("exists already", file=target, remedy="name a new directory")
    target.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        with BagWriter(scratch / "bag", name=f"{target.name}_0") as writer:
            copy = _Copy(writer)
            for file in files:
                copy.file(file)
        (scratch / "bag").rename(target)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return RecoverReport(
        messages=dict(copy.messages),
        attachments=tuple(copy.attachments),
        complete=not copy.damage,
        bytes_read=copy.bytes_read,
        bytes_total=copy.bytes_total,
        damage=tuple(copy.damage),
    )
