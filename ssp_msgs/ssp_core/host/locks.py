"""Locks between the commands of one host, those of all its users."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ssp_core.errors import HostError

# Of what all commands of this host share; the folder that TMPDIR names may be one command's own.
LOCKS = Path("/tmp")


def folder_of_locks(name: str, otherwise: str = "") -> Path:
    """Return a folder of locks of this host, made for all its users where there is none.

    Args:
        name: of the folder.
        otherwise: further remedy, at the end of the sentence.

    Raises:
        HostError: it can't be made.
    """
    folder = LOCKS / name
    try:
        _make_for_all(folder)
    except OSError as error:
        raise HostError(
            f"{folder}, which keeps commands of this host out of each other's way, can't be made: "
            f"{error.strerror}; make it a folder in which every user may make files{otherwise}"
        ) from error
    return folder


def _make_for_all(folder: Path) -> None:
    if not folder.is_dir():
        folder.mkdir(exist_ok=True)
        folder.chmod(0o1777)


def open_lock(path: Path) -> int:
    """Open a file for locking, also one that another user left: reading it is enough."""
    _make_for_all(path.parent)
    try:
        handle = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        handle = os.open(path, os.O_CREAT | os.O_RDONLY, 0o644)
    # A umask would keep other users out.
    if os.fstat(handle).st_uid == os.geteuid():
        os.fchmod(handle, 0o644)
    return handle


@contextmanager
def measuring_alone(say: Callable[[str], None]) -> Iterator[None]:
    """Keep other driven commands of this host waiting to the block's end, and wait for them.

    Args:
        say: takes a line for people where another command is waited for.

    Raises:
        HostError: the lock can't be opened.
    """
    path = _measuring_lock()
    try:
        lock = _open_pair(path)
    except OSError as error:
        raise HostError(
            f"{path}, the lock of commands that measure latencies, can't be opened: "
            f"{error.strerror}; make it a file that every user may read, in a folder in which "
            "every user may make one"
        ) from error
    words = (
        "another command drives, or measures latencies, on this host, and would disturb what this "
        f"one measures: it goes on when that has ended ({path} is the lock)"
    )
    with _held_in_turn(lock, fcntl.LOCK_EX, lambda: say(words)):
        yield


@contextmanager
def beside_measuring(say: Callable[[str], None]) -> Iterator[None]:
    """Wait while another command of this host measures latencies, and keep it waiting.

    Commands that measure none disturb each other in nothing that counts, and run side by side.
    Where the lock can't be opened, no command measures.

    Args:
        say: takes a line for people where another command is waited for.
    """
    path = _measuring_lock()
    try:
        lock = _open_pair(path)
    except OSError:
        yield
        return
    words = (
        "another command measures latencies on this host, and this one would disturb it: it goes "
        f"on when that has ended ({path} is the lock)"
    )
    with _held_in_turn(lock, fcntl.LOCK_SH, lambda: say(words)):
        yield


def _measuring_lock() -> Path:
    return LOCKS / "ssp-measuring" / "lock"


def _open_pair(path: Path) -> tuple[int, int]:
    """Open a lock, and the gate before it."""
    handle = open_lock(path)
    try:
        return handle, open_lock(path.with_name("gate"))
    except OSError:
        os.close(handle)
        raise


@contextmanager
def _held_in_turn(lock: tuple[int, int], kind: int, say: Callable[[], None]) -> Iterator[None]:
    """Hold a lock; ``say`` is called where it is waited for.

    Who waits for it keeps the gate shut, so that commands that share it don't go before one that
    wants it alone.
    """
    handle, gate = lock
    try:
        try:
            _lock_both(handle, kind | fcntl.LOCK_NB, gate, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say()
            _lock_both(handle, kind, gate, fcntl.LOCK_EX)
        finally:
            os.close(gate)
        yield
    finally:
        os.close(handle)


def _lock_both(handle: int, kind: int, gate: int, gate_kind: int) -> None:
    fcntl.flock(gate, gate_kind)
    fcntl.flock(handle, kind)
