"""Sites: the shipped ones, their blocks and regions, and what contradicts itself."""

from __future__ import annotations

import copy
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.errors import InputError
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import point_in_polygon
from ssp_scenario_manager.maps.block import BlockLane, ConflictArea, conflict_areas
from ssp_scenario_manager.maps.site import (
    Polygon,
    Site,
    Strip,
    load_site,
    region_polygon,
    site_library,
    site_version,
)

SHIPPED = (
    "boulevard",
    "cross_track",
    "crossroads",
    "entry",
    "entry_track",
    "north_track",
    "ring",
    "ring_track",
    "south_loop",
    "tee",
    "tee_track",
)


def mapping(name: str = "south_loop") -> dict[str, Any]:
    site, _ = load_site(name)
    return site.model_dump(mode="json", by_alias=True)


def changed(path: str, value: Any, name: str = "south_loop") -> Site:
    """A shipped site with one field changed; the path is dotted, numbers are indices."""
    whole = copy.deepcopy(mapping(name))
    *inner, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    place: Any = whole
    for part in inner:
        place = place[part]
    place[last] = value
    return Site.model_validate(whole)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_sites_hold_together(name: str) -> None:
    site, version = load_site(name)
    library = site_library(site)
    assert (library.source, library.sha256, library.kind) == (name, version, "site")
    fence = region_polygon(site, site.geofence)
    for block in library.blocks:
        if block.junction is not None:
            assert [lane.forward for lane in block.lanes] == [True]
            continue
        crossed = name.startswith(("cross", "ring", "tee"))
        narrow = crossed or name.startswith("entry")
        assert len(block.forward_lanes) >= (1 if narrow else 2)
        assert block.backward_lanes or block.block_id == "ramp_in"
        assert [lane.y_m for lane in block.lanes] == sorted(lane.y_m for lane in block.lanes)
        wanted = {"following"} | (set() if narrow else {"merge"})
        if not name.startswith("entry"):
            wanted.add("crossing")
        assert {area.kind for area in block.conflict_areas} == wanted
        for share in (0.001, 0.25, 0.5, 0.75, 0.999):
            for offset in (block.left_edge_m + 0.1, block.right_edge_m - 0.1):
                place = block.line.to_map(share * block.length_m, offset)
                assert point_in_polygon(*place, fence)
    for region in (*site.ot_reachable, *site.safe_stop_zones):
        # Strips to the very ends share their border with the fence.
        corners = region_polygon(site, region)
        x = sum(x for x, _ in corners) / len(corners)
        y = sum(y for _, y in corners) / len(corners)
        assert all(
            point_in_polygon(0.999 * cx + 0.001 * x, 0.999 * cy + 0.001 * y, fence)
            for cx, cy in corners
        )


def test_what_is_written_as_a_path_is_one_and_its_reader_says_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "boulevard").mkdir()  # a name of ours stays one
    for name in ("folder", "none/site", "none.xodr", "none.net.xml", str(tmp_path / "none")):
        with pytest.raises(InputError, match="can't be read") as refused:
            load_site(name)
        assert refused.value.file == name
    for name in ("none", ""):
        with pytest.raises(InputError, match=rf"no such site \(got '{name}'\); name one of"):
            load_site(name)
    assert load_site("boulevard")[0].name == "boulevard"


def test_the_two_straight_sites_keep_their_figures() -> None:
    boulevard = site_library(load_site("boulevard")[0]).blocks[0]
    assert boulevard.length_m == 400.0
    assert boulevard.crossings_s_m == (110.0,)
    assert [lane.y_m for lane in boulevard.lanes] == [0.0, 3.5, 7.0, 10.5]
    track = load_site("north_track")[0]
    assert track.blocks[0].origin.yaw_rad == pytest.approx(math.radians(37.0))
    assert [lane.width_m for lane in track.blocks[0].lanes] == [3.75] * 4
    # The fence of today's sessions, in their order.
    site = load_site("boulevard")[0]
    assert region_polygon(site, site.geofence) == [
        (0.0, -6.75),
        (400.0, -6.75),
        (400.0, 17.25),
        (0.0, 17.25),
    ]


