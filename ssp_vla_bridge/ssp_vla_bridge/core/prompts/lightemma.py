"""LightEMMA's three steps: scene, intent, motion (michigan-traffic-lab/LightEMMA, predict.py).

As there, intent and motion are given the scene and the history as a list of speeds and one of
curvatures, and no step is given the answer before.
"""

from __future__ import annotations

from collections.abc import Mapping

from ssp_vla_bridge.core.native_history import LIGHTEMMA_PAIRS, STEP_S, lightemma_history
from ssp_vla_bridge.core.prompts.shared import (
    UNKNOWN_PAST,
    actions_sentence,
    critical_sentence,
    frames_sentence,
    native_demand,
    objects_sentence,
    paragraphs,
    placeholders,
    whole_task,
)
from ssp_vla_bridge.core.prompts.types import Prompt, Stage
from ssp_vla_bridge.core.request import Request

_PARAGRAPH = (
    "Answer this step only, with one paragraph of plain English text without any formatting."
)


def _scene(request: Request, _: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        "This step: observe how vehicles and pedestrians move, the lane markings, the traffic "
        "lights and whatever else matters. Describe what you see, and don't say yet what your "
        "vehicle does.",
        objects_sentence(request.task),
        critical_sentence(request.task),
        _PARAGRAPH,
    )
    return Prompt(text)


def _past(request: Request) -> str:
    history = lightemma_history(request)
    count = len(history.rows)
    if not count:
        return UNKNOWN_PAST
    return (
        f"Your vehicle's last {count} speeds, {STEP_S:g} s apart, the most recent one last, are "
        f"{history.column_text(0)} m/s. Its curvatures at these times are "
        f"{history.column_text(1)} 1/m; positive is a left turn, negative a right turn."
    )


def _intent(request: Request, before: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        f"The scene was described as: {before['scene']}",
        _past(request),
        "This step: say what your vehicle was doing until now, and then how it should drive in "
        f"the next {LIGHTEMMA_PAIRS * STEP_S:g} s: whether it accelerates, decelerates or keeps "
        "its speed, and whether it turns left, turns right or follows the lane, each by how much.",
        actions_sentence(request.task),
        _PARAGRAPH,
    )
    return Prompt(text)


def _motion(request: Request, before: Mapping[str, str]) -> Prompt:
    demand = native_demand(request.task, "lightemma", LIGHTEMMA_PAIRS, STEP_S)
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        f"The scene was described as: {before['scene']}",
        _past(request),
        f"You have decided to drive like this: {before['intent']}",
        f"This step: predict speed (m/s) and curvature (1/m, positive to the left). {demand} "
        "Their changes must be such that a vehicle can make them.",
        f"Answer with exactly {LIGHTEMMA_PAIRS} pairs in the form "
        f"[{placeholders('(v{i}, c{i})', LIGHTEMMA_PAIRS)}] and nothing else.",
    )
    return Prompt(text)


LIGHTEMMA = (Stage("scene", _scene), Stage("intent", _intent), Stage("motion", _motion))
