"""The commands that a manager takes: those of its own session, and an abort from any sender."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from ssp_core.ros import stamp_from_ns
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.action import RunScenario
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.session.run_script import PATIENCE_S
from ssp_scenario_manager.session.state_machine import REFUSED_TRANSITION
from tests.support.processes.patience import patient
from tests.support.processes.waiting import DEADLINE_S

pytestmark = pytest.mark.ros

LIVE = {"mode": "live", "disturbance": {}, "disturbances": {}, "faults": [], "traffic": []}


def begin(peers: Any, run_file: Path, token: str, **more: Any) -> Any:
    """A goal that was accepted."""
    peers.spin_until(peers.action.server_is_ready, "the action server")
    goal = RunScenario.Goal(run_file=str(run_file), session_token=token, **more)
    asked = peers.action.send_goal_async(goal)
    peers.spin_until(asked.done, "the goal's answer")
    return asked.result()


def result_of(peers: Any, goal: Any) -> Any:
    result = goal.get_result_async()
    peers.spin_until(result.done, "the goal's result")
    return result.result().result


def send(peers: Any, run_file: Path, token: str, **more: Any) -> Any:
    """A goal's result."""
    return result_of(peers, begin(peers, run_file, token, **more))


def send_command(peers: Any, name: str, **given: Any) -> Any:
    return peers.ask(peers.services[name], SessionCommand.Request(requested_by="test", **given))


def obtained(peers: Any, name: str, **given: Any) -> None:
    """Asks until it is accepted: what the peers say of themselves needs a moment to arrive."""
    peers.spin_until(lambda: send_command(peers, name, **given).accepted, f"{name} accepted")


@pytest.fixture
def live(peers: Any, run_mapping: dict[str, Any], tmp_path: Path) -> Path:
    """A manager that leads a live session, everybody in place."""
    path = tmp_path / "live.yaml"
    live = {**run_mapping, **LIVE, "session_token": "live-1"}
    path.write_text(json.dumps(patient(live)))
    peers.live = True
    peers.appear()
    assert peers.load(path).accepted
    peers.spin_until(lambda: peers.token == "live-1", "a heartbeat with the token")
    return path


def prints_its_token(manager: subprocess.Popen[str], peers: Any) -> None:
    """Read the token in the log of a manager led by hand, and give it as a person does."""
    token = peers.token
    manager.terminate()
    printed, _ = manager.communicate(timeout=DEADLINE_S)
    assert token
    assert f"session_token {token}: goals and commands must carry it" in printed


def test_a_live_manager_takes_nothing_of_a_simulated_session(
    peers: Any, manager: Any, live: Path, run_mapping: dict[str, Any], tmp_path: Path
) -> None:
    """Its goal went through connect and armed the live object."""
    simulated = tmp_path / "simulated.yaml"
    simulated.write_text(json.dumps({**run_mapping, "session_token": "sim-2"}))
    for token in ("sim-2", "live-9", ""):
        result = send(peers, simulated, token)
        assert result.error_code == RunScenario.Result.FAILED_START
        assert "session" in result.error_msg
        assert not peers.ask(
            peers.loading, LoadScenario.Request(run_file=str(live), session_token=token)
        ).accepted
        for name in ("connect", "arm", "start", "reset"):
            answer = send_command(peers, name, session_token=token)
            assert answer.error_code == SessionCommand.Response.REFUSED_SESSION, answer
    # Its run isn't this manager's either, whatever token comes with it.
    result = send(peers, simulated, "live-1")
    assert "start another manager" in result.error_msg
    assert peers.commands == []
    assert peers.session_states[-1].state == SessionPhase.LOADED
    obtained(peers, "connect", session_token="live-1")
    prints_its_token(manager, peers)


def test_a_simulated_manager_takes_no_live_run(
    peers: Any, manager: Any, run_file: Path, run_mapping: dict[str, Any], tmp_path: Path
) -> None:
    peers.appear()
    assert peers.load(run_file).accepted
    path = tmp_path / "live.yaml"
    path.write_text(json.dumps({**run_mapping, **LIVE}))
    answer = peers.ask(peers.loading, LoadScenario.Request(run_file=str(path)))
    assert not answer.accepted
    assert "is simulated, and the run's mode is live" in answer.error_msg
    # Without a token, a simulated session is led as before.
    obtained(peers, "connect")
    prints_its_token(manager, peers)


def test_during_a_goal_an_abort_counts_from_anybody_and_no_run_is_loaded(
    peers: Any, live: Path
) -> None:
    """A person's word for one run armed and started another."""
    peers.obeys = False
    goal = begin(peers, live, "live-1", not_after=stamp_from_ns(time.time_ns() + 60_000_000_000))
    load = LoadScenario.Request(run_file=str(live), session_token="live-1")
    answer = peers.ask(peers.loading, load)
    assert (answer.accepted, answer.error_code) == (False, REFUSED_TRANSITION)
    assert "a run_scenario goal is under way" in answer.error_msg
    given = {"session_token": "sim-2", "shown_state": 3, "shown_since": stamp_from_ns(7)}
    assert send_command(peers, "abort", **given).accepted
    peers.wait_for(SessionPhase.ABORTED)
    assert result_of(peers, goal).error_code


def test_a_press_counts_for_the_state_that_was_shown(peers: Any, live: Path) -> None:
    loaded = peers.session_states[-1]
    shown = {"shown_state": loaded.state, "shown_since": loaded.header.stamp}
    obtained(peers, "connect", session_token="live-1", **shown)
    answer = send_command(peers, "reset", session_token="live-1", **shown)
    assert answer.error_code == SessionCommand.Response.REFUSED_OUTDATED
    assert "pressed for LOADED, and the session is CONNECTED" in answer.error_msg
    # The same state again is another one: somebody reset and loaded in between.
    assert send_command(peers, "reset", session_token="live-1").accepted
    assert peers.load(live).accepted
    answer = send_command(peers, "connect", session_token="live-1", **shown)
    assert "which came after it" in answer.error_msg
    assert peers.session_states[-1].state in (SessionPhase.IDLE, SessionPhase.LOADED)


def test_a_word_that_ran_out_moves_nothing(peers: Any, live: Path) -> None:
    late = stamp_from_ns(time.time_ns() - 1)
    result = send(peers, live, "live-1", not_after=late)
    assert result.error_code == RunScenario.Result.NOT_IN_TIME
    assert peers.commands == []
    # One that holds, with an object that refuses: given up when it has run out, not after 45 s.
    peers.obeys = False
    began_s = time.monotonic()
    result = send(peers, live, "live-1", not_after=stamp_from_ns(time.time_ns() + 2_000_000_000))
    assert result.error_code == RunScenario.Result.NOT_IN_TIME
    assert result.error_msg
    assert time.monotonic() - began_s < PATIENCE_S
    peers.wait_for(SessionPhase.CONNECTED)
