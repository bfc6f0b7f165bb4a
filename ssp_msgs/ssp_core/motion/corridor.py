"""The swept corridor of the VUT, and what boxes cover of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from ssp_core.geometry import Polyline, Pose2, wrap_angle
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import ObjectState
from ssp_core.value_class import value_class

_EXTENSION_M = 500.0
_POINT_SPACING_M = 0.5
# So many boxes are projected at once.
_TOGETHER = 16


@value_class(frozen=True, slots=True)
class Extent:
    """Stations and offsets that a box covers along a path, m; offsets are + to the left."""

    s_min_m: float
    s_max_m: float
    l_min_m: float
    l_max_m: float


@dataclass(frozen=True, slots=True)
class Corridor:
    """The VUT's swept corridor: its path, straight on beyond its ends, and half its width."""

    path: Polyline
    half_width_m: float

    @classmethod
    def of(cls, vut: Sequence[ObjectState]) -> Corridor:
        """Return the corridor of a recorded VUT.

        Args:
            vut: its states in time order, at least one.
        """
        points = [(vut[0].x_m, vut[0].y_m)]
        for state in islice(vut, 1, None):
            if math.dist(points[-1], (state.x_m, state.y_m)) >= _POINT_SPACING_M:
                points.append((state.x_m, state.y_m))
        points.insert(0, vut[0].pose.to_parent(-_EXTENSION_M, 0.0))
        end = Pose2(*points[-1], vut[-1].yaw_rad)
        points.append(end.to_parent(_EXTENSION_M, 0.0))
        return cls(Polyline(points), corridor_half_m(vut[0].size.width_m))

    def extent(self, state: ObjectState) -> Extent:
        """Return the stations and offsets that an object's box covers."""
        return next(self.extents([state]))

    def extents(self, states: Iterable[ObjectState]) -> Iterator[Extent]:
        """Yield the stations and offsets that boxes cover.

        Many are projected at once: neighbours in time look for nearly the same pieces of the path.
        """
        more = iter(states)
        while boxes := [state.box.corners() for state in islice(more, _TOGETHER)]:
            corners = [corner for box in boxes for corner in box]
            projected = iter(self.path.project_all_beyond(corners))
            for box in boxes:
                stations, offsets = zip(*islice(projected, len(box)), strict=True)
                yield Extent(min(stations), max(stations), min(offsets), max(offsets))

    def overlaps(self, extent: Extent) -> bool:
        """Tell whether an extent reaches into the corridor sideways."""
        return extent.l_min_m <= self.half_width_m and extent.l_max_m >= -self.half_width_m

    def holds(self, extent: Extent) -> bool:
        """Tell whether an extent lies within the corridor sideways."""
        return extent.l_min_m >= -self.half_width_m and extent.l_max_m <= self.half_width_m

    def heading_rad(self, state: ObjectState) -> float:
        """Return the angle from the path's direction to where it faces, + to the left."""
        station, _ = self.path.project_beyond(state.x_m, state.y_m)
        return wrap_angle(state.yaw_rad - self.path.pose(station).yaw_rad)

    def velocity(self, state: ObjectState) -> tuple[float, float]:
        """Return the speed along the path and to its left, m/s."""
        angle = self.heading_rad(state)
        return state.speed_mps * math.cos(angle), state.speed_mps * math.sin(angle)

    def front_m(self, vut: ObjectState) -> float:
        """Return the station of the VUT's front bumper."""
        return next(self.fronts_m([vut]))

    def fronts_m(self, vut: Iterable[ObjectState]) -> Iterator[float]:
        """Yield the stations of the VUT's front bumper at many states."""
        more = iter(vut)
        while fronts := [
            state.pose.to_parent(state.size.front_m, 0.0) for state in islice(more, _TOGETHER)
        ]:
            yield from (station for station, _ in self.path.project_all_beyond(fronts))
