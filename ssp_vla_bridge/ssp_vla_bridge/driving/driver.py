"""A model as the driver of the VUT: question, request, answer, plan (ssp_core.world.driver)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError, SspError
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Camera
from ssp_core.world import driver as core
from ssp_core.world.camera import intrinsics
from ssp_vla_bridge.backend import BACKENDS, OPTION_TIMEOUT, SERVICES
from ssp_vla_bridge.driving.process import MeasuredAnswer, ModelProcess, no_answer_within
from ssp_vla_bridge.http_messages import request_to_json
from ssp_vla_bridge.messages import (
    TASK,
    CameraGeometry,
    DrivingTask,
    EgoSample,
    ErrorCode,
    Frame,
    Request,
    Response,
)
from ssp_vla_bridge.prompts import native_prompt, words_sha256
from ssp_vla_bridge.window import Interface, Preprocessing, choose

TIMEOUT_S = 60.0
# What a driver of this interface is asked for lies beyond two large latencies; the prompts of the
# others ask for what their models were trained on.
_HORIZON_S = 5.0
_SLACK_S = 1e-6
# Of the question whose words a card has the hash of.
_CARD_STAMP_NS = 60_000_000_000
_CHAT = "openai"


@dataclass(frozen=True)
class DriverModel:
    """A model, as it is to drive.

    Args:
        name: on topics.
        backend: name of a backend, or ``module:factory``.
        options: of the backend.
        interface: that it speaks.
        adapter: that reads its answers, ``name`` or ``name:mode``.
        rules: its frames and its history.
        timeout_s: for one answer; None: that of the backend's options, or 60 s.
        centre_line: it is given the centre line of its lane.
    """

    name: str
    backend: str
    options: Mapping[str, Any]
    interface: Interface
    adapter: str
    rules: Preprocessing
    timeout_s: float | None = None
    centre_line: bool = False

    @property
    def limit_s(self) -> float:
        """Time after which no answer is waited for."""
        own = self.options.get("timeout_s") if self.backend in OPTION_TIMEOUT else None
        limits_s = [t for t in (self.timeout_s, own) if t is not None]
        return min(limits_s) if limits_s else TIMEOUT_S

    @property
    def task(self) -> DrivingTask:
        """The question, which is the same in all runs."""
        if self.interface.name == "waypoints":
            return replace(TASK, trajectory_horizon_s=_HORIZON_S)
        return TASK


class BridgeDriver:
    """A model in a process of its own, which drives one run.

    A model that can't be loaded has died at its first question, so that it ends one run only.

    Args:
        model: as it is to drive.
        recorded: answers of a run before, which it repeats without being loaded; None: it is asked.
        is_wanted: tells, while it loads, whether it is still waited for.
    """

    privileged = False

    def __init__(
        self,
        model: DriverModel,
        recorded: Sequence[core.RecordedAnswer] | None = None,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._model = model
        self._recorded = recorded
        self._previous: Response | None = None
        self._process: ModelProcess | None = None
        self.problem = ""
        if recorded is not None:
            return
        options = dict(model.options)
        if model.backend in OPTION_TIMEOUT:
            options["timeout_s"] = model.limit_s
        try:
            self._process = ModelProcess(
                model.name, model.backend, options, model.adapter, is_wanted=is_wanted
            )
        except SspError as error:
            self.problem = str(error)

    @property
    def frame_span_s(self) -> float:
        """Greatest age of a frame in a request."""
        return self._model.rules.frame_span_s if self._model.rules.frames > 1 else 0.0

    @property
    def history_s(self) -> float:
        """Length of the history in a request."""
        return self._model.rules.history_s

    def choose(self, stamps_ns: Sequence[int]) -> list[int]:
        """Return the indices of the frames of a request about the last stamp, rising."""
        return choose(stamps_ns, len(stamps_ns) - 1, self._model.rules)

    def give(self, question: core.Question) -> core.GivenAnswer:
        """Answer one question, or say why the model ended.

        Raises:
            NotRecordedError: a recorded run asks another question than it did.
        """
        if self._recorded is not None:
            return core.repeated_answer(self._recorded, question)
        return self.ask(request_of(question, self._model))

    def ask(self, request: Request) -> core.GivenAnswer:
        """Answer a request, or say why the model ended.

        Args:
            request: without the model's own last answer, which is put in here.
        """
        if self._process is None:
            return core.GivenAnswer(None, ended=f"it can't be loaded: {self.problem}")
        limit_s = self._model.limit_s
        outcome = self._process.ask(replace(request, previous=self._previous), limit_s)
        if isinstance(outcome, core.GivenAnswer):
            return outcome
        measured, latency = outcome
        response = measured.response
        if response.error_code == ErrorCode.TIMEOUT or ns_to_seconds(latency.total_ns) > limit_s:
            return no_answer_within(limit_s)
        if measured.raised:
            return core.GivenAnswer(None, latency, response.error_msg)
        if response.error_code == ErrorCode.OVERLOAD:
            return core.GivenAnswer(None, latency, f"took no request: {response.error_msg}")
        if self._model.interface.carries_previous:
            self._previous = None if response.error_code else response
        return core.GivenAnswer(answer_of(measured), latency)

    def interrupt(self) -> None:
        """End the model's process while another thread asks it; ``close`` follows."""
        if self._process is not None:
            self._process.interrupt()

    def close(self) -> None:
        """End the model's process."""
        if self._process is not None:
            self._process.close()


