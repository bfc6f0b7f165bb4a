"""The seam behind which a model sits, and the backends by name."""

from __future__ import annotations

import importlib
import math
import os
import sys
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from operator import index
from pathlib import Path
from typing import Any, Protocol

from ssp_core.chat.answer_text import Ending, ending
from ssp_core.credentials import check_key, is_http_address
from ssp_core.errors import InputError, PeerError, SspError
from ssp_core.files.strict_json import parse_strict
from ssp_vla_bridge.messages import (
    Answer,
    ErrorCode,
    NativeArray,
    Request,
    Response,
    request_problems,
)
from ssp_vla_bridge.window import find_interface

# name: module:factory. A backend's module is imported when it is asked for, so that one
# backend's dependencies are not another's.
BACKENDS: dict[str, str] = {
    "constant_velocity": "ssp_vla_bridge.backends.baselines:ConstantVelocity",
    "copy_history": "ssp_vla_bridge.backends.baselines:CopyHistory",
    "opencv_baseline": "ssp_vla_bridge.backends.opencv_baseline:OpencvBaseline",
    "perfect": "ssp_vla_bridge.backends.perfect:make",
    "openai": "ssp_vla_bridge.backends.openai_chat:make",
    "silent": "ssp_vla_bridge.backends.baselines:Silent",
    "recorded": "ssp_vla_bridge.backends.recorded:make",
    "python": "ssp_vla_bridge.backends.python:make",
    "http": "ssp_vla_bridge.backends.http:make",
    "alpamayo": "ssp_vla_bridge.backends.http:make_alpamayo",
    "llavida": "ssp_vla_bridge.backends.http:make_llavida",
    "node": "ssp_vla_bridge.ros.node_client:make",
}

# The interface that a backend speaks unless its option ``interface`` says otherwise; where there
# is no line, ``waypoints``.
_INTERFACES: dict[str, str] = {
    "openai": "openemma",
    "alpamayo": "alpamayo",
    "llavida": "llavida",
}
SERVICES = frozenset({"http", "alpamayo", "llavida"})
# Backends that speak what their option ``interface`` says, give up by themselves after their
# option ``timeout_s``, and wait ``start_s`` for their service before they answer.
OPTION_INTERFACE = SERVICES | {"openai", "python", "recorded", "node"}
OPTION_TIMEOUT = SERVICES | {"openai"}
OPTION_START = SERVICES
# Options of backends that decide whether an answer comes, and never what it says.
_OF_DELIVERY: dict[str, frozenset[str]] = {
    "openai": frozenset({"timeout_s", "tries", "api_key_env"}),
    **dict.fromkeys(
        sorted(SERVICES), frozenset({"timeout_s", "start_s", "tries", "max_mb", "api_key_env"})
    ),
}


# What the option ``images`` of the chat backend says where it asks without pictures.
NO_IMAGES = "none"


class NotTakenError(PeerError):
    """The service did not take the request: no process listens, or it is busy. Later it may."""


class NoTimeError(PeerError):
    """The service gave no whole answer in time; another time it may."""


class BrokenOffError(PeerError):
    """The service broke its answer off, failed or gave no text; another time it may answer."""


class DeclinedError(PeerError):
    """The model, or a filter of its server, declines to answer. That is final."""


# What is raised, by the error code of the response.
CODES: dict[type[SspError], ErrorCode] = {
    NotTakenError: ErrorCode.OVERLOAD,
    NoTimeError: ErrorCode.TIMEOUT,
    BrokenOffError: ErrorCode.BROKEN_OFF,
    DeclinedError: ErrorCode.DECLINED,
}


class Backend(Protocol):
    """A model, whatever it is; it sees the request and nothing else."""

    @property
    def model_id(self) -> str:
        """Exact model and version."""

    def answer(self, request: Request) -> Answer:
        """Return the raw answer; any exception costs this answer only."""


class BackendFactory(Protocol):
    """Makes a backend from its options."""

    def __call__(self, options: Mapping[str, Any]) -> Backend:
        """Make a backend; raise InputError for unknown or wrong options."""


@dataclass(frozen=True)
class BackendResult:
    """A response, and the traceback behind its error (empty when nothing was raised)."""

    response: Response
    traceback: str = ""


