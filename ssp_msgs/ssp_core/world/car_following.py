"""The law by which the VUT's built-in driver keeps speed and gap, without a world around it.

The driver uses it in every step; the compiler uses it to foresee what the driver will do.
"""

from __future__ import annotations

import math

from ssp_core.run_file.participants import Driver

# Share of the softened acceleration in the mix.
_COOLNESS = 0.99
_MIN_GAP_M = 0.1


def free_acceleration(speed_mps: float, driver: Driver) -> float:
    """Return the acceleration in m/s^2 on a free road: a (1 - (v/v0)^4), v0 the cruise speed."""
    return driver.acceleration_mps2 * (1.0 - (speed_mps / driver.cruise_mps) ** 4)


def earliest_arrival_s(gap_m: float, speed_mps: float, driver: Driver) -> float:
    """Return the time to drive a distance, accelerating as the driver would, up to cruise speed.

    Args:
        gap_m: the distance, >= 0.
        speed_mps: at its start, >= 0.
        driver: for its acceleration and cruise speed.
    """
    a, v0 = driver.acceleration_mps2, speed_mps
    top = max(driver.cruise_mps, v0)
    t_top = (top - v0) / a
    s_top = 0.5 * (v0 + top) * t_top
    if gap_m <= s_top:
        return (math.sqrt(v0 * v0 + 2.0 * a * gap_m) - v0) / a
    return t_top + (gap_m - s_top) / top


def following_acceleration(
    speed_mps: float,
    gap_m: float,
    ahead_mps: float,
    ahead_acceleration_mps2: float,
    driver: Driver,
) -> float:
    """Return the acceleration in m/s^2 behind another road user.

    IDM: a (1 - (v/v0)^4 - (s*/s)^2), s* = s0 + v T + v dv / (2 sqrt(a b)). CAH: the acceleration
    that just avoids a collision when the one ahead keeps its own. Of the two the milder counts,
    softened: CAH + b tanh((IDM - CAH) / b).

    Args:
        speed_mps: of the vehicle.
        gap_m: bumper gap, > 0.
        ahead_mps: speed of the one ahead along the same path.
        ahead_acceleration_mps2: of the one ahead.
        driver: of the vehicle.
    """
    a, b = driver.acceleration_mps2, driver.comfortable_deceleration_mps2
    v = speed_mps
    closing = v - ahead_mps
    desired_gap_m = (
        driver.standstill_gap_m + v * driver.headway_s + v * closing / (2.0 * math.sqrt(a * b))
    )
    idm = free_acceleration(v, driver) - a * (max(desired_gap_m, 0.0) / gap_m) ** 2
    # The room that is left above the gap to keep at standstill.
    room = max(gap_m - driver.standstill_gap_m, _MIN_GAP_M)
    ahead_a = min(ahead_acceleration_mps2, a)
    slower = max(ahead_mps, 0.0)
    below = slower * slower - 2.0 * room * ahead_a
    if below > 0.0 and slower * closing <= -2.0 * room * ahead_a:
        cah = v * v * ahead_a / below
    else:
        cah = ahead_a - (closing * closing / (2.0 * room) if closing > 0.0 else 0.0)
    if idm >= cah:
        return idm
    return (1.0 - _COOLNESS) * idm + _COOLNESS * (cah + b * math.tanh((idm - cah) / b))
