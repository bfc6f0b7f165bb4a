"""Do the service brakes do what they are asked? If not, the emergency brake has to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Point, Pose2, wrap_angle
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import Limits
from ssp_core.safety.fence import KnownRoom, way_excess_m, way_room_m
from ssp_core.safety.stopping import (
    SLACK_STOP_M,
    STRAIGHT_RAD,
    arc_places,
    blind_excess_m,
    blind_s,
    blind_stopping,
    grown,
    stopping_of,
)
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.control.tracker import Track

# From the first command to brake on the object is given so long before it is judged.
BRAKE_GRACE_S = 0.5
# After that it must have lost this share of the speed that the deceleration would have taken.
LEAST_SHARE = 0.5
# Below this speed brakes that judder at the end of a stop are no matter.
_SLOW_MPS = 0.3


@dataclass(frozen=True, slots=True)
class BrakeMonitor:
    """The begin of a braking and its speed."""

    since_ns: int
    from_mps: float

    def fails(self, speed_mps: float, now_ns: int, deceleration_mps2: float) -> bool:
        """Tell whether the object is too fast for the time that it has been braking.

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


class Brakes:
    """Stop of one object: as asked, as hard as it goes once its brakes failed, or blindly.

    Args:
        deceleration_mps2: that a stop is asked for.
        yaw_rad: of its start.

    Attributes:
        blind: the object has lost its place; it stays blind until it is cleared, whatever it sees
            later.
    """

    def __init__(self, deceleration_mps2: float, yaw_rad: float) -> None:
        self.blind = False
        self._deceleration_mps2 = deceleration_mps2
        self._monitor: BrakeMonitor | None = None  # of the braking that lasts
        self._failed = False  # until it is cleared
        self._last = Command(0.0, 0.0, yaw_rad)

    def clear(self) -> None:
        """Believe in places and brakes again, when the object is cleared."""
        self.blind = self._failed = False

    def release(self, command: Command) -> Command:
        """Take a command that drives, and return it."""
        self._last, self._monitor = command, None
        return command

    def brake(self, speed_mps: float, now_ns: int, command: Command) -> Command:
        """Take a command that brakes, and return it; an emergency stop if the brakes fail."""
        if self._monitor is None:
            self._monitor = BrakeMonitor(now_ns, speed_mps)
        elif self._monitor.fails(speed_mps, now_ns, self._deceleration_mps2):
            self._failed = True
        self._last = replace(command, emergency_stop=True) if self._failed else command
        return self._last

    def stop_blindly(self) -> Command:
        """Return the command of an object that has lost its place."""
        self.blind = True
        return self.hold_steering()

    def hold_steering(self) -> Command:
        """Return the last steering, and the brakes as hard as they go."""
        self._last = replace(self._last, acceleration_mps2=0.0, emergency_stop=True)
        return self._last