def parse_options(
    text: str, field: str = "backend_options", remedy: str = 'give an object such as {"frames": 10}'
) -> dict[str, Any]:
    """Read the options in a JSON object; blank text has none.

    Raises:
        InputError: the text is no JSON object. It doesn't quote the text, in which somebody may
            have put a key that can't be distinguished from the rest.
    """
    if not text.strip():
        return {}
    try:
        value = parse_strict(text)
    except ValueError as error:
        raise InputError(f"is not valid JSON: {error}", field=field, remedy=remedy) from error
    if not isinstance(value, dict):
        raise InputError(
            f"must be a JSON object, not {type(value).__name__}", field=field, remedy=remedy
        )
    return value


def look_here_too() -> None:
    """Find modules of the working folder, behind all others: of models alone, not of ours."""
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)


def make_backend(name: str, options: Mapping[str, Any]) -> Backend:
    """Return the named backend, ready to answer.

    Args:
        name: a key of BACKENDS, or ``module:factory`` for a backend of one's own.
        options: the backend's own; each backend documents its keys.

    Raises:
        InputError: the name or the options are wrong.
    """
    target = BACKENDS.get(name, name)
    module_name, _, function = target.partition(":")
    if name not in BACKENDS:
        look_here_too()
    try:
        factory: BackendFactory = getattr(importlib.import_module(module_name), function)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise InputError(
            f"no such backend ({error})",
            field="backend",
            value=name,
            remedy=f"known: {', '.join(sorted(BACKENDS))}; your own is given as module:factory",
        ) from error
    return factory(options)


def interface_of(name: str, options: Mapping[str, Any]) -> str:
    """Return the interface that a backend speaks, without making it (window.py has them).

    Args:
        name: a key of BACKENDS, or ``module:factory`` for a backend of one's own.
        options: the backend's own; ``interface`` overrides the backend's usual one.

    Raises:
        InputError: the option ``interface`` names none.
    """
    interface = options.get("interface", _INTERFACES.get(name, "waypoints"))
    if not isinstance(interface, str):
        raise InputError(
            "must be a name",
            field="backend_options.interface",
            value=interface,
            remedy="write the name of an interface in quotes",
        )
    return find_interface(interface).name


def is_blind(options: Mapping[str, Any]) -> bool:
    """Tell whether options, or an answer's recorded decoding, say that no picture is shown."""
    return options.get("images") == NO_IMAGES


