"""What goes to a model and what comes back: driving task, requests, responses, their JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, field
from enum import IntEnum
from functools import cached_property
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_bytes
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS


class Malformed(ValueError):
    """A value that isn't what its place asks for.

    Args:
        field: path of the field, such as ``arrays[0].shape``.
        problem: what is wrong, as one clause.
        value: the offending value.
    """

    def __init__(self, field: str, problem: str, value: object = None) -> None:
        super().__init__(problem)
        self.field, self.problem, self.value = field, problem, value


def exact_object(value: Any, place: str, keys: set[str]) -> dict[str, Any]:
    """An object that has exactly these keys."""
    if not isinstance(value, dict):
        raise Malformed(place, "must be an object", value)
    for key in sorted(keys ^ set(value)):
        raise Malformed(f"{place}.{key}", "is missing" if key in keys else "is no known key")
    return value


def listed(value: Any, place: str) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise Malformed(place, "must be a list", value)
    return value


def mapping(value: Any, place: str) -> dict[str, Any]:
    """An object with any keys."""
    if not isinstance(value, dict):
        raise Malformed(place, "must be an object", value)
    return value


def string(fields: dict[str, Any], key: str, place: str = "response") -> str:
    """The text under a key."""
    value = fields[key]
    if not isinstance(value, str):
        raise Malformed(f"{place}.{key}", "must be a string", value)
    return value


def integer(value: Any, place: str) -> int:
    """A whole number."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise Malformed(place, "must be an integer", value)
    return value


def number(value: Any, place: str) -> float:
    """A number; ``nan``, ``inf`` and ``-inf`` stand for those that JSON doesn't have."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise Malformed(place, "is too large a number", value) from None
    if value in ("nan", "inf", "-inf"):
        return float(value)
    raise Malformed(place, "must be a number", value)


def number_to_json(value: float) -> float | str:
    """The inverse of number."""
    return float(value) if math.isfinite(value) else str(float(value))


_INSTRUCTION = (
    "You drive the vehicle from whose forward camera these frames come, oldest first. "
    "For the time of the last frame, say in plain English which road users matter, where the "
    "critical one is relative to your vehicle and how it moves, whether there is a conflict "
    "with it, and what your vehicle does now: its longitudinal and its lateral action. "
    "Then give the trajectory that your vehicle will follow."
)


@dataclass(frozen=True)
class DrivingTask:
    """What a model is to answer, independent of its native prompt (METHOD 5.1, 5.4).

    Args:
        instruction: for the model, plain English.
        objects: closed vocabulary of the objects slot.
        positions: closed vocabulary of the position slot.
        motions: closed vocabulary of the motion slot.
        conflicts: closed vocabulary of the conflict slot.
        lon_actions: allowed longitudinal actions.
        lat_actions: allowed lateral actions.
        trajectory_step_s: time between the points asked for, s.
        trajectory_horizon_s: time of the last point asked for, s after the request's time.
    """

    instruction: str
    objects: tuple[str, ...]
    positions: tuple[str, ...]
    motions: tuple[str, ...]
    conflicts: tuple[str, ...]
    lon_actions: tuple[str, ...]
    lat_actions: tuple[str, ...]
    trajectory_step_s: float
    trajectory_horizon_s: float


TASK = DrivingTask(
    instruction=_INSTRUCTION,
    objects=OBJECTS,
    positions=POSITIONS,
    motions=MOTIONS,
    conflicts=CONFLICTS,
    lon_actions=LON_ACTIONS,
    lat_actions=LAT_ACTIONS,
    trajectory_step_s=0.5,
    trajectory_horizon_s=2.0,
)


RESPONSE_SCHEMA = "ssp.response/1"
_ARRAY_KEYS = {"name", "shape", "data", "frame", "unit", "step_s", "first_time_s"}
_RESPONSE_KEYS = {
    "schema", "request_id", "stamp_ns", "model", "model_id", "text", "arrays", "decoding",
    "latency_s", "error_code", "error_msg",
}  # fmt: skip


class ErrorCode(IntEnum):
    """Why there is no answer, by the numbers of VlaResponse.msg."""

    NONE = 0
    TIMEOUT = 1
    BACKEND = 2
    OVERLOAD = 3
    BAD_REQUEST = 4


@dataclass(frozen=True)
class NativeArray:
    """A numeric output of a model, untouched: nothing here is checked against anything else.

    Args:
        name: as the model's interface calls it.
        shape: sizes of the axes.
        data: row-major values.
        frame: declared by the model's interface, for example ``ego_xy``.
        unit: declared unit.
        step_s: time between rows, s, 0 when it has none.
        first_time_s: time of the first row after the request's time, s.
    """

    name: str
    shape: tuple[int, ...]
    data: tuple[float, ...]
    frame: str
    unit: str
    step_s: float
    first_time_s: float


@dataclass(frozen=True)
class Answer:
    """What a backend makes of one request: raw text, raw arrays and decoding facts."""

    text: str
    arrays: tuple[NativeArray, ...] = ()
    decoding: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Response:
    """One answer, raw; adapters interpret it later, so that it can be interpreted again.

    Args:
        request_id: the request's.
        stamp_ns: the request's stamp, never the time of answering, ns.
        model: name on the topic.
        model_id: exact model and version.
        text: raw.
        arrays: raw.
        decoding: every decoding parameter, JSON values only.
        latency_s: from request to answer inside the bridge, s.
        error_code: an ErrorCode's number, 0 is none.
        error_msg: one line, empty without an error.
    """

    request_id: str
    stamp_ns: int
    model: str
    model_id: str
    text: str = ""
    arrays: tuple[NativeArray, ...] = ()
    decoding: Mapping[str, Any] = field(default_factory=dict)
    latency_s: float = 0.0
    error_code: int = ErrorCode.NONE
    error_msg: str = ""


def arrays_to_json(arrays: Sequence[NativeArray]) -> list[dict[str, Any]]:
    """The one JSON form of native arrays; numbers that aren't finite stand as strings in it."""
    return [
        {
            "name": array.name,
            "shape": list(array.shape),
            "data": [number_to_json(value) for value in array.data],
            "frame": array.frame,
            "unit": array.unit,
            "step_s": number_to_json(array.step_s),
            "first_time_s": number_to_json(array.first_time_s),
        }
        for array in arrays
    ]


