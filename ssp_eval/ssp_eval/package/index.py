"""What the files of a package say of themselves: versions, seals, and what a recording names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TypeVar

from ssp_core.bag.frames import Frames
from ssp_core.bag.reader import BagReader, bag_files
from ssp_core.errors import InputError
from ssp_core.files import Model, parse_mapping, parse_model
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.verdict import VERDICT_FILE
from ssp_eval.audit.model import RecordingEntry
from ssp_eval.package.contents import Contents
from ssp_eval.package.model import FileEntry
from ssp_eval.recordings.import_record import IMPORT_ATTACHMENT, ImportRecord
from ssp_eval.recordings.provenance import (
    RUN_ATTACHMENT,
)
from ssp_scenario_manager.compile.task import TASK_FILE, Task, content_hash
from ssp_scenario_manager.event_spec.load import event_version
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.site import Site, site_version

_IMAGE = absolute(CAMERA_IMAGE)

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Problem:
    """A link that doesn't hold.

    Args:
        file: path of the file that names something, or that is wrong.
        field: where it does.
        text: what is wrong, one clause.
    """

    file: str
    field: str
    text: str

    def __str__(self) -> str:
        return ": ".join(part for part in (self.file, self.field, self.text) if part)


@dataclass(frozen=True)
class Recording:
    """A bag among the files.

    Args:
        entry: its first MCAP file.
        sha256: content hash as evaluation and audit name it.
        attachments: data by name.
        frames: hash of each camera frame by its stamp.
        run: of a session.
        video: of an imported video.
        task: sealed task in the bag.
    """

    entry: FileEntry
    sha256: str
    attachments: dict[str, bytes]
    frames: dict[int, str]
    run: RunSpec | None
    video: ImportRecord | None
    task: Task | None

    @property
    def scenario(self) -> str | None:
        if self.run is not None:
            return self.run.scenario
        return None if self.video is None else self.video.scenario

    @property
    def domain(self) -> str | None:
        if self.run is not None:
            return self.run.domain
        return None if self.video is None else self.video.domain

    @property
    def event_version(self) -> str | None:
        if self.run is not None:
            return self.run.event_version
        return None if self.video is None else self.video.event_version


class Index:
    """Events, sites, tasks and recordings of a package, each by what others name it by.

    Args:
        contents: of the package.
        on_step: told which recording is read next.
    """

    def __init__(self, contents: Contents, on_step: Callable[[str], None] = lambda _: None) -> None:
        self.contents = contents
        self.notes: list[str] = []
        self.problems: list[Problem] = []
        self.sites = self._versions("site", self._site)
        self.seals: dict[str, Task] = {}
        self.sources: dict[str, str] = {}  # path of a K*: hash of the clip that it was taken from
        self.tasks = self._versions("task", self._task)
        self.events = self._versions("event", self._event)
        self.recordings: dict[str, Recording] = {}
        self.copies: dict[str, list[FileEntry]] = {}  # the same bytes may lie at several places
        for entry in self._bags():
            on_step(f"reading {entry.path}")
            recording = self._try(entry, self._recording)
            if recording is not None:
                self.recordings.setdefault(recording.sha256, recording)
                self.copies.setdefault(recording.sha256, []).append(entry)

    def _versions(self, role: str, read: Callable[[FileEntry], str]) -> dict[str, list[FileEntry]]:
        found: dict[str, list[FileEntry]] = {}
        for entry in self.contents.files:
            if entry.role == role:
                version = self._try(entry, read)
                if version is not None:
                    found.setdefault(version, []).append(entry)
        return found

    def _try(self, entry: FileEntry, read: Callable[[FileEntry], Item]) -> Item | None:
        """What is read, or None with a note: whoever names the file will be the problem."""
        try:
            return read(entry)
        except InputError as error:
            self.notes.append(str(error))
            return None

    def _event(self, entry: FileEntry) -> str:
        event = parse_model(Event, self.contents.mapping(entry), entry.path)
        if event.source.sha256 is not None:
            self.sources[entry.path] = event.source.sha256
        return event_version(event)

    def verdict_beside(self, recording: FileEntry) -> FileEntry | None:
        """The runner's verdict in the folder of an MCAP file."""
        return self.contents.beside(recording.path, VERDICT_FILE)

    def place_of(self, audited: RecordingEntry) -> FileEntry | None:
        """The MCAP file of a recording that an audit is of; None: it isn't in the package.

        Of several copies it is one with the verdict that the audit read.
        """
        copies = self.copies.get(audited.bag_sha256, [])

        def unlike(copy: FileEntry) -> bool:
            verdict = self.verdict_beside(copy)
            return audited.verdict_sha256 != (None if verdict is None else verdict.sha256)

        return min(copies, key=lambda copy: (unlike(copy), copy.path), default=None)

    def _site(self, entry: FileEntry) -> str:
        return site_version(parse_model(Site, self.contents.mapping(entry), entry.path))

    def _task(self, entry: FileEntry) -> str:
        try:
            task = sealed_task(self.contents.data(entry), entry.path)
        except InputError as error:
            # Unlike a draft of an event, a task that nobody names is still claimed to be sealed.
            self.problems.append(Problem(entry.path, error.field or "", error.problem))
            raise
        self.seals[entry.path] = task
        return task.version

    def _bags(self) -> Sequence[FileEntry]:
        """One MCAP file of each bag."""
        first: dict[str, FileEntry] = {}
        for entry in self.contents.of("recording"):
            whole = self.contents.beside(entry.path, "metadata.yaml") is not None
            first.setdefault(str(PurePosixPath(entry.path).parent) if whole else entry.path, entry)
        return list(first.values())

    def _recording(self, entry: FileEntry) -> Recording:
        with self.contents.bag(entry) as bag:
            digests = [
                self.contents.by_path[str(PurePosixPath(entry.path).with_name(file.name))].sha256
                for file in bag_files(bag.path)
            ]
            attachments = {
                name: data
                for name in dict.fromkeys(bag.attachments)
                if (data := bag.attachment(name)) is not None
            }
            frames = _frames(bag)
        return Recording(
            entry=entry,
            sha256=digests[0] if len(digests) == 1 else sha256_json(digests),
            attachments=attachments,
            frames=frames,
            run=_parsed(RunSpec, attachments, RUN_ATTACHMENT, entry.path),
            video=_parsed(ImportRecord, attachments, IMPORT_ATTACHMENT, entry.path),
            task=_attached_task(attachments, entry.path),
        )


def sealed_task(data: bytes, name: str) -> Task:
    """A task whose seal holds.

    Raises:
        InputError: it is none, or its seal is broken.
    """
    task = parse_model(Task, parse_mapping(data, name), name)
    found = content_hash(task)
    if found != task.version:
        raise InputError(
            f"was changed after it was compiled: its content has {found}",
            file=name,
            field="version",
            value=task.version,
        )
    return task


def _attached_task(attachments: dict[str, bytes], path: str) -> Task | None:
    data = attachments.get(TASK_FILE)
    return None if data is None else sealed_task(data, f"{path}:{TASK_FILE}")


def _parsed(
    model: type[Model], attachments: dict[str, bytes], name: str, path: str
) -> Model | None:
    data = attachments.get(name)
    if data is None:
        return None
    place = f"{path}:{name}"
    return parse_model(model, parse_mapping(data, place), place)


def _frames(bag: BagReader) -> dict[int, str]:
    found: dict[int, str] = {}
    if _IMAGE in bag.topics:
        for frame in Frames(bag, _IMAGE).jpegs():
            found.setdefault(frame.stamp_ns, sha256_bytes(frame.data))
    return found