def test_the_loop_bends_and_leads_on_to_its_straight() -> None:
    back, bend = site_library(load_site("south_loop")[0]).blocks
    assert (bend.segment, back.segment) == ("curve", "straight")
    assert (bend.exits, back.entrances) == (("back",), ("bend",))
    assert (bend.entrances, back.exits) == ((), ())
    end, start = bend.line.pose(bend.length_m), back.line.pose(0.0)
    assert (end.x_m, end.y_m, end.yaw_rad) == pytest.approx(
        (start.x_m, start.y_m, start.yaw_rad), abs=1e-9
    )
    assert bend.line.curvature_1pm(250.0) == 0.005
    assert bend.lanes[0].width_m != 3.5


def test_a_strip_along_a_bend_follows_it() -> None:
    site = load_site("south_loop")[0]
    strip = Strip(block="bend", from_s_m=150.0, to_s_m=370.0, from_l_m=-3.0, to_l_m=8.0)
    corners = region_polygon(site, strip)
    line = site_library(site).blocks[1].line
    assert len(corners) > 8
    assert corners[0] == pytest.approx(line.to_map(150.0, -3.0))
    for s in (151.0, 200.0, 290.0, 369.0):
        for offset, inside in ((-3.1, False), (-2.9, True), (7.9, True), (8.1, False)):
            assert point_in_polygon(*line.to_map(s, offset), corners) is inside


@pytest.mark.parametrize(
    ("path", "value", "field", "problem"),
    [
        ("blocks.1.id", "bend", r"blocks\[1\].id", "twice"),
        ("blocks.0.leads_to", ["moon"], r"blocks\[0\].leads_to\[0\]", "no block"),
        ("blocks.0.lanes.1.y_m", 2.0, r"blocks\[0\].lanes\[1\]", "overlaps"),
        ("blocks.0.lanes.1.y_m", 5.0, r"blocks\[0\].lanes\[2\]", "overlaps"),
        ("blocks.0.traffic.0.lane", 3, r"blocks\[0\].traffic\[0\].lane", "no such lane"),
        ("blocks.0.traffic.0.x_m", 480.0, r"blocks\[0\].traffic\[0\].x_m", "leaves"),
        (
            "blocks.0.traffic.0.speed_mps",
            30.0,
            r"blocks\[0\].traffic\[0\].speed_mps",
            "oncoming1 is faster than .*the posted speed",
        ),
        (
            "blocks.0.traffic.0.speed_mps",
            30.0,
            r"blocks\[0\].traffic\[0\].speed_mps",
            "oncoming1 is faster than limits.speed_mps, the limit of everybody",
        ),
        (
            "blocks.0.traffic.0.object_class",
            "pedestrian",
            r"blocks\[0\].traffic\[0\].object_class",
            "can't be traffic",
        ),
        ("blocks.0.left_boundary", "verge", r"blocks\[0\].left_boundary", "draws one of 2 m"),
        ("blocks.0.right_boundary", "shoulder", r"blocks\[0\].right_boundary", "draws one of"),
        ("blocks.0.sidewalk_left_m", 0.0, r"blocks\[0\].left_boundary", "has no width"),
        ("blocks.0.crossing_x_m", -1.0, r"blocks\[0\].crossing_x_m", "leaves"),
        ("blocks.0.pieces.2.start_curvature_1pm", 50.0, r"blocks\[0\].pieces", "turns at most"),
        ("ot_reachable.0.block", "moon", r"ot_reachable\[0\].block", "no block"),
        ("ot_reachable.0.to_s_m", 0.0, r"ot_reachable\[0\].to_s_m", "above from_s_m"),
        ("safe_stop_zones.1.to_l_m", -9.0, r"safe_stop_zones\[1\].to_l_m", "above from_l_m"),
        ("safe_stop_zones.0.to_l_m", 300.0, r"safe_stop_zones\[0\]", "centre of curvature"),
        ("geofence.points", [[0, 0], [1, 1], [1, 0], [0, 1]], "geofence.points", "crosses itself"),
        (
            "geofence.points",
            [[0, 0], [1, 1], [0, 0]],
            "geofence.points",
            "leave the last corner out",
        ),
        ("geofence.points", [[0, 0], [1, 1], [2, 0], [1, 1]], "geofence.points", "twice"),
        ("geofence.points", [[0, 0], [1, 1], [2, 2]], "geofence.points", "no area"),
        ("geofence.points", [[i, i * i] for i in range(1200)], "geofence.points", "1200 corners"),
        ("geofence.points", [[0, 0], [8, 0], [8, 8], [4, 0], [0, 8]], "geofence.points", "touches"),
        (
            "geofence.points",
            [[0, 0], [9, 0], [9, 9], [9, 12], [9, 5], [0, 9]],
            "geofence.points",
            "touches itself",
        ),
        ("safe_stop_zones.2.from_l_m", -60.0, r"safe_stop_zones\[2\]", "leaves the geofence by"),
        ("ot_reachable.1.to_s_m", 400.0, r"ot_reachable\[1\]", "leaves the geofence by"),
    ],
)
def test_a_site_that_contradicts_itself(path: str, value: Any, field: str, problem: str) -> None:
    with pytest.raises(InputError, match=rf"(^|\n  ){field}: .*{problem}"):
        site_library(changed(path, value))


