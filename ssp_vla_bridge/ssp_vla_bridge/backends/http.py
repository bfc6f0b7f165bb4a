"""A model behind an HTTP service (http_messages.py): asked once per request, believed in nothing.

What is tried again: a refused connection, and 503 or 429 with ``Retry-After`` in seconds; in both
cases the service hasn't taken the request. Everything else is final, because a request that was
taken may be answered only once: it becomes an error that says in one line what the service did.

A connection serves one exchange, so that what a service sends unasked, or too late, can't be taken
for the answer to the next request: no redirects, no cookies, no compression. Proxies of the
environment are used for services on other machines only.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import json
import threading
import time
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar
from urllib.parse import urlsplit

import aiohttp

from ssp_core.credentials import gives_away, redact
from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.backend import (
    NoTimeError,
    NotTakenError,
    address_option,
    check_options,
    key_option,
    number_option,
)
from ssp_vla_bridge.http_messages import (
    ServiceAnswer,
    answer_from_json,
    health_from_json,
    parse_json,
    request_to_json,
)
from ssp_vla_bridge.messages import Answer, Request
from ssp_vla_bridge.prompts import native_prompt
from ssp_vla_bridge.stopwatch import ENCODING, PARSING, part
from ssp_vla_bridge.window import find_interface

_BUSY = (429, 503)
_POLL_S = 0.25
_HEALTH_S = 5.0
_FIRST_WAIT_S = 0.25
_SHOWN = 200

Read = TypeVar("Read")


@dataclass(frozen=True)
class HttpReply:
    """A service's reply, with the headers by lower-case name."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def retry_after_s(self) -> float | None:
        """Return the wait that a busy service asks for, s; None where it states none, or a date."""
        text = self.headers.get("retry-after", "")
        whole = text.isascii() and text.isdigit() and len(text) < 7
        return float(text) if whole and self.status in _BUSY else None


class _Final(PeerError):
    """Waiting won't help."""


