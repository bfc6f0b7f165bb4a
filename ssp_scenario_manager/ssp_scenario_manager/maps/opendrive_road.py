"""Roads and junctions of an OpenDRIVE map, as they stand in the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

from ssp_core.run_file.road import SceneryItem
from ssp_scenario_manager.maps.crossings import Crosswalk, read_crosswalks
from ssp_scenario_manager.maps.scenery import read_scenery
from ssp_scenario_manager.maps.xml_input import (
    FARTHEST_M,
    BadElement,
    number,
    text,
    whole,
)

End = Literal["start", "end"]
Shape = Literal["line", "arc", "spiral", "poly3", "paramPoly3"]


@dataclass(frozen=True, slots=True)
class Geometry:
    """A part of the reference line.

    Args:
        s_m: where it starts along the road.
        x_m: its start, as y_m and heading.
        y_m: as x_m.
        heading_rad: there.
        kind: how it is described.
        numbers: curvature; start and end curvature; a to d; aU to dU and aV to dV.
        normalised: paramPoly3 whose parameter runs from 0 to 1.
    """

    s_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    kind: Shape
    numbers: tuple[float, ...] = ()
    normalised: bool = False


@dataclass(frozen=True, slots=True)
class Cubic:
    """a + b d + c d^2 + e d^3, with d the distance from s_m (along the road), m."""

    s_m: float
    a: float
    b: float
    c: float
    d: float

    def at(self, s_m: float) -> float:
        u = s_m - self.s_m
        return self.a + u * (self.b + u * (self.c + u * self.d))

    @property
    def is_constant(self) -> bool:
        return self.b == self.c == self.d == 0.0


@dataclass(frozen=True, slots=True)
class Mark:
    """The marking on a lane's outer border, from s_m (along the road) on."""

    s_m: float
    type: str
    lane_change: str | None


@dataclass(frozen=True, slots=True)
class LaneRecord:
    """A lane of one lane section; all s_m are along the road.

    Args:
        closed: from where on it is closed to cars, or open to them again.
        direction: attribute of that name: standard, reversed or both.
        travel: vendor data ``travelDir``: forward, backward, bidirectional; empty where it has
            none.
    """

    id: int
    type: str
    widths: tuple[Cubic, ...]
    borders: tuple[Cubic, ...]
    marks: tuple[Mark, ...]
    speeds: tuple[tuple[float, float | None], ...]
    closed: tuple[tuple[float, bool], ...]
    direction: str
    travel: str


@dataclass(frozen=True, slots=True)
class Section:
    """A lane section: lanes from the left border to the right one, without lane 0."""

    start_m: float
    end_m: float
    lanes: tuple[LaneRecord, ...]
    centre_marks: tuple[Mark, ...]


@dataclass(frozen=True, slots=True)
class Link:
    """The element that a road's end is joined to."""

    kind: Literal["road", "junction"]
    id: str
    contact: End | None


@dataclass(frozen=True, slots=True)
class RoadRecord:
    """A road.

    Args:
        id: unique in the map.
        junction: whose connecting road it is, None outside of one.
        length_m: along its reference line.
        left_hand: traffic keeps to the left.
        types: (s, type, speed limit in m/s or None), in order.
        offsets: of lane 0 from the reference line.
        scenery: what stands beside it, along its reference line.
        not_drawn: how much more there is of it that can't be.
        fault: why it is left out, although it is well-formed; empty: it isn't.
    """

    id: str
    junction: str | None
    length_m: float
    left_hand: bool
    links: dict[End, Link]
    types: tuple[tuple[float, str, float | None], ...]
    geometry: tuple[Geometry, ...]
    offsets: tuple[Cubic, ...]
    sections: tuple[Section, ...]
    crosswalks: tuple[Crosswalk, ...]
    scenery: tuple[SceneryItem, ...] = ()
    not_drawn: int = 0
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Connection:
    """A way through a junction: the end of a road that enters, and the road that it leads to."""

    junction: str
    incoming: str
    to: str
    contact: End


