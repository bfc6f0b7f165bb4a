"""The way from latitude, longitude and heading to a fix in frame map, with a quality gate; no ROS.

Drivers of receivers publish ``NavSatFix`` for the place and ``Imu`` for the heading, as orientation
against east, north and up. Velocity is ``TwistStamped`` in the unit's axes with some and in those
of the Earth with others, which no message tells: of it only the horizontal speed is taken, and
whether the vehicle goes backwards is seen by where it goes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2, wrap_angle, yaw_of
from ssp_core.motion.state import ObjectState
from ssp_ot_controller.bodies.odometry import (
    MAX_PAUSE_S,
    Fix,
    LeverArm,
    Unusable,
    VutStates,
    smoothed_rate,
)

# A heading that its source takes for less sure than this is none; 1 m off at 20 m.
HEADING_STD_RAD = 0.05
# Slower than this backwards is noise of a vehicle that stands.
_BACKWARDS_MPS = 0.1
# A vehicle that drives goes where it heads, but for its slip; a heading against another axis shows.
_DRIVES_MPS = 3.0
# Faster than this a receiver whose heading is the course over ground must tell one.
_TELLS_COURSE_MPS = 1.0
_MOST_ACROSS = 0.5
# No vehicle that drives turns so far within so long: its source's heading has jumped.
_JUMP_RAD = math.pi / 2.0
_JUMP_S = 1.0
_HIGHEST_M = 1e5


class FixType(IntEnum):
    """The kind of a fix, by the numbers of NavSatStatus."""

    UNKNOWN = -2
    NO_FIX = -1
    FIX = 0
    SBAS = 1
    GBAS = 2


@dataclass(frozen=True, slots=True)
class NavSat:
    """The place of the antenna, or of the unit (NavSatFix).

    Args:
        stamp_ns: when it was measured, session time.
        status: of NavSatStatus.
        place: its altitude may be NaN.
        variance_m2: the larger of east and north; NaN: the receiver states none.
    """

    stamp_ns: int
    status: int
    place: Place
    variance_m2: float


@dataclass(frozen=True, slots=True)
class Heading:
    """The orientation of the unit (Imu).

    Args:
        quaternion: orientation (x, y, z, w) against east, north, up.
        variance_rad2: of the yaw; 0: not stated, negative: there is no orientation.
    """

    stamp_ns: int
    quaternion: tuple[float, float, float, float]
    variance_rad2: float


@dataclass(frozen=True, slots=True)
class Speed:
    """The speed of the unit over ground, m/s, in whatever direction."""

    stamp_ns: int
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Gate:
    """The requirements on a fix; its standard deviation is judged with the states.

    Args:
        least: fix type.
        apart_s: between a fix and the heading and velocity that belong to it.
    """

    least: FixType
    apart_s: float


class GnssStates:
    """Makes the VUT's states of fixes, headings and speeds. Reads no clock.

    Args:
        states: makes them of fixes in frame map.
        speeds: speeds are heard; False: speed is made of differences of places.
        start_yaw_rad: of the vehicle at its start, where the heading is known only while it drives;
            it counts until then, and the last known one after it. None: one is known at rest too.
    """

    def __init__(
        self,
        states: VutStates,
        lever: LeverArm,
        datum: Datum,
        gate: Gate,
        *,
        speeds: bool,
        start_yaw_rad: float | None = None,
    ) -> None:
        self._states = states
        self._mounting_yaw_rad = lever.yaw_left_rad
        self._datum = datum
        self._gate = gate
        self._hears_speeds = speeds
        self._by_course = start_yaw_rad is not None
        self._yaw_rad = (start_yaw_rad or 0.0) + lever.yaw_left_rad
        self._yaw_rate_radps = 0.0
        self._jumped_rad, self._drives = 0.0, False
        self._heading_ns: int | None = None
        self._speed: Speed | None = None
        self._last: tuple[int, float, float] | None = None
        self._velocity: tuple[float, float] | None = None
        self._why_no_heading = ""

    def hear_heading(self, heading: Heading) -> None:
        """Take a heading; its rate is made of differences.

        Raises:
            Unusable: there is none in it, or it is too uncertain.
        """
        try:
            self._take_heading(heading)
        except Unusable as error:
            self._why_no_heading = f" ({error})"
            raise
        self._why_no_heading = ""

    def _take_heading(self, heading: Heading) -> None:
        std_rad = math.sqrt(max(heading.variance_rad2, 0.0))
        if heading.variance_rad2 < 0.0 or not all(map(math.isfinite, heading.quaternion)):
            raise Unusable("it holds no orientation")
        if not std_rad <= HEADING_STD_RAD:
            raise Unusable(f"it is uncertain by {std_rad:.3f} rad, limit {HEADING_STD_RAD:g} rad")
        try:
            east_rad = yaw_of(heading.quaternion)
        except ValueError as error:
            raise Unusable(str(error)) from error
        yaw_rad = self._datum.of_enu(Pose2(0.0, 0.0, east_rad)).yaw_rad
        if self._heading_ns is not None:
            dt_s = ns_to_seconds(heading.stamp_ns - self._heading_ns)
            if dt_s == 0.0:
                return
            turned_rad = wrap_angle(yaw_rad - self._yaw_rad)
            # One from before is of a clock that was set back.
            rate = 0.0 if dt_s < 0.0 else smoothed_rate(self._yaw_rate_radps, turned_rad, dt_s)
            if self._drives and abs(turned_rad) > _JUMP_RAD and 0.0 < dt_s <= _JUMP_S:
                # Another jump leads back.
                self._jumped_rad, rate = 0.0 if self._jumped_rad else turned_rad, 0.0
            self._yaw_rate_radps = rate
        self._heading_ns, self._yaw_rad = heading.stamp_ns, yaw_rad

    def hear_speed(self, speed: Speed) -> None:
        """Take a speed.

        Raises:
            Unusable: it is no number.
        """
        if not math.isfinite(speed.speed_mps):
            raise Unusable("it holds a value that isn't finite")
        self._speed = speed

    def take(self, fix: NavSat, now_ns: int) -> ObjectState:
        """Return the state of the reference point at the fix's stamp.

        Raises:
            Unusable: the gate doesn't let it through, or ``VutStates.take`` doesn't.
        """
        names = {kind.value: kind.name for kind in FixType}
        if fix.status < self._gate.least or fix.status not in names:
            name = names.get(fix.status, str(fix.status))
            raise Unusable(f"fix type: {name}, {self._gate.least.name} is asked for")
        place = fix.place
        if math.isnan(place.altitude_m):
            place = replace(place, altitude_m=self._datum.place.altitude_m)
        is_on_earth = abs(place.latitude_deg) <= 90.0 and abs(place.longitude_deg) <= 180.0
        if not (is_on_earth and abs(place.altitude_m) <= _HIGHEST_M):
            raise Unusable("its latitude, longitude or altitude is out of range")
        self._states.check_stamp(fix.stamp_ns, now_ns)
        yaw_rad = self._unit_yaw_rad(fix.stamp_ns)
        x_m, y_m, _ = self._datum.to_site(place)
        forward_mps = self._forward_mps(fix.stamp_ns, x_m, y_m, yaw_rad - self._mounting_yaw_rad)
        # Along the vehicle, as the unit sees it with its own axes.
        c, s = math.cos(self._mounting_yaw_rad), math.sin(self._mounting_yaw_rad)
        return self._states.take(
            Fix(
                stamp_ns=fix.stamp_ns,
                frame_id=self._states.map_frame,
                x_m=x_m,
                y_m=y_m,
                quaternion=(0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)),
                forward_mps=c * forward_mps,
                left_mps=-s * forward_mps,
                yaw_rate_radps=self._yaw_rate_radps,
                variance_x_m2=fix.variance_m2,
                variance_y_m2=fix.variance_m2,
            ),
            now_ns,
        )

    def _unit_yaw_rad(self, stamp_ns: int) -> float:
        """Give the heading of the unit in the site's frame."""
        try:
            self._near("heading", self._heading_ns, stamp_ns, self._why_no_heading)
        except Unusable:
            if not self._by_course or self._latest_mps() > _TELLS_COURSE_MPS:
                raise
            self._yaw_rate_radps = 0.0
            return wrap_angle(self._yaw_rad)
        later_s = ns_to_seconds(stamp_ns - (self._heading_ns or stamp_ns))
        return wrap_angle(self._yaw_rad + self._yaw_rate_radps * later_s)

    def _latest_mps(self) -> float:
        if self._hears_speeds:
            return 0.0 if self._speed is None else self._speed.speed_mps
        return math.hypot(*(self._velocity or (0.0, 0.0)))

    def _near(self, what: str, stamp_ns: int | None, fix_ns: int, why: str = "") -> None:
        """Raise Unusable where a fix has no partner that was measured about when it was."""
        if stamp_ns is None:
            raise Unusable(f"{what}: no usable one has arrived{why}")
        apart_s = abs(ns_to_seconds(fix_ns - stamp_ns))
        if apart_s > self._gate.apart_s:
            limit = f"limit {self._gate.apart_s:g} s{why}"
            raise Unusable(f"{what}: the last usable one is {apart_s:.3f} s from the fix, {limit}")

    def _forward_mps(self, stamp_ns: int, x_m: float, y_m: float, yaw_rad: float) -> float:
        """Return the velocity of the unit along the vehicle's heading."""
        velocity = self._by_places(stamp_ns, x_m, y_m)
        speed_mps = self._speed_mps(stamp_ns, velocity)
        self._check_jump(speed_mps)
        vx, vy = velocity or (0.0, 0.0)
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        along_mps, across_mps = c * vx + s * vy, c * vy - s * vx
        if abs(across_mps) > _MOST_ACROSS * math.hypot(vx, vy) and math.hypot(vx, vy) > _DRIVES_MPS:
            turned_rad = math.atan2(across_mps, along_mps)
            raise Unusable(
                f"heading: the vehicle drives {turned_rad:+.2f} rad to the left of it; is it "
                "against east, north and up, and is --unit right?"
            )
        if not self._hears_speeds:
            return along_mps
        return -speed_mps if along_mps < -_BACKWARDS_MPS else speed_mps

    def _speed_mps(self, stamp_ns: int, velocity: tuple[float, float] | None) -> float:
        """Return the speed at a fix, as it is stated or by the places."""
        if not self._hears_speeds:
            if velocity is None:
                raise Unusable("speed: unknown at the first fix, and the first after a pause")
            return math.hypot(*velocity)
        speed = self._speed
        self._near("velocity", None if speed is None else speed.stamp_ns, stamp_ns)
        return 0.0 if speed is None else speed.speed_mps

    def _check_jump(self, speed_mps: float) -> None:
        """Raise Unusable where the heading has jumped on the way, which would read as reversing."""
        self._drives = abs(speed_mps) > _TELLS_COURSE_MPS
        if not self._drives:
            self._jumped_rad = 0.0
        if self._jumped_rad:
            raise Unusable(
                f"heading: it jumped by {math.degrees(self._jumped_rad):+.0f} degrees while the "
                f"vehicle drives, {speed_mps:.1f} m/s; it counts again when it is back, or below "
                f"{_TELLS_COURSE_MPS:g} m/s"
            )

    def _by_places(self, stamp_ns: int, x_m: float, y_m: float) -> tuple[float, float] | None:
        """Return velocity in the site's frame by differences; None at first and after a pause."""
        last, self._last = self._last, (stamp_ns, x_m, y_m)
        before, self._velocity = self._velocity, None
        if last is None or not 0 < stamp_ns - last[0] <= seconds_to_ns(MAX_PAUSE_S):
            return None
        dt_s = ns_to_seconds(stamp_ns - last[0])
        dx, dy = x_m - last[1], y_m - last[2]
        vx, vy = before or (dx / dt_s, dy / dt_s)
        self._velocity = smoothed_rate(vx, dx, dt_s), smoothed_rate(vy, dy, dt_s)
        return self._velocity
