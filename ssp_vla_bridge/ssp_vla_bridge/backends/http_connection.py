"""One exchange over HTTP with a service that nobody trusts: in a total time, of a bounded size."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

import aiohttp

from ssp_core.errors import InputError


class RefusedError(Exception):
    """Nobody listens there: the request was not taken, so that it may be sent again."""


class BrokenError(Exception):
    """The exchange failed after the service may have taken the request; says how."""


class LateError(BrokenError):
    """The exchange wasn't done in time."""


@dataclass(frozen=True)
class HttpReply:
    """What came back.

    Args:
        status: of HTTP.
        headers: by lower-case name.
        body: as it came.
    """

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def retry_after_s(self) -> float | None:
        """What the service asks for, in seconds; None where it says nothing, or a date."""
        text = self.headers.get("retry-after", "")
        return float(text) if text.isascii() and text.isdigit() and len(text) < 7 else None


class HttpConnection:
    """The way to one service: no redirects, no cookies, no compression, no kept connections.

    A connection serves one exchange, so that what a service sends unasked, or too late, can't be
    taken for the answer to the next request. Proxies of the environment are used for services on
    other machines only.

    Args:
        url: with scheme and host; paths are put behind it.
        headers: sent with each request.
        max_bytes: of one body.

    Raises:
        InputError: the address isn't one of HTTP, or has a password in it.
    """

    def __init__(self, url: str, headers: Mapping[str, str], max_bytes: int) -> None:
        self.url = _checked(url)
        self._headers = {**headers, "Accept": "application/json", "Accept-Encoding": "identity"}
        self._max_bytes = max_bytes
        self._proxy = _proxy(self.url)

    def exchange(self, path: str, body: bytes | None, timeout_s: float) -> HttpReply:
        """Sends a request and reads the whole reply.

        Args:
            path: behind the address.
            body: JSON to post; None: gets.
            timeout_s: for everything, from connecting to the last byte.

        Raises:
            RefusedError: the connection was refused.
            LateError: it wasn't done in time.
            BrokenError: anything else went wrong.
        """
        try:
            return asyncio.run(self._within(path, body, timeout_s))
        except TimeoutError:
            raise LateError(f"no whole answer within {round(timeout_s, 2):g} s") from None
        except aiohttp.ClientConnectorError as error:
            if error.os_error.errno == errno.ECONNREFUSED:
                raise RefusedError("nobody listens there (connection refused)") from error
            raise BrokenError(f"the service can't be reached ({error})") from error
        except aiohttp.ServerDisconnectedError as error:
            raise BrokenError("the service closed the connection without an answer") from error
        except aiohttp.ClientPayloadError as error:
            raise BrokenError("the service closed the connection within its answer") from error
        except aiohttp.ClientResponseError as error:
            raise BrokenError(f"the service doesn't speak HTTP ({error.message})") from error
        except (aiohttp.ClientError, OSError, ValueError) as error:
            raise BrokenError(f"the exchange failed ({type(error).__name__}: {error})") from error

    async def _within(self, path: str, body: bytes | None, timeout_s: float) -> HttpReply:
        async with asyncio.timeout(timeout_s):
            return await self._talk(path, body)

    async def _talk(self, path: str, body: bytes | None) -> HttpReply:
        headers = dict(self._headers)
        if body is not None:
            headers["Content-Type"] = "application/json"
        session = aiohttp.ClientSession(
            connector=aiohttp.TCPConnector(force_close=True),
            cookie_jar=aiohttp.DummyCookieJar(),
            timeout=aiohttp.ClientTimeout(total=None, sock_connect=None),
            auto_decompress=False,
            trust_env=False,  # it would also read passwords from ~/.netrc
        )
        async with (
            session,
            session.request(
                "GET" if body is None else "POST",
                self.url + path,
                data=body,
                headers=headers,
                allow_redirects=False,
                proxy=self._proxy,
            ) as response,
        ):
            if (response.content_length or 0) > self._max_bytes:
                raise self._too_large()
            read = bytearray()
            async for chunk in response.content.iter_any():
                read += chunk
                if len(read) > self._max_bytes:
                    raise self._too_large()
            named = {name.lower(): value for name, value in response.headers.items()}
            return HttpReply(response.status, named, bytes(read))

    def _too_large(self) -> BrokenError:
        return BrokenError(f"the answer is larger than {self._max_bytes / (1 << 20):g} MiB")


def is_loopback(host: str) -> bool:
    """True for names and addresses of this machine's own loopback."""
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _checked(url: str) -> str:
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise _refused(f"is no address: {error}", url) from error
    if "@" in parts.netloc:
        raise InputError(
            "has a user or password in it, which would be stored with the results",
            field="backend_options.url",
            remedy="put the key into an environment variable and name that with api_key_env",
        )
    plain = url.isascii() and url.isprintable() and " " not in url
    if parts.scheme not in ("http", "https") or not host or not plain:
        raise _refused("is no address of HTTP", url)
    if parts.query or parts.fragment or url.endswith(("?", "#")):
        raise _refused("must end with its path", url)
    return url.rstrip("/")


def _refused(problem: str, url: str) -> InputError:
    remedy = "give one such as http://127.0.0.1:8300"
    return InputError(problem, field="backend_options.url", value=url, remedy=remedy)


def _proxy(url: str) -> str | None:
    parts = urlsplit(url)
    host = parts.hostname or ""
    if is_loopback(host) or urllib.request.proxy_bypass(host):
        return None
    return urllib.request.getproxies().get(parts.scheme)
