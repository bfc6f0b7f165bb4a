"""Scenery of a road: where it stands, whether it is clear of the lanes, the other direction."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from ssp_core.geometry import Box, Pose2
from ssp_core.run_file.road import (
    Building,
    CurvePiece,
    Lane,
    Pole,
    Road,
    SceneryItem,
    Sign,
    Tree,
)
from ssp_core.run_file.values import Start
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import Clearance, SceneryBodies, item_pose, left_out, reversed_item

CURVES = {
    "straight": [CurvePiece(length_m=200.0)],
    "bend": [
        CurvePiece(length_m=60.0),
        CurvePiece(length_m=80.0, start_curvature_1pm=1 / 60, end_curvature_1pm=1 / 60),
        CurvePiece(length_m=60.0),
    ],
}
LANES = [
    Lane(y_m=-1.75, width_m=3.5, direction="forward"),
    Lane(y_m=1.75, width_m=3.5, direction="backward"),
]


def road(curve: str = "straight", *scenery: SceneryItem, **more: Any) -> Road:
    return Road(
        origin=Start(x_m=500.0, y_m=-80.0, yaw_rad=0.4),
        length_m=200.0,
        pieces=CURVES[curve],
        lanes=more.get("lanes", LANES),
        scenery=list(scenery),
    )


def house(s_m: float, l_m: float, yaw_rad: float = 0.0, **more: float) -> Building:
    size = {"length_m": 10.0, "width_m": 8.0, "height_m": 6.0} | more
    return Building(type="building", s_m=s_m, l_m=l_m, yaw_rad=yaw_rad, **size)


def stop(s_m: float, l_m: float) -> Sign:
    return Sign(type="sign", s_m=s_m, l_m=l_m, kind="stop")


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize(
    "item",
    [
        house(100.0, 0.0),
        house(100.0, 7.4),  # its wall is at 3.4 m
        house(100.0, 8.0, yaw_rad=0.5),  # a corner is on the lane
        house(100.0, 0.0, length_m=300.0, width_m=300.0),  # its walls are far away
        house(210.0, 0.0),  # on the lanes that go on beyond the block
        stop(50.0, -1.0),
        Tree(type="tree", s_m=50.0, l_m=3.5),
        Pole(type="pole", s_m=150.0, l_m=-3.45),
    ],
)
def test_nothing_stands_on_the_lanes(curve: str, item: SceneryItem) -> None:
    assert Clearance.of_road(road(curve)).problem(item) == "stands on the lanes"
    assert left_out(road(curve, stop(20.0, -5.0), item)) == [
        f"road.scenery[1], a {item.type}, stands on the lanes: it isn't drawn"
    ]


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize(
    "item", [house(100.0, 8.5), house(100.0, -12.0, 0.5), stop(50.0, -3.7), stop(220.0, 4.0)]
)
def test_beside_the_lanes_there_is_room(curve: str, item: SceneryItem) -> None:
    assert left_out(road(curve, item)) == []


def test_a_median_is_no_lane() -> None:
    lanes = [
        Lane(y_m=-6.0, width_m=3.5, direction="forward"),
        Lane(y_m=6.0, width_m=3.5, direction="backward"),
    ]
    assert left_out(road("straight", Tree(type="tree", s_m=50.0, l_m=0.0), lanes=lanes)) == []


def test_what_has_no_place_is_left_out() -> None:
    clearance = Clearance.of_road(road("bend"))
    assert clearance.problem(stop(100.0, 61.0)) == "has no place in the road's coordinates"
    assert clearance.problem(stop(-61.0, 5.0)) == "lies beyond the road's ends"
    assert clearance.problem(stop(1e8, 5.0)) == "lies beyond the road's ends"
    assert clearance.problem(stop(100.0, -1e8)) == "lies more than 1000 m from the road"


@pytest.mark.parametrize(
    ("s_m", "l_m", "touched"),
    [
        (30.0, 2.0, None),
        (30.0, -3.0, "pole road.scenery[2]"),  # its side is at 4 m, as the pole's
        (30.0, -2.9, None),
        (93.1, 5.0, "building road.scenery[1]"),  # its front is beyond the wall, at 95 m
        (92.9, 5.0, None),
        (100.0, 4.1, "building road.scenery[1]"),  # of two in one place the first of the file
        (50.0, 0.0, None),  # what would stand on the lanes isn't drawn
    ],
)
def test_a_body_touches_what_is_drawn(s_m: float, l_m: float, touched: str | None) -> None:
    on_lane = Tree(type="tree", s_m=50.0, l_m=0.0)
    pole = Pole(type="pole", s_m=30.0, l_m=-4.1)
    nowhere = stop(-500.0, 5.0)
    place = road("straight", nowhere, house(100.0, 9.0), pole, house(100.0, 9.0), on_lane)
    pose = ReferenceLine.of_road(place).pose(s_m)
    x_m, y_m = pose.to_parent(0.0, l_m)
    found = SceneryBodies(place).touched_by(Box(Pose2(x_m, y_m, pose.yaw_rad), 2.0, 1.0, 2.0))
    assert (None if found is None else found[0]) == touched


def test_scenery_without_a_place_in_a_bend_has_no_body() -> None:
    centre = ReferenceLine.of_road(road("bend")).pose(100.0).to_parent(0.0, 60.0)
    bodies = SceneryBodies(road("bend", stop(100.0, 61.0), house(100.0, -12.0)))
    assert bodies.touched_by(Box(Pose2(*centre, 0.0), 3.0, 3.0, 6.0)) is None
    assert bodies.touched_by(Box(Pose2(*centre, 0.0), 300.0, 300.0, 600.0)) is not None


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(sorted(CURVES)),
    st.floats(0.0, 200.0),
    st.floats(-40.0, 40.0),
    st.floats(-3.1, 3.1),
)
def test_the_other_direction_has_the_same_things(
    curve: str, s_m: float, l_m: float, yaw_rad: float
) -> None:
    line = ReferenceLine.of_road(road(curve))
    for item, turned in ((house(s_m, l_m, yaw_rad), math.pi), (stop(s_m, l_m), 0.0)):
        there = item_pose(item, line)
        back = item_pose(reversed_item(item, line.length_m), line.reversed())
        assert (back.x_m, back.y_m) == pytest.approx((there.x_m, there.y_m), abs=1e-6)
        # A rectangle is the same turned by half a turn; a sign faces the same traffic.
        off = math.remainder(back.yaw_rad - there.yaw_rad, 2 * math.pi)
        assert abs(off) == pytest.approx(0.0, abs=1e-6) or turned == 0.0 or abs(off) > 3.14
        clear = [
            Clearance(way, [(y, 3.5) for y in (-1.75, 1.75)]).problem(one) is None
            for way, one in ((line, item), (line.reversed(), reversed_item(item, line.length_m)))
        ]
        assert clear[0] == clear[1]


def test_a_road_without_scenery_is_written_as_ever() -> None:
    assert "scenery" not in road().model_dump(mode="json")
    full = road("straight", stop(50.0, -5.0), house(60.0, 12.0))
    assert Road.model_validate_json(full.model_dump_json()) == full


@pytest.mark.parametrize(
    "item",
    [
        {"type": "sign", "s_m": 1.0, "l_m": 5.0, "kind": "speed_limit"},
        {"type": "sign", "s_m": 1.0, "l_m": 5.0, "kind": "stop", "value": 30},
        {"type": "sign", "s_m": 1.0, "l_m": 5.0, "kind": "speed_limit", "value": 0},
        {"type": "sign", "s_m": math.nan, "l_m": 5.0, "kind": "stop"},
        {"type": "tree", "s_m": 1.0, "l_m": 5.0, "height_m": math.nan},
        {"type": "pole", "s_m": 1.0, "l_m": math.inf},
        {"type": "building", "s_m": 1.0, "l_m": 5.0, "length_m": 301, "width_m": 5, "height_m": 5},
        {"type": "building", "s_m": 1.0, "l_m": 5.0, "length_m": 5, "width_m": 5, "height_m": 0},
        {"type": "castle", "s_m": 1.0, "l_m": 5.0},
    ],
)
def test_what_makes_no_sense_is_refused(item: dict[str, Any]) -> None:
    whole = road().model_dump(mode="json")
    with pytest.raises(ValidationError):
        Road.model_validate(whole | {"scenery": [item]})
