"""Requests, answers and health as JSON: whole round trips, and what is wrong is named."""

from __future__ import annotations

import base64
import contextlib
import json
import math
from dataclasses import asdict, fields, replace

from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_vla_bridge.http_messages import (
    Health,
    ServiceAnswer,
    answer_from_json,
    health_from_json,
    parse_json,
    request_to_json,
)
from ssp_vla_bridge.messages import CameraGeometry, NativeArray, Request, Response, response_to_json

SCHEMA = {"schema": "ssp.vla_http/1"}
ANSWER = [field.name for field in fields(ServiceAnswer)]
CAMERA = CameraGeometry(470.0, 470.5, 359.5, 202.0, 720, 405, None, 0.03)


def wired(value):
    """Return a value as it arrives at the other end."""
    return parse_json(json.dumps(value, allow_nan=False).encode())


def test_a_request_is_sent_whole(make_request, make_response, straight_history):
    request = make_request(history=straight_history(8.0, -0.3, 0.1), camera=CAMERA)
    route = ((0.0, 0.0), (2.0, -0.5))
    previous = make_response([(0, 0), (math.inf, 1)])
    request = replace(request, previous=previous, route_m=route)
    sent = wired(request_to_json(request, "in words"))
    assert (sent.pop("schema"), sent.pop("prompt")) == ("ssp.vla_http/1", "in words")
    assert sent.keys() == {field.name for field in fields(Request)}
    assert base64.b64decode(sent["frames"][0]["jpeg_base64"]) == request.frames[0].jpeg
    assert sent["history"] == [asdict(sample) for sample in request.history]
    assert sent["camera"] == asdict(CAMERA)
    assert sent["previous"]["arrays"][0]["data"] == [0.0, 0.0, "inf", 1.0]
    assert wired(request_to_json(make_request()))["previous"] is None


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
    stored = response_to_json(Response("r1", 0, "m", "m/1", text, given_arrays, decoding))
    found = answer_from_json(wired({key: stored[key] for key in ANSWER} | SCHEMA))
    assert found == ServiceAnswer("r1", "m/1", text, given_arrays, decoding)


def test_health_survives_the_wire():
    for health in (Health("m/1", True), Health("", False, "loading")):
        assert health_from_json(asdict(health) | SCHEMA) == health


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(json_values, st.sampled_from(["text", "arrays", "decoding", "model_id", "schema", ""]))
def test_nothing_but_an_input_error_comes_of_anything(value, place):
    answer = {**asdict(ServiceAnswer("r", "m", "x", (), {})), **SCHEMA, place: value}
    for read in (answer_from_json, health_from_json):
        for one in (value, answer):
            with contextlib.suppress(InputError):
                read(one)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.text('[]{}",:0123456789eE+-.nulltrfasNIiy \\ud8', max_size=60))
def test_no_body_raises_anything_else(body):
    with contextlib.suppress(InputError):
        parse_json(body if isinstance(body, bytes) else body.encode())


def test_the_centre_line_stands_in_a_request_where_it_is_given_alone() -> None:
    request = Request("1", 0, ())
    assert "route_m" not in request_to_json(request)
    line = ((0.0, 0.0), (2.0, -0.5))
    assert request_to_json(replace(request, route_m=line))["route_m"] == [[0.0, 0.0], [2.0, -0.5]]
