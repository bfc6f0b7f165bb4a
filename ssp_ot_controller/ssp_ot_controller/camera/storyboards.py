"""Motion for synthetic clips: closed formulas of time, without dynamics, control or traffic.

A clip shows the same interaction as a session with its own speeds, distances, timing and look. A
further scenario is one function and a line in ``_PLAYS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import CurvePiece, JunctionRoad, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.actors import (
    Actor,
    Line,
    Ramp,
    SteeredMotion,
    Turning,
    Winding,
    curve_pieces,
)
from ssp_ot_controller.camera.ring import BEFORE_ARM, FIRST_ARM, SECOND_ARM, VUT_ARM, Ring

LANE_M = 3.4
VUT_START_M = 10.0
KERB_M = -LANE_M / 2  # where the right sidewalk begins, from the VUT's path
CAR, TRUCK, PEDESTRIAN = (
    DEFAULT_SIZES[c] for c in (ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.PEDESTRIAN)
)
Cast = tuple[
    Actor | Turning | Winding, tuple[Actor | Turning | Winding, ...]
]  # the VUT, and who else is there


@dataclass(frozen=True)
class LaneCounts:
    """Lanes of the road that is drawn: in the VUT's direction, and oncoming."""

    same: int = 2
    opposite: int = 2

    @property
    def total(self) -> int:
        return self.same + self.opposite


def clip_road(counts: LaneCounts) -> Road:
    """Return a city road with sidewalks; the VUT's lane is the rightmost."""
    lanes = [
        Lane(y_m=i * LANE_M, width_m=LANE_M, direction="forward" if i < counts.same else "backward")
        for i in range(counts.total)
    ]
    return Road(
        origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
        length_m=260.0,
        lanes=lanes,
        sidewalk_left_m=2.4,
        sidewalk_right_m=2.4,
        crossing_x_m=None,
    )


# From the carriageway to where the arms of a junction begin, and the length of these.
_SETBACK_M, _ARM_M = 6.0, 60.0
# Radius of the way to the left through it, from the oncoming lane.
_TURN_M = 1.5 * LANE_M + _SETBACK_M


