"""The node ``view``: markers of the scene and of the objects, and /diagnostics."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point as PointMsg
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ssp_core import names, ros
from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.encounter import encounter
from ssp_core.motion.state import ObjectState
from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.run_file.model import load_run
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.road_drawing import Drawing, drawing_of
from ssp_monitor.ros.parameters import VIEW
from ssp_monitor.ros.session_subscriptions import LOOK_PERIOD_S, SessionSubscriptions
from ssp_monitor.status.board import STALE_S, Board, object_age_s
from ssp_monitor.status.health import ClockWatch, health

Colour = tuple[float, float, float, float]  # red, green, blue and opacity, 0 to 1

FENCE: Colour = (0.85, 0.15, 0.15, 1.0)
OPPOSED: Colour = (0.9, 0.75, 0.2, 0.9)
CROSSING: Colour = (0.9, 0.9, 0.9, 0.8)
VUT_ROUTE: Colour = (0.15, 0.45, 0.85, 0.8)
OT_ROUTE: Colour = (0.9, 0.5, 0.1, 0.8)
CONFLICT: Colour = (0.9, 0.1, 0.5, 0.9)
REGION: Colour = (0.6, 0.3, 0.8, 0.7)
# Colour and width, m, of a road's lines.
_LINES: dict[str, tuple[Colour, float]] = {
    "edge": ((0.75, 0.75, 0.75, 1.0), 0.15),
    "divider": ((0.6, 0.6, 0.6, 0.7), 0.12),
    "centre": ((0.5, 0.5, 0.5, 0.25), 0.08),
    "reference": ((0.3, 0.6, 0.9, 0.4), 0.08),
}

STALE: Colour = (0.5, 0.5, 0.5, 0.6)
NAME: Colour = (1.0, 1.0, 1.0, 1.0)
GAP: Colour = (0.9, 0.1, 0.5, 1.0)
VUT: Colour = (0.15, 0.45, 0.85, 1.0)
COLOURS: dict[ObjectClass, Colour] = {
    ObjectClass.UNKNOWN: (0.6, 0.6, 0.6, 1.0),
    ObjectClass.CAR: (0.9, 0.5, 0.1, 1.0),
    ObjectClass.TRUCK: (0.7, 0.35, 0.1, 1.0),
    ObjectClass.BUS: (0.8, 0.7, 0.1, 1.0),
    ObjectClass.MOTORCYCLE: (0.6, 0.2, 0.7, 1.0),
    ObjectClass.CYCLIST: (0.1, 0.65, 0.6, 1.0),
    ObjectClass.PEDESTRIAN: (0.85, 0.2, 0.2, 1.0),
}


def mark(
    space: str,
    number: int,
    shape: int,
    colour: Colour,
    at: Pose2,
    z_m: float,
    size_m: tuple[float, float, float],
) -> Marker:
    """Return a mark in frame map; a later one of the same space and number replaces it.

    Args:
        space: the marker's namespace.
        number: its id in there.
        shape: a type of Marker.msg.
        colour: red, green, blue and opacity, 0 to 1.
        at: its middle, m.
        z_m: height of its middle over the ground.
        size_m: x, y and z in the mark's own frame.
    """
    marker = Marker(ns=space, id=number, type=shape, action=Marker.ADD)
    marker.header.frame_id = MAP_FRAME
    position, orientation = marker.pose.position, marker.pose.orientation
    position.x, position.y, position.z = at.x_m, at.y_m, z_m
    orientation.z, orientation.w = math.sin(at.yaw_rad / 2), math.cos(at.yaw_rad / 2)
    marker.scale.x, marker.scale.y, marker.scale.z = size_m
    red, green, blue, alpha = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def line(
    space: str,
    number: int,
    points: Sequence[Point],
    colour: Colour,
    width_m: float,
    z_m: float = 0.02,
    *,
    closed: bool = False,
) -> Marker:
    """Return a line through points of frame map; back to the first one where it is closed."""
    origin = Pose2(0.0, 0.0, 0.0)
    marker = mark(space, number, Marker.LINE_STRIP, colour, origin, 0.0, (width_m, 0.0, 0.0))
    through = (*points, points[0]) if closed else points
    marker.points = [PointMsg(x=x, y=y, z=z_m) for x, y in through]
    return marker


def text(space: str, number: int, words: str, at: Point, z_m: float, colour: Colour) -> Marker:
    """Return a text that faces the viewer."""
    place = Pose2(*at, 0.0)
    marker = mark(space, number, Marker.TEXT_VIEW_FACING, colour, place, z_m, (0.0, 0.0, 0.9))
    marker.text = words
    return marker


def circle(centre: Point, radius_m: float, corners: int = 32) -> tuple[Point, ...]:
    """Return a circle as an outline that isn't closed."""
    angles = [2.0 * math.pi * k / corners for k in range(corners)]
    return tuple(
        (centre[0] + radius_m * math.cos(a), centre[1] + radius_m * math.sin(a)) for a in angles
    )