@dataclass
class HttpService:
    """The model behind an address, which speaks an interface.

    Args:
        url: with scheme and host; paths are put behind it.
        key: sent as bearer token, None for none.
        key_name: of the environment variable that holds it.
        max_bytes: of an answer.
        timeout_s: for one answer, waits and further tries included.
        start_s: for the service to be ready when the bridge starts.
        tries: of one request, where a further one is safe.
    """

    url: str
    interface: str
    key: str | None = field(repr=False)
    key_name: str
    max_bytes: int
    timeout_s: float
    start_s: float
    tries: int

    def __post_init__(self) -> None:
        self.model_id = f"http({self.url})"
        self._proxy = _proxy(self.url)
        self._ready = False
        self._one_at_a_time = threading.Lock()

    def wait_ready(self) -> None:
        """Wait at most ``start_s`` until the service is ready; it may still come later."""
        deadline_s = time.monotonic() + self.start_s
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            try:
                self._require_ready(min(left_s, _HEALTH_S))
                return
            except _Final:
                return
            except PeerError:
                time.sleep(min(_POLL_S, max(0.0, deadline_s - time.monotonic())))

    def answer(self, request: Request) -> Answer:
        """Return the service's answer.

        Raises:
            NotTakenError: the service didn't take the request.
            NoTimeError: it gave no whole answer in time.
            PeerError: there is no answer, for the reason that it says.
            InputError: the interface's prompt can't ask what the task asks.
        """
        deadline_s = time.monotonic() + self.timeout_s
        if not self._one_at_a_time.acquire(timeout=self.timeout_s):
            raise NoTimeError(self._text("the request before this one isn't answered yet"))
        try:
            if not self._ready:
                self._require_ready(min(_HEALTH_S, _left_s(deadline_s)))
            with part(ENCODING):
                value = request_to_json(request, native_prompt(self.interface, request))
                body = json.dumps(value, allow_nan=False).encode()
            reply = self._ask(body, deadline_s)
            with part(PARSING):
                answer = self._answer(reply, request.request_id)
        finally:
            self._one_at_a_time.release()
        self.model_id = answer.model_id
        return answer.answer

    def _require_ready(self, timeout_s: float) -> None:
        reply = self._exchange("/health", None, timeout_s)
        health = self._read(reply, "/health", health_from_json)
        self._refuse_key([health.model_id, health.detail])
        self.model_id = health.model_id
        if not health.ready:
            detail = self._short(health.detail)
            raise NotTakenError(self._text(f"the service isn't ready yet ({detail})"))
        self._ready = True

    def _ask(self, body: bytes, deadline_s: float) -> HttpReply:
        wait_s = _FIRST_WAIT_S
        for tried in range(1, self.tries + 1):
            try:
                reply = self._exchange("/answer", body, _left_s(deadline_s))
                if reply.retry_after_s is None:
                    return reply
                pause_s = reply.retry_after_s
                reason = self._text(f"the service is busy ({reply.status})")
            except NotTakenError as error:
                self._ready = False
                pause_s, reason = wait_s, str(error)
            if tried == self.tries or time.monotonic() + pause_s >= deadline_s:
                break
            time.sleep(pause_s)
            wait_s *= 2.0
        raise NotTakenError(f"{reason}, {tried} tries")

    def _answer(self, reply: HttpReply, request_id: str) -> ServiceAnswer:
        answer = self._read(reply, "/answer", answer_from_json)
        if answer.request_id != request_id:
            answer_id = self._short(answer.request_id)
            raise PeerError(self._text(f"the answer is for another request ({answer_id!r})"))
        names = [(array.name, array.frame, array.unit) for array in answer.arrays]
        self._refuse_key([answer.model_id, answer.text, dict(answer.decoding), names])
        return answer

    def _refuse_key(self, contents: list[Any]) -> None:
        """Refuse to store an answer that holds the key, which the service may have repeated."""
        if gives_away(json.dumps(contents).encode(), self.key):
            raise PeerError(self._text("the answer repeats the key, and isn't kept"))

    # -- one exchange --------------------------------------------------------------------------

    def _exchange(self, path: str, body: bytes | None, timeout_s: float) -> HttpReply:
        """Send a request and read the whole reply.

        Args:
            path: of the endpoint, under the service's address.
            body: JSON to post; None: the request is a GET.
            timeout_s: for everything, from connecting to the last byte.

        Raises:
            NotTakenError: the connection was refused.
            NoTimeError: it wasn't done in time.
            PeerError: it failed otherwise, after the service may have taken the request.
        """
        kind: type[PeerError] = PeerError
        try:
            return asyncio.run(self._talk(path, body, timeout_s))
        except TimeoutError:
            kind, reason = NoTimeError, f"no whole answer within {round(timeout_s, 2):g} s"
        except aiohttp.ClientConnectorError as error:
            reason = f"the service can't be reached ({error})"
            if error.os_error.errno == errno.ECONNREFUSED:
                kind, reason = NotTakenError, "no program listens there (connection refused)"
        except aiohttp.ServerDisconnectedError:
            reason = "the service closed the connection without an answer"
        except aiohttp.ClientPayloadError:
            reason = "the service closed the connection within its answer"
        except aiohttp.ClientResponseError as error:
            reason = f"the service doesn't speak HTTP ({error.message})"
        except _TooLargeError:
            reason = f"the answer is larger than {self.max_bytes / (1 << 20):g} MiB"
        except (aiohttp.ClientError, OSError, ValueError) as error:
            reason = f"the exchange failed ({type(error).__name__}: {error})"
        raise kind(self._text(reason))

    async def _talk(self, path: str, body: bytes | None, timeout_s: float) -> HttpReply:
        headers = {"Accept": "application/json", "Accept-Encoding": "identity"}
        if self.key is not None:
            headers["Authorization"] = f"Bearer {self.key}"
        if body is not None:
            headers["Content-Type"] = "application/json"
        session = aiohttp.ClientSession(
            connector=aiohttp.TCPConnector(force_close=True),
            cookie_jar=aiohttp.DummyCookieJar(),
            timeout=aiohttp.ClientTimeout(total=None, sock_connect=None),
            auto_decompress=False,
            trust_env=False,  # it would also read passwords from ~/.netrc
        )
        method, url = "GET" if body is None else "POST", self.url + path
        options: dict[str, Any] = {"allow_redirects": False, "proxy": self._proxy}
        async with (
            asyncio.timeout(timeout_s),
            session,
            session.request(method, url, data=body, headers=headers, **options) as response,
        ):
            if (response.content_length or 0) > self.max_bytes:
                raise _TooLargeError
            read = bytearray()
            async for chunk in response.content.iter_any():
                read += chunk
                if len(read) > self.max_bytes:
                    raise _TooLargeError
            reply_headers = {name.lower(): value for name, value in response.headers.items()}
            return HttpReply(response.status, reply_headers, bytes(read))

    def _read(self, reply: HttpReply, path: str, read: Callable[[Any], Read]) -> Read:
        """Read a reply; raise PeerError for one that isn't of the exchange."""
        self._check_status(reply, path)
        try:
            return read(parse_json(reply.body))
        except InputError as error:
            what = "the answer" if path == "/answer" else path
            begins = ""
            if reply.body.lstrip()[:1] != b"{":
                kind = self._short(reply.headers.get("content-type", "no content type"))
                begins = f" ({kind}, begins with {self._failure_text(reply.body)[:40]!r})"
            where = f"{error.field}: " if error.field else ""
            is_printable = error.value is not None and self.key is None
            value_text = f" (got {error.value!r})" if is_printable else ""
            problem = self._short(error.problem + value_text)
            raise PeerError(
                self._text(f"{what} can't be read{begins}: {where}{problem}")
            ) from error

    def _check_status(self, reply: HttpReply, path: str) -> None:
        status = reply.status
        if status in (401, 403):
            remedy = "name the environment variable that holds it with api_key_env"
            if self.key is not None:
                remedy = f"the one in {self.key_name} isn't accepted"
            raise _Final(self._text(f"the service asks for a key ({status}); {remedy}"))
        if 300 <= status < 400:
            to = self._short(reply.headers.get("location", "nowhere"))
            raise _Final(self._text(f"redirects {path} to {to} ({status}); give that as url"))
        if status != 200:
            error = _Final if status == 404 else PeerError
            raise error(self._text(f"{path} says {status}: {self._failure_text(reply.body)}"))
        encoding = reply.headers.get("content-encoding", "identity")
        if encoding != "identity":
            raise PeerError(self._text(f"{path} is compressed ({self._short(encoding)}), unasked"))

    def _failure_text(self, body: bytes) -> str:
        """Return the service's description of its failure, ``{"error": …}`` or any text."""
        with suppress(InputError):
            value = parse_json(body)
            if isinstance(value, dict) and isinstance(value.get("error"), str):
                return self._short(value["error"])
        return self._short(body.decode("utf-8", "replace"))

    def _text(self, reason: str) -> str:
        return redact(f"{self.url}: {reason}", self.key)

    def _short(self, text: str) -> str:
        """Return one printable line without the key; cut before, as it may be large, and after."""
        text = redact(text[: 4 * _SHOWN], self.key)
        line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
        return line if len(line) <= _SHOWN else line[: _SHOWN - 1] + "…"


