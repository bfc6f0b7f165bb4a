"""The VUT's state of places and headings on the Earth, and the gate that fixes go through."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import seconds_to_ns
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_ot_controller.bodies.gnss import FixType, Gate, GnssStates, Heading, NavSat, Speed
from ssp_ot_controller.bodies.odometry import LeverArm, Unusable, VutStates

VUT = ParticipantSpec(
    id="vut", object_class="car", start=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0), approach=None
)
# Its x axis points to the north-west, so that nothing holds that only holds for ENU.
DATUM = Datum(Place(57.7775, 12.7805, 200.0), 2.4)


class Receiver:
    """A vehicle on the site, as its receiver tells of it."""

    def __init__(
        self,
        lever: LeverArm | None = None,
        *,
        least: FixType = FixType.GBAS,
        speeds: bool = True,
        datum: Datum = DATUM,
        start_yaw_rad: float | None = None,
    ) -> None:
        self.lever = lever or LeverArm()
        self.datum = datum
        states = VutStates(VUT, self.lever, "map")
        self.states = GnssStates(
            states,
            self.lever,
            datum,
            Gate(least, 0.3),
            speeds=speeds,
            start_yaw_rad=start_yaw_rad,
        )

    def heading(self, t_s: float, yaw_rad: float = 0.3, variance_rad2: float = 1e-6) -> Heading:
        half = (yaw_rad + self.lever.yaw_left_rad + self.datum.yaw_rad) / 2.0
        quaternion = (0.0, 0.0, math.sin(half), math.cos(half))
        return Heading(seconds_to_ns(t_s), quaternion, variance_rad2)

    def place(self, t_s: float, x_m: float = 30.0, y_m: float = 40.0, **changes: Any) -> NavSat:
        there = self.datum.to_place(x_m, y_m)
        return replace(NavSat(seconds_to_ns(t_s), FixType.GBAS, there, 4e-4), **changes)

    def hear(self, t_s: float, yaw_rad: float = 0.3, speed_mps: float = 8.0) -> None:
        self.states.hear_heading(self.heading(t_s, yaw_rad))
        self.states.hear_speed(Speed(seconds_to_ns(t_s), speed_mps))

    def take(self, fix: NavSat) -> ObjectState:
        return self.states.take(fix, fix.stamp_ns)


def test_a_place_and_a_heading_become_a_state_in_the_sites_frame() -> None:
    receiver = Receiver()
    receiver.hear(1.0)
    state = receiver.take(receiver.place(1.0))
    assert (state.x_m, state.y_m) == pytest.approx((30.0, 40.0), abs=1e-6)
    assert (state.yaw_rad, state.speed_mps) == pytest.approx((0.3, 8.0))
    assert state.position_std_m == pytest.approx(0.02)
    assert (state.stamp_ns, state.sequence) == (seconds_to_ns(1.0), 1)


@given(
    yaw=st.floats(-3.1, 3.1),
    forward=st.floats(-2.0, 4.0),
    left=st.floats(-1.0, 1.0),
    turn=st.floats(-3.1, 3.1),
    site_yaw=st.floats(-3.1, 3.1),
    speeds=st.booleans(),
)
def test_the_lever_arm_is_taken_out_whatever_the_site_and_the_unit_are_turned_by(
    yaw: float, forward: float, left: float, turn: float, site_yaw: float, speeds: bool
) -> None:
    """A vehicle that drives straight at 5 m/s, with the unit anywhere on it."""
    datum = replace(DATUM, yaw_rad=site_yaw)
    receiver = Receiver(LeverArm(forward, left, turn), speeds=speeds, datum=datum)
    state = None
    for k in range(2):
        t_s = 1.0 + 0.1 * k
        here = Pose2(3.0 + 5.0 * t_s * math.cos(yaw), 4.0 + 5.0 * t_s * math.sin(yaw), yaw)
        receiver.hear(t_s, yaw, 5.0)
        fix = receiver.place(t_s, *here.to_parent(forward, left))
        if speeds or k:
            state = receiver.take(fix)
            assert (state.x_m, state.y_m) == pytest.approx((here.x_m, here.y_m), abs=1e-6)
            assert wrap_angle(state.yaw_rad - yaw) == pytest.approx(0.0, abs=1e-9)
            assert state.speed_mps == pytest.approx(5.0, abs=1e-6)
        else:
            with pytest.raises(Unusable, match="speed: unknown at the first fix"):
                receiver.take(fix)
    assert state is not None


@pytest.mark.parametrize("speeds", [True, False])
def test_a_vehicle_that_goes_backwards_has_a_negative_speed(speeds: bool) -> None:
    """A velocity's message doesn't say in whose axes it is; where the vehicle goes does."""
    receiver = Receiver(speeds=speeds)
    receiver.hear(0.0, 0.0, 2.0)
    if speeds:
        receiver.take(receiver.place(0.0, 10.0, 0.0))
    else:
        with pytest.raises(Unusable):
            receiver.take(receiver.place(0.0, 10.0, 0.0))
    receiver.hear(0.1, 0.0, 2.0)
    state = receiver.take(receiver.place(0.1, 9.8, 0.0))
    assert state.speed_mps == pytest.approx(-2.0, abs=1e-6)


@pytest.mark.parametrize("turned_rad", [-1.57, -0.55, 0.55, 1.57, 2.5])
@pytest.mark.parametrize(("speed_mps", "shows"), [(2.9, False), (3.1, True)])
def test_a_heading_that_the_vehicle_does_not_drive_along_is_refused(
    turned_rad: float, speed_mps: float, shows: bool
) -> None:
    """Drivers that count from north, clockwise, are off by up to half a turn."""
    receiver = Receiver()
    for k in range(3):
        t_s = 0.1 * k
        receiver.hear(t_s, turned_rad, speed_mps)
        fix = receiver.place(t_s, speed_mps * t_s, 0.0)
        if shows and k:
            with pytest.raises(Unusable, match=re.escape(f"drives {-turned_rad:+.2f} rad to the")):
                receiver.take(fix)
        else:
            receiver.take(fix)


@pytest.mark.parametrize("turned_rad", [-0.5, 0.0, 0.5, math.pi])
def test_a_vehicle_may_slip_and_drive_backwards(turned_rad: float) -> None:
    receiver = Receiver()
    for k in range(3):
        receiver.hear(0.1 * k, turned_rad, 10.0)
        receiver.take(receiver.place(0.1 * k, float(k), 0.0))


@pytest.mark.parametrize("speeds", [True, False])
@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize("turned_rad", [math.pi, -2.0])
def test_a_heading_that_jumps_on_the_way_gives_no_state(
    turned_rad: float, rate_hz: float, speeds: bool
) -> None:
    """It would read as reversing, with the vehicle's box the wrong way round."""
    receiver = Receiver(speeds=speeds)
    told: dict[float, str] = {}
    for k in range(1, round(6.0 * rate_hz)):
        t_s = k / rate_hz
        # Its way is a bend; the heading is wrong from 1 s to 2 s, and from 3 s on.
        way_rad = 0.3 * t_s
        wrong = 1.0 <= t_s < 2.0 or t_s >= 3.0
        receiver.hear(t_s - 0.004, way_rad + (turned_rad if wrong else 0.0), 9.0)
        x_m, y_m = 30.0 * math.sin(way_rad), -30.0 * math.cos(way_rad)
        told[t_s] = ""
        try:
            receiver.take(receiver.place(t_s, x_m, y_m))
        except Unusable as error:
            told[t_s] = str(error)
    for t_s, why in told.items():
        if 1.0 <= t_s < 2.0 or t_s >= 3.0:
            assert re.match(r"heading: it jumped by [+-]1\d\d degrees .* [89]\.\d m/s; ", why)
        else:
            assert not why or (t_s == 1 / rate_hz and "unknown at the first fix" in why)


