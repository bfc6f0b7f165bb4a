"""Routes through junctions: where they lead, where they conflict, and what is no route."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_scenario_manager.event_spec.load import load_event, seal_event, write_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, Conflict, Passage
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of
from ssp_scenario_manager.maps.site import Site, load_site, site_library

SN = "junction 9: road s backward > road sn forward lane -1 > road n forward"
WE = "junction 9: road w backward > road we forward lane -1 > road e forward"
SW = "junction 9: road s backward > road sw forward lane -1 > road w forward"


def routes(path: Path) -> dict[str, Block]:
    return {route.block_id: route for route in routes_of(load_library(path))[0]}


def passage(route: Block) -> Passage:
    assert route.passage is not None
    return route.passage


def met(route: Block) -> list[tuple[str, str]]:
    return [(one.kind, one.route) for one in passage(route).conflicts]


def conflict(route: Block, other: str) -> Conflict:
    (found,) = (one for one in passage(route).conflicts if one.route == other)
    return found


# -- OpenDRIVE ------------------------------------------------------------------------------------


def test_a_route_is_the_lane_of_approach_connecting_road_and_exit(crossroads: Path) -> None:
    found = routes(crossroads)
    assert sorted(found) == sorted([SN, WE, SW])
    straight, left = found[SN], found[SW]
    assert (straight.segment, straight.junction) == ("junction", "9")
    assert straight.roads == ("s", "sn", "n")
    assert (straight.entrances, straight.exits) == (("road s backward",), ("road n forward",))
    assert passage(straight).via == ("road sn forward",)
    # Northwards in the lane to the right of the roads' own line, from 60 m before the junction.
    assert straight.line.to_map(0.0, 0.0) == pytest.approx((1.75, -70.0))
    assert straight.line.to_map(140.0, 0.0) == pytest.approx((1.75, 70.0))
    assert straight.length_m == pytest.approx(140.0)
    assert (passage(straight).start_s_m, passage(straight).end_s_m) == pytest.approx((60.0, 80.0))
    assert passage(straight).turn_rad == pytest.approx(0.0, abs=1e-9)
    # The lane beside it is there before and beyond the junction; a turn has its own lane alone.
    lanes = [(x.y_m, x.width_m, x.forward) for x in straight.lanes]
    assert lanes == [(0.0, 3.5, True), (pytest.approx(3.5), 3.5, False)]
    assert [(x.y_m, x.width_m, x.forward) for x in left.lanes] == [(0.0, 3.5, True)]
    # The lane of the turn has a radius of 11.75 m around (-10, -10).
    assert passage(left).turn_rad == pytest.approx(math.pi / 2)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        s = passage(left).start_s_m + share * (passage(left).end_s_m - passage(left).start_s_m)
        x, y = left.line.to_map(s, 0.0)
        assert math.hypot(x + 10.0, y + 10.0) == pytest.approx(11.75, abs=0.03)


def test_routes_that_cross_know_place_angle_and_side(crossroads: Path) -> None:
    found = routes(crossroads)
    one, other = conflict(found[SN], WE), conflict(found[WE], SN)
    assert (one.kind, other.kind) == ("crossing", "crossing")
    # Northwards at x = 1.75 m, eastwards at y = -1.75 m; each enters the junction at 60 m.
    assert (one.s_m, one.other_s_m) == pytest.approx((68.25, 71.75), abs=0.01)
    assert (other.s_m, other.other_s_m) == pytest.approx((71.75, 68.25), abs=0.01)
    assert found[SN].line.to_map(one.s_m, 0.0) == pytest.approx((1.75, -1.75), abs=0.01)
    assert math.degrees(one.angle_rad) == pytest.approx(-90.0, abs=0.1)
    assert (one.comes_from, other.comes_from) == ("left", "right")
    # Lanes of 3.5 m overlap from 3.5 m before the crossing of their middles to 3.5 m after it.
    assert (one.start_s_m, one.end_s_m) == pytest.approx((64.75, 71.75), abs=0.5)
    assert [(x.kind, x.start_s_m) for x in found[SN].conflict_areas] == [
        ("crossing", one.start_s_m),
        ("following", 0.0),
    ]
    # The turn crosses the same lane at y = -1.75 m, on its circle around (-10, -10).
    turn = conflict(found[SW], WE)
    assert turn.s_m == pytest.approx(60.0 + 11.75 * math.asin(8.25 / 11.75), abs=0.05)
    # Routes of one approach only part.
    assert met(found[SN]) == [("crossing", WE)]


def test_conflicts_come_in_the_order_in_which_they_are_met(crossroads: Path) -> None:
    # The turn crosses the lane from the west at x = -1.6 m, the straight on at x = 1.75 m.
    found = routes(crossroads)
    assert met(found[WE]) == [("crossing", SW), ("crossing", SN)]
    first, second = passage(found[WE]).conflicts
    assert first.s_m == pytest.approx(60.0 + 10.0 - 10.0 + 11.75 * math.cos(0.7783), abs=0.1)
    assert second.s_m == pytest.approx(71.75, abs=0.01)


def test_routes_into_one_lane_merge(made: Any, words: Any, crossroads: Path) -> None:
    # From the east to the north, to the right around (10, 10).
    made.road(
        "en",
        math.pi / 2 * 10.0,
        geometry=words.at(10, 0, math.pi, math.pi / 2 * 10.0, '<arc curvature="-0.1"/>'),
        sections=words.section("", words.lane(-1)),
        junction="9",
        links=words.to_road("predecessor", "e", "start") + words.to_road("successor", "n", "start"),
    )
    found = routes(made.write(crossroads.name))
    turn = "junction 9: road e backward > road en forward lane -1 > road n forward"
    one, other = conflict(found[SN], turn), conflict(found[turn], SN)
    assert (one.kind, one.comes_from) == ("merge", "right")
    assert (other.kind, other.comes_from) == ("merge", "left")
    # On a radius of 8.25 m the turn is 0.2 to 0.45 m beside the other lane 1.8 to 2.7 m earlier.
    assert 10.0 - 3.5 <= found[SN].line.to_map(one.s_m, 0.0)[1] <= 10.0 - 1.5
    # From there on they share a lane.
    assert one.end_s_m == pytest.approx(found[SN].length_m)


def test_a_lane_that_no_lane_continues_is_told(made: Any, words: Any, crossroads: Path) -> None:
    crossroads.write_text(
        crossroads.read_text().replace('x="0" y="-10.0" hdg', 'x="0.4" y="-10.0" hdg')
    )
    found, refused = routes_of(load_library(crossroads))
    assert [route.block_id for route in found] == [WE]
    assert dict(refused).keys() == {"road sn forward", "road sw forward"}
    assert all("continues one of an approach to 0.3 m" in why for _, why in refused)


def test_a_route_leads_over_a_lane_that_shifts(crossroads: Path) -> None:
    """It used to end where an arm begins to shift, as those of most roundabouts do."""
    offsets = (
        '<laneOffset s="0" a="0"/><laneOffset s="5" a="0" c="0.00375" d="-0.0000625"/>'
        '<laneOffset s="45" a="2"/>'
    )
    text = crossroads.read_text()
    head, _, tail = text.partition('<road id="s"')
    crossroads.write_text(head + '<road id="s"' + tail.replace("<lanes>", f"<lanes>{offsets}", 1))
    found = routes(crossroads)
    assert sorted(found) == sorted(
        name.replace("road s backward", "road s [0-5 m] backward") for name in (SN, WE, SW)
    )
    left = found[SW.replace("road s backward", "road s [0-5 m] backward")]
    assert left.roads == ("s", "sw", "w")
    assert passage(left).start_s_m == pytest.approx(60.0, abs=0.1)
    # From 15 m on the lane is 2 m farther to the driver's left, up to 45 m before the junction.
    assert left.line.to_map(0.0, 0.0) == pytest.approx((3.75, -70.0), abs=0.15)
    assert left.line.to_map(35.0, 0.0)[0] == pytest.approx(2.75, abs=0.05)
    # One that goes straight on would bend by it.
    straight = found[SN.replace("road s backward", "road s [0-5 m] backward")]
    assert passage(straight).start_s_m == pytest.approx(5.0)


# -- roads beyond the arms ------------------------------------------------------------------------

FAR_M = 200.0


def beyond(made: Any, words: Any, **road: Any) -> dict[str, Block]:
    """Routes of the crossroads whose southern arm of 60 m continues another road."""
    shape = {
        "geometry": words.at(0, -70, -math.pi / 2, FAR_M),
        "sections": words.section(words.lane(1, 3.6), words.lane(-1, 3.6)),
    }
    made.road("far", FAR_M, links=words.to_road("predecessor", "s", "end"), **{**shape, **road})
    return routes(made.write("beyond.xodr"))


def test_a_route_goes_on_over_the_roads_before_its_arm(
    made: Any, words: Any, crossroads: Path
) -> None:
    """A route used to end where the map ends a road, after 60 m of the 150 m that it keeps."""
    short, found = routes(crossroads)[SN], beyond(made, words)
    straight = found[SN]
    assert straight.roads == ("far", "s", "sn", "n")
    assert straight.line.to_map(0.0, 0.0) == pytest.approx((1.8, -160.0))
    part = passage(straight)
    assert (part.start_s_m, part.end_s_m) == pytest.approx((150.0, 170.0), abs=0.01)
    assert straight.length_m == pytest.approx(230.0, abs=0.01)
    # The arm begins 60 m before the junction; beyond the exit there is nothing.
    assert part.arms_s_m == (pytest.approx(90.0, abs=0.01), math.inf)
    assert passage(short).arms_s_m == (-math.inf, math.inf)
    # All else is as without them.
    for name in ("block_id", "entrances", "exits", "speed_limit_mps", "left_boundary"):
        assert getattr(straight, name) == getattr(short, name)
    assert [(x.y_m, x.width_m) for x in straight.lanes] == [(x.y_m, x.width_m) for x in short.lanes]
    before, after = conflict(short, WE), conflict(straight, WE)
    assert after.s_m - before.s_m == pytest.approx(90.0, abs=0.01)
    assert after.other_s_m == pytest.approx(before.other_s_m)


@pytest.mark.parametrize("of", ["narrow", "slow", "bent", "turned"])
def test_no_road_before_it_makes_a_route_worse(
    made: Any, words: Any, crossroads: Path, of: str
) -> None:
    road = {
        "narrow": {"sections": words.section(words.lane(1, 3.4), words.lane(-1, 3.5))},
        "slow": {"head": '<type s="0" type="town"><speed max="10" unit="m/s"/></type>'},
        "bent": {"geometry": words.at(0, -70, -math.pi / 2, FAR_M, '<arc curvature="0.002"/>')},
        "turned": {"geometry": words.at(0, -70, -math.pi / 2 + 0.2, FAR_M)},
    }[of]
    found, short = beyond(made, words, **road)[SN], routes(crossroads)[SN]
    assert (found.roads, found.length_m) == (short.roads, short.length_m)
    assert found.passage == short.passage


def test_lanes_beside_a_route_go_on_before_its_arm(made: Any, words: Any, crossroads: Path) -> None:
    one_way = words.section(words.lane(1))
    found, short = beyond(made, words, sections=one_way), routes(crossroads)
    assert found[SN].roads == short[SN].roads
    # A turn has its own lane alone, and leads over the road.
    assert found[SW].length_m == pytest.approx(short[SW].length_m + 90.0, abs=0.01)


def test_a_route_goes_straight_on_over_the_junction_before_its_own(
    made: Any, words: Any, crossroads: Path
) -> None:
    def link(name: str, came_from: str, x: float, curve: str) -> None:
        made.road(
            name,
            20.0,
            geometry=words.at(x, -90.0, math.pi / 2, 20.0, curve),
            sections=words.section("", words.lane(-1)),
            junction="8",
            links=words.to_road("predecessor", came_from, "start")
            + words.to_road("successor", "s", "end"),
        )

    for name, x in (("far", 0.0), ("beside", -0.5)):
        made.road(
            name,
            FAR_M,
            geometry=words.at(x, -90.0, -math.pi / 2, FAR_M),
            links=words.to_junction("predecessor", "8"),
        )
    link("straight", "far", 0.0, "<line/>")
    link("bent", "beside", -0.2, '<arc curvature="-0.001"/>')
    made.add(
        '<junction id="8">'
        + "".join(
            f'<connection id="{i}" incomingRoad="{a}" connectingRoad="{c}" contactPoint="start">'
            '<laneLink from="1" to="-1"/></connection>'
            for i, (a, c) in enumerate((("far", "straight"), ("beside", "bent")))
        )
        + "</junction>"
    )
    found = routes(made.write("junctions.xodr"))
    (turn,) = (route for name, route in found.items() if name == SW)
    assert turn.roads == ("far", "straight", "s", "sw", "w")
    assert passage(turn).start_s_m == pytest.approx(150.0, abs=0.01)


# -- SUMO -----------------------------------------------------------------------------------------

NET = """<?xml version="1.0"?><net version="1.20">
<edge id=":J_0" function="internal">
  <lane id=":J_0_0" index="0" speed="8" length="8" shape="2,-10 2,-2"/></edge>
