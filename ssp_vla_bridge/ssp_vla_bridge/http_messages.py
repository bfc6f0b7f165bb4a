"""What goes over the wire to a model behind HTTP, and back: ``ssp.vla_http/1`` (docs/bridges.md).

    GET  {url}/health  ->  {schema, model_id, ready, detail}
    POST {url}/answer  <-  {schema, request_id, stamp_ns, task, frames, camera, history,
                            ego_provenance, previous, prompt}
                       ->  {schema, request_id, model_id, text, arrays, decoding}

Both directions of each are here, so that a service in Python can use the same functions. A frame
is ``{stamp_ns, jpeg_base64}``; arrays and ``previous`` are in the form of messages.py.
``prompt`` is the interface's native prompt where that is one text (core/prompts), else null.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar

from ssp_core.errors import InputError
from ssp_core.files import check_characters
from ssp_vla_bridge.messages import (
    Answer,
    CameraGeometry,
    DrivingTask,
    EgoSample,
    Frame,
    Malformed,
    Request,
    arrays_from_json,
    arrays_to_json,
    exact_object,
    integer,
    listed,
    mapping,
    number,
    number_to_json,
    response_from_json,
    response_to_json,
    string,
)

HTTP_SCHEMA = "ssp.vla_http/1"
_REQUEST_KEYS = {
    "schema", "request_id", "stamp_ns", "task", "frames", "camera", "history", "ego_provenance",
    "previous", "prompt",
}  # fmt: skip
_ANSWER_KEYS = {"schema", "request_id", "model_id", "text", "arrays", "decoding"}
_HEALTH_KEYS = {"schema", "model_id", "ready", "detail"}
_TASK_NUMBERS = {"trajectory_step_s", "trajectory_horizon_s"}

Read = TypeVar("Read")


@dataclass(frozen=True)
class Health:
    """What a service says of itself.

    Args:
        model_id: exact model and version.
        ready: it answers now.
        detail: why it doesn't, or nothing.
    """

    model_id: str
    ready: bool
    detail: str = ""


@dataclass(frozen=True)
class ServiceAnswer:
    """An answer, and the model that gave it."""

    request_id: str
    model_id: str
    answer: Answer


def request_to_json(request: Request, prompt: str | None = None) -> dict[str, Any]:
    """The JSON object of a request.

    Args:
        request: what is asked.
        prompt: the same in words, for a model that is asked in words.
    """
    return {
        "schema": HTTP_SCHEMA,
        "request_id": request.request_id,
        "stamp_ns": request.stamp_ns,
        "task": asdict(request.task),
        "frames": [
            {
                "stamp_ns": frame.stamp_ns,
                "jpeg_base64": base64.b64encode(frame.jpeg).decode("ascii"),
            }
            for frame in request.frames
        ],
        "camera": None if request.camera is None else asdict(request.camera),
        "history": [
            {name: number_to_json(value) for name, value in asdict(sample).items()}
            for sample in request.history
        ],
        "ego_provenance": request.ego_provenance,
        "previous": None if request.previous is None else response_to_json(request.previous),
        "prompt": prompt,
    }


def request_from_json(value: Any) -> Request:
    """The inverse of request_to_json; the prompt is read by whom it concerns.

    Raises:
        InputError: naming the field that is wrong.
    """
    return _read(_request, value)


def answer_to_json(answer: ServiceAnswer) -> dict[str, Any]:
    """The JSON object of an answer."""
    return {
        "schema": HTTP_SCHEMA,
        "request_id": answer.request_id,
        "model_id": answer.model_id,
        "text": answer.answer.text,
        "arrays": arrays_to_json(answer.answer.arrays),
        "decoding": dict(answer.answer.decoding),
    }


def answer_from_json(value: Any) -> ServiceAnswer:
    """The inverse of answer_to_json.

    Numbers of arrays may be anything that a float holds: an adapter judges them. Decoding facts
    may not, since they are stored as they are.

    Raises:
        InputError: naming the field that is wrong.
    """
    return _read(_answer, value)


def health_to_json(health: Health) -> dict[str, Any]:
    """The JSON object of a service's health."""
    return {"schema": HTTP_SCHEMA, **asdict(health)}


def health_from_json(value: Any) -> Health:
    """The inverse of health_to_json.

    Raises:
        InputError: naming the field that is wrong.
    """
    return _read(_health, value)


