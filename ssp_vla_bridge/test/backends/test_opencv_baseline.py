"""The seeing baseline on drawn road scenes: it must see, and see nothing but its request."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import respond
from ssp_vla_bridge.backends.opencv_baseline import OpencvBaseline, choose_frames
from ssp_vla_bridge.backends.vision.ground import ground_plane, horizon_row
from ssp_vla_bridge.messages import CameraGeometry, Frame, Request
from ssp_vla_bridge.trajectory import interpolate

NOUNS = ("car", "truck", "pedestrian", "cyclist", "motorcycle", "bus")

CAR_CUTTING_IN = ("car", 9.0, 2.4, 7.0, -1.4)
PEDESTRIAN_CROSSING = ("pedestrian", 16.0, -2.2, 0.0, 1.4)


def answer(request):
    return OpencvBaseline().answer(request)


def mentioned(text):
    return {noun for noun in NOUNS if re.search(rf"\b{noun}\b", text)}


def swapped(text):
    return re.sub(r"left|right", lambda m: {"left": "right", "right": "left"}[m[0]], text)


def test_sees_a_car_that_cuts_in(draw_frames, picture_request):
    text = answer(picture_request(draw_frames(*CAR_CUTTING_IN))).text
    assert text.startswith("A car is ahead on the left and is cutting in from the left.")
    assert text.endswith("I slow down and stay in my lane.")


def test_sees_a_pedestrian_who_crosses(draw_frames, picture_request):
    text = answer(picture_request(draw_frames(*PEDESTRIAN_CROSSING))).text
    assert text.startswith("A pedestrian is ahead on the right and is crossing from the right.")
    assert "A collision with the pedestrian is imminent." in text
    assert text.endswith("I slow down and stay in my lane.")


def test_sees_that_nobody_is_there(draw_frames, picture_request):
    text = answer(picture_request(draw_frames(None, 0, 0, 0, 0))).text
    assert mentioned(text) == set()
    assert "There are no road users that matter to me." in text
    assert text.endswith("I keep my speed and stay in my lane.")


def test_oncoming_and_parked_are_told_apart(draw_frames, picture_request):
    oncoming = answer(picture_request(draw_frames("car", 25.0, 3.5, -8.0, 0.0))).text
    parked = answer(picture_request(draw_frames("car", 16.0, -1.6, 0.0, 0.0))).text
    assert "is oncoming" in oncoming
    assert "is stationary" in parked


@pytest.mark.parametrize("scene", [CAR_CUTTING_IN, PEDESTRIAN_CROSSING])
def test_mirrored_pictures_swap_left_and_right(draw_frames, picture_request, scene):
    pictures = draw_frames(*scene)
    straight = answer(picture_request(pictures)).text
    mirrored = answer(picture_request([cv2.flip(picture, 1) for picture in pictures])).text
    assert "left" in straight or "right" in straight
    assert mirrored == swapped(straight)


def test_black_pictures_change_the_answer(draw_frames, picture_request):
    pictures = draw_frames(*PEDESTRIAN_CROSSING)
    seeing = answer(picture_request(pictures))
    blind = answer(picture_request([np.zeros_like(picture) for picture in pictures]))
    assert "can't see anything" in blind.text
    assert mentioned(blind.text) == set()
    assert blind.text != seeing.text
    assert blind.text.endswith("I slow down and stay in my lane.")


@pytest.mark.parametrize("value", [0, 128, 255])
def test_an_even_picture_shows_nothing(draw_frames, picture_request, value):
    picture = np.full_like(draw_frames(None, 0, 0, 0, 0)[0], value)
    assert "can't see anything" in answer(picture_request([picture] * 3)).text


def test_another_class_changes_the_objects(draw_frames, picture_request):
    for kind, x_m, y_m, vx_mps, vy_mps in (
        ("car", 14.0, 0.0, 8.0, 0.0),
        ("truck", 14.0, 0.0, 8.0, 0.0),
        ("pedestrian", 18.0, -1.5, 0.0, 1.4),
        ("cyclist", 16.0, -1.5, 0.0, 3.5),
    ):
        text = answer(picture_request(draw_frames(kind, x_m, y_m, vx_mps, vy_mps))).text
        assert mentioned(text) == {kind}


def test_the_trajectory_does_what_the_text_says(draw_frames, picture_request):
    for scene, words, faster in (
        ((None, 0, 0, 0, 0), "I keep my speed", 0.0),
        (PEDESTRIAN_CROSSING, "I slow down", -2.0),
    ):
        request = picture_request(draw_frames(*scene))
        response = respond(OpencvBaseline(), "m", request).response
        trajectory = adapt("waypoints", response).trajectory
        x0, x1, x2 = (interpolate(trajectory, t)[0] for t in (0.0, 0.5, 1.0))
        assert words in response.text
        assert ((x2 - x1) - (x1 - x0)) / 0.25 == pytest.approx(faster)
        assert (x1 - x0) / 0.5 == pytest.approx(8.0 + faster * 0.25)


def test_a_standing_vut_stops_for_a_pedestrian_and_then_sets_off(draw_frames, picture_request):
    crossing = draw_frames("pedestrian", 6.0, -1.0, 0.0, 1.4, ego_mps=0.0)
    free = draw_frames(None, 0, 0, 0, 0, ego_mps=0.0)
    assert "I stop and" in answer(picture_request(crossing, ego_mps=0.0)).text
    assert "I accelerate and" in answer(picture_request(free, ego_mps=0.0)).text


def test_unknown_ego_motion_gives_text_only(draw_frames, picture_request):
    given_answer = answer(picture_request(draw_frames(*PEDESTRIAN_CROSSING), ego_mps=None))
    assert given_answer.arrays == ()
    assert "A pedestrian is ahead on the right and is crossing from the right." in (
        given_answer.text
    )


def test_unknown_geometry_is_assumed_and_said(draw_frames, picture_request):
    given_answer = answer(picture_request(draw_frames(*PEDESTRIAN_CROSSING), camera=None))
    assumed = {entry.split("=")[0] for entry in given_answer.decoding["assumed"]}
    assert {"hfov_deg", "height_m", "pitch_down_rad"} <= assumed
    known = answer(picture_request(draw_frames(*PEDESTRIAN_CROSSING)))
    assert {e.split("=")[0] for e in known.decoding["assumed"]} == {"camera_to_bumper_m"}


def test_it_sees_nothing_but_its_request(draw_frames, picture_request):
    """No memory of other requests, of names or of absolute time."""
    request = picture_request(draw_frames(*PEDESTRIAN_CROSSING))
    other = picture_request(draw_frames(*CAR_CUTTING_IN))
    backend = OpencvBaseline()
    first = backend.answer(request)
    backend.answer(other)
    assert backend.answer(request) == first
    later_ns = 10**15
    moved = replace(
        request,
        request_id="another",
        stamp_ns=request.stamp_ns + later_ns,
        frames=tuple(Frame(f.stamp_ns + later_ns, f.jpeg) for f in request.frames),
    )
    assert backend.answer(moved) == first


def test_pictures_beyond_the_look_back_change_nothing(draw_frames, picture_request):
    request = picture_request(draw_frames(*PEDESTRIAN_CROSSING))
    black = cv2.imencode(".jpg", np.zeros((405, 720, 3), np.uint8))[1].tobytes()
    older = tuple(Frame(request.frames[0].stamp_ns - n * 10**8, black) for n in (3, 2, 1))
    assert answer(replace(request, frames=older + request.frames)) == answer(request)


def test_frames_are_chosen_by_time(make_request, grey_jpeg):
    frames = make_request(jpegs=[grey_jpeg] * 15).frames
    ages = [round((frames[-1].stamp_ns - f.stamp_ns) / 1e8) for f in choose_frames(frames)]
    assert ages == [9, 6, 3, 0]
    assert choose_frames(frames[:1]) == [frames[0]]


def test_ground_plane_by_hand():
    camera = CameraGeometry(400.0, 400.0, 319.5, 179.5, 640, 360, 1.5, 0.0)
    plane = ground_plane(camera, (640, 360), 1.0)
    assert plane.horizon_px == pytest.approx(179.5)
    # 40.5 px under the horizon: x = 400 * 1.5 / 40.5
    assert plane.row_x_m[220] == pytest.approx(600 / 40.5)
    assert plane.row_px_per_m[220] == pytest.approx(40.5 / 1.5)
    assert plane.y_m(319.5 - 27.0, 220) == pytest.approx(1.0)
    assert np.isinf(plane.row_x_m[179])
    assert plane.row_px_per_m[179] == 0.0
    half = ground_plane(camera, (640, 360), 0.5)
    assert half.row_x_m[109] == pytest.approx(200 * 1.5 / (109 - 89.5))


def test_a_camera_that_looks_down_sees_the_ground_nearer():
    camera = CameraGeometry(400.0, 400.0, 319.5, 179.5, 640, 360, 1.5, 0.1)
    plane = ground_plane(camera, (640, 360), 1.0)
    assert plane.horizon_px == pytest.approx(179.5 - 400 * math.tan(0.1))
    angle = 0.1 + math.atan(0.5 / 400)
    assert plane.row_x_m[180] == pytest.approx(1.5 / math.tan(angle))


def test_the_horizon_is_found_where_road_lines_meet(draw_frames):
    plane = ground_plane(
        CameraGeometry(470.0, 470.0, 359.5, 202.0, 720, 405, 1.45, 0.03), (720, 405), 1.0
    )
    pictures = draw_frames(None, 0, 0, 0, 0)
    assert horizon_row(pictures[-3:]) == pytest.approx(plane.horizon_px, abs=6.0)
    assert horizon_row([np.zeros((405, 720, 3), np.uint8)]) is None


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 60),
    st.integers(1, 60),
    st.integers(0, 2**32 - 1),
    st.sampled_from([None, 0.0, 12.0]),
    st.sampled_from([None, -0.6, 0.0, 0.9]),
)
def test_any_picture_has_an_answer(width, height, seed, speed_mps, pitch_rad):
    from ssp_vla_bridge.messages import EgoSample

    noise = np.random.default_rng(seed).integers(0, 256, (2, height, width, 3), np.uint8)
    frames = tuple(
        Frame(t_ns, cv2.imencode(".jpg", cv2.resize(p, None, fx=4, fy=4))[1].tobytes())
        for t_ns, p in zip((0, 300_000_000), noise, strict=True)
    )
    camera = None
    if pitch_rad is not None:
        camera = CameraGeometry(
            100.0, 100.0, width * 2.0, height * 2.0, width * 4, height * 4, 1.4, pitch_rad
        )
    history = () if speed_mps is None else (EgoSample(0.0, 0.0, 0.0, 0.0, speed_mps, 0.0),)
    request = Request("r", 300_000_000, frames, camera, history, "measured")
    given_answer = answer(request)
    assert given_answer.text.endswith("stay in my lane.")
    assert bool(given_answer.arrays) == (speed_mps is not None)
