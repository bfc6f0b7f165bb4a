"""How far and how long participants travel: free drivers, references, and stops."""

from __future__ import annotations

import math

from ssp_core.run_file.participants import Driver
from ssp_core.world.car_following import free_acceleration
from ssp_scenario_manager.core.dispatch import APPROACH_LEAD_S

STEP_S = 0.05
# A driver comes near its cruise speed only slowly; from this share on it counts as reached.
CRUISE_SHARE = 0.95
# Time for which both are to be seen at cruise speed before the trigger.
HOLD_S = 1.5
LEAST_HOLD_S = 1.0


def driver_travel(cruise_mps: float, acceleration_mps2: float, t_s: float) -> tuple[float, float]:
    """Distance in m and speed in m/s of a free driver (a (1 - (v/v0)^4)) t_s after standstill."""
    driver = Driver(cruise_mps=cruise_mps, acceleration_mps2=acceleration_mps2)
    distance, speed, left = 0.0, 0.0, t_s
    while left > 0.0:
        dt = min(STEP_S, left)
        faster = speed + free_acceleration(speed, driver) * dt
        distance += 0.5 * (speed + faster) * dt
        speed, left = faster, left - dt
    return distance, speed


def cruise_reached_s(cruise_mps: float, acceleration_mps2: float) -> float:
    """Time from standstill in s until a free driver has CRUISE_SHARE of its cruise speed.

    With x = v/v0: t = v0/a times the integral of 1 / (1 - x^4).
    """
    x = CRUISE_SHARE
    return cruise_mps / acceleration_mps2 * 0.5 * (math.atanh(x) + math.atan(x))


def reference_travel(cruise_mps: float, acceleration_mps2: float, t_s: float) -> float:
    """Distance in m that an OT's approach has covered at session time t_s, once at cruise speed."""
    moving = t_s - APPROACH_LEAD_S - cruise_mps / acceleration_mps2 - 0.2
    return 0.5 * cruise_mps**2 / acceleration_mps2 + cruise_mps * max(moving, 0.0)


def stopping_m(speed_mps: float, deceleration_mps2: float, reaction_s: float = 0.3) -> float:
    """Distance to a standstill, m."""
    return speed_mps * reaction_s + speed_mps**2 / (2.0 * deceleration_mps2)
