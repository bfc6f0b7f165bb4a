"""A disk that is nearly full ends a recording in good order; one that is full ends it at once."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from tests.support.processes.waiting import DEADLINE_S, until

from .checks import kept_until_ns, missing
from .conftest import Field
from .disks import Disk, may_mount, small_disk
from .load import LoadTopic

pytestmark = [pytest.mark.ros, pytest.mark.system]
TOPICS = (
    LoadTopic("/load/state", rate_hz=100),
    LoadTopic("/load/frame", rate_hz=20, size_bytes=50_000),
)
NAMES = [topic.name for topic in TOPICS]
DISK_BYTES = 60 << 20
FILE_BYTES = 3_000_000
# What a run asks for before it starts, and more.
SESSION_BYTES = 700 << 20


def test_a_disk_that_is_nearly_full_ends_it_before_anything_is_lost(
    field_: Field, tmp_path: Path
) -> None:
    """Here by the time that is left at 1 MB/s; a limit on files can't be seen coming."""
    load = field_.load(*TOPICS)
    with small_disk(tmp_path, 15 << 20) as disk:
        reserve = "0" if disk.is_mounted else "100000000"  # no machine has 100 TB to spare
        recording = field_.record(*NAMES, "--reserve-mb", reserve, "--json", disk=disk)
        assert recording.wait() == 1
        sent = load.stop()
        result = json.loads(recording.out)
        assert result["ended"].startswith("the disk ")
        assert (result["lost"], result["problems"]) == (0, [])
        assert check_bag(recording.bag).problems == ()
        assert missing(recording.bag, TOPICS, sent, until_ns=0) == []
        with BagReader(recording.bag) as reader:
            assert reader.count == result["messages"] > 0
            report = json.loads(reader.attachment("recording.json") or b"")
        assert report["written"] == report["received"] == result["messages"]


def test_a_full_disk_is_said_at_once_and_costs_at_most_a_second(
    field_: Field, tmp_path: Path
) -> None:
    """Somebody else fills the disk between two looks of the recorder, who had 30 s left."""
    load = field_.load(*TOPICS)
    with small_disk(tmp_path, DISK_BYTES if may_mount() else FILE_BYTES) as disk:
        recording = field_.record(*NAMES, "--reserve-mb", "0", "--json", disk=disk)
        until(lambda: recording.size() > FILE_BYTES // 2, "data")
        full_ns = time.monotonic_ns()
        if disk.is_mounted:
            fill(disk)
        else:
            until(lambda: recording.size() >= FILE_BYTES, "a file at its limit")
            full_ns = time.monotonic_ns()
        assert recording.wait() == 1
        sent = load.stop()
        result = json.loads(recording.out)
        assert "writing failed" in result["ended"] or "the disk has" in result["ended"]
        assert "writing failed" in result["problems"][0]
        assert not (recording.bag / "metadata.yaml").exists()
        recover(recording.bag, tmp_path / "recovered")
    assert check_bag(tmp_path / "recovered").problems == ()
    assert missing(tmp_path / "recovered", TOPICS, sent, kept_until_ns(sent, full_ns)) == []
    with BagReader(tmp_path / "recovered") as reader:
        assert 0 < reader.count <= result["messages"]


@pytest.mark.skipif(not may_mount(), reason="may not mount a small disk")
def test_a_session_on_a_full_disk_says_its_verdict_and_how_the_bag_is_closed(
    long_session: Any, tmp_path: Path
) -> None:
    with small_disk(tmp_path, SESSION_BYTES) as disk:
        run = disk.point / "run"
        session = long_session("--no-camera", folder=run, enter=disk.enter)
        # On a busy machine it may take longer to fill the disk than the session lasts.
        session.kill(names.SIL_WORLD, signal.SIGSTOP)
        fill(disk)
        session.kill(names.SIL_WORLD, signal.SIGCONT)
        out, err = session.process.communicate(timeout=DEADLINE_S)
        assert session.process.returncode == 1
        assert "cut_in on boulevard: invalid_harness, " in out
        assert "because the bag isn't closed: " in out
        assert "Traceback" not in err
        assert f"error: {run / 'result.json'}: can't be written: No space left on device" in err
        # Nothing half-written, and what it says to do does it.
        left = {file.name for file in (disk.seen / "run").iterdir()}
        assert left == {"bag.unfinished", "logs", "run.yaml", "task"}
        (command,) = re.findall(r"close it with `ssp (.*)`", err)
        (disk.seen / "somebody_elses").unlink()
        for words in (command.split(), ["bag", "check", str(run / "bag")]):
            done = [*disk.enter, sys.executable, "-m", "ssp_core.cli", *words]
            subprocess.run(done, check=True, capture_output=True)


def fill(disk: Disk) -> None:
    block = bytes(1 << 16)
    with (disk.seen / "somebody_elses").open("wb", buffering=0) as stream:
        free = os.statvfs(disk.seen)
        try:
            # At once, since a session doesn't wait for it; then what is left.
            os.posix_fallocate(stream.fileno(), 0, free.f_bavail * free.f_frsize * 9 // 10)
            stream.seek(0, os.SEEK_END)
            while True:
                stream.write(block)
        except OSError:
            return
