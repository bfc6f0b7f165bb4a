"""What an object hears of others: their newest states, as far as they are near enough to matter.

Whether it hears anything is not its business: silence of the VUT or of another object is the
manager's to judge.
"""

from __future__ import annotations

from collections.abc import Iterable

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits


def _reach_m(state: ObjectState) -> float:
    return max(state.size.front_m, state.size.rear_m) + 0.5 * state.size.width_m


class Earshot:
    """The newest states of the VUT and the object targets. Reads no clock.

    Args:
        limits: of the site; a state older than its state age says nothing any more.
    """

    def __init__(self, limits: Limits) -> None:
        self._separation_m = limits.separation_m
        self._oldest_ns = seconds_to_ns(limits.state_age_s)
        self._age_s = limits.state_age_s
        # With x, y, and how far from there anything of it may be while it is heard.
        self._heard: dict[str, tuple[float, float, float, ObjectState]] = {}

    def take(self, states: Iterable[ObjectState]) -> None:
        """States as they were heard; a broken one replaces none."""
        for state in states:
            if state.is_finite:
                far_m = _reach_m(state) + abs(state.speed_mps) * self._age_s
                self._heard[state.object_id] = (state.x_m, state.y_m, far_m, state)

    def near(self, own: ObjectState) -> list[ObjectState]:
        """Those that may be too close, led on to the stamp of the own state, by id."""
        found = []
        x, y, mine_m = own.x_m, own.y_m, _reach_m(own) + self._separation_m
        for its_x, its_y, far_m, state in self._heard.values():
            near_m = mine_m + far_m
            if not (-near_m <= x - its_x <= near_m and -near_m <= y - its_y <= near_m):
                continue
            if state.object_id == own.object_id:
                continue
            age_ns = own.stamp_ns - state.stamp_ns
            if not -self._oldest_ns <= age_ns <= self._oldest_ns:
                continue
            # As far as it can have come in this time.
            near_m += abs(state.speed_mps) * (abs(ns_to_seconds(age_ns)) - self._age_s)
            if (x - its_x) ** 2 + (y - its_y) ** 2 <= near_m * near_m:
                found.append(state.extrapolated(own.stamp_ns))
        return sorted(found, key=lambda state: state.object_id)
