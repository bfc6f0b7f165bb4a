"""The map file beside a scenario: its lanes, and the height of the ground on it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from xml.etree.ElementTree import Element

import defusedxml.ElementTree as safe_xml
import numpy as np

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray, Pose2
from ssp_core.run_file.participants import LaneChange
from ssp_core.run_file.road import CurvePiece
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.opendrive_road import Geometry, RoadRecord, read_road
from ssp_scenario_manager.maps.xml_input import BadElement, number

# Reference lines are sampled this densely; a place this far from all of them has no height.
_SAMPLE_M = 2.0
_FARTHEST_M = 40.0
_COEFFICIENT = 1e6

_Profile = list[tuple[float, float, float, float, float]]


class Heights:
    """Heights over a map's roads; all 0 where the map is flat.

    Args:
        xodr: text of an OpenDRIVE map; None: flat.

    Raises:
        InputError: it isn't XML, or a road in it can't be read.
    """

    def __init__(self, xodr: str | None) -> None:
        self._profiles: list[_Profile] = []
        self._samples: FloatArray = np.empty((0, 4))
        if xodr is None:
            return
        try:
            root = safe_xml.fromstring(xodr.encode())
        except (ValueError, safe_xml.ParseError) as error:
            raise InputError(f"is not valid XML: {error}") from error
        try:
            self._profiles = [_profile(road) for road in root.iter("road")]
            if self.is_flat:
                return
            rows = [
                (x, y, index, s)
                for index, road in enumerate(root.iter("road"))
                for s, x, y in _line(read_road(road))
            ]
        except BadElement as error:
            raise InputError(f"its <{error.element.tag}> {error.problem}") from error
        self._samples = np.array(rows)

    @property
    def is_flat(self) -> bool:
        """No road rises or lies above or below 0."""
        return not any(any(record[1:]) for profile in self._profiles for record in profile)

    def at(self, place: Point) -> float:
        """Height of the ground, m.

        Raises:
            InputError: the place is far from all roads of a map that isn't flat.
        """
        if not len(self._samples):
            return 0.0
        apart = np.hypot(self._samples[:, 0] - place[0], self._samples[:, 1] - place[1])
        nearest = int(np.argmin(apart))
        if apart[nearest] > _FARTHEST_M:
            raise InputError(
                f"is {apart[nearest]:.0f} m from the nearest road, so that its height is unknown",
                value=place,
            )
        _, _, index, s = self._samples[nearest]
        return _height(self._profiles[int(index)], float(s))


def _profile(road: Element) -> _Profile:
    found = [
        (
            number(e, "s", 0.0),
            *(number(e, k, 0.0, low=-_COEFFICIENT, high=_COEFFICIENT) for k in "abcd"),
        )
        for e in road.iterfind("elevationProfile/elevation")
    ]
    return sorted((s, a, b, c, d) for s, a, b, c, d in found)


def _height(profile: _Profile, s_m: float) -> float:
    index = bisect_right(profile, s_m, key=lambda record: record[0]) - 1
    if index < 0:
        return 0.0
    s, a, b, c, d = profile[index]
    u = s_m - s
    return a + u * (b + u * (c + u * d))


def _line(road: RoadRecord) -> list[tuple[float, float, float]]:
    """(s, x, y) along a road."""
    rows: list[tuple[float, float, float]] = []
    for geometry in road.geometry:
        if geometry.length_m <= 0.0:
            continue
        count = max(1, math.ceil(geometry.length_m / _SAMPLE_M))
        stations = [i * geometry.length_m / count for i in range(count + 1)]
        rows += [
            (geometry.s_m + u, x, y)
            for u, (x, y) in zip(stations, _places(geometry, stations), strict=True)
        ]
    return rows


def _places(geometry: Geometry, stations: Sequence[float]) -> list[Point]:
    """Places at distances from a geometry's start; near ones for cubics."""
    ends = (0.0, 0.0)
    if geometry.kind == "arc":
        ends = (geometry.numbers[0], geometry.numbers[0])
    elif geometry.kind == "spiral":
        ends = (geometry.numbers[0], geometry.numbers[1])
    elif geometry.kind in ("poly3", "paramPoly3"):
        return [_on_cubic(geometry, u) for u in stations]
    start = Pose2(geometry.x_m, geometry.y_m, geometry.heading_rad)
    line = ReferenceLine(
        start,
        [
            CurvePiece(
                length_m=geometry.length_m,
                start_curvature_1pm=ends[0],
                end_curvature_1pm=ends[1],
            )
        ],
    )
    return [(pose.x_m, pose.y_m) for pose in map(line.pose, stations)]


def _on_cubic(geometry: Geometry, station_m: float) -> Point:
    """A place on a cubic, its parameter taken for the share of its length."""

    def value(numbers: Sequence[float], p: float) -> float:
        a, b, c, d = numbers
        return a + p * (b + p * (c + p * d))

    start = Pose2(geometry.x_m, geometry.y_m, geometry.heading_rad)
    if geometry.kind == "poly3":
        return start.to_parent(station_m, value(geometry.numbers, station_m))
    p = station_m / geometry.length_m if geometry.normalised else station_m
    return start.to_parent(value(geometry.numbers[:4], p), value(geometry.numbers[4:], p))


# A lane change ends within this of a lane's centre, or it isn't one.
_LANE_CENTRE_M = 0.5


@dataclass(frozen=True, slots=True)
class MapFile:
    """The OpenDRIVE map of an export.

    Args:
        own: made from the block; else the user's map as it is.
    """

    name: str
    data: bytes
    own: bool
    heights: Heights


def provenance(task: Task) -> dict[str, str]:
    """What every file of an export says about where it comes from (METHOD 2.5)."""
    return {
        "event": task.event.name,
        "event_version": task.event.version,
        "task_version": task.version,
        "compiler": task.compiler,
        "seed": str(task.seed),
    }


def map_file(task: Task, block: Block, map_text: str | None) -> MapFile:
    """The user's OpenDRIVE map, or one of the block where it was placed on a site or a SUMO net.

    Raises:
        InputError: the block can't be put into OpenDRIVE, or the map's text is missing.
    """
    if task.place.kind == "opendrive":
        if map_text is None:
            raise InputError("needs the map that it was compiled for", field="place.name")
        name = PurePath(task.place.name).name
        return MapFile(name, map_text.encode(), own=False, heights=Heights(map_text))
    name = PurePath(task.place.name).name.split(".")[0]
    data = opendrive_map([block], name, provenance(task))
    return MapFile(f"{name}.xodr", data, own=True, heights=Heights(None))


def lanes_crossed(block: Block, from_l_m: float, change: LaneChange) -> tuple[int, float]:
    """How many lanes to the left a lane change goes, and where beside that lane's centre it ends.

    Args:
        from_l_m: offset before it, + left of the reference line.

    Returns:
        Lanes, < 0 to the right, and the offset from the target lane's centre in m, + left.

    Raises:
        InputError: it ends in no lane of its direction, or in the one that it started from.
    """
    lanes = block.forward_lanes
    goal = from_l_m + change.lateral_shift_m

    def nearest(offset_m: float) -> int:
        return min(range(len(lanes)), key=lambda i: abs(lanes[i].y_m - offset_m))

    start, end = nearest(from_l_m), nearest(goal)
    beside = goal - lanes[end].y_m
    if start == end or abs(beside) > _LANE_CENTRE_M:
        raise InputError(
            "doesn't end in another lane of its direction",
            field="run.triggers[0].manoeuvre.lateral_shift_m",
            value=change.lateral_shift_m,
        )
    return end - start, beside
