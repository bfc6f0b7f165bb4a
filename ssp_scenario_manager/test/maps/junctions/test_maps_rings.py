"""Roundabouts whose entries and exits are junctions of their own."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ssp_core.geometry import FloatArray, outline_problem, point_in_polygon
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.area import strip_polygon
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.maps.block import Library, headings
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.rings import MOST_RADIUS_M, is_ring
from ssp_scenario_manager.maps.routes import routes_of
from ssp_scenario_manager.scenarios.base import CannotPlace

ARMS = {"east": 0.0, "north": 90.0, "west": 180.0, "south": 270.0}
ARM_M = 120.0
# Half of what a junction takes of the ring, how far before it an arm ends, and its lanes' offset.
HALF_DEG, BEFORE_M, BESIDE_M = 20.0, 14.0, 4.0

Radius = Callable[[FloatArray], FloatArray]


def at(radius: Radius, angles_deg: FloatArray) -> FloatArray:
    """Places on the ring."""
    angles = np.radians(angles_deg)
    return radius(angles)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))


def bend(start: FloatArray, end: FloatArray) -> FloatArray:
    """A curve between two pairs of places, tangent to both."""
    (before, a), (b, after) = start, end
    reach = 0.4 * math.dist(a, b)
    first = a + reach * (a - before) / math.dist(before, a)
    second = b - reach * (after - b) / math.dist(b, after)
    t = np.linspace(0.0, 1.0, 16)[:, None]
    return (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * first + 3 * (1 - t) * t**2 * second + t**3 * b


def network(radius: Radius, mirrored: bool = False) -> str:
    """A network of four arms around a ring, with a junction at each of them."""
    edges, connections = [], []

    def add(edge: str, ends: str, shape: FloatArray) -> None:
        places = " ".join(f"{x:.4f},{-y if mirrored else y:.4f}" for x, y in shape)
        edges.append(
            f'<edge id="{edge}" {ends}><lane id="{edge}_0" index="0" speed="10" '
            f'shape="{places}"/></edge>'
        )

    def connect(start: str, end: str, over: str) -> None:
        connections.append(
            f'<connection from="{start}" to="{end}" fromLane="0" toLane="0" via="{over}_0" '
            'dir="s" state="M"/>'
            f'<connection from="{over}" to="{end}" fromLane="0" toLane="0" dir="s" state="M"/>'
        )

    names = list(ARMS)
    for arm, following in pairwise([*names, names[0]]):
        angle = ARMS[arm]
        own, other = f"{arm}_ring", f"{names[names.index(arm) - 1]}_ring"
        high = angle + HALF_DEG
        around = at(radius, np.arange(high, angle + 90.0 - HALF_DEG + 0.1, 5.0))
        add(own, f'from="{arm}" to="{following}"', around)
        out = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        left = np.array([-out[1], out[0]])
        near = float(radius(np.radians([angle]))[0]) + BEFORE_M
        coming = np.array([out * (near + ARM_M), out * near]) + BESIDE_M * left
        leaving = np.array([out * near, out * (near + ARM_M)]) - BESIDE_M * left
        add(f"{arm}_in", f'from="{arm}_far" to="{arm}"', coming)
        add(f"{arm}_out", f'from="{arm}" to="{arm}_far"', leaving)
        low = at(radius, np.array([angle - HALF_DEG - 1.0, angle - HALF_DEG]))
        internal = 'function="internal"'
        add(f":{arm}_0", internal, bend(coming, around[:2]))
        add(f":{arm}_1", internal, at(radius, np.arange(angle - HALF_DEG, high + 0.1, 4.0)))
        add(f":{arm}_2", internal, bend(low, leaving))
        connect(f"{arm}_in", own, f":{arm}_0")
        connect(other, own, f":{arm}_1")
        connect(other, f"{arm}_out", f":{arm}_2")
    hand = ' lefthand="true"' if mirrored else ""
    junctions = [f'<junction id="{arm}" type="priority"/>' for arm in ARMS]
    inside = "".join(edges + junctions + connections)
    return f'<?xml version="1.0"?><net version="1.20"{hand}>{inside}</net>'


def circle(radius_m: float) -> Radius:
    return lambda angles: np.full(len(angles), radius_m)


def square(half_m: float) -> Radius:
    return lambda angles: half_m / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], Library]:
    def library(text: str) -> Library:
        path = tmp_path / "ring.net.xml"
        path.write_text(text)
        return load_library(path)

    return library


@pytest.mark.parametrize("mirrored", [False, True])
def test_routes_lead_over_the_junctions_of_a_ring(
    read: Callable[[str], Library], mirrored: bool
) -> None:
    """Each route used to end on the first road between two junctions, after some metres."""
    library = read(network(circle(20.0), mirrored))
    assert {one.junction for one in library.blocks} == {None, "ring east"}
    assert {one.block_id for one in library.blocks if one.junction is None} == {
        f"edge {arm}_{way} forward" for arm in ARMS for way in ("in", "out")
    }
    routes, refused = routes_of(library)
    assert refused == []
    ways = {(*one.entrances, *one.exits) for one in routes}
    assert len(routes) == len(ways) == 16
    turns = {
        one.exits[0]: math.degrees(one.passage.turn_rad)
        for one in routes
        if one.passage is not None and one.entrances == ("edge south_in forward",)
    }
    sides = [turns[f"edge {arm}_out forward"] for arm in ("east", "north", "west")]
    assert sides == pytest.approx([90.0, 0.0, -90.0] if mirrored else [-90.0, 0.0, 90.0], abs=3.0)


def test_lanes_of_a_ring_that_meet_to_centimetres_make_no_bend(
    read: Callable[[str], Library],
) -> None:
    """Drawn exactly, a step of 12 cm from one place to the next is a bend of 8 m radius."""

    def farther(shape: re.Match[str]) -> str:
        places = (map(float, word.split(",")) for word in shape[2].split())
        return shape[1] + " ".join(f"{x * 1.006:.4f},{y * 1.006:.4f}" for x, y in places)

    text = network(circle(20.0))
    shape = r'(id="south_ring_0"[^>]*shape=")([^"]*)'
    for library in (read(text), read(re.sub(shape, farther, text))):
        found = [one for one in routes_of(library)[0] if "south_ring" in one.block_id]
        assert found
        for one in found:
            assert one.passage is not None
            ring = np.arange(one.passage.start_s_m + 25.0, one.passage.end_s_m - 25.0, 1.0)
            bends = np.diff(headings(one.line, ring))
            # On the ring itself 0.05 1/m.
            assert bends.min(initial=0.05) >= 0.03
            assert bends.max(initial=0.05) <= 0.07


def test_the_routes_of_a_junction_beside_a_ring_are_not_smoothed(
    read: Callable[[str], Library],
) -> None:
    """Smoothed, its bend was sharper by the ring's entry, so that the road beyond was left out."""
    around = at(circle(30.0), np.array([290.0, 295.0]))

    def ahead(degrees: float) -> FloatArray:
        return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])

    def words(places: FloatArray) -> str:
        return " ".join(f"{x:.4f},{y:.4f}" for x, y in places)

    # Traffic on the ring goes at 20 degrees there; the arm comes at 12, and turns by 10 before.
    mouth = around[0] - 20.0 * ahead(16.0)
    arm = np.array([mouth - 30.0 * ahead(12.0), mouth])
    gate = np.array([arm[0] - 10.0 * ahead(12.0), arm[0]])
    before = np.array([gate[0] - 80.0 * ahead(2.0), gate[0]])
    text = network(circle(30.0))
    for lane, places in (("south_in_0", arm), (":south_0_0", bend(arm, around))):
        text = re.sub(f'(id="{lane}"[^>]*shape=")[^"]*', rf"\g<1>{words(places)}", text)
    text = text.replace('from="south_far" to="south"', 'from="gate" to="south"')
    more = "".join(
        f'<edge id="{name}" {ends}><lane id="{name}_0" index="0" speed="10" '
        f'shape="{words(places)}"/></edge>'
        for name, ends, places in (
            ("gate_in", 'from="south_far" to="gate"', before),
            (":gate_0", 'function="internal"', gate),
        )
    )
    more += '<junction id="gate" type="priority"/>'
    lanes = 'to="south_in" fromLane="0" toLane="0" dir="s" state="M"'
    more += f'<connection from="gate_in" {lanes} via=":gate_0_0"/>'
    more += f'<connection from=":gate_0" {lanes}/>'
    library = read(text.replace("</net>", f"{more}</net>"))
    assert {one.junction for one in library.blocks} == {None, "gate", "ring east"}
    (found,) = routes_of(library, "gate")[0]
    assert found.roads == ("gate_in", ":gate_0", "south_in", ":south_0")
    assert found.length_m == pytest.approx(140.0, abs=0.2)