def telling_options(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that can change a backend's answer; all of a backend that isn't ours."""
    delivery = _OF_DELIVERY.get(name, frozenset())
    return {key: value for key, value in options.items() if key not in delivery}


def check_options(
    backend: str, options: Mapping[str, Any], option_types: Mapping[str, type]
) -> None:
    """Refuse options that a backend doesn't know or that have the wrong type.

    Raises:
        InputError: naming the option.
    """
    for key, value in options.items():
        if key not in option_types:
            raise InputError(
                f"is no option of {backend}",
                field=f"backend_options.{key}",
                remedy=f"known: {', '.join(sorted(option_types)) or 'none'}",
            )
        required_type = option_types[key]
        # bool is an int to Python, and an int is a fine float.
        fits = isinstance(value, (int, float) if required_type is float else required_type)
        if not fits or (isinstance(value, bool) and required_type is not bool):
            raise InputError(
                f"must be of type {required_type.__name__}",
                field=f"backend_options.{key}",
                value=value,
                remedy="write one of that type",
            )


class OptionFree:
    """A backend in this process that has no options."""

    name: str

    def __init__(self, options: Mapping[str, Any] | None = None) -> None:
        check_options(self.name, options or {}, {})


def number_option(
    options: Mapping[str, Any], key: str, default: float, least: float, most: float
) -> float:
    """Return a number among the options, or the default.

    Raises:
        InputError: it lies outside the limits, or is none.
    """
    value = options.get(key)
    number: float = default if value is None else value
    if not (math.isfinite(number) and least <= number <= most):
        raise InputError(
            f"must lie in [{least:g}, {most:g}]",
            field=f"backend_options.{key}",
            value=number,
            remedy="give a number of that range",
        )
    return number


def address_option(url: str, field: str, example: str) -> str:
    """Return the address of a service, without a slash at its end.

    Raises:
        InputError: it is no address of HTTP, or may hold a key or password, which would be stored
            with the results; it isn't shown then.
    """
    if set(url) & set("@?#"):
        raise InputError(
            "holds a name, a password, a query or a fragment",
            field=f"backend_options.{field}",
            remedy="name the environment variable that holds a key with api_key_env",
        )
    if not url.isascii() or not url.isprintable() or " " in url or not is_http_address(url):
        raise InputError(
            "is no address of HTTP",
            field=f"backend_options.{field}",
            value=url,
            remedy=f"give such as {example}",
        )
    return url.rstrip("/")


def key_option(options: Mapping[str, Any]) -> str | None:
    """Return the key in the environment variable that ``api_key_env`` names, None without one.

    Raises:
        InputError: the variable holds no key; the message doesn't show what it holds.
    """
    variable = options.get("api_key_env") or ""
    if not variable:
        return None
    remedy = "leave api_key_env out where the service wants no key; a key is never an option"
    return check_key(variable, os.environ.get(variable), remedy)


def respond(backend: Backend, model: str, request: Request) -> BackendResult:
    """Return the response to one request, whatever the backend does; latency is the caller's.

    A request that can't be answered is ERROR_BAD_REQUEST and doesn't reach the backend; an
    exception of the backend is ERROR_BACKEND with its last line as the message. A request that a
    service behind the backend didn't take is ERROR_OVERLOAD, as one that finds the queue full, and
    one that it gave no answer to in time is ERROR_TIMEOUT, as one that the bridge waited for.
    """
    blank = Response(request.request_id, request.stamp_ns, model, backend.model_id)
    problems = request_problems(request)
    if problems:
        return BackendResult(failure(blank, ErrorCode.BAD_REQUEST, "; ".join(problems)))
    try:
        answer = backend.answer(request)
        _check_ended(answer.decoding)
        response = replace(
            blank,
            model_id=backend.model_id,
            text=answer.text,
            arrays=_of_numbers(answer.arrays),
            decoding=answer.decoding,
        )
    except SspError as error:  # written for people; where in the code it was raised says no more
        code = CODES.get(type(error), ErrorCode.BACKEND)
        return BackendResult(failure(blank, code, str(error)))
    except Exception as error:  # a model's failure costs one answer and goes to the caller's log
        message = f"{type(error).__name__}: {error}"
        return BackendResult(failure(blank, ErrorCode.BACKEND, message), traceback.format_exc())
    return BackendResult(response)


def _of_numbers(arrays: Iterable[NativeArray]) -> tuple[NativeArray, ...]:
    """Return arrays with plain numbers as their values, of whatever kind of number they are.

    Raises:
        PeerError: one holds something else, or a number that is too large.
    """
    try:
        return tuple(
            replace(
                array,
                shape=tuple(map(index, array.shape)),
                data=tuple(map(float, array.data[: len(array.data)])),
            )
            for array in arrays
        )
    except (TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise PeerError(f"an array of the answer holds no numbers: {error}") from error


def _check_ended(decoding: Mapping[str, Any]) -> None:
    """Refuse an answer of which its service says that it was broken off or filtered.

    Raises:
        BrokenOffError: it was broken off.
        DeclinedError: a filter held it back.
    """
    stages = decoding.get("stages")
    for part in (decoding, *(stages if isinstance(stages, list) else ())):
        reason = part.get("finish_reason") if isinstance(part, Mapping) else None
        if not isinstance(reason, str):
            continue
        if ending(reason) is Ending.BROKEN:
            raise BrokenOffError(f"the service broke the answer off (finish_reason {reason})")
        if ending(reason) is Ending.FILTERED:
            raise DeclinedError(f"filtered by the service (finish_reason {reason})")


def with_end_read(response: Response) -> Response:
    """Return an answer, or the error that it is where its decoding says that it didn't end.

    ``respond`` reads this of our own backends; answers of other bridges, and those that were stored
    before, come without.
    """
    if response.error_code != ErrorCode.NONE:
        return response
    try:
        _check_ended(response.decoding)
    except (BrokenOffError, DeclinedError) as error:
        return failure(response, CODES[type(error)], str(error))
    return response


def failure(response: Response, code: ErrorCode, message: str) -> Response:
    """Return an answer that says, on one line, why there is none."""
    line = " ".join(message.split())
    return replace(
        response,
        text="",
        arrays=(),
        decoding={},
        error_code=int(code),
        error_msg=line if len(line) <= 400 else line[:397] + "...",
    )
