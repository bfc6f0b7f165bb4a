"""Repair of a recording that was cut off or is damaged, into a closed and indexed bag."""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.metadata import is_latched, usable_qos
from ssp_core.bag.reading.mcap_file import (
    CHUNK_HEAD_BYTES,
    HEAD,
    BoundedFile,
    ChunkParts,
    Names,
    RecordFrame,
    UnpackBudget,
    chunk_length,
    chunk_parts,
    data_crc,
    inner_records,
    open_bounded,
    parse_attachment,
    parse_message,
    read_body,
    read_frame,
    read_summary,
    unpack_chunk,
)
from ssp_core.bag.reading.reader import bag_files, files_sha256, mcap_files, type_definition
from ssp_core.bag.seals.seal import Seal, files_seal, sources_with
from ssp_core.bag.types import TypeDefinition
from ssp_core.bag.writing.chain import Maker, Source
from ssp_core.bag.writing.latched import MOST_KEPT, LatchedMessage, StaticTransforms, is_static
from ssp_core.bag.writing.split import REPEATED_KEY
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from ssp_core.files.folders import new_folder

_PIECE = 1 << 20
# A chunk's first bytes: lengths below 4 GiB, the compression's name of 0, 3 or 4 letters.
_CHUNK_BEGIN = re.compile(
    rb"(?=\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}[\x00\x03\x04]\x00{3})", re.DOTALL
)
_CHUNK_BEGIN_BYTES = 41
# A file may be damaged in a million places; a person reads the first ones.
_MAX_DAMAGE = 1000
_MAX_NAME_BYTES = 240  # a file system takes 255, and the file inside is named <target>_0.mcap


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """The messages that recover kept of one or several files.

    Args:
        messages: kept, by topic.
        attachments: names of those kept.
        bytes_read: up to where the files could be read.
        bytes_total: size of the files.
        damage: per place that could not be used, what was wrong there.
        seal: how the seal of the source stands to what is in it.
    """

    messages: dict[str, int]
    attachments: tuple[str, ...]
    bytes_read: int
    bytes_total: int
    damage: tuple[str, ...]
    seal: str = ""

    @property
    def complete(self) -> bool:
        """Every file was read up to its regular end, and nothing was damaged."""
        return not self.damage

    @property
    def count(self) -> int:
        return sum(self.messages.values())


def recover(source: str | Path, target: str | Path) -> RecoverReport:
    """Copy every message that can be read into a new bag; the source stays as it is.

    A chunk counts only when its CRC is right, so nothing damaged gets into the new bag. Behind a
    damaged place the copy goes on at the next record of the file's own index, and in a file
    without one at the next chunk whose CRC is right. Latched messages that the files of a split
    bag repeat are written once. The new bag names the source, with how far that fits its seal. The
    target is whole or not there.

    Args:
        source: bag directory (with or without metadata.yaml) or .mcap file.
        target: directory of the new bag; must not exist.

    Raises:
        InputError: the source is no MCAP, or the target exists or can't be made.
        HostError: the disk doesn't take it.
    """
    source, target = Path(source), Path(target)
    files = mcap_files(source) if source.is_dir() else bag_files(source)
    if len(os.fsencode(target.name)) > _MAX_NAME_BYTES:
        raise InputError(
            f"has a name of more than {_MAX_NAME_BYTES} bytes", file=target, remedy="shorten it"
        )
    with (
        new_folder(target) as folder,
        BagWriter(folder, name=f"{target.name}_0", maker=Maker.RECOVER) as writer,
    ):
        sources = _sources(source, files)
        writer.add_sources(sources)
        into = _NewBag(writer)
        bytes_read = bytes_total = 0
        for number, file in enumerate(files):
            with open_bounded(file) as stream:
                head = stream.read(len(MCAP0_MAGIC))
                if number and head != MCAP0_MAGIC and MCAP0_MAGIC.startswith(head):
                    # A recorder that was killed when it went on in a new file.
                    into.note(f"{file.name}: has no content")
                    continue
                if head != MCAP0_MAGIC:
                    raise InputError(
                        "is no MCAP file", file=file, remedy="name a file of a recording in MCAP"
                    )
                bytes_total += stream.size
                bytes_read += _DamagedFile(into, stream, file).copy()
    if into.places > _MAX_DAMAGE:
        into.damage.append(f"{into.places - _MAX_DAMAGE} more places")
    return RecoverReport(
        messages=dict(into.messages),
        attachments=tuple(into.attachments),
        bytes_read=bytes_read,
        bytes_total=bytes_total,
        damage=tuple(into.damage),
        seal=sources[0].state,
    )


