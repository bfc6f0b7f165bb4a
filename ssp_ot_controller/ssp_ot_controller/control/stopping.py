"""Do the service brakes do what they are asked? If not, the emergency brake has to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Box, FloatArray, Pose2
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import Limits
from ssp_core.safety.fence import box_excess_m, room_m, row_excess_m
from ssp_core.safety.stopping import (
    SLACK_STOP_M,
    STRAIGHT_RAD,
    blind_excess_m,
    blind_s,
    blind_stopping,
    grown,
    stopping_of,
)
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.control.tracker import Track

# From the first command to brake on the object is given so long before it is judged.
BRAKE_GRACE_S = 0.5
# After that it must have lost this share of the speed that the deceleration would have taken.
LEAST_SHARE = 0.5
# Below this speed brakes that judder at the end of a stop are no matter.
_SLOW_MPS = 0.3


@dataclass(frozen=True, slots=True)
class BrakeMonitor:
    """When a braking began and at what speed."""

    since_ns: int
    from_mps: float

    def fails(self, speed_mps: float, now_ns: int, deceleration_mps2: float) -> bool:
        """True when the object is too fast for the time that it has been braking.

        Args:
            speed_mps: measured; no number counts as too fast.
            now_ns: on the clock of ``since_ns``.
            deceleration_mps2: that was asked for all the time.
        """
        elapsed_s = ns_to_seconds(now_ns - self.since_ns)
        if elapsed_s < BRAKE_GRACE_S:
            return False
        due_mps = abs(self.from_mps) - LEAST_SHARE * deceleration_mps2 * elapsed_s
        return not abs(speed_mps) <= max(due_mps, _SLOW_MPS)


# Points of a reference are looked at so far apart at most.
_POINTS_M = 2.0


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A stop that would end outside.

    Args:
        excess_m: how far the object would stick out.
        how: which stop, for people.
    """

    point: int
    excess_m: float
    how: str


class _Clear:
    """The last place that was measured: nothing within its room is outside.

    An object is judged at places a few centimetres apart, nearly all far from the outline.
    """

    def __init__(self, fence: Sequence[tuple[float, float]]) -> None:
        self._fence = fence
        self._x_m = self._y_m = 0.0
        self._room_m = -math.inf

    def is_sure(self, x_m: float, y_m: float, reach_m: float) -> bool:
        """True when no point within ``reach_m`` is outside; False when that isn't known."""
        dx, dy, left_m = x_m - self._x_m, y_m - self._y_m, self._room_m - reach_m
        if left_m > 0.0 and dx * dx + dy * dy < left_m * left_m:
            return True
        self._x_m, self._y_m = x_m, y_m
        self._room_m = room_m(x_m, y_m, self._fence)
        return self._room_m > reach_m


