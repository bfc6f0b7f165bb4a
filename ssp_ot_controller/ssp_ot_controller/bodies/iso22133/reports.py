"""The reports of an object: MONR as readings of a body, and GREM as answers to messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geodesy import Datum
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.iso22133.framing import Header, Reason, RejectedBytes
from ssp_ot_controller.bodies.iso22133.messages import (
    DriveDirection,
    Grem,
    Monr,
    ObjectError,
)
from ssp_ot_controller.bodies.iso22133.states import state_of
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns
from ssp_ot_controller.bodies.odometry import AHEAD_S, LeverArm, smoothed_rate


class MonrReadings:
    """Readings of one object's reference point, made of its MONR. Reads no clock.

    A MONR states no yaw rate, and may state no acceleration: they are differences of yaw and
    speed, through a first-order filter. It states no accuracy either, only that it is bad.

    Args:
        lever: where the point that the object reports lies from the reference point.
        position_error_m: the largest one that its OSEM allowed, taken for the accuracy of an
            object that is trusted to report a worse one; infinite where none is.
    """

    def __init__(
        self,
        datum: Datum,
        lever: LeverArm | None = None,
        position_error_m: float = math.inf,
    ) -> None:
        self._datum = datum
        self._position_error_m = position_error_m
        self._lever = lever or LeverArm()
        self._last: BodyReading | None = None

    def forget(self) -> None:
        """Begin anew with the next MONR: a new connection stands, maybe to another clock."""
        self._last = None

    def take(self, monr: Monr, now_ns: int) -> BodyReading | RejectedBytes:
        """Return the reading of a MONR, or why it gives none.

        One of more than AHEAD_S ahead, which isn't taken elsewhere, is not remembered: no later
        MONR could follow it.

        Args:
            monr: of the object, newly arrived.
            now_ns: session time, for the GPS week.
        """
        missing = [name for name in _NEEDED if getattr(monr, name) is None]
        x, y, yaw, speed, time_ns = (getattr(monr, name) for name in _NEEDED)
        if missing:
            return RejectedBytes(Reason.MISSING, f"{', '.join(missing)} unavailable")
        stamp_ns = nearest_utc_ns(time_ns, now_ns)
        last = self._last
        if last is not None and stamp_ns <= last.stamp_ns:
            late_s = ns_to_seconds(last.stamp_ns - stamp_ns)
            return RejectedBytes(Reason.ORDER, f"is {late_s:.4f} s older than the newest one")
        lever = self._lever
        pose = self._datum.of_enu(Pose2(x, y, yaw))
        there = Pose2(pose.x_m, pose.y_m, wrap_angle(pose.yaw_rad - lever.yaw_left_rad))
        x_m, y_m = there.to_parent(-lever.forward_m, -lever.left_m)
        if monr.drive_direction == DriveDirection.BACKWARD:
            speed = -abs(speed)
        acceleration, rate = self._derived(stamp_ns, speed, there.yaw_rad)
        stated = monr.acceleration_mps2
        inaccurate = monr.error_status & ObjectError.BAD_POSITIONING_ACCURACY
        reading = BodyReading(
            stamp_ns=stamp_ns,
            x_m=x_m,
            y_m=y_m,
            yaw_rad=there.yaw_rad,
            speed_mps=speed,
            acceleration_mps2=acceleration if stated is None else stated,
            yaw_rate_radps=rate,
            position_std_m=math.inf if inaccurate else self._position_error_m,
            brakes_by_itself=state_of(monr.state) is ControlState.ABORTING,
        )
        if ns_to_seconds(stamp_ns - now_ns) <= AHEAD_S:
            self._last = reading
        return reading

    def _derived(self, stamp_ns: int, speed_mps: float, yaw_rad: float) -> tuple[float, float]:
        """Return the acceleration and yaw rate; 0 at first and after a pause."""
        last = self._last
        if last is None:
            return 0.0, 0.0
        dt_s = ns_to_seconds(stamp_ns - last.stamp_ns)
        faster_mps, turned_rad = speed_mps - last.speed_mps, wrap_angle(yaw_rad - last.yaw_rad)
        return (
            smoothed_rate(last.acceleration_mps2, faster_mps, dt_s),
            smoothed_rate(last.yaw_rate_radps, turned_rad, dt_s),
        )


_NEEDED = ("x_m", "y_m", "yaw_rad", "speed_mps", "time_of_week_ns")


@dataclass(frozen=True, slots=True)
class Answer:
    """A GREM beside what it answers.

    Args:
        after_ns: since the message was sent.
    """

    grem: Grem
    sent: Header
    after_ns: int


class Answers:
    """The messages with an acknowledge request, and their answers. Reads no clock.

    Counters have 8 bits, so that no more than 256 messages of a kind are ever waited for.
    """

    def __init__(self) -> None:
        self._sent: dict[tuple[int, int, int], tuple[Header, int]] = {}

    def on_sent(self, header: Header, now_ns: int) -> None:
        """Remember a message that goes out, unless it asks for no acknowledgement."""
        if header.acknowledge:
            key = header.transmitter_id, header.counter, header.message_id
            self._sent[key] = header, now_ns

    def on_grem(self, grem: Grem, now_ns: int) -> Answer | None:
        """Match a GREM with its message; None for an answer to no message that waits for one."""
        sent = self._sent.pop((grem.transmitter_id, grem.counter, grem.message_id), None)
        return None if sent is None else Answer(grem, sent[0], now_ns - sent[1])

    def silent(self, now_ns: int, limit_ns: int) -> list[Header]:
        """Return the messages that weren't answered within a limit; each is reported once."""
        late = [key for key, (_, at_ns) in self._sent.items() if now_ns - at_ns > limit_ns]
        return [self._sent.pop(key)[0] for key in late]
