"""Disks that are too small, or lose their power, for processes that see them alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ssp_core.host.children import die_with_parent

_HOLD = 'mount "$@" && echo mounted && exec cat'


@dataclass(frozen=True)
class Disk:
    """A folder with an end.

    Args:
        point: where the process finds it.
        seen: where this process finds it, while the block lasts.
        enter: to be put before the command of the process.
        is_mounted: a file system of its own; else a limit on each file of the process.
    """

    point: Path
    seen: Path
    enter: tuple[str, ...]
    is_mounted: bool


@cache
def may_mount() -> bool:
    """Tell whether this process may mount file systems, in a name space that ends with it."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "nsenter", "mount"))):
        return False
    command = ["unshare", "--mount", "mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", "/mnt"]
    return subprocess.run(command, capture_output=True).returncode == 0


@contextmanager
def mounted(point: Path, *arguments: str) -> Iterator[Disk]:
    """A file system in a mount name space that a helper process holds: when that process ends,
    and be it with this one, nothing of it is left.

    Args:
        point: folder, empty.
        arguments: of ``mount``, but for the folder.
    """
    holder = subprocess.Popen(
        ["unshare", "--mount", "sh", "-c", _HOLD, "hold", *arguments, str(point)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=die_with_parent,
    )
    try:
        if holder.stdout is None or holder.stdout.readline() != "mounted\n":
            raise RuntimeError(f"{' '.join(arguments)} can't be mounted on {point}")
        enter = ("nsenter", f"--mount=/proc/{holder.pid}/ns/mnt")
        yield Disk(point, Path(f"/proc/{holder.pid}/root{point}"), enter, True)
    finally:
        holder.kill()
        holder.communicate()


@contextmanager
def small_disk(folder: Path, size_bytes: int) -> Iterator[Disk]:
    """A disk with room for so many bytes. Without the right to mount, no file of the process may
    become larger; that is no full disk, but fails at the same place in the same manner."""
    point = folder / "disk"
    point.mkdir()
    if may_mount():
        with mounted(point, "-t", "tmpfs", "-o", f"size={size_bytes}", "tmpfs") as disk:
            yield disk
    else:
        limit = (
            "import os, resource, sys; "
            f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size_bytes}, {size_bytes})); "
            "os.execvp(sys.argv[1], sys.argv[1:])"
        )
        yield Disk(point, point, (sys.executable, "-c", limit), False)
