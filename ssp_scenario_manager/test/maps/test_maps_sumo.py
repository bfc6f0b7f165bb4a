"""SUMO networks: what becomes a block, what it looks like, what is refused and why."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.reference_line import CORNER_CUT_M, Unusable, smooth_line
from ssp_scenario_manager.maps.routes import routes_of

# Two edges of two lanes from A to B and back, a sidewalk, an onward edge over a junction.
NET = """<?xml version="1.0"?><net version="1.20">
<edge id=":B_0" function="internal">
  <lane id=":B_0_0" index="0" speed="8" length="10" shape="100,-5 110,-5"/>
  <lane id=":B_0_1" index="1" speed="8" length="10" shape="100,-1.8 110,-1.8"/>
</edge>
<edge id=":B_c0" function="crossing"><lane id=":B_c0_0" index="0" speed="1" shape="0,0 1,1"/></edge>
<edge id="ab" from="A" to="B" type="highway.residential">
  <lane id="ab_0" index="0" allow="pedestrian" width="2" speed="2" shape="0,-7.6 100,-7.6"/>
  <lane id="ab_1" index="1" disallow="tram" speed="13.9" shape="0,-5 100,-5"/>
  <lane id="ab_2" index="2" speed="12.5" shape="0,-1.8 100,-1.8" changeRight="bus"/>
</edge>
<edge id="ba" from="B" to="A" type="highway.residential">
  <lane id="ba_0" index="0" allow="pedestrian" width="2" speed="2" shape="100,4.4 0,4.4"/>
  <lane id="ba_1" index="1" speed="13.9" shape="100,1.8 0,1.8"/>
</edge>
<edge id="bc" from="B" to="C" type="highway.motorway">
  <lane id="bc_0" index="0" speed="30" shape="110,-5 200,-5"/>
  <lane id="bc_1" index="1" speed="30" shape="110,-1.8 200,-1.8"/>
</edge>
<edge id="rail" from="B" to="D">
  <lane id="rail_0" index="0" allow="rail" speed="30" shape="100,0 100,50"/>
