"""The run's road as a SUMO network, in frame map without any offset."""

from __future__ import annotations

import importlib.util
import math
import shutil
import subprocess
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

from ssp_core.errors import HostError
from ssp_core.run_file.road import JunctionRoad, Lane, Road
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine

# The network goes on this far beyond the block, so that whatever starts or stops at the block's
# end is on a lane with its whole length.
OVERHANG_M = 100.0
# SUMO's classes of who drives or walks.
SUMO_CLASSES = {
    ObjectClass.CAR: "passenger",
    ObjectClass.TRUCK: "truck",
    ObjectClass.BUS: "bus",
    ObjectClass.MOTORCYCLE: "motorcycle",
    ObjectClass.CYCLIST: "bicycle",
    ObjectClass.PEDESTRIAN: "pedestrian",
}
# SUMO's seed is a 32-bit signed number; those of runs are taken modulo this.
SUMO_SEEDS = 2**31 - 1
# More digits than SUMO's default, so that lanes lie where the run file says.
_PRECISION = 6
# Lanes leave the true curve by at most this.
_CHORD_M = 0.01


@dataclass(frozen=True, slots=True)
class LanePlace:
    """The place in the network of a lane of the run file.

    Args:
        index: of the lane in the edge, 0 is the rightmost.
        start_x_m: block x at which the lane begins; a backward lane begins at the far end.
        backward: it leads towards smaller block x.
        line: the road's.
        y_m: offset of the lane from it.
    """

    edge: str
    index: int
    start_x_m: float
    backward: bool
    line: ReferenceLine
    y_m: float

    def position_m(self, x_m: float) -> float:
        """Return SUMO's position along the lane of a place given by block x (arc length)."""
        if self.line.is_straight:
            return self.start_x_m - x_m if self.backward else x_m - self.start_x_m
        way = self.line.path(self.start_x_m, x_m, self.y_m, _CHORD_M)
        return float(sum(math.dist(a, b) for a, b in pairwise(way)))


@dataclass(frozen=True, slots=True)
class Network:
    """A network file, and where the run file's lanes are in it (by index into road.lanes)."""

    path: Path
    lanes: tuple[LanePlace, ...]


@dataclass(frozen=True, slots=True)
class _Edge:
    """An edge with its lanes from right to left as (block y, width)."""

    name: str
    backward: bool
    lanes: tuple[tuple[float, float], ...]
    pedestrian: bool = False


def find_netconvert() -> Path:
    """Return the netconvert program: of the eclipse-sumo package, else of the system.

    Raises:
        HostError: neither has it.
    """
    spec = importlib.util.find_spec("sumo")
    if spec is not None and spec.origin is not None:
        packaged = Path(spec.origin).parent / "bin" / "netconvert"
        if packaged.is_file():
            return packaged
    program = shutil.which("netconvert")
    if program is None:
        raise HostError("netconvert isn't installed; install the Python package eclipse-sumo")
    return Path(program)


def _number(value: float) -> str:
    return f"{value:.{_PRECISION}f}"


def _edges(road: Road) -> list[_Edge]:
    edges = []
    straight = ReferenceLine.of_road(road).is_straight
    for name, backward in (("forward", False), ("backward", True)):
        lanes = sorted(_lanes_of(road, name), key=lambda lane: lane.y_m, reverse=backward)
        strips = [(lane.y_m, lane.width_m) for lane in lanes]
        if not straight:
            # SUMO gives the lanes of an edge one length. On a bend they have several, so that each
            # lane is an edge; the traffic keeps to its lane anyway.
            edges += [_Edge(f"{name}_{i}", backward, (strip,)) for i, strip in enumerate(strips)]
        elif strips:
            edges.append(_Edge(name, backward, tuple(strips)))
    if road.sidewalk_left_m > 0.0:
        width = road.sidewalk_left_m
        edges.append(_Edge("walk_left", False, ((road.left_edge_m + width / 2, width),), True))
    if road.sidewalk_right_m > 0.0:
        width = road.sidewalk_right_m
        edges.append(_Edge("walk_right", False, ((road.right_edge_m - width / 2, width),), True))
    return edges


def _lanes_of(road: Road, direction: str) -> list[Lane]:
    return [lane for lane in road.lanes if lane.direction == direction]


def _span(road: Road, edge: _Edge) -> tuple[float, float]:
    ends = (-OVERHANG_M, road.length_m + OVERHANG_M)
    return (ends[1], ends[0]) if edge.backward else ends


def _shape(line: ReferenceLine, x0_m: float, x1_m: float, y_m: float) -> str:
    """Return the middle of a lane; straight beyond both ends of the line."""
    way = line.path(x0_m, x1_m, y_m, _CHORD_M)
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in way)


