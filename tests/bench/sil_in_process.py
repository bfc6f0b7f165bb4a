"""Sessions in one process, without ROS and camera: what a sweep and a campaign run.

The lower bound moves as many points as many steps, in a bare loop. All times are processor time,
so that other load on the machine counts little.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

from measure import report
from sil import five_targets, one_target

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run.in_process import run_in_process

ROUNDS = 5
STEPS = 8000


def session_s(spec: RunSpec, work_dir: Path) -> float:
    """Processor time of a session, with all that a run of a sweep takes to start, per second."""
    started = time.process_time()
    result, _ = run_in_process(spec, work_dir)
    took_s = time.process_time() - started
    if not result.ok:
        raise RuntimeError(f"the run in one process failed: {result.reasons}")
    return took_s / result.session_s


def points_alone_s(spec: RunSpec) -> float:
    """Processor time of as many points that move at a speed and a yaw rate, per second."""
    states = [[0.0, 0.0, 0.1, 10.0] for _ in (spec.vut, *spec.targets)]
    step_s = spec.step_s
    started = time.process_time()
    for _ in range(STEPS):
        for state in states:
            x_m, y_m, yaw_rad, speed_mps = state
            way_m = speed_mps * step_s
            state[0] = x_m + way_m * math.cos(yaw_rad)
            state[1] = y_m + way_m * math.sin(yaw_rad)
            state[2] = math.remainder(yaw_rad + 0.01 * step_s, math.tau)
    return (time.process_time() - started) / (STEPS * step_s)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        session_s(five_targets(), Path(folder))  # imports, gains and files are there now
        for spec, most in ((one_target(), 1250.0), (five_targets(), 950.0)):
            # In turns, so that both meet the same load.
            both = [(session_s(spec, Path(folder)), points_alone_s(spec)) for _ in range(ROUNDS)]
            ours_s, bound_s = map(min, zip(*both, strict=True))
            report(
                f"sil_in_process: {len(spec.targets)} target(s)",
                1e3 * ours_s,
                1e3 * bound_s,
                "ms of a core per s",
                f"{1 / spec.step_s:.0f} Hz, best of {ROUNDS}, {1 / ours_s:.3g} x real time",
                lower=True,
                ratio_limit=most,
            )


if __name__ == "__main__":
    main()