def arrays_from_json(value: Any) -> tuple[NativeArray, ...]:
    """The inverse of arrays_to_json.

    Raises:
        Malformed: it is no such list.
    """
    return tuple(_array(one, f"arrays[{i}]") for i, one in enumerate(listed(value, "arrays")))


def response_to_json(response: Response) -> dict[str, Any]:
    """The JSON object of a response; numbers that aren't finite stand as strings in it."""
    return {
        "schema": RESPONSE_SCHEMA,
        "request_id": response.request_id,
        "stamp_ns": response.stamp_ns,
        "model": response.model,
        "model_id": response.model_id,
        "text": response.text,
        "arrays": arrays_to_json(response.arrays),
        "decoding": dict(response.decoding),
        "latency_s": number_to_json(response.latency_s),
        "error_code": int(response.error_code),
        "error_msg": response.error_msg,
    }


def response_from_json(value: Any, *, file: str | None = None, line: int | None = None) -> Response:
    """The response of such an object: the inverse of response_to_json.

    Args:
        value: a decoded JSON value.
        file: where it stands, for the message.
        line: the line there, from 1.

    Raises:
        InputError: it is no such object.
    """
    try:
        return _response(value)
    except Malformed as error:
        raise InputError(
            error.problem, file=file, line=line, field=error.field, value=error.value
        ) from None


def _response(value: Any) -> Response:
    fields = exact_object(value, "response", _RESPONSE_KEYS)
    if fields["schema"] != RESPONSE_SCHEMA:
        raise Malformed("schema", f"must be {RESPONSE_SCHEMA!r}", fields["schema"])
    return Response(
        request_id=string(fields, "request_id"),
        stamp_ns=integer(fields["stamp_ns"], "stamp_ns"),
        model=string(fields, "model"),
        model_id=string(fields, "model_id"),
        text=string(fields, "text"),
        arrays=arrays_from_json(fields["arrays"]),
        decoding=mapping(fields["decoding"], "decoding"),
        latency_s=number(fields["latency_s"], "latency_s"),
        error_code=integer(fields["error_code"], "error_code"),
        error_msg=string(fields, "error_msg"),
    )


def _array(value: Any, place: str) -> NativeArray:
    fields = exact_object(value, place, _ARRAY_KEYS)
    shape, data = (listed(fields[key], f"{place}.{key}") for key in ("shape", "data"))
    return NativeArray(
        name=string(fields, "name", place),
        shape=tuple(integer(size, f"{place}.shape") for size in shape),
        data=tuple(number(one, f"{place}.data") for one in data),
        frame=string(fields, "frame", place),
        unit=string(fields, "unit", place),
        step_s=number(fields["step_s"], f"{place}.step_s"),
        first_time_s=number(fields["first_time_s"], f"{place}.first_time_s"),
    )


_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_AT_ONCE = 4  # pictures that are decoded side by side


@dataclass(frozen=True)
class Frame:
    """One forward-camera image.

    Args:
        stamp_ns: time of exposure, ns.
        jpeg: the compressed image as the camera gave it.
    """

    stamp_ns: int
    jpeg: bytes

    @cached_property
    def sha256(self) -> str:
        """Hash of the picture, worked out once: it stands in keys, questions and file names."""
        return sha256_bytes(self.jpeg)


