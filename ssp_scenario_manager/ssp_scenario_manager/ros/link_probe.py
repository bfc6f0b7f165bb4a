"""Two nodes in two processes that answer each other: can DDS be used on this host?"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import rclpy
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.errors import HostError
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import adopt, session_environment
from ssp_core.host.processes import ProcessGroup
from ssp_msgs.msg import Heartbeat
from ssp_scenario_manager.doctor.checks import LinkMeasurement

PING, PONG = "doctor/ping", "doctor/pong"
MATCH_TIMEOUT_S = 10.0
ROUND_TRIPS = 200
ANSWER_TIMEOUT_S = 1.0


class Echo(Node):
    """Sends every ping back."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__("doctor_echo", namespace=names.NAMESPACE)
        publisher = self.create_publisher(Heartbeat, PONG, ros.STATE)
        self.create_subscription(Heartbeat, PING, publisher.publish, ros.STATE)


def measure_link() -> LinkMeasurement:
    """Start an echo process in a free domain and measure discovery and round trips.

    Raises:
        HostError: the processes don't find each other, or no domain is free.
    """
    with free_domain() as domain_id, tempfile.TemporaryDirectory(prefix="ssp-doctor-") as folder:
        env = session_environment(domain_id)
        adopt(env)
        context = rclpy.Context()
        ros.init(context=context, domain_id=domain_id)
        try:
            with ProcessGroup(env, Path(folder)) as group:
                group.start_node("doctor_echo", "ssp_scenario_manager.ros.link_probe", {})
                return _measure(context, group)
        finally:
            rclpy.shutdown(context=context)


def _measure(context: rclpy.Context, group: ProcessGroup) -> LinkMeasurement:
    node = Node("doctor", namespace=names.NAMESPACE, context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    answers: list[int] = []

    def take(message: Heartbeat) -> None:
        answers.append(message.sequence)

    node.create_subscription(Heartbeat, PONG, take, ros.STATE)
    ping = node.create_publisher(Heartbeat, PING, ros.STATE)
    started = time.monotonic()
    # Both directions must be matched: an answer to a ping is the proof.
    while not answers:
        ping.publish(Heartbeat(sequence=0))
        executor.spin_once(timeout_sec=0.05)
        if group.ended():
            raise HostError("the echo process died: " + group.ended()[0].log_tail(3))
        if time.monotonic() - started > MATCH_TIMEOUT_S:
            raise HostError(f"two processes did not find each other in {MATCH_TIMEOUT_S:g} s")
    matched_s = time.monotonic() - started
    times_ms, lost = [], 0
    for number in range(1, ROUND_TRIPS + 1):
        sent = time.monotonic()
        ping.publish(Heartbeat(sequence=number))
        while answers[-1] != number and time.monotonic() - sent < ANSWER_TIMEOUT_S:
            executor.spin_once(timeout_sec=0.05)
        if answers[-1] == number:
            times_ms.append((time.monotonic() - sent) * 1e3)
        else:
            lost += 1
    executor.shutdown()
    node.destroy_node()
    times_ms.sort()
    if not times_ms:
        raise HostError("the processes found each other, and every message was lost")
    return LinkMeasurement(
        matched_s,
        times_ms[len(times_ms) // 2],
        times_ms[int(0.99 * (len(times_ms) - 1))],
        ROUND_TRIPS,
        lost,
    )


def main() -> None:
    """Run the echo process."""
    sys.exit(ros.run_node(Echo, lambda _node: None))


if __name__ == "__main__":
    main()
