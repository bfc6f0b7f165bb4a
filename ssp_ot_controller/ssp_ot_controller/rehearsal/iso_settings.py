"""The requests of a control centre's OSEM: whether they can be kept, and what follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2
from ssp_ot_controller.bodies.iso22133.messages import CoordinateSystem, Osem, ResponseCode
from ssp_ot_controller.bodies.iso22133.units import leap_seconds
from ssp_ot_controller.objects.rules import ObjectRules

# An origin further away than this is none of the place where the object stands.
FARTHEST_ORIGIN_M = 10_000.0
# Three heartbeats have to be missing, whatever timeout an OSEM states.
_LEAST_PERIODS = 3
# Public objects divide by the rates; nothing can be kept to a bound of 0.
_NOT_ZERO = (
    "monr_rate_hz",
    "heab_rate_hz",
    "max_way_deviation_m",
    "max_lateral_deviation_m",
    "max_yaw_deviation_rad",
    "max_position_error_m",
    "heab_timeout_s",
)


@dataclass(frozen=True, slots=True)
class RefusalReason:
    """The reason why a message isn't obeyed."""

    code: ResponseCode
    text: str


def invalid(text: str) -> RefusalReason:
    return RefusalReason(ResponseCode.INVALID_DATA, text)


def not_now(text: str) -> RefusalReason:
    return RefusalReason(ResponseCode.GENERAL_ERROR, text)


def unsupported(text: str) -> RefusalReason:
    return RefusalReason(ResponseCode.NOT_SUPPORTED, text)


def problem_of(osem: Osem, now_ns: int) -> RefusalReason | None:
    """Say why settings can't be kept, None when they can."""
    for name in _NOT_ZERO:
        if getattr(osem, name) == 0:
            return invalid(f"{name} is 0")
    ours = leap_seconds(now_ns)
    if osem.leap_seconds != ours:
        return invalid(f"leap_seconds is {osem.leap_seconds}, our table has {ours}")
    if osem.rotation_rad:
        return invalid("rotation_rad isn't 0: its sense isn't public")
    return None


def frame_of(osem: Osem, datum: Datum | None) -> Pose2 | RefusalReason:
    """Return the pose of the centre's frame in frame map.

    Args:
        osem: settings that the centre sent.
        datum: of frame map; None: unknown, and the centre's frame is frame map.
    """
    if osem.latitude_deg is None or osem.longitude_deg is None:
        return invalid("latitude_deg and longitude_deg are unavailable")
    if datum is None:
        return Pose2(0.0, 0.0, 0.0)
    if osem.coordinate_system not in (CoordinateSystem.WGS84, CoordinateSystem.ITRF2000):
        return invalid(f"coordinate_system is {osem.coordinate_system}, ours is WGS 84")
    place = Place(osem.latitude_deg, osem.longitude_deg, osem.altitude_m or 0.0)
    x, y, _ = datum.to_site(place)
    away_m = math.hypot(x, y)
    if not away_m <= FARTHEST_ORIGIN_M:
        return invalid(
            f"the origin is {away_m / 1000.0:.1f} km from this site's, limit is "
            f"{FARTHEST_ORIGIN_M / 1000.0:g} km"
        )
    east_x, east_y, _ = datum.to_site(Datum(place).to_place(100.0, 0.0))
    return Pose2(x, y, math.atan2(east_y - y, east_x - x))


def tightened(rules: ObjectRules, osem: Osem) -> ObjectRules:
    """Tighten the rules of an object where the OSEM asks for more."""
    limits = rules.limits
    osem_limits = {
        "heartbeat_s": max(osem.heab_timeout_s, _LEAST_PERIODS / osem.heab_rate_hz),
        "error_longitudinal_m": osem.max_way_deviation_m,
        "error_lateral_m": osem.max_lateral_deviation_m,
        "error_yaw_rad": osem.max_yaw_deviation_rad,
        "position_std_m": osem.max_position_error_m,
    }
    tighter = {
        name: min(getattr(limits, name), value)
        for name, value in osem_limits.items()
        if value is not None
    }
    return replace(rules, limits=limits.model_copy(update=tighter))
