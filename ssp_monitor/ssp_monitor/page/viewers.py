"""The viewers that are connected, and what is pushed to each: of every kind only the newest."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from aiohttp import WSMsgType, web

from ssp_monitor.page.access import AccessRules, TokenBucket, same_token

Payload = str | bytes


class Mailbox:
    """One slot per kind of message; must be used in one event loop."""

    def __init__(self) -> None:
        self._slots: dict[str, Payload] = {}
        self._filled = asyncio.Event()
        self.filled_ns = 0

    def put(self, kind: str, payload: Payload) -> None:
        """Put in the newest of its kind; drop an older one that wasn't fetched."""
        self._slots[kind] = payload
        self.filled_ns = time.monotonic_ns()
        self._filled.set()

    async def take(self) -> Mapping[str, Payload]:
        """Take all there is, as soon as there is something."""
        await self._filled.wait()
        self._filled.clear()
        payloads, self._slots = self._slots, {}
        return payloads


MOST_VIEWERS = 12
# Sockets that haven't said who they are yet.
MOST_STRANGERS = 8
# A viewer says who it is within this time, and takes what it is sent within that one.
HELLO_S = 5.0
SEND_S = 5.0
# What was sent must be confirmed within this time. Kernels and tunnels buffer far more than one
# bundle: only a viewer's own word tells that what it sees is new.
ECHO_S = 5.0
MOST_BYTES = 2048
# A viewer that is gone without a word is noticed after one and a half of this.
PING_S = 5.0
# How long a viewer may take to confirm that the connection ends; then it is cut.
CLOSE_S = 2.0
# What a new viewer gets at once. A snapshot or a picture that nobody looked at may be hours old.
_KEPT = ("site", "events")
_TOO_MANY = 4008
_REFUSED = 4001
_MALFORMED = 4002
_NO_ECHO = 4009


