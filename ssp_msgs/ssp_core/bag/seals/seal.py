"""Verification of a bag's seal: its digest chain, computed anew from its bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.reading.mcap_file import (
    DAMAGE,
    FOOTER,
    HEAD,
    REPAIR,
    BoundedFile,
    McapFile,
    RecordFrame,
    UnpackBudget,
    chunk_parts,
    damage_of,
    data_crc,
    inner_records,
    open_bounded,
    read_body,
    read_frame,
    unpack_chunk,
)
from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.writing.chain import (
    DAMAGED,
    LARGE_BYTES,
    SEAL_NAME,
    SOURCE_NAME,
    UNCLOSED,
    Chain,
    Ending,
    Maker,
    Source,
    chunk_record,
    closing_record,
    opening_record,
)
from ssp_core.bag.writing.mcap_output import MESSAGE_BODY_BYTES
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping

# The recorder's report on what it recorded; `sealed` there says that the bag has a seal.
REPORT_NAME = "recording.json"
ALTERED = "is altered since it was sealed"
_MAX_METADATA_BYTES = 1 << 20
_MAKERS = {
    Maker.RECORDER: "the recorder",
    Maker.CUT: "`ssp bag cut`",
    Maker.RECOVER: "`ssp bag recover`",
    Maker.IMPORT: "the import",
    Maker.TWIN: "`ssp twins`",
    Maker.DRAW: "`ssp draw`",
    Maker.WRITER: "its writer",
}


@dataclass(frozen=True, slots=True)
class Seal:
    """Result of holding a bag's seal against its content.

    Args:
        maker: what wrote the bag; None: it has no seal.
        chunks: that fit their seal, before the first thing that doesn't.
        ends: digests of the closing records, the last one over the whole bag.
        open_at: where a bag that wasn't closed ends; empty: it was closed.
        altered: the first thing that doesn't fit the seal though its checksums are right; empty:
            there is none.
        damaged: the first thing that can't be read, or has a wrong checksum; empty: none.
        sources: the bags of which it was made, its own parent first.
    """

    maker: str | None = None
    chunks: int = 0
    ends: tuple[str, ...] = ()
    open_at: str = ""
    altered: str = ""
    damaged: str = ""
    sources: tuple[Source, ...] = ()

    @property
    def is_sound(self) -> bool:
        """Nothing in the bag contradicts its seal; that holds of a bag without one too."""
        return not (self.altered or self.damaged)

    @property
    def end(self) -> str:
        """Digest over the whole bag; empty where it has none."""
        return self.ends[-1] if self.ends and not self.open_at else ""

    @property
    def text(self) -> str:
        """The state in a few words, for people; the same for the same bytes."""
        if self.altered:
            return f"altered: {self.altered}"
        if self.damaged:
            return f"{DAMAGED}: {self.damaged}; sealed up to there, {self.chunks} chunks"
        if self.maker is None:
            return "not sealed"
        by = _MAKERS.get(Maker(self.maker), self.maker) if self.maker in set(Maker) else "unknown"
        if self.open_at:
            return f"sealed by {by} up to {self.open_at}, {UNCLOSED}"
        return f"sealed by {by}, {self.chunks} chunks, end {self.end[:16]}"

    @property
    def lineage(self) -> tuple[str, ...]:
        """Describe its sources, for people."""
        return tuple(f"made of {one.name}, {one.state}" for one in self.sources)

    @property
    def altered_source(self) -> Source | None:
        """The source that didn't fit its own seal; None: there is none."""
        return next((one for one in self.sources if one.altered), None)


def read_seal(bag: BagReader) -> Seal:
    """Compute the chain of an open bag; it reads every byte of it.

    Raises:
        InputError: a file can't be read any more.
    """
    return files_seal(bag.files, whole=bag.path.is_dir())


def check_unaltered(seal: Seal, path: Path) -> None:
    """Refuse a bag that isn't what was sealed, or that was made of such a one.

    Raises:
        InputError: it, or a source of it, is altered or damaged.
    """
    if seal.altered:
        raise InputError(
            f"{ALTERED}: {seal.altered}", file=path, remedy="take the bag as it was recorded"
        )
    if seal.damaged:
        raise InputError(f"is damaged: {seal.damaged}", file=path, remedy=REPAIR)
    if (source := seal.altered_source) is not None:
        raise InputError(
            f"was made of {source.name}, which {ALTERED}: {source.state}",
            file=path,
            remedy="make it anew of the bag as it was recorded",
        )