LONGEST_ROAD_M = 1e6
_MOST_LANES = 64
# Parts of the line, lane sections or lane offsets of one road.
_MOST_RECORDS = 10_000
_COEFFICIENT = 1e6
_CURVATURE = 1e3
_NUMBERS: dict[Shape, tuple[str, ...]] = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": tuple("abcd"),
    "paramPoly3": tuple(name + side for side in "UV" for name in "abcd"),
}
_SHAPES: dict[str, Shape] = {shape: shape for shape in _NUMBERS}
_SPEED_UNITS = {"m/s": 1.0, "mph": 0.44704, "km/h": 1 / 3.6}
# What others write for a unit of OpenDRIVE.
_MEANT = {"kph": "km/h", "kmh": "km/h", "kmph": "km/h", "mps": "m/s", "ms": "m/s", "mi/h": "mph"}
# Which side traffic keeps to, and where it goes on a lane; others write them in any case.
_RULES = ("rht", "lht")
_DIRECTIONS = ("standard", "reversed", "both")
_SPELT = {"rht": "RHT", "lht": "LHT"}
# Participants that restrictions of access name, of which one that may use a lane makes it a car's.
_CARS = frozenset(
    {"passengercar", "car", "none", "simulator", "autonomoustraffic", "throughtraffic"}
)


def _end(element: Element) -> End | None:
    word = element.get("contactPoint")
    if word == "start":
        return "start"
    if word == "end":
        return "end"
    if word is None:
        return None
    raise BadElement(element, "is no end of a road", "contactPoint", "say start or end")


def _word(element: Element, name: str, words: tuple[str, ...]) -> str:
    """Read an attribute that is one of a few words, in small letters; the first is the default.

    A road with another word is left out: see _word_fault.
    """
    return element.get(name, words[0]).strip().lower()


def _word_fault(road: Element) -> str:
    """Name a word that hides where a road's traffic runs; empty: there is none."""
    places = [("rule", _RULES, road), *(("direction", _DIRECTIONS, e) for e in road.iter("lane"))]
    for name, words, element in places:
        if _word(element, name, words) not in words:
            choices = " or ".join(_SPELT.get(word, word) for word in words)
            return f"{element.get(name)!r} is no {name} of a {element.tag}; write {choices}"
    return ""


def _rising(records: list[tuple[Element, float]]) -> None:
    if len(records) > _MOST_RECORDS:
        element = records[_MOST_RECORDS][0]
        raise BadElement(element, f"is one of {len(records)}", None, f"at most {_MOST_RECORDS}")
    before = -1.0
    for element, s in records:
        if s < before:
            raise BadElement(element, "starts before the one ahead of it", "s", "sort them")
        before = s


def _cubic(element: Element, base_m: float, attribute: str) -> Cubic:
    return Cubic(
        base_m + number(element, attribute, 0.0, high=LONGEST_ROAD_M),
        *(number(element, k, 0.0, low=-_COEFFICIENT, high=_COEFFICIENT) for k in "abcd"),
    )


def elevations(road: Element) -> list[Cubic]:
    """Return heights along a road, in order.

    Raises:
        BadElement: something in it is no number where one belongs.
    """
    cubics = [_cubic(e, 0.0, "s") for e in road.iterfind("elevationProfile/elevation")]
    return sorted(cubics, key=lambda cubic: cubic.s_m)


def _speed(element: Element) -> float | None:
    word = text(element, "max", "undefined").strip()
    if word in ("no limit", "undefined"):
        return None
    # A road with another unit is left out: see _unit_fault.
    unit = _SPEED_UNITS.get(element.get("unit", "m/s"), 1.0)
    speed = number(element, "max", low=-1.0, high=1000.0) * unit
    return speed if speed > 0.0 else None


def _unit_fault(road: Element) -> str:
    """Name the unit that keeps a road's limits from being read; empty: they can be read."""
    for element in (*road.iterfind("type/speed"), *road.iterfind("lanes/laneSection/*/lane/speed")):
        unit = element.get("unit", "m/s")
        if unit not in _SPEED_UNITS:
            likely_unit = _MEANT.get(unit.strip().lower().replace(" ", ""))
            units = ", ".join(_SPEED_UNITS)
            remedy = (
                f"write {likely_unit}, which is meant" if likely_unit else f"write one of {units}"
            )
            return f"{unit[:40]!r} is no unit of speed in OpenDRIVE; {remedy}"
    return ""


