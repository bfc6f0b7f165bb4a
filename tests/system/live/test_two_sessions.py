"""Two whole sessions side by side: neither moves, arms or records anything of the other's."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.host.domains import free_domain
from ssp_core.vocabulary import ControlState, SessionPhase
from tests.support.bags.messages import messages
from tests.system.conftest import ssp_command
from tests.system.live.conftest import ASKS, ODOMETRY
from tests.system.recordings import Recordings

PORT = 21_000
pytestmark = [pytest.mark.ros, pytest.mark.system]

# ``ssp``, which waits for the end of another session, since this one doesn't end, no longer than it
# has to.
SSP = """
import sys
from ssp_core import cli
from ssp_scenario_manager.run.over_dds import follow, session as over_dds
follow.OTHERS_S = 1.0
"""
RUN = "cli.entry()"
# A simulated session whose nodes take domain and discovery from the environment, as no session of
# ``ssp run`` does: what is left between it and a live one is the session's token and mode.
NOT_ISOLATED = (
    f"{SSP}over_dds.session_environment = lambda *_: "
    f"over_dds.live_environment(over_dds.HOSTS_PROFILE)\n{RUN}"
)
BEFORE_ARMING = {SessionPhase.IDLE, SessionPhase.LOADED, SessionPhase.CONNECTED}


@pytest.fixture
def waiting_session(
    make_stage: Callable[[dict[str, str]], Any], task: Callable[[str], Path]
) -> Callable[[dict[str, str]], tuple[Any, Any]]:
    """Starts a live session in an environment, up to where it waits with everybody connected."""

    def start(env: dict[str, str]) -> tuple[Any, Any]:
        stage = make_stage({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **env})
        port = str(PORT + os.getpid() % 1000)
        run = stage.run_live(task("cut_in"), "--no-camera", "--body", f"ot1=udp://127.0.0.1:{port}")
        stage.play("bodies", "--play", "bodies", "--first-port", port, "--log", str(stage.log))
        stage.play("vut", "--play", "vut")
        ask_until_connected(stage, run)
        return stage, run

    return start


def ask_until_connected(stage: Any, run: Any) -> None:
    """Types what is no word until the summary above the prompt shows all as connected."""

    def connected() -> bool:
        before = stage.said("ssp_run").count(ASKS)
        type_line(run, "who is there")
        stage.wait_for(lambda: stage.said("ssp_run").count(ASKS) > before, "a new prompt")
        return "NOT CONNECTED" not in stage.said("ssp_run").rpartition("mode live")[2]

    stage.wait_for(connected, "everybody to be connected")


def type_line(run: Any, words: str) -> None:
    run.stdin.write(f"{words}\n".encode())
    run.stdin.flush()


def ends_unarmed(stage: Any, run: Any) -> None:
    """The waiting session goes on until ``abort`` is typed, and its bag knows of no arming."""
    assert run.poll() is None, stage.said("ssp_run")
    type_line(run, "abort")
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    assert result["reasons"][0] == "abort before the start", result["reasons"]
    bag = stage.folder / "run" / "bag"
    sessions = messages(bag, names.absolute(names.SESSION_STATE))
    assert sessions
    assert {SessionPhase(message.state) for message in sessions} <= BEFORE_ARMING
    states = messages(bag, names.absolute(names.state_topic("ot1")))
    assert {ControlState(state.control_state) for state in states} == {ControlState.DISARMED}
    assert all(row.speed_mps == 0.0 for row in stage.rows())


def simulated(stage: Any, task: Path, name: str, domain: int, *program: str) -> Any:
    """Start a whole simulated session, in the same environment but for the domain."""
    command = [*(program or ssp_command()), "run", str(task), "--no-camera"]
    command += ["--out", str(stage.folder / name)]
    return stage.start(name, command, ("env", f"ROS_DOMAIN_ID={domain}"))


def ended(stage: Any, name: str, process: Any) -> tuple[dict[str, Any], int]:
    stage.wait_for(lambda: process.poll() is not None, f"the end of the session {name}")
    result = json.loads((stage.folder / name / "result.json").read_text())
    return result, process.wait()


def is_valid_beside(stage: Any, task: Path, domain: int) -> None:
    """An isolated session does what it does alone, while others start or wait in its domain."""
    result, status = ended(stage, "isolated", simulated(stage, task, "isolated", domain))
    assert (result["verdict"], status) == ("valid", 0), result["reasons"]


def is_met_and_not_armed(stage: Any, task: Path, domain: int) -> None:
    """A simulated session that isn't isolated meets the waiting one, and takes nothing of it."""
    name = "not_isolated"
    process = simulated(stage, task, name, domain, sys.executable, "-c", NOT_ISOLATED)
    is_valid_beside(stage, task, domain)
    result, status = ended(stage, name, process)
    assert (result["verdict"], status) == ("invalid_harness", 1), result["reasons"]
    assert "foreign_manager" in " ".join(result["reasons"]), result["reasons"]


def second_is_refused(stage: Any) -> None:
    """Another live session in the same domain is refused before any goal, though no word is asked
    for."""
    command = ["run", str(stage.folder / "task"), "--mode", "live", "--start-at-once"]
    command += ["--no-camera", "--odometry", ODOMETRY, "--out", str(stage.folder / "second")]
    result, status = ended(
        stage, "second", stage.start("second", [sys.executable, "-c", SSP + RUN, *command])
    )
    assert (result["verdict"], status) == ("invalid_harness", 1), result["reasons"]
    reason = result["reasons"][0]
    assert reason.startswith("foreign_manager: "), reason
    assert "ROS_DOMAIN_ID" in reason
    # No goal: the bag of its manager's domain knows of no session but the waiting one.
    assert "session CONNECTED" not in stage.said("second")
    states = messages(stage.folder / "second" / "bag", names.absolute(names.SESSION_STATE))
    assert {SessionPhase(message.state) for message in states} <= BEFORE_ARMING


@pytest.mark.timeout(1800)  # four sessions, on a busy machine
@pytest.mark.parametrize("on_server", [False, True])
def test_no_other_session_reaches_a_waiting_live_one(
    waiting_session: Any, discovery_server: str, recordings: Recordings, on_server: bool
) -> None:
    """A second live session in its domain; before that an isolated one.

    On a server the isolated one runs beside one that isn't. The waiting session outlives them all,
    and arms nothing. Sessions of any domain on a server: test_isolation.
    """
    with free_domain() as domain:
        env = {"ROS_DOMAIN_ID": str(domain)}
        if on_server:
            env["ROS_DISCOVERY_SERVER"] = discovery_server
        simulation = recordings.task("cut_in")
        stage, run = waiting_session(env)
        if on_server:
            is_met_and_not_armed(stage, simulation, domain)
        else:
            is_valid_beside(stage, simulation, domain)
        second_is_refused(stage)
        ends_unarmed(stage, run)