def source_of(bag: BagReader) -> tuple[Source, ...]:
    """Return an open bag as the source of another one, and its own sources behind it.

    Raises:
        InputError: a file can't be read any more, or the bag isn't what was sealed.
    """
    seal = read_seal(bag)
    check_unaltered(seal, bag.path)
    return sources_with(bag.path.resolve().name, content_sha256(bag), seal)


def sources_with(name: str, digest: str, seal: Seal) -> tuple[Source, ...]:
    """Return a bag as the source of another one, and its own sources behind it."""
    own = Source(name, digest, seal.text, seal.ends, bool(seal.altered))
    return (own, *seal.sources)


def files_seal(files: Sequence[Path], *, whole: bool) -> Seal:
    """Compute the chain over the files of a bag.

    Args:
        files: in their order; none of SQLite.
        whole: these are all files of the bag.

    Raises:
        InputError: a file can't be read.
    """
    walk = _Walk(whole)
    for number, file in enumerate(files):
        if not walk.file(file, number, last=number + 1 == len(files)):
            break
    if walk.maker is None and not (walk.altered or walk.damaged):
        walk.altered = _missing_seal(files)
    return walk.seal()


def _missing_seal(files: Sequence[Path]) -> str:
    """Say that a bag without a seal had one, by its recorder's report; empty where none says so."""
    for file in files:
        try:
            data = McapFile(file).attachment(REPORT_NAME)
            report = {} if data is None else parse_mapping(data, f"{file}:{REPORT_NAME}")
        except InputError:
            continue  # Not closed, or damaged: whoever reads it says so.
        if report.get("sealed") is True:
            return f"its seal is missing, and {REPORT_NAME} says that the recorder sealed it"
    return ""


@dataclass
class _Walk:
    """Walk through the files of a bag."""

    whole: bool
    maker: str | None = None
    chunks: int = 0
    ends: list[str] = field(default_factory=list)
    open_at: str = ""
    altered: str = ""
    damaged: str = ""
    sources: list[Source] = field(default_factory=list)
    chain: Chain = field(default_factory=Chain)

    def seal(self) -> Seal:
        """Return the findings so far."""
        return Seal(
            self.maker,
            self.chunks,
            tuple(self.ends),
            self.open_at,
            self.altered,
            self.damaged,
            tuple(self.sources),
        )

    def file(self, path: Path, number: int, *, last: bool) -> bool:
        """Go through one file; whether the next one is to be looked at."""
        with open_bounded(path) as stream, damage_of(path):
            walk = _FileWalk(self, stream, path.name)
            opening = walk.opening()
            if opening is None:
                if self.maker is not None and not walk.is_closed():
                    self.open_at = f"the end of the file before {path.name}"
                elif self.maker is not None or walk.is_closed_with_seal():
                    walk.is_wrong(f"{path.name} has no opening seal")
                return False
            maker, place, begins = opening
            if number == 0:
                self.maker = maker
                self.chain = Chain(bytes.fromhex(begins))
            if (self.whole and place != number) or self.chain.end.hex() != begins:
                before = "another file" if number else "a file that is missing"
                walk.is_wrong(f"{path.name} goes on from {before}")
                return False
            ending = walk.to_the_end()
        if self.altered or self.damaged or self.open_at:
            return False
        if ending is Ending.BAG and not last:
            self.altered = f"{path.name} ends the bag, and another file follows"
        elif ending is Ending.FILE and last and self.whole:
            self.altered = f"the file behind {path.name} is missing"
        return not self.altered


