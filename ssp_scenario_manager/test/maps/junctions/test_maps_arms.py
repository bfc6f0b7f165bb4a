"""Arms of a junction that a map cuts into several roads."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ssp_core.run_file.road import JunctionRoad
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.arms import junction_roads
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of, with_routes
from tests.support.events.junctions import made as realised

SHORT_M, FAR_M = 3.0, 90.0
# The lanes of a road shift by 1 m, over 20 m of it.
SHIFT = '<laneOffset s="0" a="0"/><laneOffset s="{}" a="0" b="0.05"/><laneOffset s="{}" a="1"/>'


def lengthen(made: Any, road: str, long_m: float) -> None:
    """Give an arm of the crossroads another length than 60 m."""
    (i,) = (i for i, part in enumerate(made.parts) if part.startswith(f'<road id="{road}"'))
    made.parts[i] = re.sub(r'length="60(\.0)?"', f'length="{long_m}"', made.parts[i])


def cut(made: Any, words: Any, near_m: float = SHORT_M, **road: Any) -> Path:
    """The crossroads with an arm in the west that the map cuts so far before the junction."""
    lengthen(made, "w", near_m)
    # Roads with the same lanes are one block.
    kerb = words.lane(2, 1.0, "border"), words.lane(-2, 1.0, "border")
    shape = {
        "geometry": words.at(-10.0 - near_m, 0, math.pi, FAR_M),
        "links": words.to_road("predecessor", "w", "end"),
        "sections": words.section(kerb[0] + words.lane(1), words.lane(-1) + kerb[1]),
    }
    made.road("far", FAR_M, **{**shape, **road})
    path: Path = made.write("cut.xodr")
    return path


def route(path: Path, name: str) -> Block:
    """The route over a connecting road."""
    routes = routes_of(load_library(path))[0]
    (found,) = (one for one in routes if f"> road {name} " in one.block_id)
    return found


def arms_of(path: Path, axis: str = "x_m") -> list[JunctionRoad]:
    """The roads of the junction's western arm, or of its southern one, along the other axis."""
    found = junction_roads(load_library(path), "9")
    mouths = [
        ReferenceLine.of_road(one).pose(one.length_m if one.junction_at == "end" else 0.0)
        for one in found
    ]
    return [
        one
        for one, at in zip(found, mouths, strict=True)
        if one.junction_at != "both" and getattr(at, axis) == pytest.approx(-10.0, abs=0.01)
    ]


def reaches_m(found: Block) -> float:
    """Return how much of its arm a route has before the junction."""
    assert found.passage is not None
    return found.passage.start_s_m - found.passage.arms_s_m[0]


def beyond_m(found: Block) -> float:
    """Return how much of its arm a route has beyond the junction."""
    assert found.passage is not None
    return found.passage.arms_s_m[1] - found.passage.end_s_m


@pytest.mark.usefixtures("crossroads")
def test_an_arm_goes_on_over_a_road_with_the_same_lanes(made: Any, words: Any) -> None:
    """It used to end after the 3 m of the road next to the junction."""
    path = cut(made, words)
    assert reaches_m(route(path, "we")) == pytest.approx(60.0, abs=0.01)
    assert beyond_m(route(path, "sw")) == pytest.approx(60.0, abs=0.01)
    (arm,) = arms_of(path)
    assert arm.junction_at == "end"
    assert arm.length_m == pytest.approx(60.0, abs=0.01)
    line = ReferenceLine.of_road(arm)
    lanes: dict[str, Any] = {
        lane.direction: (line.to_map(0.0, lane.y_m), lane.width_m) for lane in arm.lanes
    }
    assert lanes == {
        "forward": (pytest.approx((-70.0, -1.75), abs=0.01), 3.5),
        "backward": (pytest.approx((-70.0, 1.75), abs=0.01), 3.5),
    }


@pytest.mark.usefixtures("crossroads")
def test_an_arm_whose_lanes_part_is_a_road_a_lane(made: Any, words: Any) -> None:
    """Away from the junction there is only the road next to it."""
    path = cut(made, words, sections=words.section("", words.lane(-1)))
    found = {one.junction_at: one for one in arms_of(path)}
    assert {end: one.length_m for end, one in found.items()} == {
        "end": SHORT_M,
        "start": pytest.approx(60.0, abs=0.01),
    }
    assert beyond_m(route(path, "sw")) == pytest.approx(60.0, abs=0.01)
    assert [(lane.y_m, lane.width_m) for lane in found["start"].lanes] == [(0.0, 3.5)]
    assert len(found["end"].lanes) == 1


