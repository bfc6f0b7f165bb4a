"""Storyboards show the interaction that they name; a clip and its truth file agree."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline, box_distance, point_in_polygon
from ssp_core.motion.encounter import CORRIDOR_MARGIN_M, encounter, is_observable
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.actors import Actor, Line, Ramp, SteeredMotion, Turning
from ssp_ot_controller.camera.clip import truth, truth_path, write_clip
from ssp_ot_controller.camera.renderer.render import BRAKE_MPS2
from ssp_ot_controller.camera.storyboards import (
    INTERACTIONS,
    LaneCounts,
    Storyboard,
    storyboard,
)

seeds = st.integers(0, 2**31)


def partner(states: tuple[ObjectState, ...]) -> ObjectState:
    return next(s for s in states if s.role is Role.OT)


def vut(states: tuple[ObjectState, ...]) -> ObjectState:
    return next(s for s in states if s.role is Role.VUT)


@given(start=st.floats(0, 5), duration=st.floats(0.1, 5), change=st.floats(-10, 10))
@settings(max_examples=60)
def test_speed_is_the_derivative_of_the_position(
    start: float, duration: float, change: float
) -> None:
    line = Line(3.0, 4.0, (Ramp(start, duration, change),))
    h = 1e-5
    for t in np.linspace(0.05, 11.0, 23):
        slope = (line.position(t + h) - line.position(t - h)) / (2 * h)
        assert slope == pytest.approx(line.speed(t), abs=1e-4)
    assert line.speed(11.0) == pytest.approx(4.0 + change)


@given(speed=st.floats(5.0, 20.0), share=st.floats(-0.9, 0.9), half=st.floats(0.5, 3.0))
@settings(max_examples=40)
def test_steering_keeps_the_speed_on_the_path(speed: float, share: float, half: float) -> None:
    ramps = (Ramp(1.0, half, share * speed), Ramp(1.0 + half, half, -share * speed))
    actor = Actor(
        "a", ObjectClass.CAR, Role.OT, SteeredMotion(3.0, speed, ramps), Line(0.0, 0.0, ramps)
    )
    h = 1e-5
    for t in np.linspace(0.05, 9.0, 19):
        slope = (actor.along.position(t + h) - actor.along.position(t - h)) / (2 * h)
        assert slope == pytest.approx(actor.along.speed(t), abs=1e-3)
        assert actor.state(t).speed_mps == pytest.approx(speed)
        assert actor.state(t).acceleration_mps2 == pytest.approx(0.0, abs=1e-6)
    assert actor.along.position(0.5) == pytest.approx(3.0 + 0.5 * speed)


def test_one_that_turns_moves_as_its_state_says() -> None:
    """Straight on for 4 m at 3 m/s, a quarter of a circle of 6 m, and straight on."""
    car = Turning("a", ObjectClass.CAR, Role.OT, Line(0.0, 3.0), (50.0, 3.0), 4.0, 6.0)
    h = 1e-5
    turn_s = 4.0 / 3.0, (4.0 + 3.0 * math.pi) / 3.0
    for t in np.linspace(0.05, 7.0, 31).tolist():
        before, now, after = (car.state(t + dt) for dt in (-h, 0.0, h))
        vx, vy = (after.x_m - before.x_m) / (2 * h), (after.y_m - before.y_m) / (2 * h)
        assert math.hypot(vx, vy) == pytest.approx(now.speed_mps) == 3.0
        along = 3.0 * math.cos(now.yaw_rad), 3.0 * math.sin(now.yaw_rad)
        assert (vx, vy) == pytest.approx(along, abs=1e-3)
        assert now.yaw_rate_radps == (0.5 if turn_s[0] < t < turn_s[1] else 0.0)
    end = car.state(7.0)
    assert (end.x_m, end.y_m) == pytest.approx((40.0, -3.0 - (21.0 - 4.0 - 3.0 * math.pi)))


def test_an_oncoming_turn_needs_an_oncoming_lane() -> None:
    with pytest.raises(InputError, match="1 to 4 oncoming ones"):
        storyboard("oncoming_turn", 1, LaneCounts(1, 0))
    # The way to the left is a connecting road of its own.
    both = [storyboard(name, 1).road.junction for name in ("crossing_car", "oncoming_turn")]
    assert len(both[1]) == len(both[0]) + 1
    assert both[1][-1].pieces[0].start_curvature_1pm > 0.0


def test_state_of_an_actor_that_turns_sideways() -> None:
    actor = Actor(
        "a", ObjectClass.CAR, Role.OT, Line(0.0, 3.0), Line(1.0, 0.0, (Ramp(1.0, 1.0, -4.0),))
    )
    before, after = actor.state(0.0), actor.state(5.0)
    assert (before.yaw_rad, before.speed_mps, before.acceleration_mps2) == (0.0, 3.0, 0.0)
    assert after.speed_mps == pytest.approx(5.0)
    assert after.yaw_rad == pytest.approx(-0.9273, abs=1e-4)


@given(seed=seeds)
@settings(max_examples=25)
def test_cut_in_comes_from_the_left_and_the_vut_brakes(seed: int) -> None:
    board = storyboard("cut_in", seed)
    series = [board.states(t) for t in board.times()]
    first, last = series[0], series[-1]
    assert partner(first).y_m - vut(first).y_m == pytest.approx(3.4)
    assert partner(last).y_m == pytest.approx(vut(last).y_m, abs=1e-6)
    assert partner(last).x_m - partner(last).size.rear_m > vut(last).x_m + vut(last).size.front_m
    speeds = [vut(s).speed_mps for s in series]
    assert speeds[: round(3 * board.fps)] == [speeds[0]] * round(3 * board.fps)
    assert speeds[-1] < speeds[0] - 3.0
    assert all(partner(s).acceleration_mps2 > BRAKE_MPS2 for s in series)  # its lamps stay dark
    assert min(box_distance(vut(s).box, partner(s).box) for s in series) > 2.0


@given(seed=seeds)
@settings(max_examples=25)
def test_pedestrian_crosses_from_the_right_and_the_vut_brakes(seed: int) -> None:
    board = storyboard("vru_crossing", seed)
    series = [board.states(t) for t in board.times()]
    first, last = partner(series[0]), partner(series[-1])
    assert first.object_class is ObjectClass.PEDESTRIAN
    assert first.y_m < board.road.right_edge_m
    assert first.speed_mps == 0.0
    assert last.y_m > board.vut.state(0.0).y_m + 2.0
    assert vut(series[-1]).speed_mps == pytest.approx(0.0, abs=1e-9)
    assert min(box_distance(vut(s).box, partner(s).box) for s in series) > 2.0


@given(seed=seeds)
@settings(max_examples=25)
def test_the_car_ahead_brakes_abruptly_and_the_vut_late(seed: int) -> None:
    board = storyboard("lead_braking", seed)
    series = [board.states(t) for t in board.times()]
    path = Polyline([(0.0, 0.0), (400.0, 0.0)])
    meetings = [encounter(vut(s), partner(s), path) for s in series]
    braking = [
        is_observable("braking", m, partner(s)) for m, s in zip(meetings, series, strict=True)
    ]
    begins = braking.index(True)
    assert 2.5 < begins / board.fps < 4.0
    assert all(braking[begins : begins + round(1.5 * board.fps)])  # brake lamps shine meanwhile
    assert min(partner(s).acceleration_mps2 for s in series) < -4.0
    late = begins + round(board.fps)
    assert vut(series[late]).speed_mps == vut(series[0]).speed_mps
    assert min(m.ttc_s for m in meetings[:begins]) > 2.5
    assert min(m.ttc_s for m in meetings) < 2.5
    assert meetings[-1].ttc_s == math.inf  # the gap opens again
    assert min(box_distance(vut(s).box, partner(s).box) for s in series) > 2.0
    assert {(partner(s).y_m, vut(s).y_m) for s in series} == {(0.0, 0.0)}


def hidden_share(board: Storyboard, t_s: float) -> float:
    """Share of the pedestrian's width that the truck hides from the camera, seen from above."""
    states = {s.object_id: s for s in board.states(t_s)}
    eye_x, eye_y = states["vut"].pose.to_parent(board.camera.forward_m, 0.0)
    person, truck = states["ot1"], states["ot2"].box
    hidden = 0
    for k in range(11):
        x, y = person.pose.to_parent(0.0, 0.0)
        y += person.size.width_m * (k / 10 - 0.5)
        ways = [(eye_x + u * (x - eye_x), eye_y + u * (y - eye_y)) for u in np.linspace(0, 1, 400)]
        hidden += any(point_in_polygon(a, b, truck.corners()) for a, b in ways)
    return hidden / 11


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_a_pedestrian_steps_out_from_behind_a_parked_truck(seed: int) -> None:
    board = storyboard("occluded_crossing", seed)
    series = [{s.object_id: s for s in board.states(t)} for t in board.times()]
    steps = next(k for k, s in enumerate(series) if s["ot1"].speed_mps > 0.0)
    assert [hidden_share(board, t) for t in board.times()[:steps:12]] == [1.0] * len(
        range(0, steps, 12)
    )
    assert hidden_share(board, board.times()[steps] + 1.2) == 0.0
    truck = [s["ot2"] for s in series]
    assert {(s.x_m, s.y_m, s.speed_mps) for s in truck} == {(truck[0].x_m, truck[0].y_m, 0.0)}
    corridor = truck[0].y_m + truck[0].size.width_m / 2  # its left side, beside the VUT's y = 0
    assert corridor < -(series[0]["vut"].size.width_m / 2 + CORRIDOR_MARGIN_M)
    assert series[0]["ot1"].x_m - truck[0].x_m - truck[0].size.front_m > 1.0
    brakes = next(k for k, s in enumerate(series) if s["vut"].acceleration_mps2 < 0.0)
    assert brakes / board.fps > steps / board.fps + 1.0
    assert series[-1]["vut"].speed_mps == pytest.approx(0.0, abs=1e-9)
    assert series[-1]["ot1"].y_m > 2.0
    assert min(box_distance(s["vut"].box, s["ot1"].box) for s in series) > 2.0
    assert min(box_distance(s["ot2"].box, s["ot1"].box) for s in series) > 0.9
    assert min(box_distance(s["ot2"].box, s["vut"].box) for s in series) > 0.5


