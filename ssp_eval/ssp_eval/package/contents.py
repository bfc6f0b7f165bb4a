"""The files of a package by the paths that they had: reading them, and opening bags among them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import Any

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping
from ssp_eval.package.model import FileEntry, Role, object_path
from ssp_scenario_manager.compile.targets.folder import TASK_FOLDER

# Text files among evidence: answers of a long campaign may be larger than what people write.
MAX_READ_BYTES = 256 << 20


class Contents:
    """What is stored, by path; the same for a package that is being made and one that is read.

    Args:
        folder: of the package, with its objects.
        files: that it holds.
    """

    def __init__(self, folder: Path, files: Sequence[FileEntry]) -> None:
        self.folder = folder
        self.files = tuple(sorted(files, key=lambda entry: entry.path))
        self.by_path = {entry.path: entry for entry in self.files}

    @cached_property
    def _by_hash(self) -> dict[str, list[FileEntry]]:
        found: dict[str, list[FileEntry]] = {}
        for entry in self.files:
            found.setdefault(entry.sha256, []).append(entry)
        return found

    def of(self, *roles: Role) -> list[FileEntry]:
        """The files of some roles, by path."""
        return [entry for entry in self.files if entry.role in roles]

    def beside(self, path: str, name: str) -> FileEntry | None:
        """The file of a name in the same folder."""
        return self.by_path.get(str(PurePosixPath(path).with_name(name)))

    def with_hash(self, sha256: str, near: str, *roles: Role) -> FileEntry | None:
        """The file with these bytes; of several, the one whose path shares most with ``near``.

        Args:
            sha256: of the bytes.
            near: a path.
            roles: that it may have; none: any.
        """
        found = [e for e in self._by_hash.get(sha256, []) if not roles or e.role in roles]
        return nearest(found, near)

    def object(self, entry: FileEntry) -> Path:
        """Where its bytes lie."""
        return object_path(self.folder, entry.sha256)

    def data(self, entry: FileEntry) -> bytes:
        """Its bytes.

        Raises:
            InputError: they can't be read, or are more than anything of this kind holds.
        """
        if entry.bytes > MAX_READ_BYTES:
            raise InputError(f"is larger than {MAX_READ_BYTES >> 20} MiB", file=entry.path)
        try:
            return self.object(entry).read_bytes()
        except OSError as error:
            raise InputError(f"can't be read: {error.strerror}", file=entry.path) from error

    def text(self, entry: FileEntry) -> str:
        """Its text.

        Raises:
            InputError: as data, or it is not UTF-8.
        """
        try:
            return self.data(entry).decode("utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"is not UTF-8 (byte {error.start})", file=entry.path) from error

    def mapping(self, entry: FileEntry) -> dict[str, Any]:
        """The mapping in a YAML or JSON file.

        Raises:
            InputError: it holds none.
        """
        return parse_mapping(self.data(entry), entry.path)

    @contextmanager
    def bag(self, recording: FileEntry) -> Iterator[BagReader]:
        """A bag, opened under the names that its files had.

        Args:
            recording: one of its MCAP files.

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
                told = (error.file or "").replace(str(place), str(parent))
                raise InputError(
                    error.problem,
                    file=told or recording.path,
                    field=error.field,
                    value=error.value,
                    remedy=error.remedy,
                ) from error

    def lay_out(self, recording: FileEntry, root: Path) -> Path:
        """A bag as it lay when it was taken in, with what an audit looks for beside it.

        Args:
            recording: one of its MCAP files.
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
                f"can't be laid out beside its files: {error.strerror}", file=recording.path
            ) from error
        return root / here if whole else root / recording.path


def nearest(entries: Sequence[FileEntry], near: str) -> FileEntry | None:
    """The entry whose path shares the longest beginning with another path; None of none."""
    if not entries:
        return None
    parts = PurePosixPath(near).parts

    def shared(entry: FileEntry) -> int:
        pairs = zip(PurePosixPath(entry.path).parts, parts, strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

    best = max(shared(entry) for entry in entries)
    return min((e for e in entries if shared(e) == best), key=lambda e: e.path)