@pytest.mark.parametrize(("beyond_m", "good"), [(0.0, True), (0.0009, True), (0.0011, False)])
def test_regions_lie_inside_the_fence_to_a_millimetre(beyond_m: float, good: bool) -> None:
    whole = mapping("north_track")
    whole["safe_stop_zones"][0]["from_l_m"] = whole["geofence"]["from_l_m"] - beyond_m
    if good:
        assert site_library(Site.model_validate(whole)).blocks
        return
    with pytest.raises(InputError, match=r"safe_stop_zones\[0\]: leaves the geofence by 0.001 m"):
        site_library(Site.model_validate(whole))


def test_a_region_that_a_thin_notch_of_the_fence_cuts_is_outside() -> None:
    whole = mapping("boulevard")
    wall = [[200.01, 17.25], [200.01, 5.0], [200.0, 5.0], [200.0, 17.25]]
    whole["geofence"] = {"points": [[0, -6.75], [400, -6.75], [400, 17.25], *wall, [0, 17.25]]}
    with pytest.raises(InputError) as caught:
        site_library(Site.model_validate(whole))
    told = str(caught.value)
    assert "ot_reachable[0]: leaves the geofence" in told
    assert "safe_stop_zones[1]: leaves the geofence" in told
    assert "safe_stop_zones[0]" not in told


def test_a_block_needs_a_forward_lane() -> None:
    lanes = [{"y_m": 0.0, "width_m": 3.0, "direction": "backward"}]
    whole = mapping()
    whole["blocks"][0]["traffic"] = []
    whole["blocks"][0]["lanes"] = lanes
    with pytest.raises(InputError, match="no forward lane"):
        site_library(Site.model_validate(whole))


def test_a_polygon_is_taken_as_surveyed() -> None:
    site = load_site("boulevard")[0]
    corners = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)]
    assert region_polygon(site, Polygon(points=corners)) == corners


def test_areas_are_where_an_interaction_can_take_place() -> None:
    one = [BlockLane(0.0, 3.5, True, "a")]
    two = [*one, BlockLane(3.5, 3.5, True, "b")]
    assert conflict_areas(100.0, one, {"keep_lane"}) == (ConflictArea("following", 0.0, 100.0),)
    assert conflict_areas(100.0, two, {"keep_lane", "lane_change_left"}) == (
        ConflictArea("following", 0.0, 100.0),
        ConflictArea("merge", 0.0, 100.0),
    )
    assert conflict_areas(100.0, one, {"keep_lane"}, [98.0])[0] == ConflictArea(
        "crossing", 94.0, 100.0
    )


def site_file(folder: Path, **changes: Any) -> Path:
    file = folder / "mine.site.yaml"
    file.write_text(yaml.safe_dump({**mapping("north_track"), **changes}))
    return file


