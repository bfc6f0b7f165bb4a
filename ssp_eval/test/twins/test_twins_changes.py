"""The effect of a change on recorded states, and its written form."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass
from ssp_eval.twins.changes import (
    CONTROL_ID,
    Kind,
    Series,
    changed_state,
    control_object,
    mirrored,
    parse_change,
    slowed,
    usual_changes,
)
from tests.support.bags.worlds import STEP_NS, cutting_in, small_world
from tests.support.states import object_state


def series_of(name: str, steps: int = 150) -> list[ObjectState]:
    return [s for step in range(steps) for s in cutting_in(step) if s.object_id == name]


CAR, VUT = series_of("ot1"), series_of("vut")


def changed(text: str, index: int) -> ObjectState:
    found = changed_state(parse_change(text), CAR[index], Series(CAR), Series(VUT))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("without=ot1", "without.ot1"),
        ("class=ot1:truck", "class.ot1.truck"),
        ("mirror=ot1", "mirror.ot1"),
        ("shift=ot1:-0.5", "shift.ot1.m0500"),
        ("shift=ot1:1.001", "shift.ot1.p1001"),
        ("control", "control.car"),
        ("control=truck", "control.truck"),
        ("camera=0.5", "camera.0500"),
        ("history=0.5", "history.0500"),
        ("history=0", "history.0000"),
    ],
)
def test_a_change_has_a_name_for_folders(text: str, name: str) -> None:
    assert parse_change(text).name == name


@pytest.mark.parametrize(
    "text",
    [
        "",
        "blur=ot1",
        "without",
        "without=",
        "without=ot1:x",
        "without=../x",
        "class=ot1",
        "class=ot1:tank",
        "class=ot1:unknown",
        "shift=ot1",
        "shift=ot1:0",
        "shift=ot1:nan",
        "shift=ot1:11",
        "shift=ot1:0.0005",
        "camera=-0.5",
        "camera=0",
        "history=1",
        "history=-0.1",
        "history=0.2_5",
        "history=nan",
        "control=tank",
        f"without={CONTROL_ID}",
    ],
)
def test_what_is_no_change_is_refused_with_the_forms(text: str) -> None:
    with pytest.raises(InputError, match=r"--change.*write "):
        parse_change(text)


def test_all_changes_have_names_of_their_own() -> None:
    found = usual_changes({"ot1": ObjectClass.CAR, "ot2": ObjectClass.PEDESTRIAN})
    assert len({change.name for change in found}) == len(found)
    assert {change.kind for change in found} == set(Kind)


def test_without_leaves_nothing() -> None:
    gone = changed_state(parse_change("without=ot1"), CAR[7], Series(CAR), Series(VUT))
    assert gone is None


def test_another_class_has_its_extents_and_the_same_motion() -> None:
    found = changed("class=ot1:truck", 60)
    size = DEFAULT_SIZES[ObjectClass.TRUCK]
    assert found == replace(CAR[60], object_class=ObjectClass.TRUCK, size=size)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -2.5])
def test_a_mirrored_object_is_on_the_other_side_and_mirrored_twice_where_it_was(
    yaw_rad: float,
) -> None:
    vut = object_state("vut", x_m=100.0, y_m=-30.0, yaw_rad=yaw_rad)
    x_m, y_m = vut.pose.to_parent(20.0, 3.5)
    there = object_state(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad + 0.2, yaw_rate_radps=0.1)
    found = mirrored(there, vut.pose)
    assert vut.pose.to_local(found.x_m, found.y_m) == pytest.approx((20.0, -3.5))
    assert math.remainder(found.yaw_rad - yaw_rad, math.tau) == pytest.approx(-0.2)
    assert (found.yaw_rate_radps, found.speed_mps) == (-0.1, there.speed_mps)
    again = mirrored(found, vut.pose)
    assert (again.x_m, again.y_m) == pytest.approx((x_m, y_m))


@pytest.mark.parametrize("later_s", [0.5, -0.5])
def test_a_shifted_object_is_where_it_was_so_much_earlier(later_s: float) -> None:
    found, then = changed(f"shift=ot1:{later_s}", 70), CAR[70 - round(later_s / 0.02)]
    assert found == replace(then, stamp_ns=CAR[70].stamp_ns, sequence=CAR[70].sequence)


def test_beyond_its_states_a_shifted_object_keeps_its_speed() -> None:
    begin, end = changed("shift=ot1:0.5", 0), changed("shift=ot1:-0.5", 149)
    assert begin.x_m == pytest.approx(CAR[0].x_m - 0.5 * 9.0)
    assert end.x_m == pytest.approx(CAR[149].x_m + 0.5 * 9.0)


def test_a_slowed_history_is_the_same_way_at_a_share_of_the_speed() -> None:
    found = slowed(VUT, 0.5)
    assert [state.stamp_ns for state in found] == [state.stamp_ns for state in VUT]
    assert [state.x_m for state in found] == pytest.approx([0.5 * state.x_m for state in VUT])
    assert {state.speed_mps for state in found} == {5.0}
    standing = slowed(VUT, 0.0)
    assert {(state.x_m, state.speed_mps) for state in standing} == {(0.0, 0.0)}


def test_a_slowed_history_keeps_to_a_bend() -> None:
    radius_m, speed_mps = 40.0, 10.0

    def at(step: int) -> ObjectState:
        angle = speed_mps * step * STEP_NS / 1e9 / radius_m
        return object_state(
            "vut",
            x_m=radius_m * math.sin(angle),
            y_m=radius_m * (1 - math.cos(angle)),
            yaw_rad=angle,
            speed_mps=speed_mps,
            yaw_rate_radps=speed_mps / radius_m,
            stamp_ns=step * STEP_NS,
        )

    found = slowed([at(step) for step in range(200)], 0.5)[-1]
    wanted = at(199 // 2)
    assert math.hypot(found.x_m, found.y_m - radius_m) == pytest.approx(radius_m, abs=1e-3)
    assert found.yaw_rad == pytest.approx(wanted.yaw_rad, abs=0.01)
    assert found.yaw_rate_radps == pytest.approx(0.5 * speed_mps / radius_m)


@pytest.mark.parametrize("heading_rad", [0.0, math.pi])
def test_the_control_stands_beside_the_road_ahead_of_the_vut(heading_rad: float) -> None:
    road: Road = small_world().road
    last = object_state("vut", x_m=100.0, y_m=1.0, yaw_rad=heading_rad)
    found = control_object(parse_change("control"), road, last)
    ahead_m, left_m = last.pose.to_local(found.x_m, found.y_m)
    assert ahead_m > 30.0
    assert left_m < 0.0
    assert not road.right_edge_m - 1.0 < found.y_m < road.left_edge_m + 1.0
    assert found.speed_mps == 0.0
