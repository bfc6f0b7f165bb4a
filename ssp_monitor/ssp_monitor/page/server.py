"""The web server of the operators' page: its files, its commands, and the viewers' connections."""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import socket as sockets
import threading
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import asdict, dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Protocol

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from ssp_core import names
from ssp_core.addresses import resolve
from ssp_core.errors import HostError
from ssp_core.files.strict_json import parse_strict
from ssp_monitor.page.access import AccessRules, TokenBucket, bearer, same_token
from ssp_monitor.page.viewers import Hub, Payload
from ssp_monitor.status.board import Answer, StateOnPage

FOLDER = Path(__file__).parent / "static"
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}


@dataclass(frozen=True, slots=True)
class Asset:
    """One file as it goes out."""

    body: bytes
    content_type: str


def load_assets(folder: Path = FOLDER) -> dict[str, Asset]:
    """Return the files by the path under which they are served; ``/`` is the page.

    Raises:
        HostError: the installation lacks the page.
    """
    assets = {
        f"/{path.name}": Asset(path.read_bytes(), _TYPES[path.suffix])
        for path in sorted(folder.glob("*"))
        if path.suffix in _TYPES
    }
    if "/index.html" not in assets:
        raise HostError(f"{folder} has no index.html: this installation lacks the operators' page")
    assets["/"] = assets.pop("/index.html")
    return assets


