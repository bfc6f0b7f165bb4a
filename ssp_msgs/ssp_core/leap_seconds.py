"""Leap seconds: by how many seconds GPS time is ahead of UTC, and until when the table is good.

Times are ns since 1970 (UTC). GPS time and UTC agreed when GPS time began, in 1980.
"""

from __future__ import annotations

from bisect import bisect_right
from datetime import UTC, datetime

from ssp_core.clock import NS_PER_S

# Days from which UTC is one second more behind GPS time, after IERS Bulletin C 70. Its next
# announcement was due before the last day.
_DAYS = (
    "1981-07-01",
    "1982-07-01",
    "1983-07-01",
    "1985-07-01",
    "1988-01-01",
    "1990-01-01",
    "1991-01-01",
    "1992-07-01",
    "1993-07-01",
    "1994-07-01",
    "1996-01-01",
    "1997-07-01",
    "1999-01-01",
    "2006-01-01",
    "2009-01-01",
    "2012-07-01",
    "2015-07-01",
    "2017-01-01",
)
TABLE_FROM = "2025-07-07"
TABLE_GOOD_UNTIL = "2026-06-28"


def day_ns(day: str) -> int:
    """Return the begin of a day of UTC, written as 2017-01-01."""
    return int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()) * NS_PER_S


LEAPS_NS = tuple(day_ns(day) for day in _DAYS)
_GOOD_UNTIL_NS = day_ns(TABLE_GOOD_UNTIL)


def leap_seconds(utc_ns: int) -> int:
    """Return the seconds by which GPS time is ahead of UTC."""
    return bisect_right(LEAPS_NS, utc_ns)


def leap_seconds_may_be_old(utc_ns: int) -> bool:
    """Tell whether leap seconds may have been announced that the table doesn't have."""
    return utc_ns >= _GOOD_UNTIL_NS