def _sources(source: Path, files: Sequence[Path]) -> tuple[Source, ...]:
    """Return the bag that is recovered, as far as it can be read, and its own sources."""
    digest, seal = "", Seal(damaged="can't be read whole")
    with suppress(InputError):
        for file in files:
            open_bounded(file).close()  # refuses a pipe, for which a digest would wait
        digest = files_sha256(files)
        seal = files_seal(files, whole=source.is_dir())
    return sources_with(source.resolve().name, digest, seal)


@dataclass(slots=True)
class _NewBag:
    """The bag that is made, and what is said of it."""

    writer: BagWriter
    messages: Counter[str] = field(default_factory=Counter)
    attachments: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    places: int = 0
    _types: dict[str, TypeDefinition] = field(default_factory=dict)
    _latched: dict[str, deque[tuple[int, int, int, int]]] = field(default_factory=dict)
    _static: dict[str, StaticTransforms] = field(default_factory=dict)

    def note(self, text: str) -> None:
        """Keep what is wrong in one place; of very many the first."""
        self.places += 1
        if self.places <= _MAX_DAMAGE:
            self.damage.append(text)

    def add(self, message: Message, channel: Channel, schema: Schema) -> None:
        """Write one message.

        Raises:
            ValueError: its topic is no CDR, or has another type than before.
        """
        topic, data = channel.topic, message.data
        if channel.message_encoding != "cdr":
            raise ValueError(f"{topic} is encoded as {channel.message_encoding!r}, not cdr")
        self._announce(channel, schema)
        repeated = REPEATED_KEY in channel.metadata
        if (static := self._static.get(topic)) is not None:
            if repeated and static.says(data):
                return
            static.keep(LatchedMessage(data, message.publish_time, message.sequence))
        elif (keys := self._latched.get(topic)) is not None:
            key = (message.publish_time, message.sequence, len(data), crc32(data))
            if repeated and key in keys:
                return
            keys.append(key)
        self.writer.write(topic, data, message.log_time, message.publish_time, message.sequence)
        self.messages[topic] += 1

    def _announce(self, channel: Channel, schema: Schema) -> None:
        topic, definition = channel.topic, type_definition(schema, channel)
        earlier_definition = self._types.get(topic)
        if earlier_definition is None:
            offered = usable_qos(channel.metadata.get("offered_qos_profiles", ""))
            latched = is_latched(offered) or REPEATED_KEY in channel.metadata
            self.writer.add_topic(topic, schema.name, offered, written=definition, latched=latched)
            self._types[topic] = definition
            if is_static(topic, schema.name):
                self._static[topic] = StaticTransforms()
            elif latched:
                self._latched[topic] = deque(maxlen=MOST_KEPT)
        elif earlier_definition.msgtype != definition.msgtype:
            raise ValueError(f"{topic} has messages of two types")
        elif (earlier_definition.encoding, earlier_definition.text) != (
            definition.encoding,
            definition.text,
        ):
            raise ValueError(f"{topic} has messages of two definitions of {schema.name}")


