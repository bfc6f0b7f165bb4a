"""The scenery beside an OpenDRIVE road: its objects and signals.

Read: buildings, trees, poles and street lamps, with their outlines' extents and their repetitions;
static signs, by the numbers of the German catalogue, of which others are plain plates. Heights of
the ground are not modelled: everything stands on it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from pydantic import ValidationError

from ssp_core.run_file.road import Building, Pole, SceneryItem, Sign, Tree
from ssp_scenario_manager.maps.xml_input import BadElement, number

MOST_OF_ROAD = 5000
_LONGEST_M = 1e6
_ANGLE = 1e4
_OWN = frozenset({"", "none", "-1"})  # types of things that say nothing
# Countries whose numbers are those of the German catalogue; many maps name none.
_GERMAN = frozenset({"de", "deu", "germany", "opendrive", *_OWN})
_SIGNS = {"205": "yield", "206": "stop", "350": "crossing"}
_LIMIT = "274"
# Lines on the ground, and lights.
_NO_PLATES = re.compile(r"29[3-9](\.\d+)?|10000\d\d")
# Maps of towns that call them so have them as objects without a type.
_NAMED_LIMIT = re.compile(r"speed_(\d{1,3})(?:_.*)?", re.IGNORECASE)
# What a sign shows of a speed in a unit; of m/s it shows km/h.
_PRINTED = {"km/h": 1.0, "mph": 1.0, "m/s": 3.6}
Place = tuple[float, float]


class _Unusable(Exception):
    """It is well-formed, and can't be drawn."""


def read_scenery(road: Element, *, left_hand: bool) -> tuple[tuple[SceneryItem, ...], int]:
    """Read a road's scenery, along its reference line, and count what can't be drawn.

    Raises:
        BadElement: something in it is no number where one belongs, or there is too much of it.
    """
    items: list[SceneryItem] = []
    unusable = 0
    for element in (*road.findall("objects/object"), *road.findall("signals/signal")):
        try:
            if element.tag == "object":
                items += _objects(element)
            else:
                items += _signal(element, left_hand=left_hand)
        except (_Unusable, ValidationError):
            unusable += 1
        if len(items) > MOST_OF_ROAD:
            raise _too_many(element)
    return tuple(items), unusable


def _too_many(element: Element) -> BadElement:
    most = f"at most {MOST_OF_ROAD} of a road can be read"
    return BadElement(element, "is one thing too many beside this road", None, most)


def _length(element: Element, attribute: str) -> float:
    """Return a length, 0 where there is none."""
    return number(element, attribute, 0.0, low=-_LONGEST_M, high=_LONGEST_M)


# -- objects -------------------------------------------------------------------------------------


def _objects(element: Element) -> list[SceneryItem]:
    word, name = element.get("type", "").lower(), element.get("name", "")
    heading = number(element, "hdg", 0.0, low=-_ANGLE, high=_ANGLE)
    limit = _NAMED_LIMIT.fullmatch(name)
    if word in _OWN and limit is not None:
        direction = "forward" if math.cos(heading) >= 0.0 else "backward"
        s, t = _own_place(element)
        printed = _printed(float(limit[1]))
        return [
            Sign(type="sign", s_m=s, l_m=t, kind="speed_limit", value=printed, direction=direction)
        ]
    height = _length(element, "height")
    if height > 0.0:
        height += _length(element, "zOffset")
    if word == "building":
        return _buildings(element, heading, height)
    if word == "tree":
        return [
            Tree.model_validate({"type": "tree", "s_m": s, "l_m": t, **_height(height)})
            for s, t in _places(element)
        ]
    if word in ("pole", "streetlamp"):
        words = f"{word} {name} {element.get('subtype', '')}".lower()
        lamp = "lamp" in words or "streetlight" in words
        return [
            Pole.model_validate(
                {"type": "pole", "s_m": s, "l_m": t, "lamp": lamp, **_height(height)}
            )
            for s, t in _places(element)
        ]
    return []


def _height(height_m: float) -> dict[str, float]:
    """Return the height's key, none for zero, as many maps leave it: then it is the usual one."""
    return {"height_m": height_m} if height_m > 0.0 else {}


def _buildings(element: Element, heading_rad: float, height_m: float) -> list[SceneryItem]:
    length, width = _length(element, "length"), _length(element, "width")
    radius = _length(element, "radius")
    if length <= 0.0 and width <= 0.0 and radius > 0.0:
        length = width = 2.0 * radius
    places = list(_places(element))
    if length <= 0.0 or width <= 0.0:
        places, heading_rad, (length, width), tall = _outlined(element, places, heading_rad)
        height_m = height_m if height_m > 0.0 else tall
    return [
        Building(
            type="building",
            s_m=s,
            l_m=t,
            yaw_rad=math.remainder(heading_rad, 2 * math.pi),
            length_m=length,
            width_m=width,
            height_m=height_m,
        )
        for s, t in places
    ]


