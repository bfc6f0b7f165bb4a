"""Native prompts of each system, all made from one definition of the driving task."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_vla_bridge.backend import SERVICES, interface_of
from ssp_vla_bridge.messages import DrivingTask, Request
from ssp_vla_bridge.native_history import (
    CURVATURE_SCALE,
    LIGHTEMMA_PAIRS,
    LLAVIDA_POINTS,
    OPENEMMA_PAIRS,
    STEP_S,
    lightemma_history,
    llavida_history,
    openemma_history,
    previous_stage,
)


@dataclass(frozen=True)
class Prompt:
    """The words of one question; the frames go before the text.

    Args:
        system: of the system's message, empty where there is none.
    """

    text: str
    system: str = ""

    @property
    def sha256(self) -> str:
        return sha256_json({"system": self.system, "text": self.text})


@dataclass(frozen=True)
class Stage:
    """One step of an answer.

    Args:
        name: ``scene``, ``objects``, ``intent`` or ``motion``.
        build: the prompt, from the request and the raw texts of the steps before, by name.
            It raises InputError where the interface can't give what the task asks for.
    """

    name: str
    build: Callable[[Request, Mapping[str, str]], Prompt]


UNKNOWN_PAST = (
    "How your vehicle has moved until now is not known; judge by the pictures alone and assume "
    "no numbers."
)
PLAIN = "Answer this step only, in plain English text."
_TOLERANCE = 1e-9


def frames_sentence(request: Request) -> str:
    """How many frames there are, and when each was taken."""
    ages_s = [ns_to_seconds(request.stamp_ns - frame.stamp_ns) for frame in request.frames]
    times = ", ".join(f"{age_s:.2f}" for age_s in ages_s)
    if len(ages_s) == 1:
        return f"The picture was taken by your vehicle's front camera {times} s before now."
    return (
        f"The {len(ages_s)} pictures were taken by your vehicle's front camera {times} s before "
        "now, oldest first."
    )


def whole_task(task: DrivingTask) -> str:
    """The instruction, for a prompt that asks for one step of it only."""
    return f"The whole task, which is done in steps: {task.instruction}"


def objects_sentence(task: DrivingTask) -> str:
    """Which kinds of road users are told apart."""
    return f"Call each road user one of: {_words(task.objects)}."


def critical_sentence(task: DrivingTask) -> str:
    """What is asked about the critical road user, and in which words."""
    return (
        f"Say where the critical one is relative to your vehicle ({_words(task.positions)}), how "
        f"it moves ({_words(task.motions)}) and whether there is a conflict with it "
        f"({_words(task.conflicts)})."
    )


def actions_sentence(task: DrivingTask) -> str:
    """The allowed actions."""
    return (
        f"Your longitudinal action is one of: {_words(task.lon_actions)}. Your lateral action is "
        f"one of: {_words(task.lat_actions)}."
    )


def demand_sentence(task: DrivingTask) -> str:
    """Step and horizon of the trajectory that the task asks for."""
    return (
        f"The task asks for a trajectory with a point every {task.trajectory_step_s:g} s, up to "
        f"{task.trajectory_horizon_s:g} s from now."
    )


def native_demand(task: DrivingTask, interface: str, rows: int, step_s: float) -> str:
    """The task's demand, and how a native form of fixed length covers it.

    Raises:
        InputError: it doesn't cover the horizon.
    """
    covered_s = rows * step_s
    if task.trajectory_horizon_s > covered_s + _TOLERANCE:
        raise InputError(
            f"is more than {interface} plans",
            field="task.trajectory_horizon_s",
            value=task.trajectory_horizon_s,
            remedy=f"{rows} steps of {step_s:g} s cover {covered_s:g} s",
        )
    return (
        f"{demand_sentence(task)} Give it as the next {rows} steps of {step_s:g} s, which is "
        f"{covered_s:g} s."
    )


def placeholders(form: str, count: int) -> str:
    """``[v1, k1], [v2, k2], …`` from a form such as ``[v{i}, k{i}]``."""
    return ", ".join(form.format(i=i) for i in range(1, count + 1))


def paragraphs(*parts: str) -> str:
    """The parts that aren't empty, one a line."""
    return "\n".join(part for part in parts if part)


def _words(values: Sequence[str]) -> str:
    return ", ".join(value.replace("_", " ") for value in values)


def _openemma_scene(request: Request, _: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        "This step: as the driver, describe the scene: traffic lights, what other vehicles and "
        "pedestrians do, lane markings.",
        objects_sentence(request.task),
        PLAIN,
    )
    return Prompt(text)


def _openemma_objects(request: Request, _: Mapping[str, str]) -> Prompt:
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


def _openemma_intent(request: Request, _: Mapping[str, str]) -> Prompt:
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


def _openemma_motion(request: Request, before: Mapping[str, str]) -> Prompt:
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
    Stage("scene", _openemma_scene),
    Stage("objects", _openemma_objects),
    Stage("intent", _openemma_intent),
    Stage("motion", _openemma_motion),
)


_PARAGRAPH = (
    "Answer this step only, with one paragraph of plain English text without any formatting."
)


def _lightemma_scene(request: Request, _: Mapping[str, str]) -> Prompt:
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


