"""MONR as readings of a body, and GREM as answers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import NS_PER_S
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.iso22133.framing import (
    Header,
    Reason,
    RejectedBytes,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    DriveDirection,
    Grem,
    MessageId,
    Monr,
    ResponseCode,
)
from ssp_ot_controller.bodies.iso22133.reports import Answers, MonrReadings
from ssp_ot_controller.bodies.iso22133.units import to_gps
from ssp_ot_controller.bodies.odometry import LeverArm

MS = 1_000_000
T0 = 1_790_000_000 * NS_PER_S
FLAT = Datum(Place(57.7779, 12.7810, 201.5))
TURNED = replace(FLAT, yaw_rad=2.0)


# -- readings -------------------------------------------------------------------------------------


def monr(at_ns: int, **changes: Any) -> Monr:
    base = Monr(
        time_of_week_ns=to_gps(at_ns)[1],
        x_m=10.0,
        y_m=20.0,
        z_m=0.0,
        yaw_rad=0.0,
        pitch_rad=None,
        roll_rad=None,
        speed_mps=5.0,
        lateral_speed_mps=None,
        acceleration_mps2=None,
        lateral_acceleration_mps2=None,
        drive_direction=0,
        state=4,
        ready_to_arm=0,
        error_status=0,
        error_code=0,
    )
    return replace(base, **changes)


def taken(readings: MonrReadings, report: Monr, now_ns: int) -> BodyReading:
    found = readings.take(report, now_ns)
    assert isinstance(found, BodyReading), found
    return found


def test_a_monr_becomes_a_reading_of_the_reference_point() -> None:
    """The object reports a point 2 m ahead and 1 m to the left; it looks north."""
    readings = MonrReadings(FLAT, LeverArm(2.0, 1.0))
    reading = taken(readings, monr(T0, yaw_rad=math.pi / 2, acceleration_mps2=-1.0), T0 + 7 * MS)
    assert reading.stamp_ns == T0
    assert (reading.x_m, reading.y_m) == pytest.approx((11.0, 18.0))
    assert (reading.yaw_rad, reading.speed_mps) == pytest.approx((math.pi / 2, 5.0))
    assert reading.acceleration_mps2 == -1.0
    assert reading.position_std_m == math.inf
    assert not reading.brakes_by_itself


def test_a_turned_site_sees_the_object_in_its_own_frame() -> None:
    told = TURNED.to_enu(Pose2(3.0, 4.0, 0.5))
    report = monr(T0, x_m=told.x_m, y_m=told.y_m, yaw_rad=told.yaw_rad % (2 * math.pi))
    reading = taken(MonrReadings(TURNED), report, T0)
    assert (reading.x_m, reading.y_m, reading.yaw_rad) == pytest.approx((3.0, 4.0, 0.5))


@pytest.mark.parametrize("name", ["x_m", "y_m", "yaw_rad", "speed_mps", "time_of_week_ns"])
def test_a_monr_without_place_motion_or_time_gives_no_reading(name: str) -> None:
    found = MonrReadings(FLAT).take(monr(T0, **{name: None}), T0)
    assert found == RejectedBytes(Reason.MISSING, f"{name} unavailable")


def test_an_object_is_as_accurate_as_it_was_asked_to_be_until_it_says_that_it_is_not() -> None:
    readings = MonrReadings(FLAT, position_error_m=0.05)
    assert taken(readings, monr(T0, error_status=0xDF), T0).position_std_m == 0.05
    assert taken(readings, monr(T0 + MS, error_status=0x20), T0).position_std_m == math.inf


def test_an_old_monr_is_not_taken_again() -> None:
    readings = MonrReadings(FLAT)
    taken(readings, monr(T0), T0)
    for at_ns in (T0, T0 - 10 * MS):
        found = readings.take(monr(at_ns), T0)
        assert isinstance(found, RejectedBytes)
        assert found.reason is Reason.ORDER
    taken(readings, monr(T0 + 10 * MS), T0)


@pytest.mark.parametrize("ahead_s", [2, 18, 3 * 86_400])
def test_one_monr_from_the_future_does_not_keep_out_those_that_follow(ahead_s: int) -> None:
    readings = MonrReadings(FLAT)
    taken(readings, monr(T0), T0)
    ahead = taken(readings, monr(T0 + ahead_s * NS_PER_S), T0 + 10 * MS)
    assert ahead.stamp_ns == T0 + ahead_s * NS_PER_S
    reading = taken(readings, monr(T0 + 20 * MS, speed_mps=5.2), T0 + 20 * MS)
    assert reading.stamp_ns == T0 + 20 * MS
    assert 0.0 < reading.acceleration_mps2 < 10.0
    assert isinstance(readings.take(monr(T0), T0 + 30 * MS), RejectedBytes)


def test_an_object_that_is_connected_again_may_have_an_earlier_clock() -> None:
    readings = MonrReadings(FLAT)
    taken(readings, monr(T0), T0)
    readings.forget()
    assert taken(readings, monr(T0 - 5 * NS_PER_S), T0 + MS).acceleration_mps2 == 0.0


@pytest.mark.parametrize("stated", [5.0, -5.0])
def test_an_object_that_drives_backwards_has_a_negative_speed(stated: float) -> None:
    report = monr(T0, drive_direction=int(DriveDirection.BACKWARD), speed_mps=stated)
    assert taken(MonrReadings(FLAT), report, T0).speed_mps == -5.0


def test_an_aborting_object_is_said_to_brake_by_itself() -> None:
    report = monr(T0, state=int(ControlState.ABORTING))
    assert taken(MonrReadings(FLAT), report, T0).brakes_by_itself


def test_acceleration_and_yaw_rate_settle_at_their_differences() -> None:
    readings = MonrReadings(FLAT)
    for number in range(200):
        t = number * 0.01
        report = monr(
            T0 + number * 10 * MS, speed_mps=5.0 - 2.0 * t, yaw_rad=(6.0 + 0.5 * t) % 6.2831853
        )
        reading = taken(readings, report, T0 + number * 10 * MS)
        if number == 0:
            assert (reading.acceleration_mps2, reading.yaw_rate_radps) == (0.0, 0.0)
    assert reading.acceleration_mps2 == pytest.approx(-2.0, abs=0.01)
    assert reading.yaw_rate_radps == pytest.approx(0.5, abs=0.01)
    late = taken(readings, monr(T0 + 3000 * MS), T0 + 3000 * MS)
    assert (late.acceleration_mps2, late.yaw_rate_radps) == (0.0, 0.0)


def test_readings_across_a_week_of_gps_time_stay_in_order() -> None:
    edge_ns = 1_710_028_782 * NS_PER_S  # 2024-03-09 23:59:42 UTC
    readings = MonrReadings(FLAT)
    stamps = [
        taken(readings, monr(edge_ns + k * 10 * MS), edge_ns + k * 10 * MS + 3 * MS).stamp_ns
        for k in range(-3, 4)
    ]
    assert stamps == [edge_ns + k * 10 * MS for k in range(-3, 4)]


# -- answers --------------------------------------------------------------------------------------


def grem(header: Header, response: int = ResponseCode.OK) -> Grem:
    return Grem(header.transmitter_id, header.counter, header.message_id, response)


def test_an_answer_is_found_once_and_silence_is_told_once() -> None:
    answers = Answers()
    osem = Header(MessageId.OSEM, counter=1, acknowledge=True)
    ostm = Header(MessageId.OSTM, counter=2, acknowledge=True)
    heab = Header(MessageId.HEAB, counter=3)
    for number, header in enumerate((osem, ostm, heab)):
        answers.on_sent(header, T0 + number)
    found = answers.on_grem(grem(osem, ResponseCode.NOT_SUPPORTED), T0 + 10)
    assert found is not None
    assert (found.sent, found.after_ns, found.grem.response) == (osem, 10, 3)
    assert answers.on_grem(grem(osem), T0 + 11) is None
    assert answers.silent(T0 + 101, 100) == []
    assert answers.silent(T0 + 102, 100) == [ostm]
    assert answers.silent(T0 + 999, 100) == []
    assert answers.on_grem(grem(ostm), T0 + 999) is None


@given(st.lists(st.tuples(st.integers(0, 255), st.sampled_from(MessageId)), max_size=600))
def test_answers_that_never_come_do_not_pile_up(sent: list[tuple[int, MessageId]]) -> None:
    answers = Answers()
    for counter, message_id in sent:
        answers.on_sent(Header(message_id, counter=counter, acknowledge=True), T0)
    assert len(answers.silent(T0 + 2, 1)) == len(set(sent))