class _FileWalk:
    def __init__(self, into: _Walk, stream: BoundedFile, name: str) -> None:
        self._into, self._stream, self._name = into, stream, name
        self._budget = UnpackBudget(stream.size)
        self._at = len(MCAP0_MAGIC)
        self._number = 0
        self._before: tuple[int, str] | None = None

    def is_closed(self) -> bool:
        """Tell whether the file has its regular last bytes."""
        last_at = max(0, self._stream.size - len(MCAP0_MAGIC))
        return last_at > 0 and self._read(last_at, len(MCAP0_MAGIC)) == MCAP0_MAGIC

    def is_closed_with_seal(self) -> bool:
        """Tell whether the file's summary names a seal."""
        try:
            summary = McapFile(Path(self._stream.name)).summary
        except InputError:
            return False
        return any(index.name == SEAL_NAME for index in summary.metadata_indexes)

    def opening(self) -> tuple[str, int, str] | None:
        """Return a file's maker, its number in the bag and its first digest; None without a seal.

        The chain takes nothing here, since it must begin with that digest.
        """
        try:
            if self._read(0, len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                return None
            second = read_frame(self._stream, read_frame(self._stream, self._at).end)
            values = self._values(second)
            if values is None or values.get("made_by") is None:
                return None
            maker, number = values["made_by"], int(values["file"])
            begins = values["begins"]
            if len(bytes.fromhex(begins)) != len(self._into.chain.end):
                return None
            if opening_record(maker, number, begins) != self._whole(second):
                return None
            self._opening_at = second.offset
        except (ValueError, KeyError):
            return None
        return maker, number, begins

    def to_the_end(self) -> Ending | None:
        """Take the file's records into the chain and compare its seals; gives what it ended."""
        into, chain = self._into, self._into.chain
        chain.take_whole(MCAP0_MAGIC)
        ending: Ending | None = None
        while True:
            try:
                frame = read_frame(self._stream, self._at)
                values = self._values(frame) if frame.offset != self._opening_at else None
            except ValueError as error:
                self._stop_at(str(error))
                return None
            if frame.opcode == Opcode.DATA_END:
                break
            if self._before is not None and frame.opcode != Opcode.CHUNK:
                self.is_wrong(f"a seal of {self._name} stands before no chunk")
                return None
            if values is not None:
                ending = None
                if "chunk" in values:
                    if not self._chunk_seal(values, frame):
                        return None
                elif (ending := self._closing(values, frame)) is None:
                    return None
            else:
                ending = None
                if frame.opcode == Opcode.CHUNK:
                    if not self._chunk(frame):
                        return None
                else:
                    self._take(frame)
                    if (source := self._source(frame)) is not None:
                        into.sources.append(source)
            self._at = frame.end
        if ending is None:
            self.is_wrong(f"{self._name} has no closing seal")
            return None
        if not self.is_closed():
            self._stop_at("its summary is cut off")
            return None
        if self._summary_digest(frame) != self._summary:
            self.is_wrong(f"the summary of {self._name}")
            return None
        return ending

    def is_wrong(self, what: str) -> None:
        """Note what doesn't fit the seal: damage where a checksum over it is wrong as well."""
        if data_crc(self._stream) is False or self._summary_crc() is False:
            self._into.damaged = f"{what}; the file's own checksum is wrong too"
        else:
            self._into.altered = what

    def _summary_crc(self) -> bool | None:
        """Tell whether the checksum over the summary is right; None without one."""
        tail_at = self._stream.size - FOOTER.size - len(MCAP0_MAGIC)
        footer = self._read(max(0, tail_at), FOOTER.size)
        if len(footer) < FOOTER.size:
            return None
        _, _, start, _, stated = FOOTER.unpack(footer)
        if not stated or not 0 < start <= tail_at:
            return None
        block = self._read(start, tail_at + FOOTER.size - 4 - start)
        return bool(crc32(block) == stated)

    def _stop_at(self, why: str) -> None:
        """Note that the data end too soon: a recorder was killed, or the file is damaged."""
        if self.is_closed():
            self._into.damaged = f"{self._name} at byte {self._at}: {why}"
        else:
            self._into.open_at = f"chunk {self._number} of {self._name}"

    def _chunk_seal(self, values: dict[str, str], frame: RecordFrame) -> bool:
        try:
            number, digest = int(values["chunk"]), values["digest"]
            sound = chunk_record(number, digest) == self._whole(frame)
        except (ValueError, KeyError):
            sound = False
        if not sound:
            self.is_wrong(f"the seal of chunk {self._number + 1} of {self._name}")
            return False
        self._before = number, digest
        return True

    def _chunk(self, frame: RecordFrame) -> bool:
        body = read_body(self._stream, frame)
        if len(body) < frame.length:
            raise ValueError("it became shorter meanwhile")
        head = self._read(frame.offset, HEAD.size)
        chunk_seal, self._before = self._before, None
        place = f"chunk {self._number + 1} of {self._name}"
        if chunk_seal is None:
            self.is_wrong(f"{place} has no seal")
            return False
        try:
            self._take_chunk(head, body)
        except ValueError as error:
            self._into.damaged = f"{place}: {error}"
            return False
        number, digest = chunk_seal
        if number != self._number + 1:
            missing = f"; {place} is missing" if number > self._number + 1 else ""
            self.is_wrong(f"chunk {number} of {self._name} stands where {place} was{missing}")
            return False
        if self._into.chain.close() != digest:
            try:
                unpack_chunk(chunk_parts(body))
            except ValueError as error:
                self._into.damaged = f"{place}: {error}"
            else:
                self.is_wrong(place)
            return False
        self._number += 1
        self._into.chunks += 1
        return True

    def _take_chunk(self, head: bytes, body: memoryview) -> None:
        chain = self._into.chain
        if len(body) <= LARGE_BYTES:
            chain.take([head, body])
            return
        parts = chunk_parts(body)
        if parts.compression:
            chain.take_whole(head)
            chain.take_whole(body)
            return
        self._budget.take(parts.unpacked_bytes)
        content = unpack_chunk(parts)  # The checksum vouches for what the chain leaves out.
        chain.take([head, body[: len(body) - len(content)]])
        begin = 0
        for record in inner_records(content):
            if len(record.body) - MESSAGE_BODY_BYTES > LARGE_BYTES:
                data_at = record.offset + HEAD.size + MESSAGE_BODY_BYTES
                chain.take_whole(content[begin:data_at])
                begin = record.offset + HEAD.size + len(record.body)
        chain.take_whole(content[begin:])

    def _closing(self, values: dict[str, str], frame: RecordFrame) -> Ending | None:
        try:
            ending, summary, digest = Ending(values["ends"]), values["summary"], values["digest"]
            self._summary = summary
            sound = closing_record(ending, summary, digest) == self._whole(frame)
            self._into.chain.take([bytes.fromhex(summary)])
        except (ValueError, KeyError):
            sound = False
        if not sound or self._into.chain.close() != digest:
            where = f"behind chunk {self._number} of {self._name}"
            self.is_wrong(f"{where}, between it and the closing seal")
            return None
        self._into.ends.append(digest)
        return ending

    def _summary_digest(self, data_end: RecordFrame) -> str:
        size = self._stream.size - FOOTER.size - len(MCAP0_MAGIC) - data_end.end
        tail = self._read(data_end.end, max(0, size))
        self._stream.seek(data_end.end + max(0, size))
        footer = self._stream.read(FOOTER.size)
        if size < 0 or len(footer) < FOOTER.size:
            return ""
        opcode, _, start, _, _ = FOOTER.unpack(footer)
        return sha256(tail).hexdigest() if (opcode, start) == (Opcode.FOOTER, data_end.end) else ""

    def _take(self, frame: RecordFrame) -> None:
        chain = self._into.chain
        chain.take_whole(self._read(frame.offset, HEAD.size))
        chain.take_whole(read_body(self._stream, frame))

    def _metadata(self, frame: RecordFrame) -> Metadata | None:
        if frame.opcode != Opcode.METADATA or frame.length > _MAX_METADATA_BYTES:
            return None
        try:
            body = bytes(read_body(self._stream, frame))
            record: Metadata = Metadata.read(ReadDataStream(io.BytesIO(body)))
        except DAMAGE:
            return None
        return record

    def _values(self, frame: RecordFrame) -> dict[str, str] | None:
        """Read the values of a seal; None for another record."""
        record = self._metadata(frame)
        return record.metadata if record is not None and record.name == SEAL_NAME else None

    def _source(self, frame: RecordFrame) -> Source | None:
        record = self._metadata(frame)
        if record is None or record.name != SOURCE_NAME:
            return None
        return Source.parse(record.metadata)

    def _read(self, offset: int, length: int) -> bytes:
        self._stream.seek(offset)
        return self._stream.read(length)

    def _whole(self, frame: RecordFrame) -> bytes:
        return self._read(frame.offset, frame.end - frame.offset)
