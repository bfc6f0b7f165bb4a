"""OpenEMMA and LightEMMA: pairs of speed and curvature."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

from ssp_vla_bridge.adapters.adapted import (
    MOTION,
    AdaptedResponse,
    AdapterInfo,
    arcs,
    at_steps,
    cosine,
    motion_is_cut,
    sine,
    without_trajectory,
)
from ssp_vla_bridge.adapters.answer import Form, choose_answer
from ssp_vla_bridge.adapters.stated import PAIRS, Meaning, Rows
from ssp_vla_bridge.messages import Request, Response
from ssp_vla_bridge.native_history import (
    CURVATURE_SCALE,
    LIGHTEMMA_PAIRS,
    OPENEMMA_PAIRS,
    STEP_S,
    lightemma_history,
    openemma_history,
    stage_text,
)
from ssp_vla_bridge.trajectory import TOLERANCE_S, Trajectory, check_trajectory

UNITS = frozenset({"m/s", "mps", "1/m", "m^-1", "m⁻¹", "rad/m"})

# No car on tyres turns harder; more tells of a curvature in another unit.
_MOST_LATERAL_MPS2 = 12.0


def adapt_pairs(
    response: Response,
    history: Rows | None,
    info: AdapterInfo,
    form: Form,
    integrate: Callable[[Rows], Trajectory],
) -> AdaptedResponse:
    """Return text and trajectory of an answer in pairs.

    Args:
        response: as it came.
        history: rows as the prompt printed them, None when the request isn't at hand.
        info: the adapter's name and mode; notes are added.
        form: of the list that the interface asks for.
        integrate: makes the trajectory of the list's rows.
    """
    if response.error_code:
        return without_trajectory(response, info, "missing")
    motion, stage_notes = motion_text(response)
    choice = choose_answer(motion, form, history, motion_is_cut(response))
    info = replace(info, notes=(*stage_notes, *choice.notes))
    if choice.reason:
        return AdaptedResponse(response.text, None, (choice.reason,), info)
    if choice.times_s and not _is_raster(choice.times_s):
        info = replace(info, notes=(*info.notes, f"its times aren't steps of {STEP_S:g} s"))
        return AdaptedResponse(response.text, None, ("timestamps",), info)
    trajectory = integrate(choice.rows)
    invalid = check_trajectory(trajectory)
    if invalid:
        return AdaptedResponse(response.text, None, invalid, info)
    if _most_lateral_mps2(trajectory) > _MOST_LATERAL_MPS2:
        note = f"it turns with more than {_MOST_LATERAL_MPS2:g} m/s² to the side"
        info = replace(info, notes=(*info.notes, note))
    return AdaptedResponse(response.text, trajectory, (), info)


def _is_raster(times_s: tuple[float, ...]) -> bool:
    """Tell whether stated times are those of the interface, from t = 0 or one step after it."""
    first = times_s[0]
    return first in (0.0, STEP_S) and all(
        abs(time - first - k * STEP_S) <= TOLERANCE_S for k, time in enumerate(times_s)
    )


def motion_text(response: Response) -> tuple[str, tuple[str, ...]]:
    """Return the motion stage's text of a staged answer, the whole text of another; with notes.

    Args:
        response: whose ``decoding["stages"]`` may name spans of its text.
    """
    if response.decoding.get("stages") is None:
        return response.text, ()
    text = stage_text(response, MOTION)
    if text is not None:
        return text, ()
    return response.text, ("no span of the motion stage is given, so the whole text was read",)


def _most_lateral_mps2(trajectory: Trajectory) -> float:
    """Return the largest change of velocity across the direction of motion, m/s²."""
    times, xs, ys = trajectory.t_s, trajectory.x_m, trajectory.y_m
    most = 0.0
    for i in range(1, len(times) - 1):
        into = (xs[i] - xs[i - 1], ys[i] - ys[i - 1])
        out = (xs[i + 1] - xs[i], ys[i + 1] - ys[i])
        length_m = math.hypot(*into)
        if length_m > 0:
            across_m = abs(into[0] * out[1] - into[1] * out[0]) / length_m
            most = max(most, across_m / (times[i + 1] - times[i]) ** 2)
    return most


CORRECTED, NATIVE = "corrected", "native"

_OPENEMMA_FORM = Form(
    OPENEMMA_PAIRS,
    Meaning(PAIRS.columns, STEP_S, CURVATURE_SCALE),
    frozenset({"m", "m/step"}),
    usual=frozenset({"square brackets"}),
)


def adapt_openemma(
    response: Response, request: Request | None = None, mode: str = CORRECTED
) -> AdaptedResponse:
    """Read the pairs of the motion stage, or of the whole text where no stage is named.

    ``corrected``: speed v / 0.5 s and curvature k / 100 hold for one step of 0.5 s each (arcs), so
    that n pairs give points at 0, 0.5, …, n · 0.5 s, the first one the origin. ``native``:
    OpenEMMA's own integration (published_points).
    """
    history = None if request is None else openemma_history(request).rows
    integrate = published_points if mode == NATIVE else _openemma_arcs
    return adapt_pairs(response, history, AdapterInfo("openemma", mode), _OPENEMMA_FORM, integrate)


def _openemma_arcs(pairs: Rows) -> Trajectory:
    return arcs(((v / STEP_S, k / CURVATURE_SCALE) for v, k in pairs), STEP_S)


def published_points(pairs: Rows) -> Trajectory:
    """Integrate as OpenEMMA does, faults included, so that its published numbers can be met.

    n pairs give n points. Its time runs from 0 to n in n points, so that a step is n / (n − 1),
    10/9 for ten; heading and position are trapezoidal sums over that time of κ v, v cos θ and
    v sin θ. Point 0 is the present position. Point i stands at i · 0.5 s here; OpenEMMA's
    evaluation compares it with the true position of (i + 1) · 0.5 s. At a steady 10 m/s the mean
    distance is 2.5 m either way.
    """
    count = len(pairs)
    stretch = count / (count - 1) if count > 1 else 0.0
    steps = [(v, k / CURVATURE_SCALE) for v, k in pairs]
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for (v0, k0), (v1, k1) in pairwise(steps):
        before_rad, heading_rad = heading_rad, heading_rad + stretch * (k0 * v0 + k1 * v1) / 2
        along = v0 * cosine(before_rad) + v1 * cosine(heading_rad)
        across = v0 * sine(before_rad) + v1 * sine(heading_rad)
        xs.append(xs[-1] + stretch * along / 2)
        ys.append(ys[-1] + stretch * across / 2)
    return at_steps(xs, ys, STEP_S)


_LIGHTEMMA_FORM = Form(
    LIGHTEMMA_PAIRS, PAIRS, UNITS, usual=frozenset({"round brackets", "a nested list"})
)


def adapt_lightemma(
    response: Response, request: Request | None = None, mode: str = NATIVE
) -> AdaptedResponse:
    """Read the pairs of the motion stage, or of the whole text where no stage is named.

    ``native``: LightEMMA's own integration (straight_steps). ``corrected``: arcs, whose heading
    doesn't lag half a step behind in a curve. Both give points at 0, 0.5, …, n · 0.5 s.
    """
    history = None if request is None else lightemma_history(request).rows
    integrate = _lightemma_arcs if mode == CORRECTED else straight_steps
    info = AdapterInfo("lightemma", mode)
    return adapt_pairs(response, history, info, _LIGHTEMMA_FORM, integrate)


def _lightemma_arcs(pairs: Rows) -> Trajectory:
    return arcs(((v, c) for v, c in pairs), STEP_S)


def straight_steps(pairs: Rows) -> Trajectory:
    """Integrate as LightEMMA does: each step is straight, and the heading turns behind it.

    x_k = x_(k−1) + v Δt cos θ_(k−1), y_k = y_(k−1) + v Δt sin θ_(k−1), θ_k = θ_(k−1) + κ v Δt. The
    points lie at 0, Δt, 2 Δt, …, the first one is the origin, which LightEMMA leaves out of its
    result.
    """
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for speed_mps, curvature_pm in pairs:
        length_m = speed_mps * STEP_S
        xs.append(xs[-1] + length_m * cosine(heading_rad))
        ys.append(ys[-1] + length_m * sine(heading_rad))
        heading_rad += curvature_pm * length_m
    return at_steps(xs, ys, STEP_S)
