"""Node processes: a clean start, supervision, and an end in any case."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.host.forked import ForkedProcess, node_server
from ssp_core.host.node_server import Request
from ssp_core.host.shared_memory import (
    remove_dead_ports,
    remove_shared_ports,
    remove_stale_shared_memory,
)

_ANSWER_S = 1.0


@dataclass
class NodeProcess:
    """One node in a process (and a process group) of its own, its output in a log file."""

    name: str
    process: ForkedProcess | subprocess.Popen[bytes]
    log: Path
    expected_to_stop: bool = False

    @property
    def returncode(self) -> int | None:
        return self.process.poll()

    def describe_exit(self) -> str:
        """Describe for people how it ended."""
        code = self.returncode
        if code is None:
            return "still running"
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exited with status {code}"

    def kill(self) -> None:
        """End it at once; one that hangs writes its stacks into its log first (faulthandler)."""
        self.expected_to_stop = True
        self.process.send_signal(signal.SIGABRT)
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_ANSWER_S)
        with suppress(ProcessLookupError):  # the last of the group may be gone by now
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def log_tail(self, lines: int = 12) -> str:
        try:
            return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


@dataclass
class ProcessGroup:
    """The node processes of one session; leaving the block ends every one of them.

    Args:
        processes: by node name.
        owns_domain: no other session is in the ROS domain, so that its remains may be removed.
        after_end: what is left when all have ended; what hangs there keeps no process alive.
    """

    env: dict[str, str]
    log_dir: Path
    processes: dict[str, NodeProcess] = field(default_factory=dict)
    owns_domain: bool = True
    after_end: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> ProcessGroup:
        self.log_dir.mkdir(parents=True, exist_ok=True)
        remove_stale_shared_memory()  # of a session that was killed with all its processes
        if self.owns_domain:
            remove_dead_ports(int(self.env["ROS_DOMAIN_ID"]))
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self.after_end.close()
        remove_stale_shared_memory()
        if self.owns_domain:
            remove_shared_ports(int(self.env["ROS_DOMAIN_ID"]))

    def start_node(
        self,
        name: str,
        module: str,
        parameters: dict[str, object],
        remappings: Sequence[str] = (),
        *,
        pipe: bool = False,
    ) -> NodeProcess:
        """Start ``module`` as a ROS node with parameters and remappings ``from:=to``.

        What it imports is imported once for all nodes that this process starts (node_server). It
        receives SIGTERM when this process dies, however that happens, and no SIGINT from the
        terminal: the session's runner ends it in order.

        Args:
            name: of the node, and of its log.
            module: its Python module, which has a ``main``.
            parameters: values by name, as ``--ros-args -p`` takes them.
            remappings: each as ``from:=to``.
            pipe: its standard input is a pipe from here; otherwise it has none.
        """
        arguments = ["--ros-args", "-r", f"__node:={name}"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        for rule in remappings:
            arguments += ["-r", rule]
        log = self.log_dir / f"{name}.log"
        request = Request(name, module, arguments, self.env, os.getcwd())
        with log.open("ab") as stream:
            process = node_server(self.env).start(request, stream.fileno(), pipe=pipe)
        node = NodeProcess(name, process, log)
        self.processes[name] = node
        return node

    def ended(self) -> list[NodeProcess]:
        """List the processes that have ended without having been asked to."""
        return [
            node
            for node in self.processes.values()
            if node.returncode is not None and not node.expected_to_stop
        ]

    def stop(self, timeout_s: float = 20.0) -> list[str]:
        """Send SIGTERM to all that live, suspended ones too, and SIGKILL to those that don't react.

        Returns:
            Names of the processes that had to be killed.
        """
        alive = [node for node in self.processes.values() if node.returncode is None]
        for node in alive:
            node.expected_to_stop = True
            node.process.terminate()
            node.process.send_signal(signal.SIGCONT)
        deadline = time.monotonic() + timeout_s
        killed = []
        for node in alive:
            try:
                node.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                node.kill()
                killed.append(node.name)
        return killed
