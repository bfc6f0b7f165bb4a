"""What an adapted motion must stay inside of, and the pace that does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.geometry import FloatArray
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import Adaptation, ParticipantSpec
from ssp_core.safety.stopping import blind_excess_m
from ssp_scenario_manager.core.pace import Pace, play, toward

_SAME_SPEED_MPS = 0.01
_BISECTIONS = 5
# So long after the decisive instant, the pace is as good as back to 1.
_AFTER_S = 2.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an adapted motion must stay inside of (METHOD 2.3, the limits of safety).

    Args:
        limits: of the site.
        geofence: polygon, m, frame map.
        target: that moves.
        step_s: how often it judges its state.
    """

    limits: Limits
    geofence: Sequence[tuple[float, float]]
    target: ParticipantSpec
    step_s: float


def nearest_rate(
    planned: FloatArray,
    known: Pace,
    wish: Adaptation,
    bounds: Bounds,
    start_ns: int,
    rate: float,
    until_s: float,
) -> float:
    """The pace that comes nearest to a wanted one inside the limits.

    Args:
        planned: columns of the routine as planned.
        known: the pace as it goes on now.
        wish: of the trigger.
        bounds: of the motion.
        start_ns: when the new pace begins.
        rate: wanted.
        until_s: own time of what decides the gap.
    """
    if _fits(planned, wish, bounds, toward(known, start_ns, rate, until_s), until_s):
        return rate
    # As it goes on now it fits, and so does whatever is near enough to that.
    good, bad = known.wanted, rate
    for _ in range(_BISECTIONS):
        middle = 0.5 * (good + bad)
        if _fits(planned, wish, bounds, toward(known, start_ns, middle, until_s), until_s):
            good = middle
        else:
            bad = middle
    return good


def _fits(
    planned: FloatArray, wish: Adaptation, bounds: Bounds, pace: Pace, until_s: float
) -> bool:
    """Speed and acceleration stay inside the limits, or inside what was planned if that is more,
    and a blind stop from any of its points stays inside the fence."""
    near = planned[:, planned[0] <= until_s + _AFTER_S]
    played = play(near, pace).columns
    speed, acceleration = played[4], played[5]
    limits, site = bounds.limits, bounds.limits.acceleration_mps2
    most_up = min(site, wish.acceleration_mps2 or site)
    most_down = min(site, wish.deceleration_mps2 or site)
    return bool(
        speed.max() <= max(limits.speed_mps, near[4].max())
        and acceleration.max() <= max(most_up, near[5].max())
        and -acceleration.min() <= max(most_down, -near[5].min())
        and _stops_inside(played, near, bounds)
    )


def _stops_inside(played: FloatArray, planned: FloatArray, bounds: Bounds) -> bool:
    """Where it is faster than planned; where it isn't, the object has found that it does."""
    at = planned[4, -(played.shape[1] - 1) :] if played.shape[1] > 1 else planned[4, :0]
    faster = played[:, 1:][:, played[4, 1:] > at + _SAME_SPEED_MPS]
    if faster.shape[1] == 0:
        return True
    target = bounds.target
    excess = blind_excess_m(
        faster, target.cls, target.size, bounds.limits, bounds.geofence, bounds.step_s
    )
    return not excess.max() > 0.0
