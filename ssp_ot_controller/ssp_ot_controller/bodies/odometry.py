"""The way from a GNSS/INS fix to the VUT's state at its reference point, without ROS.

The receiver gives pose and velocity of its own frame (where antenna or unit sit, x forward).
The session speaks of the reference point: on the ground, under the rear axle. A lever arm joins the
two, and a rotating vehicle moves them at different velocities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import PeerError
from ssp_core.geometry import wrap_angle, yaw_of
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ControlState, Role

# Time constant of what is made of differences: acceleration of speeds, for one.
FILTER_S = 0.1
# Smaller offsets are the manager's to judge (limits.clock_offset_s), with the figure.
AHEAD_S = 1.0
# After a pause longer than this a difference says nothing about the rate now.
MAX_PAUSE_S = 0.5


class Unusable(PeerError):
    """A fix that can't become a state; the message says why."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One message of the receiver (nav_msgs/Odometry).

    Args:
        stamp_ns: when it was measured, session time, ns.
        frame_id: of the pose; must be the session's map (ENU).
        x_m: east, m.
        y_m: north, m.
        quaternion: orientation (x, y, z, w) of the unit in the map.
        forward_mps: velocity of the unit along its own x.
        left_mps: along its own y.
        yaw_rate_radps: counter-clockwise positive.
        variance_x_m2: of x; negative or NaN: the unit gives none.
        variance_y_m2: of y, as variance_x_m2.
    """

    stamp_ns: int
    frame_id: str
    x_m: float
    y_m: float
    quaternion: tuple[float, float, float, float]
    forward_mps: float
    left_mps: float
    yaw_rate_radps: float
    variance_x_m2: float
    variance_y_m2: float


@dataclass(frozen=True, slots=True)
class LeverArm:
    """The unit's place from the reference point, in the vehicle's frame; m and rad.

    Args:
        forward_m: + is ahead of the rear axle.
        left_m: + is left of the middle.
        yaw_left_rad: how the unit is turned against the vehicle.
    """

    forward_m: float = 0.0
    left_m: float = 0.0
    yaw_left_rad: float = 0.0


class VutStates:
    """Makes the VUT's states of fixes, numbered from 1. Reads no clock.

    Args:
        vut: the run's VUT; gives class and size.
        map_frame: the frame that fixes must be in.
    """

    def __init__(self, vut: ParticipantSpec, lever: LeverArm, map_frame: str) -> None:
        self._vut = vut
        self._lever = lever
        self.map_frame = map_frame
        self._last: ObjectState | None = None
        self._sequence = 0

    def take(self, fix: Fix, now_ns: int | None = None) -> ObjectState:
        """Return the state of the reference point at the fix's stamp.

        Raises:
            Unusable: wrong frame, values that aren't finite, a stamp that doesn't rise, or lies
                more than AHEAD_S ahead: no later fix could follow it. A VUT of which only such
                fixes come is silent, which ends a session.
        """
        if fix.frame_id != self.map_frame:
            raise Unusable(f"frame is {fix.frame_id!r}, the session's is {self.map_frame!r}")
        numbers = (fix.x_m, fix.y_m, *fix.quaternion, fix.forward_mps, fix.left_mps)
        if not all(math.isfinite(v) for v in (*numbers, fix.yaw_rate_radps)):
            raise Unusable("it holds a value that isn't finite")
        self.check_stamp(fix.stamp_ns, now_ns)
        try:
            yaw = wrap_angle(yaw_of(fix.quaternion) - self._lever.yaw_left_rad)
        except ValueError as error:
            raise Unusable(str(error)) from error
        state = self._state(fix, yaw)
        self._last = state
        self._sequence += 1
        return replace(state, sequence=self._sequence)

    def check_stamp(self, stamp_ns: int, now_ns: int | None) -> None:
        """Raise Unusable for a stamp that no state can have now."""
        ahead_s = 0.0 if now_ns is None else ns_to_seconds(stamp_ns - now_ns)
        if ahead_s > AHEAD_S:
            raise Unusable(f"its stamp lies {ahead_s:.3f} s ahead of this machine's clock")
        if self._last is not None and stamp_ns <= self._last.stamp_ns:
            late_s = ns_to_seconds(self._last.stamp_ns - stamp_ns)
            raise Unusable(f"its stamp lies {late_s:.3f} s before the newest one, or equals it")

    def _state(self, fix: Fix, yaw_rad: float) -> ObjectState:
        lever = self._lever
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        turn = lever.yaw_left_rad
        # The unit's velocity along the vehicle, less what turning adds at the lever's end.
        along = math.cos(turn) * fix.forward_mps - math.sin(turn) * fix.left_mps
        speed = along + fix.yaw_rate_radps * lever.left_m
        return ObjectState(
            object_id=self._vut.id,
            object_class=self._vut.cls,
            role=Role.VUT,
            stamp_ns=fix.stamp_ns,
            x_m=fix.x_m - c * lever.forward_m + s * lever.left_m,
            y_m=fix.y_m - s * lever.forward_m - c * lever.left_m,
            yaw_rad=yaw_rad,
            speed_mps=speed,
            acceleration_mps2=self._acceleration(fix.stamp_ns, speed),
            yaw_rate_radps=fix.yaw_rate_radps,
            size=self._vut.size,
            control_state=ControlState.OFF,
            position_std_m=_std_m(fix),
        )

    def _acceleration(self, stamp_ns: int, speed_mps: float) -> float:
        """Compute the acceleration from differences of speed; 0 at first and after a pause."""
        if self._last is None:
            return 0.0
        dt_s = ns_to_seconds(stamp_ns - self._last.stamp_ns)
        last = self._last
        return smoothed_rate(last.acceleration_mps2, speed_mps - last.speed_mps, dt_s)


def smoothed_rate(before: float, difference: float, dt_s: float) -> float:
    """Filter differences by a first-order lag; 0 after a pause.

    Args:
        before: what it gave for the difference before.
        difference: since the one before, in the unit of the result times s.
        dt_s: in which the difference came about, > 0.
    """
    if dt_s > MAX_PAUSE_S:
        return 0.0
    share = -math.expm1(-dt_s / FILTER_S)
    return before + share * (difference / dt_s - before)


def _std_m(fix: Fix) -> float:
    """Return the larger of the two standard deviations; infinite where the unit gives none.

    A receiver that doesn't say how good its position is has none that can be relied on.
    """
    worst = max(fix.variance_x_m2, fix.variance_y_m2)
    if not (fix.variance_x_m2 > 0.0 and fix.variance_y_m2 > 0.0 and math.isfinite(worst)):
        return math.inf
    return math.sqrt(worst)
