"""The place of recorded paths on the road."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Lane, Road
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.maps.block import STRAIGHT_BELOW_1PM

_CURVATURE_STEP_M = 1.0


@dataclass(frozen=True)
class Spot:
    """A place on the road.

    Args:
        s_m: arc length along the reference line.
        l_m: offset, + left of the line.
        lane: index from right to left; None: on no lane.
    """

    s_m: float
    l_m: float
    lane: int | None


class Lanes:
    """The lanes of a run's road, seen by somebody who drives on it.

    Args:
        forward: whether the VUT drives along the reference line or against it. All that is left
            and right below is so for the VUT.
    """

    def __init__(self, road: Road, forward: bool = True) -> None:
        self.line = ReferenceLine.of_road(road)
        self.forward = forward
        self.lanes: tuple[Lane, ...] = tuple(sorted(road.lanes, key=lambda lane: lane.y_m))
        self.junction = tuple((ReferenceLine.of_road(one), one) for one in road.junction)

    @classmethod
    def of(cls, road: Road, vut: Iterable[ObjectState]) -> Lanes:
        """Return the road as a recorded VUT drives on it; along the line where it never moves."""
        lanes = cls(road)
        votes = 0.0
        for state in vut:
            spot = lanes.spot(state)
            if spot is not None:
                turn = state.yaw_rad - lanes.line.pose(spot.s_m).yaw_rad
                votes += state.speed_mps * math.cos(turn)
        return lanes if votes >= 0.0 else cls(road, forward=False)

    def spot(self, state: ObjectState) -> Spot | None:
        """Return the place of an object's middle; None where the road has no coordinates for it."""
        middle = (state.size.front_m - state.size.rear_m) / 2.0
        try:
            s_m, l_m = self.line.to_local(*state.pose.to_parent(middle, 0.0))
        except NotOneToOne:
            return None
        return Spot(s_m, l_m, self._lane_at(l_m))

    def _lane_at(self, l_m: float) -> int | None:
        inside = [
            (abs(lane.y_m - l_m), index)
            for index, lane in enumerate(self.lanes)
            if abs(lane.y_m - l_m) <= lane.width_m / 2.0
        ]
        return min(inside)[1] if inside else None

    def is_same_direction(self, index: int) -> bool:
        """Return True for a lane in the VUT's direction."""
        return (self.lanes[index].direction == "forward") == self.forward

    @property
    def same_direction(self) -> int:
        """Lanes in the VUT's direction."""
        return sum(self.is_same_direction(i) for i in range(len(self.lanes)))

    @property
    def opposite(self) -> int:
        """Oncoming lanes."""
        return len(self.lanes) - self.same_direction

    def lane_words(self, lane: int | None) -> tuple[str, ...]:
        """Return a lane's places in the VUT's direction: any of rightmost, middle, leftmost."""
        own = [i for i in range(len(self.lanes)) if self.is_same_direction(i)]
        if not self.forward:
            own.reverse()
        if lane is None:
            return ("off the road",)
        if lane not in own:
            return ("oncoming",)
        place = own.index(lane)
        words = ["rightmost"] if place == 0 else []
        words += ["leftmost"] if place == len(own) - 1 else []
        return tuple(words) or ("middle",)

    def place_word(self, spot: Spot, own_lane: int | None) -> str:
        """Return a place as a word of K*'s initial regions, from the VUT's lane."""
        side = 1.0 if self.forward else -1.0
        if spot.lane is None:
            middle = (self.lanes[0].y_m + self.lanes[-1].y_m) / 2.0
            at = np.array([self.line.to_map(spot.s_m, spot.l_m)])
            place = "road" if self.is_on_junction(at) else "kerb"
            return f"left_{place}" if (spot.l_m - middle) * side > 0.0 else f"right_{place}"
        if spot.lane == own_lane:
            return "vut_lane"
        if not self.is_same_direction(spot.lane):
            return "oncoming_lane"
        if own_lane is None:
            return "another_lane"
        steps = round((spot.lane - own_lane) * side)
        name = "left" if steps > 0 else "right"
        return f"{name}_lane" if abs(steps) == 1 else f"{abs(steps)}_lanes_{name}"

    def offset_m(self, spot: Spot, lane: int) -> float:
        """Return the offset of a place from the middle of a lane, + left as the VUT sees it."""
        return (spot.l_m - self.lanes[lane].y_m) * (1.0 if self.forward else -1.0)

    def is_on_junction(self, at: FloatArray, *, arms: bool = True) -> bool:
        """Tell whether any of some places lies on a road of the junction.

        Args:
            at: rows x, y in map.
            arms: its arms count too, or else the connecting roads in it alone.
        """
        for line, road in self.junction:
            if not arms and road.junction_at != "both":
                continue
            s_m, l_m = line.to_local_many(at).T
            along = (s_m >= 0.0) & (s_m <= road.length_m)
            if (along & (l_m >= road.right_edge_m) & (l_m <= road.left_edge_m)).any():
                return True
        return False

    def segment(self, from_s_m: float, to_s_m: float, zone: FloatArray | None) -> str:
        """Return ``junction``, ``straight`` or ``curve``; the latter two by the tightest bend.

        A road that leads through a junction is one where the conflict zone lies on a connecting
        road; without a conflict zone it is one throughout, as its block is.

        Args:
            from_s_m: arc length of one end of the stretch.
            to_s_m: of the other.
            zone: outline of the conflict zone, rows x, y in map; None: there is none.
        """
        if self.junction and (zone is None or self.is_on_junction(zone, arms=False)):
            return "junction"
        low, high = sorted((from_s_m, to_s_m))
        steps = max(1, math.ceil((high - low) / _CURVATURE_STEP_M))
        tightest = max(
            abs(self.line.curvature_1pm(low + (high - low) * k / steps)) for k in range(steps + 1)
        )
        return "straight" if tightest < STRAIGHT_BELOW_1PM else "curve"