def _geometry(element: Element) -> Geometry:
    s, x, y, heading, length = (
        number(element, "s", low=0.0, high=LONGEST_ROAD_M),
        number(element, "x"),
        number(element, "y"),
        number(element, "hdg", low=-1e4, high=1e4),
        number(element, "length", low=0.0, high=LONGEST_ROAD_M),
    )
    shape = next((child for child in element if child.tag in _SHAPES), None)
    if shape is None:
        shape = next(iter(element), None)
    if shape is None:
        raise BadElement(element, "has no shape", None, "add line, arc, spiral or paramPoly3")
    kind = _SHAPES.get(shape.tag)
    if kind is None:
        raise BadElement(element, f"has the unknown shape {shape.tag[:40]}")
    bound = _CURVATURE if kind in ("arc", "spiral") else FARTHEST_M
    numbers = tuple(number(shape, name, low=-bound, high=bound) for name in _NUMBERS[kind])
    span = text(shape, "pRange", "normalized") if kind == "paramPoly3" else "arcLength"
    if span not in ("arcLength", "normalized"):
        raise BadElement(shape, "is unknown", "pRange", "arcLength or normalized")
    return Geometry(s, x, y, heading, length, kind, numbers, span == "normalized")


def _marks(lane: Element, base_m: float) -> tuple[Mark, ...]:
    marks = [
        Mark(
            base_m + number(mark, "sOffset", 0.0, high=LONGEST_ROAD_M),
            text(mark, "type", "none"),
            mark.get("laneChange"),
        )
        for mark in lane.findall("roadMark")
    ]
    return tuple(sorted(marks, key=lambda mark: mark.s_m))


def _closed(lane: Element, base_m: float) -> tuple[tuple[float, bool], ...]:
    """List from where on a lane is closed to cars, or open again, by its ``access`` elements.

    Those at one place hold together, up to the next place. If any of them allows somebody, all
    others are kept out. Without a rule they deny, as the standard says.
    """
    rules: dict[float, dict[str, set[str]]] = {}
    for element in lane.findall("access"):
        s = base_m + number(element, "sOffset", 0.0, high=LONGEST_ROAD_M)
        word = element.get("rule", "deny")
        if word not in ("allow", "deny"):
            raise BadElement(element, "is unknown", "rule", "allow or deny")
        who = {child.get("type", "") for child in element.findall("restriction")}
        who |= {element.get("restriction", "")}
        whom = {name.strip().lower() for name in who} - {""}
        rules.setdefault(s, {"allow": set(), "deny": set()})[word].update(whom)
    return tuple(
        (s, bool(rule["allow"] and not rule["allow"] & _CARS) or "passengercar" in rule["deny"])
        for s, rule in sorted(rules.items())
    )


def _travel(lane: Element) -> str:
    """Return vendor data about a lane's direction of travel, empty without any."""
    for data in lane.findall("userData"):
        if data.get("code") == "travelDir":
            return data.get("value", "")
        for child in data.iter():
            if child.get("travelDir") is not None:
                return text(child, "travelDir")
    return ""


def _lane(element: Element, base_m: float) -> LaneRecord:
    cubics = {}
    for tag in ("width", "border"):
        pieces = [_cubic(child, base_m, "sOffset") for child in element.findall(tag)]
        cubics[tag] = tuple(sorted(pieces, key=lambda cubic: cubic.s_m))
    speeds = [
        (base_m + number(child, "sOffset", 0.0, high=LONGEST_ROAD_M), _speed(child))
        for child in element.findall("speed")
    ]
    return LaneRecord(
        id=whole(element, "id"),
        type=text(element, "type", "none"),
        widths=cubics["width"],
        borders=cubics["border"],
        marks=_marks(element, base_m),
        speeds=tuple(sorted(speeds, key=lambda speed: speed[0])),
        closed=_closed(element, base_m),
        direction=_word(element, "direction", _DIRECTIONS),
        travel=_travel(element),
    )


def _section(element: Element, start_m: float, end_m: float, before: Section | None) -> Section:
    """Read a lane section; one of a single side takes the other side from the one before it."""
    lanes = []
    centre: tuple[Mark, ...] = ()
    for side in ("left", "center", "right"):
        for group in element.findall(side):
            for child in group.findall("lane"):
                if whole(child, "id") == 0:
                    centre = _marks(child, start_m)
                    continue
                lane = _lane(child, start_m)
                if (lane.id > 0) != (side == "left") or side == "center":
                    raise BadElement(child, f"stands on the {side}", "id")
                lanes.append(lane)
    if before is not None and element.get("singleSide") in ("true", "1"):
        own_sides = {lane.id > 0 for lane in lanes}
        lanes += [lane for lane in before.lanes if (lane.id > 0) not in own_sides]
        centre = centre or before.centre_marks
    lanes.sort(key=lambda lane: -lane.id)
    ids = [lane.id for lane in lanes]
    if len(ids) > _MOST_LANES:
        raise BadElement(element, f"has {len(ids)} lanes", None, f"at most {_MOST_LANES}")
    if len(set(ids)) < len(ids):
        raise BadElement(element, "has two lanes with the same id")
    # Lane 0 lies between 1 and -1; a number left out would leave the borders unknown.
    left, right = [i for i in ids if i > 0], [-i for i in ids if i < 0]
    for side_ids in (left[::-1], right):
        if side_ids != list(range(1, len(side_ids) + 1)):
            raise BadElement(element, "leaves a lane id out", None, "number lanes from the middle")
    return Section(start_m, end_m, tuple(lanes), centre)


