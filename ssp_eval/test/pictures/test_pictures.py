"""Pictures held against states: a drawn clip, and what is done to it (docs/audit.md)."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import CurvePiece, Road, Start
from ssp_core.world.camera import Mounting, intrinsics, project
from ssp_eval.data.audit import PictureCheck
from ssp_eval.pictures.change import Change
from ssp_eval.pictures.compare import (
    SIDES,
    change_check,
    compare_pictures,
    plan_pairs,
    road_checks,
    sides_check,
    turning_check,
)
from ssp_eval.pictures.copies import details_of, same_pictures
from ssp_eval.pictures.footage import Footage, Grey, coarse, pairs_apart, reduced
from ssp_eval.pictures.ground import Pair
from ssp_eval.pictures.repeats import has_many_repeats, repeated_frames, sampled_frames
from ssp_eval.pictures.sides import Sides
from ssp_eval.pictures.turning import Turn, _rotation
from ssp_eval.recordings.sight import Moment, Optics
from ssp_ot_controller.camera.clip import board_of
from ssp_ot_controller.camera.frames import Odometer
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene
from ssp_ot_controller.camera.storyboards import Storyboard

SIZE_PX = (384, 216)
FROM_S, TO_S = 2.2, 6.0
ORDER = "order of the frames"


@dataclass(frozen=True)
class Drive:
    """Frames of a clip with their states."""

    moments: tuple[Moment, ...]
    pictures: tuple[Grey, ...]
    optics: Optics
    road: Road | None = None


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Frames of a pedestrian who crosses, and a VUT that brakes for her."""
    board = board_of("vru_crossing", 3, 2, 2)
    camera = board.camera.model_copy(update={"width_px": SIZE_PX[0], "height_px": SIZE_PX[1]})
    odometer, indicators = Odometer(), Indicators(board.road)
    moments, pictures = [], []
    for index, t_s in enumerate(np.arange(FROM_S, TO_S, 0.1)):
        states = board.states(t_s)
        odometer.update(states)
        blinking = indicators.update(states, seconds_to_ns(t_s))
        vut = board.vut.state(t_s)
        scene = Scene(board.road, vut, states, odometer.snapshot(), blinking)
        drawn = render(scene, board.look, camera, index, board.seed)
        moments.append(Moment(float(t_s), {state.object_id: state for state in states}))
        pictures.append(np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY), np.uint8))
    mounting = Mounting(camera.forward_m, camera.height_m, camera.pitch_down_rad)
    optics = Optics(intrinsics(camera), mounting)
    return Drive(tuple(moments), tuple(pictures), optics, board.road)


def render_drive(
    road: Road, vut: Sequence[ObjectState], board: Storyboard, step_s: float = 0.1
) -> Drive:
    """Frames of a VUT alone on a road."""
    camera = board.camera.model_copy(update={"width_px": SIZE_PX[0], "height_px": SIZE_PX[1]})
    moments, pictures = [], []
    for index, state in enumerate(vut):
        image = render(Scene(road, state, (state,)), board.look, camera, index, board.seed)
        moments.append(Moment(step_s * index, {"vut": state}))
        pictures.append(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))
    mounting = Mounting(camera.forward_m, camera.height_m, camera.pitch_down_rad)
    return Drive(tuple(moments), tuple(pictures), Optics(intrinsics(camera), mounting), road)


def turning_drive(bend_1pm: float) -> Drive:
    """Frames of a VUT that drives 10 m/s in the right lane of a bend, + to the left."""
    board = board_of("vru_crossing", 3, 2, 2)
    piece = CurvePiece(length_m=120.0, start_curvature_1pm=bend_1pm, end_curvature_1pm=bend_1pm)
    road = board.road.model_copy(
        update={
            "origin": Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
            "length_m": 120.0,
            "pieces": [piece],
            "crossing_x_m": None,
        }
    )
    lane_m, radius_m, speed_mps = road.lanes[0].y_m, 1.0 / bend_1pm, 10.0
    vut = []
    for k in range(20):
        angle_rad = bend_1pm * (20.0 + speed_mps * 0.1 * k)
        at = {
            "x_m": (radius_m - lane_m) * math.sin(angle_rad),
            "y_m": radius_m - (radius_m - lane_m) * math.cos(angle_rad),
            "yaw_rad": angle_rad,
            "speed_mps": speed_mps * (1.0 - lane_m * bend_1pm),
            "yaw_rate_radps": speed_mps * bend_1pm,
            "stamp_ns": seconds_to_ns(0.1 * k),
        }
        vut.append(replace(board.vut.state(0.0), **at))
    return render_drive(road, vut, board)


