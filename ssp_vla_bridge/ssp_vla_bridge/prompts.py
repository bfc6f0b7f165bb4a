"""Native prompts of each system, all made from one definition of the driving task.

Their words stand in prompts.yaml; here is what its braces stand for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping
from ssp_core.hashing import sha256_json
from ssp_vla_bridge.backend import SERVICES, interface_of, is_blind
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
    """The words of one question; the frames go before the text."""

    text: str
    system: str = ""  # empty where there is none

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
_UNKNOWN_TO_BLIND = "How your vehicle has moved until now is not known; assume no numbers."
_TOLERANCE = 1e-9


def visible_request(request: Request, blind: bool) -> Request:
    """Return the request that prompts and pictures are made from; a blind model's has no frame."""
    return replace(request, frames=()) if blind else request


def _frames(request: Request) -> str:
    """Describe how many frames there are, and when each was taken."""
    if not request.frames:
        return (
            "You are given no picture. Answer from what is told here and from what is usual on "
            "roads, as definitely as if you saw the road."
        )
    ages_s = [ns_to_seconds(request.stamp_ns - frame.stamp_ns) for frame in request.frames]
    times = ", ".join(f"{age_s:.2f}" for age_s in ages_s)
    if len(ages_s) == 1:
        return f"The picture was taken by your vehicle's front camera {times} s before now."
    return (
        f"The {len(ages_s)} pictures were taken by your vehicle's front camera {times} s before "
        "now, oldest first."
    )


def _words(values: Sequence[str]) -> str:
    return ", ".join(value.replace("_", " ") for value in values)


def _critical(task: DrivingTask) -> str:
    return (
        f"Say where the critical one is relative to your vehicle ({_words(task.positions)}), how "
        f"it moves ({_words(task.motions)}) and whether there is a conflict with it "
        f"({_words(task.conflicts)})."
    )


def _actions(task: DrivingTask) -> str:
    return (
        f"Your longitudinal action is one of: {_words(task.lon_actions)}. Your lateral action is "
        f"one of: {_words(task.lat_actions)}."
    )


def _task_demand(task: DrivingTask) -> str:
    return (
        f"The task asks for a trajectory with a point every {task.trajectory_step_s:g} s, up to "
        f"{task.trajectory_horizon_s:g} s from now."
    )


def _intent(request: Request) -> str:
    """Write OpenEMMA's question about the intent: a first one, or whether the one before holds."""
    previous = previous_stage(request, "intent")
    if previous is None:
        return (
            "This step: from the lane markings and from what other road users do, say what you "
            "intend: to follow the lane straight on, to turn left or to turn right; and to keep "
            "your speed, to slow down or to speed up."
        )
    ago_s = ns_to_seconds(request.stamp_ns - previous.stamp_ns)
    return (
        f"This step: {ago_s:.1f} s ago your intent was:\n{previous.text}\nFrom the lane "
        "markings and from what other road users do now, say whether you keep this intent or "
        "change it, and explain your present one."
    )


def _unknown_past(request: Request) -> str:
    return UNKNOWN_PAST if request.frames else _UNKNOWN_TO_BLIND


def _openemma_past(request: Request) -> str:
    history = openemma_history(request)
    return (
        f"The last {len(history.rows)} pairs of your vehicle, {STEP_S:g} s apart, oldest first, "
        f"are {history.pairs_text}."
        if history.rows
        else _unknown_past(request)
    )


def _lightemma_past(request: Request) -> str:
    history = lightemma_history(request)
    if not history.rows:
        return _unknown_past(request)
    return (
        f"Your vehicle's last {len(history.rows)} speeds, {STEP_S:g} s apart, the most recent one "
        f"last, are {history.column_text(0)} m/s. Its curvatures at these times are "
        f"{history.column_text(1)} 1/m; positive is a left turn, negative a right turn."
    )


def _llavida_past(request: Request) -> str:
    history = llavida_history(request)
    if not history.rows:
        return _unknown_past(request)
    return (
        f"Your vehicle's last {len(history.rows)} positions, {STEP_S:g} s apart, oldest first, "
        f"are {history.points_text}; it is at (0.00,0.00) now, and its speed is "
        f"{request.history[-1].speed_mps:.2f} m/s."
    )


def _waypoints_past(request: Request) -> str:
    if not request.ego_known:
        return _unknown_past(request)
    rows = ", ".join(
        f"[{s.t_s:.1f}, {s.x_m + 0.0:.2f}, {s.y_m + 0.0:.2f}, {s.speed_mps + 0.0:.2f}]"
        for s in request.history
    )
    return (
        "Your vehicle's past as [time in s, x, y, speed in m/s], oldest first, with 0 as the time "
        f"now: {rows}."
    )


@dataclass(frozen=True)
class _Native:
    """An interface's account of the past, and the form of the rows that it asks for."""

    past: Callable[[Request], str]
    form: str
    rows: int = 0  # 0: as many as the task asks for


