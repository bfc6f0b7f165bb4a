"""Any one node dies, or the user interrupts: the run ends, says why, and its bag can be read.

Deaths in lockstep, with their reaction times and stopping distances: test_fault_cells.py.
"""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.alone]

# Which node dies, in which mode, and the watches of which the first to see it is the primary
# reason: the manager's, the world's and the runner's race each other on the wall's clock.
DEATHS = [
    (
        "object_target",
        "realtime",
        ("object_silent: ot1", "participant_lost: object_target", "object_target killed"),
    ),
    ("front_camera", "lockstep", ("participant_lost: front_camera",)),
    ("monitor", "realtime", ("recorder: monitor",)),
]


def last_speeds(bag: Path) -> dict[str, float]:
    """Speed of each object in the last recorded ground truth."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/ssp/world/tick"]
        last: Any = None
        for connection, _, raw in reader.messages(connections=connections):
            last = reader.deserialize(raw, connection.msgtype)
    return {o.object_id: o.speed for o in last.objects if o.role in (1, 2)}


@pytest.mark.parametrize(("node", "mode", "primary"), DEATHS)
def test_killed_node_ends_the_run(
    node: str, mode: str, primary: tuple[str, ...], start_session: Any, live_processes: Any
) -> None:
    camera = () if node != "front_camera" else ("--site", "boulevard")
    session = start_session("cut_in", "--mode", mode, *(camera or ("--no-camera",)))
    session.wait_for("phase approach")
    time.sleep(0.4 if mode == "lockstep" else 2.0)  # so that there is something to stop
    session.kill(node)
    result = session.finish()

    assert session.process.returncode == 1
    assert result["verdict"] in ("invalid_harness", "aborted")
    assert any(watch in result["reasons"][0] for watch in primary), result["reasons"]
    assert any(f"{node} killed by SIGKILL" in reason for reason in result["reasons"])
    assert live_processes(session.folder) == {}
    bag = session.folder / "bag"
    with AnyReader([bag]) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
        # An empty list of connections would mean all of them.
        events = [c for c in reader.connections if c.topic == "/ssp/safety_event"]
        decoded = [
            reader.deserialize(raw, c.msgtype)
            for c, _, raw in (reader.messages(connections=events) if events else ())
        ]
    lost = [event.object_id for event in decoded if event.limit_name == "participant_lost"]
    assert topics["/ssp/vut/state"] > 0
    assert topics["/ssp/world/tick"] > 0
    # Nobody is called lost but the one that was killed.
    assert set(lost) <= {node}
    if node != "monitor":
        assert all(speed < 0.05 for speed in last_speeds(bag).values()), last_speeds(bag)
    verdict = json.loads((bag / "verdict.json").read_text())
    assert verdict["verdict"] == result["verdict"]


def test_dead_manager_stops_the_objects_by_themselves(start_session: Any) -> None:
    session = start_session("cut_in", "--mode", "realtime", "--no-camera")
    session.wait_for("phase approach")
    time.sleep(4.0)
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


@pytest.mark.parametrize("signal_name", ["SIGINT", "SIGHUP"])
def test_interruption_aborts_and_leaves_nothing_behind(
    signal_name: str, start_session: Any, live_processes: Any
) -> None:
    closes = signal_name == "SIGHUP"
    session = start_session("cut_in", "--mode", "realtime", "--no-camera", terminal=closes)
    session.wait_for("phase approach")
    if closes:
        session.process.stderr.close()
    else:
        session.process.send_signal(signal.SIGINT)
    result = session.finish()

    assert session.process.returncode == 1
    assert result["verdict"] == "aborted"
    assert result["reasons"][0] == f"interrupted by {signal_name}"
    assert live_processes(session.folder) == {}
    assert (session.folder / "bag" / "metadata.yaml").is_file()
    assert max(last_speeds(session.folder / "bag").values()) < 0.05


def test_output_that_nobody_reads_ends_no_session(start_session: Any) -> None:
    session = start_session("cut_in", "--no-camera")
    session.wait_for("session")
    session.process.stdout.close()
    session.process.stderr.close()
    assert session.finish()["verdict"] == "valid"
    assert session.process.returncode == 0


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
