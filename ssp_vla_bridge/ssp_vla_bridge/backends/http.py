"""A model behind an HTTP service (http_messages.py): asked once per request, believed in nothing.

What is tried again: a refused connection, and 503 or 429 with ``Retry-After`` in seconds; in both
cases the service hasn't taken the request. Everything else is final, because a request that was
taken may be answered only once: it becomes an error that says in one line what the service did.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.credentials import gives_away, redact
from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.backend import NoTimeError, NotTakenError, check_options
from ssp_vla_bridge.backends.http_connection import (
    BrokenError,
    HttpConnection,
    HttpReply,
    LateError,
    RefusedError,
)
from ssp_vla_bridge.http_messages import (
    Health,
    ServiceAnswer,
    answer_from_json,
    health_from_json,
    parse_json,
    request_to_json,
)
from ssp_vla_bridge.messages import Answer, Request
from ssp_vla_bridge.prompts import native_prompt
from ssp_vla_bridge.window import find_interface

_BUSY = (429, 503)
_POLL_S = 0.25
_HEALTH_S = 5.0
_FIRST_WAIT_S = 0.25
_SHOWN = 200


@dataclass(frozen=True)
class Timeouts:
    """How long and how often a service is asked.

    Args:
        timeout_s: for one answer, waits and further tries included.
        start_s: for the service to be ready when the bridge starts.
        tries: of one request, where a further one is safe.
    """

    timeout_s: float = 60.0
    start_s: float = 20.0
    tries: int = 3


class _Final(PeerError):
    """Waiting won't help."""


