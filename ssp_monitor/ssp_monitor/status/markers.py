"""Markers for RViz and Foxglove as plain values: of what stands still, and of what moves."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.encounter import encounter
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.road_drawing import Drawing
from ssp_monitor.status.board import STALE_S, Board, object_age_s

ORIGIN = Pose2(0.0, 0.0, 0.0)


class Shape(IntEnum):
    """Shapes by the numbers of visualization_msgs/Marker."""

    CUBE = 1
    CYLINDER = 3
    LINE_STRIP = 4
    TEXT = 9


@dataclass(frozen=True, slots=True)
class Colour:
    """Red, green, blue and opacity, 0 to 1."""

    red: float
    green: float
    blue: float
    alpha: float = 1.0


@dataclass(frozen=True, slots=True)
class Mark:
    """One mark in frame map.

    Args:
        space: with ``number`` it names the mark; a later one of that name replaces it.
        at: of the middle of a shape; points of a line are in frame map itself.
        z_m: height of that middle, and of a line, over the ground.
        size_m: x, y and z in the mark's own frame; a line's width is the first, a text's height
            the last.
    """

    space: str
    number: int
    shape: Shape
    colour: Colour
    at: Pose2 = ORIGIN
    z_m: float = 0.0
    size_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    points: tuple[Point, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True)
class RemovedMark:
    """The mark of this name is to disappear."""

    space: str
    number: int


def line(
    space: str,
    number: int,
    points: Sequence[Point],
    colour: Colour,
    width_m: float,
    z_m: float = 0.02,
    *,
    closed: bool = False,
) -> Mark:
    """A line through points, in their order; back to the first one where it is closed."""
    all_points = (*points, points[0]) if closed else tuple(points)
    return Mark(
        space,
        number,
        Shape.LINE_STRIP,
        colour,
        z_m=z_m,
        size_m=(width_m, 0.0, 0.0),
        points=all_points,
    )


def text(space: str, number: int, words: str, at: Point, z_m: float, colour: Colour) -> Mark:
    """A text that faces whoever looks."""
    place = Pose2(at[0], at[1], 0.0)
    return Mark(space, number, Shape.TEXT, colour, place, z_m, (0.0, 0.0, 0.9), text=words)


def circle(centre: Point, radius_m: float, corners: int = 32) -> tuple[Point, ...]:
    """A circle as an outline that isn't closed."""
    angles = [2.0 * math.pi * k / corners for k in range(corners)]
    return tuple(
        (centre[0] + radius_m * math.cos(a), centre[1] + radius_m * math.sin(a)) for a in angles
    )


FENCE = Colour(0.85, 0.15, 0.15)
EDGE = Colour(0.75, 0.75, 0.75)
DIVIDER = Colour(0.6, 0.6, 0.6, 0.7)
OPPOSED = Colour(0.9, 0.75, 0.2, 0.9)
CENTRE = Colour(0.5, 0.5, 0.5, 0.25)
REFERENCE = Colour(0.3, 0.6, 0.9, 0.4)
CROSSING = Colour(0.9, 0.9, 0.9, 0.8)
VUT_ROUTE = Colour(0.15, 0.45, 0.85, 0.8)
OT_ROUTE = Colour(0.9, 0.5, 0.1, 0.8)
CONFLICT = Colour(0.9, 0.1, 0.5, 0.9)
REGION = Colour(0.6, 0.3, 0.8, 0.7)
_LINES = {"edge": (EDGE, 0.15), "centre": (CENTRE, 0.08), "reference": (REFERENCE, 0.08)}


def standing_marks(drawing: Drawing) -> tuple[Mark, ...]:
    """The marks of a run's drawing."""
    return (
        line("fence", 0, drawing.fence, FENCE, 0.3, closed=True),
        *_road(drawing),
        *_objects(drawing),
        *_event(drawing),
    )


