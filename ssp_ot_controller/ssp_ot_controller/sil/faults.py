"""When the faults of a run file begin and end, by session time."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.run_file.model import Fault, FaultKind
from ssp_core.world.plant import FaultFact

UNITS: dict[FaultKind, str] = {
    "link_delay": "s",
    "clock_step": "s",
    "position_jump": "m",
    "actuator_stuck": "m/s^2",
    "vut_stop": "m/s^2",
}


@dataclass(frozen=True, slots=True)
class FaultChange:
    """A fault begins or ends (FaultEvent.msg).

    Args:
        number: of the fault in the run file, from 0.
        target: object or node that it strikes.
        active: True: it begins.
        value: its size, NaN for a kind without one.
    """

    number: int
    kind: FaultKind
    target: str
    active: bool
    value: float
    unit: str

    def fact(self, source: str, now_ns: int) -> FaultFact:
        """As the node of that name tells it."""
        name = f"{self.number} {self.kind}"
        return FaultFact(source, name, self.target, self.active, self.value, self.unit, now_ns)


class FaultSchedule:
    """The faults of one or a few targets, and which of them are active. Reads no clock.

    Args:
        faults: all faults of the run; their place is their number.
    """

    def __init__(
        self, faults: Sequence[Fault], targets: Collection[str], kinds: Collection[FaultKind]
    ) -> None:
        self._mine = [
            (i, f) for i, f in enumerate(faults) if f.target in targets and f.kind in kinds
        ]
        self._active: dict[int, Fault] = {}
        self._begun = False

    @property
    def is_empty(self) -> bool:
        return not self._mine

    def begin(self, now_ns: int, *, running: bool, armed: bool) -> list[FaultChange]:
        """Once a step, before anything else of it: what begins or ends now.

        Args:
            running: the session's time goes; False while the world holds.
            armed: the target is armed. A fault without a time begins then.
        """
        if not self._mine:
            return []
        self._begun = self._begun or running
        changes = []
        for number, fault in self._mine:
            wanted = self._is_due(fault, now_ns, armed)
            if wanted == (number in self._active):
                continue
            if wanted:
                self._active[number] = fault
            else:
                del self._active[number]
            changes.append(
                FaultChange(
                    number,
                    fault.kind,
                    fault.target,
                    wanted,
                    math.nan if fault.value is None else fault.value,
                    UNITS.get(fault.kind, ""),
                )
            )
        return changes

    def active(self, kind: FaultKind) -> list[Fault]:
        """Active faults of a kind, in the order of the run file."""
        if not self._active:
            return []
        return [self._active[i] for i in sorted(self._active) if self._active[i].kind == kind]

    def has(self, kind: FaultKind) -> bool:
        return bool(self._active) and any(f.kind == kind for f in self._active.values())

    def total(self, kind: FaultKind) -> float:
        """Sum of the values of the active faults of a kind."""
        return sum(f.value or 0.0 for f in self.active(kind))

    def share(self, kind: FaultKind, usual: float) -> float:
        """Probability that the usual or one of the active faults of a kind strikes."""
        kept = 1.0 - usual
        for fault in self.active(kind):
            kept *= 1.0 - (fault.value or 0.0)
        return usual if kept == 1.0 - usual else 1.0 - kept

    def _is_due(self, fault: Fault, now_ns: int, armed: bool) -> bool:
        if not self._begun:
            # Before the start time stands still; a duration counts from the start.
            return fault.at_s is None and armed
        start_ns = seconds_to_ns(fault.at_s or 0.0)
        if fault.duration_s is not None and now_ns >= start_ns + seconds_to_ns(fault.duration_s):
            return False
        return now_ns >= start_ns