def standing_marks(drawing: Drawing) -> Iterator[Marker]:
    """Yield the marks of a run's drawing."""
    yield line("fence", 0, drawing.fence, FENCE, 0.3, closed=True)
    for number, one in enumerate(drawing.road_lines):
        colour, width_m = _LINES[one.kind]
        colour = OPPOSED if one.kind == "divider" and one.opposed else colour
        yield line("road", number, one.points, colour, width_m, 0.01)
    for number, outline in enumerate(drawing.crossings):
        yield line("crossing", number, outline, CROSSING, 0.2, closed=True)
    for number, route in enumerate(drawing.routes):
        colour = VUT_ROUTE if route.role is Role.VUT else OT_ROUTE
        yield line("route", number, route.points, colour, 0.15, 0.03)
    for number, start in enumerate(drawing.starts):
        colour = VUT_ROUTE if start.role is Role.VUT else OT_ROUTE
        outline = circle(start.centre, start.radius_m)
        yield line("start", number, outline, colour, 0.1, 0.03, closed=True)
        ahead = Pose2(*start.centre, start.yaw_rad).to_parent(start.radius_m, 0.0)
        yield line("start heading", number, (start.centre, ahead), colour, 0.1, 0.03)
    for number, zone in enumerate(drawing.conflict_zones):
        yield line("conflict zone", number, zone.outline, CONFLICT, 0.2, 0.04, closed=True)
    for number, region in enumerate(drawing.regions):
        yield line("region", number, region.outline, REGION, 0.15, 0.04, closed=True)
    for number, anchor in enumerate(drawing.anchors):
        at = Pose2(*anchor.at, 0.0)
        yield mark("anchor", number, Marker.CYLINDER, CONFLICT, at, 0.5, (0.5, 0.5, 1.0))
        yield text("anchor name", number, anchor.name, anchor.at, 1.6, CONFLICT)


FORGOTTEN_S = 30.0
TRAIL_POINTS = 200
TRAIL_STEP_M = 0.25
TRAIL_JUMP_M = 10.0


@dataclass(slots=True)
class Trail:
    """The places where an object has been, at steps of TRAIL_STEP_M.

    The oldest points are forgotten.
    """

    points: deque[Point] = field(default_factory=lambda: deque(maxlen=TRAIL_POINTS))
    stamp_ns: int = 0

    def add(self, state: ObjectState) -> None:
        """Add one more state. A time that goes back, or a jump, begins a new trail."""
        at = (state.x_m, state.y_m)
        moved_m = math.dist(self.points[-1], at) if self.points else math.inf
        if state.stamp_ns < self.stamp_ns or moved_m > TRAIL_JUMP_M:
            self.points.clear()
            moved_m = math.inf
        self.stamp_ns = state.stamp_ns
        if moved_m >= TRAIL_STEP_M:
            self.points.append(at)