@pytest.mark.parametrize(
    ("fence", "field", "says"),
    [
        ({"points": [[0, 0], [10, 0]]}, "geofence.points", "at least 3 items"),
        ({"points": [[0, 0], [10, 0], [10]]}, "geofence.points[2][1]", "Field required"),
        (
            {"points": [[0, 0], [1, 0], [1, 1]], "block": "main"},
            "geofence.block",
            "is not a known key",
        ),
        ({"block": "straight", "from_s_m": 0.0}, "geofence.to_s_m", "Field required"),
        ({"corners": [[0, 0]]}, "geofence", "is no region: a polygon has points (at least 3"),
        ([[0, 0], [10, 0], [10, 10]], "geofence", "is no region: a polygon has points (at least 3"),
    ],
)
def test_a_wrong_fence_is_named_for_what_it_is(
    fence: Any, field: str, says: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        load_site(str(site_file(tmp_path, geofence=fence)))
    assert re.search(rf"(: |\n  ){re.escape(field)}: .*{re.escape(says)}", str(caught.value))
    assert "block: Field required" not in str(caught.value)


def test_everything_that_is_wrong_with_a_site_file_is_said_at_once(tmp_path: Path) -> None:
    blocks = mapping("north_track")["blocks"]
    blocks[0]["lanes"][0]["width_m"] = -3.0
    del blocks[0]["road_type"]
    file = site_file(
        tmp_path, blocks=blocks, geofence={"points": [[0, 0], [1, 0]]}, domain="track", speed=3
    )
    with pytest.raises(InputError) as caught:
        load_site(str(file))
    head, *lines = str(caught.value).splitlines()
    assert head == f"{file}: has 5 errors:"
    fields = ["domain", "blocks[0].lanes[0].width_m", "blocks[0].road_type", "geofence", "speed"]
    assert sorted(line.split(":")[0].strip().split(".points")[0] for line in lines) == sorted(
        fields
    )


def test_every_contradiction_of_a_site_is_said_at_once() -> None:
    site = changed("geofence.points", [[0, 0], [1, 1], [1, 0], [0, 1]])
    block = site.blocks[0].model_copy(update={"leads_to": ["moon", "mars"], "crossing_x_m": -1.0})
    site = site.model_copy(update={"blocks": [block, *site.blocks[1:]]})
    with pytest.raises(InputError) as caught:
        site_library(site, "mine.site.yaml")
    head, *lines = str(caught.value).splitlines()
    assert head == "mine.site.yaml: has 4 errors:"
    assert [line.split(":")[0].strip() for line in lines] == [
        "blocks[0].leads_to[0]",
        "blocks[0].leads_to[1]",
        "blocks[0].crossing_x_m",
        "geofence.points",
    ]


def test_fields_of_which_a_site_says_nothing_leave_its_version_as_it_was() -> None:
    """Datum and stop_reaction_s came later than sites that are in use."""
    version = load_site("south_loop")[1]
    assert "datum" not in mapping()
    assert "stop_reaction_s" not in mapping()["limits"]
    assert site_version(changed("datum", None)) == version
    assert site_version(changed("limits.stop_reaction_s", 1.0)) == version
    slower = changed("limits.stop_reaction_s", 1.5)
    assert slower.limits.stop_reaction_s == 1.5
    assert slower.model_dump(mode="json")["limits"]["stop_reaction_s"] == 1.5
    assert site_version(slower) != version


def test_a_datum_says_where_a_site_lies() -> None:
    given = {"latitude_deg": 57.7775, "longitude_deg": 12.7805}
    site = changed("datum", given | {"altitude_m": 201.3, "yaw_rad": 0.5})
    assert site.datum is not None
    assert site.datum.datum == Datum(Place(57.7775, 12.7805, 201.3), 0.5)
    assert site_version(site) != load_site("south_loop")[1]
    assert changed("datum", given).datum is not None
    for field, value in (("latitude_deg", 90.1), ("longitude_deg", -180.1), ("altitude_m", "nan")):
        with pytest.raises(ValueError, match=field):
            changed("datum", given | {field: value})


def beside(second: dict[str, Any]) -> Site:
    """The boulevard with another second vehicle; the first, a car in lane 3, stands at 345 m."""
    whole = mapping("boulevard")
    whole["blocks"][0]["traffic"][1].update(second)
    return Site.model_validate(whole)


@pytest.mark.parametrize(
    ("second", "overlap_m"),
    [
        # x_m is the front bumper; lane 3 is oncoming, so that bodies lie beyond it.
        ({"x_m": 346.0}, 3.5),
        ({"x_m": 345.0}, 4.5),
        ({"x_m": 340.0, "object_class": "truck"}, 4.0),
        ({"x_m": 349.49}, 0.01),
    ],
)
def test_vehicles_that_overlap_are_named(second: dict[str, Any], overlap_m: float) -> None:
    with pytest.raises(InputError, match=f"oncoming1 and oncoming2 overlap by {overlap_m:g} m"):
        site_library(beside({"object_class": "car", **second}))


@pytest.mark.parametrize("second", [{"x_m": 349.51}, {"x_m": 340.4}, {"x_m": 346.0, "lane": 2}])
def test_vehicles_that_do_not_overlap_are_accepted(second: dict[str, Any]) -> None:
    site_library(beside({"object_class": "car", **second}))


def test_traffic_may_be_as_fast_as_is_posted() -> None:
    site = changed("blocks.0.traffic.0.speed_mps", 13.9, "boulevard")
    assert site.blocks[0].speed_limit_mps == 13.9
    site_library(site)
