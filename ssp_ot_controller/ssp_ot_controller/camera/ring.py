"""The roundabout of a synthetic clip: its roads, and the ways around it.

Traffic keeps to the right and drives around to the left. Arms are named by the order in which one
meets them from the VUT's on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import JunctionRoad, Lane
from ssp_core.run_file.values import Start
from ssp_ot_controller.camera.actors import curve_pieces

Bends = tuple[tuple[float, float], ...]
# The arms, by their directions from the middle relative to the VUT's, + left.
VUT_ARM, FIRST_ARM, SECOND_ARM, BEFORE_ARM = (math.radians(a) for a in (0.0, 90.0, 213.0, 287.0))
_ARMS = (VUT_ARM, FIRST_ARM, SECOND_ARM, BEFORE_ARM)
_RING_LANE_M = 4.0


@dataclass(frozen=True)
class Ring:
    """A ring of one lane, with arms of one lane each way.

    Args:
        mouth_m: where the VUT's arm, whose inward lane is the x axis, meets it.
        lane_m: width of the arms' lanes.
        radius_m: of the ring's middle.
        corner_m: radius of the ways into it and out of it.
    """

    mouth_m: float
    lane_m: float
    radius_m: float = 14.0
    corner_m: float = 10.3

    @property
    def corner_rad(self) -> float:
        """Angle by which a way turns right before it is on the ring."""
        return math.acos((0.5 * self.lane_m + self.corner_m) / (self.radius_m + self.corner_m))

    @property
    def _beside_rad(self) -> float:
        """Angle at the middle between an arm and where its ways meet the ring."""
        return 0.5 * math.pi - self.corner_rad

    @property
    def _reach_m(self) -> float:
        """Distance from the middle to where the arms end, m."""
        return (self.radius_m + self.corner_m) * math.sin(self.corner_rad)

    def _place(self, arm_rad: float, ahead_m: float, beside_m: float, turned_rad: float) -> Pose2:
        """Return a pose that is given from the middle along an arm, outwards and to its left."""
        axis = math.pi + arm_rad
        cos, sin = math.cos(axis), math.sin(axis)
        x = self.mouth_m + self._reach_m + cos * ahead_m - sin * beside_m
        return Pose2(x, 0.5 * self.lane_m + sin * ahead_m + cos * beside_m, axis + turned_rad)

    def inward(self, arm_rad: float, before_m: float) -> Pose2:
        """Return the pose on an arm's inward lane so far before it ends."""
        return self._place(arm_rad, self._reach_m + before_m, 0.5 * self.lane_m, math.pi)

    def way(self, from_rad: float, to_rad: float, before_m: float, beyond_m: float) -> Bends:
        """Return the way from one arm to another one, from so far before the ring to beyond it."""
        corner = (self.corner_m * self.corner_rad, -1.0 / self.corner_m)
        around = (to_rad - from_rad) % (2.0 * math.pi) - 2.0 * self._beside_rad
        ring = (self.radius_m * around, 1.0 / self.radius_m)
        return ((before_m, 0.0), corner, ring, corner, (beyond_m, 0.0))

    def roads(self, arm_m: float) -> list[JunctionRoad]:
        """Return the arms, each so long, the ways into the ring and out of it, and the ring."""
        half = 0.5 * self.lane_m
        own = [Lane(y_m=0.0, width_m=_RING_LANE_M, direction="forward")]
        both = [
            Lane(y_m=-half, width_m=self.lane_m, direction="forward"),
            Lane(y_m=half, width_m=self.lane_m, direction="backward"),
        ]
        junction_roads = []
        for here, following in zip(_ARMS, (*_ARMS[1:], _ARMS[0]), strict=True):
            far = self._place(here, self._reach_m + arm_m, 0.0, math.pi)
            junction_roads.append(_road(far, ((arm_m, 0.0),), both, "end"))
            into, ring, out, _ = self.way(here, following, 1.0, 1.0)[1:]
            junction_roads.append(_road(self.inward(here, 0.0), (into, ring), own, "both"))
            on = self._place(here, *self._polar(-self._beside_rad), 0.5 * math.pi)
            turned = on.yaw_rad - self._beside_rad
            on = Pose2(on.x_m, on.y_m, turned)
            junction_roads.append(_road(on, (out,), own, "both"))
            around = (following - here) % (2.0 * math.pi)
            junction_roads.append(_road(on, ((self.radius_m * around, ring[1]),), own, "both"))
        return junction_roads

    def _polar(self, angle_rad: float) -> tuple[float, float]:
        return self.radius_m * math.cos(angle_rad), self.radius_m * math.sin(angle_rad)


def _road(
    start: Pose2, bends: Bends, lanes: Sequence[Lane], end: Literal["end", "both"]
) -> JunctionRoad:
    return JunctionRoad(
        origin=Start(
            x_m=start.x_m, y_m=start.y_m, yaw_rad=math.remainder(start.yaw_rad, 2.0 * math.pi)
        ),
        length_m=sum(length_m for length_m, _ in bends),
        pieces=curve_pieces(bends) if any(bend for _, bend in bends) else [],
        lanes=list(lanes),
        junction_at=end,
    )
