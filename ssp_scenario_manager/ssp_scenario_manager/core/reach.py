"""Where the participants of a run may get by the motions that it has for them, and how fast.

Told from the run file alone, and generously: what isn't sure is possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import Size
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    LaneChange,
    ParticipantSpec,
    TriggerSpec,
)
from ssp_core.safety.fence import room_m
from ssp_scenario_manager.core.dispatch import APPROACH_LEAD_S

SPACING_M = 0.5
_LANE_CHANGE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Whose offset from the VUT's path differs by less stays beside it.
_PARALLEL_M = 0.2
# By which a speed is reached at the latest, beyond the time that the motion's acceleration takes.
_SURELY_S = 1.0


class Reach:
    """One participant.

    Args:
        who: the VUT or a target.
        given: triggers that may fire; those of others are left out.
        spec: the run.
    """

    def __init__(self, who: ParticipantSpec, given: Sequence[TriggerSpec], spec: RunSpec) -> None:
        self.who = who
        self._spec = spec
        self._is_vut = who.id == spec.vut.id
        self._acts = [t for t in given if t.object_id == who.id]

    @property
    def size(self) -> Size:
        return self.who.size

    @property
    def fastest_mps(self) -> float:
        """Speed that no motion asks it to exceed."""
        spec = self._spec
        if self._is_vut:
            driver = spec.driver
            if driver.external or spec.mode == "live":
                return spec.limits.speed_mps
            return max(driver.cruise_mps, *(c.cruise_mps for c in driver.later), 0.0)
        speeds = [0.0] if self.who.approach is None else [self.who.approach.cruise_mps]
        for trigger in self._acts:
            act = trigger.manoeuvre
            share = trigger.adaptation.speed_share[1] if trigger.adaptation else 1.0
            if isinstance(act, FollowPath):
                speeds.append(act.motion.cruise_mps * share)
            elif isinstance(act, LaneChange):
                speeds.append(act.cruise_mps * share)
        return min(max(speeds), spec.limits.speed_mps)

    def below_again(self, speed_mps: float, end_s: float) -> bool:
        """It may be slower than a speed again, once it was as fast and before the run's end."""
        if self._is_vut:
            return True
        for trigger in self._acts:
            act = trigger.manoeuvre
            if isinstance(act, FollowPath):
                return True
            if (act.to_mps if isinstance(act, Brake) else act.cruise_mps) < speed_mps:
                return True
            if trigger.adaptation is not None:
                return True
        drive = self.who.approach
        # It stops at its path's end, and is there at the earliest after this time.
        return drive is not None and Polyline(drive.path).length_m / drive.cruise_mps < end_s

    def surely_reached_s(self, speed_mps: float) -> float:
        """When its approach has it as fast as that at the latest, s after the start; inf: never."""
        drive = self.who.approach
        if self._is_vut or drive is None or speed_mps >= drive.cruise_mps:
            return math.inf
        return APPROACH_LEAD_S + speed_mps / drive.acceleration_mps2 + _SURELY_S

    @cached_property
    def points(self) -> FloatArray:
        """Places of its reference point, about half a metre apart, shape (n, 2), frame map."""
        start = np.array([[self.who.start.x_m, self.who.start.y_m]])
        found = [start]
        approach = self.who.approach
        if approach is not None:
            found.append(_along(Polyline(approach.path), 0.0))
        for trigger in self._acts:
            act = trigger.manoeuvre
            if isinstance(act, FollowPath):
                found.append(_along(Polyline(act.motion.path), 0.0))
            elif isinstance(act, LaneChange) and approach is not None:
                path = Polyline(approach.path)
                found += [
                    _along(path, share * act.lateral_shift_m) for share in _LANE_CHANGE_SHARES
                ]
        return np.concatenate(found)

    def room_m(self, polygon: Sequence[tuple[float, float]]) -> float:
        """The most room that it has inside a polygon, negative: it comes no nearer."""
        return max(room_m(x, y, polygon) for x, y in self.points.tolist())

    def ahead_m(self, path: Polyline) -> float:
        """How far ahead along a path its nearest point gets, m of arc length."""
        stations = [s for s, _ in path.project_all_beyond(self.points.tolist())]
        return max(stations) + max(self.size.front_m, self.size.rear_m)

    def stays_beside(self, path: Polyline, width_m: float) -> bool:
        """It is always outside the corridor of someone on a path, and keeps its distance.

        Args:
            path: of the other one.
            width_m: of the other one.
        """
        offsets = [d for _, d in path.project_all_beyond(self.points.tolist())]
        low, high = min(offsets), max(offsets)
        half = 0.5 * self.size.width_m
        outside = min(abs(low), abs(high)) - half > corridor_half_m(width_m)
        return outside and high - low < _PARALLEL_M


def _along(path: Polyline, offset_m: float) -> FloatArray:
    count = max(2, math.ceil(path.length_m / SPACING_M) + 1)
    poses = [path.pose(float(s), offset_m) for s in np.linspace(0.0, path.length_m, count)]
    return np.array([(pose.x_m, pose.y_m) for pose in poses])
