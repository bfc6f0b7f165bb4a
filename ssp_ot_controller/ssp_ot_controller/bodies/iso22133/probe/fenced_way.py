"""The way on which a probe may move an object, and the fence that no stop may end outside of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Box, Point, Polyline, Pose2, wrap_angle
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Points
from ssp_core.motion.state import Size
from ssp_core.run_file.participants import Motion
from ssp_core.safety.fence import box_excess_m, way_excess_m

# A default way, and the fastest that a probe drives.
DEFAULT_WAY_M = 20.0
DEFAULT_MPS = 3.0
FASTEST_MPS = 10.0
# An object that is stopped needs no more room than with these.
REACTION_S = 1.5
DECELERATION_MPS2 = 2.0
MARGIN_M = 0.5
# It holds its speed for so long, or nothing could be told of a stop.
_CRUISE_S = 3.0
# An object that stands further off its way, m and rad, isn't sent along it.
_BESIDE_M = 0.5
_ASKEW_RAD = 0.5
_APART_M = 0.1
_ACCELERATION_MPS2 = 1.5


def _motion(path: Sequence[Point], cruise_mps: float) -> Motion:
    return Motion(
        path=list(path),
        cruise_mps=cruise_mps,
        acceleration_mps2=_ACCELERATION_MPS2,
        deceleration_mps2=_ACCELERATION_MPS2,
    )


def motion_of(points: Points) -> Motion | None:
    """Return the way of a trajectory, at its highest speed; None where it leads nowhere."""
    _, x, y, _, speed = points.columns[:5]
    path: list[Point] = []
    for place in zip(x.tolist(), y.tolist(), strict=True):
        if not path or math.dist(place, path[-1]) > _APART_M:
            path.append(place)
    return _motion(path, float(speed.max())) if len(path) > 1 and speed.max() > 0.0 else None


@dataclass(frozen=True, slots=True)
class FencedWay:
    """The region in which an object may be moved.

    Args:
        fence: polygon, m, frame of the datum.
        size: of the object.
        motion: its way and speed; None: straight on from where it stands.
    """

    fence: tuple[Point, ...]
    size: Size
    motion: Motion | None = None

    def plan(self, pose: Pose2) -> Points | str:
        """Plan points from a pose on; return why where it can't be moved from there."""
        motion = self._rest(pose)
        if isinstance(motion, str):
            return motion
        if motion.cruise_mps > FASTEST_MPS:
            return f"{motion.cruise_mps:g} m/s is faster than a probe drives ({FASTEST_MPS:g} m/s)"
        try:
            points = approach_points(motion)
        except ValueError as error:
            return f"its way can't be driven: {error}"
        t_s, _, _, _, speed = points.columns[:5]
        cruising = t_s[speed >= 0.99 * motion.cruise_mps]
        if len(cruising) < 2 or cruising[-1] - cruising[0] < _CRUISE_S:
            return f"its way is too short to hold {motion.cruise_mps:g} m/s for {_CRUISE_S:g} s"
        outside_m = self.outside_m(points)
        if outside_m > 0.0:
            return f"its way or a stop from it would end {outside_m:.1f} m outside of the fence"
        return points

    def outside_m(self, points: Points) -> float:
        """Compute how far the object would stick out of the fence at the worst, with every stop."""
        _, x, y, yaw, speed = points.columns[:5]
        way = speed * REACTION_S + speed**2 / (2.0 * DECELERATION_MPS2) + MARGIN_M
        # The way itself, and each stop: straight on, so that its two ends sweep all of it.
        stops_x = np.stack((x, x + way * np.cos(yaw)), axis=-1)
        stops_y = np.stack((y, y + way * np.sin(yaw)), axis=-1)
        stops_yaw = np.stack((yaw, yaw), axis=-1)
        stops = way_excess_m(stops_x, stops_y, stops_yaw, self.size, self.fence)
        return float(max(stops.max(), way_excess_m(x, y, yaw, self.size, self.fence).max()))

    def holds(self, pose: Pose2) -> bool:
        size = self.size
        box = Box(pose, size.front_m, size.rear_m, size.width_m)
        return not box_excess_m(box, self.fence) > 0.0

    def _rest(self, pose: Pose2) -> Motion | str:
        """Return the part of its way that is left from here."""
        if self.motion is None:
            ahead = pose.to_parent(DEFAULT_WAY_M, 0.0)
            return _motion([(pose.x_m, pose.y_m), ahead], DEFAULT_MPS)
        line = Polyline(self.motion.path)
        station_m, left_m = line.project(pose.x_m, pose.y_m)
        off_rad = abs(wrap_angle(line.pose(station_m).yaw_rad - pose.yaw_rad))
        if abs(left_m) > _BESIDE_M or off_rad > _ASKEW_RAD:
            return (
                f"it stands {abs(left_m):.1f} m and {math.degrees(off_rad):.0f}° off its "
                "trajectory: bring it there"
            )
        here = line.pose(station_m)
        stations = zip(line.stations_m.tolist(), self.motion.path, strict=True)
        rest = [point for at_m, point in stations if at_m > station_m + 0.1]
        path = [(here.x_m, here.y_m), *rest]
        if len(path) < 2:
            return "it stands at its trajectory's end: bring it back"
        return self.motion.model_copy(update={"path": path})
