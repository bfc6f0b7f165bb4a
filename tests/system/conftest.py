"""Sessions in processes of their own, started through the command line as a user does."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from tests.support.bags.messages import last_speeds
from tests.system.recordings import Recordings, change_on_site

START_DEADLINE_S = 300.0
END_DEADLINE_S = 300.0
EVENTS = ("cut_in", "vru_crossing")
Beside = Callable[..., subprocess.Popen[str]]
LiveProcesses = Callable[[Path], dict[str, int]]
# In lockstep, and with a trigger that never fires: a run that lasts until it is struck.
LONG_S = 600.0  # the recorder wants room for all of it
LONG = """schema: ssp.faults/1
faults: [{kind: trigger_never, at_s: 0.0}]
"""


def ssp_command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "ssp_core.cli", *arguments]


def processes_of(folder: Path) -> dict[str, int]:
    """Live processes of a run: pid by node name, and by last argument those that name its folder.

    A node writes into its log there; its command line is that of the process it was forked from.
    """
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
            output = (entry / "fd" / "1").readlink()
        except OSError:
            continue
        if state == "Z":
            continue
        if output.suffix == ".log" and output.is_relative_to(folder.resolve()):
            found[output.stem] = int(entry.name)
        elif any(str(folder) in word for word in words):
            found[words[-1]] = int(entry.name)
    return found


@dataclass
class Session:
    """One ``ssp run`` under way; what it printed is in ``out`` once it has ended."""

    folder: Path
    process: subprocess.Popen[str]
    lines: list[str]
    out: str = ""

    def wait_for(self, text: str) -> None:
        """Reads what the run says until a line holds the text, or finds it in what was read."""
        if any(text in line for line in self.lines):
            return
        deadline = time.monotonic() + START_DEADLINE_S
        if self.process.stderr is None:
            raise RuntimeError("the run's standard error is not a pipe")
        for line in self.process.stderr:
            self.lines.append(line)
            if text in line:
                return
            if time.monotonic() > deadline:
                break
        pytest.fail(f"no line with {text!r} came; there were:\n{''.join(self.lines)}")

    def wait_for_process(self, node: str) -> None:
        """Waits until this node's process has been started; the run itself gives up on it."""
        while node not in processes_of(self.folder):
            assert self.process.poll() is None, f"the run ended before {node} was started"
            time.sleep(0.1)

    def kill(self, node: str, number: signal.Signals = signal.SIGKILL) -> None:
        os.kill(self.pid_of(node), number)

    def pid_of(self, node: str) -> int:
        return processes_of(self.folder)[node]

    def finish(self) -> dict[str, Any]:
        """Waits for the end and returns result.json."""
        if self.process.stderr is not None and self.process.stderr.closed:
            self.process.wait(END_DEADLINE_S)
        else:
            self.out, err = self.process.communicate(timeout=END_DEADLINE_S)
            self.lines += [self.out, err]
        result: dict[str, Any] = json.loads((self.folder / "result.json").read_text())
        return result


def aborted_by(name: str, session: Session, live_processes: LiveProcesses) -> dict[str, Any]:
    """Fails unless a signal ended the session in good order; returns result.json.

    Nothing moves or runs any more, and the bag is closed.
    """
    result = session.finish()
    assert session.process.returncode == 1
    assert result["verdict"] == "aborted"
    assert result["reasons"][0] == f"interrupted by {name}"
    # Of the nodes; what a test started beside them ends with it.
    assert live_processes(session.folder) == {}
    assert (session.folder / "bag" / "metadata.yaml").is_file()
    assert max(last_speeds(session.folder / "bag").values()) < 0.05
    return result


def in_terminal(command: list[str]) -> subprocess.Popen[str]:
    """The command in a terminal of its own, which closing the process's ``stderr`` closes."""
    master, slave = pty.openpty()

    def own() -> None:
        fcntl.ioctl(slave, termios.TIOCSCTTY, 0)
        # Of the tests' own terminal nothing is to be known: they may have been started by nohup.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    process: subprocess.Popen[str] = subprocess.Popen(
        command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True, preexec_fn=own
    )
    os.close(slave)
    process.stderr = os.fdopen(master)
    return process


