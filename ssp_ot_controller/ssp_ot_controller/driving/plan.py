"""A driver's trajectory as a reference in the map frame, or why it is refused (METHOD 8.4).

The reference is a shape-preserving cubic (PCHIP) through x(t) and y(t), sampled at the session's
step. Behind the plan's last point it goes on along the last direction and decelerates to a
standstill: that part is the fallback.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import FloatArray, Pose2, wrap_angles
from ssp_core.motion.reference import PLAN, Points, Reference
from ssp_core.motion.trajectory import TOLERANCE_S, Trajectory, check_trajectory


@dataclass(frozen=True, slots=True)
class PlanLimits:
    """Limits of METHOD 8.4; ours, and on the card of each campaign.

    Args:
        least_end_s: a plan reaches at least so far behind its frame.
        start_m: from the pose at its frame to where it begins.
        back_m: by which it may go back in all against its own heading.
        acceleration_mps2: by central differences of the velocity over ``window_s``.
        held_mps: slower, a tangent says nothing, and the yaw is held.
        fallback_mps2: deceleration without a plan.
        most_points: of one plan.
        longest_s: what a plan says of later isn't used.
    """

    least_end_s: float = 2.0
    start_m: float = 3.0
    back_m: float = 0.2
    acceleration_mps2: float = 12.0
    window_s: float = 0.5
    speed_mps: float = 100.0
    held_mps: float = 0.5
    fallback_mps2: float = 2.0
    most_points: int = 10_000
    longest_s: float = 20.0


PLAN_LIMITS = PlanLimits()


@dataclass(frozen=True, slots=True)
class MapPlan:
    """An accepted plan: the reference with its fallback, and when the plan itself ends.

    Args:
        reference: frame map; its execute_at is the stamp of the frame that it answers.
        end_ns: session time of the plan's last point.
    """

    reference: Reference
    end_ns: int


@dataclass(frozen=True, slots=True)
class _SampledPlan:
    """A plan in the ego frame at the session's steps: values and derivatives, shape (n,)."""

    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    vx_mps: FloatArray
    vy_mps: FloatArray
    ax_mps2: FloatArray
    ay_mps2: FloatArray
    speed_mps: FloatArray


def plan_of(
    trajectory: Trajectory,
    pose: Pose2,
    stamp_ns: int,
    step_s: float,
    reference_id: str,
    event_version: str,
) -> MapPlan | str:
    """Return the plan in the map frame, or why it is refused.

    Args:
        trajectory: as the driver gave it, whatever that is.
        pose: of the VUT at the stamp, as it was reported.
        stamp_ns: of the frame that it answers.
        step_s: of the session.
        reference_id: of the reference.
        event_version: K* version.
    """
    if len(trajectory.t_s) > PLAN_LIMITS.most_points:
        return f"{len(trajectory.t_s)} points, at most {PLAN_LIMITS.most_points}"
    if invalid := check_trajectory(trajectory):
        return f"invalid: {', '.join(invalid)}"
    if trajectory.t_s[-1] < PLAN_LIMITS.least_end_s - TOLERANCE_S:
        least_s = PLAN_LIMITS.least_end_s
        return f"ends {trajectory.t_s[-1]:.3g} s after its frame, at least {least_s:g} s"
    # The difference of two huge numbers may overflow, which the limits below then refuse.
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        try:
            plan = _sampled(trajectory, step_s)
        except ValueError:  # a slope that is no number
            return f"needs more than any number of m/s, at most {PLAN_LIMITS.speed_mps:g} m/s"
        if problem := _problem(plan):
            return problem
    points = _points(plan, pose, step_s)
    reference = Reference(
        reference_id=reference_id,
        object_id="vut",
        event_version=event_version,
        purpose=PLAN,
        dispatched_ns=stamp_ns,
        execute_at_ns=stamp_ns,
        expires_at_ns=stamp_ns + seconds_to_ns(float(points[0, -1])) + 1,
        points=Points(points),
    )
    return MapPlan(reference, stamp_ns + seconds_to_ns(float(plan.t_s[-1])))


def fallback_of(
    pose: Pose2,
    speed_mps: float,
    stamp_ns: int,
    step_s: float,
    event_version: str,
) -> Reference:
    """Return the reference of a VUT that no plan leads: it decelerates straight on.

    Args:
        pose: of the VUT at the stamp.
        speed_mps: of the VUT at the stamp.
        stamp_ns: from when on.
        step_s: of the session.
        event_version: K* version.
    """
    start = np.array([[0.0], [pose.x_m], [pose.y_m], [pose.yaw_rad], [speed_mps], [0.0], [0.0]])
    points = np.hstack([start, _tail(start[:, -1], step_s)])
    points[5, :-1] = -PLAN_LIMITS.fallback_mps2
    end_ns = stamp_ns + seconds_to_ns(float(points[0, -1])) + 1
    return Reference(
        "fallback", "vut", event_version, "fallback", stamp_ns, stamp_ns, end_ns, Points(points)
    )


def _sampled(trajectory: Trajectory, step_s: float) -> _SampledPlan:
    from scipy.interpolate import PchipInterpolator  # type: ignore[import-untyped]  # slow, no types

    t = np.array(trajectory.t_s)
    end_s = min(float(t[-1]), PLAN_LIMITS.longest_s)
    steps: FloatArray = step_s * np.arange(math.floor(end_s / step_s + 1e-6) + 1, dtype=np.float64)
    if end_s - steps[-1] > 1e-6:
        steps = np.append(steps, end_s)
    # The support may begin within the tolerance behind 0 (METHOD 5.4).
    inside = np.clip(steps, t[0], t[-1])
    curve = PchipInterpolator(t, np.array([trajectory.x_m, trajectory.y_m], dtype=np.float64).T)
    curves = curve, curve.derivative(), curve.derivative(2)
    (x, y), (vx, vy), (ax, ay) = (np.ascontiguousarray(one(inside).T) for one in curves)
    return _SampledPlan(steps, x, y, vx, vy, ax, ay, np.hypot(vx, vy))


