"""Blocks of an OpenDRIVE map (``.xodr``, versions 1.4 to 1.8).

Read: plan views of all kinds, lane offsets, lane sections, widths and borders, lane types, right-
and left-hand traffic, links, junctions (default, direct), speed limits, road types, marks, marked
crossings, objects and signs that stand beside the road. Not read: elevation, traffic lights. What
is well-formed and can't be a block stands in the library's ``rejected``, with the reason; what
isn't well-formed is an error.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.geometry import wrap_angle
from ssp_core.hashing import sha256_file
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import shifted
from ssp_scenario_manager.maps.block import LEFT_HAND, Library, RoadType
from ssp_scenario_manager.maps.crossings import Zebra, crossings_between, zebras_of
from ssp_scenario_manager.maps.lane_layout import (
    Slot,
    Stretch,
    active,
    direction_fault,
    may_change,
    stretches,
)
from ssp_scenario_manager.maps.opendrive_road import (
    Connection,
    Link,
    Mark,
    RoadRecord,
    Section,
    read_junction,
    read_road,
)
from ssp_scenario_manager.maps.reference_line import Unusable, road_line
from ssp_scenario_manager.maps.shifting import ShiftingLane, middle_line, shifting_lanes
from ssp_scenario_manager.maps.way_blocks import in_known_junctions, network_blocks
from ssp_scenario_manager.maps.ways import End, Rules, Side, Way, WayEnd, WayLane
from ssp_scenario_manager.maps.xml_input import BadElement, Loading, input_error, parts, untold

ROOT = "OpenDRIVE"
_ROAD_TYPES: dict[str, RoadType] = {
    "town": "urban",
    "townExpressway": "urban",
    "townCollector": "urban",
    "townArterial": "urban",
    "townPrivate": "urban",
    "townLocal": "urban",
    "townPlayStreet": "urban",
    "lowSpeed": "urban",
    "rural": "rural",
    "motorway": "motorway",
}
_WALKABLE = frozenset({"sidewalk", "walking"})
_KERBS = frozenset({"border", "curb"})
# A narrower strip beside the lanes is the edge line's, and no shoulder to stand on.
_SHOULDER_M = 0.5
# A border this wide is a verge: whoever waits beside the road stands on it, at its inner edge.
_VERGE_M = 1.0
# A stretch that ends this near to a road's end goes to its end.
_AT_END_M = 0.01
# Roads of no length that follow one another are looked through so far.
_MOST_PASSED = 100


_OTHER_END: dict[End, End] = {"start": "end", "end": "start"}


@dataclass
class _Map:
    """The parts of the map that have been read so far."""

    ways: list[Way] = field(default_factory=list)
    spans: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)
    shifting: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)
    roads: dict[str, RoadRecord] = field(default_factory=dict)
    connections: list[Connection] = field(default_factory=list)
    junctions: set[str] = field(default_factory=set)
    rejected: list[tuple[str, str]] = field(default_factory=list)
    faults: list[tuple[str, str]] = field(default_factory=list)
    lines: dict[str, ReferenceLine] = field(default_factory=dict)


def _edge_marks(section: Section, slot: Slot, leftwards: bool) -> tuple[Mark, ...]:
    """Return the marking on a lane's left or right border, which the inner lane of the two has."""
    inner = slot.id if leftwards == (slot.id > 0) else slot.id + (1 if leftwards else -1)
    if inner == 0:
        return section.centre_marks
    return next(lane.marks for lane in section.lanes if lane.id == inner)


def _side(outward: list[Slot], stretch: Stretch, edge: tuple[Mark, ...]) -> Side:
    """Describe the roadside beyond a driving lane by the lanes outside of it and its own edge."""
    shoulder = walkable = 0.0
    sidewalk = False
    kerb = any(mark.type == "curb" for mark in edge)
    for slot in outward:
        if slot.type in _WALKABLE:
            sidewalk = True
            walkable += slot.width_m
        elif sidewalk or slot.type == "none":
            break
        elif slot.type == "border" and slot.width_m >= _VERGE_M:
            kerb = True
            walkable += slot.width_m
        elif walkable > 0.0:
            break
        else:
            kerb = kerb or slot.type in _KERBS
            shoulder += slot.width_m
        lane = next(lane for lane in stretch.section.lanes if lane.id == slot.id)
        kerb = kerb or any(mark.type == "curb" for mark in lane.marks)
    if sidewalk:
        return Side("sidewalk", shoulder, walkable)
    if kerb:
        return Side("kerb", shoulder, walkable)
    return Side("shoulder" if shoulder >= _SHOULDER_M else "verge", shoulder)