@pytest.mark.parametrize("bend_1pm", [1.0 / 60.0, -1.0 / 40.0])
def test_pictures_of_a_turn_hold_and_their_mirror_images_turn_the_other_way(
    bend_1pm: float,
) -> None:
    turn = turning_drive(bend_1pm)
    found = checks_of(turn)
    assert {name: check.told for name, check in found.items() if check.state == "fails"} == {}
    assert found["speed"].figure == pytest.approx(1.0, abs=0.05)
    assert (found["course of the speed"].figure or 0.0) >= 0.9
    assert found["turning"].figure == pytest.approx(1.0, abs=0.1)
    mirrored = checks_of(_mirrored(turn))
    assert mirrored["turning"].state == "fails"
    assert mirrored["turning"].figure == pytest.approx(-1.0, abs=0.1)


def checks_of(drive: Drive) -> dict[str, PictureCheck]:
    small = {index: coarse(picture) for index, picture in enumerate(drive.pictures)}
    repeated = frozenset[int]()
    if has_many_repeats(small, drive.moments, "vut"):
        repeated = repeated_frames(small, drive.moments, "vut")
    plan = plan_pairs(drive.moments, drive.optics, "vut", ["ot1"], repeated)
    grey = {index: reduced(drive.pictures[index]) for index in plan.frame_indices}
    footage = Footage(drive.moments, grey, drive.optics, "vut")
    return {check.name: check for check in compare_pictures(footage, plan, drive.road).checks}


def failing(drive: Drive) -> set[str]:
    return {name for name, check in checks_of(drive).items() if check.state == "fails"}


def test_pictures_of_these_states_hold(drive: Drive) -> None:
    found = checks_of(drive)
    assert {name: check.told for name, check in found.items() if check.state == "fails"} == {}
    assert {"speed", "ot1"} <= {n for n, check in found.items() if check.state == "holds"}
    assert found["speed"].figure == pytest.approx(1.0, abs=0.1)
    assert checks_of(drive) == found


def _mirrored(drive: Drive) -> Drive:
    flipped = tuple(np.ascontiguousarray(one[:, ::-1]) for one in drive.pictures)
    return replace(drive, pictures=flipped)


def test_lanes_tell_a_mirrored_picture_where_nothing_turns_and_no_object_is_aside(
    drive: Drive,
) -> None:
    """The object is left out: a straight road with a VUT alone."""
    alone = tuple(Moment(m.t_s, {"vut": m.states["vut"]}) for m in drive.moments)
    straight = replace(drive, moments=alone)
    found = checks_of(straight)[SIDES]
    assert found.state == "holds"
    assert failing(_mirrored(straight)) == {SIDES}
    mirrored = checks_of(_mirrored(straight))[SIDES]
    # Reasons stand in pages as they are.
    assert html.escape(mirrored.told) == mirrored.told
    assert mirrored.figure == pytest.approx(-(found.figure or 0.0), abs=0.01)


def test_lanes_that_are_alike_on_both_sides_or_not_known_tell_nothing_and_say_so(
    drive: Drive,
) -> None:
    alone = tuple(Moment(m.t_s, {"vut": m.states["vut"]}) for m in drive.moments)
    straight = replace(drive, moments=alone)
    assert drive.road is not None
    lane = drive.road.lanes[0]
    own_m = drive.moments[0].states["vut"].y_m
    one_lane = drive.road.model_copy(
        update={
            "lanes": [lane.model_copy(update={"y_m": own_m})],
            "sidewalk_left_m": 0.0,
            "sidewalk_right_m": 0.0,
        }
    )
    for road, why in (
        (None, "the recording has no road whose lanes could tell left from right"),
        (one_lane, "the lanes of the road are alike to the left and right of the VUT"),
    ):
        found = checks_of(replace(straight, road=road))[SIDES]
        assert (found.state, found.told) == (
            "not judged",
            f"{why}; nothing else does, so that mirrored pictures would not be seen",
        )
    # The pedestrian of the whole drive walks on one side of the picture.
    found = checks_of(replace(drive, road=None))[SIDES]
    assert found.told.endswith("; the place of ot1 does")


