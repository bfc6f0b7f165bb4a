"""Any one node dies, or the user interrupts: the run ends, says why, and its bag can be read.

Deaths of manager and objects, with reaction times and stopping distances: test_fault_cells.py.
"""

from __future__ import annotations

import json
import os
import signal
import time
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from tests.support.bags.messages import last_speeds, messages
from tests.support.processes.waiting import until
from tests.system.conftest import aborted_by

pytestmark = [pytest.mark.ros, pytest.mark.system]

# Which node dies, and the watches of which one sees it first.
DEATHS = [
    ("front_camera", ("participant_lost: front_camera",)),
    ("monitor", ("recorder: monitor", "monitor killed")),
]
FLUSHED_BYTES = 50_000
BUSY = ("participant_lost: scenario_manager", "overrun: scenario_manager")


@pytest.mark.parametrize(("node", "primary"), DEATHS)
def test_killed_node_ends_the_run(
    node: str, primary: tuple[str, ...], long_session: Any, live_processes: Any
) -> None:
    session = long_session(*(() if node == "front_camera" else ("--no-camera",)))
    # A recorder that is killed before its first flush has recorded nothing.
    (file,) = (session.folder / "bag").glob("*.mcap")
    flushed = file.stat().st_size + FLUSHED_BYTES
    if node == "monitor":

        def has_flushed() -> bool:
            assert session.process.poll() is None, "the run ended before its recorder was killed"
            return file.stat().st_size >= flushed

        until(has_flushed, lambda: f"{flushed} bytes in {file.name}, {file.stat().st_size} there")
    session.kill(node)
    result = session.finish()

    assert session.process.returncode == 1
    assert result["verdict"] in ("invalid_harness", "aborted")
    # The first, but for a manager that a busy machine lets answer too late, too.
    first = next(r for r in result["reasons"] if not r.startswith(BUSY))
    assert any(watch in first for watch in primary), result["reasons"]
    assert any(f"{node} killed by SIGKILL" in reason for reason in result["reasons"])
    assert live_processes(session.folder) == {}
    bag = session.folder / "bag"
    with AnyReader([bag]) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections}
    lost = [
        event.object_id
        for event in messages(bag, "/ssp/safety_event")
        if event.limit_name == "participant_lost"
    ]
    assert topics["/ssp/vut/state"] > 0
    assert topics["/ssp/world/tick"] > 0
    assert set(lost) <= {node, "scenario_manager"}
    if node != "monitor":
        assert all(speed < 0.05 for speed in last_speeds(bag).values()), last_speeds(bag)
    verdict = json.loads((bag / "verdict.json").read_text())
    assert verdict["verdict"] == result["verdict"]


def test_a_closed_terminal_aborts_and_leaves_nothing_behind(
    long_session: Any, live_processes: Any
) -> None:
    # So does SIGINT (test_strangers).
    session = long_session("--no-camera", terminal=True)
    session.process.stderr.close()
    aborted_by("SIGHUP", session, live_processes)


def test_closed_output_ends_no_session_and_a_page_without_a_viewer_ends_with_it(
    start_session: Any, live_processes: Any
) -> None:
    session = start_session("cut_in", "--no-camera", "--page", "0")
    session.wait_for("session")
    session.process.stdout.close()
    session.process.stderr.close()
    assert session.finish()["verdict"] == "valid"
    assert session.process.returncode == 0
    assert live_processes(session.folder) == {}


def test_killed_runner_takes_its_nodes_along(long_session: Any, live_processes: Any) -> None:
    session = long_session("--no-camera")
    session.process.kill()
    session.process.communicate()
    until(
        lambda: not live_processes(session.folder),
        lambda: f"end of {live_processes(session.folder)}",
    )
    assert (session.folder / "bag" / "metadata.yaml").is_file()


def test_a_session_outlives_its_page_and_waits_for_a_recorder_that_stands_still(
    start_session: Any,
) -> None:
    """The world waits in lockstep for the recorder, which the test stalls twice.

    The page dies last, when it has found everybody. Killed while it creates a port in shared
    memory, it would leave half of one, for which the DDS of the others waits without end.
    """
    session = start_session("cut_in", "--no-camera", "--page", "0")
    session.wait_for("session RUNNING")
    # Looking for it takes a busy machine a while, which would be a part of the stall.
    monitor = session.pid_of("monitor")
    (file,) = (session.folder / "bag").glob("*.mcap")
    for _ in range(2):
        written = file.stat().st_size
        os.kill(monitor, signal.SIGSTOP)
        time.sleep(0.5)
        os.kill(monitor, signal.SIGCONT)
        until(lambda written=written: file.stat().st_size > written, "word of the recorder")
    session.wait_for("operator page: ")
    session.kill("monitor_page")
    result = session.finish()
    assert (result["verdict"], result["reasons"]) == ("valid", [])
    assert "the operator page killed by SIGKILL; the session goes on" in "".join(session.lines)
    with AnyReader([session.folder / "bag"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/ssp/vut/state"] > 600