_NATIVE = {
    "openemma": _Native(_openemma_past, "[speed_{i}, curvature_{i}]", OPENEMMA_PAIRS),
    "lightemma": _Native(_lightemma_past, "(v{i}, c{i})", LIGHTEMMA_PAIRS),
    "llavida": _Native(_llavida_past, "(x{i},y{i})", LLAVIDA_POINTS),
    "waypoints": _Native(_waypoints_past, "[x{i}, y{i}]"),
}


class _Words(str):
    """Words behind a brace's colon, such as ``{seeing: in the picture}``; none where it fails."""

    def __format__(self, words: str) -> str:
        return words if self else ""


class _Braces(dict[str, str]):
    """The values of a prompt's braces, computed where they are met."""

    def __init__(self, interface: str, request: Request, before: Mapping[str, str]) -> None:
        super().__init__({f"before_{name}": text for name, text in before.items()})
        self._interface, self._request = interface, request

    def __missing__(self, name: str) -> str:
        request, task, native = self._request, self._request.task, _NATIVE[self._interface]
        rows = native.rows or math.floor(
            task.trajectory_horizon_s / task.trajectory_step_s + _TOLERANCE
        )
        texts: dict[str, Callable[[], str]] = {
            "frames": lambda: _frames(request),
            "seeing": lambda: _Words("yes" if request.frames else ""),
            "blind": lambda: _Words("" if request.frames else "yes"),
            # Steps that don't say how the vehicle moved say it to who can't see.
            "blind_past": lambda: "" if request.frames else _waypoints_past(request),
            "instruction": lambda: task.instruction,
            "whole_task": lambda: f"The whole task, which is done in steps: {task.instruction}",
            "objects": lambda: f"Call each road user one of: {_words(task.objects)}.",
            "critical": lambda: _critical(task),
            "actions": lambda: _actions(task),
            "plain": lambda: "Answer this step only, in plain English text.",
            "paragraph": lambda: (
                "Answer this step only, with one paragraph of plain English text without any "
                "formatting."
            ),
            "intent": lambda: _intent(request),
            "past": lambda: native.past(request),
            "demand": lambda: self._demand(rows),
            "task_demand": lambda: _task_demand(task),
            "task_step_s": lambda: f"{task.trajectory_step_s:g}",
            "step_s": lambda: f"{STEP_S:g}",
            "covered_s": lambda: f"{rows * STEP_S:g}",
            "curvature_scale": lambda: f"{CURVATURE_SCALE:g}",
            "rows": lambda: str(rows),
            "form": lambda: ", ".join(native.form.format(i=i) for i in range(1, rows + 1)),
        }
        return texts[name]()

    def _demand(self, rows: int) -> str:
        """Return the task's demand, and how a native form of fixed length covers it."""
        task, covered_s = self._request.task, rows * STEP_S
        if task.trajectory_horizon_s > covered_s + _TOLERANCE:
            raise InputError(
                f"is more than {self._interface} plans",
                field="task.trajectory_horizon_s",
                value=task.trajectory_horizon_s,
                remedy=f"{rows} steps of {STEP_S:g} s cover {covered_s:g} s",
            )
        return (
            f"{_task_demand(task)} Give it as the next {rows} steps of {STEP_S:g} s, which is "
            f"{covered_s:g} s."
        )


def _build(
    interface: str, words: Mapping[str, str], request: Request, before: Mapping[str, str]
) -> Prompt:
    braces = _Braces(interface, request, before)
    paragraphs = [part.format_map(braces) for part in words["text"].splitlines()]
    system = words.get("system", "").format_map(braces)
    return Prompt("\n".join(part for part in paragraphs if part), system)


WORDS = read_mapping(Path(__file__).with_suffix(".yaml"))
PROMPTS: dict[str, tuple[Stage, ...]] = {
    interface: tuple(
        Stage(name, partial(_build, interface, words)) for name, words in stages.items()
    )
    for interface, stages in WORDS.items()
}


def find_stages(interface: str) -> tuple[Stage, ...]:
    """Return the steps in which an interface asks, first to last.

    Raises:
        InputError: there is no prompt for this interface.
    """
    if interface not in PROMPTS:
        raise InputError(
            "has no prompt",
            field="backend_options.interface",
            value=interface,
            remedy=f"known: {', '.join(sorted(PROMPTS))}",
        )
    return PROMPTS[interface]


# Asks all steps of its interface itself; services are given the words of a single step.
_ASKS_STEPS = "openai"


def native_prompt(interface: str, request: Request) -> str | None:
    """Write an interface's prompt where it asks in one step; None where it doesn't.

    Raises:
        InputError: it can't ask what the task asks.
    """
    stages = PROMPTS.get(interface, ())
    if len(stages) != 1:
        return None
    prompt = stages[0].build(request, {})
    return f"{prompt.system}\n\n{prompt.text}" if prompt.system else prompt.text


def words_sha256(backend: str, options: Mapping[str, Any], request: Request) -> str | None:
    """Return the hash of all words with which our backends ask a request; None: they use none.

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
        request = visible_request(request, blind=is_blind(options))
        left_open = {stage.name: f"({stage.name})" for stage in stages}
        return sha256_json([[s.name, s.build(request, left_open).sha256] for s in stages])
    except InputError as error:  # the answer will be this error
        return sha256_json(str(error))
