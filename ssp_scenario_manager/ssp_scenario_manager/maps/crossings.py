"""Marked crossings of roads: where a zebra lies, and which lanes of the road it covers."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.xml_input import number

# Half of a zebra along the road, where nothing says how long it is.
ZEBRA_HALF_M = 2.0
# A marked crossing is used by people this far to either side of its centre.
CROSSING_HALF_M = 4.0
# Outlines of one crossing that lie this far apart, on both sides of a refuge, belong together.
_REFUGE_M = 1.0
_FARTHEST_M = 1e6


@dataclass(frozen=True, slots=True)
class Crossing:
    """A zebra on a road.

    Args:
        s_m: arc length of its middle.
        half_m: half of its length along the road.
        whole: it leads over all driving lanes; else it is a marking, and no crossing of the road.
        right_m: offset of its right border, where it isn't whole.
        left_m: offset of its left border, likewise.
    """

    s_m: float
    half_m: float = ZEBRA_HALF_M
    whole: bool = True
    right_m: float = -math.inf
    left_m: float = math.inf

    @property
    def reach_m(self) -> float:
        """Distance from its middle within which people use it."""
        return max(CROSSING_HALF_M, self.half_m + CROSSING_HALF_M - ZEBRA_HALF_M)

    def at(self, s_m: float) -> Crossing:
        """Return the same zebra with its middle elsewhere."""
        return replace(self, s_m=s_m)

    def reversed(self, length_m: float) -> Crossing:
        """Return the same zebra along a road of that length in the other direction."""
        return replace(self, s_m=length_m - self.s_m, right_m=-self.left_m, left_m=-self.right_m)


@dataclass(frozen=True, slots=True)
class Crosswalk:
    """A crosswalk object of OpenDRIVE.

    Args:
        s_m: its place along the road, as the heading and t_m that of its own frame.
        corners: of its outline or its extents, m; in its own frame, or along and beside the road.
        local: they are in its own frame.
        anywhere: nothing says how wide it is, so that it leads over the whole road.
    """

    s_m: float
    t_m: float
    heading_rad: float
    corners: tuple[tuple[float, float], ...]
    local: bool
    anywhere: bool

    def extent(self, line: ReferenceLine) -> tuple[float, float, float, float]:
        """Return its begin and end along a road's line, and its right and left border, m."""
        places = np.array(self.corners)
        if self.local:
            # Its middle by the line, and the rest of it in the line's direction there.
            turned = places @ _turn(self.heading_rad)
            middle = (turned.min(axis=0) + turned.max(axis=0)) / 2.0
            at = line.pose(min(self.s_m, line.length_m))
            foot = np.array([self.s_m, self.t_m]) + middle
            projection = line.to_local_many(
                np.array([at.to_parent(middle[0], self.t_m + middle[1])])
            )[0]
            if not np.isnan(projection).any():
                foot = projection
            there = line.pose(min(max(float(foot[0]), 0.0), line.length_m))
            places = (turned - middle) @ _turn(at.yaw_rad - there.yaw_rad) + foot
        (low, right), (high, left) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        if self.anywhere:
            right, left = -math.inf, math.inf
        return low, high, right, left


def _turn(angle_rad: float) -> FloatArray:
    """Make the matrix that turns rows of coordinates to the left."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, s], [-s, c]])


def read_crosswalks(road: Element) -> Iterator[Crosswalk]:
    """Yield the crosswalks among a road's objects.

    Raises:
        BadElement: something in one is no number where one belongs.
    """
    for element in road.findall("objects/object"):
        if "crosswalk" in (element.get("type", "") + element.get("name", "")).lower():
            yield _crosswalk(element)


def _crosswalk(element: Element) -> Crosswalk:
    s = number(element, "s", 0.0, low=0.0, high=_FARTHEST_M)
    t = number(element, "t", 0.0, low=-_FARTHEST_M, high=_FARTHEST_M)
    heading = number(element, "hdg", 0.0, low=-1e4, high=1e4)
    for tag, ahead, left in (("cornerLocal", "u", "v"), ("cornerRoad", "s", "t")):
        corners = tuple(
            (_length(corner, ahead), _length(corner, left)) for corner in element.iter(tag)
        )
        if len(corners) > 1:
            return Crosswalk(s, t, heading, corners, tag == "cornerLocal", anywhere=False)
    length, width = _length(element, "length"), _length(element, "width")
    anywhere = length <= 0.0 or width <= 0.0
    if anywhere:
        length, width = 2.0 * ZEBRA_HALF_M, 0.0
        heading = 0.0
    u, v = length / 2.0, width / 2.0
    box = ((-u, -v), (u, -v), (u, v), (-u, v))
    return Crosswalk(s, t, heading, box, local=True, anywhere=anywhere)


def _length(element: Element, attribute: str) -> float:
    return number(element, attribute, 0.0, low=-_FARTHEST_M, high=_FARTHEST_M)


@dataclass(frozen=True, slots=True)
class Zebra:
    """The outlines of a road's crosswalks that lie beside one another.

    Args:
        s_m: arc length of their middle.
        half_m: half of their length along the road.
        borders_m: right and left border of each.
    """

    s_m: float
    half_m: float
    borders_m: tuple[tuple[float, float], ...]


def zebras_of(crosswalks: Sequence[Crosswalk], line: ReferenceLine) -> list[Zebra]:
    """Return a road's zebras, in order along its line."""
    groups: list[list[tuple[float, float, float, float]]] = []
    ends: list[float] = []
    for extent in sorted(crosswalk.extent(line) for crosswalk in crosswalks):
        if groups and extent[0] <= ends[-1] + _REFUGE_M:
            groups[-1].append(extent)
            ends[-1] = max(ends[-1], extent[1])
        else:
            groups.append([extent])
            ends.append(extent[1])
    return [
        Zebra(
            round((group[0][0] + end) / 2.0, 6),
            round((end - group[0][0]) / 2.0, 6),
            tuple((right, left) for _, _, right, left in group),
        )
        for group, end in zip(groups, ends, strict=True)
    ]


def crossings_between(
    zebras: Sequence[Zebra], low_m: float, high_m: float, lanes_m: Collection[float]
) -> Iterator[Crossing]:
    """Yield the zebras on the driving lanes of a part of a road, in order along the road.

    A zebra leads over the whole road if the middle of each driving lane lies under one of its
    outlines; where it lies under none, as on a sidewalk, there is no zebra on the road.

    Args:
        zebras: of the road, in order.
        low_m: where the part begins, along the road.
        high_m: where it ends.
        lanes_m: offsets of the middles of the driving lanes, m.
    """
    first = bisect_left(zebras, low_m, key=_middle)
    for zebra in zebras[first : bisect_right(zebras, high_m, key=_middle)]:
        covered = [any(right <= y <= left for right, left in zebra.borders_m) for y in lanes_m]
        if all(covered):
            yield Crossing(zebra.s_m, zebra.half_m)
        elif any(covered):
            right = min(right for right, _ in zebra.borders_m)
            left = max(left for _, left in zebra.borders_m)
            yield Crossing(zebra.s_m, zebra.half_m, False, round(right, 6), round(left, 6))


def _middle(zebra: Zebra) -> float:
    return zebra.s_m
