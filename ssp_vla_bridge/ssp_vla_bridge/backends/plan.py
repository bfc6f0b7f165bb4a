"""Trajectories of simple motions, as the native array that the adapter ``waypoints`` reads."""

from __future__ import annotations

import math

from ssp_vla_bridge.core.adapters.waypoints import ARRAY_NAME, FRAME
from ssp_vla_bridge.core.response import NativeArray
from ssp_vla_bridge.core.task import DrivingTask

# The thresholds of METHOD 6.6.
STOPPED_MPS = 0.5
TREND_MPS2 = 0.5
SIDEWAYS_M = 0.3


def point_times(task: DrivingTask) -> tuple[float, ...]:
    """0, step, 2 step, … up to the task's horizon, s."""
    count = math.floor(task.trajectory_horizon_s / task.trajectory_step_s + 1e-9)
    return tuple(index * task.trajectory_step_s for index in range(count + 1))


def circle_point(distance_m: float, curvature_per_m: float) -> tuple[float, float]:
    """Where a path of constant curvature has come to: x = sin(κs)/κ, y = (1 − cos κs)/κ, m."""
    turn = distance_m * curvature_per_m
    if abs(turn) < 1e-9:
        return distance_m, distance_m * turn / 2.0
    return math.sin(turn) / curvature_per_m, (1.0 - math.cos(turn)) / curvature_per_m


def travelled_m(time_s: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Distance after a time at constant acceleration; a braking vehicle stays where it stops."""
    if acceleration_mps2 < 0.0:
        time_s = min(time_s, max(0.0, speed_mps) / -acceleration_mps2)
    return speed_mps * time_s + acceleration_mps2 * time_s**2 / 2.0


def waypoints(points: list[tuple[float, float]], task: DrivingTask) -> NativeArray:
    """Positions (x_m, y_m) at the task's point times, the first one at t = 0."""
    return NativeArray(
        name=ARRAY_NAME,
        shape=(len(points), 2),
        data=tuple(value for point in points for value in point),
        frame=FRAME,
        unit="m",
        step_s=task.trajectory_step_s,
        first_time_s=0.0,
    )
