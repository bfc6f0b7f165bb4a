"""The places and bodies of a road's scenery, and whether they are beside the road.

Nothing of a map may stand on the lanes: the camera would show an obstacle that isn't there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssp_core.geometry import Box, FloatArray, Pose2, boxes_overlap, wrap_angle
from ssp_core.run_file.road import Building, Road, SceneryItem, Sign
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine

# The road goes on straight before and beyond the block, and so far what stands there is looked at.
BEFORE_M, BEYOND_M = 60.0, 260.0
FARTHEST_M = 1000.0  # to either side; nobody sees so far
_OUTLINE_STEP_M = 1.0
# Half the side of the square of ground that a sign, a pole or a trunk takes.
_POST_M = 0.1
# A smaller building can't lie between the places of lanes that are looked at: its outline can't
# pass them by.
_ALONG_M, _ACROSS_M = 2.0, 1.0
# On the border of a lane is beside it.
_BORDER_M = 1e-6


def half_extent_m(item: SceneryItem) -> tuple[float, float]:
    """Return half the length and half the width of the ground that an item takes."""
    if isinstance(item, Building):
        return item.length_m / 2, item.width_m / 2
    return _POST_M, _POST_M


def item_pose(item: SceneryItem, line: ReferenceLine) -> Pose2:
    """Return the pose of an item in the line's parent frame.

    Its x axis is along the item's length, or along its traffic's direction.

    Args:
        item: on the line.
        line: the road's.

    Raises:
        NotOneToOne: the line has no such place.
    """
    x, y = line.to_map(item.s_m, item.l_m)
    yaw = line.pose(item.s_m).yaw_rad
    if isinstance(item, Building):
        yaw += item.yaw_rad
    elif isinstance(item, Sign) and item.direction == "backward":
        yaw += math.pi
    return Pose2(x, y, wrap_angle(yaw))


class Clearance:
    """Says of items whether they stand clear of a road's lanes.

    Args:
        lanes: offset of the centre and width of each, m.
    """

    def __init__(self, line: ReferenceLine, lanes: Sequence[tuple[float, float]]) -> None:
        self._line = line
        self._lanes = [(y - width / 2, y + width / 2) for y, width in lanes]
        self._places: FloatArray | None = None

    @classmethod
    def of_road(cls, road: Road) -> Clearance:
        """Make the clearance of a run's road."""
        lanes = [(lane.y_m, lane.width_m) for lane in road.lanes]
        return cls(ReferenceLine.of_road(road), lanes)

    def problem(self, item: SceneryItem) -> str | None:
        """Say why an item can't stand where it is; None: it can."""
        if not -BEFORE_M <= item.s_m <= self._line.length_m + BEYOND_M:
            return "lies beyond the road's ends"
        if abs(item.l_m) > FARTHEST_M:
            return f"lies more than {FARTHEST_M:g} m from the road"
        try:
            pose = item_pose(item, self._line)
        except NotOneToOne:
            return "has no place in the road's coordinates"
        half = half_extent_m(item)
        offsets = self._line.to_local_many(_outline(pose, *half))[:, 1]
        for low, high in self._lanes:
            if bool(((offsets > low + _BORDER_M) & (offsets < high - _BORDER_M)).any()):
                return "stands on the lanes"
        if min(half) > _ACROSS_M and self._surrounds(pose, *half):
            return "stands on the lanes"
        return None

    def _surrounds(self, pose: Pose2, half_length_m: float, half_width_m: float) -> bool:
        """Tell whether some place of the lanes lies inside of a rectangle."""
        if self._places is None:
            self._places = self._lane_places()
        away = self._places - (pose.x_m, pose.y_m)
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        ahead = np.abs(away[:, 0] * c + away[:, 1] * s)
        left = np.abs(away[:, 1] * c - away[:, 0] * s)
        return bool(((ahead < half_length_m) & (left < half_width_m)).any())

    def _lane_places(self) -> FloatArray:
        end = self._line.length_m + BEYOND_M
        poses = self._line.poses(np.arange(-BEFORE_M, end, _ALONG_M).tolist())
        middles = [(low + high) / 2 for low, high in self._lanes]
        return np.array([pose.to_parent(0.0, y) for pose in poses for y in middles])