# Points of a reference are looked at so far apart at most.
_POINTS_M = 2.0


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A stop that would lead outside.

    Args:
        excess_m: how far the object would stick out.
        how: which stop, for people.
    """

    point: int
    excess_m: float
    how: str


# A way that is measured goes on for so much longer, and holds for the steps that follow.
_AHEAD_M = 10.0


class _Clear:
    """The last straight way that was measured: nothing within its room is outside.

    An object is judged along ways that are a few centimetres apart, nearly all far from the
    outline.
    """

    def __init__(self, fence: Sequence[Point]) -> None:
        self._fence = fence
        self._start: Point = (0.0, 0.0)
        self._along: Point = (1.0, 0.0)
        self._length_m = 0.0
        self._room_m = -math.inf

    def is_sure(self, start: Point, end: Point, radius_m: float) -> bool:
        """Tell whether nothing within a radius of a straight way is outside.

        False: it isn't known.
        """
        if self._holds(start, end, radius_m):
            return True
        dx, dy = end[0] - start[0], end[1] - start[1]
        length_m = math.hypot(dx, dy)
        if not math.isfinite(length_m + radius_m):
            return False
        ahead = _AHEAD_M / length_m if length_m > 0.0 else 0.0
        for share in (ahead, 0.0):
            self._start, self._length_m = start, length_m * (1.0 + share)
            self._along = (dx / length_m, dy / length_m) if length_m > 0.0 else (1.0, 0.0)
            far = end[0] + share * dx, end[1] + share * dy
            self._room_m = way_room_m(start, far, self._fence)
            if self._room_m > radius_m:
                return True
        return False

    def _holds(self, start: Point, end: Point, radius_m: float) -> bool:
        """Tell whether the measured way shows it: all of a way is as near to it as its ends."""
        left_m = self._room_m - radius_m
        if not left_m > 0.0:
            return False
        (x, y), (c, s) = self._start, self._along
        for px, py in (start, end):
            dx, dy = px - x, py - y
            along = c * dx + s * dy
            beyond = -along if along < 0.0 else max(along - self._length_m, 0.0)
            if not math.hypot(beyond, c * dy - s * dx) < left_m:
                return False
        return True


class StoppingRoom:
    """Judges stops of one object, and whether it is inside now.

    Args:
        fence: polygon, m, frame map.
        step_s: how often the object judges its state.
        slows_s: see ``ssp_core.safety.stopping.stopping_of``.
    """

    def __init__(
        self,
        cls: ObjectClass,
        size: Size,
        limits: Limits,
        fence: Sequence[Point],
        step_s: float,
        slows_s: float = 0.0,
    ) -> None:
        self._cls, self._limits, self._step_s, self._slows_s = cls, limits, step_s, slows_s
        self._size = size
        self._fence = list(fence)
        self._room = KnownRoom(self._fence)
        self._here, self._ahead, self._past = (_Clear(self._fence) for _ in range(3))
        self._last: Pose2 | None = None
        self._reach_m = size.reach_m
        self._turns = cls is not ObjectClass.PEDESTRIAN
        self._along = stopping_of(cls, limits, step_s, slows_s)
        self._blind = blind_stopping(cls, limits, step_s, slows_s)

    def outside_m(self, state: ObjectState) -> float:
        """Compute how far the object sticks out of the fence, here or since the last state.

        0 for inside, inf for nowhere.
        """
        here = Pose2(state.x_m, state.y_m, state.yaw_rad)
        if not math.isfinite(here.x_m + here.y_m + here.yaw_rad):
            return math.inf
        last, self._last = self._last or here, here
        moved_m = math.hypot(here.x_m - last.x_m, here.y_m - last.y_m)
        if self._room.holds(here.x_m, here.y_m, self._reach_m + moved_m):
            return 0.0
        moved_m += abs(wrap_angle(here.yaw_rad - last.yaw_rad)) * self._reach_m
        if self._here.is_sure(*self._axis(here, here), 0.5 * self._size.width_m + moved_m):
            return 0.0
        return self._swept_m([last, here])

    def excess_m(self, state: ObjectState, left_m: float | None, track: Track | None) -> float:
        """Compute how far a stop from here would lead outside at the worst.

        0 when all of it is inside.

        Args:
            state: of the object, with finite values.
            left_m: path ahead of it; None without a reference.
            track: the reference that it drives; None without one.
        """
        here, speed = Pose2(state.x_m, state.y_m, state.yaw_rad), abs(state.speed_mps)
        blind_m = self._blind.distance_m(speed, blind_s(self._limits))
        curvature = state.yaw_rate_radps / speed if self._turns and speed > 0.5 else 0.0
        worst = self._stop_excess_m(here, curvature, blind_m, self._ahead)
        if left_m is not None and track is not None:
            over_m = self._along.distance_m(speed, 0.0) - left_m
            if over_m > 0.0:
                end = Pose2(track.end.x_m, track.end.y_m, track.end.yaw_rad)
                worst = max(worst, self._stop_excess_m(end, 0.0, over_m, self._past))
        return worst

    def _stop_excess_m(
        self, here: Pose2, curvature_1pm: float, way_m: float, clear: _Clear
    ) -> float:
        """Compute how far the object sticks out anywhere on an arc."""
        there = _on_arc(here, curvature_1pm, way_m)
        # Ends of the object's axis included, the arc strays no further from its chord.
        size, bend = self._size, abs(curvature_1pm)
        chord_m = way_m + size.front_m + size.rear_m
        stray_m = bend * (chord_m**2 / 8.0 + max(size.front_m, size.rear_m) ** 2 / 2.0)
        if bend * chord_m < 1.0 and clear.is_sure(
            *self._axis(here, there), 0.5 * size.width_m + stray_m
        ):
            return 0.0
        places = arc_places(way_m, curvature_1pm)
        shares = (k / (places - 1) for k in range(places))
        return self._swept_m([_on_arc(here, curvature_1pm, way_m * share) for share in shares])

    def _axis(self, start: Pose2, end: Pose2) -> tuple[Point, Point]:
        """Return the line from its rear's middle at one pose to its front's middle at another."""
        return start.to_parent(-self._size.rear_m, 0.0), end.to_parent(self._size.front_m, 0.0)

    def _swept_m(self, way: Sequence[Pose2]) -> float:
        x, y, yaw = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in way]).T
        return float(way_excess_m(x, y, yaw, self._size, self._fence).max())

    def lack(self, columns: FloatArray) -> Shortfall | None:
        """Return the first point of a reference from which a stop would lead outside; None: none.

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
        # Straight on, so that its two ends sweep all of it.
        past = np.array([0.0, over[point]])
        xs, ys = x[-1] + past * np.cos(yaw[-1]), y[-1] + past * np.sin(yaw[-1])
        yaws = np.array([yaw[-1], yaw[-1]])
        excess = float(way_excess_m(xs, ys, yaws, grown(self._size), self._fence).max())
        return Shortfall(point, excess, "a stop goes past its end and") if excess > 0.0 else None

    def _blindly(self, columns: FloatArray, points: NDArray[np.intp]) -> Shortfall | None:
        worst = blind_excess_m(
            columns[:, points],
            self._cls,
            self._size,
            self._limits,
            self._fence,
            self._step_s,
            self._slows_s,
        )
        if not worst.max() > 0.0:
            return None
        first = int(np.argmax(worst > 0.0))
        return Shortfall(int(points[first]), float(worst[first]), "a stop that holds its steering")


def _on_arc(start: Pose2, curvature_1pm: float, along_m: float) -> Pose2:
    """Return a pose further on along the arc of a curvature."""
    half = 0.5 * curvature_1pm * along_m
    chord = along_m * (math.sin(half) / half if abs(half) > STRAIGHT_RAD else 1.0)
    heading = start.yaw_rad + half
    x_m, y_m = start.x_m + chord * math.cos(heading), start.y_m + chord * math.sin(heading)
    return Pose2(x_m, y_m, heading + half)
