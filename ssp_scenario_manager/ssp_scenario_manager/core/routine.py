"""What an object target does from a trigger on, in its own time, and where it meets the VUT.

Own time is 0 where the manoeuvre begins as planned; before that it is on its approach or stands.
Arrival, departure and conflict zone are those of METHOD 1 for the planned path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import FloatArray, Polyline, wrap_angle
from ssp_core.motion.encounter import AGAINST_RAD, corridor_half_m, is_crossing, swept_stations
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import Role

# What a manoeuvre does later than this is no matter of its conflict.
_LOOKED_AT_S = 20.0
# Points that are looked at at once.
_PIECE = 32


@dataclass(frozen=True, slots=True)
class Zone:
    """The conflict zone along the VUT's path, m: from the conflict point to its end."""

    start_m: float
    end_m: float


@dataclass(frozen=True)
class Routine:
    """A manoeuvre with what comes before it, and its meeting with the VUT.

    Args:
        columns: reference points over own time, shape (7, n).
        execute_at_ns: session time of own time 0, as planned.
        arrival_s: own time at which it reaches the VUT's corridor.
        departure_s: own time at which it has left the conflict zone.
        zone: that both share.
    """

    columns: FloatArray
    execute_at_ns: int
    arrival_s: float
    departure_s: float
    zone: Zone


def columns_of(current: Reference | None, manoeuvre: Reference, from_ns: int) -> FloatArray:
    """The manoeuvre's points over own time, with the approach's before them, from a time on.

    Args:
        current: the reference that is driven until the manoeuvre begins; None: it stands.
        manoeuvre: that was dispatched.
        from_ns: session time from which the points are needed.
    """
    points = manoeuvre.columns
    lead_s = ns_to_seconds(from_ns - manoeuvre.execute_at_ns)
    if lead_s >= 0.0:
        return points
    if (
        current is None
        or from_ns <= current.execute_at_ns
        or manoeuvre.execute_at_ns > _end(current)
    ):
        # Two points at one place: it stands there until the manoeuvre begins.
        waiting = points[:, :1].copy()
        waiting[0], waiting[4:6] = lead_s, 0.0
        return np.concatenate((waiting, points), axis=1)
    before = current.columns.copy()
    before[0] += ns_to_seconds(current.execute_at_ns - manoeuvre.execute_at_ns)
    # One point before, so that the first place that is asked for lies between two.
    first = max(int(np.searchsorted(before[0], lead_s, side="right")) - 1, 0)
    last = int(np.searchsorted(before[0], -1e-3, side="left"))
    return np.concatenate((before[:, first:last], points), axis=1)


def _end(reference: Reference) -> int:
    return reference.execute_at_ns + round(reference.times_s[-1] * NS_PER_S)


def routine_of(
    current: Reference | None,
    manoeuvre: Reference,
    from_ns: int,
    target: ParticipantSpec,
    vut: ParticipantSpec,
    path: Polyline,
) -> Routine | None:
    """Where and when a manoeuvre meets the VUT's corridor, None where it doesn't come into it.

    Args:
        current: the reference that is driven until the manoeuvre begins; None: it stands.
        manoeuvre: that was dispatched.
        from_ns: session time from which it is followed.
        target: who drives it.
        vut: whose corridor it comes into.
        path: of the VUT.
    """
    columns = columns_of(current, manoeuvre, from_ns)
    half = corridor_half_m(vut.size.width_m)
    clearance, heading = _until_it_left(columns, target, half, path)
    inside = clearance <= 0.0
    entries = np.flatnonzero(inside[1:] & ~inside[:-1]) + 1
    if len(entries) == 0 or inside[0]:
        return None
    entry = int(entries[0])
    arrival = _crossing_s(columns[0], clearance, entry)
    direction = abs(float(heading[entry]))
    if direction > AGAINST_RAD:
        return None
    place = _state_at(columns, entry, arrival, target)
    if not is_crossing(direction):
        rear = min(s for s, _ in path.project_all_beyond(place.box.corners()))
        zone = Zone(rear, rear)
        return Routine(columns, manoeuvre.execute_at_ns, arrival, arrival, zone)
    left = np.flatnonzero(~inside[entry:])
    if len(left) == 0:
        return None
    departure = _crossing_s(columns[0], clearance, entry + int(left[0]))
    reach = 4.0 * (half + target.size.length_m + target.size.width_m)
    span = swept_stations(place, path, half, reach)
    if span is None:
        return None
    return Routine(columns, manoeuvre.execute_at_ns, arrival, departure, Zone(*span))


def _until_it_left(
    columns: FloatArray, target: ParticipantSpec, half_m: float, path: Polyline
) -> tuple[FloatArray, FloatArray]:
    """As ``_clearance``, of no more points than it takes to see it come in and leave."""
    clearance, heading = np.empty(0), np.empty(0)
    count = int(np.searchsorted(columns[0], _LOOKED_AT_S, side="right"))
    for i in range(0, count, _PIECE):
        more = _clearance(columns[:, i : min(i + _PIECE, count)], target, half_m, path)
        clearance = np.append(clearance, more[0])
        heading = np.append(heading, more[1])
        inside = np.flatnonzero(clearance <= 0.0)
        if len(inside) and (clearance[inside[0] :] > 0.0).any():
            break
        if len(inside) and not is_crossing(abs(float(heading[inside[0]]))):
            break
    return clearance, heading


def _clearance(
    columns: FloatArray, target: ParticipantSpec, half_m: float, path: Polyline
) -> tuple[FloatArray, FloatArray]:
    """Distance of the object from the VUT's corridor, < 0 inside it, and heading off the path."""
    places = list(zip(columns[1].tolist(), columns[2].tolist(), strict=True))
    projected = path.project_all_beyond(places)
    offset = np.array([d for _, d in projected])
    along = np.array([path.pose(s).yaw_rad for s, _ in projected])
    turned = columns[3] - along
    size, half = target.size, target.size.width_m / 2.0
    across = [
        np.sin(turned) * x + np.cos(turned) * y
        for x in (size.front_m, -size.rear_m)
        for y in (half, -half)
    ]
    low, high = offset + np.min(across, axis=0), offset + np.max(across, axis=0)
    heading = np.array([wrap_angle(a) for a in turned.tolist()])
    return np.maximum(low - half_m, -half_m - high), heading


def _crossing_s(t_s: FloatArray, value: FloatArray, i: int) -> float:
    """Own time at which a value passes 0 between the points i - 1 and i."""
    a, b = float(value[i - 1]), float(value[i])
    share = a / (a - b) if a != b else 1.0
    return float(t_s[i - 1]) + min(max(share, 0.0), 1.0) * float(t_s[i] - t_s[i - 1])


def _state_at(columns: FloatArray, i: int, own_s: float, target: ParticipantSpec) -> ObjectState:
    """The object between the points i - 1 and i; its path counts as straight there."""
    a, b = columns[:, i - 1], columns[:, i]
    share = (own_s - a[0]) / (b[0] - a[0])
    x, y = (a[1:3] + share * (b[1:3] - a[1:3])).tolist()
    yaw = float(a[3]) + share * math.remainder(float(b[3] - a[3]), 2.0 * math.pi)
    return ObjectState(
        target.id, target.cls, Role.OT, 0, x, y, wrap_angle(yaw), float(a[4]), 0.0, 0.0, target.size
    )
