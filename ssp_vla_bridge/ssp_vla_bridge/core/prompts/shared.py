"""Sentences that the prompts share: the task's words, the frames' times, the native horizon."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.task import DrivingTask

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