def _plain_xml(road: Road) -> tuple[ElementTree.Element, ElementTree.Element]:
    """Return the nodes and edges files; each lane has a shape of its own, so that gaps can be."""
    line = ReferenceLine.of_road(road)
    nodes, edges = ElementTree.Element("nodes"), ElementTree.Element("edges")
    for edge in _edges(road):
        x0, x1 = _span(road, edge)
        middle = sum(y for y, _ in edge.lanes) / len(edge.lanes)
        for end, x in (("from", x0), ("to", x1)):
            east, north = line.to_map(x, middle)
            ElementTree.SubElement(
                nodes, "node", id=f"{edge.name}_{end}", x=_number(east), y=_number(north)
            )
        element = ElementTree.SubElement(
            edges,
            "edge",
            {"id": edge.name, "from": f"{edge.name}_from", "to": f"{edge.name}_to"},
            numLanes=str(len(edge.lanes)),
            speed=_number(road.speed_limit_mps),
            spreadType="center",
        )
        if not line.is_straight:
            element.set("shape", _shape(line, x0, x1, middle))
        for index, (y, width) in enumerate(edge.lanes):
            lane = ElementTree.SubElement(
                element,
                "lane",
                index=str(index),
                width=_number(width),
                shape=_shape(line, x0, x1, y),
            )
            if edge.pedestrian:
                lane.set("allow", "pedestrian")
    for number, one in enumerate(road.junction):
        _add_junction_road(nodes, edges, one, f"junction_{number}", road.speed_limit_mps)
    return nodes, edges


def _add_junction_road(
    nodes: ElementTree.Element,
    edges: ElementTree.Element,
    road: JunctionRoad,
    name: str,
    speed_mps: float,
) -> None:
    """Add each lane of an arm or a connecting road as an edge, linked to no other one."""
    line = ReferenceLine.of_road(road)
    for index, lane in enumerate(road.lanes):
        way = line.path(0.0, road.length_m, lane.y_m, _CHORD_M)
        if lane.direction == "backward":
            way.reverse()
        edge = f"{name}_{index}"
        for end, (east, north) in (("from", way[0]), ("to", way[-1])):
            ElementTree.SubElement(
                nodes, "node", id=f"{edge}_{end}", x=_number(east), y=_number(north)
            )
        element = ElementTree.SubElement(
            edges,
            "edge",
            {"id": edge, "from": f"{edge}_from", "to": f"{edge}_to"},
            numLanes="1",
            speed=_number(speed_mps),
            spreadType="center",
        )
        shape = " ".join(f"{_number(x)},{_number(y)}" for x, y in way)
        element.set("shape", shape)
        ElementTree.SubElement(element, "lane", index="0", width=_number(lane.width_m), shape=shape)


def _places(road: Road) -> tuple[LanePlace, ...]:
    line = ReferenceLine.of_road(road)
    by_y = {
        (edge.backward, y): LanePlace(
            edge.name, index, _span(road, edge)[0], edge.backward, line, y
        )
        for edge in _edges(road)
        if not edge.pedestrian
        for index, (y, _) in enumerate(edge.lanes)
    }
    return tuple(by_y[(lane.direction == "backward", lane.y_m)] for lane in road.lanes)


_UNFINISHED = "unfinished.net.xml"


def write_network(road: Road, folder: Path) -> Network:
    """Write ``road.net.xml`` and the plain files that it is made from into a folder.

    A network that lies there already and was made from the same files is left as it is.

    Raises:
        HostError: netconvert isn't installed or fails; the message holds what it said.
    """
    folder.mkdir(parents=True, exist_ok=True)
    network = Network(folder / "road.net.xml", _places(road))
    contents: dict[str, bytes] = {}
    for name, root in zip(("road.nod.xml", "road.edg.xml"), _plain_xml(road), strict=True):
        ElementTree.indent(root)
        contents[name] = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    if network.path.is_file() and all(
        _holds(folder / name, data) for name, data in contents.items()
    ):
        return network
    network.path.unlink(missing_ok=True)
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    command = [
        str(find_netconvert()),
        "--node-files=road.nod.xml",
        "--edge-files=road.edg.xml",
        f"--output-file={_UNFINISHED}",
        "--offset.disable-normalization=true",
        "--no-turnarounds=true",
        f"--precision={_PRECISION}",
    ]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if process.returncode != 0:
        raise HostError(f"netconvert can't make the road network: {process.stderr.strip()}")
    (folder / _UNFINISHED).replace(network.path)
    return network


def _holds(path: Path, data: bytes) -> bool:
    return path.is_file() and path.read_bytes() == data
