"""Makes a closed, indexed bag of what can be read of a recording that was cut off or is damaged."""

from __future__ import annotations

import os
import re
import struct
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.mcap_file import (
    HEAD,
    KNOWN,
    NAMED,
    BoundedFile,
    RecordFrame,
    UnpackBudget,
    attachment_fits,
    chunk_length,
    chunk_parts,
    data_crc,
    inner_records,
    open_bounded,
    parse_attachment,
    parse_message,
    parse_named,
    read_body,
    read_frame,
    read_summary,
    unpack_chunk,
)
from ssp_core.bag.metadata import is_latched, usable_qos
from ssp_core.bag.reader import bag_files, mcap_files, type_definition
from ssp_core.bag.split import MOST_KEPT, REPEATED_KEY
from ssp_core.bag.types import TypeDefinition
from ssp_core.bag.writer import BagWriter
from ssp_core.errors import InputError
from ssp_core.files import new_folder

_INDEX = struct.Struct("<HI")  # a MessageIndex: channel, and bytes of the entries that follow
_U16 = struct.Struct("<H")
_PIECE = 1 << 20
_FIRST_PIECE = 512  # of a search: what is looked for mostly stands near
# A chunk's first bytes: lengths below 4 GiB, the compression's name of 0, 3 or 4 letters.
_CHUNK_BEGIN = re.compile(
    rb"(?=\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}[\x00\x03\x04]\x00{3})", re.DOTALL
)
_CHUNK_BEGIN_BYTES = 41
_ATTACHMENT_HEAD_BYTES = 4096  # its names stand in these
_CHUNK_HEAD_BYTES = 44  # fields before the data, with the longest name of a compression


class DamagedSpan(NamedTuple):
    """A place where no record begins, and where the next one was found (None: nowhere)."""

    offset: int
    why: str
    next_offset: int | None


