"""``ssp bag export``: a part of a bag as images, MP4 and tables, in a folder whole or not there."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path

import av
import click

from ssp_core.bag.pictures.frames import Frames, Picture, VideoFile, image_topics
from ssp_core.bag.pictures.images import decode_still, encode, even_sized, suffix_of
from ssp_core.bag.pictures.stamps import LEAP_S, settle_stamps
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.images import ImageMessage
from ssp_core.console import note, out, progress
from ssp_core.errors import HostError, InputError
from ssp_core.files.folders import new_folder
from ssp_monitor.bag_tools.selection import select_span, select_topics, span_options
from ssp_monitor.bag_tools.tables import CsvFile, Layout, layout_of

Span = tuple[int | None, int | None]  # log times, ns


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
    span: Span,
    losses: Losses,
    advance: Callable[[int], None],
) -> int:
    """Write each frame as ``<number>_<stamp in ns>.<suffix>``, and ``index.csv`` beside them.

    What was recorded in the wanted format is copied byte for byte.

    Args:
        bag: open for reading.
        topic: of the frames.
        folder: made here.
        suffix: ``.jpg`` or ``.png``.
        span: first log time, and the first that no longer belongs.
        losses: called with each frame that can't be written.
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
    span: Span,
    losses: Losses,
    advance: Callable[[int], None],
) -> tuple[list[Path], int, int]:
    """Write ``<stem>.mp4``, and ``<stem>.2.mp4`` and so on where the size of the frames changes.

    A frame whose stamp leaps is shown at its time of receipt.

    Args:
        bag: open for reading.
        topic: of the frames.
        stem: path without suffix.
        span: first log time, and the first that no longer belongs.
        losses: called with each frame that can't be written.
        advance: called with the number of frames written.

    Returns:
        The files, the number of frames in them, and how many stamps leapt.
    """
    files: list[Path] = []
    video: VideoFile | None = None
    count = 0
    frames = Frames(bag, topic, Losses())
    stamps, received = [], []
    for message, still in frames.messages(*span):
        stamps.append(still.stamp_ns)
        received.append(message.log_time_ns)
    settled = settle_stamps(stamps, received)
    shown_ns = dict(zip(zip(stamps, received, strict=True), settled.times_ns.tolist(), strict=True))
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
            at_ns = shown_ns[picture.stamp_ns, picture.log_time_ns]
            video.add(Picture(at_ns, picture.log_time_ns, image))
            count += 1
            advance(1)
    finally:
        if video is not None:
            video.close()
    return files, count, settled.count


_UNUSUAL = re.compile(r"[^A-Za-z0-9_-]")
_MOST_CHARACTERS = 100


