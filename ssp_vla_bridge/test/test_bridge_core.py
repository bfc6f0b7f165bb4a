"""Requests, responses, the queue of requests and the one function that answers."""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_vla_bridge.backend import BACKENDS, check_options, make_backend, parse_options, respond
from ssp_vla_bridge.bridge import (
    MOST_AT_ONCE,
    MOST_HELD,
    RELEASE_PERIOD_NS,
    AnswerQueue,
    RequestQueue,
)
from ssp_vla_bridge.messages import (
    Answer,
    EgoSample,
    ErrorCode,
    Frame,
    NativeArray,
    Response,
    request_problems,
    response_from_json,
    response_to_json,
)


class Raising:
    model_id = "raising/1"

    def answer(self, request):
        raise RuntimeError("weights\nare lost")


class Echo:
    model_id = "echo/1"

    def answer(self, request):
        return Answer(request.request_id, decoding={"temperature": 0})


def test_a_good_request_has_no_problems(make_request, straight_history):
    assert request_problems(make_request(history=straight_history(8.0))) == ()


def test_garbage_cut_off_and_missing_frames_are_problems(make_request, grey_jpeg):
    assert request_problems(make_request(jpegs=[])) == ("it has no frames",)
    for bad in (b"", b"\x00" * 100, b"\xff\xd8garbage\xff\xd9", grey_jpeg[:-50]):
        (problem,) = request_problems(make_request(jpegs=[grey_jpeg, bad]))
        assert "frames[1]" in problem
    assert request_problems(make_request(jpegs=[grey_jpeg + b"\0\0\0"])) == ()


def test_frames_of_the_future_or_out_of_order_are_problems(make_request, grey_jpeg):
    request = make_request(jpegs=[grey_jpeg, grey_jpeg])
    late = replace(request, frames=(Frame(request.stamp_ns + 1, grey_jpeg),))
    assert "later" in request_problems(late)[0]
    assert "rise" in request_problems(replace(request, frames=request.frames[::-1]))[0]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_history_that_is_not_finite_is_a_problem(make_request, value):
    history = (EgoSample(0.0, 0.0, 0.0, 0.0, value, 0.0),)
    assert "finite" in request_problems(make_request(history=history))[0]


def test_history_order_and_future_are_problems(make_request, straight_history):
    history = straight_history(8.0)
    assert "rise" in request_problems(make_request(history=history[::-1]))[0]
    future = (replace(history[-1], t_s=0.1),)
    assert "after" in request_problems(make_request(history=future))[0]


@pytest.mark.parametrize(
    ("step_s", "horizon_s"), [(0.0, 2.0), (math.nan, 2.0), (3.0, 2.0), (0.5, 1e9), (0.5, math.inf)]
)
def test_a_task_without_a_plannable_horizon_is_a_problem(make_request, step_s, horizon_s):
    request = make_request()
    task = replace(request.task, trajectory_step_s=step_s, trajectory_horizon_s=horizon_s)
    assert request_problems(replace(request, task=task))


def test_respond_carries_id_stamp_and_decoding(make_request):
    response = respond(Echo(), "echo", make_request("abc", 7_000)).response
    assert (response.request_id, response.stamp_ns) == ("abc", 7_000)
    assert (response.model, response.model_id, response.text) == ("echo", "echo/1", "abc")
    assert response.decoding == {"temperature": 0}
    assert response.error_code == ErrorCode.NONE


@pytest.mark.parametrize(
    ("decoding", "code"),
    [
        ({"finish_reason": "abort"}, ErrorCode.BROKEN_OFF),
        ({"stages": [{"name": "motion", "finish_reason": "error"}]}, ErrorCode.BROKEN_OFF),
        ({"finish_reason": "SAFETY"}, ErrorCode.DECLINED),
        ({"finish_reason": "length"}, ErrorCode.NONE),
        ({"finish_reason": None, "stages": "none"}, ErrorCode.NONE),
        ({"finish_reason": 7}, ErrorCode.NONE),
    ],
)
def test_an_answer_that_its_service_broke_off_is_none(make_request, decoding, code):
    backend = SimpleNamespace(model_id="m/1", answer=lambda _: Answer("I brake.", (), decoding))
    response = respond(backend, "m", make_request()).response
    assert (response.error_code, response.text) == (code, "" if code else "I brake.")


def test_an_exception_becomes_one_line_and_a_traceback(make_request):
    outcome = respond(Raising(), "m", make_request())
    assert outcome.response.error_code == ErrorCode.BACKEND
    assert outcome.response.error_msg == "RuntimeError: weights are lost"
    assert "Traceback" in outcome.traceback
    assert outcome.response.text == ""


def test_a_bad_request_never_reaches_the_backend(make_request):
    outcome = respond(Raising(), "m", make_request(jpegs=[]))
    assert outcome.response.error_code == ErrorCode.BAD_REQUEST
    assert outcome.traceback == ""


def test_every_registered_backend_names_an_unknown_option():
    for name in BACKENDS:
        with pytest.raises(InputError, match=r"backend_options\.colour"):
            make_backend(name, {"colour": 1})


@pytest.mark.parametrize(
    "name", ["nope", "nope:make", "ssp_vla_bridge.messages:nothing", ":", "", "..a:b"]
)
def test_an_unknown_backend_names_the_known_ones(name):
    with pytest.raises(InputError, match="constant_velocity"):
        make_backend(name, {})