@pytest.mark.usefixtures("crossroads")
@pytest.mark.parametrize(("near_m", "arm_m", "roads"), [(SHORT_M, 60.0, 2), (15.0, 35.0, 1)])
def test_an_arm_goes_on_along_lanes_that_shift(
    made: Any, words: Any, near_m: float, arm_m: float, roads: int
) -> None:
    """It is one road, and ends where they shift, if it keeps its lanes for 30 m."""
    path = cut(made, words, near_m, offsets=SHIFT.format(20, 40))
    found = route(path, "sw")
    assert beyond_m(found) == pytest.approx(arm_m, abs=0.2)
    arms = arms_of(path)
    assert [one.length_m for one in arms] == [pytest.approx(arm_m, abs=0.2)] * roads
    # The route's arm is on the road's.
    assert found.passage is not None
    stations = np.arange(found.passage.end_s_m, found.passage.arms_s_m[1], 1.0)
    places = found.line.to_map_many(stations, 0.0)
    offsets = [
        ReferenceLine.of_road(one).to_local_many(places)[:, 1] - lane.y_m
        for one in arms
        for lane in one.lanes
    ]
    assert min(float(np.abs(some).max()) for some in offsets) < 0.05


@pytest.mark.usefixtures("crossroads")
@pytest.mark.parametrize(("near_m", "arms_m"), [(20.0, [20.0]), (SHORT_M, [60.0])])
def test_an_arm_ends_where_another_junction_begins(
    made: Any, words: Any, near_m: float, arms_m: list[float]
) -> None:
    """One that is shorter than 15 m goes on over it along its lane."""
    lengthen(made, "s", near_m)
    yaw, y_m = math.pi / 2, -10.0 - near_m - 20.0
    made.road(
        "link",
        20.0,
        geometry=words.at(0.0, y_m, yaw, 20.0),
        sections=words.section("", words.lane(-1)),
        junction="8",
        links=words.to_road("predecessor", "far", "start") + words.to_road("successor", "s", "end"),
    )
    made.road(
        "far",
        FAR_M,
        geometry=words.at(0.0, y_m, -yaw, FAR_M),
        links=words.to_junction("predecessor", "8"),
    )
    made.add(
        '<junction id="8"><connection id="0" incomingRoad="far" connectingRoad="link" '
        'contactPoint="start"><laneLink from="1" to="-1"/></connection></junction>'
    )
    path = made.write("junctions.xodr")
    found = route(path, "sw")
    assert found.roads == ("far", "link", "s", "sw", "w")
    assert reaches_m(found) == pytest.approx(arms_m[0], abs=0.01)
    assert [one.length_m for one in arms_of(path, "y_m")] == pytest.approx(arms_m, abs=0.01)


@pytest.mark.usefixtures("crossroads")
def test_a_car_waits_on_an_arm_that_the_map_cuts(made: Any, words: Any) -> None:
    """It was refused: it needs 5.5 m of its arm, which is 3 m long."""
    for arm in "sn":
        lengthen(made, arm, 150.0)
    loaded = load_area(None, cut(made, words))[0]
    area: OperatingArea = replace(loaded, library=with_routes(loaded.library))
    (own,) = (one for one in area.library.blocks if "> road sn " in one.block_id)
    whole = load_event("crossing_car")[0].model_dump(mode="json", by_alias=True)
    for part in ("participants", "motion", "interaction"):
        whole[part] = yaml.safe_load(yaml.safe_dump(whole[part]).replace("right", "left"))
    whole["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    run = realised(Event.model_validate(whole), area, own.block_id).task.run
    (car,) = run.targets
    assert car.start.y_m == pytest.approx(-1.75, abs=0.01)
    # Its rear lies beyond the seam.
    assert car.start.x_m - car.size.rear_m < -10.0 - SHORT_M
    on = []
    for one in run.road.junction:
        s_m, l_m = ReferenceLine.of_road(one).to_local(car.start.x_m, car.start.y_m)
        if one.junction_at == "end" and 0.0 < s_m < one.length_m:
            on += [lane for lane in one.lanes if abs(l_m - lane.y_m) < 0.01]
    assert [lane.direction for lane in on] == ["forward"]
