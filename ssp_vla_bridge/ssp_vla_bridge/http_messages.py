"""The messages to and from a model behind HTTP: ``ssp.vla_http/1`` (docs/bridges.md).

    GET  {url}/health  ->  {schema, model_id, ready, detail}
    POST {url}/answer  <-  {schema, request_id, stamp_ns, frames, camera, history, ego_provenance,
                            task, previous, prompt, route_m}
                       ->  {schema, request_id, model_id, text, arrays, decoding}

Both directions of each are here, so that a service in Python can use the same functions. A frame
is ``{stamp_ns, jpeg_base64}``; arrays and ``previous`` are in the form of messages.py.
``prompt`` is the interface's native prompt where that is one text (prompts.py), else null.
``route_m`` is there for drivers that are given the centre line of their lane.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Strict, TypeAdapter

from ssp_core.errors import InputError
from ssp_core.files.reading import check_characters
from ssp_core.files.strict_json import parse_lenient
from ssp_vla_bridge.messages import Answer, NativeArray, Request, of_schema, read_json

HTTP_SCHEMA = "ssp.vla_http/1"


@dataclass(frozen=True)
class Health:
    """A service's report of itself: its exact model and version, and why it isn't ready."""

    __pydantic_config__ = ConfigDict(extra="forbid")
    model_id: str
    ready: Annotated[bool, Strict()]
    detail: str = ""


def _finite(decoding: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        json.dumps(decoding, allow_nan=False)
    except (ValueError, RecursionError):
        raise ValueError("holds a number that isn't finite") from None
    return decoding


@dataclass(frozen=True)
class ServiceAnswer:
    """An answer, and the model that gave it.

    Numbers of arrays may be anything that a float holds: an adapter judges them. Decoding facts
    may not, since they are stored as they are.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")
    request_id: str
    model_id: str
    text: str
    arrays: tuple[NativeArray, ...]
    decoding: Annotated[Mapping[str, Any], AfterValidator(_finite)]

    @property
    def answer(self) -> Answer:
        return Answer(self.text, self.arrays, self.decoding)


_HEALTH: TypeAdapter[Health] = TypeAdapter(
    Annotated[Health, BeforeValidator(of_schema(HTTP_SCHEMA, Health))]
)
_ANSWER: TypeAdapter[ServiceAnswer] = TypeAdapter(
    Annotated[ServiceAnswer, BeforeValidator(of_schema(HTTP_SCHEMA, ServiceAnswer))]
)
_REQUEST: TypeAdapter[Request] = TypeAdapter(Request)


def request_to_json(request: Request, prompt: str | None = None) -> dict[str, Any]:
    """Return the JSON object of a request; the prompt says the same to a model asked in words."""
    value = _REQUEST.dump_python(request, mode="json", by_alias=True)
    if not request.route_m:
        del value["route_m"]
    return {"schema": HTTP_SCHEMA, **value, "prompt": prompt}


def answer_from_json(value: Any) -> ServiceAnswer:
    """Read a service's answer; raise InputError naming the field that is wrong."""
    return read_json(_ANSWER, value)


def health_from_json(value: Any) -> Health:
    """Read a service's health; raise InputError naming the field that is wrong."""
    return read_json(_HEALTH, value)


def parse_json(body: bytes) -> Any:
    """Read the one JSON value in a body; ``NaN`` and ``Infinity`` are read as such.

    Raises:
        InputError: it is no JSON, more than one value, or text that no file can hold.
    """
    try:
        text = body.decode("utf-8")
        value = parse_lenient(text)
        check_characters(value, text)
    except RecursionError as error:
        raise InputError("is nested too deeply", remedy="nest it less") from error
    except ValueError as error:
        if isinstance(error, json.JSONDecodeError) and error.msg == "Extra data":
            raise InputError(
                f"goes on after its JSON value, at character {error.pos}",
                remedy="send one JSON value",
            ) from error
        raise InputError(f"is no JSON: {error}", remedy="send one JSON value, in UTF-8") from error
    return value