@pytest.mark.parametrize("speeds", [True, False])
@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 100.0])
def test_a_vehicle_that_stops_and_reverses_keeps_its_states(rate_hz: float, speeds: bool) -> None:
    """So does one whose heading was corrected at rest."""
    receiver = Receiver(speeds=speeds)
    x_m, speed_told = 0.0, 0.0
    for k in range(round(9.0 * rate_hz)):
        t_s = k / rate_hz
        speed_mps = 6.0 - 3.0 * min(max(t_s - 2.0, 0.0), 4.0) if t_s > 1.0 else 0.0
        x_m += speed_mps / rate_hz
        receiver.hear(t_s, 0.0 if t_s > 0.5 else math.pi, abs(speed_mps))
        if not k and not speeds:
            with pytest.raises(Unusable, match="unknown at the first fix"):
                receiver.take(receiver.place(t_s, x_m, 0.0))
        else:
            speed_told = receiver.take(receiver.place(t_s, x_m, 0.0)).speed_mps
    assert speed_told == pytest.approx(-6.0, abs=1e-3)


def test_a_heading_is_carried_on_to_the_time_of_the_fix() -> None:
    receiver = Receiver()
    for k in range(100):
        receiver.hear(0.01 * k, 0.5 * 0.01 * k, 0.0)
    state = receiver.take(receiver.place(1.09))
    assert state.yaw_rate_radps == pytest.approx(0.5, abs=1e-3)
    assert state.yaw_rad == pytest.approx(0.5 * 1.09, abs=1e-3)


