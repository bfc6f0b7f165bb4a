"""One file of a bag as a reader sees it: which channels count, and the runs of its messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from functools import cached_property
from pathlib import Path

from mcap.records import Channel, ChunkIndex

from ssp_core.bag.bounds import MAX_REREADS, UnpackBudget
from ssp_core.bag.mcap_file import McapFile, damage_of, open_bounded
from ssp_core.bag.runs import ChunkRun, ContentCache, LooseRun, Run, Selection
from ssp_core.bag.scan import Scan, scan
from ssp_core.bag.split import REPEATED_KEY


class Part(McapFile):
    """A closed MCAP file that is the first or a later one of a bag.

    Args:
        path: the file.
        later: files before it are read too, so its repeated messages are left out.

    Raises:
        InputError: it can't be opened, is no closed MCAP file or its summary is damaged.
    """

    def __init__(self, path: Path, *, later: bool) -> None:
        super().__init__(path)
        self.channels: dict[int, Channel] = {
            number: channel
            for number, channel in self.summary.channels.items()
            if not (later and REPEATED_KEY in channel.metadata)
        }
        with damage_of(path):
            used = {n for index in self.chunks for n in index.message_index_offsets}
            used.update(self._scan.channels)
            for number in sorted(used - self.summary.channels.keys()):
                raise ValueError(f"its summary lacks channel {number}")

    @cached_property
    def chunks(self) -> list[ChunkIndex]:
        """Where the chunks are, in the order of the file."""
        found = self.summary.chunk_indexes or self._scan.chunks
        return sorted(found, key=lambda index: index.chunk_start_offset)

    @cached_property
    def _scan(self) -> Scan:
        """What the index of chunks doesn't say; nothing where there is one."""
        statistics = self.summary.statistics
        if self.summary.chunk_indexes or (statistics and not statistics.message_count):
            return Scan()
        with open_bounded(self.path) as stream, damage_of(self.path):
            return scan(stream)

    @cached_property
    def counts(self) -> Counter[int]:
        """Messages by channel, counted where the file doesn't say."""
        statistics = self.summary.statistics
        if statistics and (statistics.channel_message_counts or not statistics.message_count):
            return Counter(statistics.channel_message_counts)
        counts = self._scan.counts()
        for run in self._chunk_runs(Selection(dict.fromkeys(self.channels, ""), None, None)):
            with damage_of(self.path):
                counts += run.counts()
            run.close()
        return counts

    def times(self) -> tuple[int, int] | None:
        """Earliest and latest log time, None for a file without messages."""
        statistics = self.summary.statistics
        if statistics:
            times = [statistics.message_start_time, statistics.message_end_time]
            return (times[0], times[1]) if statistics.message_count else None
        times = [
            time
            for index in self.chunks
            if index.message_start_time <= index.message_end_time
            for time in (index.message_start_time, index.message_end_time)
        ]
        times += self._scan.times_ns
        return (min(times), max(times)) if self.counts.total() else None

    def runs(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> list[Run]:
        """The places that may hold messages of some topics and times, in the order of the file."""
        channels = {
            number: channel.topic
            for number, channel in self.channels.items()
            if topics is None or channel.topic in topics
        }
        if not channels:
            return []
        wanted = Selection(channels, start_ns, stop_ns)
        runs: list[Run] = [*self._chunk_runs(wanted)]
        if self._scan.times_ns:
            runs.append(LooseRun(self.path, self._scan, wanted))
        return runs

    def _chunk_runs(self, wanted: Selection) -> list[ChunkRun]:
        unpacked = sum(index.uncompressed_size for index in self.chunks)
        cache = ContentCache(UnpackBudget(unpacked, ratio=MAX_REREADS))
        return [
            ChunkRun(self, index, wanted, cache)
            for index in self.chunks
            if wanted.overlaps(index.message_start_time, index.message_end_time)
            and not (
                index.message_index_offsets
                and wanted.topics.keys().isdisjoint(index.message_index_offsets)
            )
        ]
