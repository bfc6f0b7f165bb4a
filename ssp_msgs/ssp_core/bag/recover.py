"""Makes a closed, indexed bag of a recording that was cut off or is damaged in places."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag.salvage import MAX_DAMAGE, Salvage
from ssp_core.bag.writer import BagWriter
from ssp_core.errors import HostError, InputError
from ssp_core.files import make_folder

_MAX_NAME_BYTES = 240  # a file system takes 255, and the file inside is named <target>_0.mcap


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What recover kept of one or several files.

    Args:
        messages: kept, by topic.
        attachments: names of those kept.
        complete: every file was read up to its regular end, and nothing was damaged.
        bytes_read: up to where the files could be read.
        bytes_total: size of the files.
        damage: per place that could not be used, what was wrong there; of very many the first
            ones, and how many more there were.
    """

    messages: dict[str, int]
    attachments: tuple[str, ...]
    complete: bool
    bytes_read: int
    bytes_total: int
    damage: tuple[str, ...]

    @property
    def count(self) -> int:
        return sum(self.messages.values())


def source_files(source: Path) -> tuple[Path, ...]:
    """The MCAP files below a directory by name and number, or the file itself.

    Raises:
        InputError: there are none.
    """
    if source.is_dir():
        files = tuple(sorted(source.glob("*.mcap"), key=_place))
        if not files:
            raise InputError("has no .mcap file", file=source)
        return files
    if not source.exists():
        raise InputError("is not there", file=source)
    if not source.is_file():  # opening a pipe would wait for somebody to write into it
        raise InputError("is no file", file=source)
    return (source,)


def _place(file: Path) -> tuple[str, int, str]:
    """Where a file of a split bag stands: ``bag_10`` comes behind ``bag_9``."""
    stem, _, number = file.stem.rpartition("_")
    whole = number.isascii() and number.isdigit() and len(number) < 10
    return (stem, int(number), file.name) if whole else (file.stem, -1, file.name)


def recover(source: str | Path, target: str | Path) -> RecoverReport:
    """Copies every message that can be read into a new bag; the source stays as it is.

    A chunk counts only when its CRC is right, so nothing damaged gets into the new bag. Behind a
    damaged place the copy goes on at the next whole chunk. Latched messages that the files of a
    split bag repeat are written once. The target is whole or not there.

    Args:
        source: bag directory (with or without metadata.yaml) or .mcap file.
        target: directory of the new bag; must not exist.

    Raises:
        InputError: the source is no MCAP, or the target exists or can't be made.
        HostError: the disk doesn't take it.
    """
    source, target = Path(source), Path(target)
    files = source_files(source)
    if len(os.fsencode(target.name)) > _MAX_NAME_BYTES:
        raise InputError(
            f"has a name of more than {_MAX_NAME_BYTES} bytes", file=target, remedy="shorten it"
        )
    if os.path.lexists(target):
        raise InputError("exists already", file=target, remedy="name a new directory")
    make_folder(target.parent)
    try:
        scratch = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name[:100]}."))
    except OSError as error:
        raise InputError(f"can't be made: {error.strerror or error}", file=target) from error
    try:
        with BagWriter(scratch / "bag", name=f"{target.name}_0") as writer:
            salvage = Salvage(writer)
            for file in files:
                salvage.file(file)
        (scratch / "bag").rename(target)
    except OSError as error:
        raise HostError(f"{target}: can't be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    more = salvage.places - MAX_DAMAGE
    return RecoverReport(
        messages=dict(salvage.messages),
        attachments=tuple(salvage.attachments),
        complete=not salvage.places,
        bytes_read=salvage.bytes_read,
        bytes_total=salvage.bytes_total,
        damage=(*salvage.damage, *([f"and {more} more places"] if more > 0 else [])),
    )
