"""The cost of holding an object's states against its places, beside a bare chord and a mean."""

from __future__ import annotations

import math
import timeit
from collections import deque

import numpy as np
from measure import report

from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from tests.support.tracks import Row, measured, motion

RATE_HZ = 50.0
REPEATS = 5
S = 1_000_000_000


def bare(rows: list[Row]) -> float:
    """The largest difference of any window's stated speed and chord: what none can do without."""
    window: deque[Row] = deque()
    worst = total = 0.0
    for row in rows:
        window.append(row)
        total += row[4]
        while row[0] - window[0][0] > 0.5:
            total -= window.popleft()[4]
        first = window[0]
        way = math.hypot(row[1] - first[1], row[2] - first[2])
        worst = max(worst, abs(abs(total) / len(window) * (row[0] - first[0]) - way))
    return worst


def judged(rows: list[tuple[int, Row]]) -> None:
    watch = ConsistencyWatch(Bounds())
    for stamp_ns, row in rows:
        watch.take(stamp_ns, *row[1:])


def late(rows: list[Row], late_s: float) -> list[Row]:
    """The same places with speeds of another time, for which delays are tried."""
    t, speed = np.array([(row[0], row[4]) for row in rows]).T
    speeds = np.interp(t - late_s, t, speed).tolist()
    return [(*row[:4], v, row[5]) for row, v in zip(rows, speeds, strict=True)]


def main() -> None:
    random = np.random.default_rng(1)
    drive = list(measured(motion("drive", random, 60.0), 0.02, RATE_HZ, random))
    stand = list(measured(motion("stand", random, 60.0), 0.02, RATE_HZ, random))
    tracks = {"driving": drive, "standing": stand, "late by 0.3 s": late(drive, 0.3)}
    for name, rows in tracks.items():
        stamped = [(round(row[0] * S), row) for row in rows]
        ours, bound = (
            min(timeit.repeat(call, number=1, repeat=REPEATS)) / len(rows) * 1e6
            for call in (lambda: judged(stamped), lambda: bare(rows))  # noqa: B023 (called at once)
        )
        report(
            f"consistency: a state, {name}",
            ours,
            bound,
            "us",
            f"{len(rows)} states at {RATE_HZ:g} Hz, best of {REPEATS}",
            lower=True,
            ratio_limit=60.0,
        )


if __name__ == "__main__":
    main()
