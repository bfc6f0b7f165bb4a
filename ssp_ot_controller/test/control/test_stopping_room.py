"""A stop must end inside the fence: along the path, past its end, and blindly along an arc."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.motion.reference import Points, Reference
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety.stopping import EMERGENCY_BRAKE_MPS2, stopping_of
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS as BODIES
from ssp_ot_controller.control.stopping import Shortfall, StoppingRoom
from ssp_ot_controller.control.tracker import Track
from tests.support.states import object_state

S = 1_000_000_000
CAR, WALKER = ObjectClass.CAR, ObjectClass.PEDESTRIAN
LIMITS = Limits(speed_mps=15.0, acceleration_mps2=5.0, state_age_s=0.3, frozen_s=0.2)
PATH = Polyline([(0.0, 0.0), (200.0, 0.0)])
DRIVE = drive_along(PATH, 0.0, 0.0, 12.0, 2.0, 2.0)


def fence(right_m: float = -50.0, end_m: float = 300.0) -> list[tuple[float, float]]:
    return [(-20.0, right_m), (end_m, right_m), (end_m, 50.0), (-20.0, 50.0)]


def room(cls: ObjectClass = CAR, **sides: float) -> StoppingRoom:
    return StoppingRoom(cls, DEFAULT_SIZES[cls], LIMITS, fence(**sides), 0.02)


def state(cls: ObjectClass = CAR, **changes: float) -> ObjectState:
    return object_state("ot1", cls, **{"x_m": 50.0, "speed_mps": 10.0, **changes})


def blind_m(speed_mps: float, cls: ObjectClass = CAR, slows_s: float = 0.0) -> float:
    """v (silence + reaction) + v^2 / 2a with the hardest braking, and the margin."""
    s = stopping_of(cls, LIMITS, 0.02, slows_s)
    hardest = BODIES[cls].emergency_deceleration_mps2
    return speed_mps * (0.3 + s.reaction_s) + speed_mps**2 / (2.0 * hardest) + s.margin_m


def test_a_reference_that_stands_is_judged_where_it_stands() -> None:
    columns = np.zeros((7, 2))
    columns[0, 1] = 1.0
    assert room().lack(columns) is None
    assert room(right_m=-0.5).lack(columns) is not None


@pytest.mark.parametrize("speed_mps", [0.5, 3.0, 10.0, 15.0])
def test_blind_stop_straight_on_at_its_boundary(speed_mps: float) -> None:
    here = state(speed_mps=speed_mps)
    end_m = 50.0 + blind_m(speed_mps) + here.size.front_m
    assert room(end_m=end_m).excess_m(here, None, None) == 0.0
    assert room(end_m=end_m + 0.01).excess_m(here, None, None) == 0.0
    assert room(end_m=end_m - 0.01).excess_m(here, None, None) == pytest.approx(0.01)


def test_a_body_that_slows_late_needs_its_way_until_then() -> None:
    """One second beside the 0.25 s that the brakes of a car need, at 10 m/s."""
    assert stopping_of(CAR, LIMITS, 0.02, 0.1) == stopping_of(CAR, LIMITS, 0.02)
    assert blind_m(10.0, slows_s=1.0) == pytest.approx(blind_m(10.0) + 7.5)
    here = state()
    for more_m in (0.01, -0.01):
        around = fence(end_m=50.0 + blind_m(10.0, slows_s=1.0) + here.size.front_m + more_m)
        late = StoppingRoom(CAR, here.size, LIMITS, around, 0.02, 1.0)
        assert late.excess_m(here, None, None) == pytest.approx(max(-more_m, 0.0))
        assert StoppingRoom(CAR, here.size, LIMITS, around, 0.02).excess_m(here, None, None) == 0.0


@pytest.mark.parametrize(
    ("points", "sides", "how"),
    [
        (DRIVE, {"end_m": 204.6}, "past its end"),
        (lane_change(PATH, 10.0, 13.0, -3.5, 2.5, 13.0, 2.0), {"right_m": -12.0}, "its steering"),
    ],
    ids=["past its end", "blind"],
)
def test_a_reference_needs_more_room_for_a_body_that_slows_late(
    points: Points, sides: dict[str, float], how: str
) -> None:
    def lack(slows_s: float) -> Shortfall | None:
        around = fence(**sides)
        judge = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, around, 0.02, slows_s)
        return judge.lack(points.columns)

    assert lack(0.25) is None
    late = lack(1.0)
    assert late is not None
    assert how in late.how


def test_a_blind_stop_follows_the_arc_that_the_object_is_on() -> None:
    right = state(yaw_rate_radps=-10.0 * 0.05)  # radius 20 m
    turned = 0.05 * blind_m(10.0)
    lowest = -(1.0 - math.cos(turned)) / 0.05 - 3.6 * math.sin(turned) - 0.9 * math.cos(turned)
    assert room(right_m=lowest - 0.01).excess_m(right, None, None) == 0.0
    assert room(right_m=lowest + 0.01).excess_m(right, None, None) == pytest.approx(0.01, rel=0.1)
    assert room(right_m=lowest + 0.01).excess_m(state(), None, None) == 0.0


def walled(at_m: float, low_m: float, wall_m: float = 0.01) -> list[tuple[float, float]]:
    """A thin notch from the left side of the fence down to a place beside or on the path."""
    wall = [(at_m + wall_m, 50.0), (at_m + wall_m, low_m), (at_m, low_m), (at_m, 50.0)]
    return [(-20.0, -50.0), (300.0, -50.0), (300.0, 50.0), *wall, (-20.0, 50.0)]


@pytest.mark.parametrize("at_m", [54.0, 57.3, 58.9, 62.0])
@pytest.mark.parametrize(("low_m", "good"), [(0.95, True), (0.85, False), (-5.0, False)])
def test_all_that_a_blind_stop_sweeps_counts(at_m: float, low_m: float, good: bool) -> None:
    """A wall that lies anywhere between here and the end of the stop."""
    judge = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, walled(at_m, low_m), 0.02)
    assert at_m < 50.0 + blind_m(10.0) + 3.6
    assert (judge.excess_m(state(), None, None) == 0.0) == good
    assert judge.outside_m(state()) == (0.0 if good or at_m > 53.6 else pytest.approx(0.05))
    reference = drive_along(PATH, 0.0, 0.0, 12.0, 2.0, 2.0)
    # A reference needs 0.2 m more to each side.
    assert judge.lack(reference.columns) is not None
    wide = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, walled(at_m, low_m + 0.2), 0.02)
    assert (wide.lack(reference.columns) is None) == good


def test_a_wall_past_the_end_of_the_path_counts() -> None:
    reference = Reference("r", "ot", "v", "approach", 0, 0, S, DRIVE)
    needed_m = stopping_of(CAR, LIMITS, 0.02).distance_m(10.0, 0.0)
    near, track = state(x_m=150.0), Track(reference)
    for share, good in ((0.5, False), (1.01, True)):
        at_m = 203.6 + share * (needed_m - 10.0)
        judge = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, walled(at_m, -5.0), 0.02)
        assert (judge.excess_m(near, 10.0, track) == 0.0) == good
        assert (judge.lack(DRIVE.columns) is None) == (at_m > 205.0)


def test_what_an_object_sweeps_between_two_states_counts() -> None:
    fence = walled(50.0, -5.0)
    for gap_m, out in ((0.4, False), (4.6, True)):
        judge = StoppingRoom(WALKER, DEFAULT_SIZES[WALKER], LIMITS, fence, 0.02)
        assert judge.outside_m(state(WALKER, x_m=50.0 - gap_m / 2)) == 0.0 or not out
        there = judge.outside_m(state(WALKER, x_m=50.01 + gap_m / 2))
        assert there > 0.0
        assert (judge.outside_m(state(WALKER, x_m=50.01 + gap_m / 2)) == 0.0) == out


def test_a_stop_that_was_clear_is_judged_as_if_nothing_had_been_remembered() -> None:
    """The way that was measured last answers for the next only where that is sure."""
    random = np.random.default_rng(1)
    fence = walled(80.0, 4.0, 2.0)
    fence[:2] = [(-20.0, -6.0), (300.0, -6.0)]
    remembers = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, fence, 0.02)
    x_m, y_m, yaw_rad, found = 0.0, 0.0, 0.0, {True: 0, False: 0}
    for _ in range(400):
        rate = float(random.normal(0.0, 0.3))
        yaw_rad += 0.05 * rate - 0.1 * yaw_rad
        x_m, y_m = x_m + 0.5, y_m + 0.5 * math.sin(yaw_rad) - 0.02 * y_m
        here = state(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, yaw_rate_radps=rate)
        anew = StoppingRoom(CAR, DEFAULT_SIZES[CAR], LIMITS, fence, 0.02)
        excess_m = remembers.excess_m(here, None, None)
        assert excess_m == anew.excess_m(here, None, None)
        found[excess_m == 0.0] += 1
    assert min(found.values()) > 20, found


def test_a_walker_that_turns_on_the_spot_stops_straight_on() -> None:
    walker = state(WALKER, speed_mps=1.5, yaw_rate_radps=-2.0)
    assert room(WALKER, right_m=-0.3).excess_m(walker, None, None) == 0.0
    ahead = room(WALKER, end_m=50.0 + blind_m(1.5, WALKER) + 0.2)
    assert ahead.excess_m(walker, None, None) == pytest.approx(0.05)


def test_past_the_end_of_the_path_a_stop_goes_straight_on() -> None:
    """The last 10 m of a path at 10 m/s: service braking needs more than they have."""
    reference = Reference("r", "ot", "v", "approach", 0, 0, S, DRIVE)
    track = Track(reference)
    assert (track.end.x_m, track.end.y_m) == (200.0, 0.0)
    needed_m = stopping_of(CAR, LIMITS, 0.02).distance_m(10.0, 0.0)
    end_m = 200.0 + needed_m - 10.0 + 3.6
    near = state(x_m=150.0)
    assert room(end_m=end_m + 0.01).excess_m(near, 10.0, track) == 0.0
    assert room(end_m=end_m - 0.01).excess_m(near, 10.0, track) == pytest.approx(0.01)
    assert room(end_m=end_m - 0.01).excess_m(near, 10.1, track) == 0.0


@pytest.mark.parametrize(("end_m", "good"), [(204.6, True), (204.0, False)])
def test_a_reference_needs_room_past_its_end(end_m: float, good: bool) -> None:
    lack = room(end_m=end_m).lack(DRIVE.columns)
    assert (lack is None) == good
    if lack is not None:
        assert "past its end" in lack.how
        assert 0.0 < lack.excess_m < 1.0


@pytest.mark.parametrize(("right_m", "good"), [(-12.0, True), (-6.0, False)])
def test_a_lane_change_needs_room_to_stop_blindly(right_m: float, good: bool) -> None:
    """Held steering leads farthest right from the place of the hardest steering to the right."""
    points = lane_change(PATH, 10.0, 13.0, -3.5, 2.5, 13.0, 2.0)
    lack = room(right_m=right_m).lack(points.columns)
    assert (lack is None) == good
    if lack is not None:
        assert "holds its steering" in lack.how
        assert points[lack.point].curvature_1pm < 0.0


def test_who_drives_an_accepted_reference_may_stop_anywhere() -> None:
    """The check of references asks for more room than the check while driving."""
    points = lane_change(PATH, 10.0, 13.0, -3.5, 2.5, 13.0, 2.0)
    for right_m in np.arange(-12.0, -5.0, 0.25):
        judge = room(right_m=float(right_m))
        if judge.lack(points.columns) is not None:
            continue
        for p in points:
            here = state(
                x_m=p.x_m,
                y_m=p.y_m,
                yaw_rad=p.yaw_rad,
                speed_mps=p.speed_mps,
                yaw_rate_radps=p.speed_mps * p.curvature_1pm,
            )
            assert judge.excess_m(here, None, None) == 0.0


def test_the_bodies_brake_as_hard_as_is_relied_upon() -> None:
    known = {cls: body.emergency_deceleration_mps2 for cls, body in BODIES.items()}
    assert known == EMERGENCY_BRAKE_MPS2
