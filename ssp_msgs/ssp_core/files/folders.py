"""Folders: made, taken by one command, replaced and removed as a whole."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ssp_core.errors import SYSTEM_REMEDIES, HostError, InputError, not_written


def make_folder(path: str | Path) -> Path:
    """Return the folder, made with its parents where it isn't there yet, and writable.

    Raises:
        InputError: it or a parent is a file, or permission is missing.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        there = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
        why = error.strerror if there.is_dir() else f"{there} is no folder"
        remedy = SYSTEM_REMEDIES.get(error.errno or 0, "name another folder")
        raise InputError(f"can't be made: {why}", file=path, remedy=remedy) from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError("can't be written to", file=path, remedy="name another folder")
    return path


def check_folder(path: str | Path, remedy: str) -> None:
    """Refuse what is no folder.

    Raises:
        InputError: it isn't there, or is a file.
    """
    if not os.path.isdir(path):
        problem = "is no folder" if os.path.lexists(path) else "is not there"
        raise InputError(problem, file=path, remedy=remedy)


# In a folder that a command writes into, until it has ended.
TAKEN_FILE = ".ssp-taken"


@contextmanager
def taken_folder(path: str | Path, *, empty: bool = False) -> Iterator[Path]:
    """Make a folder and keep it from other commands until the end of the block.

    A file that is created exclusively says that it is taken. One whose writer died is taken over.

    Args:
        path: of the folder.
        empty: what holds anything is refused.

    Raises:
        InputError: another command writes into it, it holds something, or it can't be made.
    """
    is_new = not Path(path).exists()
    folder = make_folder(path)
    file = folder / TAKEN_FILE
    handle = _created_alone(file)
    try:
        if empty and any(entry.name != TAKEN_FILE for entry in folder.iterdir()):
            raise InputError("is not empty", file=folder, remedy="name a new folder")
        yield folder
    finally:
        with suppress(OSError):
            file.unlink()
            if is_new:  # a command that fails before it writes leaves nothing
                folder.rmdir()
        os.close(handle)


def _created_alone(file: Path) -> int:
    """Create a file that isn't there, and lock it for as long as this process lives.

    Raises:
        InputError: another process has, or it can't be made.
    """
    while True:
        try:
            handle = os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            if _is_left_behind(file):
                continue
            raise InputError(
                "is in use: another command is writing into it",
                file=file.parent,
                remedy=f"wait until that has ended, or name another folder ({file.name} says so)",
            ) from None
        except OSError as error:
            raise InputError(
                f"can't be written to: {error.strerror}",
                file=file.parent,
                remedy="get permission, or name another folder",
            ) from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:  # somebody takes it for one that was left behind
            os.close(handle)
            continue
        except OSError:  # some network file systems have no locks
            return handle
        if _is_still(file, handle):
            return handle
        os.close(handle)


def _is_left_behind(file: Path) -> bool:
    """Tell whether the process that created a file is gone; the file is removed then."""
    try:
        handle = os.open(file, os.O_WRONLY)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_still(file, handle):
            file.unlink()
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


def _is_still(file: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.stat(file), os.fstat(handle))
    except FileNotFoundError:
        return False


def remove_folder(folder: Path) -> None:
    """Remove a folder, if it is there, so that no part of it is ever found without the others.

    Raises:
        HostError: it can't be moved.
    """
    try:
        aside = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", dir=folder.parent))
    except FileNotFoundError:
        return
    except OSError as error:
        raise HostError(f"{folder} can't be removed: {error.strerror}") from error
    try:
        folder.rename(aside)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise HostError(f"{folder} can't be removed: {error.strerror}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def scratch_beside(target: Path) -> Path:
    """Make a hidden folder beside a target that is made in it and then renamed.

    Raises:
        InputError: it can't be made, or no file can have the target's name.
    """
    parent = make_folder(target.absolute().parent)
    try:
        with suppress(FileNotFoundError):
            os.lstat(target)
        return Path(tempfile.mkdtemp(dir=parent, prefix=f".{target.name[:50]}."))
    except OSError as error:
        remedy = SYSTEM_REMEDIES.get(error.errno or 0, "name another folder")
        raise InputError(
            f"can't be made: {error.strerror or error}", file=target, remedy=remedy
        ) from error


@contextmanager
def new_folder(target: Path, remedy: str = "name a new directory") -> Iterator[Path]:
    """Yield a path at which a folder is made; it becomes the target, or there is none.

    Raises:
        InputError: the target exists or can't be made.
        HostError: the disk doesn't take it.
    """
    if os.path.lexists(target):
        raise InputError("exists already", file=target, remedy=remedy)
    scratch = scratch_beside(target)
    try:
        yield scratch / "new"
        (scratch / "new").rename(target)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):  # made in the meantime
            raise InputError("exists already", file=target, remedy=remedy) from error
        raise not_written(target, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def put_in_place(folder: Path, target: Path) -> None:
    """Rename a finished folder to its place; an earlier one there goes once the new one stands.

    Raises:
        HostError: the system doesn't let it, such as where the target is a mount; the earlier
            folder is there as it was.
    """
    aside = scratch_beside(target)
    old = aside / "old"
    try:
        if os.path.lexists(target):
            target.rename(old)
        folder.rename(target)
    except BaseException as error:
        if os.path.lexists(old):
            old.rename(target)
        if isinstance(error, OSError):
            raise not_written(target, error) from error
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def new_files(folder: Path) -> Iterator[Path]:
    """Yield a folder for files that belong together; at the end they go to ``folder``, or none do.

    Files of the same names that are there are replaced.

    Raises:
        InputError: the folder can't be made.
        HostError: the disk doesn't take them.
    """
    is_new = not folder.exists()
    make_folder(folder)
    try:
        scratch = Path(tempfile.mkdtemp(dir=folder, prefix=".new."))
    except OSError as error:
        raise not_written(folder, error) from error
    try:
        yield scratch
        for file in sorted(scratch.iterdir()):
            file.replace(folder / file.name)
    except HostError as error:  # names a file by the place that it was to have
        raise HostError(str(error).replace(str(scratch), str(folder))) from error
    except OSError as error:
        raise not_written(folder, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # it holds something: a file was put there
                folder.rmdir()
