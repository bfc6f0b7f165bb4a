"""OpenDRIVE maps of our own blocks, for players that need a map."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scenariogeneration import xodr  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.run_file.road import CurvePiece, JunctionRoad
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.block import WIDEST_GAP_M, Block, BlockLane
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD

# The standard library's, which only builds and writes here: nothing is parsed.


# The standards ask for a date. A date of writing would make the same task give other bytes.
FIXED_DATE = "2000-01-01T00:00:00"


def to_bytes(root: ET.Element) -> bytes:
    """Encode as UTF-8 with a declaration, indented by two spaces, and a final newline."""
    ET.indent(root, "  ")
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


# Lanes closer than this touch.
_TOUCH_M = 1e-6
# Rounding in a route's pieces bends them by less.
_FLAT_1PM = 1e-6
_CROSSING_WIDTH_M = 4.0
_MARK_M = 0.12
# A verge has no end; a map's has, and whoever waits on it needs ground.
_VERGE_M = 6.0
# Processors differ in a sine's last bit; a file doesn't.
_DIGITS = 10

_ROAD_TYPES = {
    "urban": xodr.RoadType.town,
    "rural": xodr.RoadType.rural,
    "motorway": xodr.RoadType.motorway,
    "proving_ground": xodr.RoadType.unknown,
}


@dataclass(frozen=True, slots=True)
class _Sides:
    """A block's lanes from the middle outwards."""

    middle_m: float
    left: tuple[BlockLane, ...]
    right: tuple[BlockLane, ...]
    left_hand_traffic: bool


def _sides(block: Block) -> _Sides:
    forward, backward = block.forward_lanes, block.backward_lanes
    if not forward:
        raise InputError(
            "has no lane along it",
            field="block",
            value=block.block_id,
            remedy="give the block a lane in the VUT's direction",
        )
    if not backward:
        middle = max(lane.y_m + lane.width_m / 2 for lane in forward)
        return _Sides(middle, (), tuple(sorted(forward, key=lambda v: -v.y_m)), False)
    left_hand = backward[0].y_m < forward[0].y_m
    right, left = (backward, forward) if left_hand else (forward, backward)
    middle = max(lane.y_m + lane.width_m / 2 for lane in right)
    gap = min(lane.y_m - lane.width_m / 2 for lane in left) - middle
    if gap < -_TOUCH_M:
        raise InputError(
            "mixes the lanes of both directions, which OpenDRIVE can't express",
            field="block",
            value=block.block_id,
            remedy="put the lanes of one direction on one side",
        )
    return _Sides(
        middle + gap / 2 if _TOUCH_M < gap <= WIDEST_GAP_M + _TOUCH_M else middle,
        tuple(sorted(left, key=lambda v: v.y_m)),
        tuple(sorted(right, key=lambda v: -v.y_m)),
        left_hand,
    )


@dataclass(frozen=True, slots=True)
class _Strip:
    """A lane of the map: one of the block's, or a wide gap between two."""

    lane_id: int
    width_m: float
    lane: BlockLane | None


def _strips(lanes: Sequence[BlockLane], middle_m: float, sign: int, block: Block) -> list[_Strip]:
    """Return the lanes of one side from the middle outwards.

    A narrow gap widens the lanes beside it, half each. A wider one is a strip that isn't driven
    on.
    """
    strips: list[_Strip] = []
    edge = middle_m
    for lane in lanes:
        gap = sign * (lane.y_m - edge) - lane.width_m / 2
        if gap < -_TOUCH_M:
            raise InputError(
                "has lanes that overlap",
                field="block",
                value=block.block_id,
                remedy="move them apart",
            )
        width = lane.width_m
        if gap > WIDEST_GAP_M + _TOUCH_M:
            strips.append(_Strip(sign * (len(strips) + 1), gap, None))
        elif gap > _TOUCH_M:
            # What lies at the middle is shared by both sides already.
            half = gap / 2 if strips else 0.0
            if half:
                strips[-1] = replace(strips[-1], width_m=strips[-1].width_m + half)
            width += gap - half
        strips.append(_Strip(sign * (len(strips) + 1), width, lane))
        edge = lane.y_m + sign * lane.width_m / 2
    return strips


