"""Shadow mode: when a request is due, what it holds, and what a bridge's health says."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.node_interface import Level
from ssp_core.vocabulary import ObjectClass, Role
from ssp_vla_bridge.bridge import BridgeHealth, ShadowRequests
from ssp_vla_bridge.messages import ErrorCode, Frame, Request, Response
from ssp_vla_bridge.window import Preprocessing

MS = NS_PER_S // 1000
CAR = DEFAULT_SIZES[ObjectClass.CAR]


def state(stamp_ns: int, x_m: float) -> ObjectState:
    return ObjectState(
        "vut", ObjectClass.CAR, Role.VUT, stamp_ns, x_m, 0.0, 0.0, 10.0, 0.0, 0.0, CAR, 1
    )


def follower(**given: object) -> ShadowRequests:
    return replace(ShadowRequests("m", NS_PER_S // 2, Preprocessing()), **given)


def drive(one: ShadowRequests, frames: int, start_ns: int = 0) -> list[Request]:
    """Frames at 10 Hz and states at 50 Hz; each request that is due is made."""
    requests = []
    for k in range(frames):
        for i in range(5):
            at_ns = start_ns + k * 100 * MS + i * 20 * MS
            one.state(state(at_ns, 10.0 * at_ns / NS_PER_S))
        if one.frame(Frame(start_ns + k * 100 * MS, b"jpeg %d" % k)):
            requests.append(one.request())
    return requests


def answer(request: Request, **given: object) -> Response:
    blank = Response(request.request_id, request.stamp_ns, "m", "m/1", "text")
    return replace(blank, **given)


def test_a_request_every_half_second_of_the_sessions_clock():
    requests = drive(follower(), 31)
    assert [r.stamp_ns for r in requests] == [k * 500 * MS for k in range(7)]
    last = requests[-1]
    assert [f.stamp_ns for f in last.frames] == [(2100 + 100 * k) * MS for k in range(10)]
    assert [s.t_s for s in last.history] == pytest.approx([-2.0 + 0.1 * k for k in range(21)])
    assert last.history[0].x_m == pytest.approx(-20.0)
    assert (last.ego_provenance, last.frames[-1].jpeg) == ("measured", b"jpeg 30")


def test_nothing_in_a_request_is_later_than_its_frame():
    one = follower()
    drive(one, 10)
    one.state(state(10 * NS_PER_S, 99.0))
    one.frame(Frame(NS_PER_S, b"x"))
    request = one.request()
    assert all(sample.t_s <= 0.0 for sample in request.history)
    assert all(frame.stamp_ns <= request.stamp_ns for frame in request.frames)


def test_without_a_recent_state_the_history_is_empty():
    one = follower()
    one.frame(Frame(5 * NS_PER_S, b"x"))
    request = one.request()
    assert (request.history, request.ego_provenance) == ((), "unknown")


def test_late_and_repeated_frames_ask_nothing():
    one = follower()
    assert one.frame(Frame(NS_PER_S, b"a"))
    one.request()
    assert not one.frame(Frame(NS_PER_S, b"a"))
    assert not one.frame(Frame(NS_PER_S - 100 * MS, b"b"))


def test_a_clock_that_goes_back_begins_anew():
    one = follower(carries_previous=True)
    first = drive(one, 11, start_ns=100 * NS_PER_S)
    one.answered(answer(first[-1]))
    again = drive(one, 1)
    assert len(again) == 1
    assert (len(again[0].frames), again[0].previous) == (1, None)


def test_an_answer_that_comes_after_the_clock_went_back_is_not_carried():
    one = follower(carries_previous=True)
    (before,) = drive(one, 1, start_ns=2 * NS_PER_S)
    drive(one, 6)
    assert one.answered(answer(before)).decoding["input"]["frames_ns"] == [2 * NS_PER_S]
    (later,) = drive(one, 1, start_ns=3 * NS_PER_S)
    assert later.previous is None
    one.answered(answer(later))
    (last,) = drive(one, 1, start_ns=4 * NS_PER_S)
    assert last.previous == answer(later)


def test_the_previous_answer_is_carried_where_the_interface_wants_it():
    one = follower(carries_previous=True)
    first = drive(one, 1)[0]
    kept = one.answered(answer(first))
    assert kept.decoding["input"] == {
        "frames_ns": [0],
        "history_s": 0.0,
        "ego": "measured",
        "previous": "",
    }
    (second,) = drive(one, 5, start_ns=100 * MS)
    assert second.previous == answer(first)
    failed = one.answered(answer(second, error_code=int(ErrorCode.BACKEND), error_msg="no"))
    assert failed.decoding["input"]["previous"] == first.request_id
    (third,) = drive(one, 5, start_ns=600 * MS)
    assert third.previous is None


def test_answers_to_others_are_left_as_they_are():
    one = follower()
    strange = answer(Request("of somebody else", 1, ()))
    assert one.answered(strange) is strange


@given(st.lists(st.integers(0, 40 * NS_PER_S), max_size=60))
def test_memory_is_bounded_whatever_the_stamps_are(stamps):
    one = follower()
    for stamp in stamps:
        one.state(state(stamp, 0.0))
        if one.frame(Frame(stamp, b"")):
            request = one.request()
            assert request.frames[-1].stamp_ns == request.stamp_ns
    rules = one.rules
    kept = [s.stamp_ns for s in one._states]
    assert kept == sorted(kept)
    if kept:
        assert kept[-1] - kept[0] <= (rules.history_s + rules.state_age_s + 1.0) * NS_PER_S
    frames = [f.stamp_ns for f in one._frames]
    assert all(a < b for a, b in pairwise(frames))
    if frames:
        assert frames[-1] - frames[0] <= rules.frame_span_s * NS_PER_S


def health() -> BridgeHealth:
    return BridgeHealth("m", "m/1", 10.0)


def test_health_of_a_bridge_that_answers():
    one = health()
    assert one.status(0, 0).message == "ready"
    for latency in (0.1, 0.3, 0.2):
        one.see(0, "", latency, NS_PER_S)
    status = one.status(2, NS_PER_S)
    assert (status.level, status.message) == (Level.OK, "answering")
    values = dict(status.values)
    assert (values["answered"], values["waiting"]) == ("3", "2")
    assert (values["latency, median [s]"], values["latency, longest [s]"]) == ("0.200", "0.300")


def test_one_error_warns_for_a_minute():
    one = health()
    one.see(0, "", 0.1, 0)
    one.see(ErrorCode.TIMEOUT, "no answer within 10 s", 10.0, NS_PER_S)
    assert one.status(0, 2 * NS_PER_S).level is Level.WARN
    assert dict(one.status(0, 0).values)["errors: timeout"] == "1"
    assert one.status(0, 62 * NS_PER_S).level is Level.OK


def test_three_errors_in_a_row_and_a_model_that_hangs_are_errors():
    one = health()
    for _ in range(3):
        one.see(ErrorCode.BACKEND, "no key", 0.0, 0)
    status = one.status(0, 300 * NS_PER_S)
    assert (status.level, status.message) == (
        Level.ERROR,
        "no answer to the last requests: no key",
    )
    one.see(0, "", 0.1, 300 * NS_PER_S)
    one.busy_since_ns = 300 * NS_PER_S
    assert one.status(0, 305 * NS_PER_S).level is not Level.ERROR
    hung = one.status(0, 311 * NS_PER_S)
    assert (hung.level, hung.message) == (
        Level.ERROR,
        "the model has been at one request for 11 s",
    )
