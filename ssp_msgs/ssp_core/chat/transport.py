"""One request to a chat service and its result: no retries, no exceptions.

The library under it follows no redirect (the key must not leave with one), takes no key, name or
address from the environment, and keeps no connection, so that an idle one that the server closes
can't be mistaken for a lost answer. Time and size of the reply are bounded whatever its status,
headers and compression are.
"""

from __future__ import annotations

import asyncio
import functools
import math
import ssl
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import openai

_SENT_HEADERS = frozenset(
    {"authorization", "host", "content-type", "content-length", "accept", "user-agent"}
)
_OF_THE_BODY = frozenset({"content-encoding", "content-length", "transfer-encoding"})
_CONNECT_S = 5.0
_ERROR_BYTES = 1 << 16  # of a reply that is an error; the rest is not read


class Failure(Enum):
    """The reason why there is no reply, by the cost of a second request.

    UNREACHABLE: no connection, so nothing was asked.
    LOST: it was asked; a whole reply didn't come, though it may have been made.
    LATE: the same, and the time that it had is over.
    TOO_LARGE: the reply exceeds the limit, and would again.
    UNSENDABLE: no request can be made of this.
    """

    UNREACHABLE = "unreachable"
    LOST = "lost"
    LATE = "late"
    TOO_LARGE = "too_large"
    UNSENDABLE = "unsendable"


@dataclass(frozen=True)
class RawReply:
    """A reply.

    Args:
        headers: names in lower case.
        body: uncompressed; of an error status its first 64 KiB.
    """

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True)
class FailedRequest:
    """No reply, and why, for people."""

    failure: Failure
    reason: str


def exchange(
    base_url: str, key: str, request: Mapping[str, Any], limit_s: float, max_bytes: int
) -> RawReply | FailedRequest:
    """Post one chat completion and take the whole reply.

    Only a name lookup may take longer than the limit: the system's resolver can't be interrupted.

    Args:
        base_url: up to and with ``/v1``.
        key: sent as the bearer's.
        request: JSON values.
        limit_s: for connection, request and reply together, s.
        max_bytes: of an answer, both as sent and uncompressed; a larger one fails.
    """
    return asyncio.run(_exchange(base_url, key, request, limit_s, max_bytes))


async def _exchange(
    base_url: str, key: str, request: Mapping[str, Any], limit_s: float, max_bytes: int
) -> RawReply | FailedRequest:
    silent = FailedRequest(Failure.LATE, f"no whole answer within {round(limit_s, 2):g} s")
    timeout = openai.Timeout(limit_s, connect=min(_CONNECT_S, limit_s))
    try:
        async with (
            asyncio.timeout(limit_s),
            _BoundedTransport(max_bytes, timeout=timeout) as http,
            openai.AsyncOpenAI(
                base_url=base_url, api_key=key, max_retries=0, timeout=timeout, http_client=http
            ) as client,
        ):
            fields = dict(request)
            reply = await client.chat.completions.with_raw_response.create(
                model=fields.pop("model"), messages=fields.pop("messages"), extra_body=fields
            )
            return _received(reply.http_response)
    except openai.APIStatusError as error:
        return _received(error.response)
    except (TimeoutError, openai.APITimeoutError) as error:
        # A connection that isn't made has a timeout of its own, whose type says so.
        if type(error.__cause__).__name__ == "ConnectTimeout":
            return FailedRequest(Failure.UNREACHABLE, "the server can't be reached (no connection)")
        return silent
    except (openai.APIConnectionError, _TooLarge, _Undecodable) as error:
        return _broken(error)
    except Exception as error:  # a value that JSON, HTTP or the library can't take
        return FailedRequest(
            Failure.UNSENDABLE, f"the request can't be made ({_error_name(error)})"
        )


def _received(response: Any) -> RawReply:
    headers = {name.lower(): value for name, value in response.headers.items()}
    return RawReply(response.status_code, headers, response.content)


