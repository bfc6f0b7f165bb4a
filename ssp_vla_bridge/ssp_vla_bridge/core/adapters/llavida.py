"""The adapter ``llavida``: six points (x lateral, y forward) in a model's text."""

from __future__ import annotations

from dataclasses import replace

from ssp_vla_bridge.core.adapters.answer import Form, choose_answer
from ssp_vla_bridge.core.adapters.limit import motion_is_cut
from ssp_vla_bridge.core.adapters.points import adapt_points
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo, without_trajectory
from ssp_vla_bridge.core.native_history import LLAVIDA_POINTS, STEP_S, llavida_history
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Response

NATIVE = "lateral_forward"

_FORM = Form(
    LLAVIDA_POINTS,
    (frozenset({"x", "lateral"}), frozenset({"y", "forward", "longitudinal"})),
    frozenset({"m", "meter", "meters", "metre", "metres"}),
    label="trajectory",
    usual=frozenset({"round brackets", "a nested list"}),
)


def adapt_llavida(
    response: Response, request: Request | None = None, mode: str = NATIVE
) -> Adapted:
    """Reads the list behind the label ``… trajectory:``, points at 0.5, 1.0, … s.

    A native x is lateral, negative to the left, and a native y is forward: (X, Y) = (y, −x). The
    origin is added. LLaViDA's own parser pads a short list with its last point and makes six
    points (0, 0) of one that it can't read; here a short list stays short, and one that can't be
    read is no trajectory. A line of meta-actions stays in the text.

    Args:
        response: raw.
        request: that it answers, by which the echo of its history is known.
        mode: there is one.
    """
    info = AdapterInfo("llavida", mode)
    if response.error_code:
        return without_trajectory(response, info, "missing")
    history = None if request is None else llavida_history(request).rows
    choice = choose_answer(response.text, _FORM, history, motion_is_cut(response))
    info = replace(info, notes=choice.notes)
    if choice.reason:
        return Adapted(response.text, None, (choice.reason,), info)
    lateral, forward = zip(*choice.rows, strict=True)
    # 0.0 − x instead of −x, which would make a negative zero of straight ahead.
    ys = [0.0 - x for x in lateral]
    return adapt_points(response, info, forward, ys, STEP_S, STEP_S)