class HttpService:
    """The model at the other end of a line.

    Args:
        line: to the service.
        interface: that it speaks.
        patience: with it.
        key: sent as bearer token, None for none.
        key_name: of the environment variable that holds it.
    """

    def __init__(
        self,
        line: HttpConnection,
        interface: str,
        patience: Timeouts,
        key: str | None = None,
        key_name: str = "",
    ) -> None:
        self.interface = interface
        self.model_id = f"http({line.url})"
        self._line = line
        self._patience = patience
        self._key = key
        self._key_name = key_name
        self._ready = False
        self._one_at_a_time = threading.Lock()

    def wait_ready(self) -> None:
        """Waits until the service is ready, at most ``start_s``; what isn't ready then may come."""
        deadline_s = time.monotonic() + self._patience.start_s
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            try:
                self._require_ready(min(left_s, _HEALTH_S))
                return
            except _Final:
                return
            except PeerError:
                time.sleep(min(_POLL_S, max(0.0, deadline_s - time.monotonic())))

    def answer(self, request: Request) -> Answer:
        """The service's answer.

        Raises:
            NotTakenError: the service didn't take the request.
            NoTimeError: it gave no whole answer in time.
            PeerError: there is no answer, for the reason that it says.
            InputError: the interface's prompt can't ask what the task asks.
        """
        deadline_s = time.monotonic() + self._patience.timeout_s
        if not self._one_at_a_time.acquire(timeout=self._patience.timeout_s):
            raise NoTimeError(self._text("the request before this one isn't answered yet"))
        try:
            if not self._ready:
                self._require_ready(min(_HEALTH_S, _left_s(deadline_s)))
            value = request_to_json(request, native_prompt(self.interface, request))
            body = json.dumps(value, allow_nan=False).encode()
            reply = self._ask(body, deadline_s)
            answer = self._answer(reply, request.request_id)
        finally:
            self._one_at_a_time.release()
        self.model_id = answer.model_id
        return answer.answer

    def _require_ready(self, timeout_s: float) -> None:
        try:
            reply = self._line.exchange("/health", None, timeout_s)
        except RefusedError as error:
            raise NotTakenError(self._text(str(error))) from error
        except LateError as error:
            raise NoTimeError(self._text(str(error))) from error
        except BrokenError as error:
            raise self._error(str(error)) from error
        self._check_status(reply, "/health")
        health = self._health(reply)
        self.model_id = health.model_id
        if not health.ready:
            detail = self._short(health.detail)
            raise NotTakenError(self._text(f"the service isn't ready yet ({detail})"))
        self._ready = True

    def _ask(self, body: bytes, deadline_s: float) -> HttpReply:
        wait_s = _FIRST_WAIT_S
        for left in range(self._patience.tries - 1, -1, -1):
            pause_s = wait_s
            try:
                reply = self._line.exchange("/answer", body, _left_s(deadline_s))
            except RefusedError as error:
                self._ready = False
                reason = str(error)
            except LateError as error:
                raise NoTimeError(self._text(str(error))) from error
            except BrokenError as error:
                raise self._error(str(error)) from error
            else:
                if reply.status not in _BUSY or reply.retry_after_s is None:
                    return reply
                reason = f"the service is busy ({reply.status})"
                pause_s = reply.retry_after_s
            if not left or time.monotonic() + pause_s >= deadline_s:
                tried = self._patience.tries - left
                raise NotTakenError(self._text(f"{reason}, {tried} tries"))
            time.sleep(pause_s)
            wait_s *= 2.0
        raise ValueError("a request needs at least one try")

    def _answer(self, reply: HttpReply, request_id: str) -> ServiceAnswer:
        self._check_status(reply, "/answer")
        try:
            answer = answer_from_json(parse_json(reply.body))
        except InputError as error:
            raise self._unreadable(reply, "the answer", error) from error
        if answer.request_id != request_id:
            raise self._error(
                f"the answer is for another request ({self._short(answer.request_id)!r})"
            )
        self._refuse_key(answer.model_id, answer.answer)
        return answer

    def _health(self, reply: HttpReply) -> Health:
        try:
            health = health_from_json(parse_json(reply.body))
        except InputError as error:
            raise self._unreadable(reply, "/health", error) from error
        self._refuse_key(health.model_id, Answer(health.detail))
        return health

    def _check_status(self, reply: HttpReply, path: str) -> None:
        status = reply.status
        if status in (401, 403):
            remedy = "name the environment variable that holds it with api_key_env"
            if self._key is not None:
                remedy = f"the one in {self._key_name} isn't accepted"
            raise _Final(self._text(f"the service asks for a key ({status}); {remedy}"))
        if 300 <= status < 400:
            to = self._short(reply.headers.get("location", "nowhere"))
            raise _Final(self._text(f"redirects {path} to {to} ({status}); give that as url"))
        if status != 200:
            error = _Final if status == 404 else PeerError
            raise error(self._text(f"{path} says {status}: {self._said(reply.body)}"))
        encoding = reply.headers.get("content-encoding", "identity")
        if encoding != "identity":
            raise self._error(f"{path} is compressed ({self._short(encoding)}), unasked")

    def _said(self, body: bytes) -> str:
        """What a service says of its failure, ``{"error": …}`` or any text."""
        try:
            value = parse_json(body)
        except InputError:
            value = None
        if isinstance(value, dict) and isinstance(value.get("error"), str):
            return self._short(value["error"])
        return self._short(body.decode("utf-8", "replace"))

    def _unreadable(self, reply: HttpReply, what: str, error: InputError) -> PeerError:
        kind = self._short(reply.headers.get("content-type", "no content type"))
        begins = ""
        if reply.body.lstrip()[:1] != b"{":
            begins = f" ({kind}, begins with {self._short(self._said(reply.body))[:40]!r})"
        where = f"{error.field}: " if error.field else ""
        given = f" (got {error.value!r})" if error.value is not None and self._key is None else ""
        return self._error(
            f"{what} can't be read{begins}: {where}{self._short(error.problem + given)}"
        )

    def _refuse_key(self, model_id: str, answer: Answer) -> None:
        """A key must not get into what is stored, also not by way of the service."""
        names = [(array.name, array.frame, array.unit) for array in answer.arrays]
        kept = json.dumps([model_id, answer.text, dict(answer.decoding), names])
        if gives_away(kept.encode(), self._key):
            raise self._error("the answer repeats the key, and isn't kept")

    def _error(self, reason: str) -> PeerError:
        return PeerError(self._text(reason))

    def _text(self, reason: str) -> str:
        return redact(f"{self._line.url}: {reason}", self._key)

    def _short(self, text: str) -> str:
        """One printable line without the key; cut before, as a text may be large, and after."""
        text = redact(text[: 4 * _SHOWN], self._key)
        line = "".join(c if c.isprintable() else " " for c in text)
        line = " ".join(line.split())
        return line if len(line) <= _SHOWN else line[: _SHOWN - 1] + "…"