<edge id=":J_2" function="internal">
  <lane id=":J_2_0" index="0" speed="8" length="12" shape="2,-2 2,10"/></edge>
<edge id=":J_1" function="internal">
  <lane id=":J_1_0" index="0" speed="8" length="20" shape="-10,-3 10,-3"/></edge>
<edge id="sj" from="S" to="J"><lane id="sj_0" index="0" speed="13" shape="2,-90 2,-10"/></edge>
<edge id="jn" from="J" to="N"><lane id="jn_0" index="0" speed="13" shape="2,10 2,90"/></edge>
<edge id="wj" from="W" to="J"><lane id="wj_0" index="0" speed="13" shape="-90,-3 -10,-3"/></edge>
<edge id="je" from="J" to="E"><lane id="je_0" index="0" speed="13" shape="10,-3 90,-3"/></edge>
<junction id="J" type="priority"/>
<connection from="sj" to="jn" fromLane="0" toLane="0" via=":J_0_0" dir="s" state="m"/>
<connection from=":J_0" to="jn" fromLane="0" toLane="0" via=":J_2_0" dir="s" state="m"/>
<connection from=":J_2" to="jn" fromLane="0" toLane="0" dir="s" state="M"/>
<connection from="wj" to="je" fromLane="0" toLane="0" via=":J_1_0" dir="s" state="M"/>
<connection from=":J_1" to="je" fromLane="0" toLane="0" dir="s" state="M"/>
</net>"""


def test_a_route_follows_internal_edges_to_the_end_of_the_junction(tmp_path: Path) -> None:
    (tmp_path / "town.net.xml").write_text(NET)
    found = {(r.entrances[0], r.exits[0]): r for r in routes(tmp_path / "town.net.xml").values()}
    assert sorted(found) == [
        ("edge sj forward", "edge jn forward"),
        ("edge wj forward", "edge je forward"),
    ]
    north, east = (
        found["edge sj forward", "edge jn forward"],
        found["edge wj forward", "edge je forward"],
    )
    # A vehicle that waits inside the junction goes on over a second internal edge.
    assert passage(north).via == ("edge :J_0 forward", "edge :J_2 forward")
    assert (passage(north).start_s_m, passage(north).end_s_m) == pytest.approx((80.0, 100.0))
    one = conflict(north, east.block_id)
    assert (one.s_m, one.other_s_m) == pytest.approx((87.0, 92.0), abs=0.01)
    assert (one.kind, one.comes_from) == ("crossing", "left")
    assert north.speed_limit_mps == 8.0


# -- sites ----------------------------------------------------------------------------------------


def crossing_site() -> Site:
    """The boulevard, and two lanes that cross it at s = 200 m over a junction of 20 m."""
    site, _ = load_site("boulevard")
    whole = site.model_dump(mode="json", by_alias=True)
    whole["name"] = "market"
    (main_road,) = whole["blocks"]
    main_road |= {"traffic": [], "crossing_x_m": None}

    def part(
        name: str, x: float, y: float, yaw: float, length: float, **more: Any
    ) -> dict[str, Any]:
        return main_road | {
            "id": name,
            "origin": {"x_m": x, "y_m": y, "yaw_rad": yaw},
            "pieces": [{"length_m": length}],
            "lanes": [{"y_m": 0.0, "width_m": 3.5, "direction": "forward"}],
            "permitted": ["keep_lane", "stop"],
            **more,
        }

    north = math.pi / 2
    whole["blocks"] = [
        part("west", 0.0, 0.0, 0.0, 190.0, leads_to=["over"]),
        part("over", 190.0, 0.0, 0.0, 20.0, leads_to=["east"], junction="market"),
        part("east", 210.0, 0.0, 0.0, 190.0),
        part("south", 200.0, -60.0, north, 50.0, leads_to=["through"]),
        part("through", 200.0, -10.0, north, 20.0, leads_to=["north"], junction="market"),
        part("north", 200.0, 10.0, north, 50.0),
    ]
    whole["ot_reachable"] = [{"points": [[0, -60], [400, -60], [400, 60], [0, 60]]}]
    whole["safe_stop_zones"] = whole["ot_reachable"]
    whole["geofence"] = {"points": [[-1, -61], [401, -61], [401, 61], [-1, 61]]}
    return Site.model_validate(whole)


def test_a_site_names_its_junction() -> None:
    library = site_library(crossing_site())
    assert {b.block_id: b.segment for b in library.blocks if b.junction == "market"} == {
        "over": "junction",
        "through": "junction",
    }
    (areas,) = {b.conflict_areas for b in library.blocks if b.block_id == "over"}
    assert [area.kind for area in areas] == ["crossing"]
    found, refused = routes_of(library)
    assert refused == []
    north, east = found
    assert east.block_id == "junction market: west > over lanes[0] > east"
    one = conflict(east, north.block_id)
    # An approach keeps 150 of its 190 m; the other enters the junction at 50 m.
    assert (one.s_m, one.other_s_m) == pytest.approx((160.0, 60.0), abs=0.01)
    assert (one.comes_from, math.degrees(one.angle_rad)) == ("right", pytest.approx(90.0))


def test_a_site_without_a_junction_says_nothing_of_one() -> None:
    site, _ = load_site("boulevard")
    assert "junction" not in site.model_dump(mode="json")["blocks"][0]


@pytest.mark.parametrize(
    ("block", "change", "problem"),
    [
        (0, {"leads_to": []}, r"blocks\[1\]\.leads_to: is in junction market, and no block leads"),
        (1, {"leads_to": []}, r"blocks\[1\]\.leads_to: leads out of junction market to no block"),
        (
            0,
            {"pieces": [{"length_m": 189.0}]},
            r"blocks\[1\]\.origin: no lane of west ends where one of over begins.*1\.00 m apart",
        ),
        (
            1,
            {"permitted": ["keep_lane", "crossing"]},
            r"blocks\[1\]\.permitted: can't be crossed on foot: it is in junction market",
        ),
    ],
)
def test_a_site_whose_junction_contradicts_itself(
    block: int, change: dict[str, Any], problem: str
) -> None:
    whole = crossing_site().model_dump(mode="json", by_alias=True)
    whole["blocks"][block] |= change
    with pytest.raises(InputError, match=problem):
        site_library(Site.model_validate(whole))


# -- ssp maps, ssp compile ------------------------------------------------------------------------


def test_maps_prints_routes_and_conflicts(crossroads: Path, capsys: Any) -> None:
    assert main(["maps", str(crossroads)]) == 0
    told = capsys.readouterr().out
    assert "map.xodr: blocks 11, junctions 1, routes through them 3" in told
    assert "road s backward > road sn forward lane -1 > road n forward: straight on, " in told
    assert "turns left by 90 deg" in told
    assert re.search(
        r"68\.[23] m crosses 3, which comes from the left at -90 deg, there at 71\.", told
    )
    assert main(["maps", str(crossroads), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [route["id"] for route in told["routes"]] == [SN, SW, WE]
    (one,) = told["routes"][0]["conflicts"]
    assert (one["route"], one["kind"]) == (WE, "crossing")
    assert one["at_m"] == pytest.approx([1.75, -1.75], abs=0.01)


def test_maps_refuses_a_junction_that_is_not_there(crossroads: Path, capsys: Any) -> None:
    assert main(["maps", str(crossroads), "--junction", "9"]) == 0
    assert "routes through 9 3" in capsys.readouterr().out
    assert main(["maps", str(crossroads), "--junction", "8"]) == 1
    assert "there is no such junction (got '8'); there are 9" in " ".join(
        capsys.readouterr().err.split()
    )
    # Its roads are there, and lead nowhere.
    text = crossroads.read_text().replace('<predecessor elementType="road"', "<other ")
    crossroads.write_text(
        text.replace("<connection ", "<other ").replace("</connection>", "</other>")
    )
    assert main(["maps", str(crossroads), "--junction", "9"]) == 1
    assert "no route leads through it: road sn forward: no block leads to it" in " ".join(
        capsys.readouterr().err.split()
    )


@pytest.fixture
def at_a_junction(tmp_path: Path) -> Path:
    """A pedestrian's crossing whose source shows a junction."""
    event, _ = load_event("vru_crossing")
    whole = event.model_dump(mode="json", by_alias=True)
    whole["topology"]["segment"] = {"value": "junction", "identity": True}
    path = tmp_path / "at_a_junction.event.yaml"
    write_event(path, seal_event(Event.model_validate(whole)))
    return path


