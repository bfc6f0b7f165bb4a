"""OpenDRIVE maps: what becomes a block, what it looks like, what is refused and why."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps import xml_input
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.maps.load import load_library

Made = Any
Words = Any


def blocks(library: Library) -> dict[str, Block]:
    return {block.block_id: block for block in library.blocks}


def only(library: Library, block_id: str) -> Block:
    assert block_id in blocks(library), [b.block_id for b in library.blocks] + list(
        library.rejected
    )
    return blocks(library)[block_id]


def lanes(block: Block) -> list[tuple[str, float, float, bool]]:
    return [(x.name, round(x.y_m, 4), round(x.width_m, 4), x.forward) for x in block.lanes]


# -- lanes and what lies beside them --------------------------------------------------------------


def test_a_road_with_two_directions_is_two_blocks(made: Made, words: Words) -> None:
    sections = words.section(
        words.lane(3, 2.5, "sidewalk") + words.lane(2, 0.4, "shoulder") + words.lane(1, 3.25),
        words.lane(-1, 3.5) + words.lane(-2, 1.2, "biking") + words.lane(-3, 0.3, "curb"),
    )
    library = load_library(made.road("7", 80.0, sections=sections).write())
    assert library.kind == "opendrive"
    assert library.source == "map.xodr"
    assert sorted(blocks(library)) == ["road 7 backward", "road 7 forward"]
    forward, backward = only(library, "road 7 forward"), only(library, "road 7 backward")
    assert lanes(forward) == [("lane -1", -1.75, 3.5, True), ("lane 1", 1.625, 3.25, False)]
    assert lanes(backward) == [("lane 1", -1.625, 3.25, True), ("lane -1", 1.75, 3.5, False)]
    assert (forward.right_boundary, forward.left_boundary) == ("kerb", "sidewalk")
    assert (backward.right_boundary, backward.left_boundary) == ("sidewalk", "kerb")
    assert forward.shoulder_right_m == pytest.approx(1.5)
    assert (forward.sidewalk_left_m, forward.shoulder_left_m) == pytest.approx((2.5, 0.4))
    assert (backward.sidewalk_right_m, backward.shoulder_right_m) == pytest.approx((2.5, 0.4))
    assert forward.line.pose(80.0).x_m == pytest.approx(80.0)
    start = backward.line.pose(0.0)
    assert (start.x_m, start.yaw_rad) == pytest.approx((80.0, math.pi))
    assert forward.segment == "straight"


def test_left_hand_traffic_turns_directions_round(made: Made) -> None:
    library = load_library(made.road(attributes='rule="LHT"').write())
    forward = only(library, "road 1 forward")
    assert lanes(forward) == [("lane -1", -1.75, 3.5, False), ("lane 1", 1.75, 3.5, True)]
    assert forward.notes == ("left-hand traffic",)


def test_a_one_way_road_is_one_block(made: Made, words: Words) -> None:
    sections = words.section("", words.lane(-1) + words.lane(-2))
    library = load_library(made.road(sections=sections).write())
    assert sorted(blocks(library)) == ["road 1 forward"]
    reversed_lane = words.section("", words.lane(-1, attributes='direction="reversed"'))
    made.parts.clear()
    library = load_library(made.road(sections=reversed_lane).write())
    assert sorted(blocks(library)) == ["road 1 backward"]


@pytest.mark.parametrize(
    ("kinds", "boundary", "shoulder_m", "sidewalk_m"),
    [
        ([], "verge", 0.0, 0.0),
        (["none"], "verge", 0.0, 0.0),
        (["shoulder"], "shoulder", 2.0, 0.0),
        (["parking", "sidewalk"], "sidewalk", 2.0, 2.0),
        # As wide as a verge: who waits beside the road stands on it, and not beyond it.
        (["border"], "kerb", 0.0, 2.0),
        (["shoulder", "border", "shoulder"], "kerb", 2.0, 2.0),
        (["sidewalk", "shoulder"], "sidewalk", 0.0, 2.0),
        (["none", "sidewalk"], "verge", 0.0, 0.0),
        (["walking", "sidewalk"], "sidewalk", 0.0, 4.0),
    ],
)
def test_what_lies_beside_the_lanes(
    made: Made,
    words: Words,
    kinds: list[str],
    boundary: str,
    shoulder_m: float,
    sidewalk_m: float,
) -> None:
    outer = "".join(words.lane(-2 - i, 2.0, kind) for i, kind in enumerate(kinds))
    library = load_library(made.road(sections=words.section("", words.lane(-1) + outer)).write())
    block = only(library, "road 1 forward")
    assert block.right_boundary == boundary
    assert (block.shoulder_right_m, block.sidewalk_right_m) == (shoulder_m, sidewalk_m)


def test_lanes_by_borders_are_lanes_by_widths(made: Made, words: Words) -> None:
    def border(a: float) -> str:
        return f'<border sOffset="0" a="{a}"/>'

    sections = words.section(
        words.lane(1, border(3.0)), words.lane(-1, border(-3.5)) + words.lane(-2, border(-6.5))
    )
    block = only(load_library(made.road(sections=sections).write()), "road 1 forward")
    assert lanes(block) == [
        ("lane -2", -5.0, 3.0, True),
        ("lane -1", -1.75, 3.5, True),
        ("lane 1", 1.5, 3.0, False),
    ]


def test_the_lane_offset_moves_all_lanes(made: Made) -> None:
    library = load_library(made.road(offsets='<laneOffset s="0" a="1.5"/>').write())
    assert lanes(only(library, "road 1 forward")) == [
        ("lane -1", -0.25, 3.5, True),
        ("lane 1", 3.25, 3.5, False),
    ]


# -- where lanes change ---------------------------------------------------------------------------


def test_a_road_is_cut_where_its_lanes_change(made: Made, words: Words) -> None:
    sections = (
        words.section("", words.lane(-1), 0.0)
        + words.section("", words.lane(-1) + words.lane(-2), 40.0)
        + words.section("", words.lane(-1) + words.lane(-2), 70.0)
    )
    library = load_library(made.road(sections=sections).write())
    assert sorted(blocks(library)) == [
        "road 1 [0-40 m] forward",
        "road 1 [40-100 m] forward",
    ]
    first, second = (blocks(library)[name] for name in sorted(blocks(library)))
    assert (first.length_m, second.length_m) == pytest.approx((40.0, 60.0))
    assert second.line.pose(0.0).x_m == pytest.approx(40.0)
    assert (first.exits, second.entrances) == ((second.block_id,), (first.block_id,))
    assert second.crossings == ()


def test_a_lane_that_opens_is_no_lane_until_it_is_open(made: Made, words: Words) -> None:
    opening = (
        '<width sOffset="0" a="0"/><width sOffset="30" a="0" b="0.175"/>'
        '<width sOffset="50" a="3.5"/>'
    )
    sections = words.section("", words.lane(-1) + words.lane(-2, opening))
    library = load_library(made.road(sections=sections).write())
    assert [lanes(block) for _, block in sorted(blocks(library).items())] == [
        [("lane -1", -1.75, 3.5, True)],
        [("lane -2", -5.25, 3.5, True), ("lane -1", -1.75, 3.5, True)],
    ]
    assert sorted(blocks(library)) == ["road 1 [0-50 m] forward", "road 1 [50-100 m] forward"]


def test_lanes_that_shift_are_refused_with_the_reason(made: Made) -> None:
    offsets = (
        '<laneOffset s="0" a="0"/><laneOffset s="40" a="0" b="0.1"/><laneOffset s="60" a="2"/>'
    )
    library = load_library(made.road(offsets=offsets).write())
    assert sorted(blocks(library)) == [
        "road 1 [0-40 m] backward",
        "road 1 [0-40 m] forward",
        "road 1 [60-100 m] backward",
        "road 1 [60-100 m] forward",
    ]
    ((name, why),) = library.rejected
    assert name == "road 1 [40-60 m]"
    assert "lane -1 shifts by 2.00 m" in why
    # Nobody can drive through what is no block.
    assert only(library, "road 1 [0-40 m] forward").exits == ()


def test_slight_changes_of_width_stay_one_block(made: Made, words: Words) -> None:
    wavy = '<width sOffset="0" a="3.5"/><width sOffset="20" a="3.5" b="0.01"/>'
    wavy += '<width sOffset="40" a="3.7"/>'
    library = load_library(made.road(sections=words.section("", words.lane(-1, wavy))).write())
    block = only(library, "road 1 forward")
    assert block.lanes[0].width_m == pytest.approx(3.5)
    assert block.lanes[0].y_m == pytest.approx(-1.8)


@pytest.mark.parametrize("width", [0.0, 1.9])
def test_a_road_without_a_wide_enough_lane(made: Made, words: Words, width: float) -> None:
    library = load_library(made.road(sections=words.section("", words.lane(-1, width))).write())
    assert library.blocks == ()
    assert library.rejected == (("road 1", f"lane -1 is {width:.2f} m wide"),)


def test_a_road_for_pedestrians(made: Made, words: Words) -> None:
    sections = words.section("", words.lane(-1, 3.0, "sidewalk"))
    library = load_library(made.road(sections=sections).write())
    assert library.rejected == (("road 1", "it has no driving lane"),)


# -- rules ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "limit"),
    [
        ('<speed max="25" unit="mph"/>', 11.176),
        ('<speed max="50" unit="km/h"/>', 13.8889),
        ('<speed max="13.9"/>', 13.9),
        ('<speed max="no limit"/>', None),
        ('<speed max="undefined" unit="m/s"/>', None),
        ('<speed max="-1" unit="m/s"/>', None),
        ("", None),
    ],
)
def test_speed_limits_have_units(made: Made, speed: str, limit: float | None) -> None:
    made.road(head=f'<type s="0" type="town">{speed}</type>')
    block = only(load_library(made.write()), "road 1 forward")
    assert block.speed_limit_mps == (None if limit is None else pytest.approx(limit, abs=1e-3))
    assert block.road_type == "urban"


def test_the_slowest_limit_of_a_stretch_counts(made: Made, words: Words) -> None:
    slow = '<speed sOffset="0" max="8"/>'
    made.road(
        head='<type s="0" type="rural"><speed max="20"/></type>'
        '<type s="60" type="rural"><speed max="15"/></type>',
        sections=words.section(words.lane(1, inner=slow), words.lane(-1)),
    )
    library = load_library(made.write())
    assert only(library, "road 1 forward").speed_limit_mps == 15.0
    assert only(library, "road 1 backward").speed_limit_mps == 8.0
    assert only(library, "road 1 forward").road_type == "rural"


@pytest.mark.parametrize(
    ("mark", "left", "right"),
    [
        ('type="broken"', True, True),
        ('type="solid"', False, False),
        ('type="none"', True, True),
        ('type="solid" laneChange="both"', True, True),
        ('type="none" laneChange="none"', False, False),
        ('type="broken" laneChange="none"', True, True),
        ('type="broken" laneChange="increase"', True, False),
        ('type="broken" laneChange="decrease"', False, True),
        ('type="solid broken"', True, False),
        ('type="broken solid"', False, True),
        ('type="solid solid"', False, False),
    ],
)
def test_marks_say_which_lane_changes_are_permitted(
    made: Made, words: Words, mark: str, left: bool, right: bool
) -> None:
    # The mark between -1 and -2 is lane -1's; seen by the driver, -1 is the left one. "solid
    # broken" has the broken line on the outer side, whose traffic may cross to the inner lane.
    line = f'<roadMark sOffset="0" {mark}/>'
    sections = words.section("", words.lane(-1, mark=line) + words.lane(-2, mark=""))
    block = only(load_library(made.road(sections=sections).write()), "road 1 forward")
    assert ("lane_change_left" in block.permitted) is left
    assert ("lane_change_right" in block.permitted) is right
    assert {"keep_lane", "stop", "crossing"} <= block.permitted
    assert any(area.kind == "merge" for area in block.conflict_areas) is (left or right)


def test_marks_of_oncoming_lanes_are_seen_from_their_drivers(made: Made, words: Words) -> None:
    line = '<roadMark sOffset="0" type="broken" laneChange="increase"/>'
    sections = words.section(words.lane(2) + words.lane(1, mark=line), words.lane(-1))
    block = only(load_library(made.road(sections=sections).write()), "road 1 backward")
    # From lane 1 to lane 2 is to the right for who drives in them.
    assert "lane_change_right" in block.permitted
    assert "lane_change_left" not in block.permitted


def test_what_holds_on_most_of_the_way_counts(made: Made, words: Words) -> None:
    for share, permitted in ((30, False), (70, True)):
        made.parts.clear()
        line = f'<roadMark sOffset="0" type="broken"/><roadMark sOffset="{share}" type="solid"/>'
        sections = words.section("", words.lane(-1, mark=line) + words.lane(-2))
        block = only(load_library(made.road(sections=sections).write()), "road 1 forward")
        assert ("lane_change_left" in block.permitted) is permitted


def test_people_dont_cross_motorways(made: Made) -> None:
    made.road(head='<type s="0" type="motorway"/>')
    block = only(load_library(made.write()), "road 1 forward")
    assert "crossing" not in block.permitted
    assert {area.kind for area in block.conflict_areas} == {"following"}


def test_marked_crossings(made: Made) -> None:
    made.road(
        objects='<object id="1" type="crosswalk" s="20" t="0"/><object id="2" type="tree" s="50"/>'
        '<object id="3" name="SimpleCrosswalk" s="55" t="0"/>'
    )
    library = load_library(made.write())
    assert only(library, "road 1 forward").crossings_s_m == pytest.approx((55.0, 20.0))
    assert only(library, "road 1 backward").crossings_s_m == pytest.approx((45.0, 80.0))


# -- reference lines ------------------------------------------------------------------------------


def test_lines_arcs_and_spirals_are_exact(made: Made, words: Words) -> None:
    geometry = words.at(10, 20, 0.5, 30)
    made.road("a", 30, geometry=geometry)
    first = only(load_library(made.write()), "road a forward").line
    end = first.pose(30.0)
    shapes = ['<arc curvature="0.02"/>', '<spiral curvStart="0.02" curvEnd="-0.01"/>', "<line/>"]
    text, s = geometry, 30.0
    pose = end
    line = first
    for shape, length in zip(shapes, (25.0, 40.0, 20.0), strict=True):
        text += words.at(pose.x_m, pose.y_m, pose.yaw_rad, length, shape, s)
        s += length
        made.parts.clear()
        made.road("a", s, geometry=text)
        line = only(load_library(made.write()), "road a forward").line
        pose = line.pose(s)
    assert [(p.length_m, p.start_curvature_1pm, p.end_curvature_1pm) for p in line.pieces] == [
        (30.0, 0.0, 0.0),
        (25.0, 0.02, 0.02),
        (40.0, 0.02, -0.01),
        (20.0, 0.0, 0.0),
    ]


def poly3(numbers: list[float], u: FloatArray) -> FloatArray:
    a, b, c, d = numbers
    return np.stack([u, a + b * u + c * u**2 + d * u**3], axis=1)


def length_of(places: FloatArray) -> float:
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def turned(places: FloatArray) -> FloatArray:
    """From the frame of a geometry at (5, -3), heading 0.7."""
    c, s = math.cos(0.7), math.sin(0.7)
    found: FloatArray = places @ np.array([[c, s], [-s, c]]) + [5.0, -3.0]
    return found


def test_a_poly3_is_fitted_within_a_centimetre(made: Made, words: Words) -> None:
    numbers = [0.0, 0.0, 0.008, -0.00008]
    places = poly3(numbers, np.linspace(0.0, 60.0, 60001))
    length = length_of(places)
    assert length > 61.0  # so that u and arc length can't be taken for one another
    values = " ".join(f'{k}="{v}"' for k, v in zip("abcd", numbers, strict=True))
    geometry = words.at(5.0, -3.0, 0.7, length, f"<poly3 {values}/>")
    made.road("p", length, geometry=geometry)
    check_fit(only(load_library(made.write()), "road p forward").line, turned(places))


def check_fit(line: ReferenceLine, places: FloatArray) -> None:
    assert len(line.pieces) > 1
    assert np.abs(line.to_local_many(places[::60])[:, 1]).max() <= 0.01
    end = line.pose(line.length_m)
    assert (end.x_m, end.y_m) == pytest.approx(tuple(places[-1]), abs=0.01)


@pytest.mark.parametrize("span", ["arcLength", "normalized"])
def test_a_param_poly3_is_fitted_within_a_centimetre(made: Made, words: Words, span: str) -> None:
    p = np.linspace(0.0, 1.0, 60001)
    u, v = 58.0 * p + 1.0 * p**2 - 2.0 * p**3, 20.0 * p**2 - 15.0 * p**3
    places = np.stack([u, v], axis=1)
    length = length_of(places)
    scale = length if span == "arcLength" else 1.0
    numbers = {"bU": 58.0, "cU": 1.0, "dU": -2.0, "aU": 0.0, "aV": 0.0, "bV": 0.0}
    numbers |= {"cV": 20.0, "dV": -15.0}
    values = " ".join(f'{k}="{v / scale ** "abcd".index(k[0])}"' for k, v in numbers.items())
    shape = f'<paramPoly3 pRange="{span}" {values}/>'
    made.road("p", length, geometry=words.at(5.0, -3.0, 0.7, length, shape))
    check_fit(only(load_library(made.write()), "road p forward").line, turned(places))


@pytest.mark.parametrize(
    ("numbers", "why"),
    [
        ((0.0, 0.0, 0.0, 5e4), "runs off"),
        # A loop that is drawn at a speed which changes its sign.
        ((0.0, -30.0, 0.0, 60.0), "can't be fitted within 0.01 m"),
        ((0.0, 2.0, 0.0, 0.0), "is 56.57 m long, and is said to be 20 m"),
    ],
)
def test_a_cubic_that_cant_be_fitted(
    made: Made, words: Words, numbers: tuple[float, ...], why: str
) -> None:
    values = " ".join(
        f'{k}{side}="{v}"' for side in "UV" for k, v in zip("abcd", numbers, strict=True)
    )
    shape = f'<paramPoly3 pRange="arcLength" {values}/>'
    library = load_library(made.road(length=20.0, geometry=words.at(0, 0, 0, 20.0, shape)).write())
    assert library.blocks == ()
    assert why in library.rejected[0][1]


def test_a_cubic_that_stands_still(made: Made, words: Words) -> None:
    zeros = " ".join(f'{k}{side}="0"' for side in "UV" for k in "abcd")
    shape = f'<paramPoly3 pRange="arcLength" {zeros}/>'
    library = load_library(made.road(length=20.0, geometry=words.at(0, 0, 0, 20.0, shape)).write())
    assert "stands still" in library.rejected[0][1]


def test_small_kinks_are_led_over_and_large_ones_refused(made: Made, words: Words) -> None:
    def kinked(turn: float, gap: float) -> Library:
        made.parts.clear()
        geometry = words.at(0, 0, 0, 50) + words.at(50, gap, turn, 50, s=50)
        return load_library(made.road(geometry=geometry).write())

    bent = only(kinked(0.02, 0.005), "road 1 forward").line
    for s in (10.0, 49.0, 51.0, 60.0, 95.0):
        true = (s, 0.0) if s <= 50 else (50 + (s - 50) * math.cos(0.02), 0.005)
        if s > 50:
            true = (true[0], 0.005 + (s - 50) * math.sin(0.02))
        assert abs(bent.to_local(*true)[1]) <= 0.01
    # Seen over the length of a car it hardly bends.
    assert only(kinked(0.005, 0.0), "road 1 forward").segment == "straight"
    assert "degrees at s = 50 m without a curve" in kinked(0.2, 0.0).rejected[0][1]
    assert "0.300 m beside the end before it" in kinked(0.0, 0.3).rejected[0][1]


def test_a_length_that_the_geometry_hasnt(made: Made, words: Words) -> None:
    library = load_library(made.road(length=200.0, geometry=words.at(0, 0, 0, 100)).write())
    assert "says that it is 200 m long; its geometry has 100 m" in library.rejected[0][1]


def test_lanes_beyond_the_centre_of_curvature_have_no_coordinates(made: Made, words: Words) -> None:
    geometry = words.at(0, 0, 0, 10, '<arc curvature="0.3"/>')
    library = load_library(made.road(length=10.0, geometry=geometry).write())
    assert library.blocks == ()
    assert "3.5 m from the reference line on the inner side of a bend of 3.3 m" in str(
        library.rejected
    )


def test_straight_parts_of_bent_roads_are_blocks_too(made: Made, words: Words) -> None:
    made.road("x", 120.0, geometry=words.at(0, 0, 0, 120))
    line = only(load_library(made.write()), "road x forward").line
    made.parts.clear()
    arc_end = (120 + 50 * math.sin(0.8), 50 * (1 - math.cos(0.8)))
    geometry = (
        words.at(0, 0, 0, 120)
        + words.at(120, 0, 0, 40, '<arc curvature="0.02"/>', 120)
        + words.at(*arc_end, 0.8, 30, s=160)
    )
    library = load_library(made.road("x", 190.0, geometry=geometry).write())
    whole = only(library, "road x forward")
    assert whole.segment == "curve"
    (name,) = [n for n in blocks(library) if n.startswith("road x forward [")]
    part = only(library, name)
    assert part.segment == "straight"
    assert 110.0 <= part.length_m <= 120.0
    assert part.exits == ("road x forward",)
    assert part.line.pose(50.0) == line.pose(50.0)
    back = next(b for n, b in blocks(library).items() if n.startswith("road x backward ["))
    assert back.length_m == pytest.approx(part.length_m, abs=2.0)
    assert back.entrances == ("road x backward",)


# -- joining --------------------------------------------------------------------------------------


def test_roads_that_continue_one_another_are_one_block(made: Made, words: Words) -> None:
    # The second road runs against the first, as maps of real editors have it.
    made.road("a", 60.0, links=words.to_road("successor", "b", "end"))
    made.road(
        "b",
        40.0,
        geometry=words.at(100, 0, math.pi, 40),
        links=words.to_road("successor", "a", "end"),
        objects='<object id="1" type="crosswalk" s="10" t="0"/>',
    )
    library = load_library(made.write())
    assert sorted(blocks(library)) == ["roads a+b backward", "roads a+b forward"]
    forward = only(library, "roads a+b forward")
    assert forward.length_m == pytest.approx(100.0)
    assert forward.notes == ("joins roads a, b",)
    assert forward.crossings_s_m == pytest.approx((90.0,))
    assert only(library, "roads a+b backward").notes == ("joins roads b, a",)


@pytest.mark.parametrize(
    "change",
    [
        {"head": '<type s="0" type="town"/>'},
        {"head": '<type s="0" type="unknown"><speed max="9"/></type>'},
        {"geometry": '<geometry s="0" x="60.5" y="0" hdg="0" length="40"><line/></geometry>'},
        {"geometry": '<geometry s="0" x="60" y="0" hdg="0.1" length="40"><line/></geometry>'},
    ],
)
def test_roads_that_differ_stay_apart(made: Made, words: Words, change: dict[str, str]) -> None:
    made.road("a", 60.0, links=words.to_road("successor", "b", "start"))
    plain = {"geometry": words.at(60, 0, 0, 40)}
    made.road("b", 40.0, links=words.to_road("predecessor", "a", "end"), **{**plain, **change})
    library = load_library(made.write())
    assert only(library, "road a forward").exits == ("road b forward",)
    assert only(library, "road a backward").entrances == ("road b backward",)


def test_a_lane_more_parts_roads(made: Made, words: Words) -> None:
    made.road("a", 60.0, links=words.to_road("successor", "b", "start"))
    made.road("b", 40.0, geometry=words.at(60, 0, 0, 40), sections=words.four_lanes)
    library = load_library(made.write())
    assert len(library.blocks) == 4
    assert only(library, "road b forward").entrances == ("road a forward",)


def test_a_ring_of_roads_ends_somewhere(made: Made, words: Words) -> None:
    radius = 50.0
    quarter = math.pi / 2 * radius
    for i in range(4):
        yaw = i * math.pi / 2
        x, y = radius * math.sin(yaw), radius * (1 - math.cos(yaw))
        made.road(
            str(i),
            quarter,
            geometry=words.at(x, y, yaw, quarter, f'<arc curvature="{1 / radius}"/>'),
            links=words.to_road("predecessor", str((i + 3) % 4), "end")
            + words.to_road("successor", str((i + 1) % 4), "start"),
        )
    library = load_library(made.write())
    forward = [b for b in library.blocks if b.block_id.endswith("forward")]
    assert sum(block.length_m for block in forward) == pytest.approx(2 * math.pi * radius)
    # Each part has coordinates: none turns right round.
    for block in forward:
        place = block.line.to_map(block.length_m / 2, 3.0)
        assert block.line.to_local(*place) == pytest.approx((block.length_m / 2, 3.0), abs=1e-6)
        assert block.exits
        assert block.entrances


def test_a_road_that_is_its_own_neighbour(made: Made, words: Words) -> None:
    made.road("a", links=words.to_road("successor", "a", "end"))
    made.road("b", links=words.to_road("successor", "b", "start"))
    library = load_library(made.write())
    assert len(library.blocks) == 4


def test_links_to_nowhere_are_told(made: Made, words: Words) -> None:
    made.road("a", links=words.to_road("successor", "gone", "end"))
    made.add(
        '<junction id="9"><connection id="0" incomingRoad="a" connectingRoad="lost" '
        'contactPoint="start"/></junction>'
    )
    library = load_library(made.write())
    assert ("road a end", "is linked to road gone, which isn't there") in library.rejected
    assert any("isn't there" in why and name == "junction 9" for name, why in library.rejected)


# -- junctions ------------------------------------------------------------------------------------


def test_a_junction_joins_its_arms(crossroads: Path) -> None:
    library = load_library(crossroads)
    through = only(library, "road sn forward")
    assert through.segment == "junction"
    # The arms lead away from the junction, so that traffic comes in against them.
    assert through.entrances == ("road s backward",)
    assert through.exits == ("road n forward",)
    assert only(library, "road s backward").exits == ("road sn forward", "road sw forward")
    assert only(library, "road w forward").entrances == ("road sw forward",)
    assert only(library, "road e backward").exits == ()
    assert "crossing" not in through.permitted


def test_ways_through_a_junction_that_cross(crossroads: Path) -> None:
    library = load_library(crossroads)
    areas = {
        name: only(library, f"road {name} forward").conflict_areas for name in ("sn", "we", "sw")
    }
    (crossing,) = areas["sn"]
    assert crossing.kind == "crossing"
    # West to east crosses 11.75 m on, at 1.75 m to the right of its own line, 3.5 m wide.
    assert crossing.start_s_m <= 10.0 - 1.75 <= crossing.end_s_m
    assert 2.0 <= crossing.end_s_m - crossing.start_s_m <= 9.0
    # South to west and south to north part; neither is in the other's way.
    assert {area.kind for area in areas["we"]} == {"crossing"}


def test_direct_junctions_join_roads_without_connecting_roads(made: Made, words: Words) -> None:
    made.road("in", 50.0, links=words.to_junction("successor", "5"))
    made.road("out", 50.0, geometry=words.at(50, 0, 0, 50))
    made.add(
        '<junction id="5" type="direct"><connection id="0" incomingRoad="in" linkedRoad="out" '
        'contactPoint="start"/></junction>'
    )
    library = load_library(made.write())
    # Nothing but the junction is between them: they continue one another.
    assert only(library, "roads in+out forward").length_m == pytest.approx(100.0)


# -- malformed maps -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('length="100.0" junction', 'length="-5" junction', "road 1 / length: is out of bounds"),
        ('length="100.0" junction', "junction", "road 1: has no attribute 'length'"),
        ('length="100.0"><line', 'length="-1"><line', r"geometry\[0\] / length: is out of bounds"),
        ('x="0"', 'x="inf"', r"road 1 / planView\[0\] / geometry\[0\] / x: is not finite"),
        ('hdg="0"', 'hdg="north"', r"geometry\[0\] / hdg: is not a number \(got 'north'\)"),
        ("<line/>", "", r"geometry\[0\]: has no shape"),
        ("<line/>", "<nurbs/>", "unknown shape nurbs"),
        ("<line/>", "<arc/>", r"arc\[0\]: has no attribute 'curvature'"),
        ("<line/>", '<spiral curvStart="0" curvEnd="x"/>', "curvEnd: is not a number"),
        ("<line/>", '<paramPoly3 pRange="km"/>', "has no attribute 'aU'"),
        ('s="0.0"', 's="-1"', r"laneSection\[0\] / s: is out of bounds"),
        ('a="3.5"', 'a="1e99"', "a: is out of bounds"),
        ('<lane id="-1"', '<lane id="-1.5"', "id: is not a whole number"),
        ('<lane id="-1"', '<lane id="-2"', "leaves a lane id out"),
        ('<lane id="-1"', '<lane id="4"', "stands on the right"),
        ('<road id="1"', "<road", "road: has no attribute 'id'"),
        ("<link>", '<link><successor elementType="moon"/>', "elementType: is unknown"),
        ("<link>", '<link><successor elementType="road"/>', "has no attribute 'elementId'"),
        (
            "<link>",
            '<link><successor elementId="1" contactPoint="middle"/>',
            "contactPoint: is no end of a road",
        ),
        (
            "</OpenDRIVE>",
            '<junction id="1"><connection id="0"/></junction></OpenDRIVE>',
            r"junction 1 / connection 0: has no attribute 'incomingRoad'",
        ),
        ("OpenDRIVE", "osm", "outermost element is <osm>"),
    ],
)
def test_malformed_maps_name_file_and_element(made: Made, old: str, new: str, message: str) -> None:
    path = made.road().write()
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_library(path)
    assert caught.value.file == str(path)


def test_two_roads_with_one_id(made: Made) -> None:
    with pytest.raises(InputError, match=r"road 1 / id: has the id of another road"):
        load_library(made.road().road().write())


def test_records_out_of_order(made: Made, words: Words) -> None:
    sections = words.section("", words.lane(-1), 50.0) + words.section("", words.lane(-1), 0.0)
    with pytest.raises(InputError, match=r"laneSection\[1\] / s: starts before the one ahead"):
        load_library(made.road(sections=sections).write())


def test_a_road_without_lane_sections(made: Made) -> None:
    library = load_library(made.road(sections="").write())
    assert library.rejected == (("road 1", "it has no lane section"),)


def test_a_map_without_roads(made: Made) -> None:
    with pytest.raises(InputError, match="has no road"):
        load_library(made.write())


BOMB = (
    '<!DOCTYPE a [<!ENTITY a "x"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
)


@pytest.mark.parametrize(
    "declaration", [BOMB, '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/hostname">]>']
)
def test_entities_are_refused(made: Made, declaration: str) -> None:
    path = made.road().write()
    text = path.read_text()
    head, body = text.split("?>", 1)
    path.write_text(f"{head}?>{declaration}{body}".replace("<line/>", "<line/>&c;", 1))
    with pytest.raises(InputError, match="declares entities"):
        load_library(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not valid XML"),
        (b"\x00\x01\x02", "is not valid XML"),
        (b'<?xml version="1.0" encoding="klingon"?><OpenDRIVE/>', "is not valid XML"),
        (b'<?xml version="1.0" encoding="utf-16"?><OpenDRIVE/>', "is not valid XML"),
        (b"<OpenDRIVE" + b' a="1"' * 2 + b"/>", "is not valid XML"),
    ],
)
def test_files_that_are_no_xml(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "map.xodr"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        load_library(path)


def test_files_that_cant_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can't be read: No such file"):
        load_library(tmp_path / "gone.xodr")
    with pytest.raises(InputError, match="is no file"):
        load_library(tmp_path)
    with pytest.raises(InputError):
        load_library("map\x00.xodr")


def test_sizes_are_bounded(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    path = made.road().write()
    deep = path.read_text().replace("<line/>", "<line>" + "<a>" * 100 + "</a>" * 100 + "</line>")
    nested = made.folder / "deep.xodr"
    nested.write_text(deep)
    with pytest.raises(InputError, match="nested more than 64 deep"):
        load_library(nested)
    monkeypatch.setattr(xml_input, "MAX_PART_ELEMENTS", 5)
    with pytest.raises(InputError, match="more than 5 elements"):
        load_library(path)
    monkeypatch.setattr(xml_input, "MAX_MAP_BYTES", 10)
    with pytest.raises(InputError, match="at most 0 MiB"):
        load_library(path)


def test_too_many_records_and_lanes(made: Made, words: Words) -> None:
    many = "".join(words.at(0, 0, 0, 0.01) for _ in range(10_001))
    with pytest.raises(InputError, match="is one of 10001; at most 10000"):
        load_library(made.road(geometry=many).write())
    made.parts.clear()
    wide = words.section("", "".join(words.lane(-1 - i) for i in range(65)))
    with pytest.raises(InputError, match="has 65 lanes; at most 64"):
        load_library(made.road(sections=wide).write())


def test_a_huge_road_doesnt_hang(made: Made, words: Words) -> None:
    widths = "".join(f'<width sOffset="{i * 0.05}" a="3.5" b="0.001"/>' for i in range(2000))
    sections = "".join(
        words.section("", words.lane(-1, widths) + words.lane(-2, widths), s * 0.5)
        for s in range(20)
    )
    library = load_library(made.road(sections=sections).write())
    assert library.blocks