def _left_s(deadline_s: float) -> float:
    return max(0.001, deadline_s - time.monotonic())


_SHORTEST_KEY = 8

OPTIONS: dict[str, type] = {
    "url": str,
    "interface": str,
    "timeout_s": float,
    "start_s": float,
    "api_key_env": str,
    "max_mb": float,
    "tries": int,
}


def make(options: Mapping[str, Any]) -> HttpService:
    """A model behind HTTP, for the options in OPTIONS; waits for it at most ``start_s``.

    Raises:
        InputError: the options are wrong.
    """
    return make_service("http", options)


def make_service(
    name: str,
    options: Mapping[str, Any],
    interface: str = "waypoints",
    defaults: Mapping[str, Any] | None = None,
) -> HttpService:
    """As make, with another name, interface and defaults.

    Raises:
        InputError: the options are wrong.
    """
    check_options(name, options, OPTIONS)
    chosen = {**(defaults or {}), **options}
    if "url" not in chosen:
        raise InputError(
            "is missing",
            field="backend_options.url",
            remedy="give the service's address, such as http://127.0.0.1:8300",
        )
    patience = Timeouts(
        timeout_s=_within(chosen, "timeout_s", Timeouts.timeout_s, 0.001, 86400.0),
        start_s=_within(chosen, "start_s", Timeouts.start_s, 0.0, 86400.0),
        tries=int(_within(chosen, "tries", Timeouts.tries, 1, 100)),
    )
    max_mb = _within(chosen, "max_mb", 16.0, 0.001, 1024.0)
    key_name = str(chosen.get("api_key_env", ""))
    key = _key(key_name) if "api_key_env" in chosen else None
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    line = HttpConnection(str(chosen["url"]), headers, round(max_mb * (1 << 20)))
    spoken = find_interface(str(chosen.get("interface", interface))).name
    service = HttpService(line, spoken, patience, key, key_name)
    service.wait_ready()
    return service


def _within(
    options: Mapping[str, Any], key: str, default: float, least: float, most: float
) -> float:
    value = options.get(key, default)
    if not least <= value <= most:
        raise InputError(
            f"must lie in [{least:g}, {most:g}]", field=f"backend_options.{key}", value=value
        )
    return float(value)


def _key(name: str) -> str:
    """The key in an environment variable; no message shows it."""
    key = os.environ.get(name, "") if name and "\0" not in name else ""
    field = "backend_options.api_key_env"
    if not key:
        raise InputError(
            "names an environment variable that isn't set or is empty",
            field=field,
            value=name if len(name) < 40 else None,
            remedy="export the key under that name; a key itself is never an option",
        )
    if len(key) < _SHORTEST_KEY or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"the variable {name} holds no key: at least {_SHORTEST_KEY} printable characters "
            "without spaces",
            field=field,
        )
    return key


LLAVIDA_DEFAULTS = {"url": "http://127.0.0.1:8302", "timeout_s": 120.0}


def make_llavida(options: Mapping[str, Any]) -> HttpService:
    """The backend ``http`` with LLaViDA's interface, its sidecar's port and its patience.

    Raises:
        InputError: the options are wrong.
    """
    return make_service("llavida", options, "llavida", LLAVIDA_DEFAULTS)


ALPAMAYO_DEFAULTS = {"url": "http://127.0.0.1:8301", "timeout_s": 120.0}


def make_alpamayo(options: Mapping[str, Any]) -> HttpService:
    """The backend ``http`` with Alpamayo's interface, its sidecar's port and its patience.

    Raises:
        InputError: the options are wrong.
    """
    return make_service("alpamayo", options, "alpamayo", ALPAMAYO_DEFAULTS)
