"""The senders that an object listens to: one manager, near neighbours; and its own heartbeats."""

from __future__ import annotations

import math

import pytest

from ssp_core.cdr.steps import Heartbeat
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.objects.messages import HeartbeatResponder, ManagerArbiter, NearbyObjects
from ssp_ot_controller.sil.disturbance import LinkSizes
from tests.support.states import object_state

S = 1_000_000_000
MS = 1_000_000
LIMITS = Limits(speed_mps=15.0, acceleration_mps2=5.0, separation_m=0.5, state_age_s=0.3)


def car(object_id: str, x_m: float, **changes: float) -> ObjectState:
    return object_state(object_id, x_m=x_m, **{"speed_mps": 10.0, "stamp_ns": 10 * S, **changes})


# -- one manager ----------------------------------------------------------------------------------


def test_a_manager_of_another_session_is_never_followed() -> None:
    """A simulated session that reached a live object armed it."""
    line = ManagerArbiter(0.5, "live-1", "live")
    assert not line.is_ours("sim", 1, 0, may_move=False, token="sim-1")
    assert not line.is_ours("others", 1, 0, may_move=False, token="live-2")
    assert not line.is_ours("old", 1, 0, may_move=False)
    assert line.strangers(0) == 3
    assert line.is_ours("ours", 1, 0, may_move=False, token="live-1")
    assert line.command_problem("live-1", 0) == ""
    for token in ("", "sim-1", "live-2"):
        assert line.command_problem(token, 0)
    # Also when ours has gone.
    assert not line.is_ours("others", 2, 10 * S, may_move=False, token="live-2")
    assert line.command_problem("live-2", 10 * S)


def test_without_a_token_of_its_own_an_object_follows_the_first_manager_of_its_kind() -> None:
    line = ManagerArbiter(0.5, "", "live")
    assert line.command_problem("sim-1", 0)
    assert line.command_problem("live-1", 0) == ""
    assert not line.is_ours("sim", 1, 0, may_move=False, token="sim-1")
    assert line.is_ours("first", 1, 0, may_move=False, token="live-1")
    assert not line.is_ours("second", 1, 0, may_move=False, token="live-2")
    assert line.command_problem("live-1", 0) == ""
    assert line.command_problem("live-2", 0)
    # The first has gone, and nothing may move.
    assert line.command_problem("live-2", S) == ""
    assert line.is_ours("second", 2, S, may_move=False, token="live-2")
    assert line.command_problem("live-1", S)


def test_others_programs_without_a_token_keep_working() -> None:
    line = ManagerArbiter(0.5, "", "live")
    assert line.is_ours("theirs", 1, 0, may_move=False)
    assert line.command_problem("", 0) == ""


def test_a_rising_sequence_of_one_sender_is_ours_gaps_or_not() -> None:
    line = ManagerArbiter(0.5)
    for sequence in (3, 4, 9, 10):
        assert line.is_ours("m", sequence, sequence * 50 * MS, may_move=True)
    assert line.strangers(S) == 0


@pytest.mark.parametrize(("sender", "sequence"), [("n", 11), ("m", 10), ("m", 1)])
def test_another_sender_or_another_line_is_a_stranger(sender: str, sequence: int) -> None:
    line = ManagerArbiter(0.5)
    assert line.is_ours("m", 10, 0, may_move=False)
    assert not line.is_ours(sender, sequence, 100 * MS, may_move=False)
    assert line.strangers(100 * MS) == 1
    assert line.is_ours("m", 12, 150 * MS, may_move=False)
    assert line.strangers(1100 * MS) == 1
    assert line.strangers(1100 * MS + 1) == 0


def test_two_lines_of_one_name_are_told_apart_by_the_one_that_lags() -> None:
    line = ManagerArbiter(0.5)
    assert line.is_ours("m", 10, 0, may_move=True)
    assert line.is_ours("m", 500, 20 * MS, may_move=True)  # it might have lost 489
    assert not line.is_ours("m", 11, 40 * MS, may_move=True)
    assert line.strangers(40 * MS) == 1


@pytest.mark.parametrize(
    ("silent_ms", "may_move", "taken"),
    [
        (500, False, False),
        (501, False, True),
        (501, True, False),
        (60_000, True, False),
    ],
)
def test_a_new_manager_takes_over_from_a_silent_one_when_nothing_may_move(
    silent_ms: int, may_move: bool, taken: bool
) -> None:
    line = ManagerArbiter(0.5)
    assert line.is_ours("m", 10, S, may_move=False)
    at_ns = S + silent_ms * MS
    assert line.is_ours("m", 1, at_ns, may_move=may_move) == taken
    assert line.strangers(at_ns) == (0 if taken else 1)


