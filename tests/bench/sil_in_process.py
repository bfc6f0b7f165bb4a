"""Sessions in one process, without ROS and camera, against the clock: what a sweep runs."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

from measure import report
from sil import five_targets, in_one_process, one_target

ROUNDS = 3


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        in_one_process(five_targets(), Path(folder))  # imports, gains and files are there now
        for spec in (one_target(), five_targets()):
            rates = [in_one_process(spec, Path(folder)) for _ in range(ROUNDS)]
            report(
                f"sil_in_process: {len(spec.targets)} target(s)",
                statistics.median(rates),
                None,
                "x real time",
                f"{1 / spec.step_s:.0f} Hz, median of {ROUNDS}, best {max(rates):.3g}",
                lower=False,
                limit=100.0,
            )


if __name__ == "__main__":
    main()
