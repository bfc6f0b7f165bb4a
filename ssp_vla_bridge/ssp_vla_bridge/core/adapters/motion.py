"""From speeds and curvatures to positions, in the ego frame: x forward, y to the left."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_vla_bridge.core.trajectory import Trajectory


def arcs(speeds_mps: Sequence[float], curvatures_pm: Sequence[float], step_s: float) -> Trajectory:
    """Each pair holds for one step: a circular arc of length d = v Δt that turns by κ d.

    With θ_0 = 0 and c = sin(κ d / 2) / (κ d / 2), which is 1 for a straight step:
    x_k = x_(k−1) + d c cos(θ_(k−1) + κ d / 2), y_k = y_(k−1) + d c sin(θ_(k−1) + κ d / 2),
    θ_k = θ_(k−1) + κ d. The points lie at 0, Δt, 2 Δt, …, the first one is the origin.
    Numbers that are too large give points that aren't finite; check_trajectory tells.

    Args:
        speeds_mps: of the steps, m/s.
        curvatures_pm: of the steps, 1/m, + is left.
        step_s: Δt, s.
    """
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for speed_mps, curvature_pm in zip(speeds_mps, curvatures_pm, strict=True):
        length_m = speed_mps * step_s
        half_rad = curvature_pm * length_m / 2
        chord_m = length_m * (sine(half_rad) / half_rad if abs(half_rad) > 1e-9 else 1.0)
        xs.append(xs[-1] + chord_m * cosine(heading_rad + half_rad))
        ys.append(ys[-1] + chord_m * sine(heading_rad + half_rad))
        heading_rad += 2 * half_rad
    return at_steps(xs, ys, step_s)


def at_steps(xs_m: Sequence[float], ys_m: Sequence[float], step_s: float) -> Trajectory:
    """Points at 0, Δt, 2 Δt, …

    Args:
        xs_m: forward, m.
        ys_m: to the left, m.
        step_s: Δt, s.
    """
    times = tuple(k * step_s for k in range(len(xs_m)))
    return Trajectory(times, tuple(xs_m), tuple(ys_m))


def sine(angle_rad: float) -> float:
    """The sine; NaN of an angle that isn't finite, where math.sin raises."""
    return math.sin(angle_rad) if math.isfinite(angle_rad) else math.nan


def cosine(angle_rad: float) -> float:
    """The cosine; NaN of an angle that isn't finite, where math.cos raises."""
    return math.cos(angle_rad) if math.isfinite(angle_rad) else math.nan