def _lane_section(block: Block, sides: _Sides) -> xodr.LaneSection:
    mark = xodr.RoadMarkType.solid if sides.left else _edge_mark(block.left_boundary)
    centre = xodr.Lane(xodr.LaneType.none)
    centre.add_roadmark(_mark(mark))
    section = xodr.LaneSection(0.0, centre)
    outside = {
        1: (block.left_boundary, block.shoulder_left_m, block.sidewalk_left_m),
        -1: (block.right_boundary, block.shoulder_right_m, block.sidewalk_right_m),
    }
    for sign, lanes in ((1, sides.left), (-1, sides.right)):
        add = section.add_left_lane if sign > 0 else section.add_right_lane
        strips = _strips(lanes, sides.middle_m, sign, block)
        boundary, shoulder_m, sidewalk_m = outside[sign]
        for i, strip in enumerate(strips):
            kind = xodr.LaneType.median if strip.lane is None else xodr.LaneType.driving
            lane = xodr.Lane(kind, a=strip.width_m)
            last = i == len(strips) - 1
            if not last:
                lane.add_roadmark(_lane_mark(block, strip))
            elif shoulder_m > 0.0:
                lane.add_roadmark(_mark(xodr.RoadMarkType.solid))
            else:
                lane.add_roadmark(_mark(_edge_mark(boundary)))
            add(lane)
        if shoulder_m > 0.0:
            lane = xodr.Lane(xodr.LaneType.shoulder, a=shoulder_m)
            lane.add_roadmark(_mark(_edge_mark(boundary)))
            add(lane)
        if sidewalk_m > 0.0:
            add(xodr.Lane(xodr.LaneType.sidewalk, a=sidewalk_m))
        if boundary == "verge":
            add(xodr.Lane(xodr.LaneType.none, a=_VERGE_M))
    return section


def _edge_mark(boundary: str) -> xodr.RoadMarkType:
    return xodr.RoadMarkType.curb if boundary == "kerb" else xodr.RoadMarkType.solid


def _mark(kind: xodr.RoadMarkType, change: xodr.LaneChange | None = None) -> xodr.RoadMark:
    return xodr.RoadMark(kind, width=_MARK_M, laneChange=change)


def _lane_mark(block: Block, strip: _Strip) -> xodr.RoadMark:
    """Choose the mark between two lanes: solid where changing is forbidden.

    Lane ids rise to the left.
    """
    left, right = (f"lane_change_{side}" in block.permitted for side in ("left", "right"))
    if strip.lane is None or (strip.lane.forward and not (left or right)):
        return _mark(xodr.RoadMarkType.solid)
    if not strip.lane.forward or (left and right):
        return _mark(xodr.RoadMarkType.broken)
    return _mark(
        xodr.RoadMarkType.broken,
        xodr.LaneChange.increase if left else xodr.LaneChange.decrease,
    )


def _geometry(piece: CurvePiece) -> xodr.Line | xodr.Arc | xodr.Spiral:
    """Return a piece's shape.

    An arc that bends by rounding alone is a line: CARLA finds places from an arc's centre, in
    single precision, and if that is far away they are metres off.
    """
    k0, k1 = piece.start_curvature_1pm, piece.end_curvature_1pm
    if k0 != k1:
        return xodr.Spiral(k0, k1, length=piece.length_m)
    if abs(k0) < _FLAT_1PM and 0.5 * abs(k0) * piece.length_m**2 < _TOUCH_M:
        return xodr.Line(piece.length_m)
    return xodr.Arc(k0, length=piece.length_m)


def _crossing(number: int, s_m: float, right: float, left: float) -> ET.Element:
    """Make a zebra from its right to its left border.

    Made here: scenariogeneration numbers objects over the life of the process.
    """
    middle, half, across = 0.5 * (left + right), 0.5 * _CROSSING_WIDTH_M, 0.5 * (left - right)
    element = ET.Element(
        "object",
        {
            "id": str(number),
            "name": "crossing",
            "type": "crosswalk",
            "s": repr(s_m),
            "t": repr(middle),
            "zOffset": "0.0",
            "orientation": "none",
            "hdg": "0.0",
            "pitch": "0.0",
            "roll": "0.0",
            "length": repr(_CROSSING_WIDTH_M),
            "width": repr(left - right),
        },
    )
    outline = ET.SubElement(element, "outline", {"id": "0", "closed": "true"})
    for i, (u, v) in enumerate(
        ((-half, -across), (half, -across), (half, across), (-half, across))
    ):
        corner = {"u": repr(u), "v": repr(v), "z": "0.0", "height": "0.0", "id": str(i)}
        ET.SubElement(outline, "cornerLocal", corner)
    return element


