"""Bounded memory: what is dropped when the disk doesn't keep up, and what never is."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.types import BagMessage
from ssp_monitor.recorder.recorder import OVERHEAD_BYTES, DropQueue
from ssp_monitor.recorder.topics import MEANINGS, Importance, Profile, TopicSpec, importance

LIMIT = 8 * OVERHEAD_BYTES
# Either a message of so much data and so important, or a writer that takes so much.
STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(Importance), st.integers(0, 5 * OVERHEAD_BYTES)),
        st.integers(0, LIMIT),
    ),
    max_size=60,
)


def message(rank: Importance, number: int, size: int) -> BagMessage:
    return BagMessage(rank.name, number, number, bytes(size), number)


def cost(item: BagMessage) -> int:
    return len(item.data) + OVERHEAD_BYTES


@given(STEPS)
def test_the_less_important_is_dropped_first(steps):
    queue = DropQueue(LIMIT)
    queue.announce({rank.name: rank for rank in Importance})
    waiting: list[BagMessage] = []
    writing = 0
    dropped: Counter[str] = Counter()
    for number, step in enumerate(steps):
        if isinstance(step, int):
            taken = queue.take(step)
            # The order in which they came, and no more than asked for but for the last one.
            assert taken == waiting[: len(taken)]
            assert sum(map(cost, taken[:-1])) < max(step, 1)
            waiting = waiting[len(taken) :]
            writing = sum(map(cost, taken))
        else:
            rank, size = step
            new = message(rank, number, size)
            queue.put_all([new])
            kept = queue.dropped()[rank.name] == dropped[rank.name]
            before = [*waiting, new]
            lost = set(before)
            if kept:
                # What remains is known by what was counted; within a class the last ones go.
                now = queue.dropped()
                for lower in Importance:
                    gone = now[lower.name] - dropped[lower.name]
                    own = [item for item in before if item.topic == lower.name]
                    if gone:
                        assert lower < rank
                        for item in own[len(own) - gone :]:
                            before.remove(item)
                        # Nothing less important is left when this one had to be touched.
                        left = [Importance[item.topic] for item in before]
                        assert all(other >= lower for other in left)
                waiting = before
                lost -= set(before)
            else:
                as_important = [item for item in waiting if Importance[item.topic] >= rank]
                assert writing + sum(map(cost, as_important)) + cost(new) > LIMIT
                lost = {new}
            dropped.update(item.topic for item in lost)
        assert queue.dropped() == dropped
        assert len(queue) == len(waiting)
        assert queue.bytes == writing + sum(map(cost, waiting)) <= LIMIT
    rest: list[BagMessage] = []
    while batch := queue.take(LIMIT):
        rest += batch
    assert rest == waiting
    assert queue.bytes == 0


def test_an_event_waits_while_pictures_go():
    queue = DropQueue(3 * (OVERHEAD_BYTES + 100))
    queue.announce({rank.name: rank for rank in Importance})
    frames = [message(Importance.FRAME, n, 100) for n in range(3)]
    event = message(Importance.EVENT, 3, 100)
    queue.put_all([*frames, event, message(Importance.RAW_IMAGE, 4, 100)])
    assert queue.take(1 << 20) == [*frames[:2], event]
    assert queue.dropped() == {"FRAME": 1, "RAW_IMAGE": 1}


def test_nothing_is_dropped_in_vain():
    """A message that would not fit in any case takes nothing with it."""
    queue = DropQueue(3 * OVERHEAD_BYTES)
    queue.announce({rank.name: rank for rank in Importance})
    small = message(Importance.OTHER, 0, 0)
    queue.put_all([small])
    queue.put_all([message(Importance.EVENT, 1, 10 * OVERHEAD_BYTES)])
    assert queue.take(1) == [small]
    assert queue.dropped() == {"EVENT": 1}


def test_what_is_being_written_still_takes_its_place():
    queue = DropQueue(2 * OVERHEAD_BYTES)
    first, second, third = (message(Importance.OTHER, n, 0) for n in range(3))
    queue.put_all([first, second])
    assert queue.take(1) == [first]
    queue.put_all([third])
    assert queue.dropped() == {"OTHER": 1}
    assert queue.take(1) == [second]
    queue.put_all([third])
    assert queue.take(1) == [third]


def test_what_was_taken_and_not_written_is_counted():
    queue = DropQueue(LIMIT)
    queue.put_all([message(Importance.STATE, 0, 0)])
    queue.give_up(queue.take(LIMIT))
    assert queue.dropped() == {"STATE": 1}


@pytest.mark.parametrize(
    ("msgtype", "profile", "expected"),
    [
        ("sensor_msgs/msg/Image", Profile.ADAPTED, Importance.RAW_IMAGE),
        ("sensor_msgs/msg/PointCloud2", Profile.ADAPTED, Importance.RAW_IMAGE),
        ("sensor_msgs/msg/CompressedImage", Profile.ADAPTED, Importance.COMPRESSED_IMAGE),
        ("sensor_msgs/msg/CompressedImage", Profile.SENSOR, Importance.FRAME),
        ("sensor_msgs/msg/CameraInfo", Profile.SENSOR, Importance.STATE),
        ("nav_msgs/msg/Odometry", Profile.ADAPTED, Importance.OTHER),
        ("diagnostic_msgs/msg/DiagnosticArray", Profile.ADAPTED, Importance.DIAGNOSTIC),
        ("ssp_msgs/msg/RecorderStatus", Profile.STATE, Importance.DIAGNOSTIC),
        ("ssp_msgs/msg/ObjectState", Profile.STATE, Importance.STATE),
        ("ssp_msgs/msg/SafetyEvent", Profile.LATCHED, Importance.EVENT),
        ("ssp_msgs/msg/Reference", Profile.COMMAND, Importance.EVENT),
    ],
)
def test_the_order_is_one_table(msgtype, profile, expected):
    assert importance(TopicSpec("/x", msgtype, profile)) is expected
    assert set(MEANINGS) == set(Importance)
