"""The adapter ``waypoints``: hand-computed readings, and that it repairs and raises nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import TASK, EgoSample, NativeArray, Request, Response


def test_reads_rows_as_forward_and_left(make_response):
    adapted = adapt("waypoints", make_response([(0, 0), (4, 0.1), (7.5, 0.3)]))
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0)
    assert adapted.trajectory.x_m == (0.0, 4.0, 7.5)
    assert adapted.trajectory.y_m == (0.0, 0.1, 0.3)
    assert adapted.invalid == ()
    assert adapted.text == "I keep my speed."
    assert not adapted.info.origin_added


def test_adds_the_origin_to_a_start_one_step_late(make_response):
    adapted = adapt("waypoints", make_response([(4, 0.1), (7.5, 0.3)], first_time_s=0.5))
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0)
    assert adapted.trajectory.x_m == (0.0, 4.0, 7.5)
    assert adapted.info.origin_added


@pytest.mark.parametrize("first_time_s", [0.2, 1.0])
def test_adds_no_other_point(make_response, first_time_s):
    response = make_response([(4, 0), (7, 0), (9, 0)], first_time_s=first_time_s)
    adapted = adapt("waypoints", response)
    assert adapted.trajectory is None
    assert adapted.invalid == ("coverage",)


def test_one_list_with_a_number_that_is_none_is_no_other_list(make_response):
    text = "Trajectory: [[5, 0], [10, 0], [15, 0], [nan, 0]]"
    adapted = adapt("waypoints", replace(make_response(text=text), arrays=()))
    assert adapted.invalid == ("non_finite",)
    assert adapted.info.notes == ("the trajectory was read from the text",)


@pytest.mark.parametrize("first_time_s", [0.4, 2.0, 3.0])
def test_one_point_that_is_not_a_step_ahead_is_no_plan(make_response, first_time_s):
    adapted = adapt("waypoints", make_response([(4, 0)], first_time_s=first_time_s))
    assert adapted.trajectory is None
    assert not adapted.info.origin_added


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"frame": "nuscenes_xy"}, "shape"),
        ({"unit": "px"}, "shape"),
        ({"shape": (6,)}, "shape"),
        ({"shape": (2, 3)}, "shape"),
        ({"shape": (3, 2, 1)}, "shape"),
        ({"data": (0.0, 0.0)}, "shape"),
        ({"shape": (0, 2), "data": ()}, "shape"),
        ({"step_s": math.nan}, "timestamps"),
        ({"step_s": 0.0}, "timestamps"),
        ({"step_s": -0.5}, "timestamps"),
        ({"first_time_s": math.inf}, "timestamps"),
        ({"data": (0.0, 0.0, 1.0, math.nan, 2.0, 0.0)}, "non_finite"),
        ({"step_s": 0.4}, "coverage"),
        ({"name": "pred_xyz"}, "missing"),
    ],
)
def test_names_why_there_is_no_trajectory(make_response, change, reason):
    response = make_response([(0, 0), (4, 0), (7, 0)])
    broken = replace(response, arrays=(replace(response.arrays[0], **change),))
    adapted = adapt("waypoints", broken)
    assert adapted.trajectory is None
    assert adapted.invalid == (reason,)
    assert adapted.text == response.text


def test_two_arrays_of_the_name_are_not_chosen_between(make_response):
    response = make_response([(0, 0), (4, 0), (7, 0)])
    adapted = adapt("waypoints", replace(response, arrays=response.arrays * 2))
    assert adapted.invalid == ("shape",)


def test_unknown_adapter_names_the_known_ones(make_response):
    with pytest.raises(InputError, match="waypoints"):
        adapt("no_such_adapter", make_response())


def written(rows, label="Trajectory: "):
    text = f"I slow down.\n{label}[{', '.join(f'[{x}, {y}]' for x, y in rows)}]"
    return Response("r1", 0, "model", "model/1", text)


def test_reads_a_trajectory_that_is_written_into_the_text():
    adapted = adapt("waypoints", written([(4.0, 0.1), (7.5, 0.3), (10.5, -0.2), (13.0, 0.0)]))
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert adapted.trajectory.x_m == (0.0, 4.0, 7.5, 10.5, 13.0)
    assert adapted.trajectory.y_m == (0.0, 0.1, 0.3, -0.2, 0.0)
    assert adapted.info.origin_added
    assert adapted.info.notes == ("the trajectory was read from the text",)


def test_the_step_of_a_written_trajectory_is_the_tasks(make_request):
    task = replace(TASK, trajectory_step_s=0.25, trajectory_horizon_s=1.0)
    request = replace(make_request(), task=task)
    adapted = adapt("waypoints", written([(1, 0), (2, 0), (3, 0), (4, 0)]), request)
    assert adapted.trajectory.t_s == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert adapted.info.notes == ("the trajectory was read from the text",)


@pytest.mark.parametrize("step_s", [0.0, -0.5, math.nan, math.inf, 1e-320])
def test_a_task_without_a_step_leaves_a_written_trajectory_unread(make_request, step_s):
    request = replace(make_request(), task=replace(TASK, trajectory_step_s=step_s))
    adapted = adapt("waypoints", written([(1, 0), (2, 0), (3, 0), (4, 0)]), request)
    assert adapted.invalid == ("timestamps",)


def test_an_array_is_read_before_a_text(make_response):
    response = make_response([(0, 0), (4, 0), (7, 0)], text=written([(1, 0), (2, 0)]).text)
    assert adapt("waypoints", response).trajectory.x_m == (0.0, 4.0, 7.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Trajectory: [[4.0, 0.0], [7.5, 0.0", "shape"),
        ("Trajectory: [[4.0, 0.0, 0.5], [7.5, 0.0, 1.0]]", "shape"),
        ("Trajectory: [[4.0, 0.0]]", "coverage"),
        ("Trajectory: none.", "missing"),
    ],
)
def test_names_why_a_written_trajectory_is_none(text, reason):
    adapted = adapt("waypoints", Response("r1", 0, "model", "model/1", text))
    assert adapted.trajectory is None
    assert adapted.invalid == (reason,)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-10, 10), st.floats(-7, 7)), min_size=3, max_size=20),
    st.booleans(),
)
def test_every_native_point_is_kept_as_it_is(rows, late):
    data = tuple(value for row in rows for value in row)
    array = NativeArray(
        "trajectory", (len(rows), 2), data, "ego_xy", "m", 0.5, 0.5 if late else 0.0
    )
    trajectory = adapt("waypoints", Response("r", 0, "m", "m/1", "", (array,))).trajectory
    skipped = 1 if late else 0
    assert list(zip(trajectory.x_m, trajectory.y_m, strict=True))[skipped:] == rows


def test_the_echo_of_past_positions_is_no_answer():
    history = tuple(EgoSample(0.5 * (i - 7), 4.0 * (i - 7), 0.0, 0.0, 8.0, 0.0) for i in range(8))
    request = Request("r1", 10**9, (), None, history, "measured")

    def read(rows):
        text = ", ".join(f"[{x:.2f}, {y:.2f}]" for x, y in rows)
        return adapt(
            "waypoints", Response("r1", 10**9, "m", "m/1", f"Trajectory: [{text}]"), request
        )

    past = [(sample.x_m, sample.y_m) for sample in history]
    for echo in (past, past[-4:]):
        adapted = read(echo)
        assert (adapted.trajectory, adapted.invalid) == (None, ("missing",))
    assert read([(4.0 * k, 0.0) for k in range(1, 5)]).invalid == ()
    both = read([*past, *((4.0 * k, 0.0) for k in range(1, 5))])
    assert both.trajectory.x_m == (0.0, 4.0, 8.0, 12.0, 16.0)
