"""/dev/shm, over which nodes of one host talk: whether they can, and what dead ones left there."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ssp_core.errors import HostError
from ssp_core.host.ports import domain_of_port, domain_ports

_SHM = Path("/dev/shm")
# A port, its mutex or the lock of who reads it; a participant that has just begun may have no lock.
_PORT = re.compile(r"(?:sem\.)?fastrtps_port(\d+)(?:_mutex|_el|_sl)?")
_NEW_S = 10.0
_MIN_FREE_BYTES = 512 << 20


def check_shared_memory() -> None:
    """Refuse a /dev/shm in which nodes can't talk; without one they do it over UDP.

    Raises:
        HostError: it can't be written to.
    """
    if _SHM.is_dir() and not os.access(_SHM, os.W_OK | os.X_OK):
        raise HostError(
            f"{_SHM} must be writable, nodes on one host talk through it; mount it so "
            "(`mount -o remount,rw /dev/shm`, in Docker `--tmpfs /dev/shm`), or use --in-process"
        )


def has_room() -> bool:
    """Tell whether the large segments of the shipped profiles fit in."""
    return _SHM.is_dir() and shutil.disk_usage(_SHM).free > _MIN_FREE_BYTES


def remove_shared_ports(domain_id: int) -> None:
    """Remove what killed participants of a domain leave of their ports in /dev/shm.

    Only for a domain that the caller holds and in which nothing runs any more.
    """
    for port in domain_ports(domain_id):
        for name in (f"fastrtps_port{port}", f"sem.fastrtps_port{port}_mutex"):
            (_SHM / name).unlink(missing_ok=True)


def remove_dead_ports(domain_id: int) -> None:
    """Remove what killed participants of a domain left, new or not, unless one of them lives.

    A port that its owner left in the middle of a change keeps each participant that comes next
    waiting for seconds. Only for a domain that the caller holds: no other has begun there.
    """
    left = [
        file
        for file in _SHM.glob("*fastrtps_port*")
        if (port := _PORT.fullmatch(file.name)) and domain_of_port(int(port[1])) == domain_id
    ]
    _remove_dead_ports(left, is_held=True)


def remove_stale_shared_memory() -> int:
    """Remove what dead participants left of Fast DDS in /dev/shm; return how many segments.

    Each segment has a lock file (``…_el``) that its owner holds locked while it lives, as
    ``fastdds shm clean`` knows too. So have the ports at which it listens (``…_el``, ``…_sl``), but
    not those that it only wrote to: a port goes when no process locks one in its domain and nothing
    in there is new. Neither does a new segment go: its owner makes the lock file, then locks it.
    What is another user's is left alone.
    """
    removed = 0
    for lock in _SHM.glob("fastrtps_*_el"):
        if _PORT.fullmatch(lock.name):
            continue
        with suppress(FileNotFoundError), _locked(lock) as is_free:
            if is_free and not _is_new([lock]):
                (_SHM / lock.name.removesuffix("_el")).unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
                removed += 1
    domains: dict[int, list[Path]] = {}
    for file in _SHM.glob("*fastrtps_port*"):
        if match := _PORT.fullmatch(file.name):
            domains.setdefault(domain_of_port(int(match[1])), []).append(file)
    for files in domains.values():
        _remove_dead_ports(files)
    return removed


def shared_ports() -> set[int]:
    """Return the ports in /dev/shm at which a participant listens, wherever its network is."""
    ports = set()
    for file in _SHM.glob("fastrtps_port*_[es]l"):
        with _locked(file) as is_free:
            if (port := _PORT.fullmatch(file.name)) and not is_free:
                ports.add(int(port[1]))
    return ports


def _remove_dead_ports(files: Sequence[Path], *, is_held: bool = False) -> None:
    """Remove all ports of a domain, unless one is locked, another user's, or new and not held.

    The locks are held meanwhile: who comes just now and finds its lock taken or gone tries again.
    """
    with ExitStack() as stack, suppress(OSError):
        locks = [file for file in files if file.name.endswith(("_el", "_sl"))]
        for lock in locks:
            if not stack.enter_context(_locked(lock)):
                return
        owners = {file.stat().st_uid for file in files}
        if (is_held or not _is_new(files)) and owners == {os.geteuid()}:
            for file in files:
                file.unlink(missing_ok=True)


def _is_new(files: Sequence[Path]) -> bool:
    return time.time() - max(file.stat().st_mtime for file in files) <= _NEW_S


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Lock a segment's file: False where its owner lives, or where it is gone."""
    try:
        handle = os.open(path, os.O_RDWR)
    except OSError:
        yield False
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = True
        except OSError:
            is_free = False
        yield is_free
    finally:
        os.close(handle)
