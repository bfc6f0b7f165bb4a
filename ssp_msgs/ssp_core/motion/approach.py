"""The approach of an object target: its path, and the points that it is sent before it starts.

The scenario manager dispatches them, and the driver of an object knows them beforehand from the
run file: the same function gives both the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np

from ssp_core.geometry import FloatArray, Polyline, wrap_angles
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Points

# So many paths and motions along them are kept; a run with more plans some of them anew.
_PREPARED = 256


class Drive(Protocol):
    """A ``Motion`` of the run file, which lies above this folder."""

    @property
    def path(self) -> Sequence[tuple[float, float]]: ...
    @property
    def cruise_mps(self) -> float: ...
    @property
    def acceleration_mps2(self) -> float: ...
    @property
    def deceleration_mps2(self) -> float: ...
    @property
    def times_s(self) -> Sequence[float] | None: ...


def path_of(motion: Drive) -> Polyline:
    """Return the path of a motion, frame map."""
    return _path(tuple(motion.path))


def approach_points(motion: Drive) -> Points:
    """Plan points from standstill along a path to its end, where it stands again.

    Raises:
        ValueError: it can't be driven.
    """
    if motion.times_s is not None:
        return _timed(tuple(motion.path), tuple(motion.times_s))
    return _drive(
        tuple(motion.path), motion.cruise_mps, motion.acceleration_mps2, motion.deceleration_mps2
    )


@lru_cache(maxsize=_PREPARED)
def _path(points: tuple[tuple[float, float], ...]) -> Polyline:
    return Polyline(points)


@lru_cache(maxsize=_PREPARED)
def _drive(
    points: tuple[tuple[float, float], ...],
    cruise_mps: float,
    acceleration_mps2: float,
    deceleration_mps2: float,
) -> Points:
    path = _path(points)
    return drive_along(path, 0.0, 0.0, cruise_mps, acceleration_mps2, deceleration_mps2)


# A body that is slower than this keeps its heading.
_MOVES_MPS = 0.1


@lru_cache(maxsize=_PREPARED)
def _timed(points: tuple[tuple[float, float], ...], times_s: tuple[float, ...]) -> Points:
    """Plan points through places at given times; speeds and headings follow from the places."""
    t: FloatArray = np.array(times_s, dtype=np.float64)
    x, y = np.array(points, dtype=np.float64).T
    vx, vy = np.gradient(x, t), np.gradient(y, t)
    speed = np.hypot(vx, vy)
    moves = np.flatnonzero(speed > _MOVES_MPS)
    if not len(moves):
        raise ValueError("no place of its path is left faster than it can be seen to move")
    speed[[0, -1]] = 0.0
    # The nearest moment at which it moves, the later one at the beginning.
    nearest = moves[np.clip(np.searchsorted(moves, np.arange(len(t)), side="right") - 1, 0, None)]
    yaw = np.unwrap(np.arctan2(vy, vx)[nearest])
    turning = np.gradient(yaw, t)
    safe = np.where(speed > _MOVES_MPS, speed, 1.0)
    curvature = np.where(speed > _MOVES_MPS, turning / safe, 0.0)
    columns = (t, x, y, wrap_angles(yaw), speed, np.gradient(speed, t), curvature)
    return Points(np.array(columns))
