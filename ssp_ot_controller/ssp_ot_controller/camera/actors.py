"""Motions of the participants of a clip: closed formulas of time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.road import CurvePiece
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.reference_line import ReferenceLine

# Exact for polynomials up to degree 31; the integrand of Steered is as smooth as one.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True)
class Ramp:
    """A smooth change of a speed: by change_mps, from start_s over duration_s (smoothstep)."""

    start_s: float
    duration_s: float
    change_mps: float

    def _share(self, t_s: float) -> float:
        return min(1.0, max(0.0, (t_s - self.start_s) / self.duration_s))

    def speed(self, t_s: float) -> float:
        p = self._share(t_s)
        return self.change_mps * (3.0 - 2.0 * p) * p * p

    def acceleration(self, t_s: float) -> float:
        p = self._share(t_s)
        return self.change_mps * 6.0 * p * (1.0 - p) / self.duration_s

    def way(self, t_s: float) -> float:
        p = self._share(t_s)
        after = max(0.0, t_s - self.start_s - self.duration_s)
        return self.change_mps * ((1.0 - 0.5 * p) * p**3 * self.duration_s + after)


@dataclass(frozen=True)
class Line:
    """Motion along one axis: a start, a speed, and smooth changes of the speed."""

    start_m: float
    speed_mps: float
    ramps: tuple[Ramp, ...] = ()

    def position(self, t_s: float) -> float:
        return self.start_m + self.speed_mps * t_s + sum(r.way(t_s) for r in self.ramps)

    def speed(self, t_s: float) -> float:
        return self.speed_mps + sum(r.speed(t_s) for r in self.ramps)

    def acceleration(self, t_s: float) -> float:
        return sum(r.acceleration(t_s) for r in self.ramps)


@dataclass(frozen=True)
class SteeredMotion:
    """Motion along the road of a body that keeps its speed while ``ramps`` move it sideways.

    What it gains sideways it loses ahead, as a car does that only steers: sqrt(v^2 - v_y^2).

    Args:
        start_m: place at t = 0.
        speed_mps: speed on the path, above every speed sideways.
        ramps: changes of the speed sideways, which starts at 0.
    """

    start_m: float
    speed_mps: float
    ramps: tuple[Ramp, ...]

    def _sideways(self, t_s: float) -> float:
        return sum(r.speed(t_s) for r in self.ramps)

    def position(self, t_s: float) -> float:
        """Return start plus speed times time, less the integral of what is lost, ramp by ramp."""
        limits = {0.0, t_s}
        for ramp in self.ramps:
            limits |= {min(t_s, ramp.start_s), min(t_s, ramp.start_s + ramp.duration_s)}
        times = sorted(t for t in limits if t >= 0.0)
        lost = 0.0
        for begin, end in pairwise(times):
            middle, half = (begin + end) / 2, (end - begin) / 2
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                speed = self.speed(middle + half * float(node))
                lost += half * float(weight) * (self.speed_mps - speed)
        return self.start_m + self.speed_mps * t_s - lost

    def speed(self, t_s: float) -> float:
        return math.sqrt(self.speed_mps**2 - self._sideways(t_s) ** 2)

    def acceleration(self, t_s: float) -> float:
        change = sum(r.acceleration(t_s) for r in self.ramps)
        return -self._sideways(t_s) * change / self.speed(t_s)


@dataclass(frozen=True)
class Actor:
    """A participant: motion along the road and across it; standing, it faces ``facing_rad``."""

    object_id: str
    object_class: ObjectClass
    role: Role
    along: Line | SteeredMotion
    across: Line
    facing_rad: float = 0.0

    def state(self, t_s: float) -> ObjectState:
        vx, vy = self.along.speed(t_s), self.across.speed(t_s)
        speed = math.hypot(vx, vy)
        yaw = math.atan2(vy, vx) if speed > 1e-3 else self.facing_rad
        ax, ay = self.along.acceleration(t_s), self.across.acceleration(t_s)
        turning = (vx * ay - vy * ax) / speed**2 if speed > 0.1 else 0.0
        return ObjectState(
            object_id=self.object_id,
            object_class=self.object_class,
            role=self.role,
            stamp_ns=seconds_to_ns(t_s),
            x_m=self.along.position(t_s),
            y_m=self.across.position(t_s),
            yaw_rad=wrap_angle(yaw),
            speed_mps=speed,
            acceleration_mps2=ax * math.cos(yaw) + ay * math.sin(yaw),
            yaw_rate_radps=turning,
            size=DEFAULT_SIZES[self.object_class],
        )


@dataclass(frozen=True)
class Turning:
    """A participant that drives straight on, turns, and goes straight on.

    Args:
        distance: along its way, from its place at the start.
        start: its place then.
        straight_m: up to where the turn begins.
        radius_m: of the turn, an arc.
        heading_rad: at the start; as it is, it heads against the road.
        turn_rad: by which it turns, + left.
    """

    object_id: str
    object_class: ObjectClass
    role: Role
    distance: Line
    start: tuple[float, float]
    straight_m: float
    radius_m: float
    heading_rad: float = math.pi
    turn_rad: float = math.pi / 2

    def place(self, driven_m: float) -> tuple[float, float, float]:
        """Return place and heading after a distance along its way: m, m, rad."""
        (x, y), side = self.start, math.copysign(self.radius_m, self.turn_rad)
        arc = min(max(driven_m - self.straight_m, 0.0), self.arc_m)
        beyond = max(driven_m - self.straight_m - arc, 0.0)
        before, yaw = self.heading_rad, self.heading_rad + arc / side
        ahead = min(driven_m, self.straight_m)
        x += ahead * math.cos(before) + side * (math.sin(yaw) - math.sin(before))
        y += ahead * math.sin(before) - side * (math.cos(yaw) - math.cos(before))
        return x + beyond * math.cos(yaw), y + beyond * math.sin(yaw), wrap_angle(yaw)

    @property
    def arc_m(self) -> float:
        """Length of the turn."""
        return abs(self.radius_m * self.turn_rad)

    def state(self, t_s: float) -> ObjectState:
        driven, speed = self.distance.position(t_s), self.distance.speed(t_s)
        x, y, yaw = self.place(driven)
        turns = 0.0 < driven - self.straight_m <= self.arc_m
        return ObjectState(
            object_id=self.object_id,
            object_class=self.object_class,
            role=self.role,
            stamp_ns=seconds_to_ns(t_s),
            x_m=x,
            y_m=y,
            yaw_rad=yaw,
            speed_mps=speed,
            acceleration_mps2=self.distance.acceleration(t_s),
            yaw_rate_radps=speed / math.copysign(self.radius_m, self.turn_rad) if turns else 0.0,
            size=DEFAULT_SIZES[self.object_class],
        )


@dataclass(frozen=True)
class Winding:
    """A participant that drives along a line of straights and arcs.

    Args:
        distance: along the line, from its begin.
        start: where the line begins.
        bends: length and curvature (+ left) of each part of it, m and 1/m.
    """

    object_id: str
    object_class: ObjectClass
    role: Role
    distance: Line
    start: Pose2
    bends: tuple[tuple[float, float], ...]

    @cached_property
    def line(self) -> ReferenceLine:
        """The line that it drives along."""
        return ReferenceLine(self.start, curve_pieces(self.bends))

    def state(self, t_s: float) -> ObjectState:
        driven, speed = self.distance.position(t_s), self.distance.speed(t_s)
        pose = self.line.pose(driven)
        ends = np.cumsum([length_m for length_m, _ in self.bends])
        part = min(int(np.searchsorted(ends, driven)), len(ends) - 1)
        return ObjectState(
            object_id=self.object_id,
            object_class=self.object_class,
            role=self.role,
            stamp_ns=seconds_to_ns(t_s),
            x_m=pose.x_m,
            y_m=pose.y_m,
            yaw_rad=wrap_angle(pose.yaw_rad),
            speed_mps=speed,
            acceleration_mps2=self.distance.acceleration(t_s),
            yaw_rate_radps=speed * self.bends[part][1],
            size=DEFAULT_SIZES[self.object_class],
        )


def curve_pieces(bends: tuple[tuple[float, float], ...]) -> list[CurvePiece]:
    """Return the pieces of a line from lengths and curvatures (+ left) of its parts, m and 1/m."""
    return [
        CurvePiece(length_m=length_m, start_curvature_1pm=bend, end_curvature_1pm=bend)
        for length_m, bend in bends
    ]
