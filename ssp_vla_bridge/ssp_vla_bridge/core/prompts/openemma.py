"""OpenEMMA's four steps: scene, critical objects, intent, motion (taco-group/OpenEMMA, main.py).

As there, every step sees the frames, the intent is given the one before it, and the motion step
is given the three texts and the history as ``[v, k]`` pairs. Unlike there, the units are said, the
times of the frames are those of the request, and nothing is asked again because of what it says.
"""

from __future__ import annotations

from collections.abc import Mapping

from ssp_core.clock import ns_to_seconds
from ssp_vla_bridge.core.native_history import (
    CURVATURE_SCALE,
    OPENEMMA_PAIRS,
    STEP_S,
    openemma_history,
)
from ssp_vla_bridge.core.previous import previous_stage
from ssp_vla_bridge.core.prompts.shared import (
    PLAIN,
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


def _scene(request: Request, _: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        "This step: as the driver, describe the scene: traffic lights, what other vehicles and "
        "pedestrians do, lane markings.",
        objects_sentence(request.task),
        PLAIN,
    )
    return Prompt(text)


def _objects(request: Request, _: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        "This step: name the two or three road users that you must watch most. For each say where "
        "in the picture it is, what it is doing, and why it matters to you.",
        objects_sentence(request.task),
        critical_sentence(request.task),
        PLAIN,
    )
    return Prompt(text)


def _intent(request: Request, _: Mapping[str, str]) -> Prompt:
    previous = previous_stage(request, "intent")
    if previous is None:
        ask = (
            "This step: from the lane markings and from what other road users do, say what you "
            "intend: to follow the lane straight on, to turn left or to turn right; and to keep "
            "your speed, to slow down or to speed up."
        )
    else:
        ago_s = ns_to_seconds(request.stamp_ns - previous.stamp_ns)
        ask = (
            f"This step: {ago_s:.1f} s ago your intent was:\n{previous.text}\nFrom the lane "
            "markings and from what other road users do now, say whether you keep this intent or "
            "change it, and explain your present one."
        )
    text = paragraphs(
        frames_sentence(request), whole_task(request.task), ask,
        actions_sentence(request.task), PLAIN,
    )  # fmt: skip
    return Prompt(text)


_MOTION_SYSTEM = (
    "You drive a vehicle and predict its motion. You have its front camera's picture, its past "
    "speeds and curvatures and a rationale. Each pair is [v, k]: v is the distance in metres that "
    f"is covered in a step of {STEP_S:g} s; k is the curvature in 1/m times {CURVATURE_SCALE:g}, "
    "positive in a left turn, negative in a right turn, near zero when driving straight on, and "
    "the larger the sharper the turn. Obey the rules of traffic, keep to the middle of your lane "
    "and keep your distance from the vehicle ahead."
)


def _motion(request: Request, before: Mapping[str, str]) -> Prompt:
    history = openemma_history(request)
    count = len(history.rows)
    past = (
        f"The last {count} pairs of your vehicle, {STEP_S:g} s apart, oldest first, are "
        f"{history.pairs_text}."
        if count
        else UNKNOWN_PAST
    )
    demand = native_demand(request.task, "openemma", OPENEMMA_PAIRS, STEP_S)
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        f"The scene was described as: {before['scene']}",
        f"The critical road users are: {before['objects']}",
        f"Your intent is: {before['intent']}",
        past,
        "This step: find how these numbers go with the pictures, and predict your future speeds "
        f"and curvatures. {demand}",
        f"Answer with {OPENEMMA_PAIRS} pairs in the form "
        f"{placeholders('[speed_{i}, curvature_{i}]', OPENEMMA_PAIRS)}, as raw text without "
        "markdown or LaTeX. Future speeds and curvatures:",
    )
    return Prompt(text, _MOTION_SYSTEM)


OPENEMMA = (
    Stage("scene", _scene),
    Stage("objects", _objects),
    Stage("intent", _intent),
    Stage("motion", _motion),
)
