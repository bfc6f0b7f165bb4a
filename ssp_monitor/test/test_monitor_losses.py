"""What is counted as lost: gaps by publisher, what the middleware says, what publishers say."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.cdr.steps import Heartbeat, WorldTick, encode_heartbeat, encode_tick
from ssp_core.vocabulary import SessionPhase
from ssp_monitor.recorder.losses import HEARTBEAT, TICK, Arrivals, claims, losses_beside

A, B = b"a" * 16, b"b" * 16


def test_a_gap_is_a_loss_and_a_start_is_none():
    arrivals = Arrivals()
    assert [arrivals.seen(A, n) for n in (7, 8, 12, 13)] == [0, 0, 3, 0]
    assert (arrivals.received, arrivals.gaps, arrivals.lost) == (4, 3, 3)


def test_publishers_count_for_themselves():
    arrivals = Arrivals()
    heard = [(A, 1), (B, 500), (A, 2), (B, 501), (B, 504), (A, 3)]
    assert [arrivals.seen(*one) for one in heard] == [0, 0, 0, 0, 2, 0]
    assert (arrivals.lost, arrivals.publishers) == (2, 2)


def test_a_publisher_that_starts_over_has_lost_nothing():
    arrivals = Arrivals()
    for publisher, sequence in ((A, 90), (A, 91), (B, 1), (B, 2)):
        assert arrivals.seen(publisher, sequence) == 0
    # As where the middleware doesn't tell publishers apart.
    assert [arrivals.seen(A, n) for n in (1, 2, 4)] == [0, 0, 1]
    assert arrivals.lost == 1


def test_messages_without_numbers_are_received_and_prove_nothing():
    arrivals = Arrivals()
    assert [arrivals.seen(A, n) for n in (4, 0, 0, 5, 0)] == [0, 0, 0, 0, 0]
    assert (arrivals.received, arrivals.lost) == (5, 0)


def test_what_two_tell_of_the_same_counts_once():
    arrivals = Arrivals()
    arrivals.seen(A, 1)
    arrivals.seen(A, 4)
    arrivals.told = 1
    assert arrivals.lost == 2
    arrivals.told = 5
    assert arrivals.lost == 5


@pytest.mark.parametrize(("sent", "behind"), [(0, 0), (8, 0), (9, 0), (12, 3)])
def test_what_a_publisher_claims_shows_what_is_missing_at_the_end(sent, behind):
    arrivals = Arrivals()
    arrivals.seen(A, 6)
    arrivals.seen(A, 9)
    arrivals.claimed(sent)
    assert (arrivals.behind, arrivals.lost) == (behind, 2 + behind)


def test_a_claim_proves_nothing_about_several_publishers_or_none():
    arrivals = Arrivals()
    arrivals.claimed(5)
    assert arrivals.lost == 0
    arrivals.seen(A, 1)
    arrivals.seen(B, 1)
    arrivals.claimed(5)
    assert arrivals.lost == 0


@given(
    st.dictionaries(
        st.binary(min_size=16, max_size=16),
        st.sets(st.integers(1, 60), min_size=1),
        min_size=1,
        max_size=4,
    ),
    st.randoms(use_true_random=False),
)
def test_received_and_lost_make_up_the_whole(heard, order):
    """Whatever the order in which publishers are heard, of each its own messages in theirs."""
    arrivals = Arrivals()
    waiting = {publisher: sorted(numbers) for publisher, numbers in heard.items()}
    while waiting:
        publisher = order.choice(sorted(waiting))  # type: ignore[attr-defined]
        arrivals.seen(publisher, waiting[publisher].pop(0))
        if not waiting[publisher]:
            del waiting[publisher]
    spans = sum(max(numbers) - min(numbers) + 1 for numbers in heard.values())
    assert arrivals.received + arrivals.lost == spans


def beat(**references: int) -> bytes:
    return encode_heartbeat(Heartbeat(0, "manager", 1, 0, SessionPhase.RUNNING, references))


def test_claims_name_the_topics_that_are_counted():
    tick = encode_tick(WorldTick(0, 7, True, True, 3, 41))
    assert claims({TICK: tick, HEARTBEAT: beat(ot1=3, walker=0)}) == {
        "/ssp/vut/state": 41,
        "/ssp/ot1/reference": 3,
        "/ssp/walker/reference": 0,
    }
    assert claims({}) == {}


def test_a_message_that_cannot_be_read_claims_nothing():
    assert claims({TICK: b"\x00\x01\x00\x00", HEARTBEAT: beat(ot1=3)}) == {"/ssp/ot1/reference": 3}


@given(st.binary(max_size=80), st.binary(max_size=80))
def test_no_bytes_make_claims_fail(tick, heartbeat):
    head = b"\x00\x01\x00\x00"
    claims({TICK: head + tick, HEARTBEAT: head + heartbeat})


def test_losses_beside_the_run_are_one_sentence():
    own = frozenset(["/run"])
    assert losses_beside({"/run": 3, "/x": 0}, own) == []
    assert losses_beside({"/run": 3, "/b": 2, "/a": 1}, own) == [
        "3 messages of topics beside the run's are missing: /a, /b"
    ]
    many = losses_beside({f"/t{k}": 1 for k in range(9)}, own)
    assert many == [
        "9 messages of topics beside the run's are missing: /t0, /t1, /t2, /t3, /t4, ..."
    ]
    # Without a run all topics count, and lost messages speak for themselves.
    assert losses_beside({"/a": 1}, frozenset()) == []