class StoppingRoom:
    """Judges stops of one object, and whether it is inside now.

    Args:
        fence: polygon, m, frame map.
        step_s: how often the object judges its state.
    """

    def __init__(
        self,
        cls: ObjectClass,
        size: Size,
        limits: Limits,
        fence: Sequence[tuple[float, float]],
        step_s: float,
    ) -> None:
        self._cls, self._limits, self._step_s = cls, limits, step_s
        self._size = size
        self._fence = list(fence)
        self._here, self._halfway, self._there = (_Clear(self._fence) for _ in range(3))
        self._reach_m = math.hypot(max(size.front_m, size.rear_m), 0.5 * size.width_m)
        self._turns = cls is not ObjectClass.PEDESTRIAN
        self._along = stopping_of(cls, limits, step_s)
        self._blind = blind_stopping(cls, limits, step_s)
        self._blind_s = blind_s(limits)

    def outside_m(self, state: ObjectState) -> float:
        """How far the object sticks out of the fence now, 0 for inside, inf for nowhere."""
        return self._excess_m(state.x_m, state.y_m, state.yaw_rad, self._here)

    def excess_m(self, state: ObjectState, left_m: float | None, track: Track | None) -> float:
        """How far a stop from here would end outside at the worst; 0 when it ends inside.

        Args:
            state: of the object, with finite values.
            left_m: path ahead of it; None without a reference.
            track: the reference that it drives; None without one.
        """
        x, y, yaw, speed = state.x_m, state.y_m, state.yaw_rad, abs(state.speed_mps)
        blind_m = self._blind.distance_m(speed, self._blind_s)
        curvature = state.yaw_rate_radps / speed if self._turns and speed > 0.5 else 0.0
        worst = max(
            self._excess_m(*_on_arc(x, y, yaw, curvature, 0.5 * blind_m), self._halfway),
            self._excess_m(*_on_arc(x, y, yaw, curvature, blind_m), self._there),
        )
        if left_m is not None and track is not None:
            over_m = self._along.distance_m(speed, 0.0) - left_m
            if over_m > 0.0:
                e = track.end
                past = _on_arc(e.x_m, e.y_m, e.yaw_rad, 0.0, over_m)
                worst = max(worst, self._excess_m(*past, self._there))
        return worst

    def _excess_m(self, x_m: float, y_m: float, yaw_rad: float, clear: _Clear) -> float:
        if not math.isfinite(yaw_rad):
            return math.inf
        if clear.is_sure(x_m, y_m, self._reach_m):
            return 0.0
        size, pose = self._size, Pose2(x_m, y_m, yaw_rad)
        return box_excess_m(Box(pose, size.front_m, size.rear_m, size.width_m), self._fence)

    def lack(self, columns: FloatArray) -> Shortfall | None:
        """The first point of a reference from which a stop would end outside, None for a good one.

        Args:
            columns: of the reference, finite.
        """
        _, x, y = columns[:3]
        stations = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
        # Of one that stands, the first point.
        at = np.arange(0.0, max(float(stations[-1]), _POINTS_M), _POINTS_M)
        # The last point before each station: of several at one place the fastest comes first.
        points = np.unique(np.searchsorted(stations, at, side="left"))
        return self._straight_on(columns, stations) or self._blindly(columns, points)

    def _straight_on(self, columns: FloatArray, stations: FloatArray) -> Shortfall | None:
        _, x, y, yaw, speed, _, _ = columns
        way = speed * self._along.reaction_s + speed**2 / (2.0 * self._along.deceleration_mps2)
        over = way + self._along.margin_m + SLACK_STOP_M - (stations[-1] - stations)
        point = int(np.argmax(over))
        if over[point] <= 0.0:
            return None
        steps = np.linspace(0.0, over[point], 2 + int(over[point] / _POINTS_M))
        xs, ys = x[-1] + steps * np.cos(yaw[-1]), y[-1] + steps * np.sin(yaw[-1])
        yaws = np.full(len(steps), yaw[-1])
        excess = float(row_excess_m(xs, ys, yaws, grown(self._size), self._fence).max())
        return Shortfall(point, excess, "a stop goes past its end and") if excess > 0.0 else None

    def _blindly(self, columns: FloatArray, points: NDArray[np.intp]) -> Shortfall | None:
        worst = blind_excess_m(
            columns[:, points], self._cls, self._size, self._limits, self._fence, self._step_s
        )
        if not worst.max() > 0.0:
            return None
        first = int(np.argmax(worst > 0.0))
        return Shortfall(int(points[first]), float(worst[first]), "a stop that holds its steering")


def _on_arc(
    x_m: float, y_m: float, yaw_rad: float, curvature_1pm: float, along_m: float
) -> tuple[float, float, float]:
    """A pose further on along the arc of a curvature."""
    half = 0.5 * curvature_1pm * along_m
    chord = along_m * (math.sin(half) / half if abs(half) > STRAIGHT_RAD else 1.0)
    heading = yaw_rad + half
    return x_m + chord * math.cos(heading), y_m + chord * math.sin(heading), heading + half
