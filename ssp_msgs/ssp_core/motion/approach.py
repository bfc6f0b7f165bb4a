"""The approach of an object target: its path, and the points that it is sent before it starts.

The scenario manager dispatches them, and whoever drives an object knows them beforehand from the
run file: the same function gives both the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

from ssp_core.geometry import Polyline
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


def path_of(motion: Drive) -> Polyline:
    """Return the path of a motion, frame map."""
    return _path(tuple(motion.path))


def approach_points(motion: Drive) -> Points:
    """Plan points from standstill along a path to its end, where it stands again.

    Raises:
        ValueError: it can't be driven.
    """
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
