"""Node processes forked from one that has imported what they need, as seen by who starts them."""

from __future__ import annotations

import dataclasses
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Mapping
from typing import IO

from ssp_core.errors import HostError
from ssp_core.host.children import AS_MODULE
from ssp_core.host.node_server import Request

# The server imports a node's module, and forks, in a second.
_ANSWER_S = 60.0
# Variables that a node reads when it starts: all others may count while its module is imported.
_READ_AT_START = ("ROS_", "FASTRTPS_", "TMPDIR", "SSP_PAGE_TOKEN", "PYTEST_")


class ForkedProcess:
    """The process of a node, with the methods of subprocess.Popen that supervision calls.

    Attributes:
        pid: of the process, which leads a session and a process group.
        stdin: pipe to its standard input, if it has one.
        returncode: exit status, −N for signal N; None until poll or wait finds its end.
    """

    def __init__(
        self, server: NodeServer, pid: int, descriptor: int, stdin: IO[bytes] | None
    ) -> None:
        self.pid = pid
        self.stdin = stdin
        self.returncode: int | None = None
        self._server = server
        self._descriptor = descriptor
        weakref.finalize(self, os.close, descriptor)

    def poll(self) -> int | None:
        """Return its exit status, None while it lives."""
        if self.returncode is None and self._has_ended(0.0):
            self.returncode = self._server.status_of(self.pid)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Return its exit status once it has ended; raise subprocess.TimeoutExpired."""
        if self.returncode is None and not self._has_ended(timeout):
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        status = self.poll()
        assert status is not None
        return status

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            signal.pidfd_send_signal(self._descriptor, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _has_ended(self, timeout_s: float | None) -> bool:
        waiting = select.poll()
        waiting.register(self._descriptor, select.POLLIN)
        return bool(waiting.poll(None if timeout_s is None else 1000.0 * timeout_s))


class NodeServer:
    """Starts nodes of this process; see ssp_core.host.node_server.

    Charter: it holds the socket to the server and how each node ended, both under one lock, since
    nodes are started and awaited from several threads. The server ends
    when this object and all of its processes are dropped, or this process ends, however it does.

    Args:
        environment: of the server.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            module, number = "ssp_core.host.node_server", theirs.fileno()
            self._process = subprocess.Popen(
                [sys.executable, *AS_MODULE, module, str(number)],
                env=environment,
                pass_fds=(number,),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        ours.settimeout(_ANSWER_S)
        self._channel = ours
        self._lock = threading.Lock()
        self._status_of: dict[int, int] = {}
        weakref.finalize(self, _end, ours, self._process)

    @property
    def is_there(self) -> bool:
        return self._process.poll() is None

    def start(self, request: Request, output: int, *, pipe: bool = False) -> ForkedProcess:
        """Start a node.

        Args:
            request: which.
            output: file descriptor to which it writes.
            pipe: its standard input is a pipe from here; otherwise it has none.

        Raises:
            HostError: the server doesn't answer.
        """
        source, sink = os.pipe() if pipe else (None, None)
        handed = [output] if source is None else [output, source]
        try:
            with tempfile.TemporaryFile() as file, self._lock:
                file.write(json.dumps(dataclasses.asdict(request)).encode())
                file.flush()
                file.seek(0)
                socket.send_fds(self._channel, [b"n"], [file.fileno(), *handed])
                while not (started := self._hear())[1]:
                    pass
                pid, (descriptor,) = started
        except OSError as error:
            raise HostError(
                f"{request.name}: the process that starts nodes doesn't answer ({error}); "
                "start again"
            ) from error
        finally:
            if source is not None:
                os.close(source)
        stdin = None if sink is None else os.fdopen(sink, "wb")
        return ForkedProcess(self, pid, descriptor, stdin)

    def status_of(self, pid: int) -> int:
        """Return the exit status of a process that has ended, −N for signal N.

        With a server that is gone it was ended by SIGTERM, as a node is whose parent dies.
        """
        try:
            with self._lock:
                while pid not in self._status_of:
                    self._hear()
                return os.waitstatus_to_exitcode(self._status_of[pid])
        except OSError:
            return -signal.SIGTERM

    def _hear(self) -> tuple[int, list[int]]:
        """Take in the next answer; raise OSError when there is none in time or any more.

        Returns:
            Number of a process; its file descriptor if it was started, none if it has ended.
        """
        data, descriptors, *_ = socket.recv_fds(self._channel, 1024, 1)
        if not data:
            raise ConnectionError("it has ended")
        answer: dict[str, int] = json.loads(data)
        pid = answer["pid"]
        if descriptors:
            self._status_of.pop(pid, None)  # of one that had this number before
        else:
            self._status_of[pid] = answer["status"]
        return pid, descriptors


def _end(channel: socket.socket, process: subprocess.Popen[bytes]) -> None:
    channel.close()
    process.wait()


_current: tuple[object, NodeServer] | None = None
_changing = threading.Lock()


def node_server(environment: Mapping[str, str]) -> NodeServer:
    """Return the server of nodes with these variables: the last one, where it would be alike."""
    global _current
    counts = {k: v for k, v in environment.items() if not k.startswith(_READ_AT_START)}
    key = os.getpid(), counts
    with _changing:
        if _current is None or _current[0] != key or not _current[1].is_there:
            _current = key, NodeServer(environment)
        return _current[1]
