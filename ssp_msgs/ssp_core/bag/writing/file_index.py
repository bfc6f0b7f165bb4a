"""The summary of one MCAP file that is being written: what the file holds, and where it stands.

This file owns the counts and indexes; they grow with each record, and are written once, behind the
data. Reads and writes no file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.summary import Summary

from ssp_core.bag.writing.chain import record_bytes


class FileIndex:
    """Schemas, channels, chunks, attachments and metadata of a file, with their places.

    Attributes:
        chunks: how many.
        counts: messages by channel.
        times: earliest and latest log time; None while there is no message.
        metadata_count: records of metadata, those that aren't found by the summary included.
    """

    def __init__(self) -> None:
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self.attachments: list[AttachmentIndex] = []
        self.chunks = 0
        self.counts: Counter[int] = Counter()
        self.times: tuple[int, int] | None = None
        self.metadata_count = 0
        # As it stands in the summary: as objects it would take ten times the memory.
        self._chunk_index = bytearray()
        self._metadata: list[MetadataIndex] = []

    @classmethod
    def of(cls, summary: Summary) -> FileIndex:
        """Return the index of a file that was closed."""
        index = cls()
        index.schemas = list(summary.schemas.values())
        index.channels = list(summary.channels.values())
        index.attachments = list(summary.attachment_indexes)
        index._chunk_index = bytearray(record_bytes(*summary.chunk_indexes))
        index._metadata = list(summary.metadata_indexes)
        statistics = summary.statistics
        if statistics is not None:
            index.chunks = statistics.chunk_count
            index.metadata_count = statistics.metadata_count
            index.counts = Counter(statistics.channel_message_counts)
            if statistics.message_count:
                index.times = statistics.message_start_time, statistics.message_end_time
        return index

    @property
    def chunk_bytes(self) -> int:
        """Bytes that the summary takes for the chunks so far."""
        return len(self._chunk_index)

    def add_chunk(
        self, chunk_index: ChunkIndex, counts: Mapping[int, int], times: tuple[int, int] | None
    ) -> None:
        """Add a chunk, whose seal is one record of metadata.

        Args:
            chunk_index: its place.
            counts: its messages by channel.
            times: its earliest and latest log time.
        """
        self.metadata_count += 1
        self.chunks += 1
        self._chunk_index += record_bytes(chunk_index)
        self.counts.update(counts)
        self.times = span(self.times, times)

    def add_metadata(self, name: str, offset: int, length: int) -> None:
        """Add a record of metadata that readers find by its name."""
        self._metadata.append(MetadataIndex(offset, length, name))
        self.metadata_count += 1

    def records(self, start: int) -> tuple[bytes, bytes]:
        """Return the groups of the summary from an offset on, and the records that find them."""
        summary, offsets = b"", b""
        for opcode, group in self._groups():
            if group:
                offsets += record_bytes(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        return summary, offsets

    def _groups(self) -> list[tuple[Opcode, bytes | bytearray]]:
        start_ns, end_ns = self.times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            # Channels without messages are named too, as rosbag2 does.
            channel_message_counts={c.id: self.counts[c.id] for c in self.channels},
            chunk_count=self.chunks,
            message_count=self.counts.total(),
            message_end_time=end_ns,
            message_start_time=start_ns,
            metadata_count=self.metadata_count,
            schema_count=len(self.schemas),
        )
        return [
            (Opcode.SCHEMA, record_bytes(*self.schemas)),
            (Opcode.CHANNEL, record_bytes(*self.channels)),
            (Opcode.STATISTICS, record_bytes(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_index),
            (Opcode.ATTACHMENT_INDEX, record_bytes(*self.attachments)),
            (Opcode.METADATA_INDEX, record_bytes(*self._metadata)),
        ]


def span(one: tuple[int, int] | None, other: tuple[int, int] | None) -> tuple[int, int] | None:
    """Return the earliest begin and the latest end of two spans; None: there is none."""
    if one is None or other is None:
        return one or other
    return min(one[0], other[0]), max(one[1], other[1])
