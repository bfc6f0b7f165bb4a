"""The adapter ``lightemma``: six pairs (v, c), v in m/s and c in 1/m, + is left, 0.5 s each."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_vla_bridge.core.adapters.answer import Form, Rows
from ssp_vla_bridge.core.adapters.motion import arcs, at_steps, cosine, sine
from ssp_vla_bridge.core.adapters.pairs import COLUMNS, UNITS, adapt_pairs
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo
from ssp_vla_bridge.core.native_history import LIGHTEMMA_PAIRS, STEP_S, lightemma_history
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.trajectory import Trajectory

CORRECTED, NATIVE = "corrected", "native"

_FORM = Form(LIGHTEMMA_PAIRS, COLUMNS, UNITS, usual=frozenset({"round brackets", "a nested list"}))


def adapt_lightemma(
    response: Response, request: Request | None = None, mode: str = NATIVE
) -> Adapted:
    """Reads the pairs of the motion stage, or of the whole text where no stage is named.

    ``native``: LightEMMA's own integration (straight_steps). ``corrected``: motion.arcs, whose
    heading doesn't lag half a step behind in a curve. Both give points at 0, 0.5, …, n · 0.5 s.

    Args:
        response: raw.
        request: that it answers, by which the echo of its history is known.
        mode: ``native`` or ``corrected``.
    """
    history = None if request is None else lightemma_history(request).rows
    integrate = _corrected if mode == CORRECTED else _native
    return adapt_pairs(response, history, AdapterInfo("lightemma", mode), _FORM, integrate)


def _native(pairs: Rows) -> Trajectory:
    return straight_steps([v for v, _ in pairs], [c for _, c in pairs], STEP_S)


def _corrected(pairs: Rows) -> Trajectory:
    return arcs([v for v, _ in pairs], [c for _, c in pairs], STEP_S)


def straight_steps(
    speeds_mps: Sequence[float], curvatures_pm: Sequence[float], step_s: float
) -> Trajectory:
    """LightEMMA's own integration: each step is straight, and the heading turns behind it.

    x_k = x_(k−1) + v Δt cos θ_(k−1), y_k = y_(k−1) + v Δt sin θ_(k−1), θ_k = θ_(k−1) + κ v Δt. The
    points lie at 0, Δt, 2 Δt, …, the first one is the origin, which LightEMMA leaves out of its
    result.

    Args:
        speeds_mps: of the steps, m/s.
        curvatures_pm: of the steps, 1/m, + is left.
        step_s: Δt, s.
    """
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for speed_mps, curvature_pm in zip(speeds_mps, curvatures_pm, strict=True):
        length_m = speed_mps * step_s
        xs.append(xs[-1] + length_m * cosine(heading_rad))
        ys.append(ys[-1] + length_m * sine(heading_rad))
        heading_rad += curvature_pm * length_m
    return at_steps(xs, ys, step_s)
