"""Offset and delay of a link from heartbeats and their answers; states that were lost on it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.safety.link_quality import (
    WINDOW_S,
    Exchange,
    LinkClock,
    LinkClocks,
    LinkEstimate,
    LossCounter,
    LossCounters,
)

MS = 1_000_000
S = 1_000_000_000


def exchange(
    at_ns: int, offset_ns: int = 0, there_ns: int = MS, work_ns: int = MS, back_ns: int = MS
) -> Exchange:
    """One whose manager's clock says at_ns when it is sent."""
    received_ns = at_ns + there_ns + offset_ns
    return Exchange(at_ns, received_ns, received_ns + work_ns, at_ns + there_ns + work_ns + back_ns)


@given(
    offset_ns=st.integers(-100 * S, 100 * S),
    there_ns=st.integers(0, S),
    work_ns=st.integers(0, S),
    back_ns=st.integers(0, S),
)
def test_the_four_stamps(offset_ns: int, there_ns: int, work_ns: int, back_ns: int) -> None:
    """The offset's error is at most half of the delay; work in between costs nothing."""
    measured = exchange(1_700_000_000 * S, offset_ns, there_ns, work_ns, back_ns)
    assert measured.delay_s == pytest.approx((there_ns + back_ns) / S)
    assert abs(measured.offset_s - offset_ns / S) <= measured.delay_s / 2 + 1e-9


def test_nothing_is_known_before_the_first_answer() -> None:
    link = LinkClock().link(S)
    assert math.isnan(link.offset_s)
    assert math.isnan(link.delay_s)
    assert link.age_s == math.inf


def test_the_fastest_exchange_of_the_window_is_believed() -> None:
    clock = LinkClock()
    clock.add(exchange(0, 20 * MS, there_ns=MS), 1 * S)
    clock.add(exchange(0, 20 * MS, there_ns=300 * MS), 1 * S + 100 * MS)
    link = clock.link(1 * S + 200 * MS)
    assert link == LinkEstimate(0.02, 0.002, 0.1)
    # Once it is old the slow one is all there is, and its offset is off by half of the delay.
    late_ns = 1 * S + round(WINDOW_S * S) + 1
    link = clock.link(late_ns)
    assert link.delay_s == pytest.approx(0.301)
    assert link.offset_s == pytest.approx(0.02 + 0.1495)
    assert link.age_s == pytest.approx(WINDOW_S - 0.1)


def test_an_old_measurement_is_none() -> None:
    clock = LinkClock()
    clock.add(exchange(0), S)
    link = clock.link(S + round(WINDOW_S * S))
    assert link.delay_s == 0.002
    link = clock.link(S + round(WINDOW_S * S) + 1)
    assert math.isnan(link.delay_s)
    assert link.age_s > WINDOW_S


def test_an_impossible_delay_is_no_answer() -> None:
    """The manager's clock was set back while the answer was under way."""
    clock = LinkClock()
    clock.add(Exchange(10 * S, 10 * S, 10 * S, 10 * S - 2 * MS), S)
    assert clock.link(S).age_s == math.inf


@pytest.mark.parametrize(("back_ns", "counts"), [(MS, True), (MS + 1, False)])
def test_a_delay_may_seem_to_be_a_millisecond_below_none(back_ns: int, counts: bool) -> None:
    clock = LinkClock()
    clock.add(Exchange(10 * S, 10 * S, 10 * S, 10 * S - back_ns), S)
    assert clock.link(S).delay_s == (-0.001 if counts else pytest.approx(math.nan, nan_ok=True))
    assert (clock.link(S).age_s == 0.0) is counts


def test_an_answer_that_comes_at_the_instant_of_a_look_counts_at_the_next_look() -> None:
    clock = LinkClock()
    clock.add(exchange(0, there_ns=300 * MS), S)
    assert clock.link(2 * S).delay_s == pytest.approx(0.301)
    clock.add(exchange(0), 2 * S)
    assert clock.link(2 * S) == LinkEstimate(0.0, 0.002, 0.0)
    assert clock.link(2 * S + S // 2) == LinkEstimate(0.0, 0.002, 0.5)


def test_one_process_answers_for_all_of_its_objects() -> None:
    links = LinkClocks()
    links.on_sent(1, 5 * S)
    assert links.on_reply(["a", "b"], 1, exchange(5 * S, 3 * MS), S)
    links.on_sent(2, 6 * S)
    assert links.on_reply(["c"], 2, exchange(6 * S, -4 * MS), 2 * S)
    assert links.link("a", 2 * S) == links.link("b", 2 * S) == LinkEstimate(0.003, 0.002, 1.0)
    assert links.link("c", 2 * S).offset_s == -0.004
    assert links.link("nobody", 2 * S).age_s == math.inf


def test_answers_to_another_manager_say_nothing() -> None:
    links = LinkClocks()
    links.on_sent(1, 5 * S)
    assert not links.on_reply(["a"], 1, exchange(5 * S + 1), S)
    assert not links.on_reply(["a"], 2, exchange(5 * S), S)
    assert links.link("a", S).age_s == math.inf


def test_the_memory_is_bounded() -> None:
    links = LinkClocks()
    for sequence in range(5000):
        links.on_sent(sequence, sequence * MS)
    assert not links.on_reply(["a"], 0, exchange(0), S)
    assert links.on_reply(["a"], 4999, exchange(4999 * MS), S)


def counted(sequences: list[int]) -> tuple[int, int]:
    count = LossCounter()
    for sequence in sequences:
        count.see(sequence)
    return count.received, count.lost


@pytest.mark.parametrize(
    ("sequences", "lost"),
    [
        ([], 0),
        ([1, 2, 3], 0),
        ([7, 8, 9], 0),  # what came before the first that was heard is no loss
        ([1, 2, 5, 6], 2),
        ([1, 3, 3], 1),  # what is repeated isn't what was lost
        ([1, 3, 2, 4], 0),  # late, not lost
        ([1, 1, 1, 2], 0),  # a world that holds repeats itself
        ([0, 0, 0], 0),  # a source that doesn't count
        ([5, 9, 6, 7], 1),
        ([500, 1, 2, 3], 0),  # begun anew
        ([2000, 900, 901], 0),
        ([2000, 1000, 1002], 1),  # so far below the highest it has begun anew
        ([2000, 1001, 1003], 0),  # nearer by one it comes late
        ([21, 1, 2, 4], 1),
        ([20, 1, 2, 4], 0),
        ([40, 2, 4], 0),
        ([2, 1, 3], 0),
    ],
)
def test_losses(sequences: list[int], lost: int) -> None:
    assert counted(sequences) == (len(sequences), lost)


@given(st.sets(st.integers(2, 60)))
def test_what_is_missing_is_lost_in_whatever_order_the_rest_comes(
    missing: set[int],
) -> None:
    """Neighbours may overtake each other; the first and the last arrive."""
    sequences = [n for n in range(1, 62) if n not in missing]
    for i in range(1, len(sequences) - 2, 2):
        sequences[i], sequences[i + 1] = sequences[i + 1], sequences[i]
    assert counted(sequences) == (len(sequences), len(missing))


def test_losses_are_told_once() -> None:
    losses = LossCounters()
    for sequence in (1, 2, 5):
        losses.see("ot2", sequence)
    losses.see("ot1", 1)
    assert losses.news() == ["ot2: 2 states lost, 2 of 5 so far"]
    assert losses.news() == []
    losses.see("ot2", 7)
    assert losses.news() == ["ot2: 1 states lost, 3 of 7 so far"]
    losses.forget()
    assert losses.of == {}
    assert losses.news() == []
