"""Shared memory: what dead participants left there goes, and what lives there stays."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ssp_core.host import shared_memory
from ssp_core.host.environment import session_environment
from ssp_core.host.ports import domain_ports
from ssp_core.host.processes import ProcessGroup
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from tests.support.processes.waiting import until


@pytest.fixture
def shm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(shared_memory, "_SHM", tmp_path)
    return tmp_path


def put(shm: Path, *names: str) -> None:
    for name in names:
        (shm / name).write_bytes(b"")


def names(shm: Path) -> list[str]:
    return sorted(p.name for p in shm.iterdir())


def make_old(shm: Path, *names: str) -> None:
    for name in names:
        os.utime(shm / name, (0, 0))


def test_stale_segments_go_and_live_ones_stay(shm: Path) -> None:
    put(shm, "fastrtps_dead", "fastrtps_dead_el", "fastrtps_live", "fastrtps_live_el")
    put(shm, "fastrtps_port7400", "psm_others", "fastrtps_without_lock", "x_el")
    make_old(shm, "fastrtps_dead_el", "fastrtps_live_el")
    with (shm / "fastrtps_live_el").open("rb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        assert remove_stale_shared_memory() == 1
        left = ["fastrtps_live", "fastrtps_live_el", "fastrtps_port7400", "fastrtps_without_lock"]
        assert names(shm) == [*left, "psm_others", "x_el"]
    assert remove_stale_shared_memory() == 1
    assert "fastrtps_live" not in names(shm)


def test_a_new_segment_stays_while_its_owner_may_not_have_locked_it_yet(shm: Path) -> None:
    put(shm, "fastrtps_new", "fastrtps_new_el")
    assert remove_stale_shared_memory() == 0
    assert names(shm) == ["fastrtps_new", "fastrtps_new_el"]
    make_old(shm, "fastrtps_new_el")
    assert remove_stale_shared_memory() == 1


def test_ports_go_when_nobody_lives_in_their_domain(shm: Path) -> None:
    """A live participant holds the lock of a port of its domain, of which others may be newer."""

    def port(number: int, *kinds: str) -> list[str]:
        name = f"fastrtps_port{number}"
        return [{"P": name, "M": f"sem.{name}_mutex"}.get(k, f"{name}_{k}") for k in kinds]

    dead = [*port(12400, "P", "M", "sl"), *port(12411, "P", "M", "el"), *port(12413, "M")]
    live = [*port(12650, "P", "M", "sl"), *port(12661, "P", "M"), *port(12663, "M")]
    new = [*port(12900, "P", "M")]
    put(shm, *dead, *live)
    make_old(shm, *dead, *live)
    put(shm, *new)
    with (shm / "fastrtps_port12650_sl").open("rb") as owner:
        fcntl.flock(owner, fcntl.LOCK_SH)
        assert remove_stale_shared_memory() == 0  # no segments
        assert names(shm) == sorted([*live, *new])
    remove_stale_shared_memory()
    assert names(shm) == sorted(new)


def test_ports_of_one_domain_go(shm: Path) -> None:
    put(shm, "fastrtps_port12400", "sem.fastrtps_port12400_mutex", "fastrtps_port12650")
    remove_shared_ports(20)
    assert names(shm) == ["fastrtps_port12650"]


def test_new_ports_of_a_domain_that_is_held_go_unless_one_lives(
    shm: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each participant of a session waited seconds for what a killed one had just left."""
    dead = ["fastrtps_port12400", "sem.fastrtps_port12400_mutex", "fastrtps_port12411_el"]
    other = ["fastrtps_port12650", "fastrtps_new", "fastrtps_new_el"]
    put(shm, *dead, *other)

    def begin() -> None:
        logs = tmp_path_factory.mktemp("logs")
        with ProcessGroup({"ROS_DOMAIN_ID": "20"}, logs, owns_domain=False):
            assert names(shm) == sorted([*dead, *other])
        group = ProcessGroup({"ROS_DOMAIN_ID": "20"}, logs)
        group.__enter__()

    with (shm / dead[-1]).open("rb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        begin()
        assert names(shm) == sorted([*dead, *other])
    begin()
    assert names(shm) == sorted(other)


LISTENER = """
import os, sys, time
import rclpy
from rclpy.node import Node
from std_msgs.msg import String
rclpy.init()
node = Node("listener")
node.create_subscription(String, "nothing", print, 1)
print("up", flush=True)
time.sleep(600)
"""


@pytest.mark.ros
def test_segments_of_a_live_participant_are_left_alone() -> None:
    """The locks of real Fast DDS tell whether the participant lives."""

    def segments() -> set[str]:
        return {p.name for p in Path("/dev/shm").glob("fastrtps_*_el") if "port" not in p.name}

    def old_ports() -> list[Path]:
        found = [p for n in domain_ports(198) for p in Path("/dev/shm").glob(f"*_port{n}*")]
        for port in found:
            os.utime(port, (0, 0))
        assert found
        return found

    before = segments()
    process = subprocess.Popen(
        [sys.executable, "-c", LISTENER],
        env=session_environment(198),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        maps = Path(f"/proc/{process.pid}/maps").read_text()
        ours = {name for name in segments() - before if name.removesuffix("_el") in maps}
        assert ours
        make_old(Path("/dev/shm"), *ours)
        ports = old_ports()
        remove_stale_shared_memory()
        assert ours <= segments()
        assert [port for port in ports if not port.exists()] == []
    finally:
        process.kill()
        process.communicate(timeout=600)

    def all_gone() -> bool:
        remove_stale_shared_memory()  # another session's end may do so just now, and hold a lock
        return not ours & segments() and not any(port.exists() for port in ports)

    until(all_gone, "removal of the segments and ports of the killed one")