def _sections(lanes: Element, length_m: float) -> tuple[Section, ...]:
    elements = lanes.findall("laneSection")
    starts = [(e, number(e, "s", low=0.0, high=LONGEST_ROAD_M)) for e in elements]
    _rising(starts)
    if not elements:
        return ()
    ends = [s for _, s in starts[1:]] + [length_m]
    sections: list[Section] = []
    for (element, start), end in zip(starts, ends, strict=True):
        before = sections[-1] if sections else None
        sections.append(_section(element, start, min(end, length_m), before))
    return tuple(sections)


def _links(road: Element) -> dict[End, Link]:
    links: dict[End, Link] = {}
    link = road.find("link")
    ends: tuple[tuple[str, End], ...] = (("predecessor", "start"), ("successor", "end"))
    for tag, end in ends:
        child = link.find(tag) if link is not None else None
        if child is None:
            continue
        kind = text(child, "elementType", "road")
        if kind == "road":
            links[end] = Link("road", text(child, "elementId"), _end(child))
        elif kind == "junction":
            links[end] = Link("junction", text(child, "elementId"), None)
        else:
            raise BadElement(child, "is unknown", "elementType", "road or junction")
    return links


def read_road(road: Element) -> RoadRecord:
    """Read a road from its element.

    Raises:
        BadElement: something in it is missing, or no number where one belongs.
    """
    length = number(road, "length", low=0.0, high=LONGEST_ROAD_M)
    plan = road.find("planView")
    geometry = [] if plan is None else plan.findall("geometry")
    if not geometry:
        raise BadElement(road, "has no geometry in a planView")
    lanes = road.find("lanes")
    if lanes is None:
        raise BadElement(road, "has no lanes")
    _rising([(e, number(e, "s", low=0.0, high=LONGEST_ROAD_M)) for e in geometry])
    types = []
    for element in road.findall("type"):
        speeds = [_speed(child) for child in element.findall("speed")]
        s = number(element, "s", 0.0, high=LONGEST_ROAD_M)
        types.append((s, text(element, "type", "unknown"), speeds[0] if speeds else None))
    left_hand = _word(road, "rule", _RULES) == "lht"
    scenery, not_drawn = read_scenery(road, left_hand=left_hand)
    shifts = lanes.findall("laneOffset")
    _rising([(e, number(e, "s", low=0.0, high=LONGEST_ROAD_M)) for e in shifts])
    junction = road.get("junction", "-1")
    return RoadRecord(
        id=text(road, "id"),
        junction=None if junction == "-1" else junction,
        length_m=length,
        left_hand=left_hand,
        links=_links(road),
        types=tuple(sorted(types, key=lambda entry: entry[0])),
        geometry=tuple(_geometry(element) for element in geometry),
        offsets=tuple(_cubic(element, 0.0, "s") for element in shifts),
        sections=_sections(lanes, length),
        crosswalks=tuple(read_crosswalks(road)),
        scenery=scenery,
        not_drawn=not_drawn,
        fault=_unit_fault(road) or _word_fault(road),
    )


def read_junction(junction: Element) -> list[Connection]:
    """Read the connections of a junction.

    Raises:
        BadElement: one names no roads.
    """
    connections = []
    for element in junction.findall("connection"):
        to = element.get("connectingRoad") or element.get("linkedRoad")
        incoming = element.get("incomingRoad")
        if to is None or incoming is None:
            if element.get("type") == "virtual":
                continue
            raise BadElement(element, "has no attribute 'incomingRoad' or no 'connectingRoad'")
        connections.append(Connection(text(junction, "id"), incoming, to, _end(element) or "start"))
    return connections