@dataclass(frozen=True)
class EgoSample:
    """The VUT at one time, in the ego frame at the request's time (x forward, y left).

    Args:
        t_s: time relative to the request's, s, <= 0.
        x_m: m, forward.
        y_m: m, to the left.
        yaw_rad: rad, + is left.
        speed_mps: m/s along the heading.
        yaw_rate_radps: rad/s, + is left.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True)
class CameraGeometry:
    """Pinhole camera without distortion; what is not known of its mount is None.

    Args:
        fx_px: focal length along the image's width, px.
        fy_px: focal length along the image's height, px.
        cx_px: principal point from the left, px.
        cy_px: principal point from the top, px.
        width_px: image width, px.
        height_px: image height, px.
        height_m: optical centre above the ground, m.
        pitch_down_rad: rad, + looks down.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int
    height_m: float | None = None
    pitch_down_rad: float | None = None


@dataclass(frozen=True)
class Request:
    """One question; it holds nothing later than ``stamp_ns``.

    Args:
        request_id: given back with the answer.
        stamp_ns: the time that the answer is about, ns.
        frames: oldest first, the last one at or before stamp_ns.
        camera: geometry of all frames, None when it is not known.
        history: oldest first, the last sample at t = 0; empty when it is not known.
        ego_provenance: where the history comes from: ``measured``, ``declared`` or ``unknown``.
        task: what is asked.
        previous: the model's own last answer about the same clip, for interfaces that carry state
            from answer to answer (interfaces.py); a bridge keeps none itself, so that an answer
            depends on its request only.
    """

    request_id: str
    stamp_ns: int
    frames: tuple[Frame, ...]
    camera: CameraGeometry | None = None
    history: tuple[EgoSample, ...] = ()
    ego_provenance: str = "unknown"
    task: DrivingTask = field(default=TASK)
    previous: Response | None = None

    @property
    def ego_known(self) -> bool:
        """True when the request says how the VUT moved."""
        return bool(self.history) and self.ego_provenance != "unknown"


def request_problems(request: Request) -> tuple[str, ...]:
    """What makes a request unanswerable, one clause each; nothing for a good one.

    Frames are decoded at an eighth of their size, which finds what can't be decoded at a
    fraction of the cost.
    """
    problems = []
    if not request.frames:
        problems.append("it has no frames")
    decoded = _all_decode([frame.jpeg for frame in request.frames])
    for index, (frame, fine) in enumerate(zip(request.frames, decoded, strict=True)):
        if not fine:
            problems.append(f"frames[{index}] is no whole JPEG image ({len(frame.jpeg)} bytes)")
    stamps = [frame.stamp_ns for frame in request.frames]
    if any(after <= before for before, after in pairwise(stamps)):
        problems.append("the frames' stamps don't rise")
    if stamps and stamps[-1] > request.stamp_ns:
        problems.append("the last frame is later than the request's stamp")
    if not all(math.isfinite(value) for sample in request.history for value in astuple(sample)):
        problems.append("the history holds a number that isn't finite")
    times = [sample.t_s for sample in request.history]
    if any(not before < after for before, after in pairwise(times)):
        problems.append("the history's times don't rise")
    if times and times[-1] > 1e-6:
        problems.append("the history goes on after the request's time")
    task = request.task
    step_s, horizon_s = task.trajectory_step_s, task.trajectory_horizon_s
    if not (math.isfinite(step_s) and math.isfinite(horizon_s) and 0.01 <= step_s <= horizon_s):
        problems.append("the task's trajectory step and horizon are no times to plan for")
    elif horizon_s > 60.0:
        problems.append("the task's trajectory horizon is longer than 60 s")
    return tuple(problems)


def _all_decode(jpegs: Sequence[bytes]) -> list[bool]:
    """Which pictures decode. OpenCV gives the interpreter free, so several are tried at a time."""
    if len(jpegs) < 2:
        return [_decodes(jpeg) for jpeg in jpegs]
    with ThreadPoolExecutor(min(len(jpegs), _AT_ONCE)) as pool:
        return list(pool.map(_decodes, jpegs))


def _decodes(jpeg: bytes) -> bool:
    # A cut-off JPEG decodes to a picture with a grey rest, so its end marker is asked for too;
    # some cameras pad with zeros after it.
    if not jpeg.startswith(_JPEG_START) or not jpeg.rstrip(b"\0").endswith(_JPEG_END):
        return False
    data = np.frombuffer(jpeg, dtype=np.uint8)
    try:
        return cv2.imdecode(data, cv2.IMREAD_REDUCED_GRAYSCALE_8) is not None
    except cv2.error:
        return False