def _road(drawing: Drawing) -> Iterator[Mark]:
    for number, one in enumerate(drawing.road_lines):
        if one.kind == "divider":
            colour, width_m = (OPPOSED if one.opposed else DIVIDER), 0.12
        else:
            colour, width_m = _LINES[one.kind]
        yield line("road", number, one.points, colour, width_m, 0.01)
    if drawing.crossing is not None:
        yield line("crossing", 0, drawing.crossing, CROSSING, 0.2, closed=True)


def _objects(drawing: Drawing) -> Iterator[Mark]:
    for number, route in enumerate(drawing.routes):
        colour = VUT_ROUTE if route.role is Role.VUT else OT_ROUTE
        yield line("route", number, route.points, colour, 0.15, 0.03)
    for number, start in enumerate(drawing.starts):
        colour = VUT_ROUTE if start.role is Role.VUT else OT_ROUTE
        yield line(
            "start", number, circle(start.centre, start.radius_m), colour, 0.1, 0.03, closed=True
        )
        ahead = Pose2(*start.centre, start.yaw_rad).to_parent(start.radius_m, 0.0)
        yield line("start heading", number, (start.centre, ahead), colour, 0.1, 0.03)


def _event(drawing: Drawing) -> Iterator[Mark]:
    for number, zone in enumerate(drawing.conflict_zones):
        yield line("conflict zone", number, zone.outline, CONFLICT, 0.2, 0.04, closed=True)
    for number, region in enumerate(drawing.regions):
        yield line("region", number, region.outline, REGION, 0.15, 0.04, closed=True)
    for number, anchor in enumerate(drawing.anchors):
        at = Pose2(*anchor.at, 0.0)
        yield Mark("anchor", number, Shape.CYLINDER, CONFLICT, at, 0.5, (0.5, 0.5, 1.0))
        yield text("anchor name", number, anchor.name, anchor.at, 1.6, CONFLICT)


FORGOTTEN_S = 30.0
STALE = Colour(0.5, 0.5, 0.5, 0.6)
NAME = Colour(1.0, 1.0, 1.0)
GAP = Colour(0.9, 0.1, 0.5)
COLOURS: dict[ObjectClass, Colour] = {
    ObjectClass.UNKNOWN: Colour(0.6, 0.6, 0.6),
    ObjectClass.CAR: Colour(0.9, 0.5, 0.1),
    ObjectClass.TRUCK: Colour(0.7, 0.35, 0.1),
    ObjectClass.BUS: Colour(0.8, 0.7, 0.1),
    ObjectClass.MOTORCYCLE: Colour(0.6, 0.2, 0.7),
    ObjectClass.CYCLIST: Colour(0.1, 0.65, 0.6),
    ObjectClass.PEDESTRIAN: Colour(0.85, 0.2, 0.2),
}
VUT = Colour(0.15, 0.45, 0.85)
TRAIL_POINTS = 200
TRAIL_STEP_M = 0.25
TRAIL_JUMP_M = 10.0


@dataclass(slots=True)
class Trails:
    """Where objects have been, at steps of TRAIL_STEP_M; the oldest points are forgotten."""

    _points: dict[str, deque[Point]] = field(default_factory=dict)
    _stamps: dict[str, int] = field(default_factory=dict)

    def add(self, state: ObjectState) -> None:
        """One more state. A time that goes back, or a jump, begins a new trail."""
        if not state.is_finite:
            return
        at = (state.x_m, state.y_m)
        trail = self._points.setdefault(state.object_id, deque(maxlen=TRAIL_POINTS))
        if state.stamp_ns < self._stamps.get(state.object_id, 0):
            trail.clear()
        self._stamps[state.object_id] = state.stamp_ns
        if trail:
            moved_m = math.dist(trail[-1], at)
            if moved_m < TRAIL_STEP_M:
                return
            if moved_m > TRAIL_JUMP_M:
                trail.clear()
        trail.append(at)

    def of(self, object_id: str) -> tuple[Point, ...]:
        return tuple(self._points.get(object_id, ()))

    def forget(self, object_id: str) -> None:
        self._points.pop(object_id, None)
        self._stamps.pop(object_id, None)


