"""The backends that look at no frame: numbers, words, and what they refuse."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError, PeerError
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import make_backend, respond
from ssp_vla_bridge.backends.perfect import Perfect, PerfectLabel
from ssp_vla_bridge.messages import Request, Response, response_to_json
from ssp_vla_bridge.trajectory import interpolate


def run(name, options, request):
    response = respond(make_backend(name, options), name, request).response
    return response, adapt("waypoints", response).trajectory


def inferred(trajectory):
    """Actions and feasibility, computed here from METHOD 6.6 on its own."""
    (s0, l0), (s1, l1), (s2, l2) = (interpolate(trajectory, t) for t in (0.0, 0.5, 1.0))
    v1, v2 = (s1 - s0) / 0.5, (s2 - s1) / 0.5
    a = (v2 - v1) / 0.5
    if v2 <= 0.5:
        lon = "stop"
    elif a <= -0.5:
        lon = "decelerate"
    elif a >= 0.5:
        lon = "accelerate"
    else:
        lon = "maintain"
    lat = "left" if l2 - l0 >= 0.3 else "right" if l2 - l0 <= -0.3 else "straight"
    steps = [(s1 - s0, l1 - l0), (s2 - s1, l2 - l1)]
    feasible = abs(a) <= 8 and all(
        ds >= -0.2 and math.hypot(ds, dl) / 0.5 <= 25 and abs(dl) / 0.5 <= 5 for ds, dl in steps
    )
    return lon, lat, feasible


def test_constant_velocity_straight(make_request, straight_history):
    response, trajectory = run("constant_velocity", {}, make_request(history=straight_history(8.0)))
    assert response.text == "I keep my speed and stay in my lane."
    assert trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert trajectory.x_m == pytest.approx((0, 4, 8, 12, 16))
    assert trajectory.y_m == pytest.approx((0, 0, 0, 0, 0))


def test_constant_velocity_on_a_circle_to_the_left(make_request, straight_history):
    history = straight_history(10.0, yaw_rate_radps=0.5)  # radius 20 m
    response, trajectory = run("constant_velocity", {}, make_request(history=history))
    assert trajectory.x_m[2] == pytest.approx(20 * math.sin(0.5))
    assert trajectory.y_m[2] == pytest.approx(20 * (1 - math.cos(0.5)))
    assert "steer to the left" in response.text


def test_constant_velocity_at_another_step(make_request, straight_history):
    request = make_request(history=straight_history(8.0))
    task = replace(request.task, trajectory_step_s=0.1, trajectory_horizon_s=2.0)
    _, trajectory = run("constant_velocity", {}, replace(request, task=task))
    assert len(trajectory.t_s) == 21
    assert trajectory.x_m[1] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("speed_mps", "acceleration_mps2", "words"),
    [
        (8.0, 0.49, "I keep my speed"),
        (8.0, 0.51, "I accelerate"),
        (8.0, -0.49, "I keep my speed"),
        (8.0, -0.51, "I slow down"),
        (0.5, 0.0, "I stop"),
        (0.51, 0.0, "I keep my speed"),
    ],
)
def test_constant_velocity_says_what_the_history_shows(
    make_request, straight_history, speed_mps, acceleration_mps2, words
):
    history = straight_history(speed_mps, acceleration_mps2)
    response, _ = run("constant_velocity", {}, make_request(history=history))
    assert response.text == f"{words} and stay in my lane."


def test_constant_velocity_without_a_history_has_no_trajectory(make_request):
    response, trajectory = run("constant_velocity", {}, make_request())
    assert response.arrays == ()
    assert trajectory is None
    assert "not known" in response.text


def test_constant_velocity_believes_no_unknown_history(make_request, straight_history):
    request = replace(make_request(history=straight_history(8.0)), ego_provenance="unknown")
    assert run("constant_velocity", {}, request)[0].arrays == ()


def test_constant_velocity_never_looks_at_frames(make_request, straight_history):
    request = make_request(history=straight_history(8.0))
    backend = make_backend("constant_velocity", {})
    assert backend.answer(request) == backend.answer(replace(request, frames=()))


def test_silent_says_nothing(make_request):
    response, trajectory = run("silent", {}, make_request())
    assert (response.text, response.arrays, response.error_code) == ("", (), 0)
    assert trajectory is None


def write_labels(tmp_path, *labels):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps({"schema": "ssp.labels/1", "labels": list(labels)}))
    return str(path)


LABEL = {
    "t_s": 1.0,
    "phase": "conflict",
    "risk_visible": True,
    "objects": ["pedestrian", "car"],
    "position": "front_right",
    "motion": "crossing_from_right",
    "conflict": "active",
    "lon_actions": ["maintain", "stop"],
    "lat_actions": ["straight"],
}


def test_perfect_answers_the_label_at_the_clip_time(tmp_path, make_request, straight_history):
    options = {"labels_file": write_labels(tmp_path, LABEL), "clip_start_ns": 9 * 10**9}
    response, trajectory = run("perfect", options, make_request(history=straight_history(8.0)))
    assert response.text == (
        "I watch a pedestrian and a car. The pedestrian is ahead on the right and is crossing "
        "from the right. A collision with the pedestrian is imminent. I stop and stay in my lane."
    )
    assert inferred(trajectory) == ("stop", "straight", True)


def test_perfect_without_a_label_near_says_so(tmp_path, make_request):
    options = {"labels_file": write_labels(tmp_path, LABEL)}
    response, _ = run("perfect", options, make_request())
    assert response.error_code == 2
    assert "clip_start_ns" in response.error_msg


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"motion": "flying"}, r"labels\[0\].motion"),
        ({"t_s": "one"}, r"labels\[0\].t_s"),
        ({"lon_actions": []}, r"labels\[0\].lon_actions"),
    ],
)
def test_perfect_names_what_is_wrong_in_the_labels(tmp_path, change, field):
    path = write_labels(tmp_path, {**LABEL, **change})
    with pytest.raises(InputError, match=field):
        make_backend("perfect", {"labels_file": path})


def test_perfect_needs_a_labels_file():
    with pytest.raises(InputError, match="labels_file"):
        make_backend("perfect", {})


labels = st.builds(
    PerfectLabel,
    t_s=st.just(0.0),
    objects=st.none() | st.lists(st.sampled_from(OBJECTS), max_size=3, unique=True).map(tuple),
    position=st.none() | st.sampled_from(POSITIONS),
    motion=st.none() | st.sampled_from(MOTIONS),
    conflict=st.none() | st.sampled_from(CONFLICTS),
    lon_actions=st.lists(st.sampled_from(LON_ACTIONS), min_size=1, unique=True).map(tuple),
    lat_actions=st.lists(st.sampled_from(LAT_ACTIONS), min_size=1, unique=True).map(tuple),
)


@settings(max_examples=100, deadline=None)
@given(labels, st.none() | st.floats(0, 40))
def test_perfect_is_feasible_allowed_and_defensive(label, speed_mps):
    from ssp_vla_bridge.messages import EgoSample

    history = () if speed_mps is None else (EgoSample(0.0, 0.0, 0.0, 0.0, speed_mps, 0.0),)
    request = Request("r", 0, (), None, history, "measured" if history else "unknown")
    answer = Perfect((label,), 0).answer(request)
    response = Response("r", 0, "p", "p/1", answer.text, answer.arrays)
    lon, lat, feasible = inferred(adapt("waypoints", response).trajectory)
    assert feasible
    assert lon in label.lon_actions
    assert lat in label.lat_actions
    if {"decelerate", "stop"} & set(label.lon_actions):
        assert lon in ("decelerate", "stop")
    words = {
        "stop": "I stop",
        "decelerate": "I slow down",
        "maintain": "I keep my speed",
        "accelerate": "I accelerate",
    }
    assert words[lon] in answer.text


def stored(tmp_path, *responses):
    path = tmp_path / "raw.jsonl"
    path.write_text("".join(json.dumps(response_to_json(r)) + "\n" for r in responses))
    return {"file": str(path)}


def test_recorded_gives_the_stored_answer_about_the_frame(tmp_path, make_request, make_response):
    response = make_response([(0, 0), (4, 0), (8, 0)], text="first")
    other = replace(response, request_id="r2", stamp_ns=5, text="second")
    options = stored(tmp_path, response, other)
    assert run("recorded", options, make_request("r2", 5))[0].text == "second"
    # Each driven run counts its questions from 1.
    assert run("recorded", options, make_request("r2"))[0].text == "first"
    by_stamp, trajectory = run("recorded", options, make_request("new", 10 * 10**9))
    assert by_stamp.text == "first"
    assert trajectory.x_m == (0.0, 4.0, 8.0)


def test_recorded_repeats_no_error_as_an_answer(tmp_path, make_request, make_response):
    options = stored(tmp_path, replace(make_response(), error_code=1, error_msg="too slow"))
    backend = make_backend("recorded", options)
    with pytest.raises(PeerError, match="too slow"):
        backend.answer(make_request("r1"))
    with pytest.raises(PeerError, match=r"no answer is stored.*a frame 0\.300 s away"):
        backend.answer(make_request("x", make_response().stamp_ns + 300_000_000))


def test_recorded_names_file_and_line(tmp_path, make_response):
    options = stored(tmp_path, make_response())
    path = tmp_path / "raw.jsonl"
    for extra in ("{", "{}", "NaN"):
        path.write_text(path.read_text().splitlines()[0] + "\n" + extra + "\n")
        with pytest.raises(InputError, match=r"raw.jsonl:2"):
            make_backend("recorded", options)
    path.write_text("\n")
    with pytest.raises(InputError, match="no responses"):
        make_backend("recorded", options)
    with pytest.raises(InputError, match="file"):
        make_backend("recorded", {})
