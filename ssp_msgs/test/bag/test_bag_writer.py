"""The writer's dealings with files and disk: gathering, splitting, synchronising, failing."""

from __future__ import annotations

import errno
import os
import shutil
import threading
import time
from io import FileIO
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.metadata import ROOT_KEY
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing import mcap_output
from ssp_core.bag.writing import writer as bag_writer
from ssp_core.bag.writing.mcap_output import (
    CHUNK_BYTES,
    COPIED_BYTES,
    ChunkBuilder,
    DiskSync,
    write_buffers,
)
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import HostError, InputError
from tests.support.processes.waiting import DEADLINE_S

STRING = "std_msgs/msg/String"


@given(
    buffers=st.lists(st.binary(max_size=40), max_size=12),
    gathered=st.integers(1, 5),
    most=st.integers(1, 17),
)
def test_buffers_arrive_whole_however_little_the_system_takes(
    buffers: list[bytes], gathered: int, most: int
) -> None:
    taken = bytearray()

    def writev(descriptor: int, given: list[bytes]) -> int:
        assert descriptor == 7
        assert len(given) <= gathered
        part = b"".join(given)[:most]
        taken.extend(part)
        return len(part)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap_output.os, "writev", writev)
        write_buffers(7, buffers, gathered)
    assert taken == b"".join(buffers)


def test_a_disk_that_takes_nothing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_output.os, "writev", lambda *_: 0)
    with pytest.raises(OSError, match="took no byte"):
        write_buffers(7, [b"x"])


def test_a_large_message_is_not_copied_into_its_chunk() -> None:
    large, small = bytes(COPIED_BYTES + 1), bytes(COPIED_BYTES)
    builder = ChunkBuilder()
    builder.add(1, 0, 5, 5, small)
    builder.add(2, 0, 4, 4, large)
    builder.add(1, 0, 6, 6, small)
    chunk = builder.finish(0)
    assert sum(buffer is large for buffer in chunk.buffers) == 1
    assert len(chunk.buffers) == 5  # head, small with head, large, small, indexes
    assert chunk.length == sum(map(len, chunk.buffers))
    assert (chunk.chunk_index.message_start_time, chunk.chunk_index.message_end_time) == (4, 6)
    assert chunk.counts == {1: 2, 2: 1}
    assert builder.size == 0
    assert builder.times() is None


