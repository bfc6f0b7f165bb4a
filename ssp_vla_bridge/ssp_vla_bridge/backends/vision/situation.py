"""The way from tracks to the closed slots: the road users, and what the critical one does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_vla_bridge.backends.vision.tracking import Track

CAMERA_TO_BUMPER_M = 1.8  # assumed; the request doesn't say
OWN_HALF_WIDTH_M = 1.2  # half the VUT's width plus 0.3 m (METHOD 1)
ACTIVE_TTC_S = 2.5
ACTIVE_ARRIVAL_GAP_S = 1.5
POTENTIAL_TTC_S = 5.0

_FARTHEST_M = 55.0
_STANDING_MPS = 0.5
_STANDING_GAP_M = 8.0
_ROADSIDE_M = 5.2
_PARKED_M = 3.0
_POLE_WIDTH_M = 0.42
_POLE_HEIGHT_M = 2.6
_PERSON_HEIGHT_M = 0.9
_STANDING_HEIGHT_M = 1.1
_VEHICLE_HEIGHT_M = 0.9
_VEHICLE_WIDTH_M = 1.35
_SIDE_ON_MPS = 1.2
_SIDE_ON_RATIO = 2.5
_SIDE_ON_WIDTH_M = 2.4
_BROAD_M = 2.5
_TALL_M = 2.45
_WALKER_MPS = 2.4
_CYCLIST_MPS = 8.5
_STILL_MPS = 0.8
_STILL_PER_M = 0.04  # the farther away, the less sure is a speed along the road
_SIDEWAYS_MPS = 0.4
_CROSSING_MPS = 0.5
_ONCOMING_MPS = -2.0
_RECEDING_MPS = 2.5
_FRONT_M = 1.4
_ALONGSIDE_M = 1.5
_VULNERABLE = ("pedestrian", "cyclist")


@dataclass(frozen=True)
class RoadUser:
    """A track with its class, and its speeds over ground and relative to the VUT where known."""

    object_class: str
    track: Track
    ground_mps: float | None
    closing_mps: float | None


@dataclass(frozen=True)
class Situation:
    """The closed slots of METHOD 5.1 for the critical road user; None where nothing is known."""

    objects: tuple[str, ...]
    position: str | None
    motion: str | None
    conflict: str
    distance_m: float | None


def judge(tracks: Sequence[Track], ego_mps: float | None) -> Situation:
    """Select the tracked objects that matter.

    Args:
        tracks: velocities over ground if ego_mps is known, else relative to the VUT.
        ego_mps: the VUT's speed, None when it isn't known.
    """
    users = [user for track in tracks if (user := _road_user(track, ego_mps)) is not None]
    if not users:
        return Situation((), None, None, "no_conflict", None)
    verdicts = [(user, motion := _motion(user), _conflict(user, motion, ego_mps)) for user in users]
    critical, motion, conflict = min(verdicts, key=_urgency)
    others = {
        user.object_class
        for user, _, verdict in verdicts
        if verdict != "no_conflict" and user.object_class != critical.object_class
    }
    return Situation(
        (critical.object_class, *sorted(others)),
        _position(critical.track),
        motion,
        conflict,
        critical.track.x_m,
    )


def _road_user(track: Track, ego_mps: float | None) -> RoadUser | None:
    """Make a road user of a track; None for what is no road user or none that could matter."""
    vx = track.vx_mps
    ground = vx if ego_mps is not None else None
    closing = None if vx is None else (ego_mps or 0.0) - vx
    crossing, driving = _moves(track, ground)
    name = _class(track, ground, crossing or driving)
    if name is None or track.x_m > _FARTHEST_M:
        return None
    vulnerable = name in _VULNERABLE
    if not (crossing or driving):
        # What only stands there matters on the road, and a person beside it too.
        aside = _ROADSIDE_M if vulnerable or ground is None else _PARKED_M
        if abs(track.y_m) > aside or (vulnerable and track.width_m < _POLE_WIDTH_M):
            return None
    elif not crossing and track.width_m < _POLE_WIDTH_M:
        return None  # a pole whose distance was misjudged
    return RoadUser(name, track, ground, closing)


def _moves(track: Track, ground_mps: float | None) -> tuple[bool, bool]:
    """Tell whether it surely moves across the road, and along it."""
    if track.sightings < 3:
        return False, False
    crossing = abs(track.vy_mps or 0.0) > _CROSSING_MPS
    return crossing, abs(ground_mps or 0.0) > _STILL_MPS + _STILL_PER_M * track.x_m


def _class(track: Track, ground_mps: float | None, moving: bool) -> str | None:
    width, height = track.width_m, track.height_m
    sideways, along = abs(track.vy_mps or 0.0), abs(ground_mps or 0.0)
    # A two-wheeler seen from its side is as wide as a car, but goes where it points.
    side_on = sideways > _SIDE_ON_MPS and along < _SIDE_ON_RATIO * sideways
    if width < _VEHICLE_WIDTH_M or (side_on and width < _SIDE_ON_WIDTH_M):
        lowest = _PERSON_HEIGHT_M if moving else _STANDING_HEIGHT_M
        if not lowest <= height <= _POLE_HEIGHT_M:
            return None
        # The speed along the road is the less sure one, so it counts only for who doesn't cross.
        speed = sideways if sideways >= _CROSSING_MPS else along
        if speed > _CYCLIST_MPS:
            return "motorcycle"
        return "cyclist" if width >= _VEHICLE_WIDTH_M or speed > _WALKER_MPS else "pedestrian"
    if height < _VEHICLE_HEIGHT_M:
        return None
    # Straight ahead only the end is seen, so its width tells; elsewhere a side adds to it.
    ahead = abs(track.y_m) < OWN_HALF_WIDTH_M and sideways < _SIDEWAYS_MPS
    return "truck" if height >= _TALL_M or (ahead and width >= _BROAD_M) else "car"


def _motion(user: RoadUser) -> str | None:
    track, ground, closing = user.track, user.ground_mps, user.closing_mps
    if track.vy_mps is None or closing is None:
        return None
    vy = track.vy_mps
    if user.object_class in _VULNERABLE and abs(vy) >= _CROSSING_MPS:
        return "crossing_from_right" if vy > 0 else "crossing_from_left"
    still = _STILL_MPS + _STILL_PER_M * track.x_m
    if ground is not None and abs(ground) <= still and abs(vy) < _SIDEWAYS_MPS:
        return "stationary"
    if ground is not None and ground < min(_ONCOMING_MPS, -still):
        return "oncoming"
    if abs(vy) >= _SIDEWAYS_MPS and user.object_class not in _VULNERABLE:
        if track.y_m * vy < 0 and abs(track.y_m) > 0.4:
            return "cutting_in_from_left" if track.y_m > 0 else "cutting_in_from_right"
        if track.y_m * vy > 0 and 0.5 < abs(track.y_m) < 2.5:
            return "cutting_out"
    if closing < -_RECEDING_MPS:
        return "receding"
    return "same_direction" if ground is not None or closing < 6.0 else None


def _conflict(user: RoadUser, motion: str | None, ego_mps: float | None) -> str:
    """Apply METHOD 1's conflict start: TTC or the gap between the arrivals under a threshold."""
    track = user.track
    gap = max(0.0, track.x_m - CAMERA_TO_BUMPER_M)
    closing = user.closing_mps
    ttc = gap / closing if closing is not None and closing > 0.3 else math.inf
    inside = track.right_m < OWN_HALF_WIDTH_M and track.left_m > -OWN_HALF_WIDTH_M
    vy = track.vy_mps or 0.0
    if motion is not None and motion.startswith("crossing") and not inside:
        if track.y_m * vy > 0:
            return "resolved"
        edge = track.right_m if track.y_m > 0 else -track.left_m
        enters_s = max(0.0, edge - OWN_HALF_WIDTH_M) / abs(vy)
        arrives_s = gap / ego_mps if ego_mps is not None and ego_mps > 0.5 else ttc
        return "active" if abs(arrives_s - enters_s) < ACTIVE_ARRIVAL_GAP_S else "potential"
    if motion is not None and motion.startswith("cutting_in"):
        headway_s = gap / ego_mps if ego_mps is not None and ego_mps > 0.5 else math.inf
        urgent = ttc < ACTIVE_TTC_S or (inside and headway_s < 1.0)
        return "active" if urgent else "potential"
    if inside and motion != "oncoming":
        if ttc < ACTIVE_TTC_S:
            return "active"
        if ego_mps is not None and ego_mps <= _STANDING_MPS and gap < _STANDING_GAP_M:
            return "potential"  # it would be one as soon as the VUT set off
        return "potential" if ttc < POTENTIAL_TTC_S else "no_conflict"
    roadside = user.object_class in _VULNERABLE and abs(track.y_m) < 4.0 and ttc < POTENTIAL_TTC_S
    return "potential" if roadside else "no_conflict"


def _urgency(verdict: tuple[RoadUser, str | None, str]) -> tuple[int, float]:
    user, _, conflict = verdict
    rank = {"active": 0, "potential": 1, "no_conflict": 2, "resolved": 3}[conflict]
    return rank, user.track.x_m + 4.0 * abs(user.track.y_m)


def _position(track: Track) -> str:
    if track.x_m < _ALONGSIDE_M:
        return "left" if track.y_m > 0 else "right"
    if abs(track.y_m) < _FRONT_M:
        return "front"
    return "front_left" if track.y_m > 0 else "front_right"
