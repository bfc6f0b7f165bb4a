"""Bag writer against a plain write of the same bytes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from measure import report

from ssp_core.bag import BagWriter

SIZES = (("states of 400 B", 400, 60_000), ("frames of 90 kB", 90_000, 3_000))
ROUNDS = 3


def payloads(size: int, count: int) -> Iterator[bytes]:
    """Distinct CDR-like payloads without paying for their making in the loop."""
    block = os.urandom(size + 256)
    for k in range(count):
        yield b"\x00\x01\x00\x00" + block[k % 256 : k % 256 + size - 4]


def write_bag(folder: Path, size: int, count: int) -> float:
    started = time.perf_counter()
    with BagWriter(folder) as writer:
        writer.add_topic("/ssp/x", "std_msgs/msg/String")
        for k, data in enumerate(payloads(size, count)):
            writer.write("/ssp/x", data, k * 1000, k * 1000)
    return time.perf_counter() - started


def write_plain(path: Path, size: int, count: int) -> float:
    started = time.perf_counter()
    with path.open("wb") as stream:
        for data in payloads(size, count):
            stream.write(data)
    return time.perf_counter() - started


def main() -> None:
    for name, size, count in SIZES:
        ours, bound = [], []
        for k in range(ROUNDS):
            with tempfile.TemporaryDirectory() as folder:
                bound.append(write_plain(Path(folder) / f"plain{k}", size, count))
                ours.append(write_bag(Path(folder) / f"bag{k}", size, count))
        report(
            f"recorder: {name}",
            count / min(ours),
            count / min(bound),
            "messages/s",
            f"{count} messages, best of {ROUNDS}",
            lower=False,
        )


if __name__ == "__main__":
    main()