class RecordScanner:
    """Records of a file in order; after a damaged place it goes on at the next whole chunk.

    What is looked at in vain while searching is bounded by twice the size of the file, so that
    no file takes more time than in proportion to its size.

    Args:
        known: offsets at which records begin, from the file's own index; empty without one.
        knows: whether a channel of that number was seen.
    """

    def __init__(
        self,
        stream: BoundedFile,
        known: Sequence[int] = (),
        knows: Callable[[int], bool] = lambda _: False,
    ) -> None:
        self._stream = stream
        self._knows = knows
        self._known = sorted(known)
        self._budget = 2 * stream.size
        self._doubt: RecordFrame | None = None

    def __iter__(self) -> Iterator[RecordFrame | DamagedSpan]:
        offset = len(MCAP0_MAGIC)
        while offset < self._stream.size:
            try:
                frame = read_frame(self._stream, offset)
            except ValueError as error:
                gap = DamagedSpan(offset, str(error), self._behind(offset))
            else:
                yield frame
                offset = frame.end
                if not self._doubted(frame) or self._continues(offset):
                    continue
                why = "the damaged record's length is wrong too"
                gap = DamagedSpan(offset, why, self._behind(frame.offset))
            yield gap
            if gap.next_offset is None:
                return
            offset = gap.next_offset

    def doubt(self, frame: RecordFrame) -> None:
        """The record just given is damaged: perhaps in its length."""
        self._doubt = frame

    def _doubted(self, frame: RecordFrame) -> bool:
        return self._doubt == frame

    def _behind(self, offset: int) -> int | None:
        """Where to go on behind a damaged record: at its end, where that can be told.

        A payload may itself hold an MCAP file, so a record is searched only when nothing else
        says where it ends.
        """
        for end in self._claimed_ends(offset):
            if end <= self._stream.size and self._continues(end):
                return end if end < self._stream.size else None
        if self._is_torn(offset):
            place = bisect_left(self._known, offset + 1)
            return self._known[place] if place < len(self._known) else None
        return self._next_record(offset + 1)

    def _head(self, offset: int) -> tuple[int, int, bytes] | None:
        """Opcode, claimed length and first bytes of what stands there."""
        self._stream.seek(offset)
        head = self._stream.read(HEAD.size + _CHUNK_HEAD_BYTES)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack_from(head)
        return opcode, length, head[HEAD.size :]

    def _claimed_ends(self, offset: int) -> Iterator[int]:
        """Where a record says that it ends: by its length, and by that of a chunk's data."""
        found = self._head(offset)
        if found is not None:
            _, length, body = found
            yield offset + HEAD.size + length
            by_data = chunk_length(body)
            if by_data is not None:
                yield offset + HEAD.size + by_data

    def _is_torn(self, offset: int) -> bool:
        """Whether a sound record begins there that the end of the file has cut off."""
        found = self._head(offset)
        if found is None or offset + HEAD.size + found[1] <= self._stream.size:
            return False
        opcode, length, body = found
        if opcode == Opcode.CHUNK:
            return chunk_length(body) == length
        if opcode == Opcode.MESSAGE_INDEX:
            return len(body) >= _INDEX.size and _INDEX.unpack_from(body)[1] == length - _INDEX.size
        if opcode == Opcode.ATTACHMENT:
            self._stream.seek(offset + HEAD.size)
            return attachment_fits(self._stream.read(_ATTACHMENT_HEAD_BYTES), length)
        return False

    def _continues(self, offset: int) -> bool:
        """Whether the file ends there, or a record begins that another one follows."""
        if offset == self._stream.size or self._is_torn(offset):
            return True
        try:
            frame = read_frame(self._stream, offset)
            if frame.opcode not in KNOWN:
                return False
            if frame.opcode == Opcode.FOOTER or frame.end == self._stream.size:
                return True
            return self._is_torn(frame.end) or read_frame(self._stream, frame.end).opcode > 0
        except ValueError:
            return False

    def _next_record(self, start: int) -> int | None:
        """Where the next record begins that the index names, or the next chunk."""
        place = bisect_left(self._known, start)
        indexed = self._known[place] if place < len(self._known) else None
        for offset in self._chunk_begins(start, indexed or self._stream.size):
            if self._is_chunk(offset):
                return offset
        return indexed

    def _chunk_begins(self, start: int, stop: int) -> Iterator[int]:
        """Offsets of what looks like the first bytes of a chunk."""
        at, size = start, _FIRST_PIECE
        while at < stop:
            size = min(size, stop - at)
            self._stream.seek(at)
            piece = self._stream.read(size + _CHUNK_BEGIN_BYTES)
            for found in _CHUNK_BEGIN.finditer(piece):
                if found.start() < size:
                    yield at + found.start()
            at += size
            size = min(2 * size, _PIECE)

    def _is_chunk(self, offset: int) -> bool:
        """Whether a chunk begins there: a right CRC, or for a packed one a record behind it."""
        try:
            frame = read_frame(self._stream, offset)
            self._stream.seek(offset + HEAD.size)
            if chunk_length(self._stream.read(_CHUNK_HEAD_BYTES)) != frame.length:
                return False
            if frame.length > self._budget:
                return False
            self._budget -= frame.length
            parts = chunk_parts(read_body(self._stream, frame))
        except ValueError:
            return False
        if parts.compression:  # its CRC is of what it unpacks to, which is looked at later
            return self._continues(frame.end)
        if not parts.crc or crc32(parts.data) != parts.crc:
            return False
        return self._is_ours(frame, parts.data)

    def _is_ours(self, frame: RecordFrame, data: memoryview) -> bool:
        """Whether its index follows, or else all its channels are known."""
        try:
            channels = {
                _U16.unpack_from(record.body)[0]
                for record in inner_records(data)
                if record.opcode == Opcode.MESSAGE and len(record.body) >= _U16.size
            }
        except ValueError:
            return False
        indexed, at = set(), frame.end
        while (found := self._head(at)) is not None and found[0] == Opcode.MESSAGE_INDEX:
            if len(found[2]) < _INDEX.size or self._is_torn(at):
                break
            indexed.add(_INDEX.unpack_from(found[2])[0])
            at += HEAD.size + found[1]
        return indexed == channels or all(map(self._knows, channels))


# rosbag2 keeps times as int64.
_MAX_TIME_NS = (1 << 63) - 1
# A file may be damaged in a million places; a person reads the first ones.
MAX_DAMAGE = 1000


class Names:
    """Schemas and channels of one file, by number.

    Args:
        summary: of the file, whose CRC was right; else an empty one.
    """

    def __init__(self, summary: Summary) -> None:
        self.schemas: dict[int, Schema | None] = dict(summary.schemas)
        self.channels: dict[int, Channel | None] = dict(summary.channels)

    def add(self, new: Schema | Channel) -> None:
        """Raises ValueError for another one of the same number; none of both is used then."""
        if isinstance(new, Schema):
            if self.schemas.setdefault(new.id, new) != new:
                self.schemas[new.id] = None
                raise ValueError(f"two types have number {new.id}")
        elif self.channels.setdefault(new.id, new) != new:
            self.channels[new.id] = None
            raise ValueError(f"two topics have number {new.id}")