def clip_junction(
    counts: LaneCounts, middle_m: float, turning: Turning | None = None
) -> list[JunctionRoad]:
    """Return the roads of a junction: a road of one lane each way crosses the clip's squarely.

    Args:
        counts: lanes of the clip's road.
        middle_m: where the middle of the other road crosses, along the clip's road.
        turning: one that turns has a connecting road of its own.
    """
    along = clip_road(counts).lanes
    across = [
        Lane(y_m=side * LANE_M / 2, width_m=LANE_M, direction=direction)
        for side, direction in ((-1, "forward"), (1, "backward"))
    ]
    half, quarter = LANE_M + _SETBACK_M, math.pi / 2
    right, left = KERB_M - _SETBACK_M, (counts.total - 0.5) * LANE_M + _SETBACK_M
    outer = (counts.total - 1) * LANE_M
    west, east = middle_m - half, middle_m + half

    def road(
        end: Literal["start", "end", "both"],
        pose: tuple[float, float, float],
        length_m: float,
        lanes: Sequence[Lane],
    ) -> JunctionRoad:
        x_m, y_m, yaw_rad = pose
        start = Start(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
        return JunctionRoad(origin=start, length_m=length_m, lanes=list(lanes), junction_at=end)

    def turn(
        x_m: float,
        y_m: float,
        yaw_rad: float,
        curvature_1pm: float = -1.0 / (_SETBACK_M + LANE_M / 2),
    ) -> JunctionRoad:
        """Return a connecting road of one lane; as it is, to the right around a corner."""
        own = [Lane(y_m=0.0, width_m=LANE_M, direction="forward")]
        bare = road("both", (x_m, y_m, yaw_rad), quarter / abs(curvature_1pm), own)
        bend = {"start_curvature_1pm": curvature_1pm, "end_curvature_1pm": curvature_1pm}
        pieces = [CurvePiece(length_m=bare.length_m, **bend)]
        return bare.model_copy(update={"pieces": pieces})

    across_it = []
    if turning is not None:
        heads_east = turning.heading_rad == 0.0
        begins = (west, 0.0, 0.0) if heads_east else (east, turning.start[1], math.pi)
        across_it = [turn(*begins, 1.0 / turning.radius_m)]
    return [
        road("end", (west - _ARM_M, 0.0, 0.0), _ARM_M, along),
        road("start", (east, 0.0, 0.0), _ARM_M, along),
        road("end", (middle_m, right - _ARM_M, quarter), _ARM_M, across),
        road("start", (middle_m, left, quarter), _ARM_M, across),
        road("both", (west, 0.0, 0.0), 2 * half, along),
        road("both", (middle_m, right, quarter), left - right, across),
        turn(west, 0.0, 0.0),
        turn(middle_m + LANE_M / 2, right, quarter),
        turn(east, outer, math.pi),
        turn(middle_m - LANE_M / 2, left, -quarter),
        *across_it,
    ]


# A ramp comes at this angle, then straight on for so long in the junction, and then in an arc.
_RAMP_RAD, _RAMP_M, _RAMP_RADIUS_M = math.radians(20.0), 8.0, 40.0


def clip_ramp(counts: LaneCounts, joins_m: float) -> list[JunctionRoad]:
    """Return the roads of a junction in which a ramp of one lane joins the VUT's lane.

    Args:
        counts: lanes of the clip's road.
        joins_m: where it ends, along the clip's road.
    """
    along, own = clip_road(counts).lanes, [Lane(y_m=0.0, width_m=LANE_M, direction="forward")]
    x_m, y_m = _ramp_start(joins_m)
    cos, sin = math.cos(_RAMP_RAD), math.sin(_RAMP_RAD)
    arc_m, bend = _RAMP_RADIUS_M * _RAMP_RAD, -1.0 / _RAMP_RADIUS_M
    pieces = [
        CurvePiece(length_m=_RAMP_M),
        CurvePiece(length_m=arc_m, start_curvature_1pm=bend, end_curvature_1pm=bend),
    ]
    far = Start(x_m=x_m - _ARM_M * cos, y_m=y_m - _ARM_M * sin, yaw_rad=_RAMP_RAD)
    on = Start(x_m=x_m, y_m=y_m, yaw_rad=_RAMP_RAD)
    roads = [
        JunctionRoad(origin=far, length_m=_ARM_M, lanes=own, junction_at="end"),
        JunctionRoad(
            origin=on, length_m=_RAMP_M + arc_m, pieces=pieces, lanes=own, junction_at="both"
        ),
    ]
    ends: tuple[tuple[float, float, Literal["start", "end", "both"]], ...] = (
        (x_m - _ARM_M, _ARM_M, "end"),
        (x_m, joins_m - x_m, "both"),
        (joins_m, _ARM_M, "start"),
    )
    for begins_m, length_m, end in ends:
        at = Start(x_m=begins_m, y_m=0.0, yaw_rad=0.0)
        roads.append(JunctionRoad(origin=at, length_m=length_m, lanes=along, junction_at=end))
    return roads


def _ramp_start(joins_m: float) -> tuple[float, float]:
    """Return where the ramp meets the junction, by where it ends along the clip's road."""
    cos, sin = math.cos(_RAMP_RAD), math.sin(_RAMP_RAD)
    back_m = _RAMP_RADIUS_M * sin + _RAMP_M * cos
    return joins_m - back_m, -_RAMP_RADIUS_M * (1.0 - cos) - _RAMP_M * sin


# Another one than in the sessions.
CLIP_CAMERA = Camera(
    width_px=960,
    height_px=540,
    hfov_deg=66.0,
    rate_hz=24.0,
    forward_m=1.6,
    height_m=1.35,
    pitch_down_rad=0.02,
    jpeg_quality=92,
)


def clip_look(rng: np.random.Generator) -> Look:
    """Return the light of an evening."""
    return Look(
        palette="dusk_city",
        fog_per_m=float(rng.uniform(0.001, 0.002)),
        sun_azimuth_deg=float(rng.uniform(15.0, 40.0)),
        sun_elevation_deg=float(rng.uniform(9.0, 16.0)),
        exposure=1.15,
        noise_sigma=2.0,
    )


def _vut(speed_mps: float, *ramps: Ramp) -> Actor:
    """Return the car with the camera, in its lane."""
    along = Line(VUT_START_M, speed_mps, ramps)
    return Actor(VUT_ID, ObjectClass.CAR, Role.VUT, along, Line(0.0, 0.0))


def _oncoming(lanes: LaneCounts, start_m: float, speed_mps: float) -> tuple[Actor, ...]:
    """Return a car in the outer oncoming lane; none on a one-way road."""
    along, across = Line(start_m, -speed_mps), Line((lanes.total - 1) * LANE_M, 0.0)
    car = Actor("oncoming_car", ObjectClass.CAR, Role.TRAFFIC, along, across, math.pi)
    return (car,) if lanes.opposite else ()


def cut_in(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a VUT that closes in and a car that cuts in; the VUT brakes to less than its speed."""
    speed = float(rng.uniform(11.0, 12.0))
    slower = float(rng.uniform(4.1, 4.5))  # closing speed at the start
    cut_s, change_s, gap_m = float(rng.uniform(2.9, 3.4)), 2.4, 15.0  # where the lane change starts
    # Across: a speed that swells and goes back; its integral is one lane width.
    peak = 2.0 * LANE_M / change_s
    across = (Ramp(cut_s, change_s / 2, -peak), Ramp(cut_s + change_s / 2, change_s / 2, peak))
    ahead_m = gap_m + slower * cut_s + CAR.front_m + CAR.rear_m
    along = SteeredMotion(VUT_START_M + ahead_m, speed - slower, across)
    other = Actor("ot1", ObjectClass.CAR, Role.OT, along, Line(LANE_M, 0.0, across))
    vut = _vut(speed, Ramp(cut_s + 1.3, 2.2, -slower - 0.6))
    return vut, (other, *_oncoming(lanes, 150.0, 9.0))


def lead_braking(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a VUT that closes in slowly and a car ahead that brakes nearly to a standstill.

    The VUT brakes late.
    """
    speed = float(rng.uniform(12.2, 12.8))
    slower = float(rng.uniform(2.4, 2.8))  # closing speed at the start
    brake_s = float(rng.uniform(2.9, 3.3))
    left = float(rng.uniform(1.6, 2.2))  # speed after braking
    lead_mps, gap_m = speed - slower, 24.0  # when the car ahead begins to brake
    ahead_m = gap_m + slower * brake_s + CAR.front_m + CAR.rear_m
    along = Line(VUT_START_M + ahead_m, lead_mps, (Ramp(brake_s, 2.7, left - lead_mps),))
    lead = Actor("ot1", ObjectClass.CAR, Role.OT, along, Line(0.0, 0.0))
    # In the end a little slower than the car ahead, so that the gap opens again.
    vut = _vut(speed, Ramp(brake_s + 1.35, 3.2, left - 0.5 - speed))
    return vut, (lead, *_oncoming(lanes, 165.0, 9.5))


def _crossing(
    speed_mps: float, brake_s: float, stop_s: float, stand_m: float, step: Ramp
) -> tuple[Actor, Actor, float]:
    """Return a VUT that stops before a pedestrian's path.

    The pedestrian waits on the sidewalk and then steps.

    Args:
        speed_mps: of the VUT before it brakes.
        brake_s: when the VUT begins to brake.
        stop_s: how long the VUT brakes.
        stand_m: from its front to the pedestrian's path in the end.
        step: the pedestrian's change of speed.

    Returns:
        The VUT, the pedestrian, and where the path crosses, along the road.
    """
    stand = VUT_START_M + speed_mps * brake_s + 0.5 * speed_mps * stop_s
    crossing_m = stand + CAR.front_m + stand_m
    along, across = Line(crossing_m, 0.0), Line(KERB_M - 0.6, 0.0, (step,))
    walker = Actor("ot1", ObjectClass.PEDESTRIAN, Role.OT, along, across, math.pi / 2)
    return _vut(speed_mps, Ramp(brake_s, stop_s, -speed_mps)), walker, crossing_m


def occluded_crossing(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a pedestrian who waits hidden and steps out; the VUT stops late before the path."""
    speed = float(rng.uniform(9.5, 10.2))
    step_s = float(rng.uniform(2.5, 2.9))
    walk = float(rng.uniform(1.35, 1.5))
    hidden_m = float(rng.uniform(1.0, 1.4))  # from the truck's front to the pedestrian
    vut, walker, crossing_m = _crossing(speed, step_s + 1.1, 3.4, 4.0, Ramp(step_s, 0.9, walk))
    # The truck stands on the shoulder.
    along = Line(crossing_m - PEDESTRIAN.width_m / 2 - hidden_m - TRUCK.front_m, 0.0)
    across = Line(KERB_M - 0.05 - TRUCK.width_m / 2, 0.0)
    truck = Actor("ot2", ObjectClass.TRUCK, Role.OT, along, across)
    return vut, (walker, truck, *_oncoming(lanes, 140.0, 10.0))


def vru_crossing(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a pedestrian who waits and walks, and a VUT that stops before the path."""
    speed = float(rng.uniform(8.8, 9.6))
    step_s = float(rng.uniform(2.3, 2.7))
    walk = float(rng.uniform(1.3, 1.45))
    vut, walker, _ = _crossing(speed, step_s + 1.0, 3.0, 3.5, Ramp(step_s, 0.6, walk))
    return vut, (walker, *_oncoming(lanes, 118.0, 10.0))


def slow_lead(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a car that drives slowly ahead, a little to the right, and a VUT that brakes late."""
    speed = float(rng.uniform(11.2, 11.8))
    slow = float(rng.uniform(3.6, 4.0))
    near_s = float(rng.uniform(2.9, 3.3))  # when TTC is 4 s
    ahead_m = (speed - slow) * (near_s + 4.0) + CAR.front_m + CAR.rear_m
    along = Line(VUT_START_M + ahead_m, slow)
    lead = Actor("ot1", ObjectClass.CAR, Role.OT, along, Line(-0.35, 0.0))
    # In the end a little slower than the car ahead, so that the gap opens again. The conflict lasts
    # as long as with the driver of a session.
    vut = _vut(speed, Ramp(near_s + 1.4, 4.2, slow - 0.5 - speed))
    return vut, (lead, *_oncoming(lanes, 165.0, 9.5))


def crossing_car(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a car that waits on the road from the right and crosses, and a VUT that stops."""
    speed = float(rng.uniform(8.8, 9.4))
    step_s = float(rng.uniform(2.2, 2.6))
    fast = float(rng.uniform(7.6, 8.2))
    step = Ramp(step_s, 4.0, fast)
    vut, _, crossing_m = _crossing(speed, step_s + 1.4, 3.0, 4.5, step)
    start_m = KERB_M - _SETBACK_M - 1.0 - CAR.front_m
    along, across = Line(crossing_m, 0.0), Line(start_m, 0.0, (step,))
    car = Actor("ot1", ObjectClass.CAR, Role.OT, along, across, math.pi / 2)
    return vut, (car, *_oncoming(lanes, 150.0, 9.0))


def oncoming_turn(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a car that waits on the opposite road and turns across, and a VUT that stops."""
    speed = float(rng.uniform(8.8, 9.4))
    step_s = float(rng.uniform(1.1, 1.5))
    fast = float(rng.uniform(4.3, 4.6))
    vut, _, lane_m = _crossing(speed, step_s + 2.9, 3.4, 5.0, Ramp(step_s, 2.6, fast))
    before_m = 1.0 + CAR.front_m  # of the junction
    start = lane_m + _TURN_M + before_m, lanes.same * LANE_M
    way = Line(0.0, 0.0, (Ramp(step_s, 2.6, fast),))
    car = Turning("ot1", ObjectClass.CAR, Role.OT, way, start, before_m, _TURN_M)
    return vut, (car,)


def vut_turn(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a VUT that waits and turns left, and a car that comes the other way and goes on."""
    speed = float(rng.uniform(5.0, 5.4))
    step_s = float(rng.uniform(2.5, 3.0))
    fast = float(rng.uniform(6.8, 7.3))
    # It comes nearly to a standstill before the car's way, and goes on when the car has passed.
    brake_s, braking_s, slow = step_s + 2.4, 2.0, 0.8
    ways = Ramp(brake_s, braking_s, slow - speed), Ramp(brake_s + braking_s, 2.2, speed - slow)
    way = Line(0.0, speed, ways)
    straight_m = way.position(brake_s + braking_s) + CAR.front_m - _INTO_M
    vut = Turning(
        *(VUT_ID, ObjectClass.CAR, Role.VUT, way, (VUT_START_M, 0.0), straight_m, _TURN_M),
        heading_rad=0.0,
    )
    east_m = VUT_START_M + straight_m + 2.0 * (LANE_M + _SETBACK_M)
    along = Line(east_m + 8.0 + CAR.front_m, 0.0, (Ramp(step_s, 2.2, -fast),))
    across = Line(lanes.same * LANE_M, 0.0)
    car = Actor("ot1", ObjectClass.CAR, Role.OT, along, across, math.pi)
    return vut, (car,)


# The front of a VUT that turns left gives way so far beyond the begin of its turn.
_INTO_M = 3.0


def merge(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a car that waits at the end of a ramp and merges, and a VUT that brakes behind it."""
    speed = float(rng.uniform(9.4, 10.0))
    step_s = float(rng.uniform(1.9, 2.3))
    fast = float(rng.uniform(5.8, 6.2))
    before_m = 1.0 + CAR.front_m  # of the junction
    x_m, y_m = _ramp_start(_JOINS_M)
    start = x_m - before_m * math.cos(_RAMP_RAD), y_m - before_m * math.sin(_RAMP_RAD)
    way = Line(0.0, 0.0, (Ramp(step_s, 2.4, fast),))
    car = Turning(
        "ot1",
        ObjectClass.CAR,
        Role.OT,
        way,
        start,
        before_m + _RAMP_M,
        _RAMP_RADIUS_M,
        _RAMP_RAD,
        -_RAMP_RAD,
    )
    # In the end a little slower than the car ahead, so that the gap opens again.
    vut = _vut(speed, Ramp(step_s + 3.2, 2.4, fast - 0.8 - speed))
    return vut, (car, *_oncoming(lanes, 150.0, 9.0))


# Where the ramp of the clip ends, along its road.
_JOINS_M = 86.0


def cut_out(rng: np.random.Generator, lanes: LaneCounts) -> Cast:
    """Cast a car that leaves the lane, one that stands there, and a VUT that brakes late."""
    speed = float(rng.uniform(10.8, 11.4))
    near_s = float(rng.uniform(2.7, 3.4))  # when TTC to the one that stands is 4 s
    ahead_m = speed * (near_s + 4.0) + CAR.front_m + CAR.rear_m
    standing = Actor(
        "ot1", ObjectClass.CAR, Role.OT, Line(VUT_START_M + ahead_m, 0.0), Line(0.0, 0.0)
    )
    # The other one is beside the lane before it would reach the one that stands.
    leave_s, change_s, gap_m = near_s - 1.1, 2.4, 23.0
    peak = 2.0 * LANE_M / change_s
    across = (Ramp(leave_s, change_s / 2, peak), Ramp(leave_s + change_s / 2, change_s / 2, -peak))
    along = SteeredMotion(VUT_START_M + gap_m + CAR.front_m + CAR.rear_m, speed - 1.5, across)
    leaving = Actor("ot2", ObjectClass.CAR, Role.OT, along, Line(0.0, 0.0, across))
    # No harder than the driver of a session, so that the conflict lasts about as long.
    vut = _vut(speed, Ramp(near_s + 1.4, 4.2, -speed))
    return vut, (standing, leaving, *_oncoming(lanes, 165.0, 9.5))


def roundabout(rng: np.random.Generator, _lanes: LaneCounts) -> Cast:
    """Cast a car that enters a ring and passes the VUT's entry, and a VUT that gives way to it."""
    speed = float(rng.uniform(4.75, 4.9))
    step_s = float(rng.uniform(5.2, 5.5))
    fast = float(rng.uniform(4.9, 5.1))
    before_m = 1.0 + CAR.front_m  # of the ring
    way = Line(0.0, 0.0, (Ramp(step_s, 2.2, fast),))
    bends = _RING.way(BEFORE_ARM, FIRST_ARM, before_m, _ARM_M)
    car = Winding("ot1", ObjectClass.CAR, Role.OT, way, _RING.inward(BEFORE_ARM, before_m), bends)
    # It comes nearly to a standstill at the ring, and goes on when the car has passed.
    brake_s, braking_s, slow = step_s + 5.0, 2.4, 0.5
    on_s = brake_s + braking_s + 0.4
    ramps = Ramp(brake_s, braking_s, slow - speed), Ramp(on_s, 2.2, speed - slow)
    driven = Line(0.0, speed, ramps).position(brake_s + braking_s)
    start_m = _RING.mouth_m - CAR.front_m - driven
    bends = _RING.way(VUT_ARM, SECOND_ARM, _RING.mouth_m, _ARM_M)
    along = Line(start_m, speed, ramps)
    return Winding(VUT_ID, ObjectClass.CAR, Role.VUT, along, Pose2(0.0, 0.0, 0.0), bends), (car,)


# The roundabout of the clip.
_RING = Ring(mouth_m=65.0, lane_m=LANE_M)


# New ones at the end: a scenario's number is part of its seed.
_PLAYS: dict[str, Callable[[np.random.Generator, LaneCounts], Cast]] = {
    "cut_in": cut_in,
    "vru_crossing": vru_crossing,
    "lead_braking": lead_braking,
    "occluded_crossing": occluded_crossing,
    "slow_lead": slow_lead,
    "crossing_car": crossing_car,
    "oncoming_turn": oncoming_turn,
    "merge": merge,
    "cut_out": cut_out,
    "vut_turn": vut_turn,
    "roundabout": roundabout,
}
# Where a road crosses the clip's, by the lane of it that one of the two takes: m to its right.
_AT_JUNCTION = {"crossing_car": LANE_M / 2, "oncoming_turn": -LANE_M / 2, "vut_turn": LANE_M / 2}
INTERACTIONS = tuple(_PLAYS)
FPS = 24.0
_DURATION_S = 9.0
# Clips whose VUT leaves its road are longer: its way is what METHOD 1 measures along.
_LONGER_S = {"vut_turn": 10.5, "roundabout": 17.0}
MOST_LANES = 4
_PATH_STEP_M = 0.5


@dataclass(frozen=True)
class Storyboard:
    """A whole clip before it is drawn; map and block frame are the same."""

    scenario: str
    seed: int
    road: Road
    camera: Camera
    look: Look
    fps: float
    duration_s: float
    vut: Actor | Turning | Winding
    others: tuple[Actor | Turning | Winding, ...]

    @property
    def vut_path(self) -> list[tuple[float, float]]:
        """The path of the VUT: along the road, or its turns and on to the end of the arm."""
        if isinstance(self.vut, Winding):
            line = self.vut.line
            return line.path(0.0, line.length_m, 0.0)
        if isinstance(self.vut, Actor):
            return [(0.0, 0.0), (self.road.length_m, 0.0)]
        on_m = self.vut.straight_m + self.vut.arc_m
        stations = [0.0, *np.arange(self.vut.straight_m, on_m, _PATH_STEP_M), on_m, on_m + _ARM_M]
        return [self.vut.place(float(s))[:2] for s in stations]

    def times(self) -> list[float]:
        """Return the times of the frames in s, from 0."""
        return [k / self.fps for k in range(round(self.duration_s * self.fps))]

    def states(self, t_s: float) -> tuple[ObjectState, ...]:
        """Return the states of all objects, the VUT too, sorted by id."""
        actors = sorted((self.vut, *self.others), key=lambda actor: actor.object_id)
        return tuple(actor.state(t_s) for actor in actors)


def usual_lanes(scenario: str) -> LaneCounts:
    """Return the lanes of a scenario's road: two each way, and one where roads cross."""
    if scenario == "roundabout":
        return LaneCounts(1, 0)
    return LaneCounts(1, 1) if scenario in {*_AT_JUNCTION, "merge"} else LaneCounts()


def storyboard(scenario: str, seed: int, lanes: LaneCounts | None = None) -> Storyboard:
    """Return the clip of a scenario; the seed varies speeds, timing and light a little.

    Args:
        scenario: one of `INTERACTIONS`.
        seed: of speeds, timing and light.
        lanes: of the road, None: the usual ones. They change nothing else.

    Raises:
        InputError: there is no such scenario, or the road has too few lanes for it.
    """
    if scenario not in INTERACTIONS:
        raise InputError(
            "is no scenario", field="scenario", value=scenario, remedy=f"one of {INTERACTIONS}"
        )
    lanes = lanes or usual_lanes(scenario)
    least = 2 if scenario in ("cut_in", "cut_out") else 1
    oncoming = 1 if scenario in ("oncoming_turn", "vut_turn") else 0
    if not least <= lanes.same <= MOST_LANES or not oncoming <= lanes.opposite <= MOST_LANES:
        raise InputError(
            f"can't be drawn on a road of {lanes.same}+{lanes.opposite} lanes",
            field="scenario",
            value=scenario,
            remedy=f"{least} to {MOST_LANES} lanes in the VUT's direction and {oncoming} to "
            f"{MOST_LANES} oncoming ones",
        )
    rng = np.random.default_rng(np.random.SeedSequence([seed, INTERACTIONS.index(scenario)]))
    vut, others = _PLAYS[scenario](rng, lanes)
    road, look = clip_road(lanes), clip_look(rng)
    if scenario in _AT_JUNCTION:
        crosser = next(actor for actor in others if actor.object_id == "ot1")
        lane_m = crosser.state(_DURATION_S).x_m
        turning = crosser if isinstance(crosser, Turning) else None
        if isinstance(vut, Turning):
            turning, lane_m = vut, vut.place(vut.straight_m + vut.arc_m)[0]
        roads = clip_junction(lanes, lane_m - _AT_JUNCTION[scenario], turning)
        road = road.model_copy(update={"junction": roads})
    if scenario == "merge":
        road = road.model_copy(update={"junction": clip_ramp(lanes, _JOINS_M)})
    if isinstance(vut, Winding):
        # The road is the VUT's way, and bends with it.
        bent = {"pieces": curve_pieces(vut.bends), "length_m": sum(m for m, _ in vut.bends)}
        road = road.model_copy(update={**bent, "junction": _RING.roads(_ARM_M)})
    duration_s = _LONGER_S.get(scenario, _DURATION_S)
    return Storyboard(scenario, seed, road, CLIP_CAMERA, look, FPS, duration_s, vut, others)
