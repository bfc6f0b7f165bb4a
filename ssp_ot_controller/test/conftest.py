"""Fixtures shared by tests of nodes: a ROS domain, a run, and a node that plays the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ssp_core import names
from ssp_core.host.domains import free_domain
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from tests.support.processes.waiting import DEADLINE_S
from tests.support.runs import small_run


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain of the test's own, of which nothing is left."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        yield domain_id
        remove_shared_ports(domain_id)
    remove_stale_shared_memory()


@pytest.fixture
def run_mapping() -> Callable[..., dict[str, Any]]:
    """Makes a run of one target that stands at 40 m; keywords replace its parts."""
    return small_run


class Others:
    """A node in the domain with which a test plays everybody whom the tested one meets."""

    def __init__(self, domain_id: int) -> None:
        # Tests of cores run where ROS is not.
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = rclpy.create_node("others", namespace=names.NAMESPACE, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def spin(self, timeout_s: float = 0.05) -> None:
        self._executor.spin_once(timeout_sec=timeout_s)

    def spin_until(
        self, condition: Callable[[], Any], what: str, limit_s: float = DEADLINE_S
    ) -> None:
        """Spins until a condition holds; in vain, it fails the test."""
        deadline = time.monotonic() + limit_s
        while not condition():
            assert time.monotonic() < deadline, f"{what} did not happen in time"
            self.spin()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.shutdown()


@pytest.fixture
def others(domain: int) -> Iterator[Others]:
    made = Others(domain)
    yield made
    made.close()
