"""OpenDRIVE maps: what becomes a block, what it looks like, what is refused and why."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of
from tests.support.events.map_blocks import blocks, only

Made = Any
Words = Any


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
    # What lies beside its lanes there isn't known: routes lead over them, and no event is in it.
    first = only(library, "road 1 [0-40 m] forward")
    assert first.exits == ("road 1 lane -1 [40-60 m] forward",)
    lane = {block.block_id: block for block in library.shifting}[first.exits[0]]
    assert (lane.entrances, lane.exits) == ((first.block_id,), ("road 1 [60-100 m] forward",))
    assert lanes(lane) == [("lane -1", 0.0, 3.5, True)]
    assert (lane.left_boundary, lane.right_boundary) == ("any", "any")
    for x, y in lane.line.path(0.0, lane.length_m, 0.0):
        assert y == pytest.approx(0.1 * (x - 40.0) - 1.75, abs=0.02)


def test_a_lane_that_shifts_keeps_its_direction_limit_and_narrowest_width(
    made: Made, words: Words
) -> None:
    speed = '<speed sOffset="0" max="9" unit="m/s"/>'
    flared = '<width sOffset="0" a="4.5"/><width sOffset="10" a="4.5" b="-0.05"/>'
    sections = words.section(words.lane(1, flared + '<width sOffset="40" a="3"/>', inner=speed), "")
    library = load_library(made.road(sections=sections).write())
    assert sorted(blocks(library)) == ["road 1 [0-10 m] backward", "road 1 [40-100 m] backward"]
    (lane,) = library.shifting
    assert lane.block_id == "road 1 lane 1 [10-40 m] backward"
    assert (lane.speed_limit_mps, lane.forward_lanes[0].width_m) == (9.0, 3.0)
    assert lane.line.to_map(0.0, 0.0) == pytest.approx((40.0, 1.5))
    assert lane.entrances == ("road 1 [40-100 m] backward",)


def test_a_lane_that_gets_too_narrow_is_no_way_on(made: Made, words: Words) -> None:
    ending = '<width sOffset="0" a="3.5"/><width sOffset="40" a="3.5" b="-0.1"/>'
    sections = words.section("", words.lane(-1, ending + '<width sOffset="60" a="1.5"/>'))
    assert load_library(made.road(sections=sections).write()).shifting == ()


def test_a_lane_that_shifts_beside_keeps_nothing_from_being_one_block(
    made: Made, words: Words
) -> None:
    """Events stay where they were placed: the ids of blocks don't change."""
    wide = '<width sOffset="0" a="3.5" b="0.02"/>'
    sections = words.section(words.lane(1, wide), words.lane(-1))
    made.road("1", 100.0, sections=sections, links=words.to_road("successor", "2", "start"))
    made.road(
        "2",
        100.0,
        geometry=words.at(100, 0, 0, 100),
        sections=words.section(words.lane(1, wide.replace("3.5", "5.5")), words.lane(-1)),
        links=words.to_road("predecessor", "1", "end"),
    )
    library = load_library(made.write())
    assert sorted(blocks(library)) == ["roads 1+2 forward"]
    assert [block.block_id for block in library.shifting] == [
        "road 1 lane 1 backward",
        "road 2 lane 1 backward",
    ]
    assert library.shifting[0].entrances == ("road 2 lane 1 backward",)


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


def test_a_road_of_no_length_is_no_gap(made: Made, words: Words) -> None:
    """CARLA's Town03 has one in its roundabout, which ended there."""
    made.road("a", 60.0, links=words.to_road("successor", "b", "start"))
    links = words.to_road("predecessor", "a", "end") + words.to_road("successor", "c", "start")
    made.road("b", 1.5e-5, geometry=words.at(60, 0, 0, 1.5e-5), links=links)
    links = words.to_road("predecessor", "b", "end")
    made.road("c", 40.0, geometry=words.at(60, 0, 0, 40), links=links, sections=words.four_lanes)
    library = load_library(made.write())
    assert only(library, "road a forward").exits == ("road c forward",)
    assert only(library, "road a backward").entrances == ("road c backward",)


def test_roads_of_no_length_that_follow_one_another_are_no_gap(made: Made, words: Words) -> None:
    made.road("a", 60.0, links=words.to_road("successor", "b", "start"))
    for name, before, beyond in (("b", "a", "d"), ("d", "b", "c")):
        links = words.to_road("predecessor", before, "end")
        links += words.to_road("successor", beyond, "start")
        made.road(name, 1.5e-5, geometry=words.at(60, 0, 0, 1.5e-5), links=links)
    links = words.to_road("predecessor", "d", "end")
    made.road("c", 40.0, geometry=words.at(60, 0, 0, 40), links=links, sections=words.four_lanes)
    library = load_library(made.write())
    assert only(library, "road a forward").exits == ("road c forward",)
    assert only(library, "road a backward").entrances == ("road c backward",)


def test_roads_of_no_length_that_lead_to_one_another_lead_nowhere(made: Made, words: Words) -> None:
    made.road("a", 60.0, links=words.to_road("successor", "b", "start"))
    for name, beyond in (("b", "d"), ("d", "b")):
        links = words.to_road("successor", beyond, "start")
        made.road(name, 1.5e-5, geometry=words.at(60, 0, 0, 1.5e-5), links=links)
    assert only(load_library(made.write()), "road a forward").exits == ()


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


def test_without_its_junction_a_connecting_road_is_in_none(crossroads: Path) -> None:
    """The roads still name it, and what a map connects by it isn't connected any more."""
    text = crossroads.read_text()
    crossroads.write_text(re.sub(r"<junction .*?</junction>", "", text, flags=re.DOTALL))
    library = load_library(crossroads)
    for name in ("sn", "we", "sw"):
        assert (f"road {name}", "is in junction 9, which isn't there") in library.rejected
    assert {one.junction for one in library.blocks} == {None}
    assert routes_of(library) == ([], [])


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
