"""Nodes forked from the process that has imported what they need."""

from __future__ import annotations

import os
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ssp_core.errors import HostError
from ssp_core.host.environment import session_environment
from ssp_core.host.forked import ForkedProcess, NodeServer, node_server
from ssp_core.host.node_server import Request
from tests.support.processes.children import is_alive
from tests.support.processes.waiting import until

TELLING = """
import os, sys
os.environ.setdefault("SET_BY_IMPORT", "1")
print("imported in", os.getpid(), file=sys.stderr)

def main():
    print(sys.argv, os.getcwd(), open("/proc/self/comm").read().strip())
    print(*(os.environ.get(name) for name in ("SET_BY_IMPORT", "GIVEN", "PYTHONPATH")))
    for number in range(3, 64):
        try:
            print(os.readlink(f"/proc/self/fd/{number}"), flush=True)
        except FileNotFoundError:
            pass
    sys.exit(int(sys.stdin.readline() or 7))
"""
BRIEF = """
import os

def main():
    os._exit(3)
"""
ENDING = """
import atexit

atexit.register(print, "by its import")

def main():
    atexit.register(print, "by itself")
    return 4
"""
WAITING = """
import time

def main():
    print("up", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    for name, text in {
        "telling": TELLING,
        "waiting": WAITING,
        "brief": BRIEF,
        "ending": ENDING,
        "broken": "import no_such\n",
    }.items():
        (tmp_path / f"ssp_{name}_node.py").write_text(text)
    env = session_environment(199)
    env["PYTHONPATH"] = os.pathsep.join(filter(None, (str(tmp_path), env.get("PYTHONPATH"))))
    return env


@pytest.fixture
def server(environment: dict[str, str]) -> NodeServer:
    return NodeServer(environment)


class Started:
    """A node, and what it has written."""

    def __init__(
        self,
        server: NodeServer,
        environment: dict[str, str],
        folder: Path,
        kind: str,
        *,
        pipe: bool = False,
    ) -> None:
        self.log = folder / f"{kind}.log"
        module = f"ssp_{kind}_node"
        request = Request(f"{kind}_with_a_long_name", module, ["-a"], environment, str(folder))
        with self.log.open("wb") as stream:
            self.process: ForkedProcess = server.start(request, stream.fileno(), pipe=pipe)

    def up(self) -> Started:
        until(lambda: "up" in self.log.read_text(), "the node's start")
        return self


def test_a_node_has_its_own_variables_folder_name_and_no_open_file_of_others(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    Started(server, environment, tmp_path, "waiting").up()
    given = {**environment, "GIVEN": "here"}
    told = Started(server, given, tmp_path, "telling")
    assert told.process.wait(600) == 7
    assert told.process.stdin is None
    said = told.log.read_text().splitlines()
    assert said[0] == f"['ssp_telling_node', '-a'] {tmp_path} telling_with_a_"
    assert said[1] == f"1 here {environment['PYTHONPATH']}"
    # Beside input, output and error libraries may have files of their own, as libffi has.
    assert all(Path(file).name.startswith("lib") for file in said[2:]), said


def test_what_was_registered_for_the_end_is_called_in_the_fork(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    """Handlers of what the server imports, too: they end processes and remove folders."""
    ending = Started(server, environment, tmp_path, "ending")
    assert ending.process.wait(600) == 4
    assert ending.log.read_text().splitlines() == ["by itself", "by its import"]


def test_a_node_reads_from_its_pipe(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    told = Started(server, environment, tmp_path, "telling", pipe=True)
    assert told.process.poll() is None
    assert told.process.stdin is not None
    told.process.stdin.write(b"5\n")
    told.process.stdin.close()
    assert told.process.wait(600) == 5
    assert told.process.poll() == 5


def test_what_can_not_be_imported_says_so_in_its_log(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    broken = Started(server, environment, tmp_path, "broken")
    assert broken.process.wait(600) == 1
    assert "No module named 'no_such'" in broken.log.read_text()
    # The server goes on.
    Started(server, environment, tmp_path, "waiting").up()


def test_signals_reach_a_node_until_it_has_ended(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    first, second = (Started(server, environment, tmp_path, "waiting").up() for _ in range(2))
    with pytest.raises(subprocess.TimeoutExpired):
        first.process.wait(0.0)
    second.process.kill()
    first.process.terminate()
    assert first.process.wait(600) == -signal.SIGTERM
    assert second.process.wait(600) == -signal.SIGKILL
    first.process.terminate()  # which is nobody's process any more


def test_a_node_may_have_ended_before_anybody_looks(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    nodes = [Started(server, environment, tmp_path, "brief") for _ in range(50)]
    assert {node.process.wait(600) for node in nodes} == {3}


def test_several_threads_await_one_node(
    server: NodeServer, environment: dict[str, str], tmp_path: Path
) -> None:
    node = Started(server, environment, tmp_path, "waiting").up()
    with ThreadPoolExecutor(4) as threads:
        waiting = [threads.submit(node.process.wait, 600) for _ in range(4)]
        node.process.kill()
        assert {one.result() for one in waiting} == {-signal.SIGKILL}


def test_nodes_end_with_their_server_and_the_next_has_a_new_one(
    environment: dict[str, str], tmp_path: Path
) -> None:
    server = node_server(environment)
    assert node_server({**environment, "ROS_DOMAIN_ID": "5", "TMPDIR": "/x"}) is server
    assert node_server({**environment, "RMW_IMPLEMENTATION": "another"}) is not server
    server = node_server(environment)
    node = Started(server, environment, tmp_path, "waiting").up()
    parent = int(Path(f"/proc/{node.process.pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
    os.kill(parent, signal.SIGKILL)
    assert node.process.wait(600) == -signal.SIGTERM
    with pytest.raises(HostError, match="starts nodes doesn't answer"):
        Started(server, environment, tmp_path, "waiting")
    until(lambda: not server.is_there, "the server's end")
    assert node_server(environment) is not server


def test_a_server_ends_when_nobody_holds_it_or_its_nodes(
    environment: dict[str, str], tmp_path: Path
) -> None:
    node = Started(NodeServer(environment), environment, tmp_path, "waiting").up()
    parent = int(Path(f"/proc/{node.process.pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
    assert is_alive(parent)
    pid = node.process.pid
    del node
    until(lambda: not is_alive(parent), "the server's end")
    until(lambda: not is_alive(pid), "the node's end")