def _broken(error: Exception) -> FailedRequest:
    cause = (error.__cause__ or error) if isinstance(error, openai.APIConnectionError) else error
    if isinstance(cause, _TooLarge):
        return FailedRequest(Failure.TOO_LARGE, str(cause))
    if isinstance(cause, _Undecodable):
        return FailedRequest(Failure.LOST, f"the answer can't be decompressed ({cause})")
    # By name, as the HTTP library is not ours to import.
    if type(cause).__name__ in ("ConnectError", "ConnectTimeout", "ProxyError"):
        return FailedRequest(
            Failure.UNREACHABLE, f"the server can't be reached ({_error_name(cause)})"
        )
    if type(cause).__name__ in ("UnsupportedProtocol", "LocalProtocolError", "InvalidURL"):
        return FailedRequest(
            Failure.UNSENDABLE, f"the request can't be made ({_error_name(cause)})"
        )
    reason = f"the connection broke off before the answer was whole ({_error_name(cause)})"
    return FailedRequest(Failure.LOST, reason)


def _error_name(error: BaseException) -> str:
    return str(error) or type(error).__name__


class _TooLarge(Exception):
    """The reply exceeds the limit."""


class _Undecodable(Exception):
    """The reply isn't compressed as it says."""


@functools.cache
def _tls() -> ssl.SSLContext:
    """Return the system's certificates, or those of SSL_CERT_FILE; loading them takes a while."""
    return ssl.create_default_context()


class _BoundedTransport(openai.DefaultAsyncHttpxClient):
    """Sends no header that we don't mean to send, and reads no more than it must.

    Args:
        options: of the HTTP library's client.
    """

    def __init__(self, max_bytes: int, **options: Any) -> None:
        super().__init__(follow_redirects=False, verify=_tls(), **options)
        self._max_bytes = max_bytes

    async def send(self, request: Any, **options: Any) -> Any:
        headers = {k: v for k, v in request.headers.items() if k.lower() in _SENT_HEADERS}
        # A gateway may compress all the same, which _plain undoes within bounds.
        headers |= {"accept-encoding": "identity", "connection": "close"}
        sent = type(request)(
            request.method,
            request.url,
            headers=headers,
            content=request.content,
            extensions=request.extensions,
        )
        options.update(stream=True, follow_redirects=False)
        response = await super().send(sent, **options)
        try:
            body = await self._read(response, response.headers.get("content-encoding", ""))
        finally:
            await response.aclose()
        left = {k: v for k, v in response.headers.items() if k.lower() not in _OF_THE_BODY}
        return type(response)(response.status_code, headers=left, content=body, request=request)

    async def _read(self, response: Any, coding: str) -> bytes:
        fine = response.status_code == 200
        limit = self._max_bytes if fine else _ERROR_BYTES
        raw = bytearray()
        async for chunk in response.aiter_raw():
            raw += chunk
            if len(raw) > limit:
                break
        body = _plain(bytes(raw[: limit + 1]), coding.strip().lower(), limit, fine)
        if fine and max(len(raw), len(body)) > limit:
            raise _TooLarge(f"the answer is larger than {limit >> 10} KiB")
        return body[:limit]


def _plain(raw: bytes, coding: str, limit: int, whole: bool) -> bytes:
    """Return the bytes uncompressed, one more than the limit where there are more.

    Raises:
        _Undecodable: they aren't what the coding says, or end too early where the whole is wanted.
    """
    if coding in ("", "identity"):
        return raw
    if coding not in ("gzip", "x-gzip", "deflate"):
        raise _Undecodable(f"its content coding is {coding[:40]!r}")
    try:
        window_bits = zlib.MAX_WBITS | (32 if "gzip" in coding else 0)
        unpacker = zlib.decompressobj(window_bits)
        body = unpacker.decompress(raw, limit + 1)
    except zlib.error as error:
        raise _Undecodable(str(error)) from error
    if whole and not unpacker.eof and len(body) <= limit and len(raw) <= limit:
        raise _Undecodable("it ends too early")
    return body


def retry_after_s(headers: Mapping[str, str]) -> float | None:
    """Return the seconds that the server asks to wait; None: it says nothing, or a date."""
    try:
        seconds = float(headers.get("retry-after", "-1"))
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and seconds >= 0 else None
