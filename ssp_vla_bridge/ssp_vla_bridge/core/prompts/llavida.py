"""LLaViDA's one step: reasoning, actions, and a 3-second trajectory (1999Lyd/LLaViDA).

Its repository has the form of the answers (convert2pkl.py) and not the questions of its training,
so these words are ours; x is lateral, to the right, and y is forward, as in its answers.
"""

from __future__ import annotations

from collections.abc import Mapping

from ssp_vla_bridge.core.native_history import LLAVIDA_POINTS, STEP_S, llavida_history
from ssp_vla_bridge.core.prompts.shared import (
    UNKNOWN_PAST,
    actions_sentence,
    critical_sentence,
    frames_sentence,
    native_demand,
    objects_sentence,
    paragraphs,
    placeholders,
)
from ssp_vla_bridge.core.prompts.types import Prompt, Stage
from ssp_vla_bridge.core.request import Request


def _answer(request: Request, _: Mapping[str, str]) -> Prompt:
    history = llavida_history(request)
    count = len(history.rows)
    past = UNKNOWN_PAST
    if count:
        past = (
            f"Your vehicle's last {count} positions, {STEP_S:g} s apart, oldest first, are "
            f"{history.points_text}; it is at (0.00,0.00) now, and its speed is "
            f"{request.history[-1].speed_mps:.2f} m/s."
        )
    task = request.task
    text = paragraphs(
        frames_sentence(request),
        task.instruction,
        objects_sentence(task),
        critical_sentence(task),
        actions_sentence(task),
        "Positions are (x,y) in metres, seen from your vehicle: x is lateral, positive to the "
        "right and negative to the left; y is forward.",
        past,
        native_demand(task, "llavida", LLAVIDA_POINTS, STEP_S),
        "Reason first, in plain English text. End with one line in the form",
        f"{LLAVIDA_POINTS * STEP_S:g}-second trajectory: "
        f"[{placeholders('(x{i},y{i})', LLAVIDA_POINTS)}]",
        f"whose first point is {STEP_S:g} s from now.",
    )
    return Prompt(text)


LLAVIDA = (Stage("motion", _answer),)
