"""One answer of a model, raw, and the one JSON form in which it is stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from ssp_core.errors import InputError
from ssp_vla_bridge.core.json_fields import (
    Malformed,
    exact_object,
    integer,
    listed,
    mapping,
    number,
    number_to_json,
    string,
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
