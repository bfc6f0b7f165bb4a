"""The messages to and from a model: driving task, requests, responses, their JSON form."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from enum import IntEnum
from functools import cached_property, lru_cache
from itertools import pairwise
from operator import attrgetter
from typing import Annotated, Any, TypeVar, cast

import cv2
import numpy as np
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    Strict,
    TypeAdapter,
    ValidationError,
    WrapSerializer,
)

from ssp_core.errors import InputError
from ssp_core.files.model_errors import field_path
from ssp_core.hashing import sha256_bytes
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS


def _number(value: Any) -> float:
    """Return a number; ``nan``, ``inf`` and ``-inf`` stand for those that JSON doesn't have."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise ValueError("is too large a number") from None
    if value in ("nan", "inf", "-inf"):
        return float(value)
    raise ValueError("must be a number")


def _number_to_json(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))


# What the types below are in JSON; with them pydantic reads and writes the dataclasses.
Number = Annotated[float, BeforeValidator(_number), PlainSerializer(_number_to_json)]
Whole = Annotated[int, Strict()]
Jpeg = Annotated[
    bytes,
    Field(alias="jpeg_base64"),
    PlainSerializer(lambda data: base64.b64encode(data).decode("ascii")),
]
_EXACT = ConfigDict(extra="forbid")
Read = TypeVar("Read")


def read_json(form: TypeAdapter[Read], value: Any, **place: Any) -> Read:
    """Read a dataclass from a decoded JSON value.

    Raises:
        InputError: naming the first field that is wrong, at the ``file`` and ``line`` of place.
    """
    try:
        return form.validate_python(value)
    except ValidationError as error:
        failure = error.errors(include_url=False)[0]
        missing = failure["type"] == "missing"
        raise InputError(
            failure["msg"].removeprefix("Value error, "),
            field=field_path(failure["loc"], value, missing=missing),
            value=failure["input"] if isinstance(failure["input"], (str, int, float)) else None,
            remedy="add it" if missing else "docs/bridges.md has the form of messages",
            **place,
        ) from None


