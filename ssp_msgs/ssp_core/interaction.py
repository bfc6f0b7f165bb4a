"""How an object stands to the VUT: gap, TTC, arrivals at the conflict zone (METHOD 1).

Everything is measured along the VUT's path, so that it holds for straight and curved roads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.geometry import Polyline
from ssp_core.state import ObjectState

# METHOD 1: a swept corridor is the vehicle's width plus this on each side.
CORRIDOR_MARGIN_M = 0.3
# METHOD 1: lateral speed towards the VUT's corridor above which a manoeuvre is observable.
OBSERVABLE_LATERAL_MPS = 0.2
_SLOWEST_MPS = 0.05


@dataclass(frozen=True, slots=True)
class Encounter:
    """One object relative to the VUT at one instant.

    Args:
        gap_m: bumper gap along the VUT's path, from the VUT's front to the object's nearest
            point; negative when the object has begun to pass or is behind.
        lateral_m: offset of the object's nearest point from the VUT's path, + is left.
        clearance_m: distance of the object from the VUT's corridor, 0 when inside it.
        towards_mps: lateral speed towards the middle of the corridor, negative when leaving.
        along_mps: speed of the object along the VUT's path.
        ttc_s: bumper gap over closing speed, +inf while not closing, when the object is behind, and
            while it is outside the VUT's corridor and doesn't move towards it.
        vut_arrival_s: until the VUT's front reaches the conflict zone at its present speed.
        object_arrival_s: until the object reaches the VUT's corridor, 0 when inside, +inf when it
            doesn't move towards it.
    """

    gap_m: float
    lateral_m: float
    clearance_m: float
    towards_mps: float
    along_mps: float
    ttc_s: float
    vut_arrival_s: float
    object_arrival_s: float

    @property
    def in_corridor(self) -> bool:
        return self.clearance_m == 0.0

    @property
    def arrival_gap_s(self) -> float:
        """Gap between the two predicted arrivals at the zone, +inf when one never arrives."""
        if math.isinf(self.vut_arrival_s) or math.isinf(self.object_arrival_s):
            return math.inf
        return abs(self.vut_arrival_s - self.object_arrival_s)


def encounter(vut: ObjectState, other: ObjectState, path: Polyline) -> Encounter:
    """The object relative to the VUT, at the present speeds of both (METHOD 1).

    The conflict zone's start is where the object's rearmost point along the path will be when the
    object reaches the corridor: for a crossing that is beside the object, for a cut-in it moves on
    with it.

    Args:
        vut: state of the VUT.
        other: state of the object at the same stamp.
        path: the VUT's path, frame map.
    """
    vut_station, _ = path.project_beyond(vut.x_m, vut.y_m)
    front = vut_station + vut.size.front_m
    projected = [path.project_beyond(x, y) for x, y in other.box.corners()]
    stations = [s for s, _ in projected]
    offsets = [d for _, d in projected]
    nearest, farthest = min(stations), max(stations)
    low, high = min(offsets), max(offsets)

    heading = other.yaw_rad - path.pose(0.5 * (nearest + farthest)).yaw_rad
    along = other.speed_mps * math.cos(heading)
    leftwards = other.speed_mps * math.sin(heading)
    centre = 0.5 * (low + high)
    towards = -math.copysign(leftwards, leftwards * centre) if centre else abs(leftwards)

    half = vut.size.width_m / 2.0 + CORRIDOR_MARGIN_M
    clearance = max(0.0, low - half, -half - high)
    lateral = 0.0 if low <= 0.0 <= high else (low if low > 0.0 else high)

    gap = nearest - front
    closing = vut.speed_mps - along
    ttc = gap / closing if closing > _SLOWEST_MPS and gap >= 0.0 else math.inf
    if clearance == 0.0:
        object_arrival = 0.0
    elif towards > _SLOWEST_MPS:
        object_arrival = clearance / towards
    else:
        object_arrival = math.inf
        ttc = math.inf
    vut_arrival = math.inf
    if math.isfinite(object_arrival) and vut.speed_mps > _SLOWEST_MPS:
        zone_start = nearest + along * object_arrival - front
        if zone_start >= 0.0:
            vut_arrival = zone_start / vut.speed_mps
        elif farthest + along * object_arrival > vut_station - vut.size.rear_m:
            vut_arrival = 0.0
    return Encounter(
        gap_m=gap,
        lateral_m=lateral,
        clearance_m=clearance,
        towards_mps=towards,
        along_mps=along,
        ttc_s=ttc,
        vut_arrival_s=vut_arrival,
        object_arrival_s=object_arrival,
    )


def is_conflict(meeting: Encounter, ttc_s: float, arrival_gap_s: float) -> bool:
    """METHOD 1: TTC or the gap between the predicted arrivals is under its threshold.

    An object that is inside the corridor and not being approached is no conflict: its arrival is
    past, so that the gap between arrivals says nothing about it.
    """
    if meeting.ttc_s < ttc_s:
        return True
    return not meeting.in_corridor and meeting.arrival_gap_s < arrival_gap_s