def test_one_on_the_ring_comes_from_the_left_and_goes_first_or_on(
    read: Callable[[str], Library],
) -> None:
    routes = {one.block_id: one for one in routes_of(read(network(circle(20.0))))[0]}
    (own,) = (
        one
        for one in routes.values()
        if (*one.entrances, *one.exits) == ("edge south_in forward", "edge north_out forward")
    )
    assert own.passage is not None
    met = {
        routes[one.route].exits[0]: one
        for one in own.passage.conflicts
        if routes[one.route].entrances == ("edge west_in forward",)
    }
    assert {name: one.kind for name, one in met.items()} == {
        "edge east_out forward": "crossing",
        "edge north_out forward": "merge",
        "edge west_out forward": "crossing",
    }
    leaves_first = met["edge east_out forward"]
    assert leaves_first.comes_from == "left"
    # Where both are one lane.
    other = routes[leaves_first.route]
    here = own.line.to_map(leaves_first.s_m, 0.0)
    assert math.dist(here, other.line.to_map(leaves_first.other_s_m, 0.0)) < 0.5
    assert math.hypot(*here) == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize(
    "shape", [square(25.0), circle(MOST_RADIUS_M + 5.0)], ids=["houses", "too large"]
)
def test_a_way_around_a_block_of_houses_is_no_ring(
    read: Callable[[str], Library], shape: Radius
) -> None:
    library = read(network(shape))
    assert {one.junction for one in library.blocks} == {None, *ARMS}
    assert not any(is_ring(one.junction) for one in library.blocks)