def _lightemma_past(request: Request) -> str:
    history = lightemma_history(request)
    count = len(history.rows)
    if not count:
        return UNKNOWN_PAST
    return (
        f"Your vehicle's last {count} speeds, {STEP_S:g} s apart, the most recent one last, are "
        f"{history.column_text(0)} m/s. Its curvatures at these times are "
        f"{history.column_text(1)} 1/m; positive is a left turn, negative a right turn."
    )


def _lightemma_intent(request: Request, before: Mapping[str, str]) -> Prompt:
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        f"The scene was described as: {before['scene']}",
        _lightemma_past(request),
        "This step: say what your vehicle was doing until now, and then how it should drive in "
        f"the next {LIGHTEMMA_PAIRS * STEP_S:g} s: whether it accelerates, decelerates or keeps "
        "its speed, and whether it turns left, turns right or follows the lane, each by how much.",
        actions_sentence(request.task),
        _PARAGRAPH,
    )
    return Prompt(text)


def _lightemma_motion(request: Request, before: Mapping[str, str]) -> Prompt:
    demand = native_demand(request.task, "lightemma", LIGHTEMMA_PAIRS, STEP_S)
    text = paragraphs(
        frames_sentence(request),
        whole_task(request.task),
        f"The scene was described as: {before['scene']}",
        _lightemma_past(request),
        f"You have decided to drive like this: {before['intent']}",
        f"This step: predict speed (m/s) and curvature (1/m, positive to the left). {demand} "
        "Their changes must be such that a vehicle can make them.",
        f"Answer with exactly {LIGHTEMMA_PAIRS} pairs in the form "
        f"[{placeholders('(v{i}, c{i})', LIGHTEMMA_PAIRS)}] and nothing else.",
    )
    return Prompt(text)


LIGHTEMMA = (
    Stage("scene", _lightemma_scene),
    Stage("intent", _lightemma_intent),
    Stage("motion", _lightemma_motion),
)


def _llavida_answer(request: Request, _: Mapping[str, str]) -> Prompt:
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


LLAVIDA = (Stage("motion", _llavida_answer),)


def _waypoints_answer(request: Request, _: Mapping[str, str]) -> Prompt:
    task = request.task
    count = math.floor(task.trajectory_horizon_s / task.trajectory_step_s + _TOLERANCE)
    text = paragraphs(
        frames_sentence(request),
        task.instruction,
        objects_sentence(task),
        critical_sentence(task),
        actions_sentence(task),
        "Positions are [x, y] in metres, seen from your vehicle: x is forward, y is to the left, "
        "and your vehicle is at [0, 0] now.",
        _waypoints_past(request),
        f"{demand_sentence(task)} That is {count} points, the first one "
        f"{task.trajectory_step_s:g} s from now.",
        "Write the text first, in plain English, and end with one line in the form",
        f"Trajectory: [{placeholders('[x{i}, y{i}]', count)}]",
    )
    return Prompt(text)


def _waypoints_past(request: Request) -> str:
    if not request.ego_known:
        return UNKNOWN_PAST
    rows = ", ".join(
        f"[{s.t_s:.1f}, {s.x_m + 0.0:.2f}, {s.y_m + 0.0:.2f}, {s.speed_mps + 0.0:.2f}]"
        for s in request.history
    )
    return (
        "Your vehicle's past as [time in s, x, y, speed in m/s], oldest first, with 0 as the time "
        f"now: {rows}."
    )


WAYPOINTS = (Stage("motion", _waypoints_answer),)


__all__ = ["PROMPTS", "Prompt", "Stage", "find_stages"]

PROMPTS: dict[str, tuple[Stage, ...]] = {
    "openemma": OPENEMMA,
    "lightemma": LIGHTEMMA,
    "llavida": LLAVIDA,
    "waypoints": WAYPOINTS,
}


def find_stages(interface: str) -> tuple[Stage, ...]:
    """The steps in which an interface asks, first to last.

    Raises:
        InputError: there is no prompt for this interface.
    """
    if interface not in PROMPTS:
        raise InputError(
            "has no prompt",
            field="backend_options.interface",
            value=interface,
            remedy=f"known are {', '.join(sorted(PROMPTS))}",
        )
    return PROMPTS[interface]


# Asks all steps of its interface itself; services are given the words of a single step.
_ASKS_STEPS = "openai"


def native_prompt(interface: str, request: Request) -> str | None:
    """What an interface asks in words, where it asks in one step; None where it doesn't.

    Raises:
        InputError: it can't ask what the task asks.
    """
    stages = PROMPTS.get(interface, ())
    if len(stages) != 1:
        return None
    prompt = stages[0].build(request, {})
    return f"{prompt.system}\n\n{prompt.text}" if prompt.system else prompt.text


def words_sha256(backend: str, options: Mapping[str, Any], request: Request) -> str | None:
    """Hash of all the words in which a backend of ours asks a request; None: it uses none.

    What the model itself says in a step is left open in the steps behind it: it follows from the
    words before.

    Raises:
        InputError: the options name no interface.
    """
    interface = interface_of(backend, options)
    if backend != _ASKS_STEPS and backend not in SERVICES:
        return None
    try:
        if backend in SERVICES:
            words = native_prompt(interface, request)
            return None if words is None else sha256_json(words)
        stages = PROMPTS.get(interface, ())
        left_open = {stage.name: f"({stage.name})" for stage in stages}
        return sha256_json([[s.name, s.build(request, left_open).sha256] for s in stages])
    except InputError as error:  # the answer will be this error
        return sha256_json(str(error))
