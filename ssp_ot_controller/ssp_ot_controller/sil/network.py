"""The run's road as a SUMO network, in frame map without any offset."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from ssp_core.errors import HostError
from ssp_core.geometry import Pose2
from ssp_core.run_spec import Lane, Road

# The network goes on this far beyond the block, so that whatever starts or stops at the block's
# end is on a lane with its whole length.
OVERHANG_M = 100.0
# More digits than SUMO's default, so that lanes lie where the run file says.
_PRECISION = 6


@dataclass(frozen=True, slots=True)
class LanePlace:
    """Where a lane of the run file is in the network.

    Args:
        edge: id of the edge.
        index: of the lane in the edge, 0 is the rightmost.
        start_x_m: block x at which the lane begins; a backward lane begins at the far end.
        backward: it leads towards smaller block x.
    """

    edge: str
    index: int
    start_x_m: float
    backward: bool

    def position_m(self, x_m: float) -> float:
        """SUMO's position along the lane of a place given by block x."""
        return self.start_x_m - x_m if self.backward else x_m - self.start_x_m


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
    """The netconvert program: of the eclipse-sumo package, else of the system.

    Raises:
        HostError: neither has it.
    """
    spec = importlib.util.find_spec("sumo")
    if spec is not None and spec.origin is not None:
        packaged = Path(spec.origin).parent / "bin" / "netconvert"
        if packaged.is_file():
            return packaged
    found = shutil.which("netconvert")
    if found is None:
        raise HostError("netconvert isn't installed; install the Python package eclipse-sumo")
    return Path(found)


def _number(value: float) -> str:
    return f"{value:.{_PRECISION}f}"


def _edges(road: Road) -> list[_Edge]:
    edges = []
    for name, backward in (("forward", False), ("backward", True)):
        lanes = sorted(_lanes_of(road, name), key=lambda lane: lane.y_m, reverse=backward)
        if lanes:
            edges.append(_Edge(name, backward, tuple((lane.y_m, lane.width_m) for lane in lanes)))
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


def _shape(origin: Pose2, x0_m: float, x1_m: float, y_m: float) -> str:
    ends = (origin.to_parent(x0_m, y_m), origin.to_parent(x1_m, y_m))
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in ends)


def _plain_xml(road: Road) -> tuple[ElementTree.Element, ElementTree.Element]:
    """The nodes and edges files. Every lane has a shape of its own, so that gaps are possible."""
    origin = road.origin.pose
    nodes, edges = ElementTree.Element("nodes"), ElementTree.Element("edges")
    for edge in _edges(road):
        x0, x1 = _span(road, edge)
        middle = sum(y for y, _ in edge.lanes) / len(edge.lanes)
        for end, x in (("from", x0), ("to", x1)):
            east, north = origin.to_parent(x, middle)
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
        for index, (y, width) in enumerate(edge.lanes):
            lane = ElementTree.SubElement(
                element,
                "lane",
                index=str(index),
                width=_number(width),
                shape=_shape(origin, x0, x1, y),
            )
            if edge.pedestrian:
                lane.set("allow", "pedestrian")
    return nodes, edges


def _places(road: Road) -> tuple[LanePlace, ...]:
    by_y = {
        (edge.backward, y): LanePlace(edge.name, index, _span(road, edge)[0], edge.backward)
        for edge in _edges(road)
        if not edge.pedestrian
        for index, (y, _) in enumerate(edge.lanes)
    }
    return tuple(by_y[(lane.direction == "backward", lane.y_m)] for lane in road.lanes)


def write_network(road: Road, folder: Path) -> Network:
    """Writes ``road.net.xml`` and the plain files that it is made from into a folder.

    Args:
        road: block of the run.
        folder: is made when it isn't there.

    Raises:
        HostError: netconvert isn't installed or fails; the message holds what it said.
    """
    folder.mkdir(parents=True, exist_ok=True)
    nodes, edges = _plain_xml(road)
    for name, root in (("road.nod.xml", nodes), ("road.edg.xml", edges)):
        ElementTree.indent(root)
        ElementTree.ElementTree(root).write(folder / name, encoding="utf-8", xml_declaration=True)
    command = [
        str(find_netconvert()),
        "--node-files=road.nod.xml",
        "--edge-files=road.edg.xml",
        "--output-file=road.net.xml",
        "--offset.disable-normalization=true",
        "--no-turnarounds=true",
        f"--precision={_PRECISION}",
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise HostError(f"netconvert can't make the road network: {done.stderr.strip()}")
    return Network(folder / "road.net.xml", _places(road))
