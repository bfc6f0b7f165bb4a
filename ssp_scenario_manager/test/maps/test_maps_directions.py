"""Lanes that another kind of traffic, or traffic of another direction, drives on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ssp_scenario_manager.compile.choose import NoBlockChosen, choose_block
from ssp_scenario_manager.compile.place import Realisation
from ssp_scenario_manager.compile.retrieval import score_blocks
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.maps.block import LEFT_HAND, Block, Library
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.scenarios.base import CannotPlace

Made = Any
Words = Any


def lanes(block: Block) -> list[tuple[str, float, bool]]:
    return [(lane.name, round(lane.y_m, 3), lane.forward) for lane in block.lanes]


def only(library: Library, block_id: str) -> Block:
    found = {block.block_id: block for block in library.blocks}
    assert block_id in found, (sorted(found), library.rejected, library.faults)
    return found[block_id]


# -- direction of travel --------------------------------------------------------------------------


def direction_data(word: str) -> str:
    """Vendor data with a lane's direction of travel."""
    return f'<userData><vectorLane sOffset="0" laneId="x" travelDir="{word}"/></userData>'


def test_vendor_data_that_agrees_with_the_side_is_no_fault(made: Made, words: Words) -> None:
    sections = words.section(
        words.lane(2, 2, "sidewalk", direction_data("forward"))
        + words.lane(1, inner=direction_data("backward")),
        words.lane(-1, inner=direction_data("forward"))
        + words.lane(-2, 2, "biking", direction_data("undirected")),
    )
    library = load_library(made.road(sections=sections).write())
    assert [block.block_id for block in library.blocks] == ["road 1 backward", "road 1 forward"]
    made.parts.clear()
    turned = words.lane(-1, inner=direction_data("backward"), attributes='direction="reversed"')
    library = load_library(made.road(sections=words.section("", turned)).write())
    assert [block.block_id for block in library.blocks] == ["road 1 backward"]


@pytest.mark.parametrize(
    ("attributes", "left", "right"),
    [
        ("", "forward", "backward"),
        ("", "backward", "backward"),
        ('rule="LHT"', "backward", "forward"),
    ],
)
def test_vendor_data_against_the_side_leaves_the_road_out_by_name(
    made: Made, words: Words, attributes: str, left: str, right: str
) -> None:
    sections = words.section(
        words.lane(1, inner=direction_data(left)), words.lane(-1, inner=direction_data(right))
    )
    library = load_library(made.road(sections=sections, attributes=attributes).road("2").write())
    assert [block.block_id for block in library.blocks] == ["road 2 backward", "road 2 forward"]
    ((name, why),) = library.faults
    assert name == "road 1"
    assert "travelDir is" in why
    event = load_event("cut_in")[0]
    scores = score_blocks(event, library)

    def nowhere(block: Block) -> Realisation:
        raise CannotPlace(block.block_id)

    with pytest.raises(NoBlockChosen, match=r"no such block; road 1 is left out: its travelDir"):
        choose_block(library, scores, nowhere, choice="road 1 forward", who="A")
    with pytest.raises(
        NoBlockChosen, match=r"no block of it fits.*road 1 is left out: its travelDir"
    ):
        choose_block(library, scores, nowhere)


@pytest.mark.parametrize(
    "more", [{"attributes": 'direction="both"'}, {"inner": direction_data("bidirectional")}]
)
def test_a_lane_of_both_directions_is_no_driving_lane(
    made: Made, words: Words, more: dict[str, str]
) -> None:
    sections = words.section(words.lane(1), words.lane(-1) + words.lane(-2, **more))
    library = load_library(made.road(sections=sections).write())
    forward = only(library, "road 1 forward")
    assert lanes(forward) == [("lane -1", -1.75, True), ("lane 1", 1.75, False)]
    assert forward.shoulder_right_m == 3.5
    made.parts.clear()
    library = load_library(made.road(sections=words.section("", words.lane(-1, **more))).write())
    assert library.rejected == (("road 1", "lane -1 is driven in both directions"),)


# -- left-hand traffic ----------------------------------------------------------------------------


def test_left_hand_traffic_is_refused_also_where_nobody_comes_the_other_way(
    made: Made, words: Words
) -> None:
    sections = words.section(words.lane(2) + words.lane(1), "")
    library = load_library(made.road(sections=sections, attributes='rule="LHT"').write())
    block = only(library, "road 1 forward")
    assert block.left_hand
    assert LEFT_HAND in block.notes
    for name in ("cut_in", "vru_crossing"):
        (score,) = score_blocks(load_event(name)[0], library)
        assert any("left-hand traffic" in reason for reason in score.reasons)


