"""The node ``view`` over real topics."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from visualization_msgs.msg import MarkerArray

from ssp_core import names, ros
from ssp_core.cdr.states import encode_state
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocabulary import ObjectClass, Role
from ssp_monitor.ros.view_node import ViewNode
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from ssp_msgs.msg import RecorderStatus, SessionState
from tests.support.processes.waiting import DEADLINE_S


def _state(x_m: float) -> bytes:
    size = DEFAULT_SIZES[ObjectClass.CAR]
    vut = (ObjectClass.CAR, Role.VUT, round(x_m * NS_PER_S))
    return bytes(encode_state(ObjectState("vut", *vut, x_m, 0.0, 0.0, 9.0, 0.0, 0.0, size)))


def test_scene_objects_and_health_are_published(domain, run_file, monkeypatch):
    arguments = ["view", "--ros-args", "-p", f"run_file:={run_file}"]
    monkeypatch.setattr(sys, "argv", arguments)
    rclpy.init(args=arguments, domain_id=domain)
    view = ViewNode()
    other = rclpy.create_node("other", use_global_arguments=False)
    executor = ros.make_executor()
    executor.add_node(view)
    executor.add_node(other)
    heard: dict[str, list[Any]] = {"scene": [], "objects": [], "diagnostics": []}
    states = other.create_publisher(ObjectStateMsg, "/ssp/vut/state", ros.STATE)
    sessions = other.create_publisher(SessionState, "/ssp/session_state", ros.LATCHED)
    recorders = other.create_publisher(RecorderStatus, "/ssp/recorder_status", ros.STATE)
    # Later than the scene was published: it is latched.
    other.create_subscription(MarkerArray, "/ssp/markers/scene", heard["scene"].append, ros.LATCHED)
    other.create_subscription(
        MarkerArray, "/ssp/markers/objects", heard["objects"].append, ros.STATE
    )
    other.create_subscription(
        DiagnosticArray, "/diagnostics", heard["diagnostics"].append, ros.STATE
    )
    sessions.publish(SessionState(state=5))
    sent = 0

    def send() -> None:
        nonlocal sent
        states.publish(_state(sent * 0.2))
        recorders.publish(RecorderStatus(ready=True, bag="bag"))
        sent += 1

    other.create_timer(0.05, send)

    def until(condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"no {what} in time"
            executor.spin_once(timeout_sec=0.05)

    def newest(which: str) -> Any:
        return heard[which][-1]

    try:
        until(lambda: bool(heard["scene"]), "scene")
        assert {marker.ns for marker in newest("scene").markers} >= {"fence", "road", "start"}
        until(
            lambda: (
                bool(heard["objects"])
                and {"object", "name", "trail"} == {m.ns for m in newest("objects").markers}
            ),
            "object with a trail",
        )
        assert {m.header.frame_id for m in newest("objects").markers} == {names.MAP_FRAME}
        until(
            lambda: (
                bool(heard["diagnostics"])
                and [s.level for s in newest("diagnostics").status][:1] == [b"\0"]
                and any(
                    s.name == "ssp: object vut" and s.level == b"\0"
                    for s in newest("diagnostics").status
                )
            ),
            "healthy recorder and VUT",
        )
        by_name = {status.name: status for status in newest("diagnostics").status}
        assert by_name["ssp: object ot1"].message == "was never heard"
        assert by_name["ssp: object ot1"].level == b"\x03"
        for topic in ("/ssp/markers/scene", "/ssp/markers/objects", "/diagnostics"):
            assert len(other.get_publishers_info_by_topic(topic)) == 1
    finally:
        executor.shutdown()
        view.destroy_node()
        other.destroy_node()
        rclpy.shutdown()


def test_a_wrong_run_file_is_an_error_with_its_name(domain, tmp_path, monkeypatch):
    missing = tmp_path / "no.yaml"
    arguments = ["view", "--ros-args", "-p", f"run_file:={missing}"]
    monkeypatch.setattr(sys, "argv", arguments)
    rclpy.init(args=arguments, domain_id=domain)
    try:
        with pytest.raises(InputError, match=r"no\.yaml"):
            ViewNode()
    finally:
        rclpy.shutdown()