def streets(count: int, road_m: float) -> str:
    """A grid of streets with corners that are cut, around blocks that are almost round."""
    edges, connections = [], []
    step = np.eye(2, dtype=int)
    ways = [step[0], step[1], -step[0], -step[1]]
    corners = [np.array([i, j]) for i in range(count) for j in range(count)]

    def add(edge: str, ends: str, *shape: FloatArray) -> None:
        places = " ".join(f"{x:.3f},{y:.3f}" for x, y in shape)
        edges.append(
            f'<edge id="{edge}" {ends}><lane id="{edge}_0" index="0" speed="10" '
            f'shape="{places}"/></edge>'
        )

    def ends_of(corner: FloatArray, way: FloatArray) -> tuple[FloatArray, FloatArray]:
        start = corner * (road_m + 8.0) + 4.0 * way + 1.6 * np.array([way[1], -way[0]])
        return start, start + road_m * way

    def street(corner: FloatArray, k: int) -> str:
        return f"s{corner[0]}_{corner[1]}_{k}"

    for corner in corners:
        name = f"n{corner[0]}_{corner[1]}"
        edges.append(f'<junction id="{name}" type="priority"/>')
        for k, way in enumerate(ways):
            if not any((corner + way == other).all() for other in corners):
                continue
            (x, y), own = corner + way, street(corner, k)
            add(own, f'from="{name}" to="n{x}_{y}"', *ends_of(corner, way))
            for i in (k - 1, k, (k + 1) % 4):
                before = corner - ways[i]
                if any((before == other).all() for other in corners):
                    over, start = f":{name}_{4 * (i % 4) + k}", street(before, i % 4)
                    joint = ends_of(before, ways[i])[1], ends_of(corner, way)[0]
                    add(over, 'function="internal"', *joint)
                    connections.append(
                        f'<connection from="{start}" to="{own}" fromLane="0" toLane="0" '
                        f'via="{over}_0" dir="s" state="M"/><connection from="{over}" to="{own}" '
                        'fromLane="0" toLane="0" dir="s" state="M"/>'
                    )
    return f'<?xml version="1.0"?><net version="1.20">{"".join(edges + connections)}</net>'


def test_closed_ways_that_share_a_junction_are_a_grid_of_streets(
    read: Callable[[str], Library],
) -> None:
    """One junction of all of them would have routes from each street to each other one."""
    alone = read(streets(2, 15.0))
    assert {one.junction for one in alone.blocks} == {None, "ring n0_0"}
    grid = read(streets(3, 15.0))
    assert len({one.junction for one in grid.blocks} - {None}) == 9
    assert not any(is_ring(one.junction) for one in grid.blocks)


def test_a_fence_goes_around_a_route_that_bends_more_than_it_is_wide(tmp_path: Path) -> None:
    """Offsets beyond the centre of a bend have no place, which ended the compiler."""
    path = tmp_path / "small.net.xml"
    path.write_text(network(circle(9.0)))
    area = load_area(None, path)[0]
    tight = 0
    for one in routes_of(area.library)[0]:
        with suppress(CannotPlace):
            fence = area.geofence(one)
            try:
                strip_polygon(one.line, 0.0, one.length_m, -5.0, 5.0)
            except NotOneToOne:
                tight += 1
            assert outline_problem(fence) is None
            middle = one.line.to_map_many(np.linspace(0.0, one.length_m, 50), 0.0)
            assert all(point_in_polygon(x, y, fence) for x, y in middle[1:-1])
    assert tight
