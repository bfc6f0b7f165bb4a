"""Stamps of a camera held against the times at which its frames were received (METHOD 4.3b)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import NS_PER_S

# A stamp whose distance to its time of receipt leaves the usual one by more than this has leapt.
LEAP_S = 1.0
# So many distances are followed at once; a camera with more of them has none that is usual.
_MOST_RUNS = 8
# No recording pauses for longer: log times that step further have leapt, as from 1970.
LOG_LEAP_S = 86_400.0
_NS = NDArray[np.int64]
# A pause of a recording that replay waits for in silence.
PAUSE_S = 10.0


def pause_text(before_ns: int, after_ns: int) -> str:
    """Return a pause of a recording, for people."""
    return (
        f"nothing was recorded for {(after_ns - before_ns) / NS_PER_S:.1f} s, from "
        f"{before_ns / NS_PER_S:.3f} to {after_ns / NS_PER_S:.3f} s"
    )


def leaps_of(log_times_ns: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the steps of a bag's log times that no recording makes, in order: from and to, ns."""
    at = np.flatnonzero(np.diff(log_times_ns) > LOG_LEAP_S * NS_PER_S)
    return [(int(log_times_ns[i]), int(log_times_ns[i + 1])) for i in at]


def leap_text(before_ns: int, after_ns: int) -> str:
    """Return a leap of log times, for people."""
    days = (after_ns - before_ns) / NS_PER_S / 86_400.0
    return (
        f"log times leap by {(after_ns - before_ns) / NS_PER_S:.6g} s ({days:.0f} days), from "
        f"{before_ns / NS_PER_S:.3f} to {after_ns / NS_PER_S:.3f} s: the recorder's clock was set"
    )


@dataclass(frozen=True)
class SettledStamps:
    """The stamps of a topic, in which each that leapt is replaced by an estimate.

    The estimate is the time of receipt, moved by the distance between the other stamps and theirs.

    Args:
        times_ns: on the clock of the stamps, in the order of the recording, shape (n,).
        leapt: True where the stamp was replaced, shape (n,).
    """

    times_ns: _NS
    leapt: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Count the stamps that leapt."""
        return int(self.leapt.sum())


@dataclass(eq=False)
class _Run:
    """Frames whose stamps go on from each other."""

    stamp_ns: int
    distance_ns: int
    places: list[int]

    def off_ns(self, stamp_ns: int, distance_ns: int) -> int:
        """Compute how far a stamp is from going on.

        That is by its distance, or by the stamps where all stood.

        A simulator that is paused delivers nothing for a while, and its stamps go on.
        """
        step_ns = stamp_ns - self.stamp_ns
        off_ns = abs(distance_ns - self.distance_ns)
        return min(off_ns, step_ns) if step_ns > 0 else off_ns


def settle_stamps(
    stamps_ns: Sequence[int] | _NS, received_ns: Sequence[int] | _NS
) -> SettledStamps:
    """Replace stamps that leap by the times of receipt, moved by the usual distance.

    Most stamps lie at one distance from their times of receipt, which may drift, as that of a
    simulator does. A stamp that leaves it by more than LEAP_S has leapt, until one comes back.

    Args:
        stamps_ns: in the order of the recording.
        received_ns: as many times of receipt.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    received = np.asarray(received_ns, dtype=np.int64)
    leapt = np.zeros(len(stamps), dtype=bool)
    distances = stamps - received
    if not len(stamps) or int(np.abs(np.diff(distances)).max(initial=0)) <= LEAP_S * NS_PER_S:
        return SettledStamps(stamps, leapt)
    usual = max(_runs(stamps, distances), key=lambda run: len(run.places)).places
    leapt[:] = True
    leapt[usual] = False
    base = int(distances[usual[0]])
    beside = np.interp(
        received - received[0], received[usual] - received[0], distances[usual] - base
    )
    times = np.where(leapt, received + base + np.round(beside).astype(np.int64), stamps)
    return SettledStamps(times, leapt)


def _runs(stamps: _NS, distances: _NS) -> list[_Run]:
    """Group the frames by the run that each goes on."""
    limit_ns = round(LEAP_S * NS_PER_S)
    runs: list[_Run] = []  # the one that went on last comes last
    for place, (stamp_ns, distance_ns) in enumerate(
        zip(stamps.tolist(), distances.tolist(), strict=True)
    ):
        off_ns = [run.off_ns(stamp_ns, distance_ns) for run in runs[-_MOST_RUNS:]]
        if off_ns and min(off_ns) <= limit_ns:
            run = runs.pop(off_ns.index(min(off_ns)) - len(off_ns))
            run.stamp_ns, run.distance_ns = stamp_ns, distance_ns
        else:
            run = _Run(stamp_ns, distance_ns, [])
        run.places.append(place)
        runs.append(run)
    return runs
