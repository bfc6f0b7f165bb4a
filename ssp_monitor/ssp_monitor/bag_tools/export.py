"""``ssp bag export``: a part of a bag as images, MP4 and tables, in a folder whole or not there."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path

import av
import click

from ssp_core.bag.frames import Frames, Picture, VideoFile, image_topics
from ssp_core.bag.images import decode_still, encode, even_sized, suffix_of
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.images import ImageMessage
from ssp_core.console import note, out, progress
from ssp_core.errors import HostError, InputError
from ssp_core.files import new_folder
from ssp_monitor.bag_tools.selection import chosen_span, chosen_topics, span_options
from ssp_monitor.bag_tools.tables import CsvFile, Layout, ParquetFile, TableFile, layout_of


class Losses:
    """Counts frames that are no pictures, and keeps what was wrong with the first."""

    def __init__(self) -> None:
        self.count = 0
        self.first = ""

    def __call__(self, log_time_ns: int, problem: str) -> None:
        self.count += 1
        self.first = self.first or f"at {log_time_ns} ns: {problem}"


def write_images(
    bag: BagReader,
    topic: str,
    folder: Path,
    suffix: str,
    span: tuple[int | None, int | None],
    losses: Losses,
    advance: Callable[[int], None],
) -> int:
    """Writes each frame as ``<number>_<stamp in ns>.<suffix>``, and ``index.csv`` beside them.

    What was recorded in the wanted format is copied byte for byte.

    Args:
        bag: open for reading.
        suffix: ``.jpg`` or ``.png``.
        span: first log time, and the first that no longer belongs.
        advance: called with the number of frames written.

    Returns:
        Frames written.
    """
    folder.mkdir()
    frames = Frames(bag, topic, losses)
    count = 0
    with (folder / "index.csv").open("w", encoding="utf-8", newline="") as stream:
        index = csv.writer(stream, lineterminator="\n")
        index.writerow(["file", "stamp_ns", "log_time_ns"])

        def keep(stamp_ns: int, log_time_ns: int, data: bytes) -> None:
            nonlocal count
            name = f"{count:06d}_{stamp_ns}{suffix}"
            (folder / name).write_bytes(data)
            index.writerow([name, stamp_ns, log_time_ns])
            count += 1
            advance(1)

        if frames.is_video:
            for picture in frames.pictures(*span):
                keep(picture.stamp_ns, picture.log_time_ns, encode(picture.image, suffix))
            return count
        for message, image in frames.messages(*span):
            try:
                data = _file_bytes(image, suffix)
            except ValueError as error:
                losses(message.log_time_ns, str(error))
                continue
            keep(image.stamp_ns, message.log_time_ns, data)
    return count


def _file_bytes(image: ImageMessage, suffix: str) -> bytes:
    if image.layout is None and suffix_of(image.data) == suffix:
        return bytes(image.data)
    return encode(decode_still(image), suffix)


def write_video(
    bag: BagReader,
    topic: str,
    stem: Path,
    span: tuple[int | None, int | None],
    losses: Losses,
    advance: Callable[[int], None],
) -> tuple[list[Path], int]:
    """Writes ``<stem>.mp4``, and ``<stem>.2.mp4`` and so on where the size of the frames changes.

    Args:
        bag: open for reading.
        stem: path without suffix.
        advance: called with the number of frames written.

    Returns:
        The files, and the number of frames in them.
    """
    files: list[Path] = []
    video: VideoFile | None = None
    count = 0
    try:
        for picture in Frames(bag, topic, losses).pictures(*span):
            try:
                image = even_sized(picture.image)
            except ValueError as error:
                losses(picture.log_time_ns, str(error))
                continue
            size_px = (image.shape[1], image.shape[0])
            if video is None or video.size_px != size_px:
                if video is not None:
                    video.close()
                number = f".{len(files) + 1}" if files else ""
                files.append(stem.with_name(f"{stem.name}{number}.mp4"))
                video = VideoFile(files[-1], *size_px)
            video.add(Picture(picture.stamp_ns, picture.log_time_ns, image))
            count += 1
            advance(1)
    finally:
        if video is not None:
            video.close()
    return files, count


_UNUSUAL = re.compile(r"[^A-Za-z0-9_-]")
_MOST_CHARACTERS = 100


class FileNames:
    """Gives each topic one name that no other has, also where large and small are the same."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def of(self, topic: str) -> str:
        """A name of letters, digits, ``_``, ``-`` and ``.``: ``ssp.vut.state`` for /ssp/vut/state.

        What can't be told from the name any more gets a part of the topic's hash.
        """
        parts = topic.strip("/").split("/")
        joined = ".".join(_UNUSUAL.sub("_", part) for part in parts)
        name = joined.strip(".-")  # no hidden file, and none that a program takes for an option
        plain = name == joined and all(part and not _UNUSUAL.search(part) for part in parts)
        if not plain or len(name) > _MOST_CHARACTERS or name.lower() in self._taken:
            digest = hashlib.sha256(topic.encode("utf-8", "surrogatepass")).hexdigest()[:12]
            name = f"{name[:_MOST_CHARACTERS] or 'topic'}-{digest}"
        self._taken.add(name.lower())
        return name