def _rules(road: RoadRecord, stretch: Stretch, along: bool) -> Rules:
    """Return speed limit and lane changes for one direction of travel."""
    own = [slot for slot in stretch.slots if slot.driving and slot.along == along]
    span = stretch.start_m, stretch.end_m
    speeds_mps = [speed for _, _, speed in active(road.types, *span, _from)]
    ids = {slot.id for slot in own}
    for lane in stretch.section.lanes:
        if lane.id in ids:
            speeds_mps += [speed for _, speed in active(lane.speeds, *span, _from)]
    limits = [speed for speed in speeds_mps if speed is not None]
    # From right to left as the drivers see it.
    ordered = own if along else own[::-1]
    pairs = list(pairwise(ordered))
    return Rules(
        speed_mps=min(limits, default=None),
        change_left=any(may_change(a, b, stretch) for a, b in pairs),
        change_right=any(may_change(b, a, stretch) for a, b in pairs),
    )


def _from(record: tuple[float, *tuple[object, ...]]) -> float:
    return record[0]


def _road_type(road: RoadRecord, at_m: float) -> RoadType:
    index = bisect_right(road.types, at_m, key=_from) - 1
    word = road.types[index][1] if index >= 0 else "unknown"
    return _ROAD_TYPES.get(word, "any")


def _way(road: RoadRecord, line: ReferenceLine, stretch: Stretch, zebras: Sequence[Zebra]) -> Way:
    low, high = stretch.start_m, min(stretch.end_m, line.length_m)
    if high >= road.length_m - _AT_END_M:
        high = line.length_m
    whole = low <= _AT_END_M and high == line.length_m
    slots = list(stretch.slots)
    driving = [i for i, slot in enumerate(slots) if slot.driving]
    notes = [LEFT_HAND] if road.left_hand else []
    if road.not_drawn:
        notes.append(f"{road.not_drawn} objects or signs of road {road.id} can't be drawn")
    return Way(
        roads=(road.id,),
        span_m=None if whole else (round(low, 2), round(high, 2)),
        line=line if whole else line.section(low, high),
        lanes=tuple(
            WayLane(f"lane {slots[i].id}", slots[i].y_m, slots[i].width_m, slots[i].along)
            for i in driving
        ),
        right=_side(
            slots[: driving[0]][::-1],
            stretch,
            _edge_marks(stretch.section, slots[driving[0]], leftwards=False),
        ),
        left=_side(
            slots[driving[-1] + 1 :],
            stretch,
            _edge_marks(stretch.section, slots[driving[-1]], leftwards=True),
        ),
        road_type=_road_type(road, 0.5 * (low + high)),
        along=_rules(road, stretch, True),
        against=_rules(road, stretch, False),
        crossings=tuple(
            zebra.at(zebra.s_m - low)
            for zebra in crossings_between(zebras, low, high, [slots[i].y_m for i in driving])
        ),
        junction=road.junction,
        left_hand=road.left_hand,
        notes=tuple(notes),
        scenery=tuple(shifted(item, -low) for item in road.scenery if low <= item.s_m <= high),
    )


def _add_road(road_map: _Map, road: RoadRecord) -> None:
    name = f"road {road.id}"
    road_map.spans[road.id] = []
    road_map.shifting[road.id] = []
    road_map.roads[road.id] = road
    fault = road.fault or direction_fault(road)
    if fault:
        road_map.faults.append((name, fault))
        return
    steady, refused = stretches(road)
    road_map.rejected += [
        (
            name
            if a <= _AT_END_M and b >= road.length_m - _AT_END_M
            else f"{name} [{a:g}-{b:g} m]",
            why,
        )
        for a, b, why in refused
    ]
    if not road.sections:
        road_map.rejected.append((name, "it has no lane section"))
    shifting = list(shifting_lanes(road, steady))
    if not steady and not shifting:
        return
    try:
        line = road_line(road)
    except Unusable as error:
        road_map.rejected.append((name, str(error)))
        return
    road_map.lines[road.id] = line
    zebras = zebras_of(road.crosswalks, line)
    for stretch in steady:
        if min(stretch.end_m, line.length_m) - stretch.start_m <= _AT_END_M:
            continue
        way = _way(road, line, stretch, zebras)
        road_map.spans[road.id].append((len(road_map.ways), stretch.start_m, stretch.end_m))
        road_map.ways.append(way)
    for lane in shifting:
        _add_lane(road_map, road, line, lane)


