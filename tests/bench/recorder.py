"""Bag writers alone: ours, rosbags', the mcap package's, and a plain write of the same bytes.

Our writer seals what it writes, so the limit holds beside rosbags with a SHA-256 of the same
messages, as far as the seal covers them. Run by hand with --turns N for more turns.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from measure import LONG, report
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from ssp_core.bag.types import definition, typestore
from ssp_core.bag.writing.chain import LARGE_BYTES
from ssp_core.bag.writing.writer import BagWriter

TYPE = "std_msgs/msg/String"
SIZES = (
    ("states of 400 B", 400, 60_000),
    ("frames of 90 kB", 90_000, 3_000),
    ("raw images of 2.7 MB", 2_700_000, 100),
)
TURNS = 5 if LONG else 3


def payloads(size: int, count: int) -> Iterator[bytes]:
    """CDR-like messages, not all the same, without paying for their making in the loop."""
    block = os.urandom(size + 32)
    some = [b"\x00\x01\x00\x00" + block[k : k + size - 4] for k in range(32)]
    for k in range(count):
        yield some[k % 32]


def ours(path: Path, messages: Iterator[bytes]) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/ssp/x", TYPE)
        for k, data in enumerate(messages):
            writer.write("/ssp/x", data, k * 1000, k * 1000)


def rosbags(path: Path, messages: Iterator[bytes]) -> None:
    with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/ssp/x", TYPE, typestore=typestore())
        for k, data in enumerate(messages):
            writer.write(connection, k * 1000, data)
    synchronise(path / f"{path.name}.mcap")


def sealed(messages: Iterator[bytes]) -> Iterator[bytes]:
    """Hash the messages that the seal of a bag covers."""
    digest = hashlib.sha256()
    for data in messages:
        if len(data) <= LARGE_BYTES:
            digest.update(data)
        yield data


def mcap(path: Path, messages: Iterator[bytes]) -> None:
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start(profile="ros2")
        schema = writer.register_schema(TYPE, "ros2msg", definition(TYPE).text.encode())
        channel = writer.register_channel("/ssp/x", "cdr", schema)
        for k, data in enumerate(messages):
            writer.add_message(channel, k * 1000, data, k * 1000)
        writer.finish()
    synchronise(path)


def plain(path: Path, messages: Iterator[bytes]) -> None:
    with path.open("wb", buffering=1 << 20) as stream:
        for data in messages:
            stream.write(data)
    synchronise(path)


def synchronise(path: Path) -> None:
    """Our writer's close waits for the disk, so the others' time holds that too."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


WRITERS: dict[str, Callable[[Path, Iterator[bytes]], None]] = {
    "ours": ours,
    "rosbags": rosbags,
    "rosbags with SHA-256": lambda path, messages: rosbags(path, sealed(messages)),
    "mcap": mcap,
    "plain": plain,
}


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one turn: time on the wall, and of the processor in program and system, in s."""

    wall_s: float
    cpu_s: float


def cost(write: Callable[[Path, Iterator[bytes]], None], size: int, count: int) -> Cost:
    messages = payloads(size, count)
    next(messages)  # makes them
    with tempfile.TemporaryDirectory() as folder:
        started, processor = time.perf_counter(), time.process_time()
        write(Path(folder) / "bag", messages)
        return Cost(time.perf_counter() - started, time.process_time() - processor)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--turns", type=int, default=TURNS)
    turns = parser.parse_args().turns
    for name, size, count in SIZES:
        costs: dict[str, list[Cost]] = {writer: [] for writer in WRITERS}
        for _ in range(turns):
            for writer, write in WRITERS.items():
                costs[writer].append(cost(write, size, count))
        cpu_s = {writer: min(c.cpu_s for c in found) for writer, found in costs.items()}
        wall_s = {writer: min(c.wall_s for c in found) for writer, found in costs.items()}
        note = f"{count} messages, fsync included, best of {turns}"
        for other in ("rosbags", "rosbags with SHA-256", "mcap", "plain"):
            report(
                f"recorder: {name}, processor / {other}",
                cpu_s["ours"] / count * 1e6,
                cpu_s[other] / count * 1e6,
                "us a message",
                note,
                lower=True,
                ratio_limit=1.1 if other == "rosbags with SHA-256" else None,
            )
        report(
            f"recorder: {name}, throughput / rosbags",
            count / wall_s["ours"],
            count / wall_s["rosbags"],
            "messages/s",
            note,
            lower=False,
        )


if __name__ == "__main__":
    main()
