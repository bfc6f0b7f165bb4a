"""What ``openemma`` and ``lightemma`` share: pairs of speed and curvature in a model's text.

Which list of the text is the answer says answer.py. The text is the only native output of these
systems; arrays of a response are not looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from ssp_vla_bridge.core.adapters.answer import Form, Rows, choose_answer
from ssp_vla_bridge.core.adapters.limit import MOTION, motion_is_cut
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo, without_trajectory
from ssp_vla_bridge.core.previous import stage_text
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.trajectory import Trajectory, check_trajectory

COLUMNS = (
    frozenset({"v", "speed", "velocity", "vel"}),
    frozenset({"k", "c", "curvature", "curv", "kappa", "κ"}),
)
UNITS = frozenset({"m/s", "mps", "1/m", "m^-1", "m⁻¹", "rad/m"})

# No car on tyres turns harder; more tells of a curvature in another unit.
_MOST_LATERAL_MPS2 = 12.0


def adapt_pairs(
    response: Response,
    history: Rows | None,
    info: AdapterInfo,
    form: Form,
    integrate: Callable[[Rows], Trajectory],
) -> Adapted:
    """Text and trajectory of an answer in pairs.

    Args:
        response: raw.
        history: as the prompt printed it, None when the request isn't at hand.
        info: name and mode of the adapter.
        form: of the list that is asked for.
        integrate: pairs to positions.
    """
    if response.error_code:
        return without_trajectory(response, info, "missing")
    motion, stage_notes = motion_text(response)
    choice = choose_answer(motion, form, history, motion_is_cut(response))
    info = replace(info, notes=(*stage_notes, *choice.notes))
    if choice.reason:
        return Adapted(response.text, None, (choice.reason,), info)
    trajectory = integrate(choice.rows)
    invalid = check_trajectory(trajectory)
    if invalid:
        return Adapted(response.text, None, invalid, info)
    if _most_lateral_mps2(trajectory) > _MOST_LATERAL_MPS2:
        note = f"it turns with more than {_MOST_LATERAL_MPS2:g} m/s² to the side"
        info = replace(info, notes=(*info.notes, note))
    return Adapted(response.text, trajectory, (), info)


def motion_text(response: Response) -> tuple[str, tuple[str, ...]]:
    """The motion stage's text of a staged answer, the whole text of another; with notes.

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
    """The largest change of velocity across the direction of motion, m/s²."""
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
