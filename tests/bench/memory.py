"""Peak memory of evaluating a bag of twenty minutes beside that of one minute.

Each is evaluated in a process of its own, over as many labels, which are spread over the whole bag.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from measure import LONG, report
from replay import FRAME_HZ, LABELS, STATE_HZ, evaluate, make_bag

SHORT_S, LONG_S = 60, 1200 if LONG else 300
# For what differs from run to run, and the stamps of twenty minutes.
MOST = 1.15


def peak_mb(folder: Path) -> float:
    """The most memory that a process held which evaluated the bag of a folder, MB."""
    done = subprocess.run(
        [sys.executable, __file__, str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(done.stderr[-2000:])
    return float(done.stdout.splitlines()[-1])


def main() -> None:
    peaks = []
    with tempfile.TemporaryDirectory() as name:
        for seconds in (SHORT_S, LONG_S):
            folder = Path(name) / str(seconds)
            folder.mkdir()
            make_bag(folder, seconds)
            peaks.append(min(peak_mb(folder) for _ in range(3)))
    short_mb, long_mb = peaks
    report(
        "memory: peak for a long bag",
        long_mb,
        short_mb,
        "MB",
        f"peak of the process, {LONG_S} s beside {SHORT_S} s, {LABELS} labels, {FRAME_HZ} frames "
        f"and {STATE_HZ} states a second, trivial model; least of 3",
        lower=True,
        ratio_limit=MOST,
    )


if __name__ == "__main__":
    if len(sys.argv) == 2:
        with tempfile.TemporaryDirectory() as out:
            evaluate(Path(sys.argv[1]), Path(out) / "out")
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    else:
        main()
