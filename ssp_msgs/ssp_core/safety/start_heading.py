"""The heading of an object whose source knows none at rest, judged on its first metre.

A single antenna gives the course over ground: while the object stands, its heading is
unknown. It starts on a person's word that it faces as its start does, and its way's first metre
shows it. Reads no clock.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import LEAST_WAY_M, Bounds
from ssp_core.safety.limits import LimitViolation
from ssp_core.safety.samples import SIGMAS

UNKNOWN_AT_REST = (
    "its heading is not known at rest (limits.heading_by_course): judged on its first metre"
)


def start_heading(one: ParticipantSpec, limits: Limits) -> StartHeading | None:
    """Give the watch of a participant that the site lists in ``heading_by_course``, else None."""
    if one.id not in limits.heading_by_course:
        return None
    bounds = Bounds.of(one.id, one.cls, limits)
    return StartHeading(bounds, one.start.yaw_rad, limits.start_yaw_rad)


class StartHeading:
    """The way that an object goes from where it stood, held against its start's heading.

    The way is judged once, as soon as it is LEAST_WAY_M long and longer than its places are
    uncertain. By the sign of its speed an object may go backwards; a person may anyhow.

    Args:
        yaw_rad: of the start.
        tolerance_rad: of the heading at the start; a wider bound of the direction counts instead.
    """

    def __init__(self, bounds: Bounds, yaw_rad: float, tolerance_rad: float) -> None:
        self._bounds = bounds
        self._yaw_rad = yaw_rad
        self._tolerance_rad = max(tolerance_rad, bounds.direction_rad or 0.0)
        self.clear()

    def clear(self) -> None:
        """Wait for the next first metre."""
        self._is_over = self._bounds.direction_rad is None
        self._rest_state: ObjectState | None = None
        self._before: ObjectState | None = None
        self._longest: tuple[float, float] = (0.0, 0.0)
        self._may_step = True

    def see(self, state: ObjectState, *, stands: bool) -> LimitViolation | None:
        """Judge a state by where the object stood.

        Args:
            state: with finite values; an older one has no effect.
            stands: by its speed and by its places.
        """
        before, rest_state = self._before, self._rest_state
        if self._is_over or (before is not None and state.stamp_ns <= before.stamp_ns):
            return None
        self._before = state
        if stands or rest_state is None or before is None:
            self._rest_state, self._longest = state, (0.0, 0.0)
            return None
        step = state.x_m - before.x_m, state.y_m - before.y_m
        self._longest = max(step, self._longest, key=lambda way: math.hypot(*way))
        return self._judge(rest_state, state)

    def _judge(self, rest_state: ObjectState, state: ObjectState) -> LimitViolation | None:
        x_m, y_m = state.x_m - rest_state.x_m, state.y_m - rest_state.y_m
        way_m = math.hypot(x_m, y_m)
        uncertain_m = max(self._uncertain_m(rest_state), self._uncertain_m(state))
        if way_m < LEAST_WAY_M or way_m <= uncertain_m:
            return None
        bound_rad = max(self._tolerance_rad, math.atan2(uncertain_m, way_m))
        turned_rad = self._deviation_rad(math.atan2(y_m, x_m), state.speed_mps)
        if abs(turned_rad) <= bound_rad:
            self._is_over = True
            return None
        if self._may_step and math.hypot(*self._longest) <= self._bounds.jump_m:
            # One correction of a receiver is no way.
            x_m, y_m = rest_state.x_m + self._longest[0], rest_state.y_m + self._longest[1]
            self._rest_state = replace(rest_state, x_m=x_m, y_m=y_m)
            self._longest, self._may_step = (0.0, 0.0), False
            return None
        self._is_over = True
        text = (
            f"its first {way_m:.2f} m lead {math.degrees(turned_rad):+.0f}° off its start's "
            f"heading, limit {math.degrees(bound_rad):.0f}°"
        )
        moved_s = ns_to_seconds(state.stamp_ns - rest_state.stamp_ns)
        return LimitViolation(SafetyCode.STATE_CONTRADICTS, moved_s, 0.0, text)

    def _uncertain_m(self, state: ObjectState) -> float:
        std_m, most_m = state.position_std_m, self._bounds.position_std_m
        return SIGMAS * (std_m if std_m <= most_m else most_m)

    def _deviation_rad(self, course_rad: float, speed_mps: float) -> float:
        turned = wrap_angle(course_rad - self._yaw_rad)
        if self._bounds.signed:
            return wrap_angle(turned + math.pi) if speed_mps < 0.0 else turned
        return math.remainder(turned, math.pi)
