"""Making a package: stored by content, checked, and there wholly or not at all."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path, PurePosixPath

from ssp_core import __version__
from ssp_core.errors import HostError, InputError
from ssp_core.files import make_folder, write_bytes
from ssp_core.hashing import sha256_bytes
from ssp_eval.package.build import Findings, work_out
from ssp_eval.package.collect import Source, collect, is_package
from ssp_eval.package.contents import Contents
from ssp_eval.package.index import Problem
from ssp_eval.package.logs import merged_log
from ssp_eval.package.model import (
    OBJECTS,
    SCHEMA,
    TABLE_FILE,
    FileEntry,
    Package,
    Role,
    sealed,
    table_bytes,
)
from ssp_eval.package.roles import is_cell_folder, role_of

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
    on_total: Callable[[int], None] = lambda _: None,
    on_bytes: Callable[[int], None] = lambda _: None,
    on_step: Callable[[str], None] = lambda _: None,
) -> tuple[Package, Findings]:
    """Takes everything in some folders into a package.

    Args:
        folders: with recordings, compiled tasks, labels, audits, cells, logs, source videos.
        out: folder to make.
        force: an earlier package there is replaced, once the new one is whole.
        copy: make no hard links.
        on_total: told once how many bytes there are.
        on_bytes: told how many more bytes were taken in.
        on_step: told afterwards what is done next, where it takes some seconds.

    Returns:
        The table of contents, and what was found.

    Raises:
        InputError: a folder can't be read, ``out`` is taken, or a link doesn't hold: something is
            named that is in none of the folders. Nothing is left behind.
        HostError: the disk doesn't take it.
    """
    _check_out(out, force)
    sources = collect(folders, out)
    on_total(sum(source.bytes for source in sources))
    parent = make_folder(out.absolute().parent)
    scratch = Path(tempfile.mkdtemp(dir=parent, prefix=f".{out.name}."))
    try:
        (scratch / OBJECTS).mkdir()
        files = _store_all(sources, scratch, copy, on_bytes)
        files.append(_store_log(files, scratch))
        contents = Contents(scratch, files)
        findings = work_out(contents, on_step)
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
        _put(scratch, out)
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


def _put(scratch: Path, out: Path) -> None:
    """Renames the package to its place; what was there goes only when the new one is there."""
    before = Path(tempfile.mkdtemp(dir=out.absolute().parent, prefix=f".{out.name}.old."))
    aside = before / out.name
    try:
        if os.path.lexists(out):
            out.rename(aside)
        scratch.rename(out)
    except OSError as error:
        if aside.exists():
            aside.rename(out)
        raise HostError(f"{out}: can't be put there: {error.strerror}") from error
    finally:
        shutil.rmtree(before, ignore_errors=True)


def _store_all(
    sources: Sequence[Source], scratch: Path, copy: bool, on_bytes: Callable[[int], None]
) -> list[FileEntry]:
    names: dict[str, set[str]] = {}
    for source in sources:
        place = PurePosixPath(source.path)
        names.setdefault(str(place.parent), set()).add(place.name)
    entries = []
    for source in sources:
        parent = str(PurePosixPath(source.path).parent)
        role = role_of(source.path, source.file, is_cell_folder(frozenset(names[parent])))
        entries.append(_store(source, role, scratch, copy, on_bytes))
    return entries


def _store(
    source: Source, role: Role, scratch: Path, copy: bool, on_bytes: Callable[[int], None]
) -> FileEntry:
    """One file under its hash; the hash is of the bytes that are stored, whatever happens since."""
    handle, name = tempfile.mkstemp(dir=scratch, prefix="incoming.")
    os.close(handle)
    incoming = Path(name)
    linked = not copy and role in _LINKED and _link(source.file, incoming)
    digest, size = hashlib.sha256(), 0
    try:
        with (
            (incoming if linked else source.file).open("rb") as taken,
            nullcontext() if linked else incoming.open("wb") as stream,
        ):
            while block := taken.read(_BLOCK_BYTES):
                digest.update(block)
                size += len(block)
                if stream is not None:
                    stream.write(block)
                on_bytes(len(block))
        if not linked:
            incoming.chmod(0o644)
        incoming.replace(scratch / OBJECTS / digest.hexdigest())
    except OSError as error:
        raise HostError(f"{source.file}: can't be taken in: {error.strerror}") from error
    return FileEntry(path=source.path, role=role, sha256=f"sha256:{digest.hexdigest()}", bytes=size)


def _link(file: Path, incoming: Path) -> bool:
    """A second name for the bytes, where both lie on one file system that has such names."""
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
    shown = [str(problem) for problem in problems[:_SHOWN_PROBLEMS]]
    if len(problems) > len(shown):
        shown.append(f"and {len(problems) - len(shown)} more")
    text = "\n  ".join(["can't be made, since not every link holds:", *shown])
    return InputError(
        text, file=out, remedy="name the folders that hold what is missing, and make the rest anew"
    )
