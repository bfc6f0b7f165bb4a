"""OpenDRIVE of our blocks: valid, and the same road to anybody who reads it."""

from __future__ import annotations

import importlib.util
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.site import LIBRARY

MAPS = ("bend.xodr", "motorway.xodr")

BENT = [
    CurvePiece(length_m=50.0),
    CurvePiece(length_m=40.0, end_curvature_1pm=-0.01),
    CurvePiece(length_m=70.0, start_curvature_1pm=-0.01, end_curvature_1pm=-0.01),
    CurvePiece(length_m=80.0, start_curvature_1pm=-0.01, end_curvature_1pm=0.006),
]


def need(element: ET.Element, path: str) -> ET.Element:
    """The element at a path, which must be there."""
    found = element.find(path)
    assert found is not None, path
    return found


def number(element: ET.Element, name: str) -> float:
    return float(element.get(name, "nan"))


def road_of(block: Any) -> ET.Element:
    return need(ET.fromstring(opendrive_map(block, "here", {})), "road")


@pytest.fixture(scope="module")
def xsd() -> etree.XMLSchema:
    """The standard's schema of version 1.7, which takes 1.5 as well."""
    spec = importlib.util.find_spec("schemas")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    folder = Path(next(iter(spec.submodule_search_locations)))
    return etree.XMLSchema(etree.parse(folder / "opendrive_17_core.xsd"))


def test_is_valid_opendrive(block_of: Any, xsd: Any) -> None:
    for block in (block_of(), block_of(BENT, Pose2(10.0, 20.0, 2.0))):
        document = etree.fromstring(opendrive_map(block, "here", {"seed": "1"}))
        assert xsd.validate(document), xsd.error_log
        assert [r.get("id") for r in document.iter("road")] == ["1"]


@pytest.mark.parametrize("name", MAPS)
def test_the_shipped_maps_are_valid(name: str, xsd: Any) -> None:
    document = etree.parse(LIBRARY / "maps" / name)
    assert xsd.validate(document), xsd.error_log


def lanes_in(road: ET.Element) -> dict[int, Any]:
    """Type, offset of the centre from the reference line and width, by lane id."""
    edge = {1: 0.0, -1: 0.0}
    edge[1] = edge[-1] = number(need(road, "lanes/laneOffset"), "a")
    found: dict[int, Any] = {}
    for lane in sorted(
        road.iterfind("lanes/laneSection/*/lane"), key=lambda v: abs(int(v.get("id", "0")))
    ):
        number_of = int(lane.get("id", "0"))
        if number_of == 0:
            continue
        sign = 1 if number_of > 0 else -1
        width = number(need(lane, "width"), "a")
        found[number_of] = (lane.get("type", ""), edge[sign] + sign * width / 2, width)
        edge[sign] += sign * width
    return found


def test_a_gap_between_the_directions_is_a_median(block_of: Any) -> None:
    block = block_of(lanes=((0.0, True), (3.5, True), (9.0, False)))
    found = lanes_in(road_of(block))
    assert [found[i][0] for i in (-2, -1)] == ["driving"] * 2
    assert found[1] == ("median", pytest.approx(6.25), pytest.approx(2.0))
    assert found[2] == ("driving", pytest.approx(9.0), 3.5)


def test_traffic_on_the_left_is_told(block_of: Any) -> None:
    block = block_of(lanes=((0.0, False), (3.5, True)))
    assert road_of(block).get("rule") == "LHT"
    assert [lanes_in(road_of(block))[i][0] for i in (-1, 1)] == ["driving"] * 2
    assert road_of(block_of()).get("rule") == "RHT"


@pytest.mark.parametrize(
    ("lanes", "words"),
    [
        (((0.0, False),), "no lane along it"),
        (((0.0, True), (3.5, False), (7.0, True)), "mixes the lanes of both directions"),
        (((0.0, True), (3.0, True)), "overlap"),
    ],
)
def test_lanes_that_cant_be_told_are_refused(lanes: Any, words: str, block_of: Any) -> None:
    with pytest.raises(InputError, match=words):
        opendrive_map(block_of(lanes=lanes), "here", {})


