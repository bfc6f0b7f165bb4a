"""Blocks of a SUMO network (``.net.xml``): one per edge, as an edge has one direction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.block import LEFT_HAND, Library, RoadType
from ssp_scenario_manager.maps.lane_layout import NARROWEST_M
from ssp_scenario_manager.maps.legs import LANES_MEET_M
from ssp_scenario_manager.maps.reference_line import Unusable, smooth_line
from ssp_scenario_manager.maps.way_blocks import in_known_junctions, network_blocks
from ssp_scenario_manager.maps.ways import Rules, Side, Way, WayEnd, WayLane
from ssp_scenario_manager.maps.xml_input import (
    FARTHEST_M,
    BadElement,
    Loading,
    input_error,
    number,
    outermost,
    parts,
    text,
    untold,
    whole,
)

# SUMO's own width of a lane that says nothing.
DEFAULT_WIDTH_M = 3.2
_MOST_LANES = 64
_MOST_POINTS = 10_000


@dataclass(frozen=True, slots=True)
class EdgeLane:
    """A lane of an edge.

    The one with index 0 is the outermost: the rightmost, or in left-hand traffic the leftmost.

    Args:
        index: from that side.
        shape: centre line, frame map.
        driving: passenger cars may use it.
        walkable: only pedestrians may.
        change_left: cars may leave it to the left.
        change_right: cars may leave it to the right.
    """

    index: int
    width_m: float
    speed_mps: float
    shape: tuple[Point, ...]
    driving: bool
    walkable: bool
    change_left: bool
    change_right: bool


@dataclass(frozen=True, slots=True)
class Edge:
    """An edge, driven in one direction; lanes from right to left."""

    id: str
    function: str
    start: str
    end: str
    type: str
    lanes: tuple[EdgeLane, ...]


def _shape(lane: Element) -> tuple[Point, ...]:
    words = text(lane, "shape").split()
    if not 2 <= len(words) <= _MOST_POINTS:
        raise BadElement(lane, f"has {len(words)} points", "shape", f"give 2 to {_MOST_POINTS}")
    points = []
    for word in words:
        try:
            x, y = (decimal(part) for part in word.split(",")[:2])
        except ValueError:
            raise BadElement(lane, f"has no point in {word[:40]!r}", "shape", "x,y") from None
        if not (math.isfinite(x) and math.isfinite(y) and max(abs(x), abs(y)) <= FARTHEST_M):
            raise BadElement(lane, f"is out of bounds at {word[:40]!r}", "shape")
        points.append((x, y))
    return tuple(points)


def _allows(lane: Element, vehicle: str) -> bool:
    allow, disallow = lane.get("allow"), lane.get("disallow")
    if allow is not None:
        return bool({vehicle, "all"} & set(allow.split()))
    return disallow is None or not {vehicle, "all"} & set(disallow.split())


def _may_change(lane: Element, side: str) -> bool:
    words = lane.get(f"change{side}")
    return words is None or bool({"passenger", "all"} & set(words.split()))


def _lane(lane: Element, left_hand: bool) -> EdgeLane:
    inwards, outwards = _may_change(lane, "Left"), _may_change(lane, "Right")
    driving = _allows(lane, "passenger")
    return EdgeLane(
        index=whole(lane, "index"),
        width_m=number(lane, "width", DEFAULT_WIDTH_M, low=0.0, high=100.0),
        speed_mps=number(lane, "speed", low=0.0, high=1000.0),
        shape=_shape(lane),
        driving=driving,
        walkable=not driving and _allows(lane, "pedestrian") and not _allows(lane, "bicycle"),
        change_left=outwards if left_hand else inwards,
        change_right=inwards if left_hand else outwards,
    )


def read_edge(edge: Element, *, left_hand: bool = False) -> Edge:
    """Read an edge from its element.

    Args:
        edge: the element.
        left_hand: the network has left-hand traffic, so that it numbers lanes from the left.

    Raises:
        BadElement: something in it is missing, or no number where one belongs.
    """
    children = edge.findall("lane")
    if not 1 <= len(children) <= _MOST_LANES:
        raise BadElement(
            edge, f"has {len(children)} lanes", None, f"1 to {_MOST_LANES} can be read"
        )
    lanes = sorted((_lane(child, left_hand) for child in children), key=lambda lane: lane.index)
    if [lane.index for lane in lanes] != list(range(len(lanes))):
        raise BadElement(edge, "leaves a lane index out", None, "number lanes from 0")
    return Edge(
        id=text(edge, "id"),
        function=text(edge, "function", "normal"),
        start=text(edge, "from", ""),
        end=text(edge, "to", ""),
        type=text(edge, "type", ""),
        lanes=tuple(lanes[::-1] if left_hand else lanes),
    )


def read_connection(connection: Element) -> tuple[str, str]:
    """Read the edges that a connection joins, and the internal edge that it leads over, if any.

    Raises:
        BadElement: it names no edges.
    """
    via = connection.get("via")
    to = via.rpartition("_")[0] if via else text(connection, "to")
    return text(connection, "from"), to


ROOT = "net"
_READ = ("normal", "internal")
# Lanes beside the reference line keep their offset to this.
_PARALLEL_M = 0.5
# A wider gap than this between the directions parts the road in two.
_MEDIAN_M = 3.0
# No road has more edges between its ends than these; each is held against all that lead back.
_MOST_BACK = 64
_ROAD_TYPES: dict[str, RoadType] = {
    "motorway": "motorway",
    "trunk": "motorway",
    "residential": "urban",
    "living_street": "urban",
}


@dataclass
class _Net:
    """The parts of the network that have been read so far.

    Args:
        left_hand: its traffic keeps to the left.
    """

    left_hand: bool
    edges: dict[str, Edge] = field(default_factory=dict)
    connections: set[tuple[str, str]] = field(default_factory=set)
    junctions: set[str] = field(default_factory=set)
    rejected: list[tuple[str, str]] = field(default_factory=list)


def _usable(edge: Edge) -> list[EdgeLane]:
    return [lane for lane in edge.lanes if lane.driving and lane.width_m >= NARROWEST_M]


def _beside(
    line: ReferenceLine, edge: Edge, along: bool, middle: EdgeLane | None = None
) -> list[WayLane] | None:
    """Return the driving lanes of an edge along a line, None where one isn't parallel to it.

    Args:
        line: of a way.
        edge: its own or the opposite one.
        along: they lead along the line.
        middle: the lane of the edge that the line was made from, if one.
    """
    way_lanes = [WayLane(_lane_name(edge, middle), 0.0, middle.width_m, along)] if middle else []
    lanes = [lane for lane in _usable(edge) if lane is not middle]
    if not lanes:
        return way_lanes
    offsets = line.to_local_many(np.array([point for lane in lanes for point in lane.shape]))[:, 1]
    ends = np.cumsum([len(lane.shape) for lane in lanes])[:-1]
    for lane, own in zip(lanes, np.split(offsets, ends), strict=True):
        if np.isnan(own).any() or np.ptp(own) > _PARALLEL_M:
            return None
        way_lanes.append(WayLane(_lane_name(edge, lane), float(own.mean()), lane.width_m, along))
    return way_lanes


def _lane_name(edge: Edge, lane: EdgeLane) -> str:
    return f"{edge.id}_{lane.index}"


def _side(outward: list[EdgeLane]) -> Side:
    """Describe the roadside beyond a driving lane; SUMO says nothing about kerbs and verges."""
    shoulder = sidewalk = 0.0
    for lane in outward:
        if lane.walkable:
            sidewalk += lane.width_m
        elif sidewalk > 0.0:
            break
        else:
            shoulder += lane.width_m
    return Side("sidewalk" if sidewalk else "any", shoulder, sidewalk)


def _sides(edge: Edge) -> tuple[Side, Side]:
    """Describe the roadsides beyond the rightmost and the leftmost driving lane."""
    lanes, usable = list(edge.lanes), _usable(edge)
    first, last = lanes.index(usable[0]), lanes.index(usable[-1])
    return _side(lanes[:first][::-1]), _side(lanes[last + 1 :])


def _oncoming(
    line: ReferenceLine, own: list[WayLane], back: list[Edge]
) -> tuple[list[WayLane], Side | None]:
    """Return the lanes of the edge back closest beside the own ones, and what is beyond them."""
    left = max(lane.y_m + lane.width_m / 2 for lane in own)
    right = min(lane.y_m - lane.width_m / 2 for lane in own)
    best: tuple[float, list[WayLane], Side] | None = None
    for edge in back:
        lanes = _beside(line, edge, along=False)
        if not lanes:
            continue
        low = min(lane.y_m - lane.width_m / 2 for lane in lanes)
        high = max(lane.y_m + lane.width_m / 2 for lane in lanes)
        gap = max(low - left, right - high)
        if -_PARALLEL_M <= gap <= _MEDIAN_M and (best is None or gap < best[0]):
            # It runs the other way: its right side is the far one where it lies on the left.
            best = gap, lanes, _sides(edge)[0 if low > right else 1]
    return ([], None) if best is None else best[1:]


def _length_m(lane: EdgeLane) -> float:
    return sum(math.dist(a, b) for a, b in pairwise(lane.shape))


class _NotParallel(Unusable):
    """The lanes of an edge aren't parallel, so that it has no way with all of them."""