def test_an_event_at_a_junction_is_looked_for_on_routes(
    at_a_junction: Path, crossroads: Path, tmp_path: Path, capsys: Any
) -> None:
    def scores() -> dict[str, list[str]]:
        to = ["--target", "sumo", "--map", str(crossroads), "--out", str(tmp_path / "T"), "--json"]
        assert main(["compile", str(at_a_junction), *to]) == 1
        told = json.loads(capsys.readouterr().out)
        return {score["block"]: score["reasons"] for score in told["scores"]}

    found = scores()
    assert {SN, WE, SW} <= found.keys()
    assert not any(why.startswith("segment") for why in found[SN])
    assert "not permitted: crossing" in found[SN]
    # Without the junction nothing is one.
    head, _, tail = crossroads.read_text().partition('<road id="sn"')
    assert tail
    crossroads.write_text(f"{head}</OpenDRIVE>")
    without = scores()
    assert all("segment straight, needs junction (identity)" in why for why in without.values())
    assert without
    assert not (tmp_path / "T").exists()


def test_a_site_with_a_junction_is_read_from_its_file(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "market.site.yaml"
    path.write_text(yaml.safe_dump(crossing_site().model_dump(mode="json", by_alias=True)))
    assert main(["maps", str(path), "--junction", "market"]) == 0
    assert "160.0 m crosses 1, which comes from the right at 90 deg" in capsys.readouterr().out
