"""What stands in a bag, from summaries and indexes alone, however large its messages are.

It works on any rosbag2 directory that is stored as MCAP and on single files, also when
metadata.yaml is missing or some file was not closed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import AttachmentIndex

from ssp_core.bag.index import indexed_entries
from ssp_core.bag.mcap_file import McapFile, damage_of
from ssp_core.bag.metadata import FILE_NAME, parse_offered_qos
from ssp_core.bag.reader import bag_files, mcap_files
from ssp_core.bag.split import REPEATED_KEY
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class FileSummary:
    """One file of a bag.

    Args:
        name: in the directory.
        bytes: on the disk.
        problem: why it can't be read, empty when it can; then nothing below is known.
        count: messages, those included that repeat an earlier file's latched ones.
        start_ns: earliest log time, None without messages.
        compressions: of its chunks, by name; ``none`` is one.
    """

    name: str
    bytes: int
    problem: str = ""
    count: int = 0
    repeated: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    chunks: int = 0
    compressions: tuple[str, ...] = ()


@dataclass(slots=True)
class TopicSummary:
    """One topic of a bag.

    Args:
        name: absolute, as the bag has it.
        msgtypes: full type names; more than one is a defect.
        encodings: of messages and of definitions, such as ``cdr`` and ``ros2msg``.
        type_hash: RIHS01, empty when the bag doesn't say.
        qos: the profiles that publishers offered; None: what stands there can't be read.
        first_ns: earliest log time, None when no index tells it.
    """

    name: str
    msgtypes: tuple[str, ...] = ()
    encodings: tuple[str, str] = ("", "")
    type_hash: str = ""
    qos: list[dict[str, Any]] | None = field(default_factory=list)
    count: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    @property
    def rate_hz(self) -> float | None:
        """Mean rate between the first message and the last, None where there is none."""
        if self.count < 2 or self.first_ns is None or self.last_ns is None:
            return None
        span_ns = self.last_ns - self.first_ns
        return (self.count - 1) * NS_PER_S / span_ns if span_ns > 0 else None


@dataclass(frozen=True, slots=True)
class BagSummary:
    """What stands in a bag.

    Args:
        topics: by name.
        notes: what a person should know about it, as sentences.
    """

    path: Path
    files: tuple[FileSummary, ...]
    topics: dict[str, TopicSummary]
    attachments: tuple[AttachmentIndex, ...]
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        return sum(topic.count for topic in self.topics.values())

    @property
    def bytes(self) -> int:
        return sum(file.bytes for file in self.files)

    @property
    def start_ns(self) -> int | None:
        return min((f.start_ns for f in self.files if f.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        return max((f.end_ns for f in self.files if f.end_ns is not None), default=None)


def _files(path: Path) -> tuple[tuple[Path, ...], list[str]]:
    """The files to look at, and what is to be said about that.

    Raises:
        InputError: there are none that can be read.
    """
    if not path.is_dir():
        return bag_files(path), []
    plain = any(path.glob("*.mcap"))
    packed = sorted(p.name for p in path.glob("*.mcap.*") if p.suffix in (".zstd", ".zst"))
    if packed and not plain:
        raise InputError(
            "has files that are compressed as a whole, which are not read here",
            file=path,
            value=packed[0],
            remedy=f"unpack them (`zstd -d {packed[0]} -o {packed[0].rpartition('.')[0]}`) and "
            "name the .mcap file, or use `ros2 bag convert`",
        )
    if (path / FILE_NAME).is_file():
        return bag_files(path), []
    if not plain:
        raise InputError(f"has neither {FILE_NAME} nor an .mcap file", file=path)
    return mcap_files(path), [
        f"there is no {FILE_NAME}, so the recording was not closed; what follows is what its "
        "files say (`ssp bag recover` makes a closed bag of it)"
    ]


def summarise_bag(path: Path) -> BagSummary:
    """Looks at a bag directory or one .mcap file.

    Raises:
        InputError: there is no bag, or none of its files can be read.
    """
    paths, notes = _files(path)
    topics: dict[str, TopicSummary] = {}
    attachments: list[AttachmentIndex] = []
    files = []
    for number, file in enumerate(paths):
        try:
            part = McapFile(file)
        except InputError as error:
            if len(paths) == 1:
                raise
            problem = error.problem + (f"; {error.remedy}" if error.remedy else "")
            files.append(FileSummary(file.name, file.stat().st_size, problem))
            continue
        files.append(_file(part, first=number == 0))
        _add_topics(part, topics, first=number == 0)
        attachments += part.summary.attachment_indexes
    if all(file.problem for file in files):
        raise InputError(f"has no file that can be read: {files[0].problem}", file=path)
    for topic in topics.values():
        if len(topic.msgtypes) > 1:
            notes.append(f"{topic.name} has messages of several types: {', '.join(topic.msgtypes)}")
        if topic.qos is None:
            notes.append(f"{topic.name}: its offered_qos_profiles can't be read")
    return BagSummary(path, tuple(files), topics, tuple(attachments), tuple(notes))


def _repeats(metadata: dict[str, str], first: bool) -> bool:
    """Whether a channel holds again what an earlier file has."""
    return not first and REPEATED_KEY in metadata


def _file(part: McapFile, first: bool) -> FileSummary:
    summary = part.summary
    statistics = summary.statistics
    if statistics is None:
        return FileSummary(part.path.name, part.path.stat().st_size, "has no statistics")
    repeated = sum(
        statistics.channel_message_counts.get(channel.id, 0)
        for channel in summary.channels.values()
        if _repeats(channel.metadata, first)
    )
    some = statistics.message_count > 0
    compressions = sorted({chunk.compression or "none" for chunk in summary.chunk_indexes})
    return FileSummary(
        name=part.path.name,
        bytes=part.path.stat().st_size,
        count=statistics.message_count,
        repeated=repeated,
        start_ns=statistics.message_start_time if some else None,
        end_ns=statistics.message_end_time if some else None,
        chunks=len(summary.chunk_indexes),
        compressions=tuple(compressions),
    )


def _add_topics(part: McapFile, topics: dict[str, TopicSummary], first: bool) -> None:
    summary = part.summary
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    wanted: dict[int, str] = {}
    for channel in summary.channels.values():
        if _repeats(channel.metadata, first):
            continue
        wanted[channel.id] = channel.topic
        topic = topics.setdefault(channel.topic, TopicSummary(channel.topic))
        schema = summary.schemas.get(channel.schema_id)
        name = schema.name if schema is not None else "(no type)"
        if name not in topic.msgtypes:
            topic.msgtypes += (name,)
        topic.encodings = (channel.message_encoding, schema.encoding if schema else "")
        topic.type_hash = topic.type_hash or channel.metadata.get("topic_type_hash", "")
        topic.count += counts.get(channel.id, 0)
        try:
            topic.qos = parse_offered_qos(channel.metadata.get("offered_qos_profiles", ""))
        except ValueError:
            topic.qos = None
    with damage_of(part.path):
        _add_times(part, wanted, topics)


def _add_times(part: McapFile, wanted: dict[int, str], topics: dict[str, TopicSummary]) -> None:
    """First and last log time of each topic, from the indexes of the chunks where they stand."""
    chunks = sorted(part.summary.chunk_indexes, key=lambda chunk: chunk.message_start_time)
    for forwards in (True, False):
        missing = set(wanted)
        for chunk in chunks if forwards else reversed(chunks):
            here = missing & chunk.message_index_offsets.keys()
            if not here:
                if not missing:
                    break
                continue
            region = part.message_index(chunk)
            for channel_id in here:
                if times_ns := [at_ns for at_ns, _ in indexed_entries(region, chunk, {channel_id})]:
                    missing.discard(channel_id)
                    _widen(topics[wanted[channel_id]], min(times_ns), max(times_ns))


def _widen(topic: TopicSummary, first_ns: int, last_ns: int) -> None:
    topic.first_ns = first_ns if topic.first_ns is None else min(topic.first_ns, first_ns)
    topic.last_ns = last_ns if topic.last_ns is None else max(topic.last_ns, last_ns)
