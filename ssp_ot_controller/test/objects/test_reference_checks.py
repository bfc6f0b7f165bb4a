"""Refusals of references: every number, at its boundary, with measured value and limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.vocabulary import ControlState, ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS
from ssp_ot_controller.control.stopping import StoppingRoom
from ssp_ot_controller.objects.references import Refusal, RefusalCode, check_reference
from tests.support.states import object_state

S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (200.0, 0.0)])
FENCE = [(-10.0, -10.0), (220.0, -10.0), (220.0, 10.0), (-10.0, 10.0)]
VERSION = "sha256:aa"


def standing(cls: ObjectClass = ObjectClass.CAR, **changes: Any) -> ObjectState:
    return object_state("ot", cls, **{"stamp_ns": 10 * S, **changes})


def reference(**changes: Any) -> Reference:
    points = drive_along(PATH, 0.0, 0.0, 12.0, 2.0, 2.0)
    base = Reference(
        "r1", "ot", VERSION, "approach", 10 * S, 10 * S + S // 10, 11 * S, tuple(points)
    )
    return replace(base, **changes)


def edited(index: int, **changes: float) -> Reference:
    points = list(reference().points)
    points[index] = replace(points[index], **changes)
    return reference(points=tuple(points))


def refused(ref: Reference, **changes: Any) -> Refusal | None:
    arguments: dict[str, Any] = {
        "now_ns": 10 * S,
        "current": standing(),
        "previous": None,
        "limits": Limits(speed_mps=15.0, acceleration_mps2=3.0),
        "geofence": FENCE,
        "body_limits": LIMITS[ObjectClass.CAR],
        "event_version": VERSION,
        "control_state": ControlState.RUNNING,
        **changes,
    }
    current = arguments["current"]
    arguments["stop_room"] = StoppingRoom(
        current.object_class, current.size, arguments["limits"], arguments["geofence"], 0.02
    )
    return check_reference(ref, **arguments)


def check(ref: Reference, **changes: Any) -> RefusalCode | None:
    refusal = refused(ref, **changes)
    if refusal is None:
        return None
    assert refusal.message
    return refusal.code


def test_a_good_reference_is_taken() -> None:
    assert check(reference()) is None


@pytest.mark.parametrize("state", list(ControlState), ids=lambda s: s.name)
def test_references_are_taken_in_running_only(state: ControlState) -> None:
    expected = None if state is ControlState.RUNNING else RefusalCode.STATE
    assert check(reference(), control_state=state) is expected


def test_another_version_is_refused() -> None:
    assert check(reference(), event_version="sha256:bb") is RefusalCode.VERSION


def test_late_and_expired_at_their_nanosecond() -> None:
    ref = reference()
    assert check(ref, now_ns=ref.execute_at_ns) is None
    assert check(ref, now_ns=ref.execute_at_ns + 1) is RefusalCode.LATE
    assert check(ref, now_ns=ref.expires_at_ns - 1) is RefusalCode.LATE
    assert check(ref, now_ns=ref.expires_at_ns) is RefusalCode.EXPIRED


@pytest.mark.parametrize(
    "make",
    [
        lambda: reference(points=()),
        lambda: reference(points=reference().points[:1]),
        lambda: edited(5, x_m=math.nan),
        lambda: edited(5, yaw_rad=math.inf),
        lambda: edited(5, t_s=reference().points[4].t_s),
        lambda: edited(0, t_s=-0.1),
        lambda: edited(5, speed_mps=-0.01),
        lambda: edited(60, x_m=reference().points[60].x_m + 0.5),
        lambda: reference(object_id="somebody_else"),
    ],
    ids=["empty", "one", "nan", "inf", "times", "before", "reverse", "jump", "addressee"],
)
def test_malformed(make: Callable[[], Reference]) -> None:
    assert check(make()) is RefusalCode.MALFORMED


@pytest.mark.parametrize(
    ("last_s", "word"),
    [(86_400.0, None), (86_401.0, "86401 s, limit is 86400 s"), (1e300, "1e+300 s")],
)
def test_times_that_no_session_reaches_are_refused(last_s: float, word: str | None) -> None:
    here = ReferencePoint(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    stands = reference(points=(here, replace(here, t_s=last_s)))
    refusal = refused(stands)
    if word is None:
        assert refusal is None
        assert stands.end_ns == stands.execute_at_ns + 86_400 * S
    else:
        assert refusal is not None
        assert refusal.code is RefusalCode.MALFORMED
        assert word in refusal.message


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"x_m": 0.49}, None),
        ({"x_m": 0.51}, RefusalCode.DISCONTINUOUS),
        ({"y_m": -0.51}, RefusalCode.DISCONTINUOUS),
        ({"yaw_rad": 0.19}, None),
        ({"yaw_rad": -0.21}, RefusalCode.DISCONTINUOUS),
        ({"speed_mps": 0.99}, None),
        ({"speed_mps": 1.01}, RefusalCode.DISCONTINUOUS),
        ({"x_m": math.nan}, RefusalCode.DISCONTINUOUS),
        ({"x_m": -1.0, "speed_mps": 0.9, "stamp_ns": 9 * S + S // 10}, None),
    ],
)
def test_the_start_must_be_where_the_object_will_be(
    changes: dict[str, Any], expected: RefusalCode | None
) -> None:
    assert check(reference(), current=standing(**changes)) is expected


def test_with_a_previous_reference_its_point_counts_and_not_the_state() -> None:
    previous = reference()
    execute = 10 * S + 6 * S
    station = next(p for p in previous.points if p.t_s >= 5.9)
    points = lane_change(PATH, station.x_m, station.speed_mps, 3.5, 2.5, 12.0, 2.0)
    ref = reference(
        points=tuple(points), execute_at_ns=execute, expires_at_ns=execute + S, purpose="manoeuvre"
    )
    assert check(ref, now_ns=execute - S // 10, previous=previous) is None
    assert check(ref, now_ns=execute - S // 10) is RefusalCode.DISCONTINUOUS


def test_a_pedestrian_may_start_with_any_heading() -> None:
    path = Polyline([(0.0, 0.0), (0.0, 6.0)])
    points = tuple(drive_along(path, 0.0, 0.0, 1.4, 1.5, 1.5))
    ref = reference(points=points)
    walker = {
        "current": standing(ObjectClass.PEDESTRIAN),
        "body_limits": LIMITS[ObjectClass.PEDESTRIAN],
    }
    assert check(ref, **walker) is None
    assert check(ref) is RefusalCode.DISCONTINUOUS


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"speed_mps": 12.0}, None),
        ({"speed_mps": 11.99}, RefusalCode.LIMIT),
        ({"acceleration_mps2": 2.0}, None),
        ({"acceleration_mps2": 1.99}, RefusalCode.LIMIT),
    ],
)
def test_limits_of_the_site(limits: dict[str, float], expected: RefusalCode | None) -> None:
    site = Limits(**{"speed_mps": 15.0, "acceleration_mps2": 3.0, **limits})
    assert check(reference(), limits=site) is expected


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"speed_mps": 11.9}, RefusalCode.LIMIT),
        ({"acceleration_mps2": 1.9}, RefusalCode.LIMIT),
        ({"deceleration_mps2": 1.9}, RefusalCode.LIMIT),
        ({"curvature_1pm": 1e-9, "lateral_acceleration_mps2": 1e-3}, None),
    ],
)
def test_limits_of_the_body(changes: dict[str, float], expected: RefusalCode | None) -> None:
    body = replace(LIMITS[ObjectClass.CAR], **changes)
    assert check(reference(), body_limits=body) is expected


def test_curvature_and_grip_are_limits_too() -> None:
    assert check(edited(100, curvature_1pm=0.21)) is RefusalCode.LIMIT
    fast = edited(100, curvature_1pm=0.08)
    assert (
        fast.points[100].speed_mps ** 2 * 0.08 > LIMITS[ObjectClass.CAR].lateral_acceleration_mps2
    )
    assert check(fast) is RefusalCode.LIMIT


def test_the_whole_path_with_its_corners_must_be_inside() -> None:
    end = 200.0 + DEFAULT_SIZES[ObjectClass.CAR].front_m
    # Room for the stops, which test_stopping_room looks at.
    wide = [(-10.0, -1.2), (end + 1.0, -1.2), (end + 1.0, 1.2), (-10.0, 1.2)]
    assert check(reference(), geofence=wide) is None
    for fence, outside in (
        ([(x - 1.02 if x > 0.0 else x, y) for x, y in wide], "0.020 m outside"),
        ([(x, 0.7 * y) for x, y in wide], "0.060 m outside"),
    ):
        refusal = refused(reference(), geofence=fence)
        assert refusal is not None
        assert refusal.code is RefusalCode.FENCE
        assert outside in refusal.message


@pytest.mark.parametrize("at_m", [20.0, 101.37, 150.0])
def test_a_thin_wall_between_the_points_is_part_of_the_fence(at_m: float) -> None:
    for low_m, good in ((1.25, True), (0.85, False), (-5.0, False)):
        wall = [(at_m + 0.01, 9.0), (at_m + 0.01, low_m), (at_m, low_m), (at_m, 9.0)]
        fence = [(-10.0, -9.0), (300.0, -9.0), (300.0, 9.0), *wall, (-10.0, 9.0)]
        refusal = refused(reference(), geofence=fence)
        assert (refusal is None) == good
        if refusal is not None:
            assert refusal.code is RefusalCode.FENCE
            assert "on its way to point" in refusal.message


def test_a_stop_must_end_inside() -> None:
    end = 200.0 + DEFAULT_SIZES[ObjectClass.CAR].front_m
    short = [(-10.0, -5.0), (end + 0.5, -5.0), (end + 0.5, 5.0), (-10.0, 5.0)]
    refusal = refused(reference(), geofence=short)
    assert refusal is not None
    assert refusal.code is RefusalCode.FENCE
    assert "a stop goes past its end and from point" in refusal.message


def test_a_moving_end_is_refused() -> None:
    points = reference().points
    assert check(reference(points=points[:-1])) is RefusalCode.MOVING_END


def test_messages_name_measured_value_and_limit() -> None:
    refusal = refused(reference(), current=standing(x_m=0.75))
    assert refusal is not None
    assert "0.750 m" in refusal.message
    assert "limit is 0.5 m" in refusal.message


def test_numbers_are_those_of_the_message() -> None:
    assert [c.value for c in RefusalCode] == list(range(1, 10))


# -- points that are far apart ---------------------------------------------------------------------


def bow(*, moving_s: float = 12.0) -> Reference:
    """Two points at 10 m/s, between which the way swings out to the left, and a stop."""
    speed, yaw = 10.0, 0.2
    bend, chord = -2.0 * yaw / (speed * moving_s), speed * moving_s * math.sin(yaw) / yaw
    c, s = math.cos(yaw), math.sin(yaw)
    swung = ReferencePoint(moving_s, chord, 0.0, -yaw, speed, 0.0, bend)
    straight = replace(swung, curvature_1pm=0.0)
    points = (
        ReferencePoint(0.0, 0.0, 0.0, yaw, speed, 0.0, bend),
        swung,
        replace(straight, t_s=moving_s + 0.1, x_m=chord + c, y_m=-s, acceleration_mps2=-2.0),
        replace(straight, t_s=moving_s + 5.1, x_m=chord + 26.0 * c, y_m=-26.0 * s, speed_mps=0.0),
    )
    return reference(points=points)


@pytest.mark.parametrize(
    ("left_m", "word"),
    [
        (6.0, "on its way to point 1 (x 55.60 m, y 5.93 m) the object is 0.882 m outside"),
        # The car's side is inside, and a stop that begins on its way there isn't.
        (6.9, "a stop that holds its steering from point 0 (x 34.63 m, y 4.93 m, 10.0 m/s)"),
        (7.1, None),
    ],
)
def test_the_way_between_points_that_are_far_apart_must_be_inside(
    left_m: float, word: str | None
) -> None:
    fence = [(-10.0, -30.0), (220.0, -30.0), (220.0, left_m), (-10.0, left_m)]
    there = standing(yaw_rad=0.2, speed_mps=10.0, stamp_ns=10 * S + S // 10)
    refusal = refused(bow(), current=there, geofence=fence)
    if word is None:
        assert refusal is None
    else:
        assert refusal is not None
        assert refusal.code is RefusalCode.FENCE
        assert word in refusal.message


def test_points_with_too_long_a_way_between_them_are_refused() -> None:
    refusal = refused(bow(moving_s=600.1))
    assert refusal is not None
    assert refusal.code is RefusalCode.MALFORMED
    # The stop takes 5 s more.
    assert "moves for 605.1 s in steps of more than 0.1 s, limit is 600 s" in refusal.message


# -- points that are no one motion ----------------------------------------------------------------

_FINE_S = 0.01


def fine(
    speed_mps: Callable[[float], float],
    sideways_rad: Callable[[float], float] = lambda t: 0.0,
    yaw_rad: Callable[[float], float] = lambda t: 0.0,
) -> Reference:
    """Points so close in time that each step for itself is short: 6 s, speed 0 at the ends.

    Args:
        speed_mps: by the time.
        sideways_rad: between the way that the places take and the heading stated.
        yaw_rad: the heading stated.
    """
    points, x, y = [], 0.0, 0.0
    for i in range(601):
        t = i * _FINE_S
        v = speed_mps(t)
        points.append(ReferencePoint(t, x, y, yaw_rad(t), v, 0.0, 0.0))
        said = 0.5 * (v + speed_mps(t + _FINE_S)) * _FINE_S
        way = yaw_rad(t) + sideways_rad(t)
        x, y = x + said * math.cos(way), y + said * math.sin(way)
    return reference(points=tuple(points))


def gently(t: float) -> float:
    """Return a speed that rises and falls with 0.45 m/s^2, too gently to have to be stated."""
    return max(0.45 * min(t, 5.9 - t), 0.0)


@pytest.mark.parametrize(
    ("points", "word"),
    [
        (fine(gently), None),
        (fine(gently, yaw_rad=lambda t: 0.05 * t), None),
        # Faster by 4 m/s within one step, and slower again: no body does that.
        (fine(lambda t: gently(t) + (4.0 if 2.0 < t < 4.0 else 0.0)), "speed changes"),
        (fine(lambda t: 1.5 * gently(t)), "speed changes"),
        # A car that is led sideways, a little at a time.
        (fine(gently, sideways_rad=lambda t: math.pi / 2), "headings"),
        (fine(gently, sideways_rad=lambda t: 0.2), "headings"),
    ],
    ids=["straight", "bend", "leap", "more than stated", "sideways", "askew"],
)
def test_columns_that_contradict_each_other_get_past_no_limit(
    points: Reference, word: str | None
) -> None:
    refusal = refused(points)
    if word is None:
        assert refusal is None
    else:
        assert refusal is not None
        assert refusal.code is RefusalCode.MALFORMED
        assert word in refusal.message