@pytest.mark.parametrize("scenario", INTERACTIONS)
def test_seed_varies_the_clip_and_only_the_seed(scenario: str) -> None:
    assert storyboard(scenario, 4) == storyboard(scenario, 4)
    assert storyboard(scenario, 4) != storyboard(scenario, 5)


def test_unknown_scenario() -> None:
    with pytest.raises(InputError, match="u_turn"):
        storyboard("u_turn", 1)


@pytest.fixture
def short_board() -> Storyboard:
    board = storyboard("vru_crossing", 2)
    camera = board.camera.model_copy(update={"width_px": 160, "height_px": 96})
    return replace(board, camera=camera, duration_s=0.5)


def test_clip_and_truth_agree(short_board: Storyboard, tmp_path: Path) -> None:
    video = tmp_path / "made" / "clip.mp4"
    drawn: list[int] = []
    write_clip(short_board, video, lambda: drawn.append(1))
    capture = cv2.VideoCapture(str(video))
    frames = 0
    while capture.read()[0]:
        frames += 1
    rate, width = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_WIDTH)
    capture.release()
    found = json.loads(truth_path(video).read_text())
    assert truth_path(video).name == "clip.truth.json"
    assert (frames, len(drawn), len(found["frames"])) == (12, 12, 12)
    assert (rate, width) == (24.0, 160.0)
    assert found == json.loads(json.dumps(truth(short_board)))


def test_truth_holds_what_labels_need(short_board: Storyboard) -> None:
    found = truth(short_board)
    assert (found["schema"], found["scenario"]) == ("ssp.truth/1", "vru_crossing")
    frame = found["frames"][3]
    assert frame["t_s"] == pytest.approx(3 / 24)
    assert [o["object_id"] for o in frame["objects"]] == ["oncoming_car", "ot1", "vut"]
    assert [o["role"] for o in frame["objects"]] == ["traffic", "ot", "vut"]
    assert frame["objects"][1]["object_class"] == "pedestrian"
    assert found["ego_speed_mps"][3]["speed_mps"] == frame["objects"][2]["speed_mps"]
    assert found["camera"]["hfov_deg"] == 66.0