def _outlined(
    element: Element, places: list[Place], heading_rad: float
) -> tuple[list[Place], float, Place, float]:
    """Return middles, heading, extents and height of a building that is drawn by its corners."""
    local = [
        (_length(c, "u"), _length(c, "v"), _length(c, "height"))
        for c in element.iter("cornerLocal")
    ]
    on_road = [
        (number(c, "s"), _length(c, "t"), _length(c, "height")) for c in element.iter("cornerRoad")
    ]
    corners = local or on_road
    if not corners:
        raise _Unusable
    low = [min(values) for values in zip(*corners, strict=True)]
    high = [max(values) for values in zip(*corners, strict=True)]
    middle = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
    extents = high[0] - low[0], high[1] - low[1]
    if not local:
        return [middle], 0.0, extents, high[2]
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    ahead, left = c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]
    return [(a + ahead, b + left) for a, b in places], heading_rad, extents, high[2]


def _own_place(element: Element) -> Place:
    return number(element, "s", 0.0), number(element, "t", 0.0)


def _places(element: Element) -> Iterator[Place]:
    """List the places of an object: its own, or instead of it those of its repetitions."""
    own = _own_place(element)
    repeats = element.findall("repeat")
    if not repeats:
        yield own
        return
    place_count = 0.0
    for repeat in repeats:
        length = number(repeat, "length", low=0.0, high=_LONGEST_M)
        distance = number(repeat, "distance", low=0.0, high=_LONGEST_M)
        if distance <= 0.0:
            raise _Unusable  # it goes on without a gap, as a wall
        place_count += length / distance + 1.0
        if place_count > MOST_OF_ROAD:
            raise _too_many(repeat)
        s = number(repeat, "s", own[0])
        first = number(repeat, "tStart", own[1])
        last = number(repeat, "tEnd", first)
        for k in range(int(length / distance) + 1):
            share = k * distance / length if length > 0.0 else 0.0
            yield s + k * distance, first + share * (last - first)


# -- signals -------------------------------------------------------------------------------------


def _signal(element: Element, *, left_hand: bool) -> list[SceneryItem]:
    word = element.get("type", "").strip()
    if (
        element.get("dynamic") == "yes"
        or word.lower() in _OWN
        or _NO_PLATES.fullmatch(word) is not None
    ):
        return []
    s, t = _own_place(element)
    kind, value = "other", None
    if element.get("country", "").strip().lower() in _GERMAN:
        kind = _SIGNS.get(word, "other")
        if word == _LIMIT:
            value = _limit(element)
            kind = "speed_limit" if value is not None else "other"
    return [
        Sign.model_validate(
            {
                "type": "sign",
                "s_m": s,
                "l_m": t,
                "kind": kind,
                "value": value,
                "direction": "forward" if _faces_along(element, t, left_hand) else "backward",
            }
        )
    ]


def _faces_along(element: Element, t_m: float, left_hand: bool) -> bool:
    """Tell whether a sign is for traffic along the road: by its orientation, else by its side."""
    orientation = element.get("orientation", "none")
    if orientation not in ("+", "-"):
        return (t_m <= 0.0) != left_hand
    turn = number(element, "hOffset", 0.0, low=-_ANGLE, high=_ANGLE)
    return (orientation == "+") == (math.cos(turn) >= 0.0)


def _limit(element: Element) -> int | None:
    """Return the number on a speed limit: its value, or else what its subtype stands for."""
    value = element.get("value")
    if value is not None:
        speed = number(element, "value", low=-_LONGEST_M, high=_LONGEST_M)
        if speed > 0.0:
            unit = element.get("unit", "km/h")
            if unit not in _PRINTED:
                raise _Unusable  # nobody knows what it shows
            return _printed(speed * _PRINTED[unit])
    subtype = element.get("subtype", "")
    if not re.fullmatch(r"\d{1,3}", subtype):
        return None
    code = int(subtype)
    # 274-50 says 50 km/h today, and 274-55 did formerly.
    if code % 10 == 0 and code > 0:
        return code
    return 10 * (code - 50) if 51 <= code <= 63 else None


def _printed(speed: float) -> int:
    if not 0.5 <= speed < 999.5:
        raise _Unusable
    return round(speed)