class Hub:
    """Sends everybody the newest of each kind; lives in the server's event loop."""

    def __init__(self, door: AccessRules) -> None:
        self._door = door
        self._newest: dict[str, Payload] = {}
        self._boxes: set[Mailbox] = set()
        self._viewers: set[web.WebSocketResponse] = set()
        self._strangers: set[web.WebSocketResponse] = set()
        self._guesses = TokenBucket(10, 1)

    @property
    def viewers(self) -> int:
        return len(self._viewers)

    def push(self, payloads: dict[str, Payload]) -> None:
        """Send new things, by kind, to all viewers."""
        self._newest.update({k: payloads[k] for k in _KEPT if k in payloads})
        for box in self._boxes:
            for kind, payload in payloads.items():
                box.put(kind, payload)

    async def close(self) -> None:
        """Say goodbye to all viewers."""
        for socket in [*self._viewers, *self._strangers]:
            with suppress(Exception):
                await asyncio.wait_for(socket.close(code=1001, message=b"the page ends"), 1.0)

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Serve one viewer, from its hello to its end."""
        if len(self._strangers) >= MOST_STRANGERS:
            return web.Response(status=503, text="too many unknown viewers; try again in a moment")
        if len(self._viewers) >= MOST_VIEWERS:
            return web.Response(status=503, text=f"{MOST_VIEWERS} viewers are connected, no more")
        socket = web.WebSocketResponse(
            max_msg_size=MOST_BYTES, compress=False, heartbeat=PING_S, timeout=CLOSE_S
        )
        self._strangers.add(socket)
        try:
            await socket.prepare(request)
            if await self._welcome(socket):
                await self._feed(socket)
        finally:
            self._strangers.discard(socket)
            self._viewers.discard(socket)
        return socket

    async def _welcome(self, socket: web.WebSocketResponse) -> bool:
        """Take the hello and answer it; return False if this viewer may not even read."""
        try:
            message = await asyncio.wait_for(socket.receive(), HELLO_S)
            token = _token_of(message.data) if message.type is WSMsgType.TEXT else None
        except TimeoutError:
            token = None
        if token is None:
            self._guesses.take(time.monotonic_ns())
            await socket.close(code=_MALFORMED, message=b"the first message must be a hello")
            return False
        right = bool(token) and same_token(token, self._door.token)
        if token and not right and not self._guesses.take(time.monotonic_ns()):
            await socket.close(code=_REFUSED, message=b"too many wrong tokens; wait a second")
            return False
        why = "" if right else "wrong token" if token else "no token"
        await _send(
            socket,
            json.dumps({"type": "welcome", "may_command": right, "why": why}),
        )
        if right or self._door.open_to_read:
            if len(self._viewers) >= MOST_VIEWERS:
                await socket.close(code=_TOO_MANY, message=b"too many viewers are connected")
                return False
            self._strangers.discard(socket)
            self._viewers.add(socket)
            return True
        await socket.close(code=_REFUSED, message=f"{why}: reading needs the token here".encode())
        return False

    async def _feed(self, socket: web.WebSocketResponse) -> None:
        box = Mailbox()
        for kind, payload in self._newest.items():
            box.put(kind, payload)
        self._boxes.add(box)
        echoes = Echoes()
        feeding = asyncio.ensure_future(_feed_from(box, socket, echoes))
        listening = asyncio.ensure_future(_listen(socket, echoes))
        try:
            await asyncio.wait({feeding, listening}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._boxes.discard(box)
            feeding.cancel()
            if socket.closed:  # By the listening task, which still waits for the confirmation.
                await asyncio.wait({listening}, timeout=CLOSE_S)
            listening.cancel()
            await asyncio.gather(feeding, listening, return_exceptions=True)
        if not socket.closed:
            code, why = 1000, b""
            if _value_of(listening):
                code, why = _TOO_MANY, b"too many messages"
            elif echoes.late:
                code, why = _NO_ECHO, b"not confirmed in time"
            with suppress(Exception):
                await asyncio.wait_for(socket.close(code=code, message=why), CLOSE_S)


class Echoes:
    """The confirmations of a viewer: never more than one bundle is on its way to it."""

    def __init__(self) -> None:
        self._sent = 0
        self._echo = asyncio.Event()
        self._echo_ns = 0
        self.late = False

    def mark(self, filled_ns: int) -> str:
        """End a bundle; return its number, and how long it was not on its way.

        The viewer knows when it confirmed the one before. From then until this one has come, all
        time was spent on the way but what it waited here; what it shows can't be older than that
        and what its own content had waited before it was sent.

        Args:
            filled_ns: when the newest of the bundle was made, steady clock.
        """
        now_ns = time.monotonic_ns()
        self._sent += 1
        self._echo.clear()
        held_s = (now_ns - self._echo_ns) / 1e9 if self._echo_ns else 0.0
        waited_s = (now_ns - filled_ns) / 1e9 if filled_ns else 0.0
        return json.dumps(
            {"type": "mark", "n": self._sent, "held_s": round(held_s - waited_s, 3)},
            separators=(",", ":"),
        )

    def hear(self, text: object) -> bool:
        """Tell whether this is the echo that is waited for; each counts once."""
        if _object_of(text) != {"echo": self._sent} or self._echo.is_set():
            return False
        self._echo_ns = time.monotonic_ns()
        self._echo.set()
        return True

    async def wait(self) -> None:
        """Wait until the last bundle is confirmed. Raise TimeoutError when it takes too long."""
        try:
            await asyncio.wait_for(self._echo.wait(), ECHO_S)
        except TimeoutError:
            self.late = True
            raise


async def _feed_from(box: Mailbox, socket: web.WebSocketResponse, echoes: Echoes) -> None:
    with suppress(ConnectionError, asyncio.TimeoutError):
        # An empty bundle first: how long the way is must be known before anything is shown.
        await _send(socket, echoes.mark(0))
        await echoes.wait()
        while not socket.closed:
            bundle = (await box.take()).values()
            # Marked before it is sent: the time that sending takes is time on the way.
            mark = echoes.mark(box.filled_ns)
            for payload in (*bundle, mark):
                await _send(socket, payload)
            await echoes.wait()


async def _send(socket: web.WebSocketResponse, payload: Payload) -> None:
    sending = socket.send_str(payload) if isinstance(payload, str) else socket.send_bytes(payload)
    await asyncio.wait_for(sending, SEND_S)


async def _listen(socket: web.WebSocketResponse, echoes: Echoes) -> bool:
    """Listen to a viewer's echoes until it leaves; return True where it says too much else.

    The socket is left open: two tasks use it, and the one that feeds the viewer must have ended
    before it is closed, or the reason is lost on its way.
    """
    chatter = TokenBucket(20, 2)
    async for message in socket:
        if not echoes.hear(message.data) and not chatter.take(time.monotonic_ns()):
            return True
    return False


def _value_of(task: asyncio.Future[bool]) -> bool:
    """Return what a task gave; False where it was cancelled or failed."""
    return not task.cancelled() and task.exception() is None and task.result()


def _object_of(text: object) -> dict[str, Any] | None:
    """Return the JSON object that a viewer sent, None for anything else."""
    try:
        message = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def _token_of(text: str) -> str | None:
    """Return the token of a hello, empty without one; None for what is no hello."""
    message = _object_of(text)
    if message is None or message.get("type") != "hello":
        return None
    token = message.get("token", "")
    return token if isinstance(token, str) else None
