"""Node processes: a clean start, supervision, and an end in any case."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.host.shared_memory import (
    remove_dead_ports,
    remove_shared_ports,
    remove_stale_shared_memory,
)

# Between Python and the name of a module of ours. Without -P the working folder comes before all
# packages, and what lies there under the name of one would run.
AS_MODULE = ("-P", "-m")

_PR_SET_PDEATHSIG = 1
_ANSWER_S = 1.0
# Loaded here: between fork and exec as little as possible may happen.
_LIBC = ctypes.CDLL(None)


def die_with_parent() -> None:
    """Let a child receive SIGTERM when its parent dies, however that happens.

    For its preexec_fn.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def outlive_parent() -> None:
    """Let this process go on after the parent that it was to die with."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, 0)


@dataclass
class NodeProcess:
    """One node in a process (and a process group) of its own, its output in a log file."""

    name: str
    process: subprocess.Popen[bytes]
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
        """Start ``python -P -m module`` as a ROS node with parameters and remappings ``from:=to``.

        It receives SIGTERM when this process dies, however that happens, and no SIGINT from the
        terminal: the session's runner ends it in order.

        Args:
            name: of the node, and of its log.
            module: its Python module.
            parameters: values by name, as ``--ros-args -p`` takes them.
            remappings: each as ``from:=to``.
            pipe: its standard input is a pipe from here; otherwise it has none.
        """
        arguments = [sys.executable, *AS_MODULE, module, "--ros-args", "-r", f"__node:={name}"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        for rule in remappings:
            arguments += ["-r", rule]
        log = self.log_dir / f"{name}.log"
        with log.open("ab") as stream:
            process = subprocess.Popen(
                arguments,
                env=self.env,
                stdin=subprocess.PIPE if pipe else subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )
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
