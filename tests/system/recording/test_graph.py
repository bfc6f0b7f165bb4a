"""Publishers that come, go, return and change while they are recorded."""

from __future__ import annotations

import json

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from tests.support.processes.waiting import until

from .checks import held, missing
from .conftest import Field, Recording
from .load import IMAGE, TEXT, LoadTopic

pytestmark = [pytest.mark.ros, pytest.mark.system]
# A recorder that a busy machine keeps waiting finds everything that was sent meanwhile.
KEPT = 10_000
FIRST = LoadTopic("/load/first", rate_hz=100, depth=KEPT)


def finish(recording: Recording) -> tuple[int, dict[str, object]]:
    """Ends a recording; its exit status and what it says about itself."""
    status = recording.stop()
    result: dict[str, object] = json.loads(recording.out)
    return status, result


def recorded(recording: Recording, size_bytes: int = 100_000) -> None:
    before = recording.size()
    until(lambda: recording.size() > before + size_bytes, f"{size_bytes} bytes more")


def test_late_topics_and_best_effort_ones_are_recorded(field_: Field) -> None:
    early = field_.load(FIRST)
    recording = field_.record("--all", "--json")
    recorded(recording)
    late_topics = (
        LoadTopic("/late/state", rate_hz=100, depth=KEPT),
        LoadTopic("/late/map", rate_hz=0, size_bytes=20_000, latched=True),
        LoadTopic("/late/lidar", rate_hz=20, size_bytes=20_000, reliable=False),
    )
    late = field_.load(*late_topics)
    late.wait_until_heard()
    recorded(recording)
    sent = [*early.stop(), *late.stop()]
    recorded_all = (FIRST, *late_topics)
    recording.wait_for_end_of_data()
    status, result = finish(recording)
    assert (status, result["lost"], result["problems"]) == (0, 0, []), recording.said
    assert check_bag(recording.bag).problems == ()
    assert missing(recording.bag, recorded_all, sent) == []
    with BagReader(recording.bag) as reader:
        assert set(reader.topics) == {topic.name for topic in recorded_all}
        assert "best_effort" in reader.topics["/late/lidar"].offered_qos
        assert "transient_local" in reader.topics["/late/map"].offered_qos


def test_a_publisher_that_starts_again_loses_nothing(field_: Field) -> None:
    """Its process ends and another one goes on; numbers of the middleware begin anew."""
    before = field_.load(FIRST)
    recording = field_.record(FIRST.name, "--json")
    recorded(recording)
    sent = before.stop()
    after = field_.load(LoadTopic(FIRST.name, rate_hz=100, first=1_000_001, depth=KEPT))
    after.wait_until_heard()
    recorded(recording)
    sent += after.stop()
    recording.wait_for_end_of_data()
    status, result = finish(recording)
    assert (status, result["lost"]) == (0, 0), recording.said
    numbers = [m.number for m in held(recording.bag, [FIRST])[FIRST.name]]
    for begin in (0, 1_000_000):
        part = [n for n in numbers if begin < n < begin + 1_000_000]
        last = max(s.number for s in sent if begin < s.number < begin + 1_000_000)
        assert part == list(range(part[0], last + 1))


def test_a_topic_that_changes_its_type_keeps_its_first_one(field_: Field) -> None:
    """Messages of the other type aren't recorded, and the recording isn't called whole."""
    before = field_.load(FIRST)
    recording = field_.record("--all", "--json")
    recorded(recording)
    sent = before.stop()
    other = LoadTopic(FIRST.name, rate_hz=100, msgtype=TEXT, first=5_000, depth=KEPT)
    beside = LoadTopic("/load/beside", rate_hz=100, depth=KEPT)
    after = field_.load(other)
    until(lambda: after.count() > 300, "messages of the other type")
    added = field_.load(beside)
    added.wait_until_heard()
    recorded(recording)
    sent += [*after.stop(), *added.stop()]
    recording.wait_for_end_of_data()
    status, result = finish(recording)
    assert status == 1
    said = f"{FIRST.name} is also of type {TEXT} now: only {IMAGE} is recorded"
    assert any(said in warning for warning in result["warnings"]), result  # type: ignore[union-attr]
    assert result["problems"] == []
    assert check_bag(recording.bag).problems == ()
    of_first = [s for s in sent if s.number < 5_000 or s.topic == beside.name]
    assert missing(recording.bag, (FIRST, beside), of_first) == []
    with BagReader(recording.bag) as reader:
        assert reader.topics[FIRST.name].msgtype == IMAGE


def test_a_topic_with_two_types_is_named(field_: Field) -> None:
    """It is not recorded where both are there when it is found; else it has its first type."""
    one = field_.load(LoadTopic("/load/both", rate_hz=20), FIRST)
    other = field_.load(LoadTopic("/load/both", rate_hz=20, msgtype=TEXT))
    recording = field_.record("--all", "--json")
    recorded(recording, 150_000)
    # While both are there: of one that was left, the topic would be recorded from then on.
    status, result = finish(recording)
    one.stop()
    other.stop()
    warning = " ".join(w for w in result["warnings"] if "/load/both" in w)  # type: ignore[attr-defined]
    with BagReader(recording.bag) as reader:
        topics = set(reader.topics)
    if "/load/both has several types and is not recorded" in warning:
        assert (status, topics) == (0, {FIRST.name})
    else:
        assert "/load/both is also of type" in warning
        assert (status, topics) == (1, {FIRST.name, "/load/both"})