@dataclass(slots=True)
class Moving:
    """Makes the marks of the objects, and makes those of an object that is gone disappear.

    Args:
        vut_path: of the run; None: no gap is drawn.
    """

    vut_path: Polyline | None = None
    trails: Trails = field(default_factory=Trails)
    _numbers: dict[str, int] = field(default_factory=dict)
    _shown: set[tuple[str, int]] = field(default_factory=set)

    def marks(self, board: Board, now_ns: int) -> list[Mark | RemovedMark]:
        """The marks of all objects as they were last heard.

        Args:
            now_ns: steady clock, as in their times of arrival.
        """
        fresh: list[ObjectState] = []
        marks: list[Mark] = []
        for heard in board.objects.values():
            silent_s = object_age_s(board, heard, now_ns)
            state = heard.state
            if silent_s > FORGOTTEN_S:
                self.trails.forget(state.object_id)
            elif state.is_finite:
                self.trails.add(state)
                marks += self._object(state, silent_s)
                if silent_s <= STALE_S:
                    fresh.append(state)
        marks += self._gaps(fresh)
        names = {(mark.space, mark.number) for mark in marks}
        gone = [RemovedMark(*name) for name in sorted(self._shown - names)]
        self._shown = names
        return [*marks, *gone]

    def _number(self, object_id: str) -> int:
        return self._numbers.setdefault(object_id, len(self._numbers))

    def _object(self, state: ObjectState, silent_s: float) -> list[Mark]:
        number, size = self._number(state.object_id), state.size
        stale = silent_s > STALE_S
        colour = STALE if stale else colour_of(state)
        middle = state.pose.to_parent((size.front_m - size.rear_m) / 2.0, 0.0)
        box = Mark(
            "object",
            number,
            Shape.CUBE,
            colour,
            Pose2(*middle, state.yaw_rad),
            size.height_m / 2.0,
            (size.length_m, size.width_m, size.height_m),
        )
        words = f"{state.object_id}  {state.speed_mps:.1f} m/s"
        if stale:
            words = f"{state.object_id}  silent for {silent_s:.1f} s"
        marks = [box, text("name", number, words, middle, size.height_m + 0.9, NAME)]
        trail = self.trails.of(state.object_id)
        if len(trail) > 1:
            marks.append(line("trail", number, trail, colour, 0.12, 0.05))
        return marks

    def _gaps(self, states: list[ObjectState]) -> list[Mark]:
        """A line from the VUT to each object that it is predicted to meet, with the times."""
        vut = next((state for state in states if state.role is Role.VUT), None)
        if vut is None or self.vut_path is None:
            return []
        marks = []
        for state in states:
            if state.role is not Role.OT:
                continue
            met = encounter(vut, state.extrapolated(vut.stamp_ns), self.vut_path)
            words = []
            if math.isfinite(met.arrival_gap_s):
                words.append(f"gap {met.arrival_gap_s:.1f} s")
            if math.isfinite(met.ttc_s):
                words.append(f"TTC {met.ttc_s:.1f} s")
            if not words:
                continue
            number = self._number(state.object_id)
            ends = ((vut.x_m, vut.y_m), (state.x_m, state.y_m))
            middle = ((vut.x_m + state.x_m) / 2.0, (vut.y_m + state.y_m) / 2.0)
            marks.append(line("gap", number, ends, GAP, 0.1, 0.5))
            marks.append(text("gap time", number, ", ".join(words), middle, 1.2, GAP))
        return marks


def colour_of(state: ObjectState) -> Colour:
    """The VUT's own colour, or that of the object's class."""
    return VUT if state.role is Role.VUT else COLOURS[state.object_class]
