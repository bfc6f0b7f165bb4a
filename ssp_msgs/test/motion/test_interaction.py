"""The relation of an object to the VUT, by hand: gap, TTC, arrivals, conflict (METHOD 1)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.encounter import Encounter, encounter, is_conflict, is_crossing, swept_stations
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import Role
from tests.support.states import object_state

# Round numbers: 3 m ahead of and 1 m behind the reference point, 2 m wide.
SIZE = Size(3.0, 1.0, 2.0, 1.5)
WALKER = Size(0.25, 0.25, 0.5, 1.75)
PATH = Polyline([(0.0, 0.0), (200.0, 0.0)])
# Half the VUT's width and 0.3 m.
HALF_CORRIDOR_M = 1.3


def state(object_id: str = "vut", size: Size = SIZE, **given_values: Any) -> ObjectState:
    return object_state(object_id, size=size, role=Role.OT, **given_values)


def meet(vut_mps: float, other: ObjectState, vut_x_m: float = 10.0) -> Encounter:
    return encounter(state(x_m=vut_x_m, speed_mps=vut_mps), other, PATH)


# -- along the path -------------------------------------------------------------------------------


def test_following_in_one_lane() -> None:
    """Bumper gap 33 - 1 - (10 + 3) = 19 m, closing 4 m/s."""
    found = meet(10.0, state("ot", x_m=33.0, speed_mps=6.0))
    assert found.gap_m == pytest.approx(19.0)
    assert found.ttc_s == pytest.approx(4.75)
    assert (found.clearance_m, found.lateral_m, found.in_corridor) == (0.0, 0.0, True)
    assert found.along_mps == pytest.approx(6.0)
    assert found.object_arrival_s == 0.0
    assert found.vut_arrival_s == pytest.approx(1.9)
    assert not is_conflict(found, 4.75, 99.0)  # at the threshold
    assert is_conflict(found, 4.76, 0.0)


@pytest.mark.parametrize(
    ("vut_mps", "other_mps"), [(10.0, 10.0), (10.0, 12.0), (0.0, 0.0), (10.04, 10.0)]
)
def test_ttc_is_infinite_while_not_closing(vut_mps: float, other_mps: float) -> None:
    assert meet(vut_mps, state("ot", x_m=33.0, speed_mps=other_mps)).ttc_s == math.inf


@pytest.mark.parametrize("x_m", [13.9, 10.0, 0.0, -50.0])
def test_who_is_beside_or_behind_has_no_ttc(x_m: float) -> None:
    found = meet(10.0, state("ot", x_m=x_m))
    assert found.gap_m < 0.0
    assert found.ttc_s == math.inf


def test_oncoming_in_the_corridor() -> None:
    """Its front is its nearest point: 50 - 3 - 13 = 34 m, closing 18 m/s."""
    found = meet(10.0, state("ot", x_m=50.0, yaw_rad=math.pi, speed_mps=8.0))
    assert found.gap_m == pytest.approx(34.0)
    assert found.zone_gap_m == pytest.approx(34.0)
    assert found.along_mps == pytest.approx(-8.0)
    assert found.ttc_s == pytest.approx(34.0 / 18.0)


def test_beyond_the_paths_end_the_road_goes_on() -> None:
    found = meet(10.0, state("ot", x_m=230.0, speed_mps=5.0), vut_x_m=195.0)
    assert found.gap_m == pytest.approx(31.0)


# -- beside the path ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("y_m", "clearance_m", "lateral_m"),
    [
        (3.5, 1.2, 2.5),
        (-3.5, 1.2, -2.5),
        (2.3, 0.0, 1.3),  # its side just at the corridor's edge
        (-2.4, 0.1, -1.4),
        (0.5, 0.0, 0.0),  # over the path
    ],
)
def test_clearance_is_of_the_near_side(y_m: float, clearance_m: float, lateral_m: float) -> None:
    found = meet(10.0, state("ot", x_m=40.0, y_m=y_m))
    assert found.clearance_m == pytest.approx(clearance_m, abs=1e-12)
    assert found.lateral_m == pytest.approx(lateral_m)


@pytest.mark.parametrize(
    ("y_m", "yaw_deg", "towards_mps"),
    [
        (5.0, -90.0, 2.0),
        (5.0, 90.0, -2.0),
        (-5.0, 90.0, 2.0),
        (-5.0, -90.0, -2.0),
        (5.0, 0.0, 0.0),
        (5.0, -30.0, 1.0),
    ],
)
def test_towards_is_positive_on_either_side(y_m: float, yaw_deg: float, towards_mps: float) -> None:
    other = state("ot", WALKER, x_m=60.0, y_m=y_m, yaw_rad=math.radians(yaw_deg), speed_mps=2.0)
    assert meet(10.0, other).towards_mps == pytest.approx(towards_mps, abs=1e-12)


def test_an_object_in_the_next_lane_that_stays_there_has_no_arrival() -> None:
    found = meet(15.0, state("ot", x_m=20.0, y_m=3.5, speed_mps=1.0))
    assert found.object_arrival_s == found.vut_arrival_s == found.ttc_s == math.inf
    assert found.zone_gap_m == math.inf
    assert found.arrival_gap_s == math.inf
    assert not is_conflict(found, 9.0, 9.0)


def test_crossing() -> None:
    """METHOD 1: the walker's corridor begins 0.25 + 0.3 m before it, 60 - 0.55 - 13 = 46.45 m ahead
    of the VUT's front; at 10 m/s. The walker has 4 - 0.25 - 1.3 m to go. TTC is to its body."""
    other = state("ot", WALKER, x_m=60.0, y_m=-4.0, yaw_rad=math.pi / 2, speed_mps=1.5)
    found = meet(10.0, other)
    assert found.zone_gap_m == pytest.approx(46.45)
    assert found.vut_arrival_s == pytest.approx(4.645)
    assert found.object_arrival_s == pytest.approx(2.45 / 1.5)
    assert found.arrival_gap_s == pytest.approx(4.645 - 2.45 / 1.5)
    assert found.ttc_s == pytest.approx(4.675)
    assert not is_conflict(found, 4.0, 3.0)
    assert is_conflict(found, 4.0, 3.02)