@pytest.mark.parametrize("rule", ["LHT", "lht", " Lht "])
def test_the_side_is_read_in_any_case(made: Made, rule: str) -> None:
    library = load_library(made.road(attributes=f'rule="{rule}"').write())
    assert all(block.left_hand for block in library.blocks)
    assert not library.faults


@pytest.mark.parametrize(
    ("attributes", "lane", "why"),
    [
        ('rule="left"', "", "'left' is no rule of a road; write RHT or LHT"),
        ("", 'direction="forward"', "'forward' is no direction of a lane; write standard or"),
    ],
)
def test_a_word_that_hides_the_direction_leaves_the_road_out_by_name(
    made: Made, words: Words, attributes: str, lane: str, why: str
) -> None:
    sections = words.section(words.lane(1), words.lane(-1, attributes=lane))
    library = load_library(made.road(sections=sections, attributes=attributes).road("2").write())
    assert {block.block_id for block in library.blocks} == {"road 2 backward", "road 2 forward"}
    ((name, told_why),) = library.faults
    assert name == "road 1"
    assert told_why.startswith(why)


def street(left_hand: str, strips: list[tuple[float, str]]) -> str:
    """A one-way SUMO edge of lanes of 3 m: their middles and permissions, outermost first."""
    text = "".join(
        f'<lane id="E_{i}" index="{i}" {more} speed="14" width="3" shape="0,{y} 200,{y}"/>'
        for i, (y, more) in enumerate(strips)
    )
    return f'<net version="1.20"{left_hand}><edge id="E" from="A" to="B">{text}</edge></net>'


WALK = 'allow="pedestrian"'
STRIPS = [(10.5, WALK), (7.5, 'allow="bicycle"'), (4.5, ""), (1.5, 'changeLeft="bus"')]


def test_left_hand_networks_number_lanes_from_the_left(tmp_path: Path) -> None:
    path = tmp_path / "town.net.xml"
    path.write_text(street(' lefthand="true"', STRIPS))
    library = load_library(path)
    block = only(library, "edge E forward")
    assert [(lane.name, round(lane.y_m, 3)) for lane in block.lanes] == [("E_3", 0), ("E_2", 3)]
    assert (block.left_boundary, block.shoulder_left_m, block.sidewalk_left_m) == ("sidewalk", 3, 3)
    assert (block.right_boundary, block.sidewalk_right_m) == ("any", 0)
    # Lane 3 lets nobody inwards, which is to the right of it: there is no such lane.
    assert {"lane_change_left", "lane_change_right"} <= block.permitted
    assert (block.left_hand, block.notes) == (True, (LEFT_HAND,))
    for score in score_blocks(load_event("vru_crossing")[0], library):
        assert any("left-hand traffic" in reason for reason in score.reasons)


@pytest.mark.parametrize("attribute", ["", ' lefthand="false"', ' lefthand="0"'])
def test_right_hand_networks_stay_as_they_are(tmp_path: Path, attribute: str) -> None:
    path = tmp_path / "town.net.xml"
    path.write_text(street(attribute, [(-y, more) for y, more in STRIPS]))
    block = only(load_library(path), "edge E forward")
    assert [lane.name for lane in block.lanes] == ["E_2", "E_3"]
    assert (block.right_boundary, block.shoulder_right_m, block.sidewalk_right_m) == (
        "sidewalk",
        3,
        3,
    )
    assert not block.left_hand


@pytest.mark.parametrize(("sign", "attribute"), [(1, ""), (-1, ' lefthand="true"')])
def test_what_lies_beyond_the_lanes_of_the_other_direction(
    tmp_path: Path, sign: int, attribute: str
) -> None:
    def edge(name: str, y: float, start: int) -> str:
        y, far = sign * y, sign * 3 * y
        ends = f"{start},{{}} {200 - start},{{}}"
        return (
            f'<edge id="{name}" from="{start}" to="{200 - start}">'
            f'<lane id="{name}_0" index="0" {WALK} speed="14" shape="{ends.format(far, far)}"/>'
            f'<lane id="{name}_1" index="1" speed="14" shape="{ends.format(y, y)}"/></edge>'
        )

    path = tmp_path / "town.net.xml"
    path.write_text(f'<net version="1.20"{attribute}>{edge("a", -2, 0)}{edge("b", 2, 200)}</net>')
    block = only(load_library(path), "edge a forward")
    assert [lane.name for lane in block.lanes] == (["a_1", "b_1"] if sign > 0 else ["b_1", "a_1"])
    assert (block.right_boundary, block.left_boundary) == ("sidewalk", "sidewalk")


