"""The VUT along its path: where it is by filtered states, and when it arrives.

Nothing here reads a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState, Size
from ssp_scenario_manager.core.routine import Routine

# Time constant of the filter on the VUT's place and speed.
FILTER_S = 0.15
# The VUT's acceleration counts for so long ahead; then its speed is taken to stay.
HOLD_S = 1.0
# Below this speed a VUT doesn't arrive.
STANDSTILL_MPS = 0.5


@dataclass(frozen=True, slots=True)
class VutTrack:
    """The VUT along its path, filtered.

    Args:
        stamp_ns: of the newest state.
        front_m: arc length of its front.
        speed_mps: along the path.
        acceleration_mps2: along the path.
    """

    stamp_ns: int
    front_m: float
    speed_mps: float
    acceleration_mps2: float


def follow_vut(track: VutTrack | None, vut: ObjectState, path: Polyline) -> VutTrack:
    """Takes a newer state into account: place and speed go on as reported, noise is averaged."""
    station, _ = path.project_beyond(vut.x_m, vut.y_m)
    front = station + vut.size.front_m
    if track is None:
        return VutTrack(vut.stamp_ns, front, vut.speed_mps, vut.acceleration_mps2)
    dt = ns_to_seconds(vut.stamp_ns - track.stamp_ns)
    if dt <= 0.0:
        return track
    gain = -math.expm1(-dt / FILTER_S)
    # Acceleration leads, so that a VUT that changes its speed is followed without lag.
    acceleration = track.acceleration_mps2 + gain * (
        vut.acceleration_mps2 - track.acceleration_mps2
    )
    speed = track.speed_mps + 0.5 * (track.acceleration_mps2 + acceleration) * dt
    ahead = track.front_m + 0.5 * (track.speed_mps + speed) * dt
    return VutTrack(
        vut.stamp_ns,
        ahead + gain * (front - ahead),
        speed + gain * (vut.speed_mps - speed),
        acceleration,
    )


def arrival_ns(track: VutTrack, station_m: float) -> float:
    """Session time at which the VUT's front is at a station; inf: it doesn't get there.

    At its present speed (METHOD 1), that changes for HOLD_S as it does now.
    """
    left, v, a = station_m - track.front_m, track.speed_mps, track.acceleration_mps2
    if left <= 0.0:
        return track.stamp_ns + NS_PER_S * left / max(v, STANDSTILL_MPS)
    held = v * HOLD_S + 0.5 * a * HOLD_S * HOLD_S
    later = v + a * HOLD_S
    if min(v, later) < STANDSTILL_MPS:
        return math.inf
    if left >= held:
        seconds = HOLD_S + (left - held) / later
    elif abs(a) < 1e-6:
        seconds = left / v
    else:
        seconds = (math.sqrt(max(v * v + 2.0 * a * left, 0.0)) - v) / a
    return track.stamp_ns + NS_PER_S * seconds


def foreseen_gap_s(
    routine: Routine, track: VutTrack, size: Size, *, initiator_first: bool
) -> float:
    """The gap that comes of a manoeuvre as planned and a VUT that goes on as it does (METHOD 1).

    Args:
        routine: as planned.
        track: of the VUT.
        size: of the VUT.
        initiator_first: whose arrival comes first.
    """
    zone = routine.zone
    if initiator_first:
        left_ns = routine.execute_at_ns + routine.departure_s * NS_PER_S
        return (arrival_ns(track, zone.start_m) - left_ns) / NS_PER_S
    comes_ns = routine.execute_at_ns + routine.arrival_s * NS_PER_S
    return (comes_ns - arrival_ns(track, zone.end_m + size.length_m)) / NS_PER_S
