"""Distance travelled per object, which moves legs and pedals in the picture."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from ssp_core.motion.state import ObjectState


class Odometer:
    """Sums the way of each object over the states it is shown, along the object's heading."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, float]] = {}
        self._travelled_m: dict[str, float] = {}

    def update(self, states: Iterable[ObjectState]) -> None:
        """Takes the states of the next instant; showing the same instant twice changes nothing."""
        for state in states:
            last = self._last.get(state.object_id)
            if last is not None:
                dx, dy = state.x_m - last[0], state.y_m - last[1]
                way = dx * math.cos(state.yaw_rad) + dy * math.sin(state.yaw_rad)
                self._travelled_m[state.object_id] += way
            else:
                self._travelled_m[state.object_id] = 0.0
            self._last[state.object_id] = (state.x_m, state.y_m)

    def snapshot(self) -> Mapping[str, float]:
        """Distances so far in m by object id; later updates don't change it."""
        return MappingProxyType(dict(self._travelled_m))
