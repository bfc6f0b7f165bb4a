"""Node processes: always gone at the end, whoever dies first."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ssp_core import processes
from ssp_core.errors import HostError
from ssp_core.processes import (
    ProcessGroup,
    domain_ports,
    live_environment,
    remove_shared_ports,
    remove_stale_shared_memory,
    session_environment,
)
from tests.support.processes import is_alive
from tests.support.waiting import DEADLINE_S, until

# A stand-in for a node: says that it is up, and does what the first word of its name says.
NODE = """
import faulthandler, os, signal, sys, time
faulthandler.enable()
kind = sys.argv[sys.argv.index("-r") + 1].removeprefix("__node:=").split("_")[0]
if kind == "stubborn":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if kind == "failing":
    print("what went wrong")
    sys.exit(3)
print("up", os.getpid(), *sys.argv[1:], flush=True)
time.sleep(600)
"""


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"{what} did not happen in {DEADLINE_S:g} s")
        time.sleep(0.01)


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Processes in which ``ssp_fake_node`` is a module."""
    (tmp_path / "ssp_fake_node.py").write_text(NODE)
    env = session_environment(199)
    env["PYTHONPATH"] = os.pathsep.join([str(tmp_path), env.get("PYTHONPATH", "")])
    return env


@pytest.fixture
def group(
    environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[ProcessGroup]:
    """A group with a /dev/shm of its own."""
    shm = tmp_path / "shm"
    shm.mkdir()
    monkeypatch.setattr(processes, "_SHM", shm)
    with ProcessGroup(environment, tmp_path / "logs") as made:
        yield made


def start(group: ProcessGroup, name: str) -> int:
    node = group.start_node(name, "ssp_fake_node", {"run_file": "/a b", "rate": 2})
    wait_until(lambda: "up" in node.log_tail() or node.returncode is not None, f"{name}'s start")
    return node.process.pid


def test_parameters_name_and_log(group: ProcessGroup) -> None:
    start(group, "good_1")
    words = group.processes["good_1"].log_tail()
    assert "--ros-args -r __node:=good_1 -p run_file:=/a b -p rate:=2" in words


def test_a_node_is_in_a_session_of_its_own(group: ProcessGroup) -> None:
    """Control-C in the terminal reaches whoever runs the session, and nobody else."""
    pid = start(group, "good")
    assert os.getsid(pid) == pid != os.getsid(0)


def test_stop_ends_the_willing_with_sigterm(group: ProcessGroup) -> None:
    pids = [start(group, name) for name in ("good_1", "good_2")]
    assert group.stop(timeout_s=DEADLINE_S) == []
    assert not any(is_alive(pid) for pid in pids)
    assert group.processes["good_1"].describe_exit() == "killed by SIGTERM"
    assert group.ended() == []  # it was asked to
    assert group.stop() == []


def test_stop_wakes_the_stopped_so_that_they_end_in_order(group: ProcessGroup) -> None:
    os.kill(start(group, "good"), signal.SIGSTOP)
    assert group.stop() == []
    assert group.processes["good"].describe_exit() == "killed by SIGTERM"


def test_stop_kills_the_stubborn_and_names_it(group: ProcessGroup) -> None:
    pid = start(group, "stubborn")
    good = start(group, "good")
    started = time.monotonic()
    assert group.stop(timeout_s=0.5) == ["stubborn"]
    assert time.monotonic() - started >= 0.5
    assert not is_alive(pid)
    assert not is_alive(good)
    # Its log says where it hung.
    assert "Aborted" in group.processes["stubborn"].log.read_text()
    assert "ssp_fake_node.py" in group.processes["stubborn"].log.read_text()


def test_who_ends_without_being_asked_is_noticed(group: ProcessGroup) -> None:
    start(group, "failing")
    node = group.processes["failing"]
    wait_until(lambda: node.returncode is not None, "the end")
    assert [n.name for n in group.ended()] == ["failing"]
    assert node.describe_exit() == "exited with status 3"
    assert node.log_tail() == "what went wrong"
    pid = start(group, "good")
    assert group.processes["good"].describe_exit() == "still running"
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: len(group.ended()) == 2, "the second end")
    assert group.processes["good"].describe_exit() == "killed by SIGKILL"


PARENT = """
import sys
from pathlib import Path
from ssp_core.processes import ProcessGroup
import os, time
with ProcessGroup(dict(os.environ, ROS_DOMAIN_ID="199"), Path(sys.argv[1])) as group:
    node = group.start_node("good", "ssp_fake_node", {})
    while "up" not in node.log_tail():
        time.sleep(0.01)
    print(node.process.pid, flush=True)
    time.sleep(600)
"""


def test_a_node_dies_with_its_killed_parent(environment: dict[str, str], tmp_path: Path) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path / "logs")],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_alive(child)
    finally:
        parent.kill()
        parent.communicate(timeout=600)
    wait_until(lambda: not is_alive(child), "the node's end")


# -- environment ----------------------------------------------------------------------------------


def test_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.1")
    monkeypatch.setenv("SOMETHING", "kept")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    env = session_environment(42)
    assert env["ROS_DOMAIN_ID"] == "42"
    assert env["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "ROS_STATIC_PEERS" not in env
    assert env["SOMETHING"] == "kept"
    assert "ROS_DOMAIN_ID" not in os.environ or os.environ["ROS_DOMAIN_ID"] != "42"


@pytest.mark.parametrize(("free_mb", "used"), [(63, False), (512, False), (513, True)])
def test_the_profile_needs_room_in_shared_memory(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free_mb: int, used: bool
) -> None:
    class Usage:
        free = free_mb << 20

    monkeypatch.setattr(processes, "_SHM", tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda _: Usage)
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    env = session_environment(42, tmp_path / "profile.xml")
    assert ("FASTRTPS_DEFAULT_PROFILES_FILE" in env) == used


def test_shared_memory_that_is_read_only_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # A file system that is mounted read-only says no to everybody, root included.
    monkeypatch.setattr(processes, "_SHM", tmp_path)
    monkeypatch.setattr("os.access", lambda path, mode: not (path == tmp_path and mode & os.W_OK))
    with pytest.raises(HostError, match=r"must be writable.*--in-process"):
        session_environment(42)
    with pytest.raises(HostError, match="must be writable"):
        live_environment(tmp_path / "profile.xml")


def test_without_shared_memory_nodes_talk_over_udp(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(processes, "_SHM", tmp_path / "none")
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in session_environment(42)


# -- shared memory --------------------------------------------------------------------------------


@pytest.fixture
def shm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(processes, "_SHM", tmp_path)
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
    """With real Fast DDS: its own locks say that it lives, and that it is gone."""

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