def parse_json(body: bytes) -> Any:
    """The one JSON value in a body; ``NaN`` and ``Infinity`` are read as such.

    Raises:
        InputError: it is no JSON, more than one value, or text that no file can hold.
    """
    try:
        text = body.decode("utf-8")
        value = json.loads(text, object_pairs_hook=_once)
        check_characters(value, text)
    except RecursionError as error:
        raise InputError("is nested too deeply") from error
    except ValueError as error:
        if isinstance(error, json.JSONDecodeError) and error.msg == "Extra data":
            raise InputError(f"goes on after its JSON value, at character {error.pos}") from error
        raise InputError(f"is no JSON: {error}") from error
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a key stands twice")
    return values


def _read(read: Callable[[Any], Read], value: Any) -> Read:
    try:
        return read(value)
    except RecursionError as error:
        raise InputError("is nested too deeply") from error
    except Malformed as error:
        shown = error.value if isinstance(error.value, (str, int, float)) else None
        raise InputError(error.problem, field=error.field, value=shown) from None


def _schema(values: Mapping[str, Any]) -> None:
    if values["schema"] != HTTP_SCHEMA:
        raise Malformed("schema", f"must be {HTTP_SCHEMA!r}", values["schema"])


def _request(value: Any) -> Request:
    values = exact_object(value, "request", _REQUEST_KEYS)
    _schema(values)
    frames = listed(values["frames"], "frames")
    history = listed(values["history"], "history")
    previous = values["previous"]
    if values["prompt"] is not None:
        string(values, "prompt", "request")
    return Request(
        request_id=string(values, "request_id", "request"),
        stamp_ns=integer(values["stamp_ns"], "stamp_ns"),
        task=_task(values["task"]),
        frames=tuple(_frame(one, f"frames[{i}]") for i, one in enumerate(frames)),
        camera=None if values["camera"] is None else _camera(values["camera"]),
        history=tuple(_sample(one, f"history[{i}]") for i, one in enumerate(history)),
        ego_provenance=string(values, "ego_provenance", "request"),
        previous=None if previous is None else response_from_json(previous),
    )


def _frame(value: Any, place: str) -> Frame:
    values = exact_object(value, place, {"stamp_ns", "jpeg_base64"})
    try:
        jpeg = base64.b64decode(string(values, "jpeg_base64", place), validate=True)
    except (binascii.Error, ValueError) as error:
        if isinstance(error, Malformed):
            raise
        raise Malformed(f"{place}.jpeg_base64", f"is no base64: {error}") from None
    return Frame(integer(values["stamp_ns"], f"{place}.stamp_ns"), jpeg)


def _sample(value: Any, place: str) -> EgoSample:
    names = [one.name for one in fields(EgoSample)]
    values = exact_object(value, place, set(names))
    return EgoSample(*(number(values[name], f"{place}.{name}") for name in names))


def _camera(value: Any) -> CameraGeometry:
    values = exact_object(value, "camera", {one.name for one in fields(CameraGeometry)})
    read: dict[str, Any] = {}
    for name, one in values.items():
        place = f"camera.{name}"
        if name in ("width_px", "height_px"):
            read[name] = integer(one, place)
        elif one is None and name in ("height_m", "pitch_down_rad"):
            read[name] = None
        else:
            read[name] = number(one, place)
    return CameraGeometry(**read)


def _task(value: Any) -> DrivingTask:
    values = exact_object(value, "task", {one.name for one in fields(DrivingTask)})
    read: dict[str, Any] = {}
    for name, one in values.items():
        if name in _TASK_NUMBERS:
            read[name] = number(one, f"task.{name}")
        elif name == "instruction":
            read[name] = string(values, name, "task")
        else:
            words = listed(one, f"task.{name}")
            if not all(isinstance(word, str) for word in words):
                raise Malformed(f"task.{name}", "must be a list of strings")
            read[name] = tuple(words)
    return DrivingTask(**read)


def _answer(value: Any) -> ServiceAnswer:
    values = exact_object(value, "answer", _ANSWER_KEYS)
    _schema(values)
    decoding = mapping(values["decoding"], "decoding")
    try:
        json.dumps(decoding, allow_nan=False)
    except (ValueError, RecursionError):
        raise Malformed("decoding", "holds a number that isn't finite") from None
    return ServiceAnswer(
        request_id=string(values, "request_id", "answer"),
        model_id=string(values, "model_id", "answer"),
        answer=Answer(
            string(values, "text", "answer"), arrays_from_json(values["arrays"]), decoding
        ),
    )


def _health(value: Any) -> Health:
    values = exact_object(value, "health", _HEALTH_KEYS)
    _schema(values)
    if not isinstance(values["ready"], bool):
        raise Malformed("health.ready", "must be true or false", values["ready"])
    return Health(
        string(values, "model_id", "health"), values["ready"], string(values, "detail", "health")
    )
