"""Units of the wire: GPS time, and headings.

Times of SSP are ns since 1970 (UTC). The wire has the GPS week (counted from 1980-01-06 without
rolling over) and the time of that week in quarter milliseconds; many messages have the latter
alone.

A yaw on the wire is measured from the x axis of the test's coordinate system, counter-clockwise as
seen from above, from 0 to less than 360 degrees. SSP announces a coordinate system that isn't
rotated: x points east and y north. So a yaw of the wire is a yaw of SSP, but for whole turns.
Vendors' messages and receivers of GNSS state compass headings: from north, clockwise.
"""

from __future__ import annotations

import math
from bisect import bisect_right

from ssp_core.clock import NS_PER_S
from ssp_core.geometry import wrap_angle
from ssp_core.leap_seconds import LEAPS_NS, day_ns
from ssp_core.leap_seconds import leap_seconds as leap_seconds

QUARTER_MS_NS = 250_000
WEEK_NS = 7 * 86_400 * NS_PER_S

_GPS_EPOCH_NS = day_ns("1980-01-06")
# When leap seconds have passed, counted as if there were none.
_LEAPS_PLAIN_NS = tuple(since + count * NS_PER_S for count, since in enumerate(LEAPS_NS, start=1))


def to_gps(utc_ns: int) -> tuple[int, int]:
    """Return the GPS week and time of that week in ns, rounded down to quarter milliseconds.

    Raises:
        ValueError: before GPS time began.
    """
    gps_ns = utc_ns - _GPS_EPOCH_NS + leap_seconds(utc_ns) * NS_PER_S
    if gps_ns < 0:
        raise ValueError(f"{utc_ns} ns is before GPS time began")
    week, time_of_week_ns = divmod(gps_ns, WEEK_NS)
    return week, time_of_week_ns - time_of_week_ns % QUARTER_MS_NS


def to_utc_ns(week: int, time_of_week_ns: int) -> int:
    """Return the UTC time of a GPS time, ns: the inverse of ``to_gps``."""
    plain_ns = _GPS_EPOCH_NS + week * WEEK_NS + time_of_week_ns
    return plain_ns - bisect_right(_LEAPS_PLAIN_NS, plain_ns) * NS_PER_S


def nearest_utc_ns(time_of_week_ns: int, near_ns: int) -> int:
    """Return the instant with that time of its week that is nearest to another instant.

    A message that was sent just before a week's end and is read after it gets its own week.
    """
    week, present_ns = to_gps(near_ns)
    return to_utc_ns(week + round((present_ns - time_of_week_ns) / WEEK_NS), time_of_week_ns)


def yaw_of_compass(heading_rad: float) -> float:
    """Return the yaw of a compass heading, and the other way round.

    Args:
        heading_rad: rad, from north, clockwise.

    Returns:
        rad, from east, counter-clockwise, in (-pi, pi].
    """
    return wrap_angle(0.5 * math.pi - heading_rad)