def of_schema(schema: str, form: Any) -> Callable[[Any], Any]:
    """Take the schema from an object that has every key; a dataclass would put in defaults."""
    names = {one.name for one in fields(form)}

    def check(value: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError("must be an object")
        if value.get("schema") != schema:
            raise ValueError(f"schema must be {schema!r}")
        for key in sorted(names - value.keys()):
            raise ValueError(f"{key} is missing")
        return {key: one for key, one in value.items() if key != "schema"}

    return check


_UNIT = re.compile("_(s|m|mps|rad|radps)$")


def bare_name(name: str) -> str:
    """Return the name of a field in a message, which has units in its comments."""
    return _UNIT.sub("", name)


def of_message(kind: type[Read], message: Any, **given: Any) -> Read:
    """Make a dataclass of a message that has its fields without their units, from any decoder."""
    for name in (one.name for one in fields(cast(Any, kind)) if one.name not in given):
        value = getattr(message, bare_name(name))
        value = value.tolist() if hasattr(value, "tolist") else value
        given[name] = tuple(value) if isinstance(value, list) else value
    return kind(**given)


_INSTRUCTION = (
    "You drive the vehicle from whose forward camera these frames come, oldest first. "
    "For the time of the last frame, say in plain English which road users matter, where the "
    "critical one is relative to your vehicle and how it moves, whether there is a conflict "
    "with it, and what your vehicle does now: its longitudinal and its lateral action. "
    "Then give the trajectory that your vehicle will follow."
)


@dataclass(frozen=True)
class DrivingTask:
    """The questions to a model, independent of its native prompt (METHOD 5.1, 5.4).

    Args:
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
    trajectory_step_s: Number
    trajectory_horizon_s: Number


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


class ErrorCode(IntEnum):
    """The reason why there is no answer, by the numbers of VlaResponse.msg."""

    NONE = 0
    TIMEOUT = 1
    BACKEND = 2
    OVERLOAD = 3
    BAD_REQUEST = 4
    BROKEN_OFF = 5
    DECLINED = 6


@dataclass(frozen=True)
class NativeArray:
    """A numeric output of a model, untouched: nothing here is checked against anything else.

    Args:
        name: as the model's interface calls it.
        data: row-major values.
        frame: declared by the model's interface, for example ``ego_xy``.
        step_s: time between rows, s, 0 when it has none.
        first_time_s: time of the first row after the request's time, s.
    """

    __pydantic_config__ = _EXACT
    name: str
    shape: tuple[Whole, ...]
    data: tuple[Number, ...]
    frame: str
    unit: str
    step_s: Number
    first_time_s: Number


@dataclass(frozen=True)
class Answer:
    """A backend's answer to one request: raw text, raw arrays and decoding facts."""

    text: str
    arrays: tuple[NativeArray, ...] = ()
    decoding: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Response:
    """One answer, raw; adapters interpret it later, so that it can be interpreted again.

    Args:
        stamp_ns: the request's stamp, never the time of answering, ns.
        model: name on the topic.
        decoding: every decoding parameter, JSON values only.
        latency_s: from request to answer inside the bridge, s.
        error_code: an ErrorCode's number, 0 is none.
        error_msg: one line, empty without an error.
    """

    __pydantic_config__ = _EXACT
    request_id: str
    stamp_ns: Whole
    model: str
    model_id: str
    text: str = ""
    arrays: tuple[NativeArray, ...] = ()
    decoding: Mapping[str, Any] = field(default_factory=dict)
    latency_s: Number = 0.0
    error_code: Whole = ErrorCode.NONE
    error_msg: str = ""


StoredResponse = Annotated[
    Response,
    BeforeValidator(of_schema(RESPONSE_SCHEMA, Response)),
    WrapSerializer(lambda response, write: {"schema": RESPONSE_SCHEMA, **write(response)}),
]
_RESPONSE: TypeAdapter[Response] = TypeAdapter(StoredResponse)


def response_to_json(response: Response) -> dict[str, Any]:
    """Return the JSON object of a response; numbers that aren't finite stand as strings in it."""
    value: dict[str, Any] = _RESPONSE.dump_python(response, mode="json")
    return value


def response_from_json(value: Any, *, file: str | None = None, line: int | None = None) -> Response:
    """Read what response_to_json wrote; raise InputError as read_json does."""
    return read_json(_RESPONSE, value, file=file, line=line)


_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_AT_ONCE = 4  # pictures that are decoded side by side


@dataclass(frozen=True)
class Frame:
    """One forward-camera image.

    Args:
        stamp_ns: time of exposure, ns.
    """

    stamp_ns: Whole
    jpeg: Jpeg

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

    t_s: Number
    x_m: Number
    y_m: Number
    yaw_rad: Number
    speed_mps: Number
    yaw_rate_radps: Number


# Each request has some sixty samples, which ``astuple`` would copy for a millisecond.
_values_of = attrgetter(*(one.name for one in fields(EgoSample)))


@dataclass(frozen=True)
class CameraGeometry:
    """Pinhole camera without distortion; what is not known of its mount is None.

    Args:
        fx_px: focal length along the image's width, px.
        fy_px: focal length along the image's height, px.
        cx_px: principal point from the left, px.
        cy_px: principal point from the top, px.
        height_m: optical centre above the ground, m.
        pitch_down_rad: rad, + looks down.
    """

    fx_px: Number
    fy_px: Number
    cx_px: Number
    cy_px: Number
    width_px: Whole
    height_px: Whole
    height_m: Number | None = None
    pitch_down_rad: Number | None = None


@dataclass(frozen=True)
class Request:
    """One question; it holds nothing later than ``stamp_ns``.

    Args:
        stamp_ns: the time that the answer is about, ns.
        frames: oldest first, the last one at or before stamp_ns.
        camera: geometry of all frames, None when it is not known.
        history: oldest first, the last sample at t = 0; empty when it is not known.
        ego_provenance: where the history comes from: ``measured``, ``declared`` or ``unknown``.
        previous: the model's own last answer about the same clip, for interfaces that carry state
            from answer to answer (interfaces.py); a bridge keeps none itself, so that an answer
            depends on its request only.
        route_m: centre line of the lane ahead, ego frame, x forward and y left; empty: none is
            given, as in open loop.
    """

    request_id: str
    stamp_ns: Whole
    frames: tuple[Frame, ...]
    camera: CameraGeometry | None = None
    history: tuple[EgoSample, ...] = ()
    ego_provenance: str = "unknown"
    task: DrivingTask = field(default=TASK)
    previous: StoredResponse | None = None
    route_m: tuple[tuple[float, float], ...] = ()

    @property
    def ego_known(self) -> bool:
        """Tell whether the request says how the VUT moved."""
        return bool(self.history) and self.ego_provenance != "unknown"


def request_problems(request: Request) -> tuple[str, ...]:
    """List the faults that make a request unanswerable, one clause each; none for a good one.

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
    if not all(math.isfinite(value) for sample in request.history for value in _values_of(sample)):
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
    """Tell which pictures decode, several at a time, since OpenCV releases the interpreter."""
    if len(jpegs) < 2:
        return [_decodes(jpeg) for jpeg in jpegs]
    with ThreadPoolExecutor(min(len(jpegs), _AT_ONCE)) as pool:
        return list(pool.map(_decodes, jpegs))


@lru_cache(maxsize=32)  # a frame stands in several requests, one after the other
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
