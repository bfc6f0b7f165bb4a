"""Making a package: files collected, stored by content, checked, and there wholly or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ssp_core import __version__
from ssp_core.bag.metadata import ROOT_KEY
from ssp_core.errors import HostError, InputError, not_read
from ssp_core.files.folders import check_folder, put_in_place, scratch_beside
from ssp_core.files.reading import MAX_TEXT_BYTES, parse_mapping
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_bytes
from ssp_eval.data.audit import SCHEMA as AUDIT_SCHEMA
from ssp_eval.data.labels import SCHEMA as LABELS_SCHEMA
from ssp_eval.evaluate.store.cell_file import CELL_FILE, RECORDS_FILE, SCORE_FILE
from ssp_eval.evaluate.store.requests import RAW_FILE, REQUESTS_FILE
from ssp_eval.observations.model import SCHEMA as OBSERVATION_SCHEMA
from ssp_eval.package.contents import Contents, Problem
from ssp_eval.package.log import merged_log
from ssp_eval.package.model import (
    OBJECTS,
    SCHEMA,
    TABLE_FILE,
    UNSEEN,
    FileEntry,
    Package,
    Progress,
    Role,
    sealed,
    table_bytes,
)
from ssp_eval.package.verify import Findings, work_out
from ssp_scenario_manager.compile.task import SCHEMA as TASK_SCHEMA
from ssp_scenario_manager.event_spec.model import SCHEMA as EVENT_SCHEMA

_BY_SCHEMA: dict[str, Role] = {
    EVENT_SCHEMA: "event",
    "ssp.site/1": "site",
    "ssp.shortlist/1": "shortlist",
    TASK_SCHEMA: "task",
    "ssp.run/1": "run",
    LABELS_SCHEMA: "labels",
    "ssp.proposal/1": "proposal",
    OBSERVATION_SCHEMA: "observation",
    AUDIT_SCHEMA: "audit",
    "ssp.cell/1": "cell",
    "ssp.result/1": "result",
    "ssp.verdict/1": "verdict",
    "ssp.declaration/1": "declaration",
    "ssp.truth/1": "truth",
    "ssp.log/1": "log",
}
_BY_SUFFIX: dict[str, Role] = {
    ".mcap": "recording",
    ".mp4": "video",
    ".avi": "video",
    ".mkv": "video",
    ".mov": "video",
    ".webm": "video",
    ".m4v": "video",
    ".xodr": "map",
    ".html": "page",
}
# These have no schema of their own, or not in every line.
_IN_A_CELL: dict[str, Role] = {
    RAW_FILE: "raw",
    REQUESTS_FILE: "requests",
    RECORDS_FILE: "records",
    SCORE_FILE: "score",
}


def role_of(path: str, file: Path, in_a_cell: bool) -> Role:
    """Determine the role of a file."""
    name = PurePosixPath(path).name
    suffix = PurePosixPath(name).suffix.lower()
    if in_a_cell and name in _IN_A_CELL:
        return _IN_A_CELL[name]
    if name.endswith(".net.xml"):
        return "map"
    if suffix in _BY_SUFFIX:
        return _BY_SUFFIX[suffix]
    if suffix in (".jpg", ".jpeg") and PurePosixPath(path).parent.name == "frames":
        return "frame"
    if suffix in (".json", ".yaml", ".yml"):
        return _of_mapping(_mapping(file, path))
    if suffix == ".jsonl":
        return _of_mapping(_first_line(file))
    return "other"


def is_cell_folder(names: frozenset[str]) -> bool:
    """Return True where the files of a folder are those of a cell."""
    return CELL_FILE in names


def _of_mapping(value: dict[str, Any]) -> Role:
    if ROOT_KEY in value:
        return "bag_metadata"
    return _BY_SCHEMA.get(str(value.get("schema")), "other")


def _mapping(file: Path, path: str) -> dict[str, Any]:
    """Return the mapping in a file; empty if it holds none, since it may be other evidence."""
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_TEXT_BYTES + 1)
        return parse_mapping(data, path)
    except InputError:
        return {}


def _first_line(file: Path) -> dict[str, Any]:
    with file.open("rb") as stream:
        line = stream.readline(MAX_TEXT_BYTES)
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Source:
    """One file to take in.

    Args:
        path: in the package: the folder's name, and the path below it.
    """

    path: str
    file: Path
    bytes: int


def collect(folders: Sequence[Path], out: Path) -> list[Source]:
    """Return all files of some folders, by path, but for hidden ones and for packages among them.

    Args:
        folders: none of which lies in another.
        out: the package that will be made, which is left out.

    Raises:
        InputError: a folder isn't there or is given twice, or holds what is no plain file.
    """
    _check_distinct(folders)
    names: dict[str, Path] = {}
    sources: list[Source] = []
    for folder in folders:
        base = folder.resolve().name or "root"
        name = base
        for number in range(2, len(folders) + 2):
            if name not in names:
                break
            name = f"{base}-{number}"
        names[name] = folder
        for file in _files(folder, out.resolve()):
            path = "/".join((name, *file.relative_to(folder).parts))
            sources.append(Source(_utf8(path, file), file, file.stat().st_size))
    if not sources:
        raise InputError("holds no files", file=folders[0], remedy="name folders with evidence")
    return sorted(sources, key=lambda source: source.path)


def _check_distinct(folders: Sequence[Path]) -> None:
    real_paths: list[tuple[Path, Path]] = []
    for folder in folders:
        check_folder(folder, "name folders with evidence")
        real = folder.resolve()
        for other, other_folder in real_paths:
            if real == other or other in real.parents or real in other.parents:
                raise InputError(
                    f"and {other_folder} hold the same files",
                    file=folder,
                    remedy="name each folder once",
                )
        real_paths.append((real, folder))


def _files(folder: Path, out: Path) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        raise not_read(folder, error) from error
    for entry in entries:
        path = Path(entry.path)
        # Unlike Path.resolve, it takes a link that leads to itself.
        is_out = os.path.realpath(path) == str(out)
        if entry.name.startswith(".") or is_out or entry.name == "__pycache__":
            continue
        if entry.is_dir(follow_symlinks=False):
            if not is_package(path):
                yield from _files(path, out)
        elif path.is_file():
            yield path
        else:
            kind = "a link to a folder or to nothing" if entry.is_symlink() else "no plain file"
            raise InputError(f"is {kind}", file=path, remedy="remove it, or put a file there")


def is_package(folder: Path) -> bool:
    """Return True for a folder that `ssp package make` left."""
    table = folder / TABLE_FILE
    if not table.is_file():
        return False
    try:
        with table.open("rb") as stream:
            data = stream.read()
        value = json.loads(data)
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(value, dict) and value.get("schema") == SCHEMA


def _utf8(path: str, file: Path) -> str:
    try:
        path.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(
            "has a name that is not UTF-8",
            file=str(file).encode("utf-8", "replace").decode(),
            remedy="rename it",
        ) from None
    return path


LOG_PATH = "log.jsonl"
_BLOCK_BYTES = 1 << 20
# Nobody writes into these once they are there, so that a second name for the same bytes is safe.
# Other files are copied: a log is appended to in place.
_LINKED: frozenset[Role] = frozenset({"recording", "video", "frame"})
_SHOWN_PROBLEMS = 12


def make_package(
    folders: Sequence[Path],
    out: Path,
    *,
    force: bool = False,
    copy: bool = False,
    progress: Progress = UNSEEN,
    workers: int = 1,
) -> tuple[Package, Findings]:
    """Take everything in some folders into a package.

    Args:
        folders: with recordings, compiled tasks, labels, audits, cells, logs, source videos.
        out: folder of the package.
        force: an earlier package there is replaced, once the new one is whole.
        copy: copy all bytes, without hard links.
        progress: receives how many bytes there are to store, those read, and each step.
        workers: see work_out.

    Returns:
        The table of contents, and what was found.

    Raises:
        InputError: a folder can't be read, ``out`` is taken, or a link doesn't hold: something is
            named that is in none of the folders. Nothing is left behind.
        HostError: the disk doesn't take it.
    """
    _check_out(out, force)
    sources = collect(folders, out)
    progress.total(sum(source.bytes for source in sources))
    scratch = scratch_beside(out)
    try:
        (scratch / OBJECTS).mkdir()
        files = _store_all(sources, scratch, copy, progress)
        files.append(_store_log(files, scratch))
        contents = Contents(scratch, files)
        findings = work_out(contents, progress.step, workers)
        if findings.problems:
            raise _broken(findings.problems, out)
        if not contents.of("recording"):
            raise InputError("holds no recording", file=folders[0], remedy="name folders of runs")
        package = sealed(
            Package(
                schema_=SCHEMA,
                software=f"ssp {__version__}",
                files=list(contents.files),
                links=list(findings.links),
                chains=list(findings.chains),
                missing=list(findings.missing),
            )
        )
        write_bytes(scratch / TABLE_FILE, table_bytes(package))
        scratch.chmod(0o755)
        _check_out(out, force)  # again: another command may have begun there meanwhile
        put_in_place(scratch, out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return package, findings


def _check_out(out: Path, force: bool) -> None:
    if not os.path.lexists(out):
        return
    if out.is_dir() and not out.is_symlink() and (is_package(out) or not any(out.iterdir())):
        if force or not any(out.iterdir()):
            return
        remedy = "replace it with --force, or name another folder with --out"
        raise InputError("exists already", file=out, remedy=remedy)
    raise InputError(
        "is there and is no package", file=out, remedy="name another folder with --out"
    )


def _store_all(
    sources: Sequence[Source], scratch: Path, copy: bool, progress: Progress
) -> list[FileEntry]:
    names: dict[str, set[str]] = {}
    for source in sources:
        place = PurePosixPath(source.path)
        names.setdefault(str(place.parent), set()).add(place.name)
    entries = []
    for source in sources:
        parent = str(PurePosixPath(source.path).parent)
        role = role_of(source.path, source.file, is_cell_folder(frozenset(names[parent])))
        entries.append(_store(source, role, scratch, copy, progress))
    return entries


def _store(source: Source, role: Role, scratch: Path, copy: bool, progress: Progress) -> FileEntry:
    """Store one file under its hash, which is that of the bytes that are stored."""
    handle, name = tempfile.mkstemp(dir=scratch, prefix="incoming.")
    os.close(handle)
    incoming = Path(name)
    linked = not copy and role in _LINKED and _link(source.file, incoming)
    digest, size = hashlib.sha256(), 0
    try:
        with (
            (incoming if linked else source.file).open("rb") as source_stream,
            nullcontext() if linked else incoming.open("wb") as stream,
        ):
            while block := source_stream.read(_BLOCK_BYTES):
                digest.update(block)
                size += len(block)
                if stream is not None:
                    stream.write(block)
                progress.bytes(len(block))
        if not linked:
            incoming.chmod(0o644)
        incoming.replace(scratch / OBJECTS / digest.hexdigest())
    except OSError as error:
        raise HostError(f"{source.file}: can't be taken in: {error.strerror}") from error
    return FileEntry(path=source.path, role=role, sha256=f"sha256:{digest.hexdigest()}", bytes=size)


def _link(file: Path, incoming: Path) -> bool:
    """Give the bytes a second name; return False where the file systems don't allow that."""
    incoming.unlink()
    try:
        os.link(file.resolve(), incoming)
    except OSError:
        incoming.touch()
        return False
    return True


def _store_log(files: Sequence[FileEntry], scratch: Path) -> FileEntry:
    contents = Contents(scratch, files)
    data = merged_log((e.path, contents.text(e)) for e in contents.of("log")).encode()
    entry = FileEntry(path=LOG_PATH, role="log_merged", sha256=sha256_bytes(data), bytes=len(data))
    write_bytes(contents.object(entry), data)
    return entry


def _broken(problems: Sequence[Problem], out: Path) -> InputError:
    lines = [str(problem) for problem in problems[:_SHOWN_PROBLEMS]]
    if len(problems) > len(lines):
        lines.append(f"and {len(problems) - len(lines)} more")
    text = "\n  ".join(["can't be made, since not every link holds:", *lines])
    return InputError(
        text, file=out, remedy="name the folders that hold what is missing, and make the rest anew"
    )