class SceneryBodies:
    """The bodies of a road's scenery: the ground of each item that is drawn.

    Args:
        road: whose scenery it is, in the map frame.
    """

    def __init__(self, road: Road) -> None:
        self._items = road.scenery
        self._clearance = Clearance.of_road(road)
        line = ReferenceLine.of_road(road)
        self._bodies = {
            i: body for i, item in enumerate(road.scenery) if (body := _body(item, line))
        }
        self._numbers = list(self._bodies)
        bodies = self._bodies.values()
        self._x_m = np.array([body.pose.x_m for body in bodies])
        self._y_m = np.array([body.pose.y_m for body in bodies])
        self._reach_m = np.array([body.reach_m for body in bodies])

    def touched_by(self, box: Box) -> tuple[str, Box] | None:
        """Return the first item that a rectangle shares area with or touches; None: none.

        Returns:
            Its type and place in the run file, as ``tree road.scenery[3]``, and its body.
        """
        away_m = np.hypot(self._x_m - box.pose.x_m, self._y_m - box.pose.y_m)
        for k in np.flatnonzero(away_m <= 1.01 * (box.reach_m + self._reach_m)).tolist():
            number = self._numbers[k]
            item, body = self._items[number], self._bodies[number]
            # What would stand on the lanes isn't drawn, and so isn't there.
            if boxes_overlap(box, body) and self._clearance.problem(item) is None:
                return f"{item.type} road.scenery[{number}]", body
        return None


def _body(item: SceneryItem, line: ReferenceLine) -> Box | None:
    """Return the ground that an item of scenery takes; None: the line has no such place."""
    try:
        pose = item_pose(item, line)
    except NotOneToOne:
        return None
    length_m, width_m = half_extent_m(item)
    return Box(pose, length_m, length_m, 2.0 * width_m)


def _outline(pose: Pose2, half_length_m: float, half_width_m: float) -> FloatArray:
    """Return places along the border of a rectangle, its corners and its middle, shape (n, 2)."""
    along = _steps(half_length_m)
    across = _steps(half_width_m)
    local = np.concatenate(
        [
            np.stack([along, np.full_like(along, half_width_m)], axis=1),
            np.stack([along, np.full_like(along, -half_width_m)], axis=1),
            np.stack([np.full_like(across, half_length_m), across], axis=1),
            np.stack([np.full_like(across, -half_length_m), across], axis=1),
            np.zeros((1, 2)),
        ]
    )
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    turned = local @ np.array([[c, s], [-s, c]])
    return np.asarray(turned + np.array([pose.x_m, pose.y_m]))


def _steps(half_m: float) -> FloatArray:
    return np.linspace(-half_m, half_m, math.ceil(2 * half_m / _OUTLINE_STEP_M) + 1)


def shifted(item: SceneryItem, by_m: float) -> SceneryItem:
    """Return the item along a line that starts by_m earlier."""
    return item.model_copy(update={"s_m": item.s_m + by_m})


def reversed_item(item: SceneryItem, length_m: float) -> SceneryItem:
    """Return the same item along the same line driven the other way, which is that long."""
    place: dict[str, float | str] = {"s_m": length_m - item.s_m, "l_m": -item.l_m}
    if isinstance(item, Building):
        place["yaw_rad"] = wrap_angle(item.yaw_rad + math.pi)
    elif isinstance(item, Sign):
        place["direction"] = "backward" if item.direction == "forward" else "forward"
    return item.model_copy(update=place)


def left_out(road: Road) -> list[str]:
    """List the scenery of a road that can't stand where it is, and why, for people."""
    clearance = Clearance.of_road(road)
    problems = []
    for i, item in enumerate(road.scenery):
        problem = clearance.problem(item)
        if problem is not None:
            problems.append(f"road.scenery[{i}], a {item.type}, {problem}: it isn't drawn")
    return problems
