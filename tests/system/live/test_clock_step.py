"""All clocks of a session are set back while it drives: it ends in time, and everything stands."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cdr.messages import stamp_ns
from ssp_core.host.domains import free_domain
from ssp_core.safety.codes import MEANINGS, SafetyCode
from tests.support.bags.messages import messages
from tests.system.live.test_live_session import start_driving

pytestmark = [pytest.mark.ros, pytest.mark.system]
SOURCE = Path(__file__).with_name("clock_step.cpp")
STEP_S = -5.0
# Of wall time, until a run has its verdict in any case.
VERDICT_BOUND_S = 30.0
# Limits of time, but for those of the run's own length; or the manager is silent for the runner.
LATE = {SafetyCode.EVENT_MISSING, SafetyCode.DURATION}
NOTICED = {"silent"} | {
    meaning.limit_name
    for code, meaning in MEANINGS.items()
    if meaning.unit == "s" and code not in LATE
}


class SteppedClock:
    """The system clock of processes that are started with ``env``."""

    def __init__(self, folder: Path) -> None:
        library = folder / "clock_step.so"
        command = ["g++", "-std=c++17", "-O2", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
        subprocess.run([*command, "-ldl"], check=True)
        self._file = folder / "clock_step"
        self._file.write_bytes(struct.pack("q", 0))
        self.env = {"LD_PRELOAD": str(library), "SSP_CLOCK_STEP": str(self._file)}

    def step(self, by_s: float) -> None:
        with self._file.open("r+b") as stream:
            stream.write(struct.pack("q", round(by_s * 1e9)))


@pytest.fixture
def clock(tmp_path: Path) -> SteppedClock:
    return SteppedClock(tmp_path)


CLOCKS = """
import sys, time
for line in sys.stdin:
    print(time.time(), time.clock_gettime(time.CLOCK_MONOTONIC), flush=True)
"""


def test_the_clock_of_these_tests_steps(clock: SteppedClock) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", CLOCKS],
        env={**os.environ, **clock.env},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None

    def read() -> tuple[float, float]:
        process.stdin.write("\n")
        process.stdin.flush()
        wall_s, steady_s = map(float, process.stdout.readline().split())
        return wall_s, steady_s

    wall_s, steady_s = read()
    clock.step(-1000.0)
    stepped_s, later_s = read()
    process.communicate()
    assert stepped_s - wall_s == pytest.approx(later_s - steady_s - 1000.0, abs=100.0)


def test_a_live_session_ends_when_all_clocks_are_set_back(
    make_stage: Callable[[dict[str, str]], Any], task: Callable[[str], Path], clock: SteppedClock
) -> None:
    with free_domain() as domain:
        here = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        stage = make_stage({**here, **clock.env})
        run, _, _ = start_driving(stage, task("cut_in"))
        clock.step(STEP_S)
        result = stage.finish(run)
        end = messages(stage.folder / "run" / "bag", "/ssp/session_state")[-1]
        assert end.verdict != 0, end
        assert result["verdict"] != "valid", result["reasons"]
        # It ends because of the clock, not when the run's time is over.
        words = set(re.findall(r"\w+", " ".join(result["reasons"])))
        assert words & NOTICED, result["reasons"]
        assert not words & {MEANINGS[code].limit_name for code in LATE}, result["reasons"]
        rows = stage.rows()
        (back,) = [k for k, (a, b) in enumerate(pairwise(rows), 1) if b.time_ns < a.time_ns]
        # By the stepped clock, which both go by from here on.
        verdict_s = (stamp_ns(end.header.stamp) - rows[back].time_ns) / 1e9
        print(f"verdict {verdict_s:.2f} s after the step, limit {VERDICT_BOUND_S:g} s")
        assert 0.0 < verdict_s < VERDICT_BOUND_S
        # Its commander stands still for as long as the clock was set back; a body brakes without.
        stood = next(row for row in rows[back:] if row.speed_mps == 0.0)
        assert (stood.time_ns - rows[back].time_ns) / 1e9 < -STEP_S
        assert rows[-1].speed_mps == 0.0
