"""Node processes: always gone at the end, in whatever order processes die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from ssp_core.host import shared_memory
from ssp_core.host.environment import session_environment
from ssp_core.host.processes import ProcessGroup
from tests.support.processes.children import is_alive
from tests.support.processes.waiting import DEADLINE_S, until

# A stand-in for a node: says that it is up, and does what the first word of its name says.
NODE = """
import faulthandler, os, signal, sys, time

def main():
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


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Processes in which ``ssp_fake_node`` is a module."""
    (tmp_path / "ssp_fake_node.py").write_text(NODE)
    env = session_environment(199)
    env["PYTHONPATH"] = os.pathsep.join(filter(None, (str(tmp_path), env.get("PYTHONPATH"))))
    return env


@pytest.fixture
def group(
    environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[ProcessGroup]:
    """A group with a /dev/shm of its own."""
    shm = tmp_path / "shm"
    shm.mkdir()
    monkeypatch.setattr(shared_memory, "_SHM", shm)
    with ProcessGroup(environment, tmp_path / "logs") as made:
        yield made


def start(group: ProcessGroup, name: str) -> int:
    node = group.start_node(name, "ssp_fake_node", {"run_file": "/a b", "rate": 2})

    def is_up() -> bool:
        text = node.log.read_text()  # which may be written word by word
        return ("up" in text and text.endswith("\n")) or node.returncode is not None

    until(is_up, f"{name}'s start")
    return node.process.pid


def test_parameters_name_and_log(group: ProcessGroup) -> None:
    start(group, "good_1")
    words = group.processes["good_1"].log_tail()
    assert "--ros-args -r __node:=good_1 -p run_file:=/a b -p rate:=2" in words


def test_a_node_is_in_a_session_of_its_own(group: ProcessGroup) -> None:
    """Control-C in the terminal reaches only the process that runs the session."""
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


@pytest.mark.parametrize("fails", [False, True])
def test_what_is_left_is_done_when_all_processes_have_ended(
    environment: dict[str, str], tmp_path: Path, fails: bool
) -> None:
    alive: list[bool] = []
    with suppress(RuntimeError), ProcessGroup(environment, tmp_path / "logs") as made:
        pid = start(made, "willing")
        made.after_end.callback(lambda: alive.append(is_alive(pid)))
        if fails:
            raise RuntimeError
    assert alive == [False]


def test_who_ends_without_being_asked_is_noticed(group: ProcessGroup) -> None:
    start(group, "failing")
    node = group.processes["failing"]
    until(lambda: node.returncode is not None, "the end")
    assert [n.name for n in group.ended()] == ["failing"]
    assert node.describe_exit() == "exited with status 3"
    assert node.log_tail() == "what went wrong"
    pid = start(group, "good")
    assert group.processes["good"].describe_exit() == "still running"
    os.kill(pid, signal.SIGKILL)
    until(lambda: len(group.ended()) == 2, "the second end")
    assert group.processes["good"].describe_exit() == "killed by SIGKILL"


@pytest.mark.parametrize("name", ["ssp_core", "yaml"])
def test_no_code_of_the_working_folder_runs_in_a_node(
    group: ProcessGroup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "ssp_importing_node.py").write_text(
        "import ssp_core, yaml\ndef main(): print('up')\n"
    )
    astray = tmp_path / "astray"
    astray.mkdir()
    (astray / f"{name}.py").write_text("raise SystemExit(f'{__file__} ran')\n")
    monkeypatch.chdir(astray)
    node = group.start_node("good", "ssp_importing_node", {})
    assert node.process.wait(600) == 0, node.log_tail()
    assert node.log_tail() == "up"


PARENT = """
import sys
from pathlib import Path
from ssp_core.host.processes import ProcessGroup
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
    until(lambda: not is_alive(child), "the node's end")
