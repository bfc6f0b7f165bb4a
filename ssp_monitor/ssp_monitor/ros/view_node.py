"""The node ``view``: markers of the scene and of the objects, and /diagnostics."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from ssp_core import names, ros
from ssp_core.geometry import Polyline
from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.run_file.model import load_run
from ssp_core.world.road_drawing import drawing_of
from ssp_monitor.ros.parameters import VIEW
from ssp_monitor.ros.session_subscriptions import LOOK_PERIOD_S, SessionSubscriptions
from ssp_monitor.status.board import Board
from ssp_monitor.status.health import ClockWatch, health
from ssp_monitor.status.markers import Mark, Moving, RemovedMark, standing_marks


def marker_of(mark: Mark | RemovedMark, stamp_ns: int) -> Marker:
    """One marker, or the deletion of one."""
    marker = Marker()
    marker.header.frame_id = MAP_FRAME
    marker.header.stamp = stamp_from_ns(stamp_ns)
    marker.ns, marker.id = mark.space, mark.number
    if isinstance(mark, RemovedMark):
        marker.action = Marker.DELETE
        return marker
    marker.action, marker.type = Marker.ADD, int(mark.shape)
    position, orientation = marker.pose.position, marker.pose.orientation
    position.x, position.y = mark.at.x_m, mark.at.y_m
    # A line's points have their own height.
    position.z = 0.0 if mark.points else mark.z_m
    orientation.z, orientation.w = math.sin(mark.at.yaw_rad / 2), math.cos(mark.at.yaw_rad / 2)
    marker.scale.x, marker.scale.y, marker.scale.z = mark.size_m
    colour = marker.color
    colour.r, colour.g, colour.b = mark.colour.red, mark.colour.green, mark.colour.blue
    colour.a = mark.colour.alpha
    marker.points = [Point(x=x, y=y, z=mark.z_m) for x, y in mark.points]
    marker.text = mark.text
    return marker


def marker_array(marks: Iterable[Mark | RemovedMark], stamp_ns: int) -> MarkerArray:
    """All of them in one message."""
    return MarkerArray(markers=[marker_of(mark, stamp_ns) for mark in marks])


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
        self._moving = Moving(Polyline(path) if path is not None else None)
        self._session_time = ClockWatch()
        self._watch = SessionSubscriptions(self, self._board)
        self._scene = self.create_publisher(MarkerArray, SCENE_MARKERS, ros.LATCHED)
        self._objects = self.create_publisher(MarkerArray, OBJECT_MARKERS, ros.STATE)
        self._diagnostics = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, ros.STATE)
        if run is not None:
            self._scene.publish(marker_array(standing_marks(drawing_of(run)), 0))
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
        if marks:
            self._objects.publish(marker_array(marks, max(stamps, default=0)))

    def _diagnose(self) -> None:
        statuses = health(self._board, self._session_time, time.monotonic_ns())
        self._diagnostics.publish(ros.diagnostic_array(statuses, time.time_ns()))


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(lambda _: ViewNode(), lambda _: None))


if __name__ == "__main__":
    main()