# Tables that are written in one pass through the bag: bounds open files and memory.
_OPEN_TABLES = 64


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What to export.

    Args:
        topics: of the bag.
        start_ns: first log time, None: from the beginning.
        stop_ns: the first log time that is left out, None: there is none.
        frames: ``.jpg`` or ``.png`` for one file per frame, None for none.
        video: an MP4 per image topic.
    """

    topics: Sequence[str]
    start_ns: int | None = None
    stop_ns: int | None = None
    frames: str | None = None
    video: bool = False
    csv: bool = False
    parquet: bool = False

    @property
    def span(self) -> tuple[int | None, int | None]:
        return self.start_ns, self.stop_ns


@dataclass(frozen=True, slots=True)
class Written:
    """One thing that was exported: its topic, file or folder, and how many rows or frames."""

    topic: str
    file: str
    count: int
    unit: str


@dataclass(slots=True)
class ExportReport:
    """What was exported, and what a person should know about it."""

    written: list[Written] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def export_bag(
    bag: BagReader,
    wanted: ExportOptions,
    target: Path,
    advance: Callable[[int], None] = lambda _: None,
) -> ExportReport:
    """Writes the files; the bag stays as it is, and memory doesn't grow with it.

    Args:
        bag: open for reading.
        target: folder to make; must not exist.
        advance: called with the number of messages and frames done since the last call.

    Raises:
        InputError: the target exists, the bag is damaged where it is read, or nothing in it can be
            exported as it was asked for.
        HostError: the disk doesn't take it, or pyarrow is missing for Parquet.
    """
    try:
        with new_folder(target, "name a new folder") as folder:
            folder.mkdir()
            export = _Export(bag, wanted, folder, advance)
            export.pictures()
            export.tables()
            if not any(folder.iterdir()):
                raise export.nothing()
    except av.error.FFmpegError as error:
        raise HostError(f"{target}: can't be written: {error.strerror or error}") from error
    return export.report


def _some(topics: Iterable[str], most: int = 8) -> str:
    named = sorted(topics)
    return ", ".join(named[:most]) + (f" and {len(named) - most} more" * (len(named) > most))


class _Export:
    def __init__(
        self, bag: BagReader, wanted: ExportOptions, folder: Path, advance: Callable[[int], None]
    ) -> None:
        self._bag, self._wanted, self._folder, self._advance = bag, wanted, folder, advance
        names = FileNames()
        self._names = {topic: names.of(topic) for topic in wanted.topics}
        self.report = ExportReport()

    def pictures(self) -> None:
        """Frames and videos, topic by topic."""
        if self._wanted.frames is None and not self._wanted.video:
            return
        images = set(image_topics(self._bag))
        chosen = [topic for topic in self._wanted.topics if topic in images]
        if not chosen:
            self.report.notes.append("none of the topics holds images")
        for topic in chosen:
            if self._wanted.frames is not None:
                self._images(topic, self._wanted.frames)
            if self._wanted.video:
                self._video(topic)

    def _images(self, topic: str, suffix: str) -> None:
        name, losses = self._names[topic], Losses()
        count = write_images(
            self._bag, topic, self._folder / name, suffix, self._wanted.span, losses, self._advance
        )
        self.report.written.append(Written(topic, f"{name}/", count, "frames"))
        self._lost(topic, losses)

    def _video(self, topic: str) -> None:
        losses = Losses()
        stem = self._folder / self._names[topic]
        files, count = write_video(self._bag, topic, stem, self._wanted.span, losses, self._advance)
        listed = ", ".join(file.name for file in files) or "-"
        self.report.written.append(Written(topic, listed, count, "frames"))
        if len(files) > 1:
            self.report.notes.append(f"{topic}: the frames change their size; one file for each")
        if self._wanted.frames is None:
            self._lost(topic, losses)

    def _lost(self, topic: str, losses: Losses) -> None:
        if losses.count:
            self.report.notes.append(
                f"{topic}: {losses.count} frames left out that are no pictures; {losses.first}"
            )

    def nothing(self) -> InputError:
        """What to say when no file was made."""
        if self._wanted.csv or self._wanted.parquet:
            filled = [name for name, info in self._bag.topics.items() if info.count]
            can = f"messages are in {_some(filled)}" if filled else "the bag holds no messages"
        else:
            images = image_topics(self._bag)
            can = f"images are in {_some(images)}" if images else "the bag holds no images"
            can += "; --csv and --parquet export tables of any topic"
        why = f": {'; '.join(self.report.notes[:3])}" if self.report.notes else ""
        return InputError(f"nothing to export{why}", file=self._bag.path, remedy=can)

    def tables(self) -> None:
        """All topics, a few dozen at a time."""
        kinds: list[type[CsvFile | ParquetFile]] = []
        kinds += [CsvFile] if self._wanted.csv else []
        kinds += [ParquetFile] if self._wanted.parquet else []
        topics = list(self._layouts()) if kinds else []
        for begin in range(0, len(topics), _OPEN_TABLES):
            self._pass(topics[begin : begin + _OPEN_TABLES], kinds)

    def _layouts(self) -> Iterator[tuple[str, Layout]]:
        for topic in self._wanted.topics:
            info = self._bag.topics[topic]
            if not info.count:
                self.report.notes.append(f"{topic}: no messages, so no table")
                continue
            try:
                layout = layout_of(self._bag.store(topic), info.msgtype)
            except (InputError, ValueError) as error:
                self.report.notes.append(f"{topic}: no table: {error}")
                continue
            if layout.left_out:
                self.report.notes.append(
                    f"{topic}: left out of the table: {', '.join(layout.left_out)} (bytes)"
                )
            yield topic, layout

    def _pass(
        self, topics: Sequence[tuple[str, Layout]], kinds: Sequence[type[CsvFile | ParquetFile]]
    ) -> None:
        layouts = dict(topics)
        tables: dict[str, list[TableFile]] = {}
        damaged: dict[str, tuple[int, str]] = {}
        with ExitStack() as stack:
            for topic, layout in topics:
                tables[topic] = []
                for kind in kinds:
                    path = self._folder / f"{self._names[topic]}{kind.suffix}"
                    table: TableFile = kind(path, layout.columns)
                    stack.callback(table.close)
                    tables[topic].append(table)
            for message in self._bag.messages(list(layouts), *self._wanted.span):
                try:
                    decoded = self._bag.decode(message)
                except InputError as error:
                    count, first = damaged.get(message.topic, (0, str(error)))
                    damaged[message.topic] = (count + 1, first)
                    continue
                for row in layouts[message.topic].rows(message, decoded):
                    for table in tables[message.topic]:
                        table.write(row)
                self._advance(1)
        for topic, written in tables.items():
            for kind, filled in zip(kinds, written, strict=True):
                name = f"{self._names[topic]}{kind.suffix}"
                self.report.written.append(Written(topic, name, filled.rows, "rows"))
        for topic, (count, first) in damaged.items():
            self.report.notes.append(f"{topic}: {count} messages left out; the first: {first}")


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@span_options
@click.option(
    "--frames",
    type=click.Choice(["jpg", "png"]),
    help="Each frame as an image; what was recorded so is copied byte for byte.",
)
@click.option("--video", is_flag=True, help="An MP4 per image topic, at the recorded times.")
@click.option("--csv", is_flag=True, help="A table per topic as CSV.")
@click.option("--parquet", is_flag=True, help="A table per topic as Parquet (needs pyarrow).")
@click.option(
    "-o", "--out", "target", type=click.Path(path_type=Path), required=True, help="New folder."
)
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def export_command(
    source: Path,
    start: str | None,
    end: str | None,
    topics: tuple[str, ...],
    exclude: tuple[str, ...],
    frames: str | None,
    video: bool,
    csv: bool,
    parquet: bool,
    target: Path,
    json_: bool,
) -> None:
    """Export frames of a bag as images or MP4, and its topics as tables.

    Tables have one row per message, or per item where a message is an array of messages; nested
    fields have dotted names, and times stand in ns and in s.
    """
    if not (frames or video or csv or parquet):
        raise click.UsageError("nothing to export: give --frames, --video, --csv or --parquet")
    with BagReader(source) as bag:
        start_ns, stop_ns = chosen_span(bag, start, end)
        wanted = ExportOptions(
            topics=chosen_topics(bag, topics, exclude),
            start_ns=start_ns,
            stop_ns=stop_ns,
            frames=f".{frames}" if frames else None,
            video=video,
            csv=csv,
            parquet=parquet,
        )
        with progress("exporting", None) as bar:
            task = bar.task_ids[0]
            report = export_bag(bag, wanted, target, lambda count: bar.advance(task, count))
    if json_:
        click.echo(json.dumps({"path": str(target), **asdict(report)}, indent=1))
        return
    _tell(target, report)


def _tell(target: Path, report: ExportReport) -> None:
    for text in report.notes:
        note(text)
    width = max((len(one.file) for one in report.written), default=0)
    for one in report.written:
        out.print(f"{one.file:{width}}  {one.count:>8} {one.unit}", markup=False)
    out.print(f"{target}: {len(report.written)} exported", markup=False)
