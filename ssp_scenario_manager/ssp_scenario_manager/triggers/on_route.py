"""The check that everybody of a run starts on their path, and the paths lie on the run's road."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ssp_core.geometry import FloatArray, Polyline, wrap_angle
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath, ParticipantSpec
from ssp_core.run_file.road import JunctionRoad
from ssp_core.run_file.values import Path2
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.sumo_network import OVERHANG_M

# The VUT's path leaves its lanes by no more: gaps between lanes are that wide.
_BESIDE_LANES_M = 0.5
# Other paths go no further beyond the road and its sidewalks: a proving ground is wide.
_BESIDE_ROAD_M = 30.0
# The VUT's path goes no further beyond the road's ends; others' may use what SUMO's road has there.
_BEYOND_ENDS_M = 1.0


def off_route(spec: RunSpec) -> list[str]:
    """List starts that don't lie on paths and paths that leave the road, each with its field.

    Args:
        spec: a run whose paths have a length.
    """
    line = ReferenceLine.of_road(spec.road)
    problems: list[str] = []
    ids_with_path: set[str] = set()
    for field, who, path in _paths(spec):
        # The path of a manoeuvre begins where the one before it ends, if there is one.
        if who.id not in ids_with_path:
            problems += _off_start(spec, who, path)
        ids_with_path.add(who.id)
        beyond_m = _BEYOND_ENDS_M if who is spec.vut else OVERHANG_M
        outside = _outside(line, path, _strips(spec, who), beyond_m)
        if who is not spec.vut:
            outside = _off_junction(spec.road.junction, outside)
        if len(outside):
            what = "the VUT's lanes" if who is spec.vut else "its surroundings"
            x_m, y_m = outside[0]
            problems.append(
                f"{field}: x {x_m:.1f} m, y {y_m:.1f} m lies off the run's road "
                f"and {what} (road.origin, road.lanes)"
            )
    return problems


def _paths(spec: RunSpec) -> Iterator[tuple[str, ParticipantSpec, Path2]]:
    """Yield every path with its field and its participant, the participant's approach first."""
    participants = [
        ("vut", spec.vut),
        *((f"targets[{i}]", who) for i, who in enumerate(spec.targets)),
    ]
    for field, who in participants:
        if who.approach is not None:
            yield f"{field}.approach.path", who, who.approach.path
    everybody = {who.id: who for _, who in participants}
    for i, trigger in enumerate(spec.triggers):
        who_acts = everybody.get(trigger.object_id)
        if who_acts is not None and isinstance(trigger.manoeuvre, FollowPath):
            path = trigger.manoeuvre.motion.path
            yield f"triggers[{i}].manoeuvre.motion.path", who_acts, path


def _off_start(spec: RunSpec, who: ParticipantSpec, path: Path2) -> list[str]:
    """Find a start at which arming would refuse an object whose path begins where it does."""
    limits, start = spec.limits, who.start
    name = "vut" if who is spec.vut else f"targets[{spec.targets.index(who)}]"
    first = Polyline(path).pose(0.0)
    problems = []
    away_m = math.hypot(start.x_m - first.x_m, start.y_m - first.y_m)
    if not away_m <= limits.start_region_m:
        problems.append(
            f"{name}.start: lies {away_m:.1f} m from its path's first point, at most "
            f"{limits.start_region_m:g} m (limits.start_region_m)"
        )
    turned_rad = abs(wrap_angle(start.yaw_rad - first.yaw_rad))
    if not turned_rad <= limits.start_yaw_rad:
        problems.append(
            f"{name}.start.yaw_rad: {start.yaw_rad:g} rad differs by {turned_rad:.2f} rad from its "
            f"path's direction, at most {limits.start_yaw_rad:g} rad (limits.start_yaw_rad)"
        )
    return problems


def _strips(spec: RunSpec, who: ParticipantSpec) -> list[tuple[float, float]]:
    """Return offsets (right, left) from the road's line between which a path may lie."""
    road = spec.road
    if who is spec.vut:
        halves = [
            (lane.y_m, lane.width_m / 2 + _BESIDE_LANES_M)
            for lane in road.lanes
            if lane.direction == "forward"
        ]
        return [(y - half, y + half) for y, half in halves]
    right = road.right_edge_m - road.sidewalk_right_m - _BESIDE_ROAD_M
    left = road.left_edge_m + road.sidewalk_left_m + _BESIDE_ROAD_M
    return [(right, left)]


def _outside(
    line: ReferenceLine, path: Path2, strips: Sequence[tuple[float, float]], beyond_m: float
) -> FloatArray:
    """Return the points of a path that lie in no strip along the road, in order."""
    points = np.array(path, dtype=np.float64)
    s, offset = line.to_local_many(points).T
    inside = np.zeros(len(points), dtype=bool)
    for right, left in strips:
        inside |= (offset >= right) & (offset <= left)
    # NaN, where the road has no such place, is inside of nothing.
    inside &= (s >= -beyond_m) & (s <= line.length_m + beyond_m)
    return points[~inside]


def _off_junction(roads: Sequence[JunctionRoad], points: FloatArray) -> FloatArray:
    """Return the points that lie on no road of the junction, in order."""
    for road in roads if len(points) else ():
        s, offset = ReferenceLine.of_road(road).to_local_many(points).T
        inside = (s >= -_BEYOND_ENDS_M) & (s <= road.length_m + _BEYOND_ENDS_M)
        inside &= (offset >= road.right_edge_m) & (offset <= road.left_edge_m)
        points = points[~inside]
    return points
