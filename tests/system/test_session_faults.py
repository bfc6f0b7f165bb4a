"""Any one node dies, or the user interrupts: the run ends, says why, and its bag can be read."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

pytestmark = [pytest.mark.ros, pytest.mark.system]

# Which node, what the primary reason must name, and the verdict.
DEATHS = [
    ("sil_world", "world_silent", "invalid_harness"),
    ("object_target", "object_target", "invalid_harness"),
    ("front_camera", "front_camera", "invalid_harness"),
    ("monitor", "recorder", "invalid_harness"),
    ("scenario_manager", "scenario_manager killed by SIGKILL", "invalid_harness"),
]


def last_speeds(bag: Path) -> dict[str, float]:
    """Speed of each object in the last recorded ground truth."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/ssp/world/tick"]
        last: Any = None
        for connection, _, raw in reader.messages(connections=connections):
            last = reader.deserialize(raw, connection.msgtype)
    return {o.object_id: o.speed for o in last.objects if o.role in (1, 2)}


@pytest.mark.parametrize(("node", "primary", "verdict"), DEATHS)
def test_killed_node_ends_the_run(
    node: str, primary: str, verdict: str, start_session: Any, live_processes: Any
) -> None:
    session = start_session("cut_in", "--mode", "realtime")
    session.wait_for("phase approach")
    time.sleep(1.0)  # some seconds of driving, so that there is something to stop
    session.kill(node)
    result = session.finish()

    assert session.process.returncode == 1
    assert result["verdict"] == verdict
    assert primary in result["reasons"][0]
    assert any(f"{node} killed by SIGKILL" in reason for reason in result["reasons"])
    assert live_processes(session.folder) == {}
    with AnyReader([session.folder / "bag"]) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
    assert topics["/ssp/vut/state"] > 0
    assert topics["/ssp/world/tick"] > 0


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_dead_manager_stops_the_objects_by_themselves(mode: str, start_session: Any) -> None:
    session = start_session("cut_in", "--mode", mode, "--no-camera")
    session.wait_for("phase approach")
    session.wait_for("trigger") if mode == "lockstep" else time.sleep(4.0)
    session.kill("scenario_manager")
    result = session.finish()

    assert result["verdict"] == "invalid_harness"
    bag = session.folder / "bag"
    assert all(speed < 0.05 for speed in last_speeds(bag).values()), last_speeds(bag)
    with AnyReader([bag]) as reader:
        events = [
            reader.deserialize(raw, c.msgtype)
            for c, _, raw in reader.messages(
                connections=[c for c in reader.connections if c.topic == "/ssp/safety_event"]
            )
        ]
    stops = [e for e in events if e.reaction == "local_stop"]
    assert [e.limit_name for e in stops] == ["heartbeat_lost"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_aborts_and_leaves_nothing_behind(
    number: signal.Signals, start_session: Any, live_processes: Any
) -> None:
    session = start_session("cut_in", "--mode", "realtime", "--no-camera")
    session.wait_for("phase approach")
    session.process.send_signal(number)
    result = session.finish()

    assert session.process.returncode == 1
    assert result["verdict"] == "aborted"
    assert result["reasons"][0] == "interrupted from the terminal"
    assert live_processes(session.folder) == {}
    assert (session.folder / "bag" / "metadata.yaml").is_file()
    assert max(last_speeds(session.folder / "bag").values()) < 0.05


def test_killed_runner_takes_its_nodes_along(start_session: Any, live_processes: Any) -> None:
    session = start_session("cut_in", "--mode", "realtime", "--no-camera")
    session.wait_for("phase approach")
    session.process.kill()
    session.process.communicate()
    deadline = time.monotonic() + 20.0
    while live_processes(session.folder) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert live_processes(session.folder) == {}
    assert (session.folder / "bag" / "metadata.yaml").is_file()
