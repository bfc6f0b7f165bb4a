"""The runner's client beside a manager that is healthy and has nothing to do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.task import Future

from ssp_core import names
from ssp_core.host.environment import session_environment
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.session_token import draw_token
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.srv import LoadScenario
from ssp_scenario_manager.ros import runner_client
from ssp_scenario_manager.ros.runner_client import RunClient
from tests.support.processes.waiting import DEADLINE_S

if TYPE_CHECKING:
    from .conftest import Peers

pytestmark = pytest.mark.ros


def await_action(peers: Peers, client: RunClient) -> None:
    missing: list[str] = []

    def ready() -> bool:
        client.spin(0.05)
        missing[:] = client.lacks()
        return not missing

    try:
        peers.spin_until(ready, "the manager's action")
    except AssertionError:
        pytest.fail(f"of the manager {missing} wasn't seen in time")


def test_a_manager_that_was_reset_is_no_silent_one(
    peers: Peers, domain: int, run_file: Path, run: RunSpec
) -> None:
    """No run is loaded then, so that no link is reported; its heartbeats go on."""
    assert peers.load(run_file).accepted
    client = RunClient(session_environment(domain), lambda _: None, run)
    try:
        await_action(peers, client)
        peers.obtain("reset")

        def is_manager_alive() -> bool:
            client.spin(0.05)
            return client.silent_s < 1.0

        for _ in range(3):
            client.silent_s = 99.0
            peers.spin_until(is_manager_alive, "a sign of the manager's life")
        assert not peers.links or peers.session_states[-1].run_id == ""
    finally:
        client.close()


def test_the_manager_of_another_session_is_not_taken_for_ones_own(
    peers: Peers, domain: int, run_file: Path, run: RunSpec
) -> None:
    """It offers the same action, so that a goal would go to it."""
    assert peers.load(run_file).accepted
    own = run.model_copy(update={"session_token": draw_token(run.mode)})
    client = RunClient(session_environment(domain), lambda _: None, own)
    try:

        def has_other_manager() -> bool:
            client.spin(0.05)
            return bool(client.other_managers())

        peers.spin_until(has_other_manager, "the other manager")
        assert names.HEARTBEAT in client.lacks()
    finally:
        client.close()


def test_a_goal_that_came_too_late_ends_nothing_for_the_next_one(
    peers: Peers, domain: int, run_file: Path, run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person's word ran out, and the word is given again more than a grace later."""
    assert peers.load(run_file).accepted
    client = RunClient(session_environment(domain), lambda _: None, run)
    try:
        await_action(peers, client)
        client.begin(str(run_file), not_after_ns=1)

        def refused() -> bool:
            client.spin(0.05)
            return client.not_in_time is not None

        peers.spin_until(refused, "the manager's refusal")
        assert client.not_in_time
        client.ask_again()
        monkeypatch.setattr(runner_client, "RESULT_GRACE_S", 0.0)
        client.begin(str(run_file))
        assert client.outcome is None
    finally:
        client.close()


def test_a_load_whose_answer_was_lost_is_asked_for_again(
    peers: Peers, domain: int, run_file: Path, run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server drops the answer to a client whose reader it hasn't found yet."""
    client = RunClient(session_environment(domain), lambda _: None, run)
    asked = []

    def call_async(request: LoadScenario.Request) -> Any:
        asked.append(request)
        return Future() if len(asked) == 1 else load(request)

    load = client._load.call_async
    monkeypatch.setattr(client._load, "call_async", call_async)
    try:
        await_action(peers, client)
        client.load(str(run_file))

        def answered() -> bool:
            client.spin(0.05)
            return client.loaded is not None

        peers.spin_until(answered, "the answer to load_scenario")
        assert client.loaded == ()
        assert len(asked) == 2
        peers.wait_for(SessionPhase.LOADED)
    finally:
        client.close()


def test_a_session_that_went_on_was_loaded_though_no_answer_came(
    peers: Peers, domain: int, run_file: Path, run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second load would be refused there, and the run be called off for it."""
    peers.appear()
    assert peers.load(run_file).accepted
    peers.obtain("connect")
    client = RunClient(session_environment(domain), lambda _: None, run)
    monkeypatch.setattr(runner_client, "ANSWER_S", 0.2)
    monkeypatch.setattr(client._load, "call_async", lambda _: Future())
    try:
        client.load(str(run_file))

        def loaded() -> bool:
            client.spin(0.05)
            return client.loaded is not None

        peers.spin_until(loaded, "the session's state")
        assert client.loaded == ()
    finally:
        client.close()


_HANGS = """
import ctypes, sys
from pathlib import Path
from ssp_core import ros
from ssp_core.host.environment import session_environment
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.ros.runner_client import RunClient
run = load_run(Path(sys.argv[2]))
client = RunClient(session_environment(int(sys.argv[1])), lambda _: None, run)
ros._TEARDOWN_LIMIT_S = 0.5
# As middleware does: with Python's lock held.
client.node.destroy_node = lambda: ctypes.PyDLL(None).pause()
print("closing", flush=True)
client.close()
"""


def test_middleware_that_hangs_ends_the_runner_with_its_stacks(domain: int, run_file: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _HANGS, str(domain), str(run_file)],
        capture_output=True,
        text=True,
        check=False,
        timeout=DEADLINE_S,
    )
    assert (done.returncode, done.stdout) == (1, "closing\n"), done.stderr
    assert "in close" in done.stderr


_MAPS = """
import sys, time
from pathlib import Path
from ssp_core.host.environment import session_environment
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.ros.runner_client import RunClient
env = session_environment(int(sys.argv[1]))
client = RunClient(env, lambda _: None, load_run(Path(sys.argv[2])))
deadline = time.monotonic() + float(sys.argv[3])
while client.lacks() and time.monotonic() < deadline:
    client.spin(0.05)
assert not client.lacks(), client.lacks()
print([line.split()[-1] for line in open("/proc/self/maps") if "/dev/shm/fast" in line])
client.close()
"""


def test_the_runner_shares_no_memory_with_nodes_that_may_be_killed(
    peers: Peers, domain: int, run_file: Path
) -> None:
    """Fast DDS waits without end for a port that a killed node left in the middle of a change."""
    assert peers.load(run_file).accepted
    arguments = [str(domain), str(run_file), str(DEADLINE_S)]
    done = subprocess.run(
        [sys.executable, "-c", _MAPS, *arguments], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("[]\n", 0), done.stderr
