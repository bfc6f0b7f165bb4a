"""Objects and signals of OpenDRIVE maps, and scenery of sites, in the frames of blocks."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.run_file.road import Building, Pole, SceneryItem, Sign, Tree
from ssp_core.world.scenery import item_pose
from ssp_scenario_manager.compile.place import road_of
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.scenery import MOST_OF_ROAD
from ssp_scenario_manager.maps.site import Site, load_site, site_library, site_version

Made = Any
Words = Any

HOUSE = '<object type="building" s="30" t="-12" hdg="0.3" length="10" width="8" height="6" {}/>'


def items(made: Made, block: str = "road 1 forward", **road: Any) -> list[SceneryItem]:
    return list(the_block(made, block, **road).scenery)


def the_block(made: Made, name: str = "road 1 forward", **road: Any) -> Block:
    if road:
        made.road(**road)
    found = {b.block_id: b for b in load_library(made.write()).blocks}
    return found[name]


def signals(text: str) -> str:
    """The map builder's objects, with signals behind them."""
    return f"</objects><signals>{text}</signals><objects>"


def signal(number: str, more: str = 'orientation="+"', s: float = 20.0, t: float = -6.0) -> str:
    return f'<signal s="{s}" t="{t}" type="{number}" {more}/>'


def test_objects_stand_where_the_map_has_them(made: Made) -> None:
    text = (
        HOUSE.format('zOffset="0.5"')
        + '<object type="tree" s="40" t="9" height="11"/>'
        + '<object type="tree" s="41" t="9" height="0"/>'
        + '<object type="pole" s="50" t="-5" height="4"/>'
        + '<object type="streetLamp" s="60" t="5" height="8"/>'
        + '<object type="pole" name="StreetLight_01" s="61" t="5"/>'
        + '<object type="barrier" s="70" t="5" length="9" width="1" height="1"/>'
    )
    assert items(made, objects=text) == [
        Building(
            type="building", s_m=30, l_m=-12, yaw_rad=0.3, length_m=10, width_m=8, height_m=6.5
        ),
        Tree(type="tree", s_m=40, l_m=9, height_m=11),
        Tree(type="tree", s_m=41, l_m=9),
        Pole(type="pole", s_m=50, l_m=-5, height_m=4),
        Pole(type="pole", s_m=60, l_m=5, height_m=8, lamp=True),
        Pole(type="pole", s_m=61, l_m=5, lamp=True),
    ]


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        (signal("274", 'orientation="+" value="50"'), "speed_limit", 50),
        (signal("274", 'orientation="+" value="30" unit="mph"'), "speed_limit", 30),
        (signal("274", 'orientation="+" value="10" unit="m/s"'), "speed_limit", 36),
        (signal("274", 'orientation="+" value="-1" subtype="70"'), "speed_limit", 70),
        (signal("274", 'orientation="+" subtype="56" country="DEU"'), "speed_limit", 60),
        (signal("274", 'orientation="+" subtype="-1"'), "other", None),
        (signal("205"), "yield", None),
        (signal("206", 'orientation="+" country="OpenDRIVE"'), "stop", None),
        (signal("350"), "crossing", None),
        (signal("206", 'orientation="+" country="FR"'), "other", None),
        (signal("120.5"), "other", None),
    ],
)
def test_signs_by_their_numbers(made: Made, text: str, kind: str, value: int | None) -> None:
    (sign,) = items(made, objects=signals(text))
    assert isinstance(sign, Sign)
    assert (sign.kind, sign.value, sign.direction) == (kind, value, "forward")
    assert (sign.s_m, sign.l_m) == (20.0, -6.0)


@pytest.mark.parametrize(
    "text", [signal("294"), signal("1000001"), signal("-1"), signal("206", 'dynamic="yes"')]
)
def test_lights_and_lines_are_no_signs(made: Made, text: str) -> None:
    block = the_block(made, objects=signals(text))
    assert block.scenery == block.notes == ()


@pytest.mark.parametrize(
    ("more", "t", "rule", "direction"),
    [
        ('orientation="+"', 6.0, "RHT", "forward"),
        ('orientation="-"', -6.0, "RHT", "backward"),
        ('orientation="+" hOffset="3.1416"', 6.0, "RHT", "backward"),
        ('orientation="none"', -6.0, "RHT", "forward"),
        ('orientation="none"', 6.0, "RHT", "backward"),
        ("", 6.0, "LHT", "forward"),
    ],
)
def test_signs_face_their_traffic(
    made: Made, more: str, t: float, rule: str, direction: str
) -> None:
    text = signals(signal("206", more, t=t))
    (sign,) = items(made, objects=text, attributes=f'rule="{rule}"')
    assert isinstance(sign, Sign)
    assert sign.direction == direction