@pytest.mark.parametrize("least", [FixType.FIX, FixType.SBAS, FixType.GBAS])
@pytest.mark.parametrize("status", [-2, -1, 0, 1, 2, 3])
def test_a_fix_of_a_lesser_type_than_asked_for_gives_no_state(least: FixType, status: int) -> None:
    receiver = Receiver(least=least)
    receiver.hear(1.0)
    fix = receiver.place(1.0, status=status)
    if least <= status <= FixType.GBAS:
        assert receiver.take(fix).sequence == 1
    else:
        with pytest.raises(Unusable, match=f"fix type: .*, {least.name} is asked for"):
            receiver.take(fix)


def test_a_receiver_that_states_no_deviation_is_uncertain_without_limit() -> None:
    """The states' own limit, limits.position_std_m, keeps it from arming then."""
    receiver = Receiver()
    receiver.hear(1.0)
    assert receiver.take(receiver.place(1.0, variance_m2=math.nan)).position_std_m == math.inf


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"variance_rad2": -1.0}, "holds no orientation"),
        ({"variance_rad2": 1000.0}, r"uncertain by 31\.623 rad, limit 0\.05 rad"),
        ({"variance_rad2": 0.0026}, r"uncertain by 0\.051 rad"),
        ({"variance_rad2": math.nan}, "uncertain by nan"),
        ({"quaternion": (0.0, 0.0, math.nan, 1.0)}, "holds no orientation"),
        ({"quaternion": (0.0, 0.0, 0.0, 0.0)}, "norm is 0.000"),
        ({"quaternion": (1.0, 0.0, 0.0, 0.0)}, "tilts by 180 degrees"),
    ],
)
def test_a_fix_without_a_usable_heading_says_what_is_wrong_with_it(
    changes: dict[str, Any], why: str
) -> None:
    receiver = Receiver()
    receiver.states.hear_speed(Speed(seconds_to_ns(1.0), 8.0))
    with pytest.raises(Unusable, match=why):
        receiver.states.hear_heading(replace(receiver.heading(1.0), **changes))
    with pytest.raises(Unusable, match=f"heading: no usable one has arrived.*{why}"):
        receiver.take(receiver.place(1.0))
    receiver.hear(1.1)
    assert receiver.take(receiver.place(1.1)).sequence == 1


def test_a_heading_of_no_stated_deviation_is_taken() -> None:
    """Odometry is treated likewise: some drivers state no deviation."""
    receiver = Receiver()
    receiver.hear(1.0)
    receiver.states.hear_heading(receiver.heading(1.1, variance_rad2=0.0))
    assert receiver.take(receiver.place(1.1)).sequence == 1


@pytest.mark.parametrize("late_s", [-0.31, 0.31])
@pytest.mark.parametrize("what", ["heading", "velocity"])
def test_what_belongs_to_a_fix_was_measured_about_when_it_was(what: str, late_s: float) -> None:
    receiver = Receiver()
    receiver.hear(1.0)
    at_s = 1.0 + late_s
    if what == "heading":
        receiver.states.hear_speed(Speed(seconds_to_ns(at_s), 8.0))
    else:
        receiver.states.hear_heading(receiver.heading(at_s))
    with pytest.raises(Unusable, match=rf"{what}: the last usable one is 0\.310 s from the fix"):
        receiver.take(receiver.place(at_s))


def test_without_the_velocity_that_was_promised_there_is_no_state() -> None:
    receiver = Receiver()
    receiver.states.hear_heading(receiver.heading(1.0))
    with pytest.raises(Unusable, match="velocity: no usable one has arrived"):
        receiver.take(receiver.place(1.0))
    with pytest.raises(Unusable, match="isn't finite"):
        receiver.states.hear_speed(Speed(seconds_to_ns(1.0), math.nan))


