"""A message of 100 MB, and a graph and a bag with 10,000 topics."""

from __future__ import annotations

import json
import resource
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_monitor.recorder.recorder import OVERHEAD_BYTES, Recorder
from ssp_monitor.recorder.topics import MOST_TOPICS, Profile, TopicSpec
from tests.support.processes.waiting import until

from .checks import held, missing
from .conftest import Field
from .load import IMAGE, TEXT, LoadTopic, encode

HUGE_BYTES = 100_000_000
HUGE = LoadTopic("/load/cloud", rate_hz=0, size_bytes=HUGE_BYTES, latched=True, depth=1)
# So seldom that whoever is kept from reading for long finds it still kept, at both ends.
SMALL = LoadTopic("/load/state", rate_hz=10, size_bytes=20_000, depth=500)


@pytest.mark.ros
@pytest.mark.system
def test_a_message_of_100_mb_through_the_middleware(field_: Field) -> None:
    """It is larger than the segment of shared memory, and than a file of this split bag."""
    load = field_.load(SMALL, HUGE)
    names = (SMALL.name, HUGE.name)
    recording = field_.record(*names, "--split-mb", "10", "--reserve-mb", "0", "--json")
    until(lambda: recording.size() > HUGE_BYTES, "the large message")
    # More than the end of a file takes.
    enough = recording.size() + 10 * SMALL.size_bytes
    until(lambda: recording.size() > enough, "messages behind it")
    sent = load.stop()
    recording.wait_for_end_of_data()
    assert recording.stop() == 0, recording.said
    assert json.loads(recording.out)["lost"] == 0
    assert check_bag(recording.bag).problems == ()
    assert missing(recording.bag, (SMALL, HUGE), sent) == []
    assert len(held(recording.bag, [HUGE])[HUGE.name]) == 1


def test_a_message_of_100_mb_is_held_once_in_memory(tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    data = encode(HUGE, 1, 0)
    limit = 2 * (len(data) + OVERHEAD_BYTES)
    spec = TopicSpec(HUGE.name, IMAGE, Profile.LATCHED)
    recorder = Recorder(tmp_path / "bag", [spec], queue_bytes=limit)
    for k in range(6):
        recorder.put_all([BagMessage(HUGE.name, k, k, data, k)])
        assert recorder.state().queue_bytes <= limit
    state = recorder.stop()
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert state.messages + state.dropped == 6
    assert state.messages >= 2
    # The message itself, what makes it, and nothing for each time that it is written.
    assert (after - before) << 10 < 4 * HUGE_BYTES
    with BagReader(tmp_path / "bag") as reader:
        assert all(message.data == data for message in reader.messages())
        assert reader.count == state.messages


def test_a_message_that_is_larger_than_the_queue_is_counted(tmp_path: Path) -> None:
    spec = TopicSpec(HUGE.name, IMAGE, Profile.SENSOR)
    recorder = Recorder(tmp_path / "bag", [spec], queue_bytes=1_000_000)
    large, small = bytes(2_000_000), encode(SMALL, 1, 0)
    for data in (small, large, small):
        recorder.put_all([BagMessage(HUGE.name, 0, 0, data)])
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (2, 1, None)


@pytest.mark.ros
@pytest.mark.system
def test_a_graph_with_more_topics_than_the_limit(field_: Field) -> None:
    """The first by name are recorded, the rest is named in a warning, and named topics come
    first."""
    many = [LoadTopic(f"/many/t{k:05d}", 0, 80, TEXT) for k in range(MOST_TOPICS + 100)]
    # A busy recorder finds in its publisher's history what was sent while it subscribed: in 500 s.
    named = LoadTopic("/zz/wanted", rate_hz=20, depth=10_000)
    load = field_.load(named, *many)
    recording = field_.record(named.name, "--all", "--json")
    recording.wait_until_told(f"topics are not recorded, the limit is {MOST_TOPICS}")
    sent_before = load.count()
    until(lambda: load.count() > sent_before + 60, "messages of the named topic")
    sent = load.stop()
    recording.wait_for_end_of_data()
    assert recording.stop() == 0, recording.said
    result = json.loads(recording.out)
    said = f"101 topics are not recorded, the limit is {MOST_TOPICS}"
    assert any(said in warning for warning in result["warnings"]), result["warnings"]
    assert result["lost"] == 0
    with BagReader(recording.bag) as reader:
        assert len(reader.topics) == MOST_TOPICS
        assert named.name in reader.topics
        assert many[0].name in reader.topics
        assert many[-1].name not in reader.topics
    assert missing(recording.bag, [named], sent) == []
