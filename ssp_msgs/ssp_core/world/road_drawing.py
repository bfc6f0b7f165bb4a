"""The road from above: a run as lines and outlines, and the page on which they are drawn.

It is made of the run file alone.

The operators' page, RViz's markers and the task sheet show the same lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.encounter import corridor_half_m, swept_on_way
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    Condition,
    FollowPath,
    InRegion,
    ParticipantSpec,
    TimeToArrival,
)
from ssp_core.run_file.road import JunctionRoad, Lane, Road
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import Role
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine

_PAGE_PX, _MARGIN_PX = 1100.0, 24.0
_BEYOND_M = 12.0
LineKind = Literal["edge", "divider", "centre", "reference"]
_ZEBRA_M = 3.0  # along the road, as SIL's own crossings are
_STEP_M = 0.25
# A chord of a drawn bend leaves it by at most so much, which no map shows.
_DRAWN_ERROR_M = 0.05
_LEAST_STEP_M = 1e-6


@dataclass(frozen=True, slots=True)
class RoadLine:
    """One line of the road.

    Args:
        kind: ``edge`` of the carriageway, ``divider`` between two lanes, ``centre`` of a lane (its
            points run in its direction of traffic), ``reference``: what s and l are counted from.
        points: frame map, m; at least two.
        opposed: a divider between lanes of opposite directions.
    """

    kind: LineKind
    points: tuple[Point, ...]
    opposed: bool = False


@dataclass(frozen=True, slots=True)
class Route:
    """A path that an object is to take.

    Args:
        purpose: ``approach`` before the trigger, ``manoeuvre`` after it.
        points: of its reference point, frame map, m; at least two.
    """

    object_id: str
    role: Role
    purpose: Literal["approach", "manoeuvre"]
    points: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class StartRegion:
    """The region in which an object must stand to be armed: a circle, and the heading."""

    object_id: str
    role: Role
    centre: Point
    yaw_rad: float
    radius_m: float


@dataclass(frozen=True, slots=True)
class Anchor:
    """A place that a trigger or the adaptation counts from; ``name`` says whose."""

    name: str
    at: Point


@dataclass(frozen=True, slots=True)
class Area:
    """An outline, not closed: its last point isn't its first."""

    name: str
    outline: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class Drawing:
    """Everything of a run that stands still; frame map, m.

    Args:
        fence: outline of the geofence, not closed.
        road_lines: see RoadLine. A line whose offset has no place of its own, beyond the centre of
            a tight bend, is left out.
        crossings: outlines of the zebra crossings, along the road.
        routes: of the VUT and the targets, in the run file's order.
        conflict_zones: parts of the VUT's corridor that manoeuvres on paths of their own will
            sweep across (METHOD 1). A lane change or a braking begins where the trigger fires, so
            that it has none beforehand.
        anchors: of adaptations and of conditions on time to arrival.
    """

    fence: tuple[Point, ...]
    road_lines: tuple[RoadLine, ...]
    crossings: tuple[tuple[Point, ...], ...]
    routes: tuple[Route, ...]
    starts: tuple[StartRegion, ...]
    conflict_zones: tuple[Area, ...]
    anchors: tuple[Anchor, ...]
    regions: tuple[Area, ...]

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Least x, least y, most x, most y of the fence: what a map should show at first."""
        xs, ys = zip(*self.fence, strict=True)
        return min(xs), min(ys), max(xs), max(ys)


def drawing_of(run: RunSpec) -> Drawing:
    """Return the drawing of a run."""
    return Drawing(
        fence=tuple(run.geofence),
        road_lines=tuple(_road_lines(run.road)),
        crossings=tuple(_crossings(run.road)),
        routes=tuple(_routes(run)),
        starts=tuple(
            StartRegion(
                one.id,
                role,
                (one.start.x_m, one.start.y_m),
                one.start.yaw_rad,
                run.limits.start_region_m,
            )
            for one, role in _participants(run)
        ),
        conflict_zones=tuple(_conflict_zones(run)),
        anchors=tuple(_anchors(run)),
        regions=tuple(_regions(run)),
    )


def _participants(run: RunSpec) -> Iterator[tuple[ParticipantSpec, Role]]:
    yield run.vut, Role.VUT
    for target in run.targets:
        yield target, Role.OT


def _beside(line: ReferenceLine, length_m: float, l_m: float) -> tuple[Point, ...] | None:
    try:
        return tuple(line.path(0.0, length_m, l_m, _DRAWN_ERROR_M))
    except NotOneToOne:
        return None


def _road_lines(road: Road) -> Iterator[RoadLine]:
    line = ReferenceLine.of_road(road)
    for l_m in (road.left_edge_m, road.right_edge_m):
        if edge := _beside(line, road.length_m, l_m):
            yield RoadLine("edge", edge)
    for l_m, opposed in _dividers(road.lanes):
        if divider := _beside(line, road.length_m, l_m):
            yield RoadLine("divider", divider, opposed)
    for lane in road.lanes:
        if centre := _beside(line, road.length_m, lane.y_m):
            yield RoadLine("centre", centre if lane.direction == "forward" else centre[::-1])
    if reference := _beside(line, road.length_m, 0.0):
        yield RoadLine("reference", reference)
    for one in road.junction:
        yield from _junction_lines(one)


def _junction_lines(road: JunctionRoad) -> Iterator[RoadLine]:
    """Yield the edges of an arm, and the lanes of an arm or a connecting road."""
    line = ReferenceLine.of_road(road)
    for l_m in (road.left_edge_m, road.right_edge_m) if road.junction_at != "both" else ():
        if edge := _beside(line, road.length_m, l_m):
            yield RoadLine("edge", edge)
    for lane in road.lanes:
        if centre := _beside(line, road.length_m, lane.y_m):
            yield RoadLine("centre", centre if lane.direction == "forward" else centre[::-1])


def _dividers(lanes: Sequence[Lane]) -> list[tuple[float, bool]]:
    """Return each border between neighbours: lateral position, and whether they are opposed."""
    ordered = sorted(lanes, key=lambda lane: lane.y_m)
    return [
        (
            (right.y_m + right.width_m / 2 + left.y_m - left.width_m / 2) / 2,
            right.direction != left.direction,
        )
        for right, left in pairwise(ordered)
    ]


def _crossings(road: Road) -> Iterator[tuple[Point, ...]]:
    line = ReferenceLine.of_road(road)
    for middle, right_m, left_m in road.zebras_m:
        near, far = middle - _ZEBRA_M / 2, middle + _ZEBRA_M / 2
        with suppress(NotOneToOne):
            left = line.path(near, far, min(left_m, road.left_edge_m), _DRAWN_ERROR_M)
            right = line.path(far, near, max(right_m, road.right_edge_m), _DRAWN_ERROR_M)
            yield (*left, *right)


def _routes(run: RunSpec) -> Iterator[Route]:
    for one, role in _participants(run):
        if one.approach is not None:
            yield Route(one.id, role, "approach", tuple(one.approach.path))
        for trigger in run.triggers:
            if trigger.object_id == one.id and isinstance(trigger.manoeuvre, FollowPath):
                path = tuple(trigger.manoeuvre.motion.path)
                yield Route(one.id, role, "manoeuvre", path)


def _conflict_zones(run: RunSpec) -> Iterator[Area]:
    if run.vut.approach is None:
        return
    vut_path = Polyline(run.vut.approach.path)
    half_m = corridor_half_m(run.vut.size.width_m)
    targets = {target.id: target for target in run.targets}
    for trigger in run.triggers:
        target = targets.get(trigger.object_id)
        if target is None or not isinstance(trigger.manoeuvre, FollowPath):
            continue
        stations = _swept(Polyline(trigger.manoeuvre.motion.path), target, vut_path, half_m)
        if stations is not None:
            yield Area(trigger.object_id, _stretch(vut_path, *stations, half_m))


def _swept(
    route: Polyline, target: ParticipantSpec, vut_path: Polyline, half_m: float
) -> tuple[float, float] | None:
    """Return the stations of the VUT's path that the target's body covers while it crosses."""
    count = max(math.ceil(route.length_m / _STEP_M), 1)
    way = map(route.pose, np.linspace(0.0, route.length_m, count + 1).tolist())
    return swept_on_way(way, target.size, vut_path, half_m)


def _stretch(path: Polyline, from_m: float, to_m: float, half_m: float) -> tuple[Point, ...]:
    """Return the outline of a corridor along a path between two stations."""
    inner: FloatArray = path.stations_m[(path.stations_m > from_m) & (path.stations_m < to_m)]
    stations = [from_m, *inner.tolist(), max(to_m, from_m + _LEAST_STEP_M)]
    left = [path.pose(s, half_m) for s in stations]
    right = [path.pose(s, -half_m) for s in reversed(stations)]
    return tuple((pose.x_m, pose.y_m) for pose in (*left, *right))


def _leaves(condition: Condition) -> Iterator[Condition]:
    if isinstance(condition, AllOf | AnyOf):
        for part in condition.of:
            yield from _leaves(part)
    else:
        yield condition


def _anchors(run: RunSpec) -> Iterator[Anchor]:
    for trigger in run.triggers:
        if trigger.adaptation is not None and trigger.adaptation.anchor is not None:
            yield Anchor(f"{trigger.id}: conflict", trigger.adaptation.anchor)
        for leaf in _leaves(trigger.condition):
            if isinstance(leaf, TimeToArrival):
                yield Anchor(f"{trigger.id}: arrival", leaf.anchor)


def _regions(run: RunSpec) -> Iterator[Area]:
    for trigger in run.triggers:
        for leaf in _leaves(trigger.condition):
            if isinstance(leaf, InRegion):
                yield Area(f"{trigger.id}: {leaf.object_id}", tuple(leaf.polygon))


class RoadView:
    """Frame map turned so that a road lies along a page, scaled to fit.

    A straight is long and narrow: across, it is drawn up to three times as wide as it is.

    Args:
        road: that lies along the page.
        shown: places that must be on the page, frame map.
    """

    width_px = _PAGE_PX

    def __init__(self, road: Road, visible_points: Sequence[Point]) -> None:
        start, end = road.origin, ReferenceLine.of_road(road).pose(road.length_m)
        turn = math.atan2(end.y_m - start.y_m, end.x_m - start.x_m)
        self._turn = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        places = np.array(visible_points) @ self._turn
        low, high = places.min(axis=0) - _BEYOND_M, places.max(axis=0) + _BEYOND_M
        wide, tall = high - low
        scale = (_PAGE_PX - 2 * _MARGIN_PX) / wide
        stretch = min(3.0, max(1.0, 0.35 * wide / tall))
        self._corner = np.array([low[0], high[1]])
        self._scale = np.array([scale, -scale * stretch])
        self.height_px = float(tall * scale * stretch + 2 * _MARGIN_PX)

    def points(self, places: Sequence[Point]) -> list[Point]:
        """Move places of frame map to pixels from the upper left corner of the page."""
        points_px = (
            np.array(places).reshape(-1, 2) @ self._turn - self._corner
        ) * self._scale + _MARGIN_PX
        return [(float(x), float(y)) for x, y in points_px]

    def svg(self, places: Sequence[Point]) -> str:
        """Write the places as the points of an SVG polyline."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in self.points(places))