def test_borders_that_fit_both_ways_refuse_nothing() -> None:
    for fit, mirrored, state in (
        (0.6, 0.4, "holds"),
        (0.4, 0.6, "fails"),
        (0.52, 0.55, "not judged"),
        (0.1, 0.35, "not judged"),
    ):
        assert sides_check(Sides(fit, mirrored, 0.6, 20), True, "").state == state
    assert sides_check(None, True, "").state == "not judged"


def shaded(drive: Drive, from_left_m: float, to_left_m: float) -> Drive:
    """Shadows on the road that move at 4 m/s, within a band beside the VUT's middle."""
    pictures = []
    for moment, picture in zip(drive.moments, drive.pictures, strict=True):
        vut, dark = moment.states["vut"], picture.copy()
        view = drive.optics.view(vut.pose)
        for k in range(30):
            start_m = 5.0 * k + 4.0 * moment.t_s
            if not 3.0 < start_m - vut.x_m < 40.0:
                continue
            corners = [
                (start_m + along_m, vut.y_m + left_m, 0.0)
                for along_m, left_m in (
                    (0.0, from_left_m),
                    (0.0, to_left_m),
                    (2.0, to_left_m),
                    (2.0, from_left_m),
                )
            ]
            seen = project(view, corners)
            outline = np.column_stack([seen.u_px, seen.v_px]).round().astype(np.int32)
            cv2.fillPoly(dark, [outline], 20)
        pictures.append(dark)
    return replace(drive, pictures=tuple(pictures))


def test_a_shadow_that_moves_with_its_object_is_not_taken_for_the_road(drive: Drive) -> None:
    """A low sun lays it across one half of the road; on both halves nothing speaks for the road."""
    one_half = shaded(drive, -4.5, -0.5)
    assert checks_of(one_half)["speed"].figure == pytest.approx(1.0, abs=0.1)
    assert checks_of(one_half)["course of the speed"].state == "holds"
    assert "speed" in failing(shaded(drive, -4.5, 4.5))


def _with(change: Callable[[list[Grey]], list[Grey]]) -> Callable[[Drive], Drive]:
    return lambda drive: replace(drive, pictures=tuple(change(list(drive.pictures))))