# -- access ---------------------------------------------------------------------------------------


def access(rule: str, *who: str, s: float = 0, children: bool = False) -> str:
    """Restrictions of access, as attributes or as elements of their own."""
    if children:
        inner = "".join(f'<restriction type="{name}"/>' for name in who)
        return f'<access sOffset="{s}" {rule}>{inner}</access>'
    return "".join(f'<access sOffset="{s}" {rule} restriction="{name}"/>' for name in who)


ALLOW, DENY = 'rule="allow"', 'rule="deny"'


@pytest.mark.parametrize(
    ("elements", "driving"),
    [
        (access(ALLOW, "bus"), False),
        (access(ALLOW, "bus", "taxi", children=True), False),
        (access(ALLOW, "bus", "passengerCar"), True),
        (access(ALLOW, "autonomousTraffic"), True),
        (access(DENY, "passengerCar"), False),
        (access(DENY, "passengerCar", "truck", children=True), False),
        (access(DENY, "truck"), True),
        (access(DENY, "none"), True),
        (access("", "pedestrian"), True),
        ("", True),
    ],
)
def test_lanes_that_cars_are_kept_out_of_are_no_driving_lanes(
    made: Made, words: Words, elements: str, driving: bool
) -> None:
    sections = words.section(words.lane(1), words.lane(-1) + words.lane(-2, inner=elements))
    block = only(load_library(made.road(sections=sections).write()), "road 1 forward")
    assert len(block.forward_lanes) == (2 if driving else 1)
    assert block.shoulder_right_m == (0.0 if driving else 3.5)


def test_a_road_is_cut_where_a_bus_lane_begins_and_ends(made: Made, words: Words) -> None:
    elements = access(ALLOW, "bus", s=30) + access(DENY, "none", s=70)
    sections = words.section("", words.lane(-1) + words.lane(-2, inner=elements))
    library = load_library(made.road(sections=sections).write())
    found = [(block.block_id, len(block.lanes)) for block in library.blocks]
    assert found == [
        ("road 1 [0-30 m] forward", 2),
        ("road 1 [30-70 m] forward", 1),
        ("road 1 [70-100 m] forward", 2),
    ]
    made.parts.clear()
    closed = words.section("", words.lane(-1, inner=access(ALLOW, "bus")))
    library = load_library(made.road(sections=closed).write())
    assert library.rejected == (("road 1", "lane -1 is closed to cars (access)"),)


# -- sections of one side -------------------------------------------------------------------------


def single(text: str) -> str:
    return text.replace("<laneSection ", '<laneSection singleSide="true" ')


def test_sections_of_one_side_keep_the_other_side(made: Made, words: Words) -> None:
    taper = '<width sOffset="0" a="3.5"/><width sOffset="60" a="3.5" b="0.01"/>'
    sections = (
        words.section(words.lane(1, taper), words.lane(-1))
        + single(words.section("", words.lane(-1) + words.lane(-2), 50.0))
        + single(words.section(words.lane(2) + words.lane(1), "", 80.0))
    )
    library = load_library(made.road(sections=sections).write())
    found = {
        b.block_id: [lane.name for lane in b.lanes] for b in library.blocks if b.lanes[0].forward
    }
    assert found["road 1 [0-50 m] forward"] == ["lane -1", "lane 1"]
    assert found["road 1 [50-80 m] forward"] == ["lane -2", "lane -1", "lane 1"]
    assert found["road 1 [80-100 m] forward"] == ["lane -2", "lane -1", "lane 1", "lane 2"]
    # The width goes on along the road, from where its own section began.
    middle = only(library, "road 1 [50-80 m] forward").lanes[-1]
    assert middle.y_m == pytest.approx(0.5 * (3.5 + 3.7) / 2, abs=0.01)


def test_one_side_that_repeats_itself_is_one_block(made: Made, words: Words) -> None:
    sections = words.four_lanes + single(words.section("", words.lane(-1) + words.lane(-2), 40.0))
    library = load_library(made.road(sections=sections).write())
    assert [(block.block_id, block.length_m) for block in library.blocks] == [
        ("road 1 [0-100 m] backward", 100.0),
        ("road 1 [0-100 m] forward", 100.0),
    ]


def test_a_section_of_both_sides_ends_what_went_on(made: Made, words: Words) -> None:
    sections = words.two_way + words.section("", words.lane(-1), 40.0)
    library = load_library(made.road(sections=sections).write())
    assert only(library, "road 1 [40-100 m] forward").backward_lanes == ()