class _TooLargeError(Exception):
    """More came than may."""


def _left_s(deadline_s: float) -> float:
    return max(0.001, deadline_s - time.monotonic())


OPTIONS: dict[str, type] = {
    "url": str,
    "interface": str,
    "timeout_s": float,
    "start_s": float,
    "api_key_env": str,
    "max_mb": float,
    "tries": int,
}


def make(
    options: Mapping[str, Any], name: str = "http", defaults: Mapping[str, Any] | None = None
) -> HttpService:
    """Make a model behind HTTP, for the options in OPTIONS; wait for it at most ``start_s``.

    Raises:
        InputError: the options are wrong.
    """
    check_options(name, options, OPTIONS)
    settings = {"interface": "waypoints", **(defaults or {}), **options}
    if "url" not in settings:
        raise InputError(
            "is missing",
            field="backend_options.url",
            remedy="give the service's address, such as http://127.0.0.1:8300",
        )
    service = HttpService(
        url=address_option(settings["url"], "url", "http://127.0.0.1:8300"),
        interface=find_interface(settings["interface"]).name,
        key=key_option(settings),
        key_name=settings.get("api_key_env", ""),
        max_bytes=round(number_option(settings, "max_mb", 16.0, 0.001, 1024.0) * (1 << 20)),
        timeout_s=number_option(settings, "timeout_s", 60.0, 0.001, 86400.0),
        start_s=number_option(settings, "start_s", 20.0, 0.0, 86400.0),
        tries=int(number_option(settings, "tries", 3, 1, 100)),
    )
    service.wait_ready()
    return service


def make_llavida(options: Mapping[str, Any]) -> HttpService:
    """Make the backend ``http`` with LLaViDA's interface, its sidecar's port and more patience."""
    defaults = {"interface": "llavida", "url": "http://127.0.0.1:8302", "timeout_s": 120.0}
    return make(options, "llavida", defaults)


def make_alpamayo(options: Mapping[str, Any]) -> HttpService:
    """Make the backend ``http`` with Alpamayo's interface, its sidecar's port and more patience."""
    defaults = {"interface": "alpamayo", "url": "http://127.0.0.1:8301", "timeout_s": 120.0}
    return make(options, "alpamayo", defaults)


def _proxy(url: str) -> str | None:
    parts = urlsplit(url)
    host = parts.hostname or ""
    with suppress(ValueError):
        if ipaddress.ip_address(host).is_loopback:
            return None
    if host == "localhost" or host.endswith(".localhost") or urllib.request.proxy_bypass(host):
        return None
    return urllib.request.getproxies().get(parts.scheme)