def test_a_backend_of_ones_own_is_module_and_factory():
    backend = make_backend("ssp_vla_bridge.backends.baselines:Silent", {})
    assert backend.model_id.startswith("ssp/silent")


def test_options_are_a_json_object():
    assert parse_options("  ") == {}
    assert parse_options('{"frames": 3}') == {"frames": 3}
    for text in ("[1]", "{", "nul", "[" * 100_000, '{"a": 1, "a": 2}', '{"a": NaN}'):
        with pytest.raises(InputError, match="backend_options"):
            parse_options(text)
    for text in ('{"api_key": "a-key-of-mine",', '"a-key-of-mine"'):
        with pytest.raises(InputError) as caught:
            parse_options(text)
        assert "a-key-of-mine" not in str(caught.value)


def test_option_types():
    check_options("b", {"a": 1, "b": "x"}, {"a": float, "b": str})
    for value in (True, "1"):
        with pytest.raises(InputError, match="type int"):
            check_options("b", {"a": value}, {"a": int})


def test_the_queue_is_bounded_and_in_order(make_request):
    queue = RequestQueue(limit=2, timeout_ns=100)
    first, second = queue.offer(make_request("a"), 0), queue.offer(make_request("b"), 1)
    assert queue.offer(make_request("c"), 2) is None
    assert queue.take() == first
    third = queue.offer(make_request("c"), 3)
    assert [queue.take(), queue.take(), queue.take()] == [second, third, None]


def test_the_queue_answers_each_request_once(make_request):
    queue = RequestQueue(limit=3, timeout_ns=100)
    working = queue.offer(make_request("a"), 0)
    waiting = queue.offer(make_request("b"), 50)
    queue.take()
    assert queue.expire(100) == []
    assert queue.expire(101) == [working]
    assert queue.expire(151) == [waiting]
    assert queue.take() is None
    assert not queue.finish(working)
    fresh = queue.offer(make_request("a"), 200)
    assert queue.finish(fresh)
    assert not queue.finish(fresh)


def test_answers_wait_for_a_listener_as_long_as_they_are_worth_something():
    held = AnswerQueue[str](60 * NS_PER_S)
    assert not held.hold("a", 0)
    assert not held.hold("b", 30 * NS_PER_S)
    assert held.release(False, 60 * NS_PER_S) == ([], 0)
    assert held.release(True, 60 * NS_PER_S) == (["a", "b"], 0)
    assert held.release(True, 60 * NS_PER_S) == ([], 0)
    held.hold("c", 0)
    held.hold("d", 1)
    assert held.release(True, 60 * NS_PER_S + 1) == (["d"], 1)


def test_answers_that_nobody_hears_are_bounded_and_released_as_fast_as_a_queue_takes_them():
    held = AnswerQueue[int](60 * NS_PER_S)
    assert not any(held.hold(k, 0) for k in range(MOST_HELD))
    assert held.hold(MOST_HELD, 0)
    released = []
    for k in range(MOST_HELD // MOST_AT_ONCE):
        now_ns = k * RELEASE_PERIOD_NS
        answers, given_up = held.release(True, now_ns)
        assert (len(answers), given_up) == (MOST_AT_ONCE, 0)
        assert held.release(True, now_ns + RELEASE_PERIOD_NS - 1) == ([], 0)
        released += answers
    assert released == list(range(1, MOST_HELD + 1))


@pytest.mark.parametrize(("limit", "timeout_ns"), [(0, 1), (1, 0)])
def test_the_queue_refuses_limits_that_allow_nothing(limit, timeout_ns):
    with pytest.raises(ValueError, match="positive"):
        RequestQueue(limit, timeout_ns)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)
native_arrays = st.builds(
    NativeArray,
    st.text(max_size=5),
    st.lists(st.integers(0, 5), max_size=3).map(tuple),
    st.lists(st.floats(), max_size=6).map(tuple),
    st.text(max_size=5),
    st.text(max_size=5),
    st.floats(),
    st.floats(),
)
responses = st.builds(
    Response,
    st.text(max_size=8),
    st.integers(-(2**62), 2**62),
    st.text(max_size=8),
    st.text(max_size=8),
    st.text(max_size=20),
    st.lists(native_arrays, max_size=2).map(tuple),
    st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=5), max_size=3),
    st.floats(0, 100),
    st.integers(0, 65535),
    st.text(max_size=8),
)


@settings(max_examples=60, deadline=None)
@given(responses)
def test_json_round_trip_keeps_every_number_and_text(response):
    line = json.dumps(response_to_json(response), allow_nan=False)
    again = response_from_json(json.loads(line))
    # repr, because a NaN must come back and is not equal to itself
    assert repr(again) == repr(response)


@settings(max_examples=100, deadline=None)
@given(json_values, st.sampled_from([*response_to_json(Response("", 0, "", "")), "x"]))
def test_a_malformed_stored_response_is_an_input_error(value, key):
    stored = {**response_to_json(Response("", 0, "", "")), key: value}
    with contextlib.suppress(InputError):  # the only exception that is allowed
        response_from_json(stored, file="raw.jsonl", line=3)


def test_a_malformed_array_names_its_place():
    response = Response("", 0, "", "", arrays=(NativeArray("a", (1,), (1.0,), "f", "m", 0, 0),))
    stored = response_to_json(response)
    stored["arrays"][0]["data"] = ["one"]
    with pytest.raises(InputError, match=r"raw.jsonl:3: arrays\[0\].data"):
        response_from_json(stored, file="raw.jsonl", line=3)
