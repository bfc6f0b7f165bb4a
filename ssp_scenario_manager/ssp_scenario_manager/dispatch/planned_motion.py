"""An object's manoeuvre in its own time, played faster or slower, and how it meets the VUT."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import FloatArray, Polyline, Pose2, wrap_angle
from ssp_core.motion.encounter import (
    AGAINST_RAD,
    ALONG_RAD,
    corridor_half_m,
    swept_on_way,
    swept_stations,
)
from ssp_core.motion.passing import Zone
from ssp_core.motion.reference import Points, Reference, ReferencePoint, between
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import Role

# What a manoeuvre does later than this is no matter of its conflict.
_LOOKED_AT_S = 20.0
# Points that are looked at at once.
_PIECE = 32


@dataclass(frozen=True)
class PlannedMotion:
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
    """Return the manoeuvre's points over own time, after those of the approach, from a time on.

    Args:
        current: the reference that is driven until the manoeuvre begins; None: it stands.
        manoeuvre: its reference.
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


def planned_motion_of(
    current: Reference | None,
    manoeuvre: Reference,
    from_ns: int,
    target: ParticipantSpec,
    vut: ParticipantSpec,
    path: Polyline,
) -> PlannedMotion | None:
    """Find where and when a manoeuvre meets the VUT's corridor, None where it doesn't enter it.

    Args:
        current: the reference that is driven until the manoeuvre begins; None: it stands.
        manoeuvre: its reference.
        from_ns: session time from which it is followed.
        target: the object that drives it.
        vut: the VUT as the run has it.
        path: the VUT's, frame map.
    """
    columns = columns_of(current, manoeuvre, from_ns)
    half = corridor_half_m(vut.size.width_m)
    clearance, heading, offset = _until_it_left(columns, target, half, path)
    inside = clearance <= 0.0
    entries = np.flatnonzero(inside[1:] & ~inside[:-1]) + 1
    if len(entries) == 0 or inside[0]:
        return None
    entry = int(entries[0])
    arrival = _crossing_s(columns[0], clearance, entry)
    direction = abs(float(heading[entry]))
    place = _state_at(columns, entry, arrival, target)
    if direction <= ALONG_RAD:
        rear = min(s for s, _ in path.project_all_beyond(place.box.corners()))
        zone = Zone(rear, rear)
        return PlannedMotion(columns, manoeuvre.execute_at_ns, arrival, arrival, zone)
    left = np.flatnonzero(~inside[entry:])
    if len(left) == 0:
        return None
    exit_ = entry + int(left[0])
    departure = _crossing_s(columns[0], clearance, exit_)
    if direction > AGAINST_RAD:
        # It is oncoming, unless it turns and leaves on the other side.
        turned = abs(float(heading[exit_])) <= AGAINST_RAD
        if not turned or offset[entry - 1] * offset[exit_] > 0.0:
            return None
        way = (Pose2(*pose) for pose in columns[1:4, entry : exit_ + 1].T.tolist())
        swept = swept_on_way(way, target.size, path, half)
        return (
            None
            if swept is None
            else PlannedMotion(columns, manoeuvre.execute_at_ns, arrival, departure, Zone(*swept))
        )
    reach = 4.0 * (half + target.size.length_m + target.size.width_m)
    span = swept_stations(place, path, half, reach)
    if span is None:
        return None
    return PlannedMotion(columns, manoeuvre.execute_at_ns, arrival, departure, Zone(*span))


