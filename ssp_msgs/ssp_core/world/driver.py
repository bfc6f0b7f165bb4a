"""A driver of the VUT as a session in one process asks it: question, answer, and result.

A driver gets its own motion and the centre line of its lane (METHOD 8.2). What a privileged driver
knows beside that stands in one field of its own, which is empty for all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError, PeerError
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.hashing import sha256_bytes
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.model import Camera
from ssp_core.value_class import value_class
from ssp_core.world.providers import Provider

_NOWHERE = Pose2(0.0, 0.0, 0.0)
# Spacing of the points of a question's centre line. A curve through points that stand farther apart
# swings where a bend begins, and a plan along it turns in early.
ROUTE_STEP_M = 1.0


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
class PrivilegedTruth:
    """The truth, for drivers that stand in no rank (METHOD 8.10).

    Args:
        truths: true states of everything at the question's stamp.
        observable_ns: T_obs; None where the event never becomes observable.
    """

    truths: tuple[ObjectState, ...]
    observable_ns: int | None


@dataclass(frozen=True, slots=True)
class SeenFrame:
    """One frame of the forward camera, as it is recorded.

    Args:
        stamp_ns: session time of its step.
    """

    stamp_ns: int
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class Question:
    """The content of one request to a driver.

    Args:
        number: counts from 1.
        stamp_ns: session time of the frame that it is about.
        history: of the VUT, oldest first, the last one at the stamp.
        route_m: centre line of the lane ahead, ego frame, x forward and y left, each ROUTE_STEP_M.
        privileged: None for all but privileged drivers.
        frames: oldest first, the last one at the stamp; empty for a driver that sees none.
        camera: of the frames; None for a driver that sees none.
        pose: of the VUT at the stamp in the map frame, for interfaces with a frame of their own; no
            model is shown it as it is.
        seed: for drivers that sample, ``Driven.sampling_seed``.
    """

    number: int
    stamp_ns: int
    history: tuple[EgoSample, ...]
    route_m: tuple[tuple[float, float], ...]
    privileged: PrivilegedTruth | None = None
    frames: tuple[SeenFrame, ...] = ()
    camera: Camera | None = None
    pose: Pose2 = _NOWHERE
    seed: int = 0

    @property
    def speed_mps(self) -> float:
        """Speed of the VUT at the stamp."""
        return self.history[-1].speed_mps

    @property
    def sha256(self) -> str:
        """Hash of stamp, motion, centre line and pictures."""
        pictures = [(frame.stamp_ns, sha256_bytes(frame.jpeg)) for frame in self.frames]
        content = self.number, self.stamp_ns, self.history, self.route_m, pictures
        return sha256_bytes(repr(content).encode())


@dataclass(frozen=True, slots=True)
class RawArray:
    """A numeric output of a model as it came (NativeArray.msg)."""

    name: str
    shape: tuple[int, ...]
    data: tuple[float, ...]
    frame: str
    unit: str
    step_s: float
    first_time_s: float


@dataclass(frozen=True, slots=True)
class Raw:
    """A model's answer before an adapter read it.

    Args:
        model_id: exact model and version.
        decoding: JSON object of its decoding parameters.
        error_code: of VlaResponse.msg, 0 without an error.
        error_msg: one line.
    """

    model_id: str
    arrays: tuple[RawArray, ...] = ()
    decoding: str = "{}"
    error_code: int = 0
    error_msg: str = ""


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer: a trajectory in the frame of METHOD 5.4, or none while there is nothing to say.

    Args:
        trajectory: None: there is none, for the reason in ``refused``.
        refused: why it has no plan; empty where it has one, or says nothing.
        raw: of a model; None: the trajectory is all that there is.
    """

    trajectory: Trajectory | None
    text: str = ""
    refused: str = ""
    raw: Raw | None = None


@dataclass(frozen=True, slots=True)
class LatencyParts:
    """A measured L, from the complete request to the parsed trajectory, and its parts.

    Args:
        total_ns: L.
        encoding_ns: pictures and request into what is sent.
        parsing_ns: what came into text, arrays and a trajectory.
    """

    total_ns: int
    encoding_ns: int = 0
    parsing_ns: int = 0

    @property
    def inference_ns(self) -> int:
        """The rest: transport, inference, waits and further tries."""
        return self.total_ns - self.encoding_ns - self.parsing_ns


@dataclass(frozen=True, slots=True)
class GivenAnswer:
    """The outcome of one question, as soon as it is known.

    Args:
        answer: None where the driver ended.
        latency: as it was measured.
        ended: why the driver ended; empty: it goes on.
    """

    answer: Answer | None
    latency: LatencyParts = LatencyParts(0)
    ended: str = ""


class NotRecordedError(PeerError):
    """A run that is driven again asks another question than it did."""


class AnswersOverError(NotRecordedError):
    """A run that is driven again asks more questions than it did."""


@dataclass(frozen=True, slots=True)
class RecordedAnswer:
    """An answer of a run before, for driving that run again.

    Args:
        question: hash of the question.
    """

    question: str
    given: GivenAnswer


def repeated_answer(recorded: Sequence[RecordedAnswer], question: Question) -> GivenAnswer:
    """Return the recorded answer to a question.

    Raises:
        NotRecordedError: none is to this question.
    """
    at_s = ns_to_seconds(question.stamp_ns)
    if question.number > len(recorded):
        raise AnswersOverError(f"no answer is recorded to a question about {at_s:.3f} s")
    one = recorded[question.number - 1]
    if one.question != question.sha256:
        raise NotRecordedError(f"the question about {at_s:.3f} s isn't the one that was recorded")
    return one.given