ANSWER_S = 3.0
# Shorter than the page's own patience, so that it learns who it was that said nothing.
ABORT_ANSWER_S = 1.0
# Room for a picture: what the kernel holds is old when it comes.
SEND_BUFFER_BYTES = 65536
MOST_BODY_BYTES = 1024
START_S = 10.0
# An ended page that is asked to leave its port does so within this time.
LEAVE_S = 3.0
# What sends no whole request for so long is closed.
REQUEST_S = 10.0
# A press counts for so long from when its server made what was shown; as long as a typed word.
PRESS_S = 10.0
LEAVE = "/api/leave"
RETIRED = "the run has ended, and its processes with it: if anything moves, use the emergency stop"
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def _is_ours(record: logging.LogRecord) -> bool:
    """Tell whether a log record is more than the answer to a stranger's bad request."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, (HttpProcessingError, web.RequestPayloadError))


_LOG = logging.getLogger("ssp.page")
_LOG.addFilter(_is_ours)


class Commands(Protocol):
    """The way of commands to the manager."""

    def ask(self, command: str, who: str, state_on_page: StateOnPage | None) -> Future[Answer]:
        """Send one of names.SESSION_COMMANDS; may be called in any thread.

        Args:
            command: its name.
            who: where it comes from, for the record.
            state_on_page: state for which it was pressed; None for an abort, which counts in each.
        """


class PageServer:
    """Serves the page, its data and its commands.

    Args:
        host: to bind to.
        port: to listen on; 0: any.

    Raises:
        HostError: the port is taken, or the address isn't this machine's.
    """

    def __init__(self, host: str, port: int, token: str, commands: Commands) -> None:
        self._commands = commands
        self._assets = load_assets()
        self._listener = _listen_on(host, port)
        own_names = (sockets.gethostname().lower(), sockets.getfqdn().lower())
        self.door = AccessRules(host, self._listener.getsockname()[1], token, own_names)
        self._hub = Hub(self.door)
        # Whoever has the token may abort whatever others do; both are bounded all the same.
        self._buckets = {"abort": TokenBucket(40, 20), "": TokenBucket(20, 5)}
        self._guesses = TokenBucket(10, 1)
        self._retired = False
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page_server", daemon=True)
        self._thread.start()
        if not self._ready.wait(START_S) or not self._thread.is_alive():
            raise HostError("the page's server did not start")

    @property
    def url(self) -> str:
        """Return its address, without the token."""
        host = (
            f"[{self.door.bind_address}]"
            if ":" in self.door.bind_address
            else self.door.bind_address
        )
        return f"http://{host}:{self.door.port}/"

    @property
    def viewers(self) -> int:
        return self._hub.viewers

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def push(self, payloads: dict[str, Payload]) -> None:
        """Send new things to all viewers; may be called in any thread."""
        self._call(self._hub.push, payloads)

    def retire(self) -> None:
        """Stop passing commands on, and leave the port to the page of another run."""
        self._retired = True

    def close(self) -> None:
        """End connections and thread."""
        if self._thread.is_alive():
            self._call(self._stop.set)
            self._thread.join(5.0)

    def _call(self, what: Callable[..., object], *arguments: object) -> None:
        """Have the server's thread call something; without effect once it has ended."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(what, *arguments)

    # -- in the server's thread ------------------------------------------------------------------

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._ready.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        app = web.Application(middlewares=[self._guard], client_max_size=MOST_BODY_BYTES)
        app.router.add_get("/api/live", self._hub.serve)
        app.router.add_post("/api/command/{name}", self._command)
        app.router.add_post(LEAVE, self._leave)
        app.router.add_get("/{name:.*}", self._asset)
        runner = web.AppRunner(
            app,
            access_log=None,
            shutdown_timeout=1.0,
            logger=_LOG,
            keepalive_timeout=REQUEST_S,
            lingering_time=1.0,
        )
        await runner.setup()
        await web.SockSite(runner, self._listener).start()
        self._ready.set()
        await self._stop.wait()
        await self._hub.close()
        await runner.cleanup()

    @web.middleware
    async def _guard(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        host = request.headers.get("Host", "")
        headers = request.headers
        if not self.door.knows_host(host):
            raise _refusal(403, "this Host is not the page's")
        asks = request.method != "GET" or request.path.startswith("/api/")
        if asks and not self.door.knows_origin(
            headers.get("Origin"), host, headers.get("Sec-Fetch-Site")
        ):
            raise _refusal(403, "this Origin is not the page's")
        try:
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(_headers(host))
            raise
        if not response.prepared:
            response.headers.update(_headers(host))
        return response

    async def _asset(self, request: web.Request) -> web.StreamResponse:
        if request.path == "/favicon.ico":  # browsers ask, and would call the page's lack an error
            return web.Response(status=204)
        asset: Asset | None = self._assets.get(request.path)
        if asset is None:
            raise web.HTTPNotFound(text="there is no such page")
        return web.Response(body=asset.body, content_type=asset.content_type, charset="utf-8")

    async def _command(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        now_ns = time.monotonic_ns()
        if name != "abort" and (refused := self._stranger(request, now_ns)) is not None:
            return refused
        if name not in names.SESSION_COMMANDS:
            return _answer(404, Answer(False, f"there is no command {name[:20]}"))
        if not self._buckets.get(name, self._buckets[""]).take(now_ns):
            return _answer(429, Answer(False, "too many commands at once; wait a second"))
        state_on_page = None
        if name != "abort":  # of an abort the head alone counts, whatever follows it
            try:  # bounded by client_max_size
                body = await asyncio.wait_for(request.read(), REQUEST_S)
                state_on_page = _state_on_page(body)
            except TimeoutError:
                return _closing(408, "the request did not end")
            except (web.RequestPayloadError, HttpProcessingError, ConnectionError):
                return _closing(400, "the request's body can't be read")
            except ValueError as error:
                return _answer(400, Answer(False, f"not sent: {error}; load the page again"))
        if self._retired:
            return _answer(200, Answer(False, RETIRED))
        if state_on_page is not None and (late := _late(state_on_page, time.monotonic_ns())):
            return _answer(200, Answer(False, late))
        limit_s = ABORT_ANSWER_S if name == "abort" else ANSWER_S
        pending_answer = self._commands.ask(
            name, f"operator page at {request.remote}", state_on_page
        )
        try:
            answer = await asyncio.wait_for(asyncio.wrap_future(pending_answer), limit_s)
        except TimeoutError:
            text = f"the scenario manager gave no answer within {limit_s:g} s"
            return _answer(504, Answer(False, text, answered=False))
        return _answer(200 if answer.answered else 504, answer)

    def _stranger(self, request: web.Request, now_ns: int) -> web.StreamResponse | None:
        """Refuse a request without the page's token; None: it has it. ABORT needs none."""
        token = bearer(request.headers.get("Authorization"))
        if not token:
            return _answer(401, Answer(False, "no token: open the page by the URL it was given"))
        if same_token(token, self.door.token):
            return None
        if not self._guesses.take(now_ns):
            return _answer(429, Answer(False, "too many wrong tokens; wait a second"))
        return _answer(403, Answer(False, "wrong token: open the page by its present URL"))

    async def _leave(self, _request: web.Request) -> web.StreamResponse:
        """Leave the port, if the run has ended: the page of the next run asks for it."""
        if not self._retired:
            return web.Response(status=409, text="this page's run goes on")
        # After the answer.
        self._loop.call_later(0.05, self._stop.set)
        return web.Response(text="leaves")


def _state_on_page(body: bytes) -> StateOnPage:
    """Return the state that the page showed. Raise ValueError where its request doesn't say."""
    fields = parse_strict(body)
    return StateOnPage.parse(fields.get("shown") if isinstance(fields, dict) else None)


def _late(state_on_page: StateOnPage, now_ns: int) -> str:
    """Give the reason why a press came too late, as over a link that was down; empty: it didn't."""
    age_s = (now_ns - state_on_page.made_ns) / 1e9
    if 0.0 <= age_s <= PRESS_S:
        return ""
    if age_s < 0.0:
        return "not sent: the page dates from before this computer restarted; load it again"
    return (
        f"not sent: pressed for what the page showed {age_s:.0f} s ago, limit {PRESS_S:g} s: look "
        "again, then press again"
    )


def _answer(status: int, answer: Answer) -> web.Response:
    return web.json_response(asdict(answer), status=status)


def _closing(status: int, text: str) -> web.Response:
    answer = _answer(status, Answer(False, text))
    answer.force_close()
    return answer


def _refusal(status: int, text: str) -> web.HTTPException:
    error = web.HTTPForbidden(text=json.dumps({"accepted": False, "text": text}))
    error.content_type = "application/json"
    error.set_status(status)
    return error


def _headers(host: str) -> dict[str, str]:
    """Return headers that allow nothing from elsewhere, nothing inline, no frame and no cache."""
    return {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
            f"connect-src 'self' ws://{host}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }


def _listen_on(host: str, port: int) -> sockets.socket:
    """Open a listening socket, so that a taken port is known at once."""
    remedy = "choose another with port, or 0 for any"
    try:
        family, _, _, _, address = resolve(host, port, sockets.SOCK_STREAM, sockets.AI_PASSIVE)[0]
    except (HostError, OverflowError) as error:
        raise HostError(f"{host}:{port} is no address to listen on: {error}") from error
    listener = sockets.socket(family, sockets.SOCK_STREAM)
    try:
        listener.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        listener.setsockopt(sockets.SOL_SOCKET, sockets.SO_SNDBUF, SEND_BUFFER_BYTES)
        try:
            listener.bind(address)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or not _is_left(host, port):
                raise
            listener.bind(address)
        listener.listen(64)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise HostError(f"port {port} of {host} is taken; {remedy}") from error
        raise HostError(f"the page can't listen on {host}:{port}: {error.strerror}") from error
    listener.setblocking(False)
    return listener


def _is_left(host: str, port: int) -> bool:
    """Tell whether a page whose run has ended held the port, and has left it."""
    name = host if host else "127.0.0.1"
    deadline = time.monotonic() + LEAVE_S
    with suppress(OSError, HTTPException):
        asking = HTTPConnection(name, port, timeout=LEAVE_S)
        try:
            asking.request("POST", LEAVE)
            if asking.getresponse().status != 200:
                return False
        finally:
            asking.close()
        while time.monotonic() < deadline:
            try:
                sockets.create_connection((name, port), LEAVE_S).close()
            except ConnectionRefusedError:
                return True
            time.sleep(0.02)
    return False