def _road(block: Block, number: int) -> xodr.Road:
    sides = _sides(block)
    plan = xodr.PlanView()
    s = 0.0
    for piece in block.line.pieces:
        pose = block.line.pose(s)
        x, y, heading = (round(v, _DIGITS) for v in (pose.x_m, pose.y_m, pose.yaw_rad))
        plan.add_fixed_geometry(_geometry(piece), x, y, heading, s)
        s += piece.length_m
    lanes = xodr.Lanes()
    lanes.add_laneoffset(xodr.LaneOffset(0.0, sides.middle_m))
    lanes.add_lanesection(_lane_section(block, sides))
    rule = xodr.TrafficRule.LHT if sides.left_hand_traffic else xodr.TrafficRule.RHT
    road = xodr.Road(number, plan, lanes, name=block.block_id, rule=rule)
    kind = _ROAD_TYPES.get(block.road_type)
    if kind is not None or block.speed_limit_mps is not None:
        road.add_type(kind or xodr.RoadType.unknown, 0.0, speed=block.speed_limit_mps)
    facts = {
        "ssp.road_type": block.road_type,
        "ssp.left_boundary": block.left_boundary,
        "ssp.right_boundary": block.right_boundary,
        "ssp.permitted": " ".join(sorted(block.permitted)),
    }
    for code, value in facts.items():
        road.add_userdata(xodr.UserData(code, value))
    return road


def _is_on(block: Block, line: ReferenceLine, length_m: float, y_m: float) -> list[bool]:
    """Tell of both ends of a line beside another one whether they lie on a block."""
    ends = np.array([line.to_map(s_m, y_m) for s_m in (0.0, length_m)])
    local = block.line.to_local_many(ends)
    on_block = (local[:, 1] > block.right_edge_m) & (local[:, 1] < block.left_edge_m)
    flags: list[bool] = on_block.tolist()
    return flags


def _off_block(block: Block, roads: Sequence[JunctionRoad]) -> Iterator[Block]:
    """Yield the roads of a junction that don't lie on a block, as blocks of their own.

    Of one that turns they have no lane in common at either of their ends: a player that looks for
    the lane under a place would find theirs.
    """
    turns = block.passage is not None and abs(block.passage.turn_rad) >= STRAIGHT_ON_RAD
    for number, road in enumerate(roads):
        line = ReferenceLine.of_road(road)
        lanes = sorted(road.lanes, key=lambda lane: lane.y_m)
        if turns:
            lanes = [x for x in lanes if not any(_is_on(block, line, road.length_m, x.y_m))]
        middle_m = 0.5 * (road.left_edge_m + road.right_edge_m)
        # Its middle may be the block's very edge, where other lanes than the block's remain.
        same = not turns and all(_is_on(block, line, road.length_m, middle_m))
        if same or not lanes:
            continue
        block_lanes = [
            BlockLane(lane.y_m, lane.width_m, lane.direction == "forward", f"lane {i}")
            for i, lane in enumerate(lanes)
        ]
        if not any(lane.forward for lane in block_lanes):
            line = line.reversed()
            block_lanes = [
                replace(one, y_m=-one.y_m, forward=True) for one in reversed(block_lanes)
            ]
        yield Block(
            block_id=f"{block.junction} {number}",
            line=line,
            lanes=tuple(block_lanes),
            road_type=block.road_type,
            segment="junction",
            left_boundary="any",
            right_boundary="any",
            sidewalk_left_m=0.0,
            sidewalk_right_m=0.0,
            permitted=frozenset({"keep_lane"}),
            speed_limit_mps=block.speed_limit_mps,
        )


def opendrive_map(
    block: Block,
    name: str,
    provenance: Mapping[str, str],
    junction: Sequence[JunctionRoad] = (),
) -> bytes:
    """Make an OpenDRIVE 1.5 map with one road, id 1, and others where it leads through a junction.

    Args:
        block: in frame map.
        name: of the map.
        provenance: what it was made from and by what, as user data of the map.
        junction: roads of the junction, each of which becomes a road without links.

    Raises:
        InputError: the block's lanes can't be put into OpenDRIVE.
    """
    drive = xodr.OpenDrive(name)
    drive.add_road(_road(block, 1))
    for number, other in enumerate(_off_block(block, junction), 2):
        drive.add_road(_road(other, number))
    root = drive.get_element()
    road, header = root.find("road"), root.find("header")
    if road is None or header is None:
        raise ValueError("scenariogeneration made a map without a road or a header")
    if block.zebras_m:
        objects = ET.SubElement(road, "objects")
        objects.extend(_crossing(i, *zebra) for i, zebra in enumerate(block.zebras_m, 1))
    # The standard wants user data last, scenariogeneration puts it first.
    for one in root.findall("road"):
        for data in one.findall("userData"):
            one.remove(data)
            one.append(data)
    header.set("date", FIXED_DATE)
    header.set("vendor", "SSP")
    offsets = block.left_edge_m, block.right_edge_m
    points = [point for y in offsets for point in block.line.path(0.0, block.length_m, y)]
    xs, ys = zip(*points, strict=True)
    extent = {"north": max(ys), "south": min(ys), "east": max(xs), "west": min(xs)}
    for side, value in extent.items():
        header.set(side, repr(round(value, 3)))
    for code, text in sorted(provenance.items()):
        ET.SubElement(header, "userData", {"code": code, "value": text})
    return to_bytes(root)
