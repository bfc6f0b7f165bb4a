"""A clock that jumps by an hour, back and forth: nothing is lost, and the bag stays readable.

The machine's own clock isn't touched. Its jumps reach a recorder as times of reception; those of
other hosts and of a simulation as stamps of messages. Both come in here as they would there.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from mcap.reader import NonSeekingReader
from rosbags.highlevel import AnyReader

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.split import Split
from ssp_monitor.recorder.losses import SimulatedTime, stamp_at
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Profile, TopicSpec

from .checks import held
from .load import IMAGE, LoadTopic, encode

TOPIC = LoadTopic("/load/frame", size_bytes=5_000)
SPEC = TopicSpec(TOPIC.name, IMAGE, Profile.SENSOR)
HOUR_NS = 3_600 * 10**9
START_NS = 1_700_000_000 * 10**9
STEP_NS = 10_000_000
COUNT = 400
JUMPS = {
    "back": lambda k: -HOUR_NS * (k >= COUNT // 2),
    "forth": lambda k: HOUR_NS * (k >= COUNT // 2),
    "back and forth": lambda k: (0, -HOUR_NS, HOUR_NS)[k * 3 // COUNT],
    "to and fro": lambda k: HOUR_NS * (k % 2),
}


def record(bag: Path, times: list[int], split: Split | None) -> None:
    recorder = Recorder(bag, [SPEC], split=split)
    for k, (time_ns, data) in enumerate(zip(times, messages(times), strict=True)):
        recorder.put_all([BagMessage(TOPIC.name, time_ns, time_ns, data, k)])
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (COUNT, 0, None)


def messages(times: list[int]) -> list[bytes]:
    return [encode(TOPIC, k, time_ns) for k, time_ns in enumerate(times)]


def stored_order(bag: Path) -> list[int]:
    """Numbers of the messages as they stand in the files, one after the other."""
    numbers = []
    with BagReader(bag) as reader:
        files = reader.files
    for file in files:
        with file.open("rb") as stream:
            found = NonSeekingReader(stream).iter_messages(log_time_order=False)
            numbers += [message.sequence for _, _, message in found]
    return numbers


@pytest.mark.parametrize("split", [None, Split(max_bytes=500_000), Split(max_s=1.0)], ids=str)
@pytest.mark.parametrize("jump", JUMPS)
def test_a_jump_of_the_systems_clock(tmp_path: Path, jump: str, split: Split | None) -> None:
    bag = tmp_path / "bag"
    times = [START_NS + k * STEP_NS + JUMPS[jump](k) for k in range(COUNT)]
    record(bag, times, split)
    assert check_bag(bag).problems == ()
    assert stored_order(bag) == list(range(COUNT)), "files hold messages as they arrived"
    found = held(bag, [TOPIC])[TOPIC.name]
    assert sorted(m.number for m in found) == list(range(COUNT))
    assert all(a.log_ns <= b.log_ns for a, b in pairwise(found)), "readers go by log time"
    facts = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert facts["starting_time"]["nanoseconds_since_epoch"] == min(times)
    assert facts["duration"]["nanoseconds"] == max(times) - min(times)
    assert all(file["duration"]["nanoseconds"] >= 0 for file in facts["files"])
    with AnyReader([bag]) as reader:
        assert reader.start_time == min(times)
        given = [t for _, t, _ in reader.messages()]
        # Of several files rosbags, as rosbag2, reads one after the other.
        assert (sorted(given) if split else given) == sorted(times)


def test_stamps_that_jump_date_a_simulated_session(tmp_path: Path) -> None:
    """A message without a stamp gets the newest stamp, so its time never goes back."""
    times = [k * STEP_NS + max(0, JUMPS["back and forth"](k)) for k in range(COUNT)]
    clock = SimulatedTime()
    at = stamp_at(IMAGE)
    assert [clock.of(data, at) for data in messages(times)] == times
    assert clock.newest_ns == max(times)
    assert clock.of(b"\x00\x01\x00\x00", None) == max(times)
