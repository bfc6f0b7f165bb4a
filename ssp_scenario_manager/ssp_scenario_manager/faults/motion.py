"""How an object came to a standstill: time, path and bound, from a row of true states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Box, FloatArray, Pose2, boxes_overlap
from ssp_core.motion.state import Size
from ssp_core.safety.fence import corners_of, excess_m
from ssp_core.safety.stopping import Stopping

STANDSTILL_MPS = 0.05


@dataclass(frozen=True, slots=True)
class Track:
    """True states of one object, in the order of time.

    Args:
        t_s: session time, rises strictly, shape (n,).
        x_m: frame map; as y_m.
        yaw_rad: frame map.
        speed_mps: along the heading.
    """

    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray

    def speed_at(self, t_s: float) -> float:
        """Speed at the last state that is not later, 0 before the first, m/s."""
        i = int(np.searchsorted(self.t_s, t_s, side="right")) - 1
        return float(self.speed_mps[i]) if i >= 0 else 0.0

    def box(self, index: int, size: Size) -> Box:
        """Where the object was at one of its states."""
        pose = Pose2(float(self.x_m[index]), float(self.y_m[index]), float(self.yaw_rad[index]))
        return Box(pose, size.front_m, size.rear_m, size.width_m)

    def stands_at_the_end(self) -> bool:
        return len(self.t_s) == 0 or abs(float(self.speed_mps[-1])) <= STANDSTILL_MPS

    def first_motion_s(self, since_s: float) -> float | None:
        """When it first moves at or after an instant; None when it doesn't."""
        moving = np.flatnonzero((self.t_s >= since_s) & (np.abs(self.speed_mps) > STANDSTILL_MPS))
        return float(self.t_s[moving[0]]) if len(moving) else None

    def farthest_outside_m(self, size: Size, fence: list[tuple[float, float]]) -> float:
        """How far it ever stuck out of the fence, m; 0 when it never did."""
        if len(self.t_s) == 0:
            return 0.0
        corners = corners_of(self.x_m, self.y_m, self.yaw_rad, size)
        return float(excess_m(corners, fence).max())


def touch(a: Track, a_size: Size, b: Track, b_size: Size) -> bool:
    """Whether the boxes of two objects ever overlap, by their true states."""
    _, ours, theirs = np.intersect1d(a.t_s, b.t_s, return_indices=True)
    reach = sum(max(s.front_m, s.rear_m) + 0.5 * s.width_m for s in (a_size, b_size))
    away = np.hypot(a.x_m[ours] - b.x_m[theirs], a.y_m[ours] - b.y_m[theirs])
    return any(
        boxes_overlap(a.box(int(ours[k]), a_size), b.box(int(theirs[k]), b_size))
        for k in np.flatnonzero(away <= reach)
    )


@dataclass(frozen=True, slots=True)
class Stop:
    """How an object stopped.

    Args:
        speed_mps: the highest from the fault until it had to be noticed.
        distance_m: driven from the fault to standstill.
        bound_m: that it may be at most.
        standstill_s: session time at which it stands for good; None when it doesn't.
    """

    speed_mps: float
    distance_m: float
    bound_m: float
    standstill_s: float | None

    @property
    def kept(self) -> bool:
        return self.standstill_s is not None and self.distance_m <= self.bound_m


def stop_of(track: Track, fault_s: float, timeout_s: float, stopping: Stopping) -> Stop:
    """The stop after a fault.

    Args:
        track: of the object.
        fault_s: session time of the fault.
        timeout_s: how long it may go unnoticed.
        stopping: how the object is said to stop.
    """
    if len(track.t_s) == 0:
        return Stop(0.0, 0.0, stopping.distance_m(0.0, timeout_s), fault_s)
    # From the very instant: a busy witness may have missed the states just before it.
    after = track.t_s > fault_s
    t = np.concatenate(([fault_s], track.t_s[after]))
    x, y, speed = (
        np.interp(t, track.t_s, v) for v in (track.x_m, track.y_m, np.abs(track.speed_mps))
    )
    unnoticed = t <= fault_s + timeout_s + stopping.reaction_s
    fastest = float(speed[unnoticed].max()) if unnoticed.any() else 0.0
    distance = float(np.hypot(np.diff(x), np.diff(y)).sum())
    moving = np.flatnonzero(speed > STANDSTILL_MPS)
    if len(moving) == 0:
        standstill: float | None = fault_s
    elif moving[-1] + 1 < len(t):
        standstill = float(t[moving[-1] + 1])
    else:
        standstill = None
    bound = stopping.distance_m(fastest, timeout_s)
    return Stop(fastest, distance, bound, standstill)
