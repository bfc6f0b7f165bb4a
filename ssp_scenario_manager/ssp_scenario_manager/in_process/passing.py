"""How VUT and initiator really passed each other in a run: order and time gap (METHOD 1).

It is measured on the true states of a whole run, along the VUT's path, with the definitions that
the audit uses for recordings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import corridor_half_m, is_crossing, swept_stations
from ssp_core.motion.state import ObjectState


@dataclass(frozen=True, slots=True)
class Passing:
    """Who arrived first at the conflict zone, and how long after the first had left.

    Args:
        other_first: the initiator arrives before the VUT; None: it never arrives.
        time_gap_s: second arrival minus first departure; None: one of them never happens.
    """

    other_first: bool | None
    time_gap_s: float | None


@dataclass(frozen=True, slots=True)
class _Extent:
    """What an object covers of the path: from, to (m along it), right, left (m beside it)."""

    start_m: float
    end_m: float
    right_m: float
    left_m: float


NEVER = Passing(None, None)


def passing(
    vut: Sequence[ObjectState], other: Sequence[ObjectState], path: Polyline, since_ns: int
) -> Passing:
    """The passing of an object that enters the VUT's corridor, or is in it ahead of the VUT.

    Args:
        vut: true states of the VUT, in time order.
        other: true states of the object at the same instants.
        path: of the VUT.
        since_ns: session time of the trigger. An object that is in the corridor by then is
            followed: its zone is where it is at that time.
    """
    start = next((i for i, state in enumerate(vut) if state.stamp_ns >= since_ns), None)
    if start is None:
        return NEVER
    half_m = corridor_half_m(vut[0].size.width_m)
    extents = [_extent(state, path) for state in other]
    inside = [e.left_m >= -half_m and e.right_m <= half_m for e in extents]
    fronts = [s + state.size.front_m for s, state in zip(_stations(vut, path), vut, strict=True)]
    times = [ns_to_seconds(state.stamp_ns) for state in vut]
    if inside[start]:
        if extents[start].start_m < fronts[start]:
            return NEVER
        own_s = _reached_s(times, fronts, extents[start].start_m)
        return Passing(True, None if own_s is None else own_s - times[start])
    entry = next(
        (i for i in range(start + 1, len(inside)) if inside[i] and not inside[i - 1]), None
    )
    if entry is None:
        return NEVER
    left = next((i for i in range(entry, len(inside)) if not inside[i]), len(inside))
    crosses = is_crossing(_direction_rad(other[entry], path))
    if crosses:
        zone = _crossed(other, path, half_m, entry, extents[entry])
        departure_s = times[left] if left < len(times) else None
    else:
        whole = (i for i in range(entry, left) if _is_within(extents[i], half_m))
        zone = extents[entry].start_m, extents[next(whole, left - 1)].end_m
        departure_s = times[entry]
    arrival_s, own_s = times[entry], _reached_s(times, fronts, zone[0])
    if own_s is None or arrival_s <= own_s:
        known = own_s is not None and departure_s is not None
        return Passing(True, own_s - departure_s if known else None)  # type: ignore[operator]
    end_m = zone[1] if crosses else zone[0]
    cleared_s = _reached_s(times, fronts, end_m + vut[0].size.length_m)
    return Passing(False, None if cleared_s is None else arrival_s - cleared_s)


def _stations(states: Sequence[ObjectState], path: Polyline) -> list[float]:
    return [s for s, _ in path.project_all_beyond([(q.x_m, q.y_m) for q in states])]


def _extent(state: ObjectState, path: Polyline) -> _Extent:
    projected = path.project_all_beyond(state.box.corners())
    stations, offsets = [s for s, _ in projected], [d for _, d in projected]
    return _Extent(min(stations), max(stations), min(offsets), max(offsets))


def _is_within(extent: _Extent, half_m: float) -> bool:
    return extent.right_m >= -half_m and extent.left_m <= half_m


def _direction_rad(state: ObjectState, path: Polyline) -> float:
    station, _ = path.project_beyond(state.x_m, state.y_m)
    return math.remainder(state.yaw_rad - path.pose(station).yaw_rad, math.tau)


def _crossed(
    other: Sequence[ObjectState], path: Polyline, half_m: float, entry: int, at_entry: _Extent
) -> tuple[float, float]:
    """What both swept corridors share, from before the entry to after the exit."""
    start_m, end_m = at_entry.start_m, at_entry.end_m
    for way in (range(entry, len(other)), range(entry - 1, -1, -1)):
        for i in way:
            span = swept_stations(other[i], path, half_m)
            if span is None:
                break
            start_m, end_m = min(start_m, span[0]), max(end_m, span[1])
    return start_m, end_m


def _reached_s(
    times_s: Sequence[float], fronts_m: Sequence[float], station_m: float
) -> float | None:
    """When a front reaches a station, between samples; None: never."""
    for i, front_m in enumerate(fronts_m):
        if front_m < station_m:
            continue
        if i == 0 or front_m <= fronts_m[i - 1]:
            return times_s[i]
        share = (station_m - fronts_m[i - 1]) / (front_m - fronts_m[i - 1])
        return times_s[i - 1] + share * (times_s[i] - times_s[i - 1])
    return None