def _lane_way(edge: Edge, lane: EdgeLane, left_hand: bool) -> Way:
    """Return one lane of an edge as a way along its own middle.

    Raises:
        Unusable: its shape makes no line.
    """
    internal = edge.function == "internal"
    name = _lane_name(edge, lane)
    return Way(
        roads=(edge.id,),
        span_m=None,
        line=smooth_line(lane.shape),
        lanes=(WayLane(name, 0.0, lane.width_m, along=True),),
        right=Side("any"),
        left=Side("any"),
        road_type=_road_type(edge),
        along=Rules(lane.speed_mps or None, change_left=False, change_right=False),
        against=Rules(None, change_left=False, change_right=False),
        junction=edge.id[1:].rpartition("_")[0] if internal else None,
        noun="edge",
        both=False,
        left_hand=left_hand,
        notes=(LEFT_HAND,) if left_hand else (),
        lane=f"lane {name}",
    )


def _road_type(edge: Edge) -> RoadType:
    return _ROAD_TYPES.get(edge.type.rpartition(".")[2].removesuffix("_link"), "any")


def _way(edge: Edge, back: list[Edge], left_hand: bool) -> Way:
    """Return the way of an edge.

    Raises:
        _NotParallel: one of its lanes keeps no distance to another.
        Unusable: its lanes make no road.
    """
    driving = _usable(edge)
    if not driving:
        raise Unusable(f"it has no lane of {NARROWEST_M:g} m or more for passenger cars")
    # The longest lane is the outermost of a bend, whose inner side has no coordinates far in.
    longest = max(driving, key=lambda lane: round(_length_m(lane), 1))
    line = smooth_line(longest.shape)
    own = _beside(line, edge, along=True, middle=longest)
    if own is None:
        raise _NotParallel("its lanes aren't parallel")
    if len(back) > _MOST_BACK:
        raise Unusable(
            f"{len(back)} edges lead back from its end to its start, and at most {_MOST_BACK} "
            "are looked at"
        )
    oncoming, far_side = _oncoming(line, own, back)
    lanes = sorted([*own, *oncoming], key=lambda lane: lane.y_m)
    right, left = _sides(edge)
    if oncoming and far_side is not None:
        if lanes[0].along:
            left = far_side
        else:
            right = far_side
    pairs = list(pairwise(driving))
    internal = edge.function == "internal"
    return Way(
        roads=(edge.id,),
        span_m=None,
        line=line,
        lanes=tuple(lanes),
        right=right,
        left=left,
        road_type=_road_type(edge),
        along=Rules(
            speed_mps=min(lane.speed_mps for lane in driving) or None,
            change_left=any(a.change_left for a, _ in pairs),
            change_right=any(b.change_right for _, b in pairs),
        ),
        against=Rules(None, False, False),
        junction=edge.id[1:].rpartition("_")[0] if internal else None,
        noun="edge",
        both=False,
        left_hand=left_hand,
        notes=(LEFT_HAND,) if left_hand else (),
    )