@dataclass(slots=True)
class ObjectMarkers:
    """The RViz markers of the objects, anew for each state; deleted for one that is gone.

    Args:
        vut_path: of the run; None: no gap is drawn.
    """

    vut_path: Polyline | None = None
    _trails: dict[str, Trail] = field(default_factory=dict)
    _numbers: dict[str, int] = field(default_factory=dict)
    _marker_ids: set[tuple[str, int]] = field(default_factory=set)

    def marks(self, board: Board, now_ns: int) -> list[Marker]:
        """Return the marks of all objects as they were last heard."""
        fresh: list[ObjectState] = []
        marks: list[Marker] = []
        for latest_state in board.objects.values():
            silent_s = object_age_s(board, latest_state, now_ns)
            state = latest_state.state
            if silent_s > FORGOTTEN_S:
                self._trails.pop(state.object_id, None)
            elif state.is_finite:
                marks += self._object(state, silent_s)
                if silent_s <= STALE_S:
                    fresh.append(state)
        marks += self._gaps(fresh)
        marker_ids = {(marker.ns, marker.id) for marker in marks}
        for space, number in sorted(self._marker_ids - marker_ids):
            marks.append(Marker(ns=space, id=number, action=Marker.DELETE))
            marks[-1].header.frame_id = MAP_FRAME
        self._marker_ids = marker_ids
        return marks

    def _number(self, object_id: str) -> int:
        return self._numbers.setdefault(object_id, len(self._numbers))

    def _object(self, state: ObjectState, silent_s: float) -> Iterator[Marker]:
        number, size = self._number(state.object_id), state.size
        trail = self._trails.setdefault(state.object_id, Trail())
        trail.add(state)
        colour = VUT if state.role is Role.VUT else COLOURS[state.object_class]
        words = f"{state.object_id}  {state.speed_mps:.1f} m/s"
        if silent_s > STALE_S:
            colour, words = STALE, f"{state.object_id}  silent for {silent_s:.1f} s"
        middle = state.pose.to_parent((size.front_m - size.rear_m) / 2.0, 0.0)
        box_m = (size.length_m, size.width_m, size.height_m)
        at = Pose2(*middle, state.yaw_rad)
        yield mark("object", number, Marker.CUBE, colour, at, size.height_m / 2.0, box_m)
        yield text("name", number, words, middle, size.height_m + 0.9, NAME)
        if len(trail.points) > 1:
            yield line("trail", number, tuple(trail.points), colour, 0.12, 0.05)

    def _gaps(self, states: list[ObjectState]) -> Iterator[Marker]:
        """Yield a line from the VUT to each object that it is predicted to meet, with the times."""
        vut = next((state for state in states if state.role is Role.VUT), None)
        if vut is None or self.vut_path is None:
            return
        for state in states:
            if state.role is not Role.OT:
                continue
            meeting = encounter(vut, state.extrapolated(vut.stamp_ns), self.vut_path)
            times_s = {"gap": meeting.arrival_gap_s, "TTC": meeting.ttc_s}
            words = [f"{word} {s:.1f} s" for word, s in times_s.items() if math.isfinite(s)]
            if not words:
                continue
            number = self._number(state.object_id)
            ends = ((vut.x_m, vut.y_m), (state.x_m, state.y_m))
            middle = ((vut.x_m + state.x_m) / 2.0, (vut.y_m + state.y_m) / 2.0)
            yield line("gap", number, ends, GAP, 0.1, 0.5)
            yield text("gap time", number, ", ".join(words), middle, 1.2, GAP)


SCENE_MARKERS = "markers/scene"
OBJECT_MARKERS = "markers/objects"

PUBLISHED: dict[str, str] = {
    names.absolute(SCENE_MARKERS): "visualization_msgs/msg/MarkerArray",
    names.absolute(OBJECT_MARKERS): "visualization_msgs/msg/MarkerArray",
    names.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}


NODE = "view"
MARKERS_S = 0.1
DIAGNOSTICS_S = 1.0


class ViewNode(Node):
    """Hears a session, publishes what other tools show.

    Raises:
        InputError: the run file is wrong.
    """

    def __init__(self) -> None:
        super().__init__(NODE, namespace=names.NAMESPACE)
        run_file = ros.declare(self, VIEW)["run_file"]
        run = load_run(run_file) if run_file else None
        self._board = Board(run)
        path = run.vut.approach.path if run is not None and run.vut.approach is not None else None
        self._moving = ObjectMarkers(Polyline(path) if path is not None else None)
        self._session_time = ClockWatch()
        self._watch = SessionSubscriptions(self, self._board)
        self._scene = self.create_publisher(MarkerArray, SCENE_MARKERS, ros.LATCHED)
        self._objects = self.create_publisher(MarkerArray, OBJECT_MARKERS, ros.STATE)
        self._diagnostics = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, ros.STATE)
        if run is not None:
            self._scene.publish(MarkerArray(markers=[*standing_marks(drawing_of(run))]))
        # Steady: a frozen /clock must not freeze what is said about it.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(MARKERS_S, self._show, clock=steady)
        self.create_timer(DIAGNOSTICS_S, self._diagnose, clock=steady)
        self.create_timer(LOOK_PERIOD_S, self._watch.look_around, clock=steady)

    def _show(self) -> None:
        self._watch.settle()
        stamps = [one.state.stamp_ns for one in self._board.objects.values()]
        now_ns = time.monotonic_ns()
        self._session_time.see(max(stamps, default=None), now_ns)
        marks = self._moving.marks(self._board, now_ns)
        for marker in marks:
            marker.header.stamp = stamp_from_ns(max(stamps, default=0))
        if marks:
            self._objects.publish(MarkerArray(markers=marks))

    def _diagnose(self) -> None:
        statuses = health(self._board, self._session_time, time.monotonic_ns())
        self._diagnostics.publish(ros.diagnostic_array(statuses, time.time_ns()))


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(lambda _: ViewNode(), lambda _: None))


if __name__ == "__main__":
    main()