def test_a_chunk_ends_with_the_message_that_fills_it(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/x", STRING)
        before = writer.file.stat().st_size
        writer.write("/x", bytes(CHUNK_BYTES // 2), 0, 0)
        assert writer.file.stat().st_size == before
        writer.write("/x", bytes(100 * CHUNK_BYTES), 1, 1)
        assert writer.file.stat().st_size > 100 * CHUNK_BYTES
    with BagReader(tmp_path / "bag") as reader:
        assert [len(m.data) for m in reader.messages()] == [CHUNK_BYTES // 2, 100 * CHUNK_BYTES]


def test_times_beyond_64_bits_and_a_closed_writer_are_the_callers_fault(tmp_path: Path) -> None:
    for split in (None, Split(max_bytes=1024)):
        with BagWriter(tmp_path / f"bag{split is None}", split=split) as writer:
            writer.add_topic("/x", STRING, latched=True)
            for times in ((1 << 64, 0), (0, 1 << 64), (-1, 0)):
                with pytest.raises(ValueError, match="64 bits"):
                    writer.write("/x", b"", *times)
            writer.write("/x", b"", (1 << 64) - 1, 0)
        assert writer.messages == writer.facts().count == 1
        with pytest.raises(ValueError, match="is closed"):
            writer.write("/x", b"", 0, 0)


def test_a_split_by_size_keeps_every_file_below_it(tmp_path: Path) -> None:
    limit = 100_000
    with BagWriter(tmp_path / "bag", split=Split(max_bytes=limit)) as writer:
        writer.add_topic("/x", STRING)
        for k in range(100):
            writer.write("/x", bytes(9_000), k, k)
        assert len(writer.files) > 5
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())[ROOT_KEY]
    assert information["relative_file_paths"] == [file.name for file in writer.files]
    assert [entry["path"] for entry in information["files"]] == [f.name for f in writer.files]
    assert sum(entry["message_count"] for entry in information["files"]) == 100
    at = 0
    for entry, file in zip(information["files"], writer.files, strict=True):
        assert entry["starting_time"]["nanoseconds_since_epoch"] == at
        assert entry["duration"]["nanoseconds"] == entry["message_count"] - 1
        at += entry["message_count"]
        # Less the indexes, which only a closed file has.
        assert file.stat().st_size < limit + 5_000


def test_a_clock_that_jumps_begins_one_file_and_not_many(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", split=Split(max_s=10.0)) as writer:
        writer.add_topic("/x", STRING)
        for second in (1000, 1001, 1002, 500, 501, 502, 7000, 7001):
            writer.write("/x", bytes(400_000), second * 10**9, 0)
    assert [file.count for file in writer.facts().files] == [3, 3, 2]
    with BagReader(tmp_path / "bag") as reader:
        seconds = [m.log_time_ns // 10**9 for m in reader.messages()]
    assert seconds == [500, 501, 502, 1000, 1001, 1002, 7000, 7001]


def test_pages_of_a_fast_stream_are_given_back_when_they_are_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given_back: list[tuple[int, int]] = []
    monkeypatch.setattr(mcap_output, "GIVEN_BACK_BYTES", 1000)
    monkeypatch.setattr(
        mcap_output.os,
        "posix_fadvise",
        lambda _, start, length, advice: given_back.append((start, length)),
    )
    file, sync = (tmp_path / "x").open("wb", buffering=0), DiskSync()
    for size in (500, 2000, 999, 1000):
        file.write(bytes(size))
        sync.request("x", file.fileno())
        while sync.age_s:
            time.sleep(0.001)
    sync.finish()
    assert given_back == [(500, 2000), (3499, 1000)]
    file.close()


def test_a_folder_that_is_replaced_just_before_a_split_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = tmp_path / "bag"
    writer = BagWriter(bag, split=Split(max_s=1.0))
    writer.add_topic("/x", STRING)
    writer.write("/x", b"first", 0, 0)

    def replace_and_make(file: Path, mode: str) -> FileIO:
        bag.rename(tmp_path / "elsewhere")
        shutil.copytree(tmp_path / "elsewhere", bag)
        return FileIO(file, mode)

    monkeypatch.setattr(bag_writer, "FileIO", replace_and_make)
    with pytest.raises(HostError, match="it was replaced while it was being written"):
        writer.write("/x", b"second", 2 * 10**9, 0)
    assert [file.name for file in bag.iterdir()] == ["bag_0.mcap"]


@pytest.mark.parametrize("wrong", [{"max_bytes": 1023}, {"max_s": 0.0}, {"max_s": float("nan")}])
def test_a_split_that_holds_nothing_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Split(**wrong)  # type: ignore[arg-type]  # the field is chosen by name


def test_a_slow_disk_holds_up_nobody_and_waits_once_per_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    release, began, synced = threading.Event(), threading.Event(), []

    def fdatasync(descriptor: int) -> None:
        began.set()
        assert release.wait(600)
        synced.append(os.fstat(descriptor).st_ino)

    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.os.fdatasync", fdatasync)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/x", STRING)
        writer.flush()
        assert began.wait(600)
        for k in range(10):
            writer.write("/x", b"x", k, k)
            writer.flush()
        assert synced == []
        release.set()
    # The one that was running, and one for all that came meanwhile.
    assert synced == [writer.file.stat().st_ino] * 2


def test_a_sync_that_is_overdue_holds_up_the_next_flush_and_tells_its_age(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started, release = threading.Event(), threading.Event()
    real = os.fdatasync

    def fdatasync(descriptor: int) -> None:
        started.set()
        assert release.wait(600)
        real(descriptor)

    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.os.fdatasync", fdatasync)
    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.LONGEST_WAIT_S", 30.0)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/x", STRING)
        assert writer.sync_age_s == 0.0
        writer.write("/x", b"x", 0, 0)
        writer.flush()
        assert started.wait(600)
        assert writer.sync_age_s > 0.0
        monkeypatch.setattr("ssp_core.bag.writing.mcap_output.OVERDUE_S", 0.0)
        second = threading.Thread(target=writer.flush)
        second.start()
        second.join(0.2)
        assert second.is_alive()
        assert writer.sync_age_s > 0.2
        release.set()
        second.join(600)
        assert not second.is_alive()
        assert writer.sync_age_s == 0.0


def test_a_disk_that_stands_still_holds_up_a_flush_for_a_while_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    release = threading.Event()
    monkeypatch.setattr(
        "ssp_core.bag.writing.mcap_output.os.fdatasync",
        lambda _: release.wait(600) or pytest.fail("late"),
    )
    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.OVERDUE_S", 0.0)
    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.LONGEST_WAIT_S", 0.05)
    with BagWriter(tmp_path / "bag") as writer:
        writer.flush()
        writer.flush()
        assert writer.sync_age_s >= 0.1
        release.set()


def flush_on(writer: BagWriter) -> None:
    """Flushes until that fails: the thread notes its error right after it happened."""
    until = time.monotonic() + DEADLINE_S
    while time.monotonic() < until:
        writer.flush()


def test_an_error_of_the_disk_comes_with_one_of_the_next_flushes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fdatasync(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("ssp_core.bag.writing.mcap_output.os.fdatasync", fdatasync)
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/x", STRING)
    with pytest.raises(HostError, match=r"bag_0\.mcap: writing failed: Input/output error"):
        flush_on(writer)
    assert writer.closed
    writer.close()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_finished_sync_has_done_all_and_left_no_descriptor(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    sync = DiskSync()
    for k in range(5):
        with (tmp_path / str(k)).open("wb") as stream:
            stream.write(b"x")
            sync.request(str(k), stream.fileno())
    sync.finish()
    assert len(os.listdir("/proc/self/fd")) == before


def test_no_file_can_be_made_for_the_next_part(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", split=Split(max_bytes=1024))
    writer.add_topic("/x", STRING)
    writer.write("/x", bytes(600), 0, 0)
    (tmp_path / "bag" / "bag_1.mcap").write_bytes(b"another's")
    with pytest.raises(HostError, match=r"bag_1\.mcap: writing failed: File exists"):
        writer.write("/x", bytes(600), 1, 1)
    assert (tmp_path / "bag" / "bag_1.mcap").read_bytes() == b"another's"
    assert writer.messages == 1
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    recover(tmp_path / "bag", tmp_path / "recovered")
    with BagReader(tmp_path / "recovered") as reader:
        assert reader.count == 1
