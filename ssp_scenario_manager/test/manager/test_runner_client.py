"""The runner's client beside a manager that is healthy and has nothing to do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock

import pytest
from rclpy.task import Future

from ssp_core import names
from ssp_core.host.environment import session_environment
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.session_token import draw_token
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.srv import LoadScenario
from ssp_scenario_manager.ros import runner_client
from ssp_scenario_manager.ros.runner_client import RunClient, StepwiseClient
from tests.support.waiting import DEADLINE_S

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

        def heard() -> bool:
            client.spin(0.05)
            return client.silent_s < 1.0

        for _ in range(3):
            client.silent_s = 99.0
            peers.spin_until(heard, "a sign of the manager's life")
        assert not peers.links or peers.seen[-1].run_id == ""
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

        def told() -> bool:
            client.spin(0.05)
            return bool(client.other_managers())

        peers.spin_until(told, "the other manager")
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


def test_step_by_step_nothing_is_asked_for_after_the_word_has_run_out(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each step is tried for 45 s if no other time is given."""
    now_s = [100.0]
    clock = MagicMock(
        monotonic=lambda: now_s[0],
        monotonic_ns=lambda: round(now_s[0] * 1e9),
        time_ns=lambda: round((now_s[0] + 1e6) * 1e9),
    )
    monkeypatch.setattr(runner_client, "time", clock)
    node = MagicMock()
    services: dict[str, MagicMock] = {}
    node.create_client.side_effect = lambda _, name: services.setdefault(name, MagicMock())
    client = StepwiseClient(node, run, "run.yaml")

    def asked(name: str) -> int:
        return int(services[name].call_async.call_count)

    def drive(state: SessionPhase, seconds: float, *, may_start: bool = True) -> None:
        client._on_session(MagicMock(state=int(state)))
        for _ in range(round(seconds)):
            now_s[0] += 1.0
            client.drive(may_start)
            if client._waiting is not None:
                refusal = MagicMock(
                    accepted=False, error_code=1, error_msg="", missing=["ot1 moves"]
                )
                client._on_answer(client._waiting, MagicMock(**{"result.return_value": refusal}))

    client.begin(not_after_ns=round((now_s[0] + 10.0 + 1e6) * 1e9))
    drive(SessionPhase.CONNECTED, 3.0)
    drive(SessionPhase.ARMED, 7.0)
    assert (asked("arm"), asked("start")) == (3, 7)
    assert not asked(names.LOAD_SCENARIO)
    assert client.problems == ()
    assert client.not_in_time is None
    drive(SessionPhase.ARMED, 20.0)
    assert asked("start") == 7
    assert client.not_in_time == ("ot1 moves",)
    assert client.stays_armed
    for _ in range(5):
        client.give_up()
        now_s[0] += 0.5
    assert asked("disarm") == 2
    # The next word goes on from where it stands.
    client.begin(not_after_ns=round((now_s[0] + 10.0 + 1e6) * 1e9))
    assert client.not_in_time is None
    drive(SessionPhase.CONNECTED, 5.0)
    assert (asked("arm"), asked("start")) == (8, 7)
    client.begin()
    drive(SessionPhase.LOADED, 2.0)
    assert asked(names.LOAD_SCENARIO) == 1


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
