"""Automatic emergency braking of the VUT's built-in driver.

It begins when an obstacle can't be avoided any more by braking comfortably. It brakes as hard as it
is set until nothing ahead is slower than the VUT, and holds it at standstill while something stands
ahead in its corridor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ssp_core.run_file.participants import Driver
from ssp_ot_controller.core.driver import Obstacle

# What is left between two bumpers when the braking was just enough.
MARGIN_M = 0.5
# Brakes need this long to build up; the gap closes meanwhile.
BUILD_UP_S = 0.2


def needed_deceleration(speed_mps: float, obstacle: Obstacle) -> float:
    """Constant deceleration in m/s^2 that just avoids an obstacle, inf for none that does.

    The obstacle keeps braking until it stands; that it may speed up doesn't count. Where the two
    come closest while it moves, (v - v_o)^2 / (2 s) + |a_o| is needed; where it stands first,
    v^2 / (2 (s + v_o^2 / (2 |a_o|))). s is the gap less the margin and less what closes while the
    brakes build up.

    Args:
        speed_mps: of the VUT, >= 0.
        obstacle: ahead of it.
    """
    ahead, braking = max(obstacle.speed_mps, 0.0), max(-obstacle.acceleration_mps2, 0.0)
    closing = speed_mps - ahead
    if closing <= 0.0 and braking == 0.0:
        return 0.0
    room = obstacle.gap_m - MARGIN_M - max(closing, 0.0) * BUILD_UP_S
    if closing > 0.0:
        if room <= 0.0:
            return math.inf
        meets_after_s = 2.0 * room / closing
        if braking == 0.0 or meets_after_s < ahead / braking:
            return braking + closing * closing / (2.0 * room)
    to_standstill = room + ahead * ahead / (2.0 * braking)
    return speed_mps**2 / (2.0 * to_standstill) if to_standstill > 0.0 else math.inf


def brakes(active: bool, speed_mps: float, obstacles: Iterable[Obstacle], driver: Driver) -> bool:
    """Whether the emergency brake is on in the next step.

    Args:
        active: it is on.
        speed_mps: of the VUT, >= 0.
        obstacles: everything ahead of it, as ``driver.find_obstacles`` gives them.
        driver: its ``aeb_deceleration_mps2`` is None where there is no such brake.
    """
    if driver.aeb_deceleration_mps2 is None:
        return False
    if active:
        return any(o.speed_mps < speed_mps or o.speed_mps <= 0.0 for o in obstacles)
    limit = driver.comfortable_deceleration_mps2
    return any(needed_deceleration(speed_mps, o) > limit for o in obstacles)