@pytest.fixture
def start_session(tmp_path: Path, recordings: Recordings) -> Iterator[Any]:
    """Starts ``ssp run`` in a folder of the test; nothing of it outlives the test.

    A shipped event is compiled once for all of them.
    """
    started: list[Session] = []

    def start(
        scenario: str = "cut_in",
        *arguments: str,
        name: str = "run",
        folder: Path | None = None,
        terminal: bool = False,
        enter: tuple[str, ...] = (),
    ) -> Session:
        folder = folder or tmp_path / name
        what = str(recordings.task(scenario)) if scenario in EVENTS else scenario
        command = [*enter, *ssp_command("run", what, "--out", str(folder), *arguments)]
        if terminal:
            process = in_terminal(command)
        else:
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        session = Session(folder, process, [])
        started.append(session)
        return session

    yield start
    for session in started:
        if session.process.poll() is None:
            session.process.kill()
            session.process.communicate()
        for pid in processes_of(session.folder).values():
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.kill(pid, signal.SIGKILL)


@pytest.fixture
def beside() -> Iterator[Beside]:
    """Starts a process in the ROS domain of a session, and waits for its first line.

    As soon as the session's own processes are started: both come up together.
    """
    started: list[subprocess.Popen[str]] = []

    def start(session: Any, *command: str) -> subprocess.Popen[str]:
        session.wait_for_process(names.OBJECT_TARGET)
        pid = session.pid_of(names.OBJECT_TARGET)
        told = Path(f"/proc/{pid}/environ").read_text().split("\0")
        env = dict(item.split("=", 1) for item in told if "=" in item)
        process = subprocess.Popen(
            [sys.executable, *command],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline()
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def start_long_session(
    start_session: Any, tmp_path: Path, recordings: Recordings
) -> Callable[..., Any]:
    """Starts one that lasts until it is struck."""

    def start(*arguments: str, **how: Any) -> Any:
        (tmp_path / "long.yaml").write_text(LONG)
        task = tmp_path / "long-task"
        if not task.exists():
            shutil.copytree(recordings.task("cut_in"), task)
            limits = {"end.at_latest_s": LONG_S, "limits.duration_s": LONG_S}
            change_on_site(task, limits, reason="the machine may be busy")
        return start_session(str(task), "--faults", str(tmp_path / "long.yaml"), *arguments, **how)

    return start


@pytest.fixture
def long_session(start_long_session: Any) -> Callable[..., Any]:
    """Starts one, up to where everybody is about to drive."""

    def start(*arguments: str, **how: Any) -> Any:
        session = start_long_session(*arguments, **how)
        session.wait_for("phase approach")
        return session

    return start


@pytest.fixture
def live_processes() -> Any:
    return processes_of


@pytest.fixture
def discovery_server() -> Iterator[str]:
    """A discovery server of this middleware on this host; its address."""
    program = shutil.which("fast-discovery-server")
    assert program is not None, "fast-discovery-server isn't on PATH: Fast DDS brings it"
    port = _free_udp_port()
    env = {k: v for k, v in os.environ.items() if k != "FASTRTPS_DEFAULT_PROFILES_FILE"}
    command = [program, "-i", "0", "-l", "127.0.0.1", "-p", str(port)]
    server = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL)
    try:
        until_s = time.monotonic() + START_DEADLINE_S
        # What refuses a port says so with a delay on a busy machine; the table of ports doesn't.
        while not _is_bound(port):
            assert server.poll() is None, "the discovery server ended"
            assert time.monotonic() < until_s, "the discovery server doesn't listen"
        yield f"127.0.0.1:{port}"
    finally:
        server.kill()
        server.wait()


def _is_bound(port: int) -> bool:
    lines = Path("/proc/net/udp").read_text().splitlines()[1:]
    return any(line.split()[1].endswith(f":{port:04X}") for line in lines)


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    base = tmp_path_factory.getbasetemp()
    # A worker of xdist has a folder of its own in one that all share.
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    return Recordings(shared / "recordings")