# -- neighbours -----------------------------------------------------------------------------------


def test_near_ones_are_heard_at_the_own_stamp_and_oneself_is_not() -> None:
    heard = NearbyObjects(LIMITS)
    own = car("ot1", 0.0)
    heard.take([own, car("ot2", 5.0, stamp_ns=10 * S - 100 * MS), car("far", 60.0), car("a", 7.0)])
    near = heard.near(own)
    assert [s.object_id for s in near] == ["a", "ot2"]
    assert near[1].stamp_ns == own.stamp_ns
    assert near[1].x_m == pytest.approx(6.0)


@pytest.mark.parametrize(("age_ms", "counts"), [(0, 1), (300, 1), (301, 0), (-300, 1), (-301, 0)])
def test_old_states_say_nothing_any_more(age_ms: int, counts: int) -> None:
    heard = NearbyObjects(LIMITS)
    heard.take([car("ot2", 5.0, stamp_ns=10 * S - age_ms * MS)])
    assert len(heard.near(car("ot1", 5.0))) == counts


def test_a_broken_state_replaces_none() -> None:
    heard = NearbyObjects(LIMITS)
    heard.take([car("ot2", 5.0), car("ot2", math.nan)])
    assert len(heard.near(car("ot1", 5.0))) == 1


def test_whoever_comes_within_the_separation_is_near() -> None:
    """No one whose box is closer than the separation may be left out, at any speed and age."""
    heard = NearbyObjects(LIMITS)
    own = car("ot1", 0.0)
    for gap_m in (0.0, 0.49, 0.5):
        for age_ms in (0, 150, 300):
            x_m = 3.6 + 0.9 + gap_m - 10.0 * age_ms / 1000.0
            heard.take([car("ot2", x_m, stamp_ns=10 * S - age_ms * MS)])
            assert len(heard.near(own)) == 1


# -- answers to heartbeats ------------------------------------------------------------------------

GOOD = LinkSizes(0.0, 0.0, 0.0, False)


def beat(sequence: int, sent_ns: int) -> Heartbeat:
    return Heartbeat(0, "m", sequence, sent_ns, SessionPhase.RUNNING, {})


def test_a_good_link_is_answered_at_once_and_once_for_all_objects() -> None:
    echo = HeartbeatResponder()
    (reply,) = echo.on_heartbeat(beat(7, 5 * S), {"b": GOOD, "a": GOOD}, 6 * S, 0)
    assert (reply.sequence, reply.object_ids) == (7, ("a", "b"))
    assert (reply.sent_ns, reply.received_ns, reply.replied_ns) == (5 * S, 6 * S, None)
    assert echo.due(60 * S) == []


def test_a_disturbed_link_is_measured_as_it_is() -> None:
    """offset = ((t2 - t1) + (t3 - t4)) / 2 and delay = (t4 - t1) - (t3 - t2)."""
    echo = HeartbeatResponder()
    links = {"a": LinkSizes(0.2, 0.03, 0.03, False), "b": GOOD}
    (at_once,) = echo.on_heartbeat(beat(1, 100 * S), links, 100 * S, 50 * S)
    assert at_once.object_ids == ("b",)
    assert echo.due(50 * S + 60 * MS - 1) == []
    (late,) = echo.due(50 * S + 60 * MS)
    assert late.object_ids == ("a",)
    arrived_ns = 100 * S + 60 * MS
    assert late.replied_ns is not None
    offset_ns = ((late.received_ns - late.sent_ns) + (late.replied_ns - arrived_ns)) / 2
    assert offset_ns == 200 * MS
    assert (arrived_ns - late.sent_ns) - (late.replied_ns - late.received_ns) == 60 * MS
    assert echo.due(60 * S) == []


def test_a_cut_link_is_silent() -> None:
    echo = HeartbeatResponder()
    assert echo.on_heartbeat(beat(1, 0), {"a": LinkSizes(0.0, 0.0, 0.0, True)}, 0, 0) == []


def test_a_manager_that_beats_very_fast_is_answered_a_hundred_times_a_second() -> None:
    echo = HeartbeatResponder()
    answered = [bool(echo.on_heartbeat(beat(k, 0), {"a": GOOD}, 0, k * MS)) for k in range(1, 101)]
    assert sum(answered) == 10
