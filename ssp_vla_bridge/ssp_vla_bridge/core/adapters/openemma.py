"""The adapter ``openemma``: ten pairs [v, k] in the units of OpenEMMA's own prompt.

A native v is the distance per step of 0.5 s in metres, half the speed in m/s, and k is the
curvature in hundredths of 1/m, + is left.
"""

from __future__ import annotations

from collections.abc import Sequence

from ssp_vla_bridge.core.adapters.answer import Form, Rows
from ssp_vla_bridge.core.adapters.motion import arcs, at_steps, cosine, sine
from ssp_vla_bridge.core.adapters.pairs import COLUMNS, UNITS, adapt_pairs
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo
from ssp_vla_bridge.core.native_history import (
    CURVATURE_SCALE,
    OPENEMMA_PAIRS,
    STEP_S,
    openemma_history,
)
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.trajectory import Trajectory

CORRECTED, NATIVE = "corrected", "native"

_FORM = Form(OPENEMMA_PAIRS, COLUMNS, UNITS | {"m", "m/step"}, usual=frozenset({"square brackets"}))


def adapt_openemma(
    response: Response, request: Request | None = None, mode: str = CORRECTED
) -> Adapted:
    """Reads the pairs of the motion stage, or of the whole text where no stage is named.

    ``corrected``: speed v / 0.5 s and curvature k / 100 hold for one step of 0.5 s each
    (motion.arcs), so that n pairs give points at 0, 0.5, …, n · 0.5 s, the first one the origin.
    ``native``: OpenEMMA's own integration (published_points).

    Args:
        response: raw.
        request: that it answers, by which the echo of its history is known.
        mode: ``corrected`` or ``native``.
    """
    history = None if request is None else openemma_history(request).rows
    integrate = _published if mode == NATIVE else _corrected
    return adapt_pairs(response, history, AdapterInfo("openemma", mode), _FORM, integrate)


def _corrected(pairs: Rows) -> Trajectory:
    return arcs([v / STEP_S for v, _ in pairs], [k / CURVATURE_SCALE for _, k in pairs], STEP_S)


def _published(pairs: Rows) -> Trajectory:
    return published_points([v for v, _ in pairs], [k / CURVATURE_SCALE for _, k in pairs])


def published_points(steps_m: Sequence[float], curvatures_pm: Sequence[float]) -> Trajectory:
    """OpenEMMA's own integration with its faults, so that its published numbers can be met.

    n pairs give n points. Its time runs from 0 to n in n points, so that a step is n / (n − 1),
    10/9 for ten; heading and position are trapezoidal sums over that time of κ v, v cos θ and
    v sin θ. Point 0 is the present position. Point i stands at i · 0.5 s here; OpenEMMA's
    evaluation compares it with the true position of (i + 1) · 0.5 s. At a steady 10 m/s the mean
    distance is 2.5 m either way.

    Args:
        steps_m: native v, m per step.
        curvatures_pm: 1/m, + is left.
    """
    count = len(steps_m)
    stretch = count / (count - 1) if count > 1 else 0.0
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for i in range(1, count):
        turns = (curvatures_pm[i - 1] * steps_m[i - 1], curvatures_pm[i] * steps_m[i])
        before_rad, heading_rad = heading_rad, heading_rad + stretch * (turns[0] + turns[1]) / 2
        along = steps_m[i - 1] * cosine(before_rad) + steps_m[i] * cosine(heading_rad)
        across = steps_m[i - 1] * sine(before_rad) + steps_m[i] * sine(heading_rad)
        xs.append(xs[-1] + stretch * along / 2)
        ys.append(ys[-1] + stretch * across / 2)
    return at_steps(xs, ys, STEP_S)