def test_limits_that_are_named_objects(made: Made) -> None:
    text = '<object name="Speed_30" type="-1" s="20" t="6" hdg="3.14"/>'
    (sign,) = items(made, objects=text)
    assert sign == Sign(
        type="sign", s_m=20, l_m=6, kind="speed_limit", value=30, direction="backward"
    )


def test_the_same_place_in_map_from_both_directions(made: Made, words: Words) -> None:
    bend = words.at(5, 7, 0.4, 100, '<arc curvature="0.01"/>')
    text = HOUSE.format("") + signals(signal("206"))
    made.road(objects=text, geometry=bend)
    forward, backward = the_block(made), the_block(made, "road 1 backward")
    for one, other in zip(forward.scenery, backward.scenery, strict=True):
        here, there = item_pose(one, forward.line), item_pose(other, backward.line)
        assert (here.x_m, here.y_m) == pytest.approx((there.x_m, there.y_m), abs=1e-6)
    sign = forward.scenery[1]
    assert item_pose(sign, forward.line).yaw_rad == pytest.approx(
        item_pose(backward.scenery[1], backward.line).yaw_rad
    )
    x, y = forward.line.to_map(20.0, -6.0)
    assert (x, y) == pytest.approx(
        (item_pose(sign, forward.line).x_m, item_pose(sign, forward.line).y_m)
    )


def test_cuts_and_joins_take_scenery_along(made: Made, words: Words) -> None:
    wide = words.section(words.lane(1), words.lane(-1) + words.lane(-2), s=40.0)
    made.road(
        sections=words.two_way + wide,
        objects=HOUSE.format("") + '<object type="tree" s="75" t="-11" height="8"/>',
    )
    found = {b.block_id: b.scenery for b in load_library(made.write()).blocks}
    assert [i.s_m for i in found["road 1 [0-40 m] forward"]] == [30.0]
    assert [i.s_m for i in found["road 1 [40-100 m] forward"]] == [35.0]
    assert [i.s_m for i in found["road 1 [40-100 m] backward"]] == [25.0]


def test_joined_roads_keep_both_their_scenery(made: Made, words: Words) -> None:
    made.road("1", links=words.to_road("successor", "2", "start"), objects=HOUSE.format(""))
    made.road(
        "2",
        geometry=words.at(100, 0, 0, 100),
        links=words.to_road("predecessor", "1", "end"),
        objects=HOUSE.format(""),
    )
    assert [i.s_m for i in items(made, "roads 1+2 forward")] == [30.0, 130.0]


def test_outlines_give_extents(made: Made) -> None:
    corners = "".join(
        f'<cornerLocal u="{u}" v="{v}" z="0" height="7"/>'
        for u, v in ((0, 0), (12, 0), (12, 6), (0, 6))
    )
    on_road = "".join(
        f'<cornerRoad s="{s}" t="{t}" dz="0" height="5"/>'
        for s, t in ((60, -9), (70, -9), (70, -15), (60, -15))
    )
    text = (
        f'<object type="building" s="30" t="12" hdg="0"><outline>{corners}</outline></object>'
        f'<object type="building" s="65" t="0"><outlines><outline>{on_road}</outline></outlines>'
        "</object>"
        '<object type="building" s="80" t="15" radius="4" height="9"/>'
    )
    extents = [
        (b.s_m, b.l_m, b.length_m, b.width_m, b.height_m)
        for b in items(made, objects=text)
        if isinstance(b, Building)
    ]
    assert extents == [(36, 15, 12, 6, 7), (65, -12, 10, 6, 5), (80, 15, 8, 8, 9)]


def test_repetitions(made: Made) -> None:
    row = '<repeat s="10" length="60" distance="20" tStart="6" tEnd="9"/>'
    text = f'<object type="tree" s="0" t="0" height="8">{row}</object>'
    assert [(i.s_m, i.l_m) for i in items(made, objects=text)] == [
        (10, 6),
        (30, 7),
        (50, 8),
        (70, 9),
    ]