def test_a_piece_that_bends_by_rounding_alone_is_a_line(block_of: Any) -> None:
    bends = [
        CurvePiece(length_m=5.0, start_curvature_1pm=k, end_curvature_1pm=k)
        for k in (2.5e-8, 2.5e-3, -2.5e-8)
    ]
    shapes = road_of(block_of(bends, crossings=())).iterfind("planView/geometry")
    assert [one[0].tag for one in shapes] == ["line", "arc", "line"]


def test_the_crossing_spans_the_carriageway(block_of: Any) -> None:
    block = block_of()
    crossing = need(road_of(block), "objects/object")
    assert crossing.get("type") == "crosswalk"
    assert number(crossing, "s") == 110.0
    middle = number(crossing, "t")
    corners = [number(c, "v") + middle for c in crossing.iterfind("outline/cornerLocal")]
    assert (min(corners), max(corners)) == (block.right_edge_m, block.left_edge_m)


def test_a_zebra_over_some_lanes_is_written_with_its_borders(block_of: Any, tmp_path: Path) -> None:
    half = Crossing(50.0, 2.0, False, -1.75, 5.0)
    block = replace(block_of(), crossings=(half, Crossing(110.0)))
    (path := tmp_path / "here.xodr").write_bytes(opendrive_map(block, "here", {}))
    found = {b.block_id: b for b in load_library(path).blocks}["road 1 forward"]
    assert found.crossings_s_m == (110.0,)
    assert found.zebras_m[0] == (50.0, -1.75, 5.0)


def test_provenance_and_extent_are_in_the_header(block_of: Any) -> None:
    root = ET.fromstring(opendrive_map(block_of(), "here", {"seed": "7", "compiler": "ssp 1"}))
    header = need(root, "header")
    data = {d.get("code"): d.get("value") for d in header.iterfind("userData")}
    assert data == {"seed": "7", "compiler": "ssp 1"}
    sides = [number(header, side) for side in ("west", "east", "south", "north")]
    assert sides == pytest.approx([0.0, 400.0, -1.75, 12.25])


def test_the_same_blocks_give_the_same_bytes(block_of: Any) -> None:
    first = opendrive_map(block_of(BENT), "here", {"b": "2", "a": "1"})
    assert opendrive_map(block_of(BENT), "here", {"a": "1", "b": "2"}) == first


@pytest.mark.parametrize(
    ("permitted", "mark", "change"),
    [
        ({"lane_change_left", "lane_change_right"}, "broken", None),
        ({"lane_change_left"}, "broken", "increase"),
        ({"lane_change_right"}, "broken", "decrease"),
        ({"keep_lane"}, "solid", None),
    ],
)
def test_markings_let_change_lane_who_may(
    permitted: set[str], mark: str, change: str | None, block_of: Any
) -> None:
    road = road_of(block_of(permitted=frozenset(permitted)))
    between = need(road, "lanes/laneSection/right/lane[@id='-1']/roadMark")
    assert (between.get("type"), between.get("laneChange")) == (mark, change)


def test_the_edges_tell_what_is_beyond_them(block_of: Any) -> None:
    block = block_of(
        left_boundary="verge",
        sidewalk_left_m=0.0,
        right_boundary="shoulder",
        sidewalk_right_m=0.0,
        shoulder_right_m=2.0,
    )
    road = road_of(block)
    found = lanes_in(road)
    assert found[3] == ("none", pytest.approx(block.left_edge_m + 3.0), 6.0)
    assert found[-3] == ("shoulder", pytest.approx(block.right_edge_m - 1.0), 2.0)
    marks = {
        lane: need(road, f"lanes/laneSection/*/lane[@id='{lane}']/roadMark").get("type")
        for lane in (2, -2, -3)
    }
    assert marks == {2: "solid", -2: "solid", -3: "solid"}
    kerbs = road_of(block_of())
    assert need(kerbs, "lanes/laneSection/*/lane[@id='-2']/roadMark").get("type") == "curb"


def test_type_and_speed_limit_of_the_road(block_of: Any) -> None:
    kind = need(road_of(block_of(road_type="rural", speed_limit_mps=27.8)), "type")
    assert kind.get("type") == "rural"
    assert (number(need(kind, "speed"), "max"), need(kind, "speed").get("unit")) == (27.8, "m/s")
    assert road_of(block_of(road_type="any", speed_limit_mps=None)).find("type") is None


