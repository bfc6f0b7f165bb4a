"""Bag time and steady time under rate, pause, loop and steps."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.types import BagMessage
from ssp_core.clock import NS_PER_S
from ssp_monitor.replay.player import (
    FASTEST,
    SLOWEST,
    End,
    Lateness,
    Playback,
    Rest,
    Send,
    Tick,
    Timeline,
)

times = st.integers(0, 10**15)
rates = st.floats(SLOWEST, FASTEST)
timelines = st.builds(Timeline, times, times, rates, st.just(False))


def _messages(*stamps_ns: int, topic: str = "/a") -> Iterator[BagMessage]:
    return iter([BagMessage(topic, ns, ns, b"%d" % ns) for ns in stamps_ns])


def _play(playback: Playback, now_ns: int = 0) -> list[tuple[int, BagMessage]]:
    """Everything with the time at which it was sent, on a clock that jumps to each deadline."""
    sent = []
    while True:
        match playback.act(now_ns):
            case End():
                return sent
            case Send(message, _):
                sent.append((now_ns, message))
            case Rest(until_ns):
                assert until_ns is not None
                assert until_ns > now_ns
                now_ns = until_ns


@given(timelines, st.integers(0, 10**13))
def test_what_is_due_has_come_when_it_is_due_and_not_long_before(line, ahead):
    wanted_ns = line.bag_ns + ahead
    due_ns = line.due_ns(wanted_ns)
    assert due_ns is not None
    # A nanosecond of the steady clock is `rate` of the bag; doubles add a little at 1e13.
    slack = 1 + 2 * line.rate + ahead * 1e-15
    assert abs(line.at(due_ns) - wanted_ns) <= slack


@given(timelines, st.lists(st.integers(0, 10**12), min_size=2, max_size=8))
def test_bag_time_never_goes_back(line, steps):
    now, seen = line.steady_ns - 10**9, line.bag_ns
    for step in steps:
        now += step
        assert line.at(now) >= seen
        seen = line.at(now)


@given(
    timelines,
    st.lists(
        st.tuples(st.integers(0, 10**11), st.one_of(st.booleans(), rates)), min_size=1, max_size=12
    ),
)
def test_no_change_makes_bag_time_jump(line, changes):
    now = line.steady_ns
    for wait_ns, change in changes:
        now += wait_ns
        before = line.at(now)
        if isinstance(change, bool):
            line = line.set_paused(change, now)
            assert line.paused is change
        else:
            line = line.set_rate(change, now)
            assert line.rate == change
        assert line.at(now) == before


@given(timelines, st.integers(0, 10**12), st.integers(0, 10**12))
def test_a_pause_takes_no_bag_time(line, before_ns, pause_ns):
    at = line.steady_ns + before_ns
    paused = line.set_paused(True, at)
    assert paused.at(at + pause_ns) == line.at(at)
    assert paused.due_ns(line.bag_ns + 10**15) is None
    resumed = paused.set_paused(False, at + pause_ns)
    assert resumed.at(at + pause_ns) == line.at(at)


def test_a_delay_before_the_beginning_is_kept_through_a_change_of_rate():
    line = Timeline(0, 5 * NS_PER_S).set_rate(2.0, NS_PER_S)
    assert line.due_ns(0) == 5 * NS_PER_S
    assert line.at(6 * NS_PER_S) == 2 * NS_PER_S


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_a_rate_that_cannot_be_is_refused_and_changes_nothing(rate):
    line = Timeline(0, 0)
    with pytest.raises(ValueError, match="rate must be from"):
        line.set_rate(rate, 0)


@given(
    st.lists(st.integers(0, 10**10), max_size=30).map(sorted),
    rates,
    st.integers(0, 10**10),
)
def test_everything_is_sent_once_in_order_and_on_time(stamps, rate, begin_ns):
    line = Timeline(0, begin_ns, rate)
    sent = _play(Playback(_messages(*stamps), line))
    assert [message.log_time_ns for _, message in sent] == stamps
    # On a clock that jumps to each deadline nothing is late, and nothing is early.
    assert all(at == max(line.due_ns(message.log_time_ns) or 0, 0) for at, message in sent)


def test_a_late_replay_catches_up_and_does_not_shift_what_follows():
    playback = Playback(_messages(0, 10, 20, 1000), Timeline(0, 0))
    late = [playback.act(500) for _ in range(3)]
    assert [action.late_ns for action in late if isinstance(action, Send)] == [500, 490, 480]
    assert playback.act(500) == Rest(1000)
    assert playback.behind_ns(1200) == 200


def test_a_step_sends_one_message_and_pauses_where_it_is():
    playback = Playback(_messages(0, 10, 20), Timeline(0, 0, 1.0, paused=True))
    assert playback.act(100) == Rest(None)
    playback.step(100)
    assert isinstance(playback.act(100), Send)
    assert playback.act(100) == Rest(None)
    playback.step(200)
    stepped = playback.act(200)
    assert isinstance(stepped, Send)
    assert stepped.message.log_time_ns == 10
    assert stepped.late_ns is None
    assert playback.timeline.at(10**9) == 10
    # It goes on from there: the next message is 10 ns of the bag away.
    playback.set_paused(False, 300)
    assert playback.act(300) == Rest(310)


def test_a_step_by_frames_ends_with_the_frame():
    tape = [("/a", 1), ("/cam", 2), ("/a", 3), ("/a", 4), ("/cam", 5), ("/a", 6)]
    messages = iter([BagMessage(topic, ns, ns, b"") for topic, ns in tape])
    playback = Playback(messages, Timeline(0, 0), frames=frozenset({"/cam"}))
    for expected in (2, 5):
        playback.step_frame(0)
        sent = []
        while isinstance(action := playback.act(0), Send):
            sent.append(action.message.log_time_ns)
        assert sent[-1] == expected
        assert playback.timeline.paused
        assert playback.timeline.bag_ns == expected


def test_resuming_forgets_steps_that_are_still_to_come():
    playback = Playback(_messages(0, 10**9), Timeline(0, 0), frames=frozenset({"/cam"}))
    playback.step_frame(0)
    playback.set_paused(False, 0)
    assert isinstance(playback.act(0), Send)
    assert playback.act(0) == Rest(10**9)


def test_ticks_come_at_their_rate_show_bag_time_and_never_pass_a_message():
    playback = Playback(_messages(0, 95), Timeline(0, 0, 2.0), tick_ns=10)
    seen: list[object] = []
    now = 0
    while not isinstance(action := playback.act(now), End):
        if isinstance(action, Rest):
            assert action.until_ns is not None
            now = action.until_ns
        else:
            seen.append(action.bag_ns if isinstance(action, Tick) else action.message.log_time_ns)
    assert seen == [0, 0, 20, 40, 60, 80, 95]
    late = Playback(_messages(50), Timeline(0, 0), tick_ns=10)
    assert late.act(1000) == Tick(50)


def test_while_paused_ticks_go_on_and_stand():
    playback = Playback(_messages(10**9), Timeline(7, 0, 1.0, paused=True), tick_ns=10)
    assert [playback.act(now) for now in (0, 10, 20)] == [Tick(7)] * 3
    assert playback.act(20) == Rest(30)


@given(st.lists(st.integers(-5, 10**11), min_size=1, max_size=200))
def test_lateness_is_known_to_four_percent(late_ns):
    lateness = Lateness()
    for late in late_ns:
        lateness.add(late)
    real = sorted(max(late, 0) for late in late_ns)
    assert lateness.most_ns == real[-1]
    assert lateness.quantile_ns(1.0) == real[-1]
    median = real[(len(real) - 1) // 2]
    assert median <= lateness.quantile_ns(0.5) + 1
    assert lateness.quantile_ns(0.5) <= median * 1.04 + 1
