"""Edges and connections of a SUMO network, as they stand in the file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from ssp_core.run_file.values import Point
from ssp_scenario_manager.topology.xml_input import FARTHEST_M, BadElement, number, text, whole

# SUMO's own width of a lane that says nothing.
DEFAULT_WIDTH_M = 3.2
_MOST_LANES = 64
_MOST_POINTS = 10_000


@dataclass(frozen=True, slots=True)
class EdgeLane:
    """A lane; the one with index 0 is the rightmost.

    Args:
        index: from the right.
        width_m: of the lane.
        speed_mps: limit.
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
    found = []
    for word in words:
        try:
            x, y = (float(part) for part in word.split(",")[:2])
        except ValueError:
            raise BadElement(lane, f"has no point in {word[:40]!r}", "shape", "x,y") from None
        if not (math.isfinite(x) and math.isfinite(y) and max(abs(x), abs(y)) <= FARTHEST_M):
            raise BadElement(lane, f"is out of bounds at {word[:40]!r}", "shape")
        found.append((x, y))
    return tuple(found)


def _allows(lane: Element, vehicle: str) -> bool:
    allow, disallow = lane.get("allow"), lane.get("disallow")
    if allow is not None:
        return bool({vehicle, "all"} & set(allow.split()))
    return disallow is None or not {vehicle, "all"} & set(disallow.split())


def _may_change(lane: Element, side: str) -> bool:
    words = lane.get(f"change{side}")
    return words is None or bool({"passenger", "all"} & set(words.split()))


def _lane(lane: Element) -> EdgeLane:
    driving = _allows(lane, "passenger")
    return EdgeLane(
        index=whole(lane, "index"),
        width_m=number(lane, "width", DEFAULT_WIDTH_M, low=0.0, high=100.0),
        speed_mps=number(lane, "speed", low=0.0, high=1000.0),
        shape=_shape(lane),
        driving=driving,
        walkable=not driving and _allows(lane, "pedestrian") and not _allows(lane, "bicycle"),
        change_left=_may_change(lane, "Left"),
        change_right=_may_change(lane, "Right"),
    )


def read_edge(edge: Element) -> Edge:
    """An edge from its element.

    Raises:
        BadElement: something in it is missing, or no number where one belongs.
    """
    children = edge.findall("lane")
    if not 1 <= len(children) <= _MOST_LANES:
        raise BadElement(
            edge, f"has {len(children)} lanes", None, f"1 to {_MOST_LANES} can be read"
        )
    lanes = sorted((_lane(child) for child in children), key=lambda lane: lane.index)
    if [lane.index for lane in lanes] != list(range(len(lanes))):
        raise BadElement(edge, "leaves a lane index out", None, "number lanes from 0")
    return Edge(
        id=text(edge, "id"),
        function=text(edge, "function", "normal"),
        start=text(edge, "from", ""),
        end=text(edge, "to", ""),
        type=text(edge, "type", ""),
        lanes=tuple(lanes),
    )


def read_connection(connection: Element) -> tuple[str, str]:
    """From which edge to which a connection leads; over which internal edge, if over one.

    Raises:
        BadElement: it names no edges.
    """
    via = connection.get("via")
    to = via.rpartition("_")[0] if via else text(connection, "to")
    return text(connection, "from"), to
