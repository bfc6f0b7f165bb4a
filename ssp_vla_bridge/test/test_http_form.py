"""Requests, answers and health as JSON: whole round trips, and what is wrong is named."""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_vla_bridge.http_messages import (
    Health,
    ServiceAnswer,
    answer_from_json,
    answer_to_json,
    health_from_json,
    health_to_json,
    parse_json,
    request_from_json,
    request_to_json,
)
from ssp_vla_bridge.messages import CameraGeometry, NativeArray, Response

CAMERA = CameraGeometry(470.0, 470.5, 359.5, 202.0, 720, 405, None, 0.03)


def wired(value):
    """What arrives of a value that is sent."""
    return parse_json(json.dumps(value, allow_nan=False).encode())


def test_a_request_survives_the_wire(make_request, make_response, straight_history):
    request = make_request(history=straight_history(8.0, -0.3, 0.1), camera=CAMERA)
    previous = make_response([(0, 0), (math.inf, 1)])
    for one in (request, make_request(), replace(request, previous=previous)):
        assert request_from_json(wired(request_to_json(one, "in words"))) == one


floats = st.floats(allow_nan=False)
arrays = st.builds(
    NativeArray,
    st.text(max_size=5),
    st.lists(st.integers(-1, 9), max_size=3).map(tuple),
    st.lists(floats, max_size=5).map(tuple),
    st.text(max_size=5),
    st.text(max_size=5),
    floats,
    floats,
)
facts = st.dictionaries(st.text(max_size=5), st.none() | st.text(max_size=5) | st.integers())


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=20), st.lists(arrays, max_size=2).map(tuple), facts)
def test_an_answer_survives_the_wire(text, given_arrays, decoding):
    answer = ServiceAnswer("r1", "m/1", text, given_arrays, decoding)
    assert answer_from_json(wired(answer_to_json(answer))) == answer


def test_health_survives_the_wire():
    for health in (Health("m/1", True), Health("", False, "loading")):
        assert health_from_json(wired(health_to_json(health))) == health


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(json_values, st.sampled_from(["text", "arrays", "decoding", "model_id", "schema", ""]))
def test_nothing_but_an_input_error_comes_of_anything(value, place):
    answer = {**answer_to_json(ServiceAnswer("r", "m", "x", (), {})), place: value}
    for read in (answer_from_json, health_from_json, request_from_json):
        for one in (value, answer):
            with contextlib.suppress(InputError):
                read(one)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.text('[]{}",:0123456789eE+-.nulltrfasNIiy \\ud8', max_size=60))
def test_no_body_raises_anything_else(body):
    with contextlib.suppress(InputError):
        parse_json(body if isinstance(body, bytes) else body.encode())


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("schema",), "ssp.vla_http/2", "schema must be 'ssp.vla_http/1'"),
        (("stamp_ns",), 1.5, "stamp_ns: Input should be a valid integer"),
        (("stamp_ns",), True, "stamp_ns: Input should be a valid integer"),
        (("frames",), {}, "frames: Input should be a valid tuple"),
        (("frames", 0, "jpeg_base64"), "?", "frames[0].jpeg_base64: is no base64"),
        (("frames", 0, "jpeg_base64"), 1, "frames[0].jpeg_base64: must be a string"),
        (("frames", 0, "stamp_ns"), None, "frames[0].stamp_ns: Input should be a valid integer"),
        (("history", 3, "yaw_rad"), "left", "history[3].yaw_rad: must be a number"),
        (("camera", "width_px"), 720.5, "camera.width_px: Input should be a valid integer"),
        (("camera", "fx_px"), None, "camera.fx_px: must be a number"),
        (("camera",), {}, "camera.fx_px: Field required"),
        (("task", "objects"), ["car", 1], "task.objects[1]: Input should be a valid string"),
        (("task", "trajectory_step_s"), "soon", "task.trajectory_step_s: must be a number"),
        (("prompt",), 5, "prompt: must be a string"),
        (("previous",), {}, "previous: schema must be 'ssp.response/1'"),
        (("mood",), 1, "mood: Unexpected keyword argument"),
    ],
)
def test_what_is_wrong_in_a_request_is_named(make_request, straight_history, path, value, words):
    sent = wired(request_to_json(make_request(history=straight_history(8.0), camera=CAMERA)))
    at = sent
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(InputError) as caught:
        request_from_json(sent)
    assert words in str(caught.value)


def test_an_array_of_an_answer_has_the_form_that_is_stored(make_response):
    from ssp_vla_bridge.messages import response_to_json

    response: Response = make_response([(0, math.nan), (-math.inf, 1)])
    answer = ServiceAnswer("r1", "m/1", "", response.arrays, {})
    assert answer_to_json(answer)["arrays"] == response_to_json(response)["arrays"]
