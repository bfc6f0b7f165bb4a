"""``ssp bag info``: what is in a bag, by summaries and indexes alone, and its recorder's report."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
import numpy as np
from mcap.records import AttachmentIndex
from numpy.typing import NDArray

from ssp_core.bag.metadata import FILE_NAME, parse_offered_qos, unlisted_files
from ssp_core.bag.pictures.stamps import LOG_LEAP_S, leap_text, leaps_of
from ssp_core.bag.reading.index import indexed_entries
from ssp_core.bag.reading.mcap_file import McapFile, damage_of
from ssp_core.bag.reading.reader import BagReader, Part, bag_files, mcap_files
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.bag.writing.split import REPEATED_KEY
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.console import out
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping
from ssp_monitor.recorder.report import SCHEMA


@dataclass(frozen=True, slots=True)
class FileSummary:
    """One file of a bag.

    Args:
        messages: those included that repeat an earlier file's latched ones.
        start_ns: earliest log time, None without messages.
        compression: of its chunks, by name; ``none`` is one.
        problem: why it can't be read, empty when it can; else only name and size are known.
    """

    name: str
    bytes: int
    messages: int = 0
    repeated: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    chunks: int = 0
    compression: tuple[str, ...] = ()
    problem: str = ""


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
    """The content of a bag.

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
    """Return the files to look at, and notes about that choice.

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
        return bag_files(path), [
            f"{name} isn't named by {FILE_NAME} and is left out" for name in unlisted_files(path)
        ]
    if not plain:
        raise InputError(
            f"has neither {FILE_NAME} nor an .mcap file",
            file=path,
            remedy="name the folder of a bag, or its .mcap file",
        )
    return mcap_files(path), [
        f"there is no {FILE_NAME}, so the recording was not closed; what follows is what its "
        "files say (`ssp bag recover` makes a closed bag of it)"
    ]


def summarise_bag(path: Path) -> BagSummary:
    """Summarise a bag directory or one .mcap file.

    Raises:
        InputError: there is no bag, or none of its files can be read.
    """
    paths, notes = _files(path)
    topics: dict[str, TopicSummary] = {}
    attachments: list[AttachmentIndex] = []
    files, parts = [], []
    for number, file in enumerate(paths):
        try:
            part = McapFile(file)
        except InputError as error:
            if len(paths) == 1:
                raise
            problem = error.problem + (f"; {error.remedy}" if error.remedy else "")
            files.append(FileSummary(file.name, file.stat().st_size, problem=problem))
            continue
        parts.append(part)
        files.append(_file(part, first=number == 0))
        _add_topics(part, topics, first=number == 0)
        attachments += part.summary.attachment_indexes
    if all(file.problem for file in files):
        raise InputError(
            f"has no file that can be read: {files[0].problem}",
            file=path,
            remedy="`ssp bag recover` keeps what can be read",
        )
    for topic in topics.values():
        if len(topic.msgtypes) > 1:
            notes.append(f"{topic.name} has messages of several types: {', '.join(topic.msgtypes)}")
        if topic.qos is None:
            notes.append(f"{topic.name}: its offered_qos_profiles can't be read")
    summary = BagSummary(path, tuple(files), topics, tuple(attachments), tuple(notes))
    if (summary.end_ns or 0) - (summary.start_ns or 0) <= LOG_LEAP_S * NS_PER_S:
        return summary
    leaps = leaps_of(np.sort(np.concatenate([_log_times(part) for part in parts])))
    return replace(summary, notes=(*notes, *(leap_text(*leap) for leap in leaps)))


def _log_times(file: McapFile) -> NDArray[np.int64]:
    """Return all log times of a file, by its indexes."""
    part = Part(file.path, later=False)
    with damage_of(part.path):
        times_ns = [
            at_ns
            for chunk in part.chunks
            for at_ns, _ in indexed_entries(part.message_index(chunk), chunk, part.channels)
        ]
    return np.array([*times_ns, *part.loose_times_ns], dtype=np.int64)


def _repeats(metadata: dict[str, str], first: bool) -> bool:
    """Tell whether a channel holds again what an earlier file has."""
    return not first and REPEATED_KEY in metadata


def _file(part: McapFile, first: bool) -> FileSummary:
    summary, name, size = part.summary, part.path.name, part.path.stat().st_size
    statistics = summary.statistics
    if statistics is None:
        return FileSummary(name, size, problem="has no statistics")
    repeated = sum(
        statistics.channel_message_counts.get(channel.id, 0)
        for channel in summary.channels.values()
        if _repeats(channel.metadata, first)
    )
    some = statistics.message_count > 0
    return FileSummary(
        name=name,
        bytes=size,
        messages=statistics.message_count,
        repeated=repeated,
        start_ns=statistics.message_start_time if some else None,
        end_ns=statistics.message_end_time if some else None,
        chunks=len(summary.chunk_indexes),
        compression=tuple(sorted({c.compression or "none" for c in summary.chunk_indexes})),
    )


def _add_topics(part: McapFile, topics: dict[str, TopicSummary], first: bool) -> None:
    summary = part.summary
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    channel_topics: dict[int, str] = {}
    for channel in summary.channels.values():
        if _repeats(channel.metadata, first):
            continue
        channel_topics[channel.id] = channel.topic
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
        _add_times(part, channel_topics, topics)


def _add_times(
    part: McapFile, channel_topics: dict[int, str], topics: dict[str, TopicSummary]
) -> None:
    """Add the first and last log time of each topic, from the chunks' indexes where they stand."""
    chunks = sorted(part.summary.chunk_indexes, key=lambda chunk: chunk.message_start_time)
    for forwards in (True, False):
        missing = set(channel_topics)
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
                    _widen(topics[channel_topics[channel_id]], min(times_ns), max(times_ns))


