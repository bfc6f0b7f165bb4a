"""GPS time with its leap seconds, and headings."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import NS_PER_S
from ssp_core.leap_seconds import leap_seconds, leap_seconds_may_be_old
from ssp_ot_controller.bodies.iso22133.units import (
    QUARTER_MS_NS,
    WEEK_NS,
    nearest_utc_ns,
    to_gps,
    to_utc_ns,
    yaw_of_compass,
)


def utc_ns(text: str) -> int:
    return round(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp() * 1000) * 1_000_000


@pytest.mark.parametrize(
    ("when", "week", "time_of_week_s"),
    [
        ("1980-01-06", 0, 0.0),
        ("1999-08-22", 1024, 13.0),
        ("2016-12-31 23:59:59", 1930, 16.0),
        ("2017-01-01", 1930, 18.0),
        ("2024-03-09 23:59:41.750", 2304, 604_799.75),
        ("2024-03-09 23:59:42", 2305, 0.0),
        ("2026-01-01 12:00:00", 2399, 388_818.0),
    ],
)
def test_known_times(when: str, week: int, time_of_week_s: float) -> None:
    assert to_gps(utc_ns(when)) == (week, round(time_of_week_s * NS_PER_S))
    assert to_utc_ns(week, round(time_of_week_s * NS_PER_S)) == utc_ns(when)


@pytest.mark.parametrize(
    ("when", "seconds"),
    [
        ("1980-01-06", 0),
        ("1981-07-01", 1),
        ("1999-01-01", 13),
        ("2016-12-31", 17),
        ("2025-01-01", 18),
    ],
)
def test_leap_seconds_of_known_days(when: str, seconds: int) -> None:
    assert leap_seconds(utc_ns(when)) == seconds


def test_the_table_says_until_when_it_is_known_to_be_good() -> None:
    assert not leap_seconds_may_be_old(utc_ns("2026-06-27"))
    assert leap_seconds_may_be_old(utc_ns("2026-06-28"))


def test_there_is_no_gps_time_before_1980() -> None:
    with pytest.raises(ValueError, match="before GPS time"):
        to_gps(utc_ns("1980-01-05"))


times = st.integers(utc_ns("1980-01-06") // QUARTER_MS_NS, utc_ns("2100-01-01") // QUARTER_MS_NS)


@given(times.map(lambda steps: steps * QUARTER_MS_NS))
def test_a_time_comes_back(now_ns: int) -> None:
    week, time_of_week_ns = to_gps(now_ns)
    assert 0 <= time_of_week_ns < WEEK_NS
    assert to_utc_ns(week, time_of_week_ns) == now_ns


@given(
    st.integers(utc_ns("2018-01-01") // QUARTER_MS_NS, utc_ns("2100-01-01") // QUARTER_MS_NS),
    st.integers(-(10**9), 10**9),
)
def test_a_time_of_week_belongs_to_the_week_that_makes_it_near(steps: int, apart: int) -> None:
    """Also where sender and receiver are in different weeks."""
    sent_ns = steps * QUARTER_MS_NS
    assert nearest_utc_ns(to_gps(sent_ns)[1], sent_ns + apart * QUARTER_MS_NS) == sent_ns


def test_a_message_from_before_midnight_read_after_it_keeps_its_week() -> None:
    sent_ns, read_ns = utc_ns("2024-03-09 23:59:41.990"), utc_ns("2024-03-09 23:59:42.010")
    assert to_gps(sent_ns)[0] != to_gps(read_ns)[0]
    assert nearest_utc_ns(to_gps(sent_ns)[1], read_ns) == sent_ns


@pytest.mark.parametrize(
    ("compass_deg", "yaw_deg"), [(0, 90), (90, 0), (180, -90), (270, 180), (-45, 135), (405, 45)]
)
def test_compass_headings(compass_deg: float, yaw_deg: float) -> None:
    assert yaw_of_compass(math.radians(compass_deg)) == pytest.approx(math.radians(yaw_deg))


@given(st.floats(-20.0, 20.0))
def test_a_heading_comes_back(heading_rad: float) -> None:
    back = yaw_of_compass(yaw_of_compass(heading_rad))
    assert math.remainder(back - heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)