@dataclass(frozen=True, slots=True)
class EffectiveAnswer:
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


@value_class(frozen=True, slots=True)
class DriveReport:
    """The doings of the driver and its tracker in one step.

    Args:
        mode: what leads the VUT until the next step.
        effective_answer: became effective in this step.
        effective: reference that is tracked from this step on, where it is a new one.
        question: that of this step's frame.
        answer: what came of it.
        died: why the driver gives no answers any more; empty: it does.
        dies: why it ends with the question that is open; empty: it doesn't.
    """

    mode: DriveMode
    effective_answer: EffectiveAnswer | None = None
    effective: Reference | None = None
    question: Question | None = None
    answer: GivenAnswer | None = None
    died: str = ""
    dies: str = ""


class PlanDriver(Protocol):
    """A driver that answers with plans."""

    @property
    def privileged(self) -> bool:
        """Tell whether its questions carry the truth."""
        ...

    def answer(self, question: Question) -> Answer:
        """Answer one question; what it raises ends the driver."""
        ...


@runtime_checkable
class SeeingDriver(Protocol):
    """A model: its questions hold frames, its answers take time, and it ends with its run."""

    @property
    def privileged(self) -> bool:
        """False: no model sees the truth."""
        ...

    def give(self, question: Question) -> GivenAnswer:
        """Answer one question, or say why the driver ended.

        Raises:
            NotRecordedError: it repeats recorded answers, and none is to this question.
        """
        ...

    @property
    def frame_span_s(self) -> float:
        """Greatest age of a frame that its questions hold."""
        ...

    @property
    def history_s(self) -> float:
        """Length of the motion of its own that its questions hold."""
        ...

    def choose(self, stamps_ns: Sequence[int]) -> Sequence[int]:
        """Return the indices of the frames of a question about the last stamp, rising."""
        ...

    @property
    def problem(self) -> str:
        """Reason why it can't be loaded; empty: it is ready to answer."""
        ...

    def close(self) -> None:
        """End it."""
        ...


def driver_options(
    name: str, raw_options: Mapping[str, Any], models_file: Path | None = None
) -> dict[str, Any]:
    """Return the options of a driver as a run file keeps them.

    Args:
        name: of a baseline, of a model of the models file, or of a bridge.
        raw_options: as a person gave them.
        models_file: of ssp.models/1; None: none is given.

    Raises:
        InputError: no such driver, or no such option.
    """
    baselines = Provider.BASELINES.load()
    if baselines.is_baseline(name):
        baselines.make_driver(name, raw_options)
        return dict(raw_options)
    models, baseline_names = Provider.MODELS.load(), baselines.known_names()
    options: dict[str, Any] = models.driver_options(name, raw_options, models_file, baseline_names)
    return options


def check_models(models_file: Path) -> None:
    """Read a file of ssp.models/1, whether a driver names one of its models or not.

    Raises:
        InputError: it isn't valid.
    """
    Provider.MODELS.load().load_models(models_file)


def sees_frames(name: str) -> bool:
    """Tell whether a driver's questions hold frames: those of all models do."""
    is_baseline: bool = Provider.BASELINES.load().is_baseline(name)
    return not is_baseline


def model_facts(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is fixed of a model before it drives: what it is shown, and how long it may take.

    Args:
        name: of a model.
        options: of it, as ``driver_options`` returned them.
    """
    facts: dict[str, Any] = Provider.MODELS.load().model_facts(name, options)
    return facts


def history_s_of(name: str, options: Mapping[str, Any]) -> float:
    """Return how long the history is that a model's questions hold; 0 for a baseline."""
    return float(model_facts(name, options)["history_s"]) if sees_frames(name) else 0.0


def make_driver(
    name: str,
    options: Mapping[str, Any],
    recorded: Sequence[RecordedAnswer] | None = None,
    is_wanted: Callable[[], bool] = lambda: True,
) -> PlanDriver | SeeingDriver | None:
    """Return a fresh driver; None for one of COMMANDED, which the session leads itself.

    Args:
        name: of the driver.
        options: of it, as ``driver_options`` returned them.
        recorded: answers of a model in a run before, which it repeats; None: it is asked.
        is_wanted: tells, while a model loads, whether it is still waited for.

    Raises:
        InputError: no such driver, or no such option.
    """
    if sees_frames(name):
        model: SeeingDriver
        model = Provider.MODELS.load().make_driver(name, options, recorded, is_wanted)
        return model
    driver: PlanDriver | None = Provider.BASELINES.load().make_driver(name, options)
    return driver


def try_driver(name: str, options: Mapping[str, Any]) -> None:
    """Make a driver once and end it, before a run is begun.

    Raises:
        InputError: it can't be loaded.
    """
    driver = make_driver(name, options)
    if isinstance(driver, SeeingDriver):
        driver.close()
        if driver.problem:
            raise InputError(
                f"can't be loaded: {driver.problem}",
                field=f"driver {name}",
                remedy="mend the model or its options",
            )


def history_of(states: Sequence[ObjectState]) -> tuple[EgoSample, ...]:
    """Return the states of the VUT as samples in the frame of the last one.

    Args:
        states: in time order, at least one.
    """
    now = states[-1]
    samples = []
    for state in states:
        x, y = now.pose.to_local(state.x_m, state.y_m)
        t_s = (state.stamp_ns - now.stamp_ns) / 1e9
        turned = wrap_angle(state.yaw_rad - now.yaw_rad)
        samples.append(EgoSample(t_s, x, y, turned, state.speed_mps, state.yaw_rate_radps))
    return tuple(samples)
