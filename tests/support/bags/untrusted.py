"""MCAP files that lie, and what it takes to read, check and recover one in a limited child."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.types import (
    definition,
)
from ssp_core.bag.writing.chain import record_bytes
from tests.support.bags.messages import STRING, text

SCHEMA = Schema(1, definition(STRING).text.encode(), "ros2msg", STRING)
CHANNEL = Channel(1, "/text", "cdr", {}, 1)
TEXT = text("text")
MESSAGE = record_bytes(Message(1, 0, TEXT, 0, 0))
ZEROS = bytes(1 << 20)


def file_bytes(data: Sequence[McapRecord | bytes], summary: Sequence[McapRecord] = ()) -> bytes:
    """A closed file of these records, whatever they claim; without CRCs."""
    head = MCAP0_MAGIC + record_bytes(Header("ros2", "hostile"))
    head += b"".join(d if isinstance(d, bytes) else record_bytes(d) for d in data)
    head += record_bytes(DataEnd(0))
    start = len(head) if summary else 0
    return head + record_bytes(*summary) + record_bytes(Footer(start, 0, 0)) + MCAP0_MAGIC


def file_of(record: Chunk, *, indexes: int = 1) -> bytes:
    """A closed file with one chunk, indexed once or more often."""
    names: list[McapRecord] = [SCHEMA, CHANNEL]
    offset = file_bytes([*names, record]).index(record_bytes(record))
    index = ChunkIndex(
        chunk_length=len(record_bytes(record)),
        chunk_start_offset=offset,
        compression=record.compression,
        compressed_size=len(record.data),
        message_end_time=record.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=record.message_start_time,
        uncompressed_size=record.uncompressed_size,
    )
    return file_bytes([*names, record], [*names, *[index] * indexes])


USE = """
import sys
from pathlib import Path
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.operations.check import check_bag
from ssp_core.errors import InputError
path = Path(sys.argv[1])
try:
    with BagReader(path) as reader:
        print("READ", sum(1 for _ in reader.messages()))
except InputError as error:
    print("READ", error)
print("CHECK", check_bag(path).problems)
try:
    report = recover(path, path.parent / "new")
    print("RECOVER", report.count, report.damage)
except InputError as error:
    print("RECOVER", error)
# Of this process alone: what getrusage says begins with the peak of the process that started it.
print("PEAK", open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
"""


class Used(NamedTuple):
    read: str
    checked: str
    recovered: str
    peak_mb: float


def use(path: Path) -> Used:
    """Reads, checks and recovers a bag in a child that has a minute and 4 GiB of addresses."""
    done = subprocess.run(
        [sys.executable, "-c", USE, path],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    read, checked, recovered, peak = done.stdout.splitlines()
    return Used(read, checked, recovered, int(peak.removeprefix("PEAK ")) / 1024)


def use_file(folder: Path, data: bytes) -> Used:
    (folder / "a.mcap").write_bytes(data)
    return use(folder / "a.mcap")