def _until_it_left(
    columns: FloatArray, target: ParticipantSpec, half_m: float, path: Polyline
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute ``_clearance`` for no more points than show the object come in and leave."""
    clearance, heading, offset = np.empty(0), np.empty(0), np.empty(0)
    count = int(np.searchsorted(columns[0], _LOOKED_AT_S, side="right"))
    for i in range(0, count, _PIECE):
        more = _clearance(columns[:, i : min(i + _PIECE, count)], target, half_m, path)
        clearance = np.append(clearance, more[0])
        heading = np.append(heading, more[1])
        offset = np.append(offset, more[2])
        inside = np.flatnonzero(clearance <= 0.0)
        if len(inside) and (clearance[inside[0] :] > 0.0).any():
            break
        if len(inside) and abs(float(heading[inside[0]])) <= ALONG_RAD:
            break
    return clearance, heading, offset


def _clearance(
    columns: FloatArray, target: ParticipantSpec, half_m: float, path: Polyline
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return distance from the VUT's corridor, < 0 inside it, heading off the path, and offset."""
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
    return np.maximum(low - half_m, -half_m - high), heading, offset


def _crossing_s(t_s: FloatArray, value: FloatArray, i: int) -> float:
    """Return the own time at which a value passes 0 between the points i - 1 and i."""
    a, b = float(value[i - 1]), float(value[i])
    share = a / (a - b) if a != b else 1.0
    return float(t_s[i - 1]) + min(max(share, 0.0), 1.0) * float(t_s[i] - t_s[i - 1])


def _state_at(columns: FloatArray, i: int, own_s: float, target: ParticipantSpec) -> ObjectState:
    """Return the object between the points i - 1 and i; its path counts as straight there."""
    a, b = columns[:, i - 1], columns[:, i]
    share = (own_s - a[0]) / (b[0] - a[0])
    x, y = (a[1:3] + share * (b[1:3] - a[1:3])).tolist()
    yaw = float(a[3]) + share * math.remainder(float(b[3] - a[3]), 2.0 * math.pi)
    return ObjectState(
        target.id, target.cls, Role.OT, 0, x, y, wrap_angle(yaw), float(a[4]), 0.0, 0.0, target.size
    )


# Time constant of the filter on the VUT's place and speed.
FILTER_S = 0.15
# The VUT's acceleration counts for so long ahead; then its speed is taken to stay.
HOLD_S = 1.0
# Below this speed a VUT doesn't arrive.
_LEAST_ARRIVAL_MPS = 0.5


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
    """Take a newer state into account: place and speed as reported, noise averaged."""
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
    """Return session time at which the VUT's front is at a station; inf: never.

    At its present speed (METHOD 1), that changes for HOLD_S as it does now.
    """
    left, v, a = station_m - track.front_m, track.speed_mps, track.acceleration_mps2
    if left <= 0.0:
        return track.stamp_ns + NS_PER_S * left / max(v, _LEAST_ARRIVAL_MPS)
    hold_m = v * HOLD_S + 0.5 * a * HOLD_S * HOLD_S
    later = v + a * HOLD_S
    if min(v, later) < _LEAST_ARRIVAL_MPS:
        return math.inf
    if left >= hold_m:
        seconds = HOLD_S + (left - hold_m) / later
    elif abs(a) < 1e-6:
        seconds = left / v
    else:
        seconds = (math.sqrt(max(v * v + 2.0 * a * left, 0.0)) - v) / a
    return track.stamp_ns + NS_PER_S * seconds


def foreseen_gap_s(
    planned_motion: PlannedMotion, track: VutTrack, size: Size, *, initiator_first: bool
) -> float:
    """Return the gap of a planned manoeuvre and a VUT that goes on as it does, s (METHOD 1).

    Args:
        planned_motion: of the manoeuvre.
        track: of the VUT.
        size: the VUT's.
        initiator_first: the initiator arrives first; else the VUT.
    """
    zone = planned_motion.zone
    if initiator_first:
        left_ns = planned_motion.execute_at_ns + planned_motion.departure_s * NS_PER_S
        return (arrival_ns(track, zone.start_m) - left_ns) / NS_PER_S
    comes_ns = planned_motion.execute_at_ns + planned_motion.arrival_s * NS_PER_S
    return (comes_ns - arrival_ns(track, zone.end_m + size.length_m)) / NS_PER_S


# Natural frequencies of the law, 1/s: most of a change is made within 1 s; nothing presses on the
# way back, which comes on top of whatever the manoeuvre itself brakes.
OMEGA_1PS = 3.0
HOME_1PS = 1.0
_NEWTON_STEPS = 6
# Newton's steps take no pace for slower than this.
_SLOWEST = 0.05
_SAME_TIME_S = 1e-4


@dataclass(frozen=True, slots=True)
class _Leg:
    """The law from one instant on: own time, pace and its change then, and the wanted pace."""

    own_s: float
    rate: float
    change_1ps: float
    target: float
    omega_1ps: float = OMEGA_1PS

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Return own time, pace and change of pace, t_s after the leg's beginning."""
        w = self.omega_1ps
        off = self.rate - self.target
        slope = self.change_1ps + w * off
        fade = math.exp(-w * t_s)
        gone = off * (1.0 - fade) / w + slope * (1.0 - (1.0 + w * t_s) * fade) / (w * w)
        now = off + slope * t_s
        return (
            self.own_s + self.target * t_s + gone,
            self.target + now * fade,
            (slope - w * now) * fade,
        )

    def over(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate ``at`` for an array of times; shape (n,) each."""
        w = self.omega_1ps
        off = self.rate - self.target
        slope = self.change_1ps + w * off
        fade = np.exp(-w * t_s)
        gone = off * (1.0 - fade) / w + slope * (1.0 - (1.0 + w * t_s) * fade) / (w * w)
        now = off + slope * t_s
        own = self.own_s + self.target * t_s + gone
        return own, self.target + now * fade, (slope - w * now) * fade

    def when(self, own_s: float) -> float:
        """Return the inverse of own time: s after the leg's beginning, for a later own time.

        The pace is positive, so that own time rises and Newton's steps converge.
        """
        t = max(own_s - self.own_s, 0.0) / self.target
        for _ in range(_NEWTON_STEPS):
            reached, rate, _ = self.at(t)
            t = max(t + (own_s - reached) / max(rate, _SLOWEST), 0.0)
        return t

    def when_each(self, own_s: FloatArray) -> FloatArray:
        """Evaluate ``when`` for an array of own times; shape (n,)."""
        t = np.maximum(own_s - self.own_s, 0.0) / self.target
        for _ in range(_NEWTON_STEPS):
            reached, rate, _ = self.over(t)
            t = np.maximum(t + (own_s - reached) / np.maximum(rate, _SLOWEST), 0.0)
        return t


@dataclass(frozen=True, slots=True)
class Pace:
    """The relation of a manoeuvre's own time to session time.

    Args:
        start_ns: session time from which on this holds.
        leg: how the pace changes from then on.
        switch_s: time after the start at which the pace begins to return to 1; inf: it is 1.
        home: how it returns to 1; None where it is 1.
    """

    start_ns: int
    leg: _Leg
    switch_s: float = math.inf
    home: _Leg | None = None

    def at(self, now_ns: int) -> tuple[float, float, float]:
        """Return the own time in s, pace, and change of pace in 1/s at a session time."""
        t = ns_to_seconds(now_ns - self.start_ns)
        if self.home is not None and t >= self.switch_s:
            return self.home.at(t - self.switch_s)
        return self.leg.at(t)

    def when_each(self, own_s: FloatArray) -> FloatArray:
        """Return times in s after start_ns at which own times are reached; shape (n,)."""
        if self.home is None:
            return self.leg.when_each(own_s)
        first = own_s <= self.home.own_s
        t = np.empty_like(own_s)
        t[first] = self.leg.when_each(own_s[first])
        t[~first] = self.switch_s + self.home.when_each(own_s[~first])
        return t

    def rates(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return pace and its change at times in s after start_ns; shape (n,) each."""
        _, rate, change = self.leg.over(t_s)
        if self.home is None:
            return rate, change
        _, later_rate, later_change = self.home.over(np.maximum(t_s - self.switch_s, 0.0))
        later = t_s >= self.switch_s
        return np.where(later, later_rate, rate), np.where(later, later_change, change)

    def arrival_ns(self, own_s: float) -> int:
        """Return the session time at which an own time that lies ahead is reached."""
        if self.home is not None and own_s > self.home.own_s:
            seconds = self.switch_s + self.home.when(own_s)
        else:
            seconds = self.leg.when(own_s)
        return self.start_ns + round(seconds * NS_PER_S)

    @property
    def target(self) -> float:
        """The pace that it goes to before it goes back to 1."""
        return self.leg.target


def as_planned(execute_at_ns: int) -> Pace:
    """Return the manoeuvre's pace as it was dispatched."""
    return Pace(execute_at_ns, _Leg(0.0, 1.0, 0.0, 1.0))


def toward(before: Pace, start_ns: int, target_rate: float, until_s: float) -> Pace:
    """Go on from a pace to a wanted one, until an own time, and then back to 1."""
    own, rate, change = before.at(start_ns)
    leg = _Leg(own, rate, change, target_rate)
    if until_s <= own:
        return Pace(start_ns, _Leg(own, rate, change, 1.0, HOME_1PS))
    switch_s = leg.when(until_s)
    _, later_rate, later_change = leg.at(switch_s)
    home = _Leg(until_s, later_rate, later_change, 1.0, HOME_1PS)
    return Pace(start_ns, leg, switch_s, home)


def required_rate(before: Pace, start_ns: int, own_s: float, in_s: float) -> float:
    """Return the wanted pace that reaches an own time so long after start_ns; inf: none does.

    Own time is linear in the wanted pace: tau = r1 T + (r0 - r1) A + (r0' + w (r0 - r1)) B with
    A = (1 - e^(-wT)) / w and B = (1 - (1 + wT) e^(-wT)) / w^2.
    """
    own, rate, change = before.at(start_ns)
    if in_s <= 0.0:
        return math.inf
    w = OMEGA_1PS
    fade = math.exp(-w * in_s)
    a = (1.0 - fade) / w
    b = (1.0 - (1.0 + w * in_s) * fade) / (w * w)
    room = in_s - a - w * b
    if room <= 1e-9:
        return math.inf
    return (own_s - own - rate * (a + w * b) - change * b) / room


def play(columns: FloatArray, pace: Pace) -> Points:
    """Return a manoeuvre's points at a pace, from the pace's start on.

    Args:
        columns: of the manoeuvre over its own time, shape (7, n).
        pace: at which it is played.
    """
    own_s, _, _ = pace.at(pace.start_ns)
    first = _point_at(columns, own_s)
    later = columns[:, columns[0] > own_s + _SAME_TIME_S]
    points = np.concatenate((first[:, None], later), axis=1)
    t = pace.when_each(points[0])
    t[0] = 0.0
    rate, change = pace.rates(t)
    speed, acceleration = points[4], points[5]
    points[5] = rate * rate * acceleration + change * speed
    points[4] = rate * speed
    # At its end it stands, and nothing is left of the acceleration that brought it there.
    points[5, -1] = np.where(points[4, -1] > 0.0, points[5, -1], 0.0)
    points[0] = t
    return Points(points)


def _point_at(columns: FloatArray, own_s: float) -> FloatArray:
    """Return the manoeuvre's point at an own time, shape (7,)."""
    i = int(np.searchsorted(columns[0], own_s, side="right"))
    if i == 0 or i == columns.shape[1]:
        edge = columns[:, min(i, columns.shape[1] - 1)].copy()
        edge[0] = own_s
        edge[5] = 0.0
        return edge
    a, b = ReferencePoint(*columns[:, i - 1].tolist()), ReferencePoint(*columns[:, i].tolist())
    p = between(a, b, own_s)
    return np.array(
        (
            own_s,
            p.x_m,
            p.y_m,
            wrap_angle(p.yaw_rad),
            p.speed_mps,
            p.acceleration_mps2,
            p.curvature_1pm,
        )
    )
