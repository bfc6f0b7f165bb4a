"""A stranger that publishes for a part of a session is named, and the run isn't valid."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.safety.publishers import NAMELESS
from tests.system import stranger
from tests.system.conftest import Beside, aborted_by

pytestmark = [pytest.mark.ros, pytest.mark.system]
# Hears what it can of a session, as a page, a recorder or a plot do, and says when it has.
LISTENER = """
import time
import rclpy
from ssp_core import names, ros
from ssp_msgs import msg
rclpy.init()
node = ros.make_node("listener")
heard = set()
for kind, topic in ((msg.ObjectState, names.state_topic("ot1")), (msg.Heartbeat, names.HEARTBEAT)):
    node.create_subscription(kind, topic, lambda _, topic=topic: heard.add(topic), ros.STATE)
executor = ros.make_executor()
executor.add_node(node)
until = time.monotonic() + 120.0
while len(heard) < 2 and time.monotonic() < until:
    executor.spin_once(timeout_sec=0.2)
assert len(heard) == 2, heard  # without a line the test fails
print("heard", flush=True)
while rclpy.ok():
    executor.spin_once(timeout_sec=0.2)
"""
# As the recorder says it, which may be sooner than the graph.
RIVALS = "has messages of two publishers in turn"


# One that the recorder hears, and one that it doesn't; each topic: test_publisher_watch.
@pytest.mark.parametrize("topic", [names.state_topic("ot1"), names.STEP_DONE])
def test_a_stranger_is_named_and_the_run_is_not_valid(
    start_long_session: Any, beside: Beside, topic: str
) -> None:
    session = start_long_session("--no-camera")
    process = beside(session, str(Path(stranger.__file__)), topic)
    session.wait_for("phase approach")
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()
    result = session.finish()
    assert result["verdict"] == "invalid_harness", result["reasons"]
    reasons = " ".join(result["reasons"])
    assert f"foreign_manager: 1, limit 0 ({topic} has" in reasons or RIVALS in reasons, reasons
    # The graph may name a node only after the run has ended; its process it knows at once.
    nameless = f"{NAMELESS} (process {process.pid & 0xFFFF} of this host)"
    assert any(who in reasons for who in ("/ssp/stranger", nameless, RIVALS)), reasons


def test_who_only_listens_is_no_stranger_and_an_interruption_leaves_nothing_behind(
    start_long_session: Any, beside: Beside, live_processes: Any
) -> None:
    """The session lasts until the listener has heard it, and ends for no other reason than us."""
    session = start_long_session("--no-camera")
    beside(session, "-c", LISTENER)
    session.wait_for("phase approach")
    session.process.send_signal(signal.SIGINT)
    result = aborted_by("SIGINT", session, live_processes)
    known = ("interrupted by SIGINT", "goal cancelled")
    assert [r for r in result["reasons"] if not any(one in r for one in known)] == []