class _DamagedFile:
    """One file on its way into the new bag."""

    def __init__(self, into: _NewBag, stream: BoundedFile, path: Path) -> None:
        self._into = into
        self._stream = stream
        self._name = path.name
        # With the CRC over all data right, nothing needs to be doubted. Some writers give none.
        self._data_crc = data_crc(stream)
        try:
            stream.seek(0)
            summary, self._is_closed = read_summary(stream, path), True
        except InputError:
            summary, self._is_closed = Summary(), False
        # What a sound summary says of them counts, whatever stands in the data.
        self._names = Names(summary)
        self._indexed = sorted(
            [index.chunk_start_offset for index in summary.chunk_indexes]
            + [index.offset for index in summary.attachment_indexes]
        )
        self._has_chunks = bool(summary.chunk_indexes)
        # What a file may take, whatever it claims: unpacked, and looked at in vain.
        self._budget = UnpackBudget(stream.size)
        self._search_left = 2 * stream.size

    def copy(self) -> int:
        """Copy the file; give the offset behind the last record that could be used."""
        before = self._into.places
        offset = used = len(MCAP0_MAGIC)
        while offset < self._stream.size:
            try:
                frame = read_frame(self._stream, offset)
            except ValueError as error:
                offset = self._behind(offset, str(error))
                continue
            if frame.opcode == Opcode.DATA_END and self._is_record(frame.end):
                if self._data_crc is False and self._into.places == before:
                    self._note("the CRC over all data is wrong")
                return self._stream.size
            try:
                self._record(frame)
                offset = used = frame.end
            except ValueError as error:
                self._note(f"record at byte {offset} left out: {error}")
                if self._is_record(frame.end):
                    offset = frame.end
                else:
                    offset = self._behind(offset, "the damaged record's length is wrong too")
        if not self._is_closed:
            self._note(f"stopped at byte {used}: the file was not closed")
        return used

    def _note(self, text: str) -> None:
        self._into.note(f"{self._name}: {text}")

    def _is_record(self, offset: int) -> bool:
        """Tell whether a record begins there, or the file ends."""
        try:
            return offset == self._stream.size or bool(read_frame(self._stream, offset).opcode)
        except ValueError:
            return False

    def _behind(self, offset: int, why: str) -> int:
        """Find where to go on behind a damaged place; the file's size where nothing follows."""
        if self._indexed:
            place = bisect_right(self._indexed, offset)
            next_offset = self._indexed[place] if place < len(self._indexed) else None
        else:
            next_offset = next(self._chunks(offset), None)
        then = (
            "found no record behind it" if next_offset is None else f"went on at byte {next_offset}"
        )
        self._note(f"damaged at byte {offset}: {why}; {then}")
        return self._stream.size if next_offset is None else next_offset

    def _chunks(self, damaged: int) -> Iterator[int]:
        """Yield offsets behind a damaged place of what looks like a chunk and has a right CRC."""
        stream = self._stream
        stream.seek(damaged)
        opcode, length = HEAD.unpack(stream.read(HEAD.size).ljust(HEAD.size, b"\0"))
        if opcode == Opcode.CHUNK and chunk_length(stream.read(CHUNK_HEAD_BYTES)) == length:
            return  # the last chunk, which a kill cut off: its messages may hold a bag themselves
        for at in range(damaged + 1, stream.size, _PIECE):
            stream.seek(at)
            piece = stream.read(_PIECE + _CHUNK_BEGIN_BYTES)
            for match in _CHUNK_BEGIN.finditer(piece):
                offset = at + match.start()
                if match.start() < _PIECE and self._is_sound_chunk(offset):
                    yield offset

    def _is_sound_chunk(self, offset: int) -> bool:
        stream = self._stream
        try:
            frame = read_frame(stream, offset)
            stream.seek(offset + HEAD.size)
            if chunk_length(stream.read(CHUNK_HEAD_BYTES)) != frame.length:
                return False
            self._search_left -= frame.length
            if self._search_left < 0:
                return False
            parts = chunk_parts(read_body(stream, frame))
            return bool(parts.crc and self._unpacked(parts))
        except ValueError:
            return False

    def _unpacked(self, parts: ChunkParts) -> memoryview:
        self._budget.take(parts.unpacked_bytes)
        return unpack_chunk(parts)

    def _record(self, frame: RecordFrame) -> None:
        """Raise ValueError when the record is damaged; what stands before that is copied."""
        if frame.opcode == Opcode.CHUNK:
            self._chunk(self._unpacked(chunk_parts(read_body(self._stream, frame))))
        elif frame.opcode == Opcode.ATTACHMENT:
            attachment = parse_attachment(read_body(self._stream, frame))
            self._into.writer.attach(attachment.name, attachment.data, attachment.media_type)
            self._into.attachments.append(attachment.name)
        elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            # No CRC says that it is a message. In a file with chunks it is a damaged record.
            if frame.opcode == Opcode.MESSAGE and self._has_chunks and not self._data_crc:
                raise ValueError("a message outside the chunks, which nothing vouches for")
            self._inner(frame.opcode, read_body(self._stream, frame))
        elif frame.opcode == Opcode.DATA_END:
            raise ValueError("the end of the data in the midst of it")

    def _chunk(self, data: memoryview) -> None:
        self._has_chunks = True
        left_out: Counter[str] = Counter()
        for record in inner_records(data):
            try:
                self._inner(record.opcode, record.body)
            except ValueError as error:
                left_out[str(error)] += 1
        if left_out:
            reasons = left_out.most_common(3)
            raise ValueError(", ".join(f"{count} records: {why}" for why, count in reasons))

    def _inner(self, opcode: int, body: memoryview) -> None:
        """Take a schema, a channel or a message, in a chunk or outside."""
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._names.add(opcode, body)
        elif opcode == Opcode.MESSAGE:
            message = parse_message(body)
            channel = self._names.channels.get(message.channel_id)
            type_ = self._names.schemas.get(channel.schema_id) if channel is not None else None
            if channel is None or type_ is None:
                raise ValueError(f"topic or type of channel {message.channel_id} is not known")
            self._into.add(message, channel, type_)
