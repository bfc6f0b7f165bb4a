"""A driver of the VUT as a session in one process asks it: question, answer, and what came of it.

A driver gets its own motion and the centre line of its lane (METHOD 8.2). What a privileged driver
knows beside that stands in one field of its own, which is empty for all others.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.motion.trajectory import Trajectory

DRIVER_MODULE = "ssp_ot_controller.driving.baselines"
# They command the VUT without plans: as the twin is led, and as an open-loop session is.
NO_RESPONSE, BUILT_IN = "no_response", "built_in"
COMMANDED = (NO_RESPONSE, BUILT_IN)


@dataclass(frozen=True, slots=True)
class EgoSample:
    """The VUT at an earlier instant, in the ego frame of the question (EgoSample.msg)."""

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class Privileged:
    """The truth, for drivers that stand in no rank (METHOD 8.10).

    Args:
        truths: true states of everything at the question's stamp.
        observable_ns: T_obs; None where the event never becomes observable.
    """

    truths: tuple[ObjectState, ...]
    observable_ns: int | None


@dataclass(frozen=True, slots=True)
class Question:
    """The content of one request to a driver.

    Args:
        number: counts from 1.
        stamp_ns: session time of the frame that it is about.
        history: of the VUT, oldest first, the last one at the stamp.
        route_m: centre line of the lane ahead, ego frame, x forward and y left.
        privileged: None for all but privileged drivers.
    """

    number: int
    stamp_ns: int
    history: tuple[EgoSample, ...]
    route_m: tuple[tuple[float, float], ...]
    privileged: Privileged | None = None

    @property
    def speed_mps(self) -> float:
        """Speed of the VUT at the stamp."""
        return self.history[-1].speed_mps


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer: a trajectory in the frame of METHOD 5.4, or none while there is nothing to say."""

    trajectory: Trajectory | None
    text: str = ""


@dataclass(frozen=True, slots=True)
class Answered:
    """An answer when it becomes effective.

    Args:
        number: of its question.
        stamp_ns: of the question.
        latency_s: L.
        refused: why its plan isn't driven; empty: it is.
    """

    number: int
    stamp_ns: int
    latency_s: float
    answer: Answer
    refused: str = ""


class DriveMode(Enum):
    """The authority that leads the VUT in a step (METHOD 8.4)."""

    BUILT_IN = "built_in"
    COMMAND = "command"
    PLAN = "plan"
    STALE = "stale"
    FALLBACK = "fallback"


@dataclass(frozen=True, slots=True)
class DriveReport:
    """The doings of the driver and its tracker in one step.

    Args:
        mode: what leads the VUT until the next step.
        answered: became effective in this step.
        effective: reference that is tracked from this step on, where it is a new one.
        asked: the question of this step's frame.
        died: why the driver gives no answers any more; empty: it does.
    """

    mode: DriveMode
    answered: Answered | None = None
    effective: Reference | None = None
    asked: Question | None = None
    died: str = ""


class PlanDriver(Protocol):
    """A driver that answers with plans."""

    @property
    def privileged(self) -> bool:
        """Tell whether its questions carry the truth."""
        ...

    def answer(self, question: Question) -> Answer:
        """Answer one question; what it raises ends the driver."""
        ...


def make_driver(
    name: str, options: Mapping[str, Any], module: str = DRIVER_MODULE
) -> PlanDriver | None:
    """Return a fresh driver; None for one of COMMANDED, which the session leads itself.

    Args:
        name: of the driver.
        options: of it, as a person gave them.
        module: that has ``make_driver(name, options)``.

    Raises:
        InputError: no such driver, or no such option.
    """
    driver: PlanDriver | None = importlib.import_module(module).make_driver(name, options)
    return driver


def history_of(states: Sequence[ObjectState]) -> tuple[EgoSample, ...]:
    """Return states of the VUT as samples in the frame of the last one.

    Args:
        states: in time order, at least one.
    """
    now = states[-1]
    found = []
    for state in states:
        x, y = now.pose.to_local(state.x_m, state.y_m)
        t_s = (state.stamp_ns - now.stamp_ns) / 1e9
        turned = state.yaw_rad - now.yaw_rad
        found.append(EgoSample(t_s, x, y, turned, state.speed_mps, state.yaw_rate_radps))
    return tuple(found)
