"""Manager and VUT on one host, the object on another, and the link between them cut mid-run.

Hosts are network namespaces that meet on a bridge in a third one, without multicast: to cut the
link, a port is taken off the bridge, and both hosts' interfaces stay up.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import ssp_core
from ssp_core.run_file.model import load_run
from ssp_core.safety.stopping import stopping_of

pytestmark = [pytest.mark.ros, pytest.mark.system]

SERVER_PORT = 11811
MANAGERS, OBJECTS = "10.77.0.1", "10.77.0.2"
BODY_PORT = "9001"
# A busy machine may run a process that late; the bound itself knows of no such thing.
BUSY_S = 0.5
# The link comes back, and whatever might start again has the time to.
AFTERWARDS_S = 3.0


class Network:
    """Two namespaces and the bridge between them.

    Args:
        name: that the names of the three begin with.
    """

    def __init__(self, name: str) -> None:
        self.a, self.b, self._switch = (f"{name}{host}" for host in "abs")

    def make(self) -> None:
        """Raises CalledProcessError where namespaces, veth or bridges may not be made."""
        for name in (self.a, self.b, self._switch):
            _ip("netns", "add", name)
            _ip("-n", name, "link", "set", "lo", "up")
        _ip("-n", self._switch, "link", "add", "br0", "type", "bridge")
        _ip("-n", self._switch, "link", "set", "br0", "up")
        for host, address in ((self.a, MANAGERS), (self.b, OBJECTS)):
            port = ("peer", "name", f"to{host[-1]}", "netns", self._switch)
            _ip("link", "add", "eth0", "netns", host, "type", "veth", *port)
            _ip("-n", self._switch, "link", "set", f"to{host[-1]}", "master", "br0", "up")
            _ip("-n", host, "addr", "add", f"{address}/24", "dev", "eth0")
            _ip("-n", host, "link", "set", "eth0", "up", "multicast", "off")

    def cut(self) -> None:
        _ip("-n", self._switch, "link", "set", "tob", "nomaster")

    def join(self) -> None:
        _ip("-n", self._switch, "link", "set", "tob", "master", "br0")

    def remove(self) -> None:
        for name in (self.a, self.b, self._switch):
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


def on(host: str) -> list[str]:
    return ["ip", "netns", "exec", host]


@pytest.fixture
def network() -> Iterator[Network]:
    made = Network(f"ssp{os.getpid() % 100000}")
    try:
        made.make()
    except FileNotFoundError:
        pytest.skip("two hosts: this machine has no `ip` (iproute2)")
    except subprocess.CalledProcessError as error:
        made.remove()
        pytest.skip(f"two hosts: no network namespaces may be made here: {error.stderr.strip()}")
    yield made
    made.remove()


@pytest.fixture
def stage(network: Network, make_stage: Callable[[dict[str, str]], Any]) -> Iterator[Any]:
    profile = Path(ssp_core.__file__).parent / "config" / "fastdds_hosts.xml"
    made = make_stage(
        {
            "ROS_DOMAIN_ID": "7",
            "ROS_DISCOVERY_SERVER": f"{MANAGERS}:{SERVER_PORT}",
            "ROS_SUPER_CLIENT": "TRUE",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        }
    )
    server = ["fast-discovery-server", "-i", "0", "-l", MANAGERS, "-p", str(SERVER_PORT)]
    made.start("discovery_server", server, on(network.a))
    yield made
    made.close()


def test_the_link_is_cut_while_an_object_drives(
    network: Network, stage: Any, task: Callable[[str], Path]
) -> None:
    run = stage.run_live(task("cut_in"), "--no-camera", host=on(network.a))
    start_object(stage, network)
    stage.play("vut", "--play", "vut", host=on(network.a))
    stage.ask_doctor(host=on(network.a))
    stage.begin(run)
    stage.wait_for_motion(run, 5.0)
    cut_ns = time.time_ns()
    network.cut()
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result
    reasons = " ".join(result["reasons"])
    silence = ("object_silent", "reply_missing", "state_stale")
    assert any(name in reasons for name in silence), reasons
    stops_inside_the_bound(stage, cut_ns)
    # The manager of this session has gone; another host's link comes back to nobody.
    network.join()
    stands = stage.rows()[-1]
    until_ns = time.time_ns() + int(AFTERWARDS_S * 1e9)
    stage.wait_for(lambda: stage.rows()[-1].time_ns > until_ns, "states after the link's return")
    after = stage.rows()[-1]
    assert (after.speed_mps, after.x_m, after.y_m) == (0.0, stands.x_m, stands.y_m)


def start_object(stage: Any, network: Network) -> None:
    run_file = stage.folder / "run" / "run.yaml"
    parts = ("--play", "bodies", "--host", OBJECTS, "--first-port", BODY_PORT)
    stage.play("bodies", *parts, "--log", str(stage.log), host=on(network.b))
    command = [sys.executable, "-m", "ssp_ot_controller.ros.object_target", "--ros-args"]
    command += ["-r", "__node:=object_target", "-p", f"run_file:={run_file}"]
    command += ["-p", f"bodies:=ot1=udp://{OBJECTS}:{BODY_PORT}"]
    stage.start("object_target", command, on(network.b))


def stops_inside_the_bound(stage: Any, cut_ns: int) -> None:
    """Measured on the other host: from the cut to standstill, by the body's true states."""
    spec = load_run(stage.folder / "run" / "run.yaml")
    stage.wait_for(lambda: stage.rows()[-1].speed_mps == 0.0, "the object's standstill")
    since = [row for row in stage.rows() if row.time_ns >= cut_ns]
    stood = next(i for i, row in enumerate(since) if row.speed_mps == 0.0)
    way = since[: stood + 1]
    went_m = sum(math.dist((p.x_m, p.y_m), (q.x_m, q.y_m)) for p, q in pairwise(way))
    fastest = max(row.speed_mps for row in way)
    stopping = stopping_of(spec.targets[0].cls, spec.limits, spec.step_s)
    bound_m = stopping.distance_m(fastest, spec.limits.heartbeat_s + BUSY_S)
    print(f"stopped {went_m:.2f} m after the cut at {fastest:.2f} m/s, bound {bound_m:.2f} m")
    assert went_m <= bound_m
    assert all(row.speed_mps == 0.0 for row in since[stood:])