@pytest.mark.parametrize(
    ("falsify", "check"),
    [
        (_mirrored, "ot1"),
        (_with(lambda all_: all_[::-1]), "speed"),
        (_with(lambda all_: [all_[5]] * len(all_)), "speed"),
        (_with(lambda all_: [all_[min(2 * k, len(all_) - 1)] for k in range(len(all_))]), "speed"),
        (_with(lambda all_: [all_[k // 2] for k in range(len(all_))]), "speed"),
        (_with(lambda all_: all_[10:] + all_[-1:] * 10), "ot1"),
        (_with(lambda all_: [all_[17 * k % len(all_)] for k in range(len(all_))]), ORDER),
    ],
    ids=["mirrored", "reversed", "one picture", "twice as fast", "half as fast", "early", "mixed"],
)
def test_pictures_of_other_states_are_told_apart(
    falsify: Callable[[Drive], Drive], check: str, drive: Drive
) -> None:
    assert check in failing(falsify(drive))


def _twice(all_: list[Grey], noise_levels: float = 0.0) -> list[Grey]:
    chance = np.random.default_rng(1)
    held = [all_[k // 2 * 2] for k in range(len(all_))]
    return [
        np.clip(one + chance.normal(0.0, noise_levels, one.shape), 0, 255).astype(np.uint8)
        for one in held
    ]


@pytest.mark.parametrize("noise_levels", [0.0, 1.0])
def test_a_slower_camera_whose_frames_are_repeated_is_judged_by_those_that_differ(
    drive: Drive, noise_levels: float
) -> None:
    """A camera of 5 Hz that was recorded at 10 Hz, as an encoder may leave it."""
    twice = _with(lambda all_: _twice(all_, noise_levels))(drive)
    found = checks_of(twice)
    assert {name: check.told for name, check in found.items() if check.state == "fails"} == {}
    assert found["speed"].figure == pytest.approx(1.0, abs=0.1)
    assert "ot1" in failing(_mirrored(twice))
    slow = _with(lambda all_: _twice([all_[k // 2] for k in range(len(all_))]))(drive)
    assert "speed" in failing(slow)


def test_frames_that_repeat_are_found_while_the_vut_moves(drive: Drive) -> None:
    def repeats_in(pictures: list[Grey]) -> frozenset[int]:
        small = {index: coarse(one) for index, one in enumerate(pictures)}
        return repeated_frames(small, drive.moments, "vut")

    frames = list(drive.pictures)
    moves = {k for k, m in enumerate(drive.moments) if m.states["vut"].speed_mps >= 2.0}
    assert repeats_in(frames) == frozenset()
    assert repeats_in(_twice(frames)) == {k for k in moves if k % 2}
    # A picture that stays for longer than 0.3 s is none of a slower camera.
    assert repeats_in(frames[:5] + [frames[5]] * 4 + frames[9:]) == {6, 7, 8}
    assert repeats_in(frames[:5] + [frames[5]] * 5 + frames[10:]) == frozenset()
    some = sampled_frames(drive.moments, "vut")
    for pictures, often in ((frames, False), (_twice(frames), True)):
        small = {index: coarse(pictures[index]) for index in some}
        assert has_many_repeats(small, drive.moments, "vut") == often


def test_an_object_that_the_pictures_do_not_hold_is_missed(drive: Drive) -> None:
    moments = tuple(
        Moment(m.t_s, {**m.states, "ot1": replace(m.states["ot1"], y_m=m.states["ot1"].y_m + 3.0)})
        for m in drive.moments
    )
    elsewhere = checks_of(replace(drive, moments=moments))
    assert elsewhere["ot1"].state == "fails"
    # Places from other systems may be off, so this figure refuses nothing.
    assert elsewhere["place of ot1"].state == "shown"


def test_what_shows_too_little_is_not_judged_and_says_so(drive: Drive) -> None:
    night = _with(lambda all_: [np.asarray(one // 40, np.uint8) for one in all_])(drive)
    grey = _with(lambda all_: [np.full_like(one, 120) for one in all_])(drive)
    for changed, why in ((night, "the pictures are dark"), (grey, "the pictures show nothing")):
        found = checks_of(changed)
        assert {check.state for check in found.values()} == {"not judged"}
        assert all(check.told.startswith(why) for check in found.values())


def test_pictures_that_are_too_small_say_so(drive: Drive) -> None:
    small = [cv2.resize(one, (96, 54), interpolation=cv2.INTER_AREA) for one in drive.pictures]
    (told,) = {check.told for check in checks_of(_with(lambda _: small)(drive)).values()}
    assert told == "the pictures are too small: 96 px wide, needed are 240"


def test_a_vut_that_stands_says_so(drive: Drive) -> None:
    first = drive.moments[0].states
    moments = tuple(Moment(m.t_s, {**m.states, "vut": first["vut"]}) for m in drive.moments)
    stands = replace(drive, moments=moments, pictures=(drive.pictures[0],) * len(moments))
    found = checks_of(stands)["speed"]
    assert (found.state, found.told) == (
        "not judged",
        "the VUT stands or creeps in all but 0 pairs of frames",
    )


def pair(t_s: float, recorded_mps: float, seen_mps: float) -> Pair:
    ways_m = np.arange(-20, 61) * 0.1
    return Pair(
        t_s, 0.1, recorded_mps * 0.1, ways_m, np.exp(-(((ways_m - seen_mps * 0.1) / 0.3) ** 2))
    )


def braking(t_s: float) -> float:
    return 12.0 - 4.0 * min(max(t_s - 3.0, 0.0), 2.0)


@pytest.mark.parametrize(("late_s", "state"), [(0.0, "holds"), (0.3, "holds"), (1.0, "fails")])
def test_a_delay_of_the_pictures_is_found(late_s: float, state: str) -> None:
    times_s = np.arange(0.0, 8.0, 0.2)
    found = road_checks([pair(t, braking(t), braking(t - late_s)) for t in times_s])
    (time,) = (check for check in found if check.name == "time")
    assert time.state == state
    assert time.figure == pytest.approx(-late_s, abs=0.1)


def blurred(t_s: float, recorded_mps: float, seen_mps: float) -> Pair:
    """A pair of frames of a road whose detail is coarse: other ways match nearly as well."""
    ways_m = np.arange(-20, 61) * 0.1
    match = 0.6 + 0.3 * np.exp(-(((ways_m - seen_mps * 0.1) / 0.8) ** 2))
    return Pair(t_s, 0.1, recorded_mps * 0.1, ways_m, match)


@pytest.mark.parametrize(
    ("late_s", "state"), [(0.0, "holds"), (0.4, "holds"), (0.7, "fails"), (-1.5, "fails")]
)
def test_a_delay_shows_in_one_braking_on_a_road_of_coarse_detail(late_s: float, state: str) -> None:
    times_s = np.arange(0.0, 8.0, 0.17)
    found = road_checks([blurred(t, braking(t), braking(t - late_s)) for t in times_s])
    (time,) = (check for check in found if check.name == "time")
    assert time.state == state
    assert time.figure == pytest.approx(-late_s, abs=0.1)


def test_a_delay_beyond_the_limit_counts_only_where_no_sound_one_fits_as_well() -> None:
    """Speeds seen in noise: so little is better at a second that it may be chance."""
    chance = np.random.default_rng(3)
    times_s = np.arange(0.0, 8.0, 0.17)
    seen = [braking(t) + chance.normal(0.0, 2.5) for t in times_s]
    pairs = [blurred(t, braking(t), mps) for t, mps in zip(times_s, seen, strict=True)]
    (time,) = (check for check in road_checks(pairs) if check.name == "time")
    assert time.state != "fails"


def test_the_speed_seen_is_finer_than_the_ways_that_were_tried() -> None:
    assert blurred(0.0, 12.0, 12.34).refined_mps == pytest.approx(12.34, abs=0.05)
    assert blurred(0.0, 12.0, 12.34).picture_mps == pytest.approx(12.0)
    # At an end of what was tried there is no parabola.
    assert blurred(0.0, 12.0, 70.0).refined_mps == pytest.approx(60.0)


def test_a_constant_speed_tells_no_delay() -> None:
    found = road_checks([pair(k * 0.2, 12.0, 12.0) for k in range(30)])
    assert [check.state for check in found] == ["holds", "holds", "not judged"]
    # Nor do speeds that were seen badly in one part.
    noisy = [pair(k * 0.2, 12.0, 12.0 if k > 12 else 10.0 + k % 5) for k in range(30)]
    assert road_checks(noisy)[2].state == "not judged"


def test_a_road_without_detail_is_not_judged() -> None:
    flat = [replace(pair(k * 0.2, 12.0, 12.0), match=np.full(81, 0.1)) for k in range(30)]
    assert {check.state for check in road_checks(flat)} == {"not judged"}


def test_artefacts_that_stand_still_are_not_taken_for_the_road() -> None:
    moves = [pair(k * 0.2, 12.0, 12.0) for k in range(12)]
    still = [pair(k * 0.2, 12.0, 0.0) for k in range(12, 30)]
    found = road_checks(moves + still)
    assert {check.state for check in found} == {"not judged"}
    assert found[0].told == (
        "the road could be followed in 12 of 30 pairs of frames; in 18 what is seen stands "
        "still, as artefacts of compression do"
    )
    assert road_checks(moves + still[:8])[0].state == "holds"
    # One and the same picture shows that nothing moved.
    repeated = [replace(one, is_repeated=True) for one in still]
    assert road_checks(moves + repeated)[0].state == "fails"


@pytest.mark.parametrize(
    ("recorded", "seen", "state"),
    [
        (0.06, 0.06, "holds"),
        (0.06, -0.06, "fails"),
        (0.06, 0.0, "fails"),
        (0.0, 0.0, "holds"),
        (0.0, 0.08, "fails"),
    ],
)
def test_turning_is_held_against_the_yaw_rate(recorded: float, seen: float, state: str) -> None:
    assert turning_check([Turn(k * 0.1, recorded, seen) for k in range(10)]).state == state


@pytest.mark.parametrize("yaw_rad", [0.0, 0.012, -0.012])
def test_rotation_is_found_whatever_the_distances(yaw_rad: float) -> None:
    random = np.random.default_rng(4)
    x_m, y_m = random.uniform(6, 80, 200), random.uniform(-15, 15, 200)
    z_m = np.where(random.random(200) < 0.5, -1.4, random.uniform(-1.0, 6.0, 200))
    way_m, ahead_m = 1.3, 1.8
    # The axle turns; the camera sits ahead of it.
    axle = np.array([way_m * math.cos(yaw_rad / 2.0), way_m * math.sin(yaw_rad / 2.0)])
    at = axle + ahead_m * np.array([math.cos(yaw_rad), math.sin(yaw_rad)]) - [ahead_m, 0.0]
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    dx, dy = x_m - at[0], y_m - at[1]
    to_x, to_y = c * dx + s * dy, -s * dx + c * dy
    old = np.column_stack([-y_m / x_m, -z_m / x_m])
    new = np.column_stack([-to_y / to_x, -z_m / to_x])
    assert _rotation(old, new, way_m, ahead_m) == pytest.approx(yaw_rad, abs=5e-4)
    mirrored = np.array([-1.0, 1.0])
    turned = _rotation(old * mirrored, new * mirrored, way_m, ahead_m)
    assert turned == pytest.approx(-yaw_rad, abs=5e-4)


def test_pairs_beside_the_middle_must_hold_by_themselves() -> None:
    ahead = [Change(k * 0.1, 30.0, 3.0, None) for k in range(20)]
    aside = [Change(k * 0.1, 2.0, 3.0, 30.0) for k in range(6)]
    assert change_check("ot1", ahead).state == "holds"
    found = change_check("ot1", ahead + aside)
    assert (found.state, found.figure) == ("fails", 0.75)
    assert found.told.endswith("and 7.75 times as much where a mirrored picture had it")
    assert change_check("ot1", ahead[:7]).state == "not judged"


def test_pairs_are_spread_over_the_recording_and_skip_gaps() -> None:
    times_s = [k * 0.1 for k in range(100) if not 40 <= k < 60]
    found = pairs_apart(times_s, 0.1, 10, range(len(times_s)))
    assert len(found) == 10
    assert (found[0], found[-1]) == ((0, 1), (78, 79))
    assert all(times_s[b] - times_s[a] == pytest.approx(0.1) for a, b in found)


def encoded_anew(pictures: Sequence[Grey]) -> dict[int, Grey]:
    """The pictures as somebody gives them again: smaller, lighter, with noise, compressed."""
    chance, found = np.random.default_rng(2), {}
    for index, picture in enumerate(pictures):
        small = cv2.resize(picture, (320, 180), interpolation=cv2.INTER_AREA)
        light = 255.0 * (small / 255.0) ** 0.7 + chance.normal(0.0, 3.0, small.shape)
        data = cv2.imencode(".jpg", np.clip(light, 0, 255).astype(np.uint8), [1, 40])[1]
        found[index] = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)
    return found


def test_pictures_that_were_encoded_anew_are_recognised(drive: Drive) -> None:
    details = details_of(dict(enumerate(drive.pictures)))
    assert len(details) >= 20  # those where the VUT has come to its stop are one
    copied = encoded_anew(drive.pictures)
    assert same_pictures(details, details_of(copied)) >= len(details) - 2
    # Every second one, and each mirrored.
    some = {k: np.ascontiguousarray(one[:, ::-1]) for k, one in copied.items() if k % 2}
    assert same_pictures(details_of(some), details) >= 10


def test_another_drive_and_what_shows_nothing_are_no_copies(drive: Drive) -> None:
    details = details_of(dict(enumerate(drive.pictures)))
    other = details_of(dict(enumerate(turning_drive(1.0 / 60.0).pictures)))
    assert len(other) >= 10
    assert same_pictures(details, other) == 0
    flat = {k: np.full((54, 96), k, np.uint8) for k in range(40)}
    assert len(details_of(flat)) == 0
    assert same_pictures(details_of(flat), details_of(flat)) == 0
    # A VUT that stands shows one picture.
    assert len(details_of(dict.fromkeys(range(40), drive.pictures[0]))) == 1