</edge>
<junction id="B" type="priority"/>
<connection from="ab" to="bc" fromLane="1" toLane="0" via=":B_0_0" dir="s" state="M"/>
<connection from="ab" to="bc" fromLane="2" toLane="1" via=":B_0_1" dir="s" state="M"/>
<connection from=":B_0" to="bc" fromLane="0" toLane="0" dir="s" state="M"/>
<connection from="ab" to="ba" fromLane="2" toLane="1" dir="t" state="M"/>
</net>"""


@pytest.fixture
def net(tmp_path: Path) -> Path:
    path = tmp_path / "town.net.xml"
    path.write_text(NET)
    return path


def block(library: Library, block_id: str) -> Block:
    found = {b.block_id: b for b in library.blocks}
    assert block_id in found, (sorted(found), library.rejected)
    return found[block_id]


def test_an_edge_is_a_block_with_the_lanes_of_the_edge_back(net: Path) -> None:
    library = load_library(net)
    assert (library.kind, library.source) == ("sumo", "town.net.xml")
    ab = block(library, "edge ab forward")
    assert [(x.name, round(x.y_m, 6), x.width_m, x.forward) for x in ab.lanes] == [
        ("ab_1", 0.0, 3.2, True),
        ("ab_2", 3.2, 3.2, True),
        ("ba_1", 6.8, 3.2, False),
    ]
    assert ab.length_m == pytest.approx(100.0)
    assert (ab.speed_limit_mps, ab.road_type) == (12.5, "urban")
    assert (ab.right_boundary, ab.sidewalk_right_m) == ("sidewalk", 2.0)
    assert (ab.left_boundary, ab.sidewalk_left_m) == ("sidewalk", 2.0)
    assert "lane_change_left" in ab.permitted
    assert "lane_change_right" not in ab.permitted
    ba = block(library, "edge ba forward")
    assert [x.forward for x in ba.lanes] == [True, False, False]
    assert ba.lanes[0].name == "ba_1"
    assert ba.line.pose(0.0).yaw_rad == pytest.approx(math.pi)
    assert not any("backward" in b.block_id for b in library.blocks)


def test_connections_lead_over_internal_edges(net: Path) -> None:
    library = load_library(net)
    inner = block(library, "edge :B_0 forward")
    assert inner.segment == "junction"
    assert inner.entrances == ("edge ab forward",)
    assert inner.exits == ("edge bc forward",)
    assert block(library, "edge ab forward").exits == ("edge :B_0 forward", "edge ba forward")
    assert block(library, "edge bc forward").entrances == ("edge :B_0 forward",)
    assert "crossing" not in block(library, "edge bc forward").permitted


def test_without_its_junction_an_internal_edge_is_in_none(net: Path) -> None:
    net.write_text(net.read_text().replace('<junction id="B" type="priority"/>', ""))
    library = load_library(net)
    assert ("edge :B_0", "is in junction B, which isn't there") in library.rejected
    assert {one.junction for one in library.blocks} == {None}
    assert "junction" not in {one.segment for one in library.blocks}


def test_what_is_no_road_for_cars_is_told(net: Path) -> None:
    assert load_library(net).rejected == (
        ("edge rail", "it has no lane of 2 m or more for passenger cars"),
    )


def test_a_wide_median_parts_the_directions(net: Path) -> None:
    net.write_text(net.read_text().replace("100,1.8 0,1.8", "100,6.8 0,6.8"))
    assert len(block(load_library(net), "edge ab forward").backward_lanes) == 0


def test_lanes_that_arent_parallel_are_no_block(net: Path) -> None:
    net.write_text(net.read_text().replace("110,-1.8 200,-1.8", "110,-1.8 200,2"))
    assert ("edge bc", "its lanes aren't parallel") in load_library(net).rejected


# -- polylines ------------------------------------------------------------------------------------


def test_a_polyline_that_samples_an_arc_becomes_one() -> None:
    angles = np.linspace(0.0, 1.2, 25)
    points = [(100 * math.sin(a), 100 * (1 - math.cos(a))) for a in angles]
    line = smooth_line(points)
    middle = [line.curvature_1pm(s) for s in np.linspace(10.0, 110.0, 21)]
    assert middle == pytest.approx([0.01] * 21, abs=1e-4)
    assert line.length_m == pytest.approx(120.0, abs=0.1)
    offsets = line.to_local_many(np.array(points))[:, 1]
    assert np.abs(offsets).max() < 0.05


@pytest.mark.parametrize("degrees", [5.0, 30.0, 60.0, 90.0, 140.0, -45.0])
def test_a_corner_is_cut_by_no_more_than_25_cm(degrees: float) -> None:
    a = math.radians(degrees)
    corner = (80.0, 0.0)
    line = smooth_line([(0.0, 0.0), corner, (80 + 60 * math.cos(a), 60 * math.sin(a))])
    assert 0.01 < abs(line.to_local(*corner)[1]) <= CORNER_CUT_M + 1e-9
    end = line.pose(line.length_m)
    assert (end.x_m, end.y_m) == pytest.approx((80 + 60 * math.cos(a), 60 * math.sin(a)), abs=1e-9)
    assert end.yaw_rad == pytest.approx(a)


def test_polylines_that_are_no_road() -> None:
    with pytest.raises(Unusable, match="no length"):
        smooth_line([(1.0, 1.0), (1.0, 1.0)])
    with pytest.raises(Unusable, match="turns by 180 degrees"):
        smooth_line([(0.0, 0.0), (10.0, 0.0), (0.0, 0.0)])
    with pytest.raises(Unusable, match=r"bends by 143 1/m at \(10, 0\)"):
        smooth_line([(0.0, 0.0), (10.0, 0.0), (10.0, 0.014), (10.0, 10.0)])
    zigzag = [(float(i), 3.0 * (i % 2)) for i in range(2000)]
    with pytest.raises(Unusable, match="turns at most"):
        smooth_line(zigzag)


def test_lanes_that_part_lead_on_each_by_itself(net: Path) -> None:
    """Edges of whose lanes one keeps no distance to another had no route at all."""
    parted = NET.replace('shape="100,-1.8 110,-1.8"', 'shape="100,-1.8 110,2"')
    parted = parted.replace('shape="110,-1.8 200,-1.8"', 'shape="110,2 200,2"')
    net.write_text(parted)
    library = load_library(net)
    assert ("edge :B_0", "its lanes aren't parallel") in library.rejected
    assert [one.block_id for one in library.shifting] == [
        "edge :B_0 lane :B_0_0 forward",
        "edge :B_0 lane :B_0_1 forward",
    ]
    assert [one.passage.via for one in routes_of(library)[0] if one.passage is not None] == [
        ("edge :B_0 lane :B_0_0 forward",),
        ("edge :B_0 lane :B_0_1 forward",),
    ]


def test_a_lane_that_ends_before_the_one_beside_it_leads_on(net: Path) -> None:
    """Lanes of a bend begin and end where they do in the network, and not at a common line."""
    net.write_text(NET.replace('shape="100,-5 110,-5"', 'shape="98,-5 110,-5"'))
    library = load_library(net)
    assert [one.block_id for one in library.shifting] == ["edge :B_0 lane :B_0_1 forward"]
    sheared = library.shifting[0]
    assert sheared.line.to_map(0.0, 0.0) == (100.0, -1.8)


def test_routes_over_one_lane_that_is_read_twice_dont_merge(net: Path) -> None:
    """The lane of an edge and the same one along its own middle were a ramp and a road."""
    net.write_text(NET.replace('shape="0,-1.8 100,-1.8"', 'shape="2,-1.8 100,-1.8"'))
    library = load_library(net)
    assert [one.block_id for one in library.shifting] == ["edge ab lane ab_2 forward"]
    found = {one.block_id: one.passage for one in routes_of(library)[0] if one.passage is not None}
    over = "> edge :B_0 forward :B_0_1 > edge bc forward"
    assert {f"junction B: edge ab {x} {over}" for x in ("forward", "lane ab_2 forward")} <= set(
        found
    )
    assert not any(one.conflicts for one in found.values())


# -- malformed networks ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('shape="0,-5 100,-5"', "", "edge ab / lane ab_1: has no attribute 'shape'"),
        ('shape="0,-5 100,-5"', 'shape="0,-5"', "lane ab_1 / shape: has 1 points"),
        ('shape="0,-5 100,-5"', 'shape="0,-5 nan,1"', "has no point in 'nan,1'"),
        ('shape="0,-5 100,-5"', 'shape="0,-5 1e12,1"', "is out of bounds at '1e12,1'"),
        ('shape="0,-5 100,-5"', 'shape="0 1"', "has no point in '0'"),
        ('speed="12.5"', 'speed="fast"', "lane ab_2 / speed: is not a number"),
        ('speed="12.5"', 'speed="-1"', "lane ab_2 / speed: is out of bounds"),
        ('width="2"', 'width="inf"', "lane ab_0 / width: is not finite"),
        ('width="2"', 'width="1_0"', "lane ab_0 / width: is not a number"),
        ('index="1" disallow', 'index="x" disallow', "lane ab_1 / index: is not a whole number"),
        ('index="1" disallow', 'index="7" disallow', "edge ab: leaves a lane index out"),
        ('id="bc" from', 'id="ab" from', "edge ab / id: has the id of another edge"),
        ('<edge id="ab" from', '<edge id="x"/><edge id="ab" from', "edge x: has 0 lanes"),
        (
            '<connection from=":B_0"',
            '<connection fromm=":B_0"',
            "connection: has no attribute 'from'",
        ),
        ("</net>", "", "is not valid XML"),
        ("<net ", '<!DOCTYPE net [<!ENTITY a "a">]><net ', "declares entities"),
    ],
)
def test_malformed_networks_name_file_and_element(
    net: Path, old: str, new: str, message: str
) -> None:
    assert old in NET
    net.write_text(NET.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_library(net)
    assert caught.value.file == str(net)


def test_a_network_without_edges(net: Path) -> None:
    net.write_text("<net/>")
    with pytest.raises(InputError, match="has no edge"):
        load_library(net)


def test_connections_in_a_circle_end(net: Path) -> None:
    net.write_text(
        NET.replace(
            "</net>", '<connection from="bc" to="bc"/><connection from="bc" to="ab"/></net>'
        )
    )
    assert block(load_library(net), "edge bc forward").exits == (
        "edge ab forward",
        "edge bc forward",
    )
