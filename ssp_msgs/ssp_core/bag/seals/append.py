"""Puts a file into a bag that is closed and sealed."""

from __future__ import annotations

import io
import os
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.reading.mcap_file import (
    FOOTER,
    HEAD,
    McapFile,
    damage_of,
    open_bounded,
    read_body,
    read_frame,
)
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.chain import SEAL_NAME
from ssp_core.bag.writing.mcap_output import McapOutput
from ssp_core.errors import HostError, InputError, not_written


def sealed_end(bag: Path) -> str:
    """Return the digest that a closed bag's last seal states; empty where it has none.

    It is read from the bag, not computed.

    Args:
        bag: its folder.

    Raises:
        InputError: it is no closed bag, or is damaged.
    """
    with BagReader(bag) as reader:
        file = McapFile(reader.files[-1])
    return _stated_end(file)


def _stated_end(file: McapFile) -> str:
    places = [i for i in file.summary.metadata_indexes if i.name == SEAL_NAME]
    if not places:
        return ""
    last = max(places, key=lambda index: index.offset)
    with damage_of(file.path):
        record = file.read_at(last.offset, last.length)
        body = io.BytesIO(record[HEAD.size :])
        values = Metadata.read(ReadDataStream(body)).metadata
        return str(values["digest"])


def append_attachment(bag: Path, name: str, data: bytes, media_type: str) -> str:
    """Put a file into a closed and sealed bag, behind all that it holds, and seal it anew.

    The room for it is taken first: on a full disk the bag stays as it was. A host that fails
    meanwhile leaves a bag that isn't closed, with all that it held before.

    Args:
        bag: its folder.
        name: of the attachment; ``verdict.json``, say.
        data: content of the file.
        media_type: of the data, such as ``application/json``.

    Returns:
        The digest of the whole bag.

    Raises:
        InputError: it is no closed bag, is damaged, or isn't sealed.
        HostError: the disk doesn't take it.
    """
    with BagReader(bag) as reader:
        file = McapFile(reader.files[-1])
    end = _stated_end(file)
    if not end:
        raise InputError(
            "isn't sealed",
            file=file.path,
            remedy="give a bag that `ssp run` or the recorder closed",
        )
    data_end, crc = _data_end(file)
    try:
        output = McapOutput.reopen(file.path, file.summary, data_end, crc, bytes.fromhex(end))
    except OSError as error:
        raise HostError(f"{file.path}: can't be opened: {error.strerror}") from error
    size = file.path.stat().st_size
    try:
        # The summary grows by two entries and their names.
        needed = size + len(data) + 8 * (len(name) + len(media_type)) + 2048
        os.posix_fallocate(output.descriptor, 0, needed)
    except OSError as error:
        os.ftruncate(output.descriptor, size)
        output.close()
        raise not_written(file.path, error) from error
    try:
        output.attach(name, media_type, data, (output.times() or (0, 0))[1])
        output.finish()
        os.ftruncate(output.descriptor, os.lseek(output.descriptor, 0, os.SEEK_CUR))
        os.fsync(output.descriptor)
    except OSError as error:
        raise not_written(file.path, error) from error
    finally:
        output.close()
    return output.seal_end


def _data_end(file: McapFile) -> tuple[int, int]:
    """Find the record DataEnd, and the CRC that it states."""
    with open_bounded(file.path) as stream, damage_of(file.path):
        stream.seek(stream.size - FOOTER.size - len(MCAP0_MAGIC))
        _, _, start, _, _ = FOOTER.unpack(stream.read(FOOTER.size))
        frame = read_frame(stream, start - HEAD.size - 4)
        if frame.opcode != Opcode.DATA_END or frame.length != 4:
            raise ValueError("no end of the data before its summary")
        return frame.offset, int.from_bytes(read_body(stream, frame), "little")
