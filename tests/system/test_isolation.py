"""A simulated session and a live one on one discovery server don't meet by their environments."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import live_environment, session_environment
from tests.support.processes.waiting import DEADLINE_S

pytestmark = pytest.mark.ros

_CONFIG = Path(__file__).resolve().parents[2] / "ssp_msgs" / "ssp_core" / "config"
_HEARD = 20

# Publishes until its input ends.
TALKER = """
import select, sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/isolation", 10)
print("up", flush=True)
while not select.select([sys.stdin], [], [], 0.05)[0]:
    publisher.publish(String(data="live"))
"""
# Says how many messages came: at the number given, and when its input ends.
LISTENER = """
import select, sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
heard = []
node.create_subscription(String, "/isolation", heard.append, 10)
print("up", flush=True)
told = False
while not select.select([sys.stdin], [], [], 0.0)[0]:
    rclpy.spin_once(node, timeout_sec=0.05)
    if not told and len(heard) >= int(sys.argv[1]):
        told = True
        print(len(heard), flush=True)
print("end", len(heard), flush=True)
"""


class Processes:
    """Nodes in processes of their own, all ended with the block."""

    def __init__(self) -> None:
        self.started: list[subprocess.Popen[str]] = []

    def start(self, env: dict[str, str], *command: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.started.append(process)
        return process

    def node(self, env: dict[str, str], code: str) -> subprocess.Popen[str]:
        """Starts a node and waits until it is up."""
        process = self.start(env, sys.executable, "-c", code, str(_HEARD))
        assert next_line(process) == "up", "the node didn't start"
        return process

    def close(self) -> None:
        for process in self.started:
            process.kill()
            process.communicate()


@pytest.fixture
def processes() -> Iterator[Processes]:
    made = Processes()
    yield made
    made.close()


def next_line(process: subprocess.Popen[str]) -> str:
    """The node's next line; the middleware's log of contested ports goes to the same stream."""
    assert process.stdout is not None
    return next((line.strip() for line in process.stdout if "RTPS" not in line), "")


def say_end(process: subprocess.Popen[str]) -> str:
    out, _ = process.communicate(timeout=DEADLINE_S)
    return out.splitlines()[-1]


def test_simulated_sessions_hear_nothing_of_a_live_one(
    processes: Processes, discovery_server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One in its domain, and one in another."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    with free_domain() as domain, free_domain() as other:
        monkeypatch.setenv("ROS_DISCOVERY_SERVER", discovery_server)
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        live = live_environment(_CONFIG / "fastdds_hosts.xml")
        profile = _CONFIG / "fastdds_one_host.xml"
        aside = [
            processes.node(session_environment(one, profile), LISTENER) for one in (domain, other)
        ]
        processes.node(live, TALKER)
        # With a discovery server a domain of one's own keeps nobody out, so this one hears it.
        control = processes.node({**live, "ROS_DOMAIN_ID": str(other)}, LISTENER)
        assert int(next_line(control)) >= _HEARD
        assert [say_end(process) for process in aside] == ["end 0", "end 0"]
