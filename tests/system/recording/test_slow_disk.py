"""A disk that doesn't keep up: memory is bounded, and what is dropped is what was stated."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing import mcap_output
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Importance, Profile, TopicSpec, importance
from tests.support.processes.waiting import DEADLINE_S

from .checks import held
from .load import IMAGE, TEXT, LoadTopic, encode

FRAMES = LoadTopic("/ssp/camera", size_bytes=500_000)
OTHERS = LoadTopic("/other/camera", size_bytes=500_000)
EVENTS = LoadTopic("/ssp/notes", size_bytes=300, msgtype=TEXT)
SPECS = (
    TopicSpec(FRAMES.name, IMAGE, Profile.SENSOR),
    TopicSpec(OTHERS.name, IMAGE, Profile.ADAPTED),
    TopicSpec(EVENTS.name, TEXT, Profile.STATE),
)
QUEUE_BYTES = 40 << 20
# Of the disk, in the time in which each camera gives a frame of 500 kB.
ROUND_BYTES = 600_000


class SlowDisk:
    """Takes so many bytes a round, however long a round lasts on this machine.

    Args:
        write: what writes.
    """

    def __init__(self, write: Callable[..., None]) -> None:
        self._write = write
        self._left = ROUND_BYTES
        self._more = threading.Condition()

    def write_buffers(self, descriptor: int, buffers: Sequence[bytes], *rest: int) -> None:
        self._write(descriptor, buffers, *rest)
        with self._more:
            self._left -= sum(map(len, buffers))
            self._more.notify_all()
            self._more.wait_for(lambda: self._left >= 0)

    def give(self, size: int) -> None:
        with self._more:
            self._left += size
            self._more.notify_all()

    def wait_until_spent(self) -> None:
        """Wait until what was given is written, and the writer waits for more."""
        with self._more:
            spent = self._more.wait_for(lambda: self._left < 0, DEADLINE_S)
        assert spent, "the recorder doesn't write what it was handed"


def test_the_least_important_is_dropped_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than the disk takes, and one of the two cameras is the run's own."""
    disk = SlowDisk(mcap_output.write_buffers)
    monkeypatch.setattr(mcap_output, "write_buffers", disk.write_buffers)
    # The disk of this machine has no part in it.
    monkeypatch.setattr(mcap_output.os, "fdatasync", lambda _: None)
    assert importance(SPECS[1]) < importance(SPECS[0]) < importance(SPECS[2]) <= Importance.EVENT
    recorder = Recorder(tmp_path / "bag", (SPECS[0], SPECS[2]), queue_bytes=QUEUE_BYTES)
    recorder.add(SPECS[1], offered="", latched=False)
    put: Counter[str] = Counter()
    most_waiting = 0
    # The run's own camera alone would fit.
    for k in range(150):
        for topic in (FRAMES, OTHERS, EVENTS):
            put[topic.name] += 1
            recorder.put_all([BagMessage(topic.name, k, k, encode(topic, k, 0), k)])
        most_waiting = max(most_waiting, recorder.state().queue_bytes)
        disk.wait_until_spent()
        disk.give(ROUND_BYTES)
    disk.give(1 << 30)
    state = recorder.stop()

    assert state.failure is None
    assert 0.5 * QUEUE_BYTES < most_waiting <= QUEUE_BYTES
    dropped = recorder.dropped_by_topic
    assert set(dropped) == {OTHERS.name}
    assert state.dropped == dropped.total()
    assert state.messages == put.total() - state.dropped
    assert check_bag(tmp_path / "bag").problems == ()
    found = held(tmp_path / "bag", (FRAMES, OTHERS, EVENTS))
    assert [m.number for m in found[FRAMES.name]] == list(range(150))
    assert [m.number for m in found[EVENTS.name]] == list(range(150))
    numbers = [m.number for m in found[OTHERS.name]]
    assert len(numbers) == put[OTHERS.name] - dropped[OTHERS.name]
    assert numbers == sorted(set(numbers))
