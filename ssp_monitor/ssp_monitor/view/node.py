"""The node ``view``: markers of the scene and of the objects, and /diagnostics."""

from __future__ import annotations

import sys
import time
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from ssp_core import names, ros
from ssp_core.geometry import Polyline
from ssp_core.run_spec import load_run
from ssp_core.wire.states import decode_state, decode_states
from ssp_core.wire.steps import Heartbeat as HeartbeatFact
from ssp_core.wire.steps import decode_heartbeat
from ssp_monitor.core.drawing import drawing_of
from ssp_monitor.page import conversions as heard
from ssp_monitor.page.board import Board
from ssp_monitor.page.intake import Newest
from ssp_monitor.view.conversions import diagnostic_array, marker_array
from ssp_monitor.view.health import ClockWatch, health
from ssp_monitor.view.moving import Moving
from ssp_monitor.view.params import read_run_file
from ssp_monitor.view.standing import standing_marks
from ssp_monitor.view.topics import DIAGNOSTICS, OBJECT_MARKERS, SCENE_MARKERS
from ssp_msgs.msg import (
    Heartbeat,
    LinkStatus,
    ObjectState,
    ObjectStates,
    PhaseEvent,
    RecorderStatus,
    SessionState,
)

NODE = "view"
MARKERS_S = 0.1
DIAGNOSTICS_S = 1.0
LOOK_S = 1.0
_STATE_TYPE = "ssp_msgs/msg/ObjectState"


class ViewNode(Node):
    """Hears a session, publishes what other tools show.

    Raises:
        InputError: the run file is wrong.
    """

    def __init__(self) -> None:
        super().__init__(NODE, namespace=names.NAMESPACE)
        run_file = read_run_file(self)
        run = load_run(run_file) if run_file is not None else None
        self._board = Board(run)
        path = run.vut.approach.path if run is not None and run.vut.approach is not None else None
        self._moving = Moving(Polyline(path) if path is not None else None)
        self._session_time = ClockWatch()
        self._single = Newest(lambda data: (decode_state(data),))
        self._arrays = Newest(lambda data: decode_states(data).states)
        self._told: set[str] = set()
        self._followed: set[str] = set()
        self._subscribe()
        self._scene = self.create_publisher(MarkerArray, SCENE_MARKERS, ros.LATCHED)
        self._objects = self.create_publisher(MarkerArray, OBJECT_MARKERS, ros.STATE)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, ros.STATE)
        if run is not None:
            self._scene.publish(marker_array(standing_marks(drawing_of(run)), 0))
        # Steady: a frozen /clock must not freeze what is said about it.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(MARKERS_S, self._show, clock=steady)
        self.create_timer(DIAGNOSTICS_S, self._diagnose, clock=steady)
        self.create_timer(LOOK_S, self._look_around, clock=steady)

    def _subscribe(self) -> None:
        sub = self.create_subscription
        sub(ObjectStates, names.OBJECT_STATES, self._on_array, ros.STATE, raw=True)
        sub(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        sub(PhaseEvent, names.PHASE_EVENT, self._on_phase, ros.LATCHED)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        sub(LinkStatus, names.LINK_STATUS, self._on_links, ros.STATE)
        ros.subscribe_raw(
            self, Heartbeat, names.HEARTBEAT, decode_heartbeat, self._on_heartbeat, ros.STATE
        )

    def _look_around(self) -> None:
        """Follows every object that has a topic of its own."""
        for topic, kinds in self.get_topic_names_and_types():
            ours = topic.startswith(f"{names.NAMESPACE}/") and _STATE_TYPE in kinds
            if ours and topic not in self._followed:
                self._followed.add(topic)
                take = partial(self._on_state, topic)
                self.create_subscription(ObjectState, topic, take, ros.STATE, raw=True)

    def _on_state(self, topic: str, data: bytes) -> None:
        self._single.put(topic, data, time.monotonic_ns())

    def _on_array(self, data: bytes) -> None:
        try:
            self._arrays.put(heard.source_of(data), data, time.monotonic_ns())
        except (ValueError, ArithmeticError, LookupError) as error:
            self._tell_once(f"{names.OBJECT_STATES}: {error}")

    def _on_heartbeat(self, heartbeat: HeartbeatFact) -> None:
        self._board.manager_stamp_ns = heartbeat.stamp_ns
        self._board.manager_at_ns = time.monotonic_ns()

    def _on_session(self, message: SessionState) -> None:
        try:
            self._board.hear_session(heard.session_fact(message), time.monotonic_ns())
        except ValueError as error:
            self._tell_once(f"{names.SESSION_STATE}: {error}")

    def _on_phase(self, message: PhaseEvent) -> None:
        try:
            self._board.hear_phase(*heard.phase_of(message))
        except ValueError as error:
            self._tell_once(f"{names.PHASE_EVENT}: {error}")

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._board.hear_recorder(heard.recorder_fact(message), time.monotonic_ns())

    def _on_links(self, message: LinkStatus) -> None:
        self._board.hear_links(heard.link_facts(message), time.monotonic_ns())

    def _tell_once(self, problem: str) -> None:
        what = problem.partition(":")[0]
        if what not in self._told:
            self._told.add(what)
            self.get_logger().error(f"message dropped (more will be without a word): {problem}")

    def _show(self) -> None:
        for newest in (self._single, self._arrays):
            states, problems = newest.take()
            for group, at_ns in states:
                self._board.hear_states(group, at_ns)
            for problem in problems:
                self._tell_once(problem)
        stamps = [one.state.stamp_ns for one in self._board.objects.values()]
        now_ns = time.monotonic_ns()
        self._session_time.see(max(stamps, default=None), now_ns)
        marks = self._moving.marks(self._board.objects.values(), now_ns)
        if marks:
            self._objects.publish(marker_array(marks, max(stamps, default=0)))

    def _diagnose(self) -> None:
        statuses = health(self._board, self._session_time, time.monotonic_ns())
        self._diagnostics.publish(diagnostic_array(statuses, time.time_ns()))


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(lambda _: ViewNode(), lambda _: None))


if __name__ == "__main__":
    main()