@dataclass(slots=True)
class Salvage:
    """Copies the records of one file after the other into a new bag."""

    writer: BagWriter
    messages: Counter[str] = field(default_factory=Counter)
    attachments: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    places: int = 0
    bytes_read: int = 0
    bytes_total: int = 0
    _types: dict[str, TypeDefinition] = field(default_factory=dict)
    _latched: dict[str, deque[tuple[int, int, int, int]]] = field(default_factory=dict)

    def file(self, path: Path) -> None:
        """Copies one file.

        Raises:
            InputError: the file is no MCAP at all.
        """
        with open_bounded(path) as stream:
            head = stream.read(len(MCAP0_MAGIC))
            if self.bytes_total and len(head) < len(MCAP0_MAGIC) and MCAP0_MAGIC.startswith(head):
                # A recorder that was killed when it went on in a new file.
                self.note(f"{path.name}: has no content")
                return
            if head != MCAP0_MAGIC:
                raise InputError("is no MCAP file", file=path)
            self.bytes_total += stream.size
            self.bytes_read += _FileSalvage(self, stream, path).run()

    def note(self, text: str) -> None:
        """Remembers a damaged place."""
        self.places += 1
        if self.places <= MAX_DAMAGE:
            self.damage.append(text)

    def message(self, message: Message, names: Names) -> None:
        """Writes one message.

        Raises:
            ValueError: its topic or type is not known or differs from what came before.
        """
        channel = names.channels.get(message.channel_id)
        schema = names.schemas.get(channel.schema_id) if channel is not None else None
        if channel is None or schema is None:
            raise ValueError(f"topic or type of channel {message.channel_id} is not known")
        if channel.message_encoding != "cdr":
            raise ValueError(f"{channel.topic} is encoded as {channel.message_encoding!r}, not cdr")
        if max(message.log_time, message.publish_time) > _MAX_TIME_NS:
            raise ValueError(f"{channel.topic} has a message later than the year 2262")
        self._announce(channel, schema)
        if (kept := self._latched.get(channel.topic)) is not None:
            data = message.data
            key = (message.publish_time, message.sequence, len(data), crc32(data))
            if REPEATED_KEY in channel.metadata and key in kept:
                return
            kept.append(key)
        self.writer.write(
            channel.topic, message.data, message.log_time, message.publish_time, message.sequence
        )
        self.messages[channel.topic] += 1

    def _announce(self, channel: Channel, schema: Schema) -> None:
        known = self._types.get(channel.topic)
        if known is not None and (known.msgtype, known.encoding) == (schema.name, schema.encoding):
            if known.text.encode() == schema.data:
                return
            raise ValueError(f"{channel.topic} has messages of two definitions of {schema.name}")
        if known is not None:
            raise ValueError(f"{channel.topic} has messages of two types")
        offered = usable_qos(channel.metadata.get("offered_qos_profiles", ""))
        written = type_definition(schema, channel)
        latched = is_latched(offered) or REPEATED_KEY in channel.metadata
        self.writer.add_topic(channel.topic, schema.name, offered, written=written, latched=latched)
        self._types[channel.topic] = written
        if latched:
            self._latched[channel.topic] = deque(maxlen=MOST_KEPT)