def test_nothing_of_a_map_stands_on_the_lanes(made: Made) -> None:
    text = (
        '<object type="building" s="30" t="0" length="10" width="8" height="6"/>'
        '<object type="tree" s="40" t="2" height="8"/><object type="tree" s="40" t="5" height="8"/>'
        '<object type="building" s="50" t="20" length="0" width="0" height="6"/>'
        '<object type="building" s="50" t="20" length="900" width="9" height="6"/>'
    )
    block = the_block(made, objects=text)
    assert [i.l_m for i in block.scenery] == [5.0]
    assert block.notes == (
        "2 objects or signs of road 1 can't be drawn",
        "2 objects or signs that stand on the lanes or have no place along the block are left out",
    )


BAD = ["nan", "inf", "-inf", "1e999", "", "wide", "1e300"]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("attribute", ["s", "t", "hdg", "length", "width", "height"])
def test_numbers_that_are_none(made: Made, attribute: str, bad: str) -> None:
    text = HOUSE.format("")
    value = text.split(f' {attribute}="')[1].split('"')[0]
    made.road(objects=text.replace(f' {attribute}="{value}"', f' {attribute}="{bad}"'))
    with pytest.raises(InputError) as caught:
        load_library(made.write())
    assert caught.value.field is not None
    assert f"object[0] / {attribute}" in caught.value.field


@pytest.mark.parametrize(
    "row",
    [
        '<repeat s="0" length="1e6" distance="1e-300"/>',
        '<repeat s="0" length="100" distance="0.001"/>',
        '<repeat s="0" length="nan" distance="1"/>',
        '<repeat s="0" length="10"/>',
    ],
)
def test_endless_repetitions(made: Made, row: str) -> None:
    made.road(objects=f'<object type="tree" s="0" t="9">{row}</object>')
    with pytest.raises(InputError, match="repeat"):
        load_library(made.write())


def test_too_many(made: Made) -> None:
    made.road(objects='<object type="tree" s="9" t="9"/>' * (MOST_OF_ROAD + 1))
    with pytest.raises(InputError, match="too many"):
        load_library(made.write())


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    st.sampled_from(["s", "t", "hdg", "length", "width", "height", "type", "zOffset", "radius"]),
    st.one_of(
        st.floats().map(str),
        st.sampled_from(["tree", "pole", "building", "streetLamp", "-1", "0", "1e5"]),
    ),
)
def test_any_number_gives_blocks_or_an_input_error(made: Made, name: str, value: str) -> None:
    made.parts.clear()
    attributes = {
        "type": "building",
        "s": "30",
        "t": "-12",
        "length": "9",
        "width": "8",
        "height": "6",
    } | {name: value}
    text = " ".join(f'{key}="{word}"' for key, word in attributes.items())
    made.road(objects=f"<object {text}/>")
    try:
        library = load_library(made.write())
    except InputError:
        return
    for block in library.blocks:
        for item in block.scenery:
            assert math.isfinite(item.s_m)
        assert road_of(block).scenery == list(block.scenery)


# -- sites ----------------------------------------------------------------------------------------


def site_with(*scenery: dict[str, Any]) -> Site:
    whole = load_site("boulevard")[0].model_dump(mode="json", by_alias=True)
    whole["blocks"][0]["scenery"] = list(scenery)
    return Site.model_validate(whole)


def test_a_sites_scenery_comes_into_the_run() -> None:
    sign = {"type": "sign", "s_m": 60.0, "l_m": -5.5, "kind": "speed_limit", "value": 50}
    site = site_with(sign)
    road = road_of(site_library(site).blocks[0])
    assert road.scenery == [Sign.model_validate(sign)]
    assert site_version(site) != load_site("boulevard")[1]


def test_a_site_without_scenery_keeps_its_version() -> None:
    assert site_version(site_with()) == load_site("boulevard")[1]
    assert "scenery" not in site_with().model_dump(mode="json")["blocks"][0]


@pytest.mark.parametrize(
    ("l_m", "problem"), [(3.0, "stands on the lanes"), (1500.0, "lies more than 1000 m")]
)
def test_a_sites_scenery_has_to_stand_beside_the_lanes(l_m: float, problem: str) -> None:
    clear = {"type": "tree", "s_m": 60.0, "l_m": 20.0}
    with pytest.raises(InputError, match=problem) as caught:
        site_library(site_with(clear, clear | {"l_m": l_m}))
    assert caught.value.field == "blocks[0].scenery[1]"