def _problem(plan: _SampledPlan) -> str:
    """Say which limit a sampled plan passes; empty: none. A value that is no number passes it."""
    begins_m = math.hypot(plan.x_m[0], plan.y_m[0])
    if not begins_m <= PLAN_LIMITS.start_m:
        return f"begins {begins_m:.3g} m from the VUT, at most {PLAN_LIMITS.start_m:g} m"
    fastest = float(plan.speed_mps.max())
    if not fastest <= PLAN_LIMITS.speed_mps:
        return f"needs {fastest:.3g} m/s, at most {PLAN_LIMITS.speed_mps:g} m/s"
    hardest = _acceleration_mps2(plan)
    if not hardest <= PLAN_LIMITS.acceleration_mps2:
        return f"needs {hardest:.3g} m/s^2, at most {PLAN_LIMITS.acceleration_mps2:g} m/s^2"
    back_m = _back_m(plan)
    if not back_m <= PLAN_LIMITS.back_m:
        return f"goes back by {back_m:.3g} m, at most {PLAN_LIMITS.back_m:g} m"
    return ""


def _acceleration_mps2(plan: _SampledPlan) -> float:
    window_s = PLAN_LIMITS.window_s
    half_s = window_s / 2.0
    t = plan.t_s
    middle = t[(t >= half_s - 1e-9) & (t <= t[-1] - half_s + 1e-9)]
    change = [
        np.interp(middle + half_s, t, v) - np.interp(middle - half_s, t, v)
        for v in (plan.vx_mps, plan.vy_mps)
    ]
    return float(np.hypot(*change).max()) / window_s


def _back_m(plan: _SampledPlan) -> float:
    """Return the way against the own heading, which follows the motion within a right angle."""
    step_x, step_y = np.diff(plan.x_m), np.diff(plan.y_m)
    # Steps within 45 degrees of where the VUT looks don't go back: the usual plan.
    if (np.abs(step_y) <= step_x).all():
        return 0.0
    heading_x, heading_y, back = 1.0, 0.0, 0.0
    steps = zip(step_x.tolist(), step_y.tolist(), strict=True)
    for (dx, dy), speed in zip(steps, plan.speed_mps[1:].tolist(), strict=True):
        along = dx * heading_x + dy * heading_y
        way = math.hypot(dx, dy)
        if along < 0.0:
            back -= along
        elif speed >= PLAN_LIMITS.held_mps and way > 0.0:
            heading_x, heading_y = dx / way, dy / way
    return back


def _points(plan: _SampledPlan, pose: Pose2, step_s: float) -> FloatArray:
    speed = plan.speed_mps
    fast = speed >= PLAN_LIMITS.held_mps
    yaw = _forward_fill(np.arctan2(plan.vy_mps, plan.vx_mps), fast)
    along = np.cos(yaw) * plan.vx_mps + np.sin(yaw) * plan.vy_mps
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = (plan.vx_mps * plan.ay_mps2 - plan.vy_mps * plan.ax_mps2) / speed**3
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    rows = np.vstack(
        [
            plan.t_s,
            pose.x_m + c * plan.x_m - s * plan.y_m,
            pose.y_m + s * plan.x_m + c * plan.y_m,
            wrap_angles(yaw + pose.yaw_rad),
            np.maximum(along, 0.0),
            np.cos(yaw) * plan.ax_mps2 + np.sin(yaw) * plan.ay_mps2,
            np.where(fast, turning, 0.0),
        ]
    )
    return np.hstack([rows, _tail(rows[:, -1], step_s)])


def _forward_fill(yaw: FloatArray, is_known: NDArray[np.bool_]) -> FloatArray:
    """Return the angles with unknown ones replaced by the last known one, 0 before the first."""
    last = np.maximum.accumulate(np.where(is_known, np.arange(len(yaw)), -1))
    angles: FloatArray = np.where(last >= 0, yaw[np.maximum(last, 0)], 0.0)
    return angles


def _tail(last: FloatArray, step_s: float) -> FloatArray:
    """Return the points behind a last one, shape (7, n): straight on to a standstill."""
    t0, x0, y0, yaw, speed = (float(v) for v in last[:5])
    stop_s = max(speed / PLAN_LIMITS.fallback_mps2, step_s)
    count = math.ceil(stop_s / step_s - 1e-9)
    t = np.minimum(np.arange(1, count + 1) * step_s, stop_s)
    v = np.maximum(speed - PLAN_LIMITS.fallback_mps2 * t, 0.0)
    way = speed * t - 0.5 * PLAN_LIMITS.fallback_mps2 * t**2 if speed > 0.0 else np.zeros(count)
    way = np.maximum.accumulate(way)
    slows = np.where(v > 0.0, -PLAN_LIMITS.fallback_mps2, 0.0)
    return np.vstack(
        [
            t0 + t,
            x0 + math.cos(yaw) * way,
            y0 + math.sin(yaw) * way,
            np.full(count, yaw),
            v,
            slows,
            np.zeros(count),
        ]
    )
