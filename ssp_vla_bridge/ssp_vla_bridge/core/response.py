"""One answer of a model, raw, and the one JSON form in which it is stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from ssp_core.errors import InputError

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


def response_to_json(response: Response) -> dict[str, Any]:
    """The JSON object of a response; numbers that aren't finite stand as strings in it."""
    return {
        "schema": RESPONSE_SCHEMA,
        "request_id": response.request_id,
        "stamp_ns": response.stamp_ns,
        "model": response.model,
        "model_id": response.model_id,
        "text": response.text,
        "arrays": [
            {
                "name": array.name,
                "shape": list(array.shape),
                "data": [_number_to_json(value) for value in array.data],
                "frame": array.frame,
                "unit": array.unit,
                "step_s": _number_to_json(array.step_s),
                "first_time_s": _number_to_json(array.first_time_s),
            }
            for array in response.arrays
        ],
        "decoding": dict(response.decoding),
        "latency_s": _number_to_json(response.latency_s),
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
    except _Malformed as error:
        raise InputError(
            error.problem, file=file, line=line, field=error.field, value=error.value
        ) from None


class _Malformed(ValueError):
    def __init__(self, field_name: str, problem: str, value: object = None) -> None:
        super().__init__(problem)
        self.field, self.problem, self.value = field_name, problem, value


def _response(value: Any) -> Response:
    fields = _object(value, "response", _RESPONSE_KEYS)
    if fields["schema"] != RESPONSE_SCHEMA:
        raise _Malformed("schema", f"must be {RESPONSE_SCHEMA!r}", fields["schema"])
    arrays = fields["arrays"]
    if not isinstance(arrays, list):
        raise _Malformed("arrays", "must be a list", arrays)
    if not isinstance(fields["decoding"], dict):
        raise _Malformed("decoding", "must be an object", fields["decoding"])
    return Response(
        request_id=_string(fields, "request_id"),
        stamp_ns=_integer(fields["stamp_ns"], "stamp_ns"),
        model=_string(fields, "model"),
        model_id=_string(fields, "model_id"),
        text=_string(fields, "text"),
        arrays=tuple(_array(array, f"arrays[{i}]") for i, array in enumerate(arrays)),
        decoding=fields["decoding"],
        latency_s=_number(fields["latency_s"], "latency_s"),
        error_code=_integer(fields["error_code"], "error_code"),
        error_msg=_string(fields, "error_msg"),
    )


def _array(value: Any, place: str) -> NativeArray:
    fields = _object(value, place, _ARRAY_KEYS)
    for key in ("shape", "data"):
        if not isinstance(fields[key], list):
            raise _Malformed(f"{place}.{key}", "must be a list", fields[key])
    return NativeArray(
        name=_string(fields, "name", place),
        shape=tuple(_integer(size, f"{place}.shape") for size in fields["shape"]),
        data=tuple(_number(number, f"{place}.data") for number in fields["data"]),
        frame=_string(fields, "frame", place),
        unit=_string(fields, "unit", place),
        step_s=_number(fields["step_s"], f"{place}.step_s"),
        first_time_s=_number(fields["first_time_s"], f"{place}.first_time_s"),
    )


def _object(value: Any, place: str, keys: set[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _Malformed(place, "must be an object", value)
    for key in sorted(keys ^ set(value)):
        raise _Malformed(f"{place}.{key}", "is missing" if key in keys else "is no known key")
    return value


def _string(fields: dict[str, Any], key: str, place: str = "response") -> str:
    value = fields[key]
    if not isinstance(value, str):
        raise _Malformed(f"{place}.{key}", "must be a string", value)
    return value


def _integer(value: Any, place: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise _Malformed(place, "must be an integer", value)
    return value


def _number_to_json(value: float) -> float | str:
    return float(value) if math.isfinite(value) else str(float(value))


def _number(value: Any, place: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise _Malformed(place, "is too large a number", value) from None
    if value in ("nan", "inf", "-inf"):
        return float(value)
    raise _Malformed(place, "must be a number", value)