def _add_lane(road_map: _Map, road: RoadRecord, line: ReferenceLine, lane: ShiftingLane) -> None:
    """Add a lane that shifts, as a way of its own."""
    low, high = lane.start_m, lane.end_m
    if min(high, line.length_m) - low <= _AT_END_M:
        return
    name = f"lane {lane.lane_id}"
    whole = low <= _AT_END_M and high >= road.length_m - _AT_END_M
    span_m = None if whole else (round(low, 2), round(high, 2))
    slot = Slot(lane.lane_id, "driving", 0.0, lane.width_m, driving=True, along=lane.along)
    alone = Stretch(lane.section, low, high, (slot,))
    try:
        own = middle_line(road, line, lane)
    except Unusable as error:
        road_map.rejected.append((f"road {road.id} {name}", str(error)))
        return
    road_map.shifting[road.id].append((len(road_map.ways), low, high))
    road_map.ways.append(
        Way(
            roads=(road.id,),
            span_m=span_m,
            line=own,
            lanes=(WayLane(name, 0.0, lane.width_m, lane.along),),
            right=Side("any"),
            left=Side("any"),
            road_type=_road_type(road, 0.5 * (low + high)),
            along=_rules(road, alone, True),
            against=_rules(road, alone, False),
            junction=road.junction,
            left_hand=road.left_hand,
            notes=(LEFT_HAND,) if road.left_hand else (),
            lane=name,
        )
    )


def _way_ends(road_map: _Map, road_id: str, end: End) -> list[WayEnd]:
    """Return the ways that lie at a road's end.

    A road of no length, as editors leave them, stands for what follows it.
    """
    passed: set[str] = set()
    while not road_map.spans[road_id] and not road_map.shifting[road_id]:
        road, beyond = road_map.roads[road_id], road_map.roads[road_id].links.get(_OTHER_END[end])
        if road.length_m > _AT_END_M or beyond is None or beyond.contact is None:
            return []
        passed.add(road_id)
        if beyond.id not in road_map.roads or beyond.id in passed or len(passed) > _MOST_PASSED:
            return []
        road_id, end = beyond.id, beyond.contact
    last_m = road_map.roads[road_id].length_m - _AT_END_M
    return [
        (index, end)
        for index, low, high in (*road_map.spans[road_id], *road_map.shifting[road_id])
        if (low <= _AT_END_M if end == "start" else high >= last_m)
    ]


def _seams(
    lanes: Sequence[tuple[int, float, float]], spans: Sequence[tuple[int, float, float]]
) -> Iterator[tuple[WayEnd, WayEnd]]:
    """Yield where lanes that shift begin and end beside other ways of their road."""
    own = {index for index, _, _ in lanes}
    ordered = sorted((*lanes, *spans), key=lambda one: one[1])
    starts = [low for _, low, _ in ordered]
    for index, _, high in ordered:
        first, last = bisect_left(starts, high - _AT_END_M), bisect_right(starts, high + _AT_END_M)
        for other, _, _ in ordered[first:last]:
            if other != index and (index in own or other in own):
                yield (index, "end"), (other, "start")


def _contacts(road_map: _Map) -> list[tuple[WayEnd, WayEnd]]:
    """List the ends of ways that meet: within a road, by links, and by junctions' connections."""
    pairs: list[tuple[WayEnd, WayEnd]] = []
    for road_id, spans in road_map.spans.items():
        for (i, _, high), (j, low, _) in pairwise(spans):
            if low - high <= _AT_END_M:
                pairs.append(((i, "end"), (j, "start")))
        lanes = road_map.shifting[road_id]
        if lanes:
            pairs += _seams(lanes, spans)
    at_junction: dict[tuple[str, str], list[End]] = {}
    for road in road_map.roads.values():
        for end, link in road.links.items():
            if link.kind == "junction":
                at_junction.setdefault((road.id, link.id), []).append(end)
            elif link.id not in road_map.roads:
                road_map.rejected.append(
                    (f"road {road.id} {end}", f"is linked to road {link.id}, which isn't there")
                )
            elif link.contact is not None:
                beyond = _way_ends(road_map, link.id, link.contact)
                pairs += product(_way_ends(road_map, road.id, end), beyond)
    for connection in road_map.connections:
        if connection.incoming not in road_map.roads or connection.to not in road_map.roads:
            road_map.rejected.append(
                (
                    f"junction {connection.junction}",
                    f"connects road {connection.incoming} to road {connection.to}, and one of them "
                    "isn't there",
                )
            )
            continue
        ends = at_junction.get((connection.incoming, connection.junction), [])
        # A road that begins and ends at one junction: its connecting roads say which end they mean.
        if len(ends) == 1:
            pairs += product(
                _way_ends(road_map, connection.incoming, ends[0]),
                _way_ends(road_map, connection.to, connection.contact),
            )
    return pairs