def request_of(question: core.Question, model: DriverModel) -> Request:
    """Return the request of a question.

    But for a last answer of its own, all that the model gets is in it.

    Args:
        question: of the session.
        model: that is asked.
    """
    return Request(
        request_id=str(question.number),
        stamp_ns=question.stamp_ns,
        frames=tuple(Frame(one.stamp_ns, one.jpeg) for one in question.frames),
        camera=None if question.camera is None else geometry_of_run(question.camera),
        history=history_by(question.history, model.rules),
        ego_provenance="measured",
        task=model.task,
        route_m=question.route_m if model.centre_line else (),
    )


def prompt_facts(model: DriverModel) -> dict[str, str | None]:
    """Return the hash of the words in which a model is asked, and what they are, for its card.

    Frames' ages and own motion stand in the words of some interfaces. The hash is of a question
    with as many frames and as long a history as the model's interface has, of a VUT that stands.

    Args:
        model: as it is to drive.

    Returns:
        ``prompt_sha256``, None where a model is asked without words, and ``prompt``: what is
        hashed, or why nothing is.
    """
    backend = model.backend
    request = _card_request(model)
    if backend == _CHAT:
        prompt_sha256 = words_sha256(
            backend, {**model.options, "interface": model.interface.name}, request
        )
        return {
            "prompt_sha256": prompt_sha256,
            "prompt": "system and user texts of each step; its own earlier answers left open",
        }
    if backend in SERVICES:
        what = "task and prompt of the request"
        try:
            words = native_prompt(model.interface.name, request)
        except InputError as error:
            return {"prompt_sha256": None, "prompt": f"it can't be asked: {error}"}
    elif backend in ("python", "node") or backend not in BACKENDS:
        words, what = None, "task of the request; the words that it makes of it aren't known here"
    elif backend == "recorded":
        return {"prompt_sha256": None, "prompt": "repeats recorded answers, and isn't asked"}
    else:
        return {"prompt_sha256": None, "prompt": "reads no words"}
    sent = request_to_json(request, words)
    return {
        "prompt_sha256": sha256_json({"task": sent["task"], "prompt": sent["prompt"]}),
        "prompt": what,
    }


def _card_request(model: DriverModel) -> Request:
    """Return a question to a model about a VUT that stands; its frames have no pixels."""
    rules = model.rules
    spacing_ns = seconds_to_ns(rules.frame_spacing_s)
    stamps_ns = [_CARD_STAMP_NS - k * spacing_ns for k in reversed(range(rules.frames))]
    shown_ns = [stamps_ns[i] for i in choose(stamps_ns, rules.frames - 1, rules)]
    times_s = [-k * rules.history_spacing_s for k in range(_samples(rules), -1, -1)]
    question = core.Question(
        number=1,
        stamp_ns=_CARD_STAMP_NS,
        history=tuple(core.EgoSample(t_s, 0.0, 0.0, 0.0, 0.0, 0.0) for t_s in times_s),
        route_m=(),
        frames=tuple(core.SeenFrame(stamp_ns, b"") for stamp_ns in shown_ns),
    )
    return request_of(question, model)


def _samples(rules: Preprocessing) -> int:
    """Return how many samples of a history lie before the newest one."""
    return round(rules.history_s / rules.history_spacing_s)


def geometry_of_run(camera: Camera) -> CameraGeometry:
    """Return the geometry of a run's camera, as a recording's CameraInfo and mounting give it."""
    lens = intrinsics(camera)
    return CameraGeometry(
        fx_px=lens.fx_px,
        fy_px=lens.fy_px,
        cx_px=lens.cx_px,
        cy_px=lens.cy_px,
        width_px=lens.width_px,
        height_px=lens.height_px,
        height_m=camera.height_m,
        pitch_down_rad=camera.pitch_down_rad,
    )


def history_by(samples: Sequence[core.EgoSample], rules: Preprocessing) -> tuple[EgoSample, ...]:
    """Return the newest sample at or before each time of the history, oldest first."""
    history: list[core.EgoSample] = [samples[-1]]
    for k in range(1, _samples(rules) + 1):
        wanted_s = -k * rules.history_spacing_s + _SLACK_S
        before = [sample for sample in samples if sample.t_s <= wanted_s]
        if not before:
            break
        if before[-1].t_s < history[-1].t_s:
            history.append(before[-1])
    return tuple(EgoSample(*astuple(sample)) for sample in reversed(history))


def answer_of(model_answer: MeasuredAnswer) -> core.Answer:
    """Return what a model's answer says, and how it came."""
    response = model_answer.response
    arrays = tuple(core.RawArray(**asdict(array)) for array in response.arrays)
    raw = core.Raw(
        model_id=response.model_id,
        arrays=arrays,
        decoding=json.dumps(dict(response.decoding), sort_keys=True),
        error_code=int(response.error_code),
        error_msg=response.error_msg,
    )
    refused = model_answer.invalid
    if response.error_code:
        refused = f"error instead of an answer: {response.error_msg}"
    return core.Answer(model_answer.trajectory, response.text, refused, raw)
