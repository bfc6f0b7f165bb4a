"""What the tests of hostile bags share: files built record by record, and children with limits."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest
from mcap.records import DataEnd, Footer, Header, McapRecord
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.mcap_output import record_bytes

# Of this process alone: what getrusage says begins with the peak of the process that started it.
_PEAK = "\nprint('PEAK', open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"


@dataclass(frozen=True)
class Ended:
    """How a child ended: standard output, and its peak resident memory in MB."""

    out: str
    peak_mb: float


@pytest.fixture(scope="session")
def mcap_bytes() -> Callable[..., bytes]:
    """Makes a closed file of these records, whatever they claim; without CRCs."""

    def make(data: Sequence[McapRecord | bytes], summary: Sequence[McapRecord] = ()) -> bytes:
        head = MCAP0_MAGIC + record_bytes(Header("ros2", "hostile"))
        head += b"".join(d if isinstance(d, bytes) else record_bytes(d) for d in data)
        head += record_bytes(DataEnd(0))
        body = record_bytes(*summary)
        start = len(head) if summary else 0
        return head + body + record_bytes(Footer(start, 0, 0)) + MCAP0_MAGIC

    return make


@pytest.fixture(scope="session")
def limited() -> Callable[..., Ended]:
    """Runs a program in a child: at most 4 GiB of addresses and a generous deadline.

    A child that hangs fails the test by its deadline, one that wants more memory by its traceback.
    """

    def run(code: str, *args: object, deadline_s: float = 60.0) -> Ended:
        done = subprocess.run(
            [sys.executable, "-c", code + _PEAK, *map(str, args)],
            capture_output=True,
            text=True,
            timeout=deadline_s,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
            check=False,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        out, _, peak = done.stdout.rpartition("PEAK ")
        return Ended(out, int(peak) / 1024)

    return run