# A heading of more than this either way may be summed up along a road, or be in degrees.
_ONE_TURN_RAD = 2.0 * math.pi + 1e-3
# What shows that it is summed up: the road goes on where it then leads, and it is this long at
# least, and the ends are so near to each other.
_SHORTEST_M = 1.0
_MEET_M = 1.0
_MEET_SHARE = 0.02
_MEET_RAD = 0.1


def _in_degrees(road_map: _Map) -> tuple[str, float] | None:
    """Find the first road with a heading beyond one turn that nothing shows to be in radians.

    Headings that are summed up along roads are sound: the next part of the road, or a road that it
    is linked to, then begins where and as the heading says. None: there is no such road.
    """
    beyond: dict[str, float] = {}
    for road in road_map.roads.values():
        most = max((shape.heading_rad for shape in road.geometry), key=abs)
        if abs(most) > _ONE_TURN_RAD:
            beyond[road.id] = most
    if not beyond:
        return None
    sound_ids = {road_id for road_id in beyond if _goes_on(road_map, road_map.roads[road_id])}
    for road in road_map.roads.values():
        for end, link in road.links.items():
            if {road.id, link.id} & beyond.keys() and _meet(road_map, road.id, end, link):
                sound_ids |= {road.id, link.id}
    return next(((name, most) for name, most in beyond.items() if name not in sound_ids), None)


def _goes_on(road_map: _Map, road: RoadRecord) -> bool:
    """Tell whether a road's parts follow one another by their headings in radians."""
    long = [shape for shape in road.geometry if shape.length_m >= _SHORTEST_M]
    return len(long) > 1 and _line_of(road_map, road.id) is not None


def _meet(road_map: _Map, road_id: str, end: End, link: Link) -> bool:
    """Tell whether two linked roads meet by their headings in radians."""
    mine, other = _line_of(road_map, road_id), _line_of(road_map, link.id)
    if link.kind != "road" or link.contact is None or mine is None or other is None:
        return False
    if min(mine.length_m, other.length_m) < _SHORTEST_M:
        return False
    a = mine.pose(0.0 if end == "start" else mine.length_m)
    b = other.pose(0.0 if link.contact == "start" else other.length_m)
    near_m = min(_MEET_M, _MEET_SHARE * min(mine.length_m, other.length_m))
    turn = wrap_angle(a.yaw_rad - b.yaw_rad + (math.pi if end == link.contact else 0.0))
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) <= near_m and abs(turn) <= _MEET_RAD


def _line_of(road_map: _Map, road_id: str) -> ReferenceLine | None:
    if road_id not in road_map.lines and road_id in road_map.roads:
        with suppress(Unusable):
            road_map.lines[road_id] = road_line(road_map.roads[road_id])
    return road_map.lines.get(road_id)


def load_opendrive(path: Path, loading: Loading = untold) -> Library:
    """Load the blocks of an OpenDRIVE map.

    Raises:
        InputError: the file can't be read, is no OpenDRIVE, or an element in it is malformed.
    """
    road_map = _Map()
    for element in parts(path, ROOT, "road", loading):
        try:
            if element.tag == "road":
                road = read_road(element)
                if road.id in road_map.roads:
                    raise BadElement(element, "has the id of another road", "id")
                _add_road(road_map, road)
            elif element.tag == "junction":
                road_map.junctions.add(element.get("id", ""))
                road_map.connections += read_junction(element)
        except BadElement as bad:
            raise input_error(path, element, bad) from bad
    if not road_map.roads:
        raise InputError("has no road", file=path, remedy="give a map with roads")
    degrees = _in_degrees(road_map)
    if degrees is not None:
        raise InputError(
            "is more than one turn, and no road goes on where it then leads",
            file=path,
            field=f"road {degrees[0]} / planView / geometry / hdg",
            value=degrees[1],
            remedy=f"hdg is in radians: {degrees[1]:g} degrees are {math.radians(degrees[1]):.6g}",
        )
    ways, missing = in_known_junctions(road_map.ways, road_map.junctions)
    map_blocks = network_blocks(ways, _contacts(road_map))
    return Library(
        source=path.name,
        sha256=sha256_file(path),
        kind="opendrive",
        blocks=map_blocks.blocks,
        rejected=tuple(road_map.rejected + missing + map_blocks.rejected),
        faults=tuple(road_map.faults),
        shifting=map_blocks.shifting,
    )
