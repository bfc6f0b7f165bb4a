"""The runner's client beside a manager that is healthy and has nothing to do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from ssp_core.processes import session_environment
from ssp_core.run_file.model import RunSpec
from ssp_core.session_token import draw_token
from ssp_scenario_manager.ros import runner_client
from ssp_scenario_manager.ros.runner_client import RunClient

if TYPE_CHECKING:
    from .conftest import Peers

pytestmark = pytest.mark.ros


def await_action(peers: Peers, client: RunClient) -> None:
    def ready() -> bool:
        client.spin(0.05)
        return client.ready()

    peers.spin_until(ready, "the manager's action")


def test_a_manager_that_was_reset_is_no_silent_one(
    peers: Peers, domain: int, run_file: Path, run: RunSpec
) -> None:
    """No run is loaded then, so that nothing is told of links; its heartbeats go on."""
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
        assert not client.ready()
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
