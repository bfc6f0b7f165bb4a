"""The newest report of a probed object: its MONR, its places of the last moments, its firmware.

This file owns them; a new connection forgets the MONR. Reads no clock.
"""

from __future__ import annotations

import math
from collections import deque

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geodesy import Datum
from ssp_core.geometry import Pose2
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import Monr
from ssp_ot_controller.bodies.iso22133.states import state_of
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns

# Its speed is the way over so long.
_WAY_NS = NS_PER_S // 5


class Latest:
    """The newest report of one object.

    Attributes:
        monr: None: none has come since it was connected.
        arrived_ns: when the newest one came.
        firmware: as its DRES states it; None before one.
    """

    def __init__(self, datum: Datum) -> None:
        self.monr: Monr | None = None
        self.arrived_ns = 0
        self.firmware: str | None = None
        self._datum = datum
        self._places: deque[tuple[int, float, float]] = deque()

    def forget(self) -> None:
        """Wait for the first MONR of a new connection."""
        self.monr = None

    def take(self, monr: Monr, arrived_ns: int) -> None:
        """Take a MONR, and the place that it states."""
        self.monr, self.arrived_ns = monr, arrived_ns
        if monr.x_m is None or monr.y_m is None:
            return
        stamp_ns = arrived_ns
        if monr.time_of_week_ns is not None:
            # Several may arrive at once on a machine that is busy.
            stamp_ns = nearest_utc_ns(monr.time_of_week_ns, arrived_ns)
        self._places.append((stamp_ns, monr.x_m, monr.y_m))
        while len(self._places) > 1 and stamp_ns - self._places[1][0] >= _WAY_NS:
            self._places.popleft()

    @property
    def state(self) -> ControlState | None:
        """The reported state; None before the first MONR, and for a number without a name."""
        return None if self.monr is None else state_of(self.monr.state)

    def enu(self) -> Pose2 | None:
        """Return the place that the object reports."""
        m = self.monr
        if m is None or m.x_m is None or m.y_m is None or m.yaw_rad is None:
            return None
        return Pose2(m.x_m, m.y_m, m.yaw_rad)

    def pose(self) -> Pose2 | None:
        """Return the pose of ``enu`` in the datum's frame."""
        enu = self.enu()
        return None if enu is None else self._datum.of_enu(enu)

    def reported_speed_mps(self) -> float:
        """Return the speed that the object states, 0 where it states none."""
        return 0.0 if self.monr is None else abs(self.monr.speed_mps or 0.0)

    def measured_speed_mps(self) -> float:
        """Compute its speed from the newest places that it reported."""
        if not self._places:
            return 0.0
        (first_ns, *first), (last_ns, *last) = self._places[0], self._places[-1]
        if last_ns - first_ns < _WAY_NS // 2:
            return 0.0
        return math.dist(first, last) / ns_to_seconds(last_ns - first_ns)
