"""The adapter ``alpamayo``: which of the trajectories, in which frame, and the printed texts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_vla_bridge.adapters.points import unwrapped
from ssp_vla_bridge.messages import NativeArray


def array(values, frame="ego_xyz", unit="m", step_s=0.1, first_time_s=0.1, name="pred_xyz"):
    values = np.asarray(values, dtype=float)
    data = tuple(values.ravel().tolist())
    return NativeArray(name, values.shape, data, frame, unit, step_s, first_time_s)


def path(speed_mps=10.0, left_mps=0.0, count=64):
    """Points at 10 Hz, the first after 0.1 s, of motion ahead with a drift to the left."""
    return [(speed_mps * 0.1 * i, left_mps * 0.1 * i, 0.0) for i in range(1, count + 1)]


def read(cases, *arrays, text="Keep distance to the lead vehicle.", **kwargs):
    return cases.read("alpamayo", text, arrays=arrays, **kwargs)


@pytest.mark.parametrize("left_mps", [1.5, -1.5])
def test_x_is_forward_and_y_is_left(cases, left_mps):
    adapted = read(cases, array([[[path(10.0, left_mps)]]]))
    trajectory = adapted.trajectory
    assert len(trajectory.t_s) == 65
    assert trajectory.t_s[:3] == pytest.approx((0.0, 0.1, 0.2))
    assert trajectory.t_s[-1] == pytest.approx(6.4)
    assert trajectory.x_m[:3] == pytest.approx((0.0, 1.0, 2.0))
    assert trajectory.y_m[:3] == pytest.approx((0.0, 0.1 * left_mps, 0.2 * left_mps))
    assert adapted.info.origin_added
    assert adapted.info.notes == ()


@pytest.mark.parametrize("axes", range(4))
def test_leading_axes_may_be_missing(cases, axes):
    values = path()
    for _ in range(axes):
        values = [values]
    assert read(cases, array(values)).trajectory.x_m[1] == pytest.approx(1.0)


def test_set_0_sample_0_is_taken(cases):
    samples = [path(speed) for speed in (10.0, 20.0, 30.0)]
    adapted = read(cases, array([[samples, samples[::-1]]]))
    assert adapted.trajectory.x_m[1] == pytest.approx(1.0)
    assert adapted.info.notes == ("the first of 6 trajectories was taken",)


def test_points_without_height_are_read(cases):
    adapted = read(cases, array([point[:2] for point in path()], frame="ego_xy"))
    assert adapted.trajectory.x_m[1] == pytest.approx(1.0)


def test_a_path_that_folds_back_is_passed_on(cases):
    points = path(count=10) + path(count=10)[::-1]
    trajectory = read(cases, array([[[points]]])).trajectory
    assert list(trajectory.x_m) == pytest.approx([0.0, *(point[0] for point in points)])


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ([], "missing"),
        ([array(path(), name="pred_rot")], "missing"),
        ([array(np.zeros((0, 2)))], "shape"),
        ([array(np.zeros((1, 1, 1, 0, 3)))], "shape"),
        ([array(np.zeros((1, 0, 1, 64, 3)))], "shape"),
        ([array([[[path()]], [[path()]]])], "shape"),
        ([array([[[[path()]]]] * 1)], "shape"),
        ([array(np.zeros((64, 4)))], "shape"),
        ([array(np.zeros(64))], "shape"),
        ([array(path()), array(path())], "shape"),
        ([array(path(), frame="map")], "shape"),
        ([array(path(), unit="cm")], "shape"),
        ([array(path(count=9))], "coverage"),
        ([array(path(), first_time_s=0.5)], "coverage"),
        ([array(path(), step_s=math.nan)], "timestamps"),
        ([array(path(), step_s=0.0)], "timestamps"),
        ([array([*path(), (math.nan, 0.0, 0.0)])], "non_finite"),
    ],
)
def test_names_why_there_is_no_trajectory(cases, given, reason):
    adapted = read(cases, *given)
    assert adapted.trajectory is None
    assert adapted.invalid == (reason,)


@pytest.mark.parametrize("shape", [(1, 1, 1, 64, 3), (64, -3), (), (10**9, 3)])
def test_a_shape_that_is_not_that_of_the_data_is_refused(cases, shape):
    wrong = NativeArray("pred_xyz", shape, (0.0,) * 6, "ego_xyz", "m", 0.1, 0.1)
    assert read(cases, wrong).invalid == ("shape",)


def test_an_empty_text_with_a_trajectory_stays_empty(cases):
    adapted = read(cases, array(path()), text="")
    assert adapted.text == ""
    assert adapted.invalid == ()


TEXTS = ["Keep distance since it's ahead.", 'He said "stop".', "a\nb\\c", "", 'it\'s "both"']


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("shape", [(1,), (1, 1, 1), (1, 1, 3)])
def test_the_print_of_an_array_is_unwrapped(text, shape):
    texts = np.array([text] + ["Another one."] * (math.prod(shape) - 1)).reshape(shape)
    for printed in (str(texts), str(texts.tolist())):
        assert unwrapped(printed)[0] == text
        assert unwrapped(printed)[1] == (
            "the text was the print of an array, whose first string was taken",
        )


@pytest.mark.parametrize(
    "text",
    ["", "[]", "Keep on.", "['a", "[a]", "['a'] and", "see ['a']", "[1, 2]", "['a' b]", "'a'"],
)
def test_another_text_is_left_alone(text):
    assert unwrapped(text) == (text, ())


def test_the_unwrapped_text_is_the_records(cases):
    adapted = read(cases, array(path()), text="['Stop for the pedestrian.']")
    assert adapted.text == "Stop for the pedestrian."
    assert "print of an array" in adapted.info.notes[0]


@pytest.mark.parametrize("unit", ["['", "[", "['a' ", "'\\'", "]", "['a']"])
def test_long_texts_are_left_alone_or_unwrapped(unit):
    text = "[" + unit * (300_000 // len(unit))
    assert len(unwrapped(text)[0]) <= len(text)
