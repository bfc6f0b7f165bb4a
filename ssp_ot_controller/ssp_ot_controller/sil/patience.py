"""The time that a lockstep world waits for an answer before it drops its participant."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from ssp_core.clock import ns_to_seconds, seconds_to_ns

# A participant is dropped after so long in which the machine had a processor to spare for it.
HANG_LIMIT_S = 3.0
# The longest that the world waits, however busy the machine is. Less than objects and manager give
# the world for a step. Drawing takes long on a busy machine, and no limit rests on a picture: the
# camera has this limit in any case.
BUSY_LIMIT_S = 10.0
# A world that didn't look for so long stood still itself, and blames no participant for that time.
OWN_PAUSE_S = 0.5

_IDLE_FIELD = 4


class Patience:
    """Counts the wait of a step, and of it the time in which a participant could have answered.

    A participant that is runnable on a saturated machine may get no processor for seconds. One that
    died or hangs leaves its processor idle. Simulated time stands still in both cases.
    """

    def __init__(self, steady_ns: int) -> None:
        self._looked_ns = steady_ns
        self._idle_s: float | None = None
        self._paused = False
        self.begin(steady_ns)

    def begin(self, steady_ns: int) -> None:
        """Begin a new wait."""
        self._since_ns = steady_ns
        self.waited_s = 0.0
        self._spare_s = 0.0

    def look(self, steady_ns: int, idle_s: float | None) -> None:
        """Count the time since the last look.

        It is called often, also while no participant is waited for.

        Args:
            steady_ns: the steady clock, ns.
            idle_s: processor time that the machine has had to spare since its start, s, summed over
                its processors; None where the kernel doesn't say, then all time counts.
        """
        passed_s = ns_to_seconds(steady_ns - max(self._looked_ns, self._since_ns))
        self._paused = ns_to_seconds(steady_ns - self._looked_ns) > OWN_PAUSE_S
        if self._paused:
            self.waited_s += min(passed_s, OWN_PAUSE_S)
        else:
            self.waited_s += passed_s
            if idle_s is None or self._idle_s is None:
                self._spare_s += passed_s
            else:
                self._spare_s += min(passed_s, max(0.0, idle_s - self._idle_s))
        self._looked_ns, self._idle_s = steady_ns, idle_s

    @property
    def may_end(self) -> bool:
        """True once the limit of some participant is passed."""
        return self.passed_limit_s() is not None

    def passed_limit_s(self, draws: bool = False) -> float | None:
        """Return the limit that this wait passed, s; None where it passed none.

        Args:
            draws: the participant is the camera.
        """
        if self._paused:
            # What came meanwhile isn't read yet.
            return None
        if self.waited_s > BUSY_LIMIT_S:
            return BUSY_LIMIT_S
        return HANG_LIMIT_S if self._spare_s > HANG_LIMIT_S and not draws else None

    def overdue(self, lost: Collection[str], camera: str, steady_ns: int) -> dict[str, float]:
        """Return those of the lost whose limit is passed, each with it, s.

        A new wait begins where this is all of them; the camera's goes on beside those of others.

        Args:
            lost: participants that keep the world waiting.
            camera: name of the one that draws.
            steady_ns: the steady clock, ns.
        """
        passed = {one: self.passed_limit_s(one == camera) for one in lost}
        overdue = {one: limit_s for one, limit_s in passed.items() if limit_s is not None}
        if len(overdue) == len(lost):
            self.begin(steady_ns)
        return overdue


class DriverHold:
    """The signs of life of the VUT's driver, and the step at which it waits for a model's answer.

    Reads no clock.

    Args:
        limit_s: a node that is silent for longer is lost, whatever it waited for.
        period_s: a hold is reported so often.
        first_step: the first at which a model can be asked. A driver that waits before waits for
            the VUT's state, which isn't sent again.
    """

    def __init__(self, limit_s: float, period_s: float, first_step: int = 0) -> None:
        self._first_step = first_step
        self._limit_ns, self._period_ns = seconds_to_ns(limit_s), seconds_to_ns(period_s)
        self.last_sign_ns: int | None = None
        self._step = -1
        self._report_ns = 0

    def hear(self, now_ns: int) -> None:
        """Take a sign of life."""
        self.last_sign_ns = now_ns

    def wait(self, step: int) -> None:
        """Take the driver's word that it waits at a step."""
        if step >= self._first_step:
            self._step = step

    def is_at(self, step: int, now_ns: int) -> bool:
        """Tell whether the driver waits at a step, and is alive."""
        if self._step != step or self.last_sign_ns is None:
            return False
        return now_ns - self.last_sign_ns <= self._limit_ns

    def is_report_due(self, now_ns: int, *, holds: bool) -> bool:
        """Tell whether the world says now that it holds; it isn't asked again for a period."""
        if holds and now_ns - self._report_ns < self._period_ns:
            return False
        self._report_ns = now_ns
        return holds


def idle_s(stat: Path = Path("/proc/stat")) -> float | None:
    """Read the idle time of all processors since the machine's start, s; None where it is unknown.

    Time in which a processor waits for a disk isn't idle here: what it waits for may be the program
    text of the participant.
    """
    try:
        with stat.open() as lines:
            fields = lines.readline().split()
        return int(fields[_IDLE_FIELD]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return None