def test_after_a_pause_speed_is_not_made_of_what_was_before_it() -> None:
    receiver = Receiver(speeds=False)
    for t_s, x_m in ((0.0, 0.0), (0.1, 1.0), (1.0, 2.0), (1.1, 2.5)):
        receiver.states.hear_heading(receiver.heading(t_s, 0.0))
        if t_s in (0.0, 1.0):
            with pytest.raises(Unusable, match="after a pause"):
                receiver.take(receiver.place(t_s, x_m, 0.0))
        else:
            speed_mps = receiver.take(receiver.place(t_s, x_m, 0.0)).speed_mps
    assert speed_mps == pytest.approx(5.0, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"stamp_ns": seconds_to_ns(5.0)}, "ahead of this machine's clock"),
        ({"stamp_ns": seconds_to_ns(1.0)}, "before the newest one, or equals it"),
        ({"place": Place(math.nan, 12.0)}, "its latitude, longitude or altitude is out of range"),
        ({"place": Place(12.0, math.inf)}, "its latitude, longitude or altitude is out of range"),
        ({"place": Place(90.1, 12.0)}, "its latitude, longitude or altitude is out of range"),
        ({"place": Place(57.0, -180.1)}, "its latitude, longitude or altitude is out of range"),
        ({"place": Place(57.0, 12.0, 1.1e5)}, "latitude, longitude or altitude is out of range"),
    ],
)
def test_a_fix_that_is_refused_leaves_no_trace(changes: dict[str, Any], why: str) -> None:
    receiver = Receiver(speeds=False)
    with pytest.raises(Unusable):
        receiver.states.take(receiver.place(0.8), seconds_to_ns(0.8))
    receiver.states.hear_heading(receiver.heading(1.0, 0.0))
    with pytest.raises(Unusable, match="speed"):
        receiver.take(receiver.place(0.9, 0.0, 0.0))
    assert receiver.take(receiver.place(1.0, 0.5, 0.0)).speed_mps == pytest.approx(5.0, abs=1e-6)
    with pytest.raises(Unusable, match=why):
        receiver.states.take(receiver.place(1.1, 99.0, 0.0, **changes), seconds_to_ns(1.1))
    state = receiver.take(receiver.place(1.1, 1.0, 0.0))
    assert (state.speed_mps, state.sequence) == (pytest.approx(5.0, abs=1e-6), 2)


def test_a_place_without_an_altitude_lies_at_the_datums() -> None:
    receiver = Receiver()
    receiver.hear(1.0)
    fix = receiver.place(1.0)
    state = receiver.take(replace(fix, place=replace(fix.place, altitude_m=math.nan)))
    assert (state.x_m, state.y_m) == pytest.approx((30.0, 40.0), abs=1e-6)


@pytest.mark.parametrize("speeds", [True, False])
def test_a_heading_by_course_is_the_starts_until_one_is_told(speeds: bool) -> None:
    lever = LeverArm(1.2, 0.0, 0.5)
    receiver = Receiver(lever, speeds=speeds, start_yaw_rad=0.3)

    def unsure(t_s: float, yaw_rad: float, speed_mps: float) -> None:
        receiver.states.hear_speed(Speed(seconds_to_ns(t_s), speed_mps))
        with pytest.raises(Unusable, match="uncertain"):
            receiver.states.hear_heading(receiver.heading(t_s, yaw_rad, 9.0))

    def place(t_s: float, x_m: float) -> NavSat:
        here = Pose2(x_m, 4.0, 0.3)
        return receiver.place(t_s, *here.to_parent(1.2, 0.0))

    if not speeds:
        with pytest.raises(Unusable, match="speed: unknown at the first fix"):
            receiver.take(place(0.0, 3.0))
    for k in range(1, 3):
        unsure(0.1 * k, 2.0, 0.0)
        state = receiver.take(place(0.1 * k, 3.0))
        assert (state.x_m, state.y_m, state.yaw_rad) == pytest.approx((3.0, 4.0, 0.3))
    receiver.hear(0.3, 0.4, 0.8)
    assert receiver.take(place(0.3, 3.05)).yaw_rad == pytest.approx(0.4)
    # It stands again, and its heading is the last one that was told.
    for k in range(4, 12):
        unsure(0.1 * k, -2.0, 0.0)
        state = receiver.take(place(0.1 * k, 3.05))
    assert state.yaw_rad == pytest.approx(0.4)
    for k in range(12, 20):
        unsure(0.1 * k, 0.4, 1.1)
        try:
            receiver.take(place(0.1 * k, 3.05 + 0.11 * (k - 11)))
            told = ""
        except Unusable as error:
            told = str(error)
    # Without speeds it takes some places to know that it drives.
    assert told.startswith("heading: the last usable one is")


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 50.0])
def test_a_heading_that_is_found_as_the_vehicle_drives_off_is_no_jump(rate_hz: float) -> None:
    """A receiver with one antenna gives an arbitrary one at rest."""
    receiver = Receiver(start_yaw_rad=0.0)
    x_m = 0.0
    for k in range(round(4.0 * rate_hz)):
        t_s = k / rate_hz
        speed_mps = 3.0 * max(t_s - 1.0, 0.0)
        x_m += speed_mps / rate_hz
        receiver.hear(t_s, 2.8 if speed_mps < 1.0 else 0.0, speed_mps)
        state = receiver.take(receiver.place(t_s, x_m, 0.0))
    assert state.yaw_rad == pytest.approx(0.0, abs=1e-6)
    assert state.speed_mps == pytest.approx(speed_mps)