@pytest.mark.parametrize(
    ("yaw_deg", "crosses"),
    [
        (0, False),
        (44.9, False),
        (45.1, True),
        (90, True),
        (134.9, True),
        (135.1, False),
        (180, False),
        (-44.9, False),
        (-45.1, True),
        (-90, True),
        (-134.9, True),
        (-135.1, False),
    ],
)
def test_what_crosses_has_a_corridor_of_its_own(yaw_deg: float, crosses: bool) -> None:
    """The zone of an object in the VUT's corridor begins at its own corridor, or at its body."""
    yaw = math.radians(yaw_deg)
    assert is_crossing(yaw) is crosses
    other = state("ot", WALKER, x_m=60.0, yaw_rad=yaw, speed_mps=1.5)
    found = meet(10.0, other)
    s, c = abs(math.sin(yaw)), abs(math.cos(yaw))
    bare = 47.0 - 0.25 * (s + c)
    swept = 47.0 - (0.55 + HALF_CORRIDOR_M * c) / s if crosses else bare
    assert found.gap_m == pytest.approx(bare)
    assert found.zone_gap_m == pytest.approx(swept)
    assert found.vut_arrival_s == pytest.approx(swept / 10.0)


@pytest.mark.parametrize("y_m", [-9.0, -1.0, 0.0, 2.0])
def test_the_zone_of_a_slanting_path_stays_where_it_is(y_m: float) -> None:
    """The path crosses (60, 0) at 60 degrees, from the right edge, 1.3 m out, to the left one."""
    tan60 = math.tan(math.radians(60.0))
    other = state(
        "ot", WALKER, x_m=60.0 + y_m / tan60, y_m=y_m, yaw_rad=math.radians(60.0), speed_mps=1.5
    )
    reach = HALF_CORRIDOR_M / tan60 + 0.55 / math.sin(math.radians(60.0))
    assert swept_stations(other, PATH, HALF_CORRIDOR_M, 30.0) == pytest.approx(
        (60.0 - reach, 60.0 + reach)
    )
    if y_m < HALF_CORRIDOR_M:
        assert meet(10.0, other).zone_gap_m == pytest.approx(47.0 - reach)


def test_who_is_beside_the_corridor_covers_nothing_of_it() -> None:
    walker = state("ot", WALKER, x_m=60.0, y_m=-1.56, yaw_rad=math.pi / 2, speed_mps=1.5)
    assert swept_stations(walker, PATH, HALF_CORRIDOR_M) is None
    nearer = replace(walker, y_m=-1.54)
    assert swept_stations(nearer, PATH, HALF_CORRIDOR_M) == pytest.approx((59.45, 60.55))


