"""Sessions in one process, without ROS and camera, against the clock: what a sweep runs.

The lower bound moves the same bodies as many steps, and nobody looks at them.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from measure import report
from sil import five_targets, in_one_process, one_target

from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.in_process import NoTraffic
from ssp_ot_controller.sil.world import World

ROUNDS = 3
STEPS = 800


def bodies_alone(spec: RunSpec) -> float:
    """Times real time of the world without objects' processes, session and traffic."""
    world = World(spec, NoTraffic())
    started = time.perf_counter()
    for _ in range(STEPS):
        world.advance({}, drive_vut=True)
    return STEPS * spec.step_s / (time.perf_counter() - started)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        in_one_process(five_targets(), Path(folder))  # imports, gains and files are there now
        for spec in (one_target(), five_targets()):
            rates = [in_one_process(spec, Path(folder)) for _ in range(ROUNDS)]
            report(
                f"sil_in_process: {len(spec.targets)} target(s)",
                statistics.median(rates),
                max(bodies_alone(spec) for _ in range(ROUNDS)),
                "x real time",
                f"{1 / spec.step_s:.0f} Hz, median of {ROUNDS}, best {max(rates):.3g}",
                lower=False,
                ratio_limit=15.0,
            )


if __name__ == "__main__":
    main()
