"""Two hosts on one machine, and what is measured of an object that stops on one of them.

Hosts are network namespaces that meet on a bridge in a third one, without multicast: to cut the
link, a port is taken off the bridge, and both hosts' interfaces stay up.
"""

from __future__ import annotations

import math
import subprocess
import time
from itertools import pairwise
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.model import load_run
from ssp_core.safety.stopping import stopping_of
from ssp_scenario_manager.run.over_dds.processor_waits import waited_ns

MANAGERS, OBJECTS = "10.77.0.1", "10.77.0.2"
# A busy machine may run a process that late; the bound itself knows of no such thing.
BUSY_S = 0.5
# An object that has lost this much of its speed brakes.
BRAKED_SHARE = 0.9
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


class Cut:
    """The link's end while an object drives, up to where the object brakes.

    Args:
        stage: of the session.
        network: whose link is cut.
        processes: that move the object.
    """

    def __init__(self, stage: Any, network: Network, *processes: subprocess.Popen[Any]) -> None:
        before_ns = [waited_ns(process.pid) or 0 for process in processes]
        self.began_ns = time.time_ns()
        network.cut()
        took_ns = time.time_ns() - self.began_ns

        def brakes() -> bool:
            speeds = [row.speed_mps for row in stage.rows() if row.time_ns >= self.began_ns]
            return bool(speeds) and speeds[-1] < BRAKED_SHARE * max(speeds)

        stage.wait_for(brakes, "the object to brake")
        after_ns = [waited_ns(process.pid) or 0 for process in processes]
        kept_ns = sum(max(0, b - a) for a, b in zip(before_ns, after_ns, strict=True))
        # Cutting takes a process of its own, and one after the other waits for a processor.
        self.late_s = ns_to_seconds(took_ns + kept_ns)


def stops_inside_the_bound(stage: Any, cut: Cut) -> None:
    """Measured on the other host: from the cut to standstill, by the body's true states."""
    spec = load_run(stage.folder / "run" / "run.yaml")
    stage.wait_for(lambda: stage.last_row().speed_mps == 0.0, "the object's standstill")
    since = [row for row in stage.rows() if row.time_ns >= cut.began_ns]
    stood = next(i for i, row in enumerate(since) if row.speed_mps == 0.0)
    way = since[: stood + 1]
    went_m = sum(math.dist((p.x_m, p.y_m), (q.x_m, q.y_m)) for p, q in pairwise(way))
    fastest = max(row.speed_mps for row in way)
    stopping = stopping_of(spec.targets[0].cls, spec.limits, spec.step_s)
    bound_m = stopping.distance_m(fastest, spec.limits.heartbeat_s + BUSY_S + cut.late_s)
    print(
        f"stopped {went_m:.2f} m after the cut at {fastest:.2f} m/s, bound {bound_m:.2f} m, "
        f"{cut.late_s:.3f} s of it for the machine"
    )
    assert went_m <= bound_m
    assert all(row.speed_mps == 0.0 for row in since[stood:])


def stands_after_the_link_is_back(stage: Any, network: Network) -> None:
    """The object goes on standing when its link returns: this session's manager has gone."""
    network.join()
    stands = stage.rows()[-1]
    until_ns = time.time_ns() + int(AFTERWARDS_S * 1e9)
    stage.wait_for(lambda: stage.last_row().time_ns > until_ns, "states after the link's return")
    after = stage.rows()[-1]
    assert (after.speed_mps, after.x_m, after.y_m) == (0.0, stands.x_m, stands.y_m)