def _widen(topic: TopicSummary, first_ns: int, last_ns: int) -> None:
    topic.first_ns = first_ns if topic.first_ns is None else min(topic.first_ns, first_ns)
    topic.last_ns = last_ns if topic.last_ns is None else max(topic.last_ns, last_ns)


def recording_report(bag: BagReader) -> dict[str, Any] | None:
    """Return the report in a bag, None when there is none or it is of another make.

    Raises:
        InputError: it is damaged.
    """
    data = bag.attachment(REPORT_NAME)
    if data is None:
        return None
    report = parse_mapping(data, f"{bag.path}:{REPORT_NAME}")
    return report if report.get("schema") == SCHEMA else None


def report_sentences(report: dict[str, Any]) -> list[str]:
    """Put the report into sentences: first whether anything is missing, then where.

    Raises:
        InputError: the report lacks what it must have.
    """
    try:
        lost, dropped = int(report["lost"]), int(report["dropped"])
        received, limit = int(report["received"]), int(report["lost_limit"])
        missing = int(report.get("missing", lost + dropped))  # an earlier recorder counted all
        topics = [(str(t["name"]), int(t["lost"]), int(t["dropped"])) for t in report["topics"]]
        warnings = [str(warning) for warning in report["warnings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"is no report of a recording: {type(error).__name__} {error}",
            file=REPORT_NAME,
            remedy="record the session again",
        ) from error
    if not lost and not dropped:
        return [f"complete: {received} messages received, none lost, none dropped", *warnings]
    within = "within" if missing <= limit else "past"
    lines = [
        f"{lost} lost and {dropped} dropped of {received} received, {within} the limit of {limit}"
    ]
    lines += [
        f"{name}: {_missing(lost, dropped)}" for name, lost, dropped in topics if lost or dropped
    ]
    return [*lines, *warnings]


def _missing(lost: int, dropped: int) -> str:
    parts = [f"{lost} never received"] if lost else []
    parts += [f"{dropped} received and not written"] if dropped else []
    return ", ".join(parts)


IMPORT_RECORD = "import.json"
# From here on a time is one of a calendar, before it one since a world began.
_CALENDAR_NS = 10**9 * NS_PER_S
# rmw's numbers, which rosbag2 wrote before Jazzy.
_RELIABILITY = {1: "reliable", 2: "best effort", "best_effort": "best effort"}
_DURABILITY = (1, "transient_local")
_KEEP_ALL = (2, "keep_all")


@click.command("info")
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def info_command(path: Path, json_: bool) -> None:
    """Show topics, types, rates, QoS, files and attachments of a bag directory or .mcap file.

    Messages are not read, so it takes no longer for a large bag.
    """
    summary = summarise_bag(path)
    report, accepted = _report(summary), _accepted(summary)
    if json_:
        told_of = {"recording": report, "accepted_at_import": accepted}
        click.echo(json.dumps({**survey_json(summary), **told_of}, indent=1))
        return
    for line in survey_lines(summary):
        out.print(line, markup=False)
    for one in accepted:
        out.print(f"accepted at import, {one['name']}: {one['text']}", markup=False)
    if report is not None:
        whole = report.get("written")
        cut = "" if whole == summary.count else f", of which this bag is a part ({whole} messages)"
        out.print(f"recording{cut}", markup=False)
        for line in report_sentences(report):
            out.print(f"  {line}", markup=False)


def _is_closed(summary: BagSummary) -> bool:
    """Tell whether the bag was finished and all of its files can be read."""
    if summary.path.is_dir() and not (summary.path / FILE_NAME).is_file():
        return False
    return not any(file.problem for file in summary.files)


def _accepted(summary: BagSummary) -> list[dict[str, str]]:
    """Return the findings that a person accepted when another's recording was imported."""
    if not _is_closed(summary) or all(a.name != IMPORT_RECORD for a in summary.attachments):
        return []
    with BagReader(summary.path) as bag:
        record = parse_mapping(
            bag.attachment(IMPORT_RECORD) or b"{}", f"{summary.path}:{IMPORT_RECORD}"
        )
    accepted = record.get("accepted")
    return [
        {key: str(one.get(key)) for key in ("name", "text")}
        for one in (accepted if isinstance(accepted, list) else [])
        if isinstance(one, dict)
    ]


def _report(summary: BagSummary) -> dict[str, Any] | None:
    """Return the recorder's report; a bag that isn't closed has none yet."""
    if not _is_closed(summary):
        return None
    with BagReader(summary.path) as bag:
        return recording_report(bag)


def survey_json(summary: BagSummary) -> dict[str, Any]:
    """Describe a bag for programs; times are log times in ns."""
    return {
        "path": str(summary.path),
        "files": [asdict(file) for file in summary.files],
        "bytes": summary.bytes,
        "messages": summary.count,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "topics": {
            name: {
                "type": ", ".join(t.msgtypes),
                "messages": t.count,
                "rate_hz": t.rate_hz,
                "first_ns": t.first_ns,
                "last_ns": t.last_ns,
                "message_encoding": t.encodings[0],
                "schema_encoding": t.encodings[1],
                "type_hash": t.type_hash,
                "offered_qos": t.qos,
            }
            for name, t in sorted(summary.topics.items())
        },
        "attachments": [
            {"name": a.name, "media_type": a.media_type, "bytes": a.data_size}
            for a in summary.attachments
        ],
        "notes": list(summary.notes),
    }


def survey_lines(summary: BagSummary) -> list[str]:
    """Describe a bag for people."""
    files = f"{len(summary.files)} files" if len(summary.files) != 1 else "1 file"
    lines = [
        f"{summary.path}: {summary.count} messages of "
        f"{topics_text([t.count for t in summary.topics.values()])}, {files}, "
        f"{size_text(summary.bytes)}, {span_text(summary.start_ns, summary.end_ns)}"
    ]
    lines += [f"note: {note}" for note in summary.notes]
    if len(summary.files) > 1 or summary.files[0].compression not in ((), ("none",)):
        lines += _table(
            [("file", "size", "messages", "from", "length", "chunks")], _file_rows(summary)
        )
    if summary.topics:
        heads = [("topic", "type", "messages", "Hz", "offered QoS")]
        lines += _table(heads, [_topic_row(t) for _, t in sorted(summary.topics.items())])
    if summary.attachments:
        rows = [(a.name, size_text(a.data_size), a.media_type) for a in summary.attachments]
        lines += _table([("attachment", "size", "kind")], rows)
    return lines


def _file_rows(summary: BagSummary) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    begin_ns = summary.start_ns or 0
    for file in summary.files:
        if file.problem:
            rows.append((file.name, size_text(file.bytes), "", "", "", file.problem))
            continue
        start_s = length_s = "-"
        if file.start_ns is not None and file.end_ns is not None:
            start_s = f"+{ns_to_seconds(file.start_ns - begin_ns):.3f} s"
            length_s = f"{ns_to_seconds(file.end_ns - file.start_ns):.3f} s"
        count = str(file.messages) + (f" ({file.repeated} repeated)" if file.repeated else "")
        chunks = f"{file.chunks} {', '.join(file.compression)}" if file.chunks else "none"
        rows.append((file.name, size_text(file.bytes), count, start_s, length_s, chunks))
    return rows


def _topic_row(topic: TopicSummary) -> tuple[str, ...]:
    rate = "-" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
    kind = ", ".join(topic.msgtypes)
    message, schema = topic.encodings
    if message != "cdr" or schema != "ros2msg":
        kind += f" ({'/'.join(part or 'no definition' for part in topic.encodings)})"
    return (topic.name, kind, str(topic.count), rate, qos_text(topic.qos))


def qos_text(profiles: Sequence[dict[str, Any]] | None) -> str:
    """Put quality of service into a few words: ``reliable, latched, 20``; for each publisher.

    Args:
        profiles: as they stand in the bag; None when they can't be read.
    """
    if profiles is None:
        return "unreadable"
    kinds = Counter(_profile_text(profile) for profile in profiles)
    return "; ".join(f"{count} x {text}" if count > 1 else text for text, count in kinds.items())


def _profile_text(profile: dict[str, Any]) -> str:
    reliability = profile.get("reliability", "?")
    parts = [str(_RELIABILITY.get(reliability, reliability))]
    if profile.get("durability") in _DURABILITY:
        parts.append("latched")
    depth = "all" if profile.get("history") in _KEEP_ALL else profile.get("depth", "?")
    return ", ".join([*parts, f"depth {depth}"])


def topics_text(counts: Collection[int]) -> str:
    """Describe how many topics there are, and how many of them hold messages."""
    filled = sum(1 for count in counts if count)
    of = f" of {len(counts)}" if filled < len(counts) else ""
    return f"{filled}{of} topics"


def size_text(size: int) -> str:
    """Return bytes in the unit that suits them."""
    value, units = float(size), ("B", "kB", "MB", "GB", "TB")
    for unit in units:
        if value < 1000.0 or unit == units[-1]:
            return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
        value /= 1000.0
    raise AssertionError("the last unit takes any size")


def span_text(start_ns: int | None, end_ns: int | None) -> str:
    """Return beginning and length of a bag; a simulated one counts from its world's beginning."""
    if start_ns is None or end_ns is None:
        return "no times"
    length = f"{ns_to_seconds(end_ns - start_ns):.3f} s"
    if start_ns < _CALENDAR_NS:
        return f"{length} from {ns_to_seconds(start_ns):.3f} s"
    begin = datetime.fromtimestamp(start_ns // NS_PER_S, UTC)
    return f"{length} from {begin:%Y-%m-%d %H:%M:%S}.{start_ns % NS_PER_S // 10**6:03d} UTC"


def _table(heads: Sequence[tuple[str, ...]], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Align columns, figures to the right; the last column runs free."""
    cells = [*heads, *rows]
    widths = [max(len(row[column]) for row in cells) for column in range(len(heads[0]))]
    figures = ("size", "messages", "Hz", "from", "length")
    lines = []
    for row in cells:
        parts = [
            f"{cell:>{width}}" if head in figures else f"{cell:{width}}"
            for cell, width, head in zip(row, widths, heads[0], strict=True)
        ]
        lines.append("  ".join(parts).rstrip())
    return lines