def test_in_a_bend_a_crossing_covers_its_width_of_the_path() -> None:
    """Outwards on a spoke of a circle of 50 m, a quarter of the way round."""
    turns = [math.pi * k / 400 for k in range(201)]
    path = Polyline([(50.0 * math.sin(a), 50.0 - 50.0 * math.cos(a)) for a in turns])
    at = math.pi / 4
    other = state(
        "ot",
        WALKER,
        x_m=46.0 * math.sin(at),
        y_m=50.0 - 46.0 * math.cos(at),
        yaw_rad=at - math.pi / 2,
        speed_mps=1.5,
    )
    found = encounter(state(x_m=0.0, speed_mps=10.0), other, path)
    assert found.zone_gap_m == pytest.approx(50.0 * at - 0.55 - 3.0, abs=0.02)


def test_in_the_corridor_the_gap_between_arrivals_says_nothing() -> None:
    """METHOD 1: its arrival is past. Only TTC makes a conflict of it."""
    found = meet(10.0, state("ot", x_m=33.0, speed_mps=10.0))
    assert found.arrival_gap_s == pytest.approx(1.9)
    assert not is_conflict(found, 99.0, 99.0)


def test_cut_in_takes_the_zone_along() -> None:
    """Side at 2.5 m, 1.2 m to go at 0.8 m/s: 1.5 s, in which the OT drives 6 * 1.5 = 9 m on.

    The heading is small enough that the corners count as if it drove straight.
    """
    yaw = math.atan2(-0.8, 6.0)
    other = state(
        "ot",
        Size(0.0, 0.0, 2.0, 1.5),
        x_m=33.0,
        y_m=3.5,
        yaw_rad=yaw,
        speed_mps=math.hypot(0.8, 6.0),
    )
    found = meet(10.0, other)
    half_turned = math.cos(yaw)  # half of its 2 m, turned
    arrival = (3.5 - half_turned - HALF_CORRIDOR_M) / 0.8
    rear = 33.0 + math.sin(yaw)
    assert found.object_arrival_s == pytest.approx(arrival)
    assert found.vut_arrival_s == pytest.approx((rear + 6.0 * arrival - 13.0) / 10.0)


def test_a_zone_that_the_vut_is_in_already_is_reached_now() -> None:
    """Somebody walks into the VUT's side."""
    found = meet(10.0, state("ot", WALKER, x_m=11.0, y_m=3.0, yaw_rad=-math.pi / 2, speed_mps=1.0))
    assert found.vut_arrival_s == 0.0
    found = meet(10.0, state("ot", WALKER, x_m=8.0, y_m=3.0, yaw_rad=-math.pi / 2, speed_mps=1.0))
    assert found.vut_arrival_s == math.inf  # behind the VUT


@pytest.mark.parametrize(
    ("x_m", "along_mps", "reached"),
    # The VUT's rear is at 9 m. Straight across: the walker's corridor ends 0.55 m beyond it.
    # At 45 degrees or less to the path: 0.335 m and what it walks on until it is in the corridor,
    # 3 - 0.335 - 1.3 m at 1 m/s. Slanting at 60: 4.3/tan 60 + 0.55/sin 60 = 3.118 m beyond.
    [
        (8.5, 0.0, True),
        (8.4, 0.0, False),
        (6.0, 2.0, True),
        (5.9, 2.0, False),
        (5.9, 0.57735, True),
        (5.85, 0.57735, False),
    ],
)
def test_the_zone_ends_at_the_vuts_rear(x_m: float, along_mps: float, reached: bool) -> None:
    walker = state(
        "ot",
        Size(0.25, 0.25, 0.5, 1.75),
        x_m=x_m,
        y_m=3.0,
        yaw_rad=math.atan2(-1.0, along_mps),
        speed_mps=math.hypot(1.0, along_mps),
    )
    found = meet(10.0, walker)
    assert found.vut_arrival_s == (0.0 if reached else math.inf)