def _lane_ways(edge: Edge, net: _Net, beside: Way | None = None) -> list[Way]:
    """Return the lanes of an edge as ways of their own, without those that make no line.

    Args:
        edge: whose lanes they are.
        net: gets the reasons of the others.
        beside: the edge's way; a lane that begins and ends where it does there needs none.
    """
    ways = []
    for lane in _usable(edge):
        if beside is not None and _meets(lane, edge, beside):
            continue
        try:
            ways.append(_lane_way(edge, lane, net.left_hand))
        except Unusable as error:
            net.rejected.append((f"edge {edge.id} lane {_lane_name(edge, lane)}", str(error)))
    return ways


def _meets(lane: EdgeLane, edge: Edge, way: Way) -> bool:
    """Tell whether a lane begins and ends where the way of its edge has it."""
    (y_m,) = (one.y_m for one in way.lanes if one.name == _lane_name(edge, lane))
    ends = way.line.pose(0.0), way.line.pose(way.line.length_m)
    return all(
        math.dist(pose.to_parent(0.0, y_m), place) <= LANES_MEET_M
        for pose, place in zip(ends, (lane.shape[0], lane.shape[-1]), strict=True)
    )


def load_sumo_net(path: Path, loading: Loading = untold) -> Library:
    """Load the blocks of a SUMO network.

    Raises:
        InputError: the file can't be read, is no network, or an element in it is malformed.
    """
    left_hand = outermost(path).get("lefthand", "false")
    net = _Net(left_hand=left_hand.lower() in ("true", "1", "yes", "on", "x", "t"))
    for element in parts(path, ROOT, "edge", loading):
        try:
            if element.tag == "edge" and element.get("function", "normal") in _READ:
                edge = read_edge(element, left_hand=net.left_hand)
                if edge.id in net.edges:
                    raise BadElement(element, "has the id of another edge", "id")
                net.edges[edge.id] = edge
            elif element.tag == "junction":
                net.junctions.add(element.get("id", ""))
            elif element.tag == "connection":
                net.connections.add(read_connection(element))
        except BadElement as bad:
            raise input_error(path, element, bad) from bad
    if not net.edges:
        raise InputError("has no edge", file=path, remedy="give a network with edges")
    between: dict[tuple[str, str], list[Edge]] = {}
    for edge in net.edges.values():
        if edge.function == "normal":
            between.setdefault((edge.start, edge.end), []).append(edge)
    ways: list[Way] = []
    index: dict[str, list[int]] = {}
    for edge in net.edges.values():
        back = between.get((edge.end, edge.start), []) if edge.function == "normal" else []
        try:
            way = _way(edge, [other for other in back if other is not edge], net.left_hand)
        except Unusable as error:
            net.rejected.append((f"edge {edge.id}", str(error)))
            edge_ways = _lane_ways(edge, net) if isinstance(error, _NotParallel) else []
        else:
            edge_ways = [way, *_lane_ways(edge, net, beside=way)]
        index[edge.id] = list(range(len(ways), len(ways) + len(edge_ways)))
        ways += edge_ways
    contacts: list[tuple[WayEnd, WayEnd]] = [
        ((i, "end"), (j, "start"))
        for start, end in sorted(net.connections)
        for i in index.get(start, ())
        for j in index.get(end, ())
    ]
    ways, missing = in_known_junctions(ways, net.junctions)
    map_blocks = network_blocks(ways, contacts)
    return Library(
        source=path.name,
        sha256=sha256_file(path),
        kind="sumo",
        blocks=map_blocks.blocks,
        rejected=tuple(net.rejected + missing + map_blocks.rejected),
        shifting=map_blocks.shifting,
    )
