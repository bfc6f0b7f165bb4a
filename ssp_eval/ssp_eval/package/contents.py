"""The files of a package: reading them by their former paths, and what each says of itself."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader, bag_files
from ssp_core.errors import InputError
from ssp_core.files.reading import Model, parse_mapping, parse_model
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.verdict import VERDICT_FILE
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.audit import RecordingEntry
from ssp_eval.data.provenance import (
    IMPORT_ATTACHMENT,
    RUN_ATTACHMENT,
    ImportRecord,
    checked_seal,
    read_provenance,
)
from ssp_eval.package.model import FileEntry, Link, Role, object_path
from ssp_scenario_manager.compile.task import TASK_FILE, TASK_FOLDER, Task, content_hash
from ssp_scenario_manager.event_spec.load import event_version
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.site import Site, site_version

# Text files among evidence: answers of a long campaign may be larger than what people write.
MAX_READ_BYTES = 256 << 20


class Contents:
    """The stored files by path; the same for a package that is being made and one that is read."""

    def __init__(self, folder: Path, files: Sequence[FileEntry]) -> None:
        self.folder = folder
        self.files = tuple(sorted(files, key=lambda entry: entry.path))
        self.by_path = {entry.path: entry for entry in self.files}

    @cached_property
    def _by_hash(self) -> dict[str, list[FileEntry]]:
        files_by_hash: dict[str, list[FileEntry]] = {}
        for entry in self.files:
            files_by_hash.setdefault(entry.sha256, []).append(entry)
        return files_by_hash

    def of(self, *roles: Role) -> list[FileEntry]:
        """Return the files of some roles, by path."""
        return [entry for entry in self.files if entry.role in roles]

    def beside(self, path: str, name: str) -> FileEntry | None:
        """Return the file of a name in the same folder."""
        return self.by_path.get(str(PurePosixPath(path).with_name(name)))

    def with_hash(self, sha256: str, near: str, *roles: Role) -> FileEntry | None:
        """Return the file with this hash; of several, the one whose path shares most with ``near``.

        Args:
            sha256: of its bytes.
            near: a path in the package.
            roles: that it may have; none: any.
        """
        candidates = [e for e in self._by_hash.get(sha256, []) if not roles or e.role in roles]
        return nearest(candidates, near)

    def object(self, entry: FileEntry) -> Path:
        """Return the path of its bytes."""
        return object_path(self.folder, entry.sha256)

    def data(self, entry: FileEntry) -> bytes:
        """Return its bytes.

        Raises:
            InputError: they can't be read, or are more than anything of this kind holds.
        """
        if entry.bytes > MAX_READ_BYTES:
            raise InputError(
                f"is larger than {MAX_READ_BYTES >> 20} MiB",
                file=entry.path,
                remedy="leave the file out of the package",
            )
        try:
            return self.object(entry).read_bytes()
        except OSError as error:
            raise InputError(
                f"can't be read: {error.strerror}", file=entry.path, remedy="get the package anew"
            ) from error

    def text(self, entry: FileEntry) -> str:
        """Return its text.

        Raises:
            InputError: as data, or it is not UTF-8.
        """
        try:
            return self.data(entry).decode("utf-8")
        except UnicodeDecodeError as error:
            raise InputError(
                f"is not UTF-8 (byte {error.start})",
                file=entry.path,
                remedy="save it as UTF-8, and make the package again",
            ) from error

    def mapping(self, entry: FileEntry) -> dict[str, Any]:
        """Return the mapping in a YAML or JSON file.

        Raises:
            InputError: it holds none.
        """
        return parse_mapping(self.data(entry), entry.path)

    @contextmanager
    def bag(self, recording: FileEntry) -> Iterator[BagReader]:
        """Yield a bag, opened under the names that its files had.

        Raises:
            InputError: it is no bag or damaged; the message names the path that it had.
        """
        parent = PurePosixPath(recording.path).parent
        metadata = self.by_path.get(str(parent / "metadata.yaml"))
        with tempfile.TemporaryDirectory(prefix="ssp-package-") as scratch:
            place = Path(scratch) / "bag"
            place.mkdir()
            for entry in self.files:
                if PurePosixPath(entry.path).parent == parent:
                    os.symlink(self.object(entry).resolve(), place / PurePosixPath(entry.path).name)
            name = PurePosixPath(recording.path).name
            try:
                with BagReader(place if metadata is not None else place / name) as bag:
                    yield bag
            except InputError as error:
                package_path = (error.file or "").replace(str(place), str(parent))
                raise InputError(
                    error.problem,
                    file=package_path or recording.path,
                    field=error.field,
                    value=error.value,
                    remedy=error.remedy,
                ) from error

    def lay_out(self, recording: FileEntry, root: Path) -> Path:
        """Return a bag as it lay when it was packed, with the files beside it that an audit reads.

        Args:
            recording: entry of the MCAP file.
            root: a new folder, under which links to the objects stand at the paths that they had.

        Returns:
            The bag's folder, or its file where it has none.

        Raises:
            InputError: the paths can't lie in one folder.
        """
        here = PurePosixPath(recording.path).parent
        whole = self.beside(recording.path, "metadata.yaml") is not None
        run = here.parent if whole else here
        try:
            root.mkdir()
            for entry in self.files:
                if PurePosixPath(entry.path).parent in (here, run, run / TASK_FOLDER):
                    place = root / entry.path
                    place.parent.mkdir(parents=True, exist_ok=True)
                    place.symlink_to(self.object(entry).resolve())
        except OSError as error:
            raise InputError(
                f"can't be laid out beside its files: {error.strerror}",
                file=recording.path,
                remedy="make room for temporary files, or set TMPDIR",
            ) from error
        return root / here if whole else root / recording.path


def nearest(entries: Sequence[FileEntry], near: str) -> FileEntry | None:
    """Return the entry whose path shares the longest beginning with another path; None of none."""
    if not entries:
        return None
    parts = PurePosixPath(near).parts

    def shared(entry: FileEntry) -> int:
        pairs = zip(PurePosixPath(entry.path).parts, parts, strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

    best = max(shared(entry) for entry in entries)
    return min((e for e in entries if shared(e) == best), key=lambda e: e.path)


_IMAGE = absolute(CAMERA_IMAGE)

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Problem:
    """A link that doesn't hold.

    Args:
        file: path of the file that names something, or that is wrong.
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
        sha256: content hash as evaluation and audit name it.
        frames: hash of each camera frame by its stamp.
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
    """Events, sites, tasks and recordings of a package, each by what others name it by."""

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
        files_by_version: dict[str, list[FileEntry]] = {}
        for entry in self.contents.files:
            if entry.role == role:
                version = self._try(entry, read)
                if version is not None:
                    files_by_version.setdefault(version, []).append(entry)
        return files_by_version

    def _try(self, entry: FileEntry, read: Callable[[FileEntry], Item]) -> Item | None:
        """Read a file, or return None with a note: the problem is then the file that names it."""
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
        """Return the runner's verdict in the folder of an MCAP file."""
        return self.contents.beside(recording.path, VERDICT_FILE)

    def place_of(self, audited: RecordingEntry) -> FileEntry | None:
        """Return the MCAP file of a recording that an audit is of; None: it isn't in the package.

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
        """Return one MCAP file of each bag."""
        first: dict[str, FileEntry] = {}
        for entry in self.contents.of("recording"):
            whole = self.contents.beside(entry.path, "metadata.yaml") is not None
            first.setdefault(str(PurePosixPath(entry.path).parent) if whole else entry.path, entry)
        return list(first.values())

    def _recording(self, entry: FileEntry) -> Recording:
        with self.contents.bag(entry) as bag:
            checked_seal(bag)
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
            sha256 = digests[0] if len(digests) == 1 else sha256_json(digests)
            if {RUN_ATTACHMENT, IMPORT_ATTACHMENT} & attachments.keys() and (
                remark := read_provenance(bag, sha256).remark
            ):
                self.notes.append(f"{PurePosixPath(entry.path).parent}: {remark}")
        return Recording(
            entry=entry,
            sha256=sha256,
            attachments=attachments,
            frames=frames,
            run=_parsed(RunSpec, attachments, RUN_ATTACHMENT, entry.path),
            video=_parsed(ImportRecord, attachments, IMPORT_ATTACHMENT, entry.path),
            task=_attached_task(attachments, entry.path),
        )


def sealed_task(data: bytes, name: str) -> Task:
    """Return a task whose seal holds.

    Raises:
        InputError: it is none, or its seal is broken.
    """
    task = parse_model(Task, parse_mapping(data, name), name)
    content_sha256 = content_hash(task)
    if content_sha256 != task.version:
        raise InputError(
            f"was changed after it was compiled: its content has {content_sha256}",
            file=name,
            field="version",
            value=task.version,
            remedy="compile it again, or put the file back",
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
    hashes_by_stamp: dict[int, str] = {}
    if _IMAGE in bag.topics:
        for frame in Frames(bag, _IMAGE).jpegs():
            hashes_by_stamp.setdefault(frame.stamp_ns, sha256_bytes(frame.data))
    return hashes_by_stamp


def missing_parts(
    index: Index, cells: Mapping[str, Mapping[str, Any]], links: Iterable[Link]
) -> list[str]:
    """Return one line for each part of P_s that is not there, by scenario.

    Source video, K*, artefacts and recording of each domain, labels and log are needed; an audit
    too, without which no recording is admitted.
    """
    links = list(links)
    used = {link.hash for link in links if link.kind == "bag"}
    recordings = [r for digest, r in index.recordings.items() if digest in used]
    scenarios = {str(facts.get("scenario")) for facts in cells.values()}
    scenarios |= {r.scenario for r in recordings if r.scenario is not None}
    parts: list[str] = []
    for scenario in sorted(scenarios):
        domains = {r.domain for r in recordings if r.scenario == scenario}
        parts += [f"{scenario}: no {d} recording" for d in DOMAINS if d not in domains]
        own = {path for path, facts in cells.items() if facts.get("scenario") == scenario}
        if not own:
            parts.append(f"{scenario}: no evaluated cell")
        unaudited = own - {link.source for link in links if link.kind == "audit"}
        parts += [f"{path}: no audit" for path in sorted(unaudited)]
    there = {link.source for link in links if link.kind == "source_video"}
    parts += [f"{path}: no source video" for path in sorted(set(index.sources) - there)]
    if not index.contents.of("log"):
        parts.append("no log")
    return parts