pieces = st.lists(
    st.builds(
        CurvePiece,
        length_m=st.floats(20.0, 120.0),
        start_curvature_1pm=st.sampled_from([0.0, 0.004, -0.01]),
        end_curvature_1pm=st.sampled_from([0.0, 0.004, -0.01]),
    ),
    min_size=1,
    max_size=4,
)
poses = st.builds(
    Pose2, st.floats(-1000.0, 1000.0), st.floats(-1000.0, 1000.0), st.floats(-3.1, 3.1)
)
SIDES: list[tuple[str, float, float]] = [
    ("sidewalk", 0.0, 2.0),
    ("sidewalk", 1.5, 2.5),
    ("kerb", 0.0, 0.0),
    ("kerb", 2.0, 0.0),
    ("shoulder", 2.5, 0.0),
    ("verge", 0.0, 0.0),
]


@settings(max_examples=40, deadline=None)
@given(
    pieces=pieces,
    pose=poses,
    width=st.floats(2.8, 4.0),
    counts=st.tuples(st.integers(1, 3), st.integers(0, 2)),
    sides=st.tuples(st.sampled_from(SIDES), st.sampled_from(SIDES)),
    inside=st.floats(-3.0, 3.0),
    crossing=st.none() | st.floats(5.0, 15.0),
)
def test_our_own_reader_reads_the_same_block(
    block_of: Any,
    tmp_path_factory: pytest.TempPathFactory,
    pieces: list[CurvePiece],
    pose: Pose2,
    width: float,
    counts: tuple[int, int],
    sides: tuple[tuple[str, float, float], tuple[str, float, float]],
    inside: float,
    crossing: float | None,
) -> None:
    lanes = tuple((inside + i * width, i < counts[0]) for i in range(sum(counts)))
    left, right = sides
    block: Block = block_of(
        pieces,
        pose,
        lanes,
        width,
        left_boundary=left[0],
        shoulder_left_m=left[1],
        sidewalk_left_m=left[2],
        right_boundary=right[0],
        shoulder_right_m=right[1],
        sidewalk_right_m=right[2],
        crossings=() if crossing is None else (Crossing(crossing),),
    )
    path = tmp_path_factory.mktemp("map") / "map.xodr"
    path.write_bytes(opendrive_map(block, "map", {}))
    found = {b.block_id: b for b in load_library(path).blocks}["road 1 forward"]
    assert found.length_m == pytest.approx(block.length_m, abs=1e-6)
    for i in range(9):
        s = i / 8 * block.length_m
        for offset in (0.0, inside):
            assert math.dist(found.line.to_map(s, offset), block.line.to_map(s, offset)) < 1e-6
    for ours, read in zip(block.lanes, found.lanes, strict=True):
        assert read.y_m == pytest.approx(ours.y_m, abs=1e-6)
        assert read.width_m == pytest.approx(ours.width_m, abs=1e-6)
        assert read.forward == ours.forward
    for name in (
        "left_boundary",
        "right_boundary",
        "shoulder_left_m",
        "shoulder_right_m",
        "sidewalk_left_m",
        "sidewalk_right_m",
        "crossings_s_m",
        "speed_limit_mps",
        "road_type",
    ):
        assert getattr(found, name) == pytest.approx(getattr(block, name)), name
    change = {"lane_change_left", "lane_change_right"}
    assert found.permitted & change == (change if counts[0] > 1 else set())


def test_every_marking_of_a_block_is_written(block_of: Any, tmp_path: Path) -> None:
    marks = (Crossing(60.0), Crossing(150.0), Crossing(300.0, 2.0, False, -9.0, 0.5))
    path = tmp_path / "map.xodr"
    path.write_bytes(opendrive_map(block_of(crossings=marks), "map", {}))
    found = {b.block_id: b for b in load_library(path).blocks}["road 1 forward"]
    assert sorted(found.crossings_s_m) == [60.0, 150.0]


@pytest.mark.parametrize("name", MAPS)
def test_our_own_reader_finds_a_block_in_each_shipped_map(name: str) -> None:
    library = load_library(LIBRARY / "maps" / name)
    assert library.rejected == ()
    assert (
        max(len(b.forward_lanes) for b in library.blocks)
        == {
            "bend.xodr": 2,
            "motorway.xodr": 3,
        }[name]
    )
