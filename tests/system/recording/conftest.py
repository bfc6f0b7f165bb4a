"""A load and recorders in processes of their own, a small disk, and what the recorder says."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import ssp_core
from ssp_core.host.children import die_with_parent
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from tests.support.processes.waiting import DEADLINE_S, until

from .disks import Disk
from .load import LoadTopic, Sent, heard_file, read_log, sent_count, write_spec

PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
LOAD = Path(__file__).with_name("load.py")


@dataclass
class Load:
    """Publishers in a process of their own."""

    topics: tuple[LoadTopic, ...]
    process: subprocess.Popen[str]
    log: Path

    def sent(self) -> list[Sent]:
        return read_log(self.log, self.topics)

    def count(self) -> int:
        return sent_count(self.log)

    def wait_until_heard(self) -> None:
        """Waits until all of its publishers have a subscription and 100 more messages were sent."""
        until(heard_file(self.log).exists, "a subscription to each topic of the load")
        before = self.count()
        until(lambda: self.count() > before + 100, "100 messages more")

    def stop(self) -> list[Sent]:
        """Ends it and returns all that it sent."""
        if self.process.stdin is not None and not self.process.stdin.closed:
            self.process.stdin.close()
        self.process.wait(DEADLINE_S)
        assert self.process.returncode == 0
        return self.sent()


@dataclass
class Recording:
    """One recorder process."""

    process: subprocess.Popen[str]
    bag: Path
    out: str = ""
    said: str = ""

    def wait_until_told(self, text: str) -> None:
        """Reads its standard error up to a line with a text."""
        stderr = self.process.stderr
        assert stderr is not None
        in_vain = threading.Timer(DEADLINE_S, self.process.kill)
        in_vain.start()
        while text not in (line := stderr.readline()):
            self.said += line
            assert line, f"it never told {text!r}: {self.said}"
        in_vain.cancel()
        self.said += line

    def stop(self, number: signal.Signals = signal.SIGINT) -> int:
        """Asks it to end; returns its exit status. What it said is in ``said`` then."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        self.out, err = self.process.communicate(timeout=DEADLINE_S)
        self.said += self.out + err
        assert "Traceback" not in self.said, self.said
        return self.process.returncode

    def kill(self) -> int:
        """SIGKILL; returns the steady time just before it."""
        before_ns = time.monotonic_ns()
        self.process.kill()
        self.process.communicate(timeout=DEADLINE_S)
        return before_ns

    def size(self) -> int:
        """Return the size of its files so far, bytes."""
        return sum(file.stat().st_size for file in self.bag.glob("*.mcap"))

    def wait_for_end_of_data(self) -> None:
        """Waits until nothing more is written, for longer than two flushes are apart."""
        seen = [self.size()]
        since = [time.monotonic()]

        def is_over() -> bool:
            if self.size() != seen[0]:
                seen[0], since[0] = self.size(), time.monotonic()
            return time.monotonic() > since[0] + 1.5

        until(is_over, "the end of the data")


class Field:
    """The place where a test starts its processes: one ROS domain, one folder. Nothing outlives
    it.
    """

    def __init__(self, folder: Path, domain_id: int) -> None:
        self.folder = folder
        self.domain_id = domain_id
        self.env = session_environment(domain_id, PROFILE)
        self._started: list[subprocess.Popen[str]] = []
        self._loads = 0

    def start(self, command: Sequence[str], **kwargs: Any) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            list(command),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.env,
            **{"preexec_fn": die_with_parent, **kwargs},
        )
        self._started.append(process)
        return process

    def load(self, *topics: LoadTopic) -> Load:
        """Starts a load; returns when it sends."""
        self._loads += 1
        spec = self.folder / f"load_{self._loads}.json"
        log = spec.with_suffix(".log")
        write_spec(spec, topics, log)
        process = self.start([sys.executable, str(LOAD), str(spec)])
        load = Load(topics, process, log)
        until(lambda: load.count() > 0 or process.poll() is not None, "the load")
        assert process.poll() is None, process.communicate()
        return load

    def record(
        self, *arguments: str, name: str = "bag", disk: Disk | None = None, **kwargs: Any
    ) -> Recording:
        """Starts ``ssp bag record``; returns at once."""
        folder = self.folder if disk is None else disk.point
        command = [sys.executable, "-m", "ssp_core.cli", "bag", "record", *arguments]
        command += ["--out", str(folder / name)]
        process = self.start([*(disk.enter if disk else ()), *command], **kwargs)
        return Recording(process, (self.folder if disk is None else disk.seen) / name)

    def close(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.kill()
            process.wait(DEADLINE_S)
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()
        remove_stale_shared_memory()
        remove_shared_ports(self.domain_id)


@pytest.fixture
def field_(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Field]:
    with free_domain() as domain_id:
        made = Field(tmp_path, domain_id)
        for key in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "RMW_IMPLEMENTATION"):
            monkeypatch.setenv(key, made.env[key])
        yield made
        made.close()
