"""The node ``view``: markers of the scene and of the objects, and /diagnostics."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from ssp_core import names, ros
from ssp_core.geometry import Polyline
from ssp_core.run_file.model import load_run
from ssp_monitor.core.drawing import drawing_of
from ssp_monitor.params import VIEW
from ssp_monitor.view.conversions import marker_array
from ssp_monitor.view.health import ClockWatch, health
from ssp_monitor.view.moving import Moving
from ssp_monitor.view.standing import standing_marks
from ssp_monitor.view.topics import OBJECT_MARKERS, SCENE_MARKERS
from ssp_monitor.watch.board import Board
from ssp_monitor.watch.node import LOOK_PERIOD_S, SessionWatch

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
        self._watch = SessionWatch(self, self._board)
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
