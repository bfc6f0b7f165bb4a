"""Binding of recordings by others to the routes of a map's junctions (METHOD 4.3)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.importers.road import bind_road
from ssp_eval.importers.tracks import Body, Samples, Source, Track
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.place import road_of
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.site import find_shipped
from tests.support.events.junctions import LEFT_TURN, STRAIGHT, ground, route

TURN = "junction tee: west_in > west_north lanes[0] > north_out"
ENTRY = "junction entry: west_in > west_east lanes[0] > east_out"


def along(block: Block, before_m: float, after_m: float) -> Track:
    """The track of a VUT along the middle of a route's own lane."""
    assert block.passage is not None
    from_m, to_m = block.passage.start_s_m - before_m, block.passage.end_s_m + after_m
    poses = [block.line.pose(s_m) for s_m in np.arange(from_m, to_m, 0.5)]
    columns = {name: np.array([getattr(p, name) for p in poses]) for name in ("x_m", "y_m")}
    columns["yaw_rad"] = np.unwrap([p.yaw_rad for p in poses])
    stamps = np.arange(len(poses)) * 50_000_000
    body = Body("vut", ObjectClass.CAR, Role.VUT, DEFAULT_SIZES[ObjectClass.CAR], "rear_axle")
    return Track(body, Samples(stamps, columns, Source(Path("states.csv"), "vut")), ())


def through(area: OperatingArea, junction: str) -> list[Block]:
    """The routes over a junction that turn left."""
    return [
        one
        for one in area.library.blocks
        if one.junction == junction and one.passage is not None and one.passage.turn_rad > 0.5
    ]


@pytest.mark.parametrize(
    ("site", "name"),
    [("crossroads", STRAIGHT), ("cross_track", LEFT_TURN), ("tee", TURN), ("entry_track", ENTRY)],
)
def test_a_way_over_a_junction_is_bound_to_its_route_with_the_roads_of_the_junction(
    site: str, name: str
) -> None:
    area = ground(site)
    block = route(area, name)
    bound = bind_road(site, None, along(block, 40.0, 20.0))
    assert bound.site.block == name
    assert bound.site.road == road_of(block, None, area.junction_roads(block))
    assert bound.site.road.junction
    assert bound.share > 0.95


def test_a_way_over_a_ring_is_bound_to_its_route() -> None:
    area = ground("ring")
    block = through(area, "ring")[0]
    assert bind_road("ring", None, along(block, 40.0, 20.0)).site.block == block.block_id


def test_a_way_most_of_which_lies_on_the_approach_keeps_it_and_names_the_route() -> None:
    vut = along(route(ground("crossroads")), 120.0, -15.0)
    bound = bind_road("crossroads", None, vut)
    assert bound.site.block == "west_in"
    assert bound.site.road.junction == []
    assert any(STRAIGHT in note and "--block" in note for note in bound.notes)
    named = bind_road("crossroads", STRAIGHT, vut)
    assert named.site.block == STRAIGHT
    assert named.site.road.junction


def test_a_way_that_never_reaches_the_junction_has_no_note_of_it() -> None:
    bound = bind_road("crossroads", None, along(route(ground("crossroads")), 120.0, -60.0))
    assert (bound.site.block, bound.notes) == ("west_in", ())


def test_of_two_lanes_over_a_junction_the_one_that_is_driven_in_counts(tmp_path: Path) -> None:
    value: dict[str, Any] = yaml.safe_load(find_shipped("tee", "site").read_text())
    for block in value["blocks"]:
        if block["id"] in ("west_in", "west_east", "east_out"):
            first = block["lanes"][0]
            block["lanes"].insert(0, first | {"y_m": first["y_m"] - first["width_m"]})
    path = tmp_path / "wide.site.yaml"
    path.write_text(json.dumps(value))
    area = ground(str(path))
    for lane in (0, 1):
        name = f"junction tee: west_in > west_east lanes[{lane}] > east_out"
        assert bind_road(str(path), None, along(route(area, name), 40.0, 20.0)).site.block == name


def test_a_route_that_the_way_does_not_touch_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="nor a route under the VUT's way"):
        bind_road("tee", STRAIGHT, along(route(ground("tee"), TURN), 40.0, 20.0))
