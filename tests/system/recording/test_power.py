"""Power loss costs at most one second of a recording.

Where file systems may be mounted, the recorder writes onto one in a file, and the power is cut by
copying that file: the copy has what reached the disk until then, and nothing of what the system
only holds in memory. Elsewhere the requests to the disk are counted. Neither covers a disk that
says that it has what is still in its own memory.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing import mcap_output
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Profile, TopicSpec
from tests.support.processes.waiting import until

from .checks import LATE_FACTOR, kept_until_ns, missing
from .conftest import Field
from .disks import may_mount, mounted
from .load import IMAGE, LoadTopic, encode

TOPICS = (
    LoadTopic("/load/state", rate_hz=200),
    LoadTopic("/load/frame", rate_hz=20, size_bytes=60_000),
)


@pytest.mark.ros
@pytest.mark.system
def test_power_loss_costs_at_most_a_second(
    field_: Field, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if may_mount() and Path("/dev/loop-control").exists() and shutil.which("mkfs.ext4"):
        _cut_the_power(field_, tmp_path)
    else:
        _count_requests(tmp_path, monkeypatch)


class SyncWatch:
    """Measures how long the disk under a folder takes for a request, again and again."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "sync_watch"
        self._taken: list[tuple[int, int]] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._measure)

    def __enter__(self) -> SyncWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _measure(self) -> None:
        with self._file.open("wb", buffering=0) as stream:
            while not self._over.wait(0.02):
                began_ns = time.monotonic_ns()
                stream.write(b"x")
                os.fdatasync(stream.fileno())
                self._taken.append((began_ns, time.monotonic_ns()))

    def longest_ns(self, until_ns: int) -> int:
        """Return the longest one up to a time, once the block is left."""
        return max((min(b, until_ns) - a for a, b in self._taken if a < until_ns), default=0)


def _cut_the_power(field_: Field, folder: Path) -> None:
    image, later = folder / "disk.img", folder / "later.img"
    for name in ("disk", "later"):
        (folder / name).mkdir()
    with image.open("wb") as stream:
        stream.truncate(128 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-F", str(image)], check=True)
    load = field_.load(*TOPICS)
    # Beside the image, and not in it: a request of ours there would write the recorder's data, too.
    with mounted(folder / "disk", "-o", "loop", str(image)) as disk, SyncWatch(folder) as watch:
        recording = field_.record(
            *(t.name for t in TOPICS), "--split-mb", "2", "--reserve-mb", "0", disk=disk
        )
        until(lambda: recording.size() > 3_000_000, "data in two files")
        recording.process.send_signal(signal.SIGSTOP)
        cut_ns = time.monotonic_ns()
        shutil.copyfile(image, later)
        recording.kill()
    sent = load.stop()
    with mounted(folder / "later", "-o", "loop", str(later)) as disk:
        recover(disk.seen / "bag", folder / "recovered")
    assert check_bag(folder / "recovered").problems == ()
    # A request that is made while another one runs waits for that one.
    until_ns = kept_until_ns(sent, cut_ns) - LATE_FACTOR * watch.longest_ns(cut_ns)
    assert missing(folder / "recovered", TOPICS, sent, until_ns) == []


def _count_requests(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    requests: list[tuple[float, int]] = []

    # The next request follows at once, however busy this machine's disk is.
    def noted(descriptor: int) -> None:
        requests.append((time.monotonic(), os.fstat(descriptor).st_size))

    monkeypatch.setattr(mcap_output.os, "fdatasync", noted)
    topic = LoadTopic("/load/state", size_bytes=2_000)
    recorder = Recorder(folder / "bag", [TopicSpec(topic.name, IMAGE, Profile.STATE)])
    put: list[tuple[float, int]] = []
    total = 0
    until = time.monotonic() + 3.0
    while time.monotonic() < until:
        data = encode(topic, len(put), 0)
        total += len(data)
        put.append((time.monotonic(), total))
        recorder.put_all([BagMessage(topic.name, len(put), len(put), data)])
        time.sleep(0.005)
    recorder.stop()
    late_s = LATE_FACTOR * max(b[0] - a[0] for a, b in pairwise(put))
    # What came last is written by closing, which waits for the disk.
    for at, size in (entry for entry in put if entry[0] < until - 1.0):
        asked = [when for when, held in requests if held >= size]
        assert asked
        assert asked[0] < at + 1.0 + late_s


def test_requests_to_the_disk_come_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _count_requests(tmp_path, monkeypatch)