class _FileSalvage:
    """One file on its way into the new bag."""

    def __init__(self, salvage: Salvage, stream: BoundedFile, path: Path) -> None:
        self._into = salvage
        self._stream = stream
        self._name = path.name
        # With the CRC over all data right, nothing needs to be doubted. Some writers give none.
        crc_right = data_crc(stream)
        self._whole = crc_right is True
        self._wrong = crc_right is False
        self._names = Names(Summary())
        self._known: list[int] = []
        self._end = len(MCAP0_MAGIC)
        self._budget = UnpackBudget(stream.size)
        self._copies: set[tuple[int, ...]] = set()
        self._kinds: set[int] = set()
        try:
            stream.seek(0)
            summary = read_summary(stream, path)
        except InputError:
            return
        self._names = Names(summary)
        self._known = [index.chunk_start_offset for index in summary.chunk_indexes]
        self._known += [index.offset for index in summary.attachment_indexes]

    def run(self) -> int:
        """Copies the file; gives the offset behind the last record that could be used."""
        before = self._into.places
        walk = RecordScanner(
            self._stream, self._known, lambda number: number in self._names.channels
        )
        for found in walk:
            if isinstance(found, DamagedSpan):
                self._gap(found)
            elif found.opcode == Opcode.DATA_END and self._is_end(found):
                if self._wrong and self._into.places == before:
                    self._into.note(f"{self._name}: the CRC over all data is wrong")
                return self._stream.size
            else:
                try:
                    self._frame(found)
                    self._end = found.end
                except ValueError as error:
                    place = f"{self._name}: record at byte {found.offset}"
                    self._into.note(f"{place} left out: {error}")
                    walk.doubt(found)
        self._into.note(f"{self._name}: stopped at byte {self._end}: the file was not closed")
        return self._end

    def _gap(self, gap: DamagedSpan) -> None:
        if gap.next_offset is not None:
            then = f"went on at byte {gap.next_offset}"
        else:
            then = "found no record behind it"
        self._into.note(f"{self._name}: damaged at byte {gap.offset}: {gap.why}; {then}")

    def _is_end(self, frame: RecordFrame) -> bool:
        """Whether a summary or the footer follows, as it must."""
        try:
            return frame.length == 4 and read_frame(self._stream, frame.end).opcode != 0
        except ValueError:
            return False

    def _frame(self, frame: RecordFrame) -> None:
        """Raises ValueError when the record is damaged; what stands before that is copied."""
        if frame.opcode == Opcode.CHUNK:
            self._chunk(frame)
        elif frame.opcode == Opcode.ATTACHMENT:
            attachment = parse_attachment(read_body(self._stream, frame))
            self._once(crc32(attachment.name.encode()), crc32(attachment.data))
            self._into.writer.attach(attachment.name, attachment.data, attachment.media_type)
            self._into.attachments.append(attachment.name)
        elif frame.opcode in NAMED:
            self._names.add(parse_named(frame.opcode, read_body(self._stream, frame)))
        elif frame.opcode == Opcode.MESSAGE:
            # No CRC says that it is one. In a damaged file with chunks it is a damaged record.
            if not self._whole and (Opcode.CHUNK in self._kinds or self._known):
                raise ValueError("a message outside the chunks, which nothing vouches for")
            self._into.message(parse_message(read_body(self._stream, frame)), self._names)
        elif frame.opcode == Opcode.DATA_END:
            raise ValueError("the end of the data in the midst of it")
        self._kinds.add(frame.opcode)

    def _chunk(self, frame: RecordFrame) -> None:
        parts = chunk_parts(read_body(self._stream, frame))
        self._budget.take(parts.unpacked_bytes)
        data = unpack_chunk(parts)
        self._kinds.add(frame.opcode)
        self._once(parts.start_ns, parts.end_ns, parts.unpacked_bytes, crc32(data))
        left_out: Counter[str] = Counter()
        for record in inner_records(data):
            try:
                if record.opcode == Opcode.MESSAGE:
                    self._into.message(parse_message(record.body), self._names)
                elif record.opcode in NAMED:
                    self._names.add(parse_named(record.opcode, record.body))
            except ValueError as error:
                left_out[str(error)] += 1
        if left_out:
            raise ValueError(_reasons(left_out.most_common(3)))

    def _once(self, *key: int) -> None:
        """Raises ValueError for what a damaged file holds a second time."""
        if self._whole:
            return
        if key in self._copies:
            raise ValueError("a copy of an earlier record")
        self._copies.add(key)


def _reasons(reasons: Iterable[tuple[str, int]]) -> str:
    return ", ".join(f"{count} records: {why}" for why, count in reasons)


_MAX_NAME_BYTES = 240  # a file system takes 255, and the file inside is named <target>_0.mcap


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What recover kept of one or several files.

    Args:
        messages: kept, by topic.
        attachments: names of those kept.
        complete: every file was read up to its regular end, and nothing was damaged.
        bytes_read: up to where the files could be read.
        bytes_total: size of the files.
        damage: per place that could not be used, what was wrong there; of very many the first
            ones, and how many more there were.
    """

    complete: bool
    messages: dict[str, int]
    attachments: tuple[str, ...]
    bytes_read: int
    bytes_total: int
    damage: tuple[str, ...]

    @property
    def count(self) -> int:
        return sum(self.messages.values())


def recover(source: str | Path, target: str | Path) -> RecoverReport:
    """Copies every message that can be read into a new bag; the source stays as it is.

    A chunk counts only when its CRC is right, so nothing damaged gets into the new bag. Behind a
    damaged place the copy goes on at the next whole chunk. Latched messages that the files of a
    split bag repeat are written once. The target is whole or not there.

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
        BagWriter(folder, name=f"{target.name}_0") as writer,
    ):
        salvage = Salvage(writer)
        for file in files:
            salvage.file(file)
    more = salvage.places - MAX_DAMAGE
    return RecoverReport(
        messages=dict(salvage.messages),
        attachments=tuple(salvage.attachments),
        complete=not salvage.places,
        bytes_read=salvage.bytes_read,
        bytes_total=salvage.bytes_total,
        damage=(*salvage.damage, *([f"and {more} more places"] if more > 0 else [])),
    )