def test_around_a_bend() -> None:
    """The path turns north at x = 20; an object beyond the bend drives along it."""
    path = Polyline([(0.0, 0.0), (20.0, 0.0), (20.0, 100.0)])
    vut = state(x_m=10.0, speed_mps=10.0)
    other = state("ot", x_m=20.0, y_m=30.0, yaw_rad=math.pi / 2, speed_mps=6.0)
    found = encounter(vut, other, path)
    assert found.gap_m == pytest.approx(36.0)
    assert found.along_mps == pytest.approx(6.0)
    assert found.towards_mps == pytest.approx(0.0, abs=1e-12)
    assert found.ttc_s == pytest.approx(9.0)
    crossing = replace(other, x_m=26.0, yaw_rad=math.pi)
    assert encounter(vut, crossing, path).towards_mps == pytest.approx(6.0)
    assert encounter(vut, replace(crossing, yaw_rad=0.0), path).towards_mps == pytest.approx(-6.0)


def test_conflict_is_under_its_thresholds_not_at_them() -> None:
    beside = Encounter(20.0, 3.0, 1.0, 1.0, 5.0, math.inf, 20.0, 2.0, 0.5)
    assert beside.arrival_gap_s == 1.5
    assert not is_conflict(beside, 2.5, 1.5)
    assert is_conflict(beside, 2.5, 1.5 + 1e-9)
    for never in (
        replace(beside, vut_arrival_s=math.inf),
        replace(beside, object_arrival_s=math.inf),
    ):
        assert never.arrival_gap_s == math.inf


def test_a_standing_vut_never_arrives() -> None:
    other = state("ot", WALKER, x_m=60.0, y_m=-4.0, yaw_rad=math.pi / 2, speed_mps=1.5)
    found = meet(0.0, other)
    assert found.vut_arrival_s == math.inf
    assert not is_conflict(found, 9.0, 9.0)


# -- invariance -----------------------------------------------------------------------------------

metres = st.floats(-20.0, 20.0)


@settings(max_examples=100, deadline=None)
@given(
    x=st.floats(-10.0, 150.0),
    y=metres,
    yaw=st.floats(-3.0, 3.0),
    speed=st.floats(0.0, 15.0),
    vut_mps=st.floats(0.0, 15.0),
    turn=st.floats(-3.0, 3.0),
    dx=metres,
    dy=metres,
)
def test_the_frame_of_the_map_does_not_matter(
    x: float, y: float, yaw: float, speed: float, vut_mps: float, turn: float, dx: float, dy: float
) -> None:
    frame = Pose2(dx, dy, turn)
    vut = state(x_m=10.0, y_m=0.4, speed_mps=vut_mps)
    other = state("ot", x_m=x, y_m=y, yaw_rad=yaw, speed_mps=speed)

    def moved(old: ObjectState) -> ObjectState:
        mx, my = frame.to_parent(old.x_m, old.y_m)
        return replace(old, x_m=mx, y_m=my, yaw_rad=old.yaw_rad + turn)

    path = Polyline([frame.to_parent(0.0, 0.0), frame.to_parent(200.0, 0.0)])
    here, there = encounter(vut, other, PATH), encounter(moved(vut), moved(other), path)
    for name in ("gap_m", "lateral_m", "clearance_m", "along_mps"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), abs=1e-6)
    assert abs(there.towards_mps) == pytest.approx(abs(here.towards_mps), abs=1e-6)


@settings(max_examples=100, deadline=None)
@given(yaw_deg=st.floats(46.0, 134.0), x=st.floats(30.0, 150.0), width=st.floats(0.4, 2.5))
def test_what_is_foreseen_of_a_crossing_is_what_it_covers(
    yaw_deg: float, x: float, width: float
) -> None:
    """Straight on, the zone at any instant is the union of what is covered on the way."""
    yaw = math.radians(yaw_deg)
    size = Size(1.0, 1.0, width, 1.5)
    way = [
        state(
            "ot", size, x_m=x + d * math.cos(yaw), y_m=d * math.sin(yaw), yaw_rad=yaw, speed_mps=1.0
        )
        for d in (0.1 * k for k in range(-80, 81))
    ]
    covered = [span for o in way if (span := swept_stations(o, PATH, HALF_CORRIDOR_M)) is not None]
    foreseen = swept_stations(way[0], PATH, HALF_CORRIDOR_M, 50.0)
    assert foreseen is not None
    assert foreseen == pytest.approx((min(s for s, _ in covered), max(e for _, e in covered)))
    assert meet(5.0, way[0]).zone_gap_m == pytest.approx(foreseen[0] - 13.0)
