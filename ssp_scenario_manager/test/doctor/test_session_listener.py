"""Hearing of a session over ROS, for ``ssp doctor --session``."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ssp_core import names
from ssp_core.host.domains import free_domain
from ssp_core.host.shared_memory import remove_shared_ports
from ssp_core.run_file.model import RunSpec

rclpy = pytest.importorskip("rclpy")
msg = pytest.importorskip("ssp_msgs.msg")
listener = pytest.importorskip("ssp_scenario_manager.ros.session_listener")
Odometry = pytest.importorskip("nav_msgs.msg").Odometry

pytestmark = pytest.mark.ros
ODOMETRY = "/ins/odometry"


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain of the test's own, of which nothing is left."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        yield domain_id
        remove_shared_ports(domain_id)


def test_second_publishers_of_an_object_and_of_the_receiver_are_strangers(
    run: RunSpec, domain: int
) -> None:
    """The manager refused to arm for them, and the doctor found nothing."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        nodes = [
            rclpy.create_node(name, namespace=names.NAMESPACE, context=context)
            for name in ("ours", "intruder")
        ]
        doubled = {names.state_topic("ot1"): msg.ObjectState, ODOMETRY: Odometry}
        for topic, kind in doubled.items():
            for node in nodes:
                node.create_publisher(kind, topic, 1)
        nodes[0].create_publisher(msg.Heartbeat, names.HEARTBEAT, 1)
        spec = run.model_copy(update={"mode": "live"})
        heard = listener.listen(spec, 0.1, lambda _: None, ODOMETRY)
    finally:
        rclpy.shutdown(context=context)
    assert heard.strangers == {
        topic: (1, f"{topic} has /ssp/intruder and /ssp/ours") for topic in doubled
    }
