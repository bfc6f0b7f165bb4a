"""The time that the disk lasts, and its consequences."""

from __future__ import annotations

import math
import os
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.run_file.model import RunSpec

# A run is ended while there is room for so long: to brake, to say so, and to close the bag.
LEAST_S = 20.0
# People are told when it is less than this.
WARN_S = 600.0
RATE_WINDOW_S = 5.0
# JPEG pictures of streets and a margin; a raw picture would be 3.
_BYTES_PER_PIXEL = 0.3
# One object's state or reference with its share of ticks, heartbeats and acknowledgements.
_BYTES_PER_OBJECT_STEP = 1500


def free_bytes(folder: Path) -> int | None:
    """Return what this process may still write on the folder's file system.

    None if it isn't known.
    """
    try:
        figures = os.statvfs(folder)
    except OSError:
        return None
    return figures.f_bavail * figures.f_frsize


@dataclass(slots=True)
class WriteRate:
    """Bytes a second over the last RATE_WINDOW_S.

    A recording's first seconds count as a part of this time: one burst at the beginning is no rate.
    """

    _totals: deque[tuple[float, int]] = field(default_factory=deque)

    def note(self, now_s: float, total_bytes: int) -> float:
        """Note what was written until now and return the rate."""
        self._totals.append((now_s, total_bytes))
        while len(self._totals) > 2 and now_s - self._totals[1][0] >= RATE_WINDOW_S:
            self._totals.popleft()
        then_s, then_bytes = self._totals[0]
        return (total_bytes - then_bytes) / max(now_s - then_s, RATE_WINDOW_S)


def expected_rate(run: RunSpec) -> float:
    """Estimate what a run will write, on the safe side, bytes per second.

    The estimate takes camera, objects and step of a run that hasn't begun.
    """
    rate = (1 + len(run.targets)) * _BYTES_PER_OBJECT_STEP / run.step_s
    if run.camera is not None:
        pixels = run.camera.width_px * run.camera.height_px
        rate += pixels * _BYTES_PER_PIXEL * run.camera.rate_hz
    return rate


@dataclass(frozen=True, slots=True)
class DiskNeeds:
    """The demands of a recording on its disk.

    Args:
        reserve_bytes: that must stay free.
        run_s: how long it may take at most; 0: unknown.
        rate_bps: what it is expected to write, bytes per second.
    """

    reserve_bytes: int
    run_s: float = 0.0
    rate_bps: float = 0.0


@dataclass(frozen=True, slots=True)
class DiskOutlook:
    """The consequences of the figures.

    Args:
        left_s: until the reserve is reached, at the present rate; inf: never, or not known.
        ends: why the recording must end now, None while it need not.
        unready: why a run must not begin, None when it may.
        warning: what a person should look at, None when there is nothing.
    """

    left_s: float
    ends: str | None
    unready: str | None
    warning: str | None


def outlook(free: int | None, rate_bps: float, needs: DiskNeeds) -> DiskOutlook:
    """Judge the disk.

    Args:
        free: bytes; None when it is unknown (the recorder's own writing fails then).
        rate_bps: written lately, bytes per second.
        needs: of the recording: reserve, and a run's length and rate.
    """
    if free is None:
        return DiskOutlook(math.inf, None, None, "the free space of the disk is unknown")
    usable = free - needs.reserve_bytes
    left_s = max(usable, 0) / rate_bps if rate_bps > 0 else (math.inf if usable > 0 else 0.0)
    ends = _ends(free, usable, left_s, needs)
    unready = ends
    rate = max(rate_bps, needs.rate_bps)
    needed = needs.run_s * rate
    if unready is None and usable < needed:
        unready = (
            f"the disk has {_mb(free)} MB, the run may need {_mb(needed)} MB "
            f"({needs.run_s:g} s at {_mb(rate)} MB/s) over {_mb(needs.reserve_bytes)} MB in reserve"
        )
    warning = unready
    if warning is None and left_s < WARN_S:
        warning = f"the disk is full in {left_s:.0f} s: {_mb(free)} MB left at {_mb(rate_bps)} MB/s"
    return DiskOutlook(left_s, ends, unready, warning)


class DiskWatch:
    """The disk of one recording, as it was at the last look.

    Attributes:
        free: bytes; None when it is unknown.
        rate_bps: written lately, bytes per second.
        outlook: the consequences.
    """

    def __init__(self, needs: DiskNeeds) -> None:
        self._needs = needs
        self._rate = WriteRate()
        self.free: int | None = None
        self.rate_bps = 0.0
        self.outlook = outlook(None, 0.0, needs)

    def look(self, now_s: float, total_bytes: int, folder: Path) -> DiskOutlook:
        """Look at the disk.

        Args:
            now_s: on the steady clock.
            total_bytes: written until now.
            folder: of the recording.
        """
        self.rate_bps = self._rate.note(now_s, total_bytes)
        self.free = free_bytes(folder)
        self.outlook = outlook(self.free, self.rate_bps, self._needs)
        return self.outlook


def _ends(free: int, usable: int, left_s: float, needs: DiskNeeds) -> str | None:
    if usable <= 0:
        return f"the disk has {_mb(free)} MB, the reserve is {_mb(needs.reserve_bytes)} MB"
    if left_s < LEAST_S:
        return f"the disk is full in {left_s:.0f} s, limit {LEAST_S:g} s: {_mb(free)} MB left"
    return None


def _mb(size: float) -> str:
    return f"{size / 1e6:.1f}"