class FileNames:
    """Gives each topic one name that no other has, also where large and small are the same."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def of(self, topic: str) -> str:
        """Return a name of letters, digits, ``_``, ``-`` and ``.``, such as ``ssp.vut.state``.

        What the name alone no longer shows gets a part of the topic's hash.
        """
        parts = topic.strip("/").split("/")
        joined = ".".join(_UNUSUAL.sub("_", part) for part in parts)
        name = joined.strip(".-")  # no hidden file, and none that a program takes for an option
        plain = name == joined and all(part and not _UNUSUAL.search(part) for part in parts)
        if not plain or len(name) > _MOST_CHARACTERS or name.lower() in self._names:
            digest = hashlib.sha256(topic.encode("utf-8", "surrogatepass")).hexdigest()[:12]
            name = f"{name[:_MOST_CHARACTERS] or 'topic'}-{digest}"
        self._names.add(name.lower())
        return name


# Tables that are written in one pass through the bag: bounds open files and memory.
_OPEN_TABLES = 64


@dataclass(frozen=True, slots=True)
class ExportEntry:
    """One thing that was exported: its topic, file or folder, and how many rows or frames."""

    topic: str
    file: str
    count: int
    unit: str


@dataclass(slots=True)
class ExportReport:
    """The exported files, and the notes on them for a person."""

    written: list[ExportEntry] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Export:
    """One export; the bag stays as it is, and memory doesn't grow with it.

    Args:
        bag: open for reading.
        topics: of the bag.
        span: first log time and the first that is left out; None: that side is open.
        frames: ``.jpg`` or ``.png`` for one file per frame, None for none.
        video: an MP4 per image topic.
        tables: the kinds of file to make of each topic.
        advance: called with the number of messages and frames done since the last call.
    """

    bag: BagReader
    topics: Sequence[str]
    span: Span = (None, None)
    frames: str | None = None
    video: bool = False
    tables: bool = False
    advance: Callable[[int], None] = lambda _: None
    report: ExportReport = field(default_factory=ExportReport)

    def into(self, target: Path) -> ExportReport:
        """Write the files into a new folder.

        Raises:
            InputError: the folder exists, the bag is damaged where it is read, or nothing in it
                can be exported as it was asked for.
            HostError: the disk doesn't take it.
        """
        files = FileNames()
        names = {topic: files.of(topic) for topic in self.topics}
        try:
            with new_folder(target, "name a new folder") as folder:
                folder.mkdir()
                if self.frames is not None or self.video:
                    self._write_pictures(folder, names)
                if self.tables:
                    self._write_tables(folder, names)
                if not any(folder.iterdir()):
                    raise self._nothing()
        except av.error.FFmpegError as error:
            raise HostError(f"{target}: can't be written: {error.strerror or error}") from error
        return self.report

    def _write_pictures(self, folder: Path, names: Mapping[str, str]) -> None:
        entries, notes = self.report.written, self.report.notes
        images = set(image_topics(self.bag))
        picture_topics = [topic for topic in self.topics if topic in images]
        if not picture_topics:
            notes.append("none of the topics holds images")
        for topic in picture_topics:
            name, losses = names[topic], Losses()
            if self.frames is not None:
                count = write_images(
                    self.bag, topic, folder / name, self.frames, self.span, losses, self.advance
                )
                entries.append(ExportEntry(topic, f"{name}/", count, "frames"))
            if self.video:
                losses = Losses()  # the same ones once more
                files, count, leapt = write_video(
                    self.bag, topic, folder / name, self.span, losses, self.advance
                )
                listed = ", ".join(file.name for file in files) or "-"
                entries.append(ExportEntry(topic, listed, count, "frames"))
                if leapt:
                    notes.append(
                        f"{topic}: {leapt} of {count} frames are shown at their times of receipt: "
                        f"their stamps leap by more than {LEAP_S:g} s"
                    )
                if len(files) > 1:
                    notes.append(f"{topic}: the frames change their size; one file for each")
            if losses.count:
                notes.append(
                    f"{topic}: {losses.count} frames left out that are no pictures; {losses.first}"
                )

    def _nothing(self) -> InputError:
        """Make the error for an export without any file."""
        if self.tables:
            filled = [name for name, info in self.bag.topics.items() if info.count]
            can = f"messages are in {_some(filled)}" if filled else "the bag holds no messages"
        else:
            images = image_topics(self.bag)
            can = f"images are in {_some(images)}" if images else "the bag holds no images"
            can += "; --csv exports a table of any topic"
        why = f": {'; '.join(self.report.notes[:3])}" if self.report.notes else ""
        return InputError(f"nothing to export{why}", file=self.bag.path, remedy=can)

    def _write_tables(self, folder: Path, names: Mapping[str, str]) -> None:
        layouts = dict(self._layouts())
        topics = list(layouts)
        for begin in range(0, len(topics), _OPEN_TABLES):
            some = {topic: layouts[topic] for topic in topics[begin : begin + _OPEN_TABLES]}
            self._write_some(folder, names, some)

    def _layouts(self) -> Iterator[tuple[str, Layout]]:
        notes = self.report.notes
        for topic in self.topics:
            info = self.bag.topics[topic]
            if not info.count:
                notes.append(f"{topic}: no messages, so no table")
                continue
            try:
                layout = layout_of(self.bag.store(topic), info.msgtype)
            except (InputError, ValueError) as error:
                notes.append(f"{topic}: no table: {error}")
                continue
            if layout.left_out:
                left_out = ", ".join(layout.left_out)
                notes.append(f"{topic}: left out of the table: {left_out} (bytes)")
            yield topic, layout

    def _write_some(
        self, folder: Path, names: Mapping[str, str], layouts: Mapping[str, Layout]
    ) -> None:
        """Write tables in one pass."""
        damaged: Counter[str] = Counter()
        first: dict[str, str] = {}
        tables: dict[str, CsvFile] = {}
        with ExitStack() as stack:
            for topic, layout in layouts.items():
                tables[topic] = CsvFile(folder / f"{names[topic]}.csv", layout.columns)
                stack.callback(tables[topic].close)
            for message in self.bag.messages(list(layouts), *self.span):
                try:
                    decoded = self.bag.decode(message)
                except InputError as error:
                    damaged[message.topic] += 1
                    first.setdefault(message.topic, str(error))
                    continue
                for row in layouts[message.topic].rows(message, decoded):
                    tables[message.topic].write(row)
                self.advance(1)
        for topic, table in tables.items():
            self.report.written.append(
                ExportEntry(topic, f"{names[topic]}.csv", table.rows, "rows")
            )
        for topic, count in damaged.items():
            self.report.notes.append(
                f"{topic}: {count} messages left out; the first: {first[topic]}"
            )


def _some(topics: Iterable[str], most: int = 8) -> str:
    topic_names = sorted(topics)
    return ", ".join(topic_names[:most]) + (
        f" and {len(topic_names) - most} more" * (len(topic_names) > most)
    )


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@span_options
@click.option(
    "--frames",
    type=click.Choice(["jpg", "png"]),
    help="Each frame as an image; recorded images are copied byte for byte.",
)
@click.option("--video", is_flag=True, help="An MP4 per image topic, at the recorded times.")
@click.option("--csv", is_flag=True, help="A table per topic as CSV.")
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
    target: Path,
    json_: bool,
) -> None:
    """Export frames of a bag as images or MP4, and its topics as tables.

    Tables have one row per message, or per item where a message is an array of messages; nested
    fields have dotted names, and times stand in ns and in s.
    """
    if not (frames or video or csv):
        raise click.UsageError("nothing to export: give --frames, --video or --csv")
    with BagReader(source) as bag:
        span = select_span(bag, start, end)
        topic_names = select_topics(bag, topics, exclude)
        with progress("exporting", None) as bar:
            task = bar.task_ids[0]
            export = Export(
                bag,
                topic_names,
                span,
                f".{frames}" if frames else None,
                video,
                csv,
                lambda count: bar.advance(task, count),
            )
            report = export.into(target)
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
