"""The viewers that are connected, and what is pushed to them."""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import suppress
from typing import Any

from aiohttp import WSMsgType, web

from ssp_monitor.page.guard import Bucket, Door, same_token
from ssp_monitor.page.mailbox import Mailbox, Payload

MOST_VIEWERS = 12
# A viewer says who it is within this time, and takes what it is sent within that one.
HELLO_S = 5.0
SEND_S = 5.0
MOST_BYTES = 2048
# A viewer that is gone without a word is noticed after one and a half of this.
PING_S = 5.0
# What a new viewer gets at once. A snapshot or a picture that nobody looked at may be hours old.
_KEPT = ("site", "events")
_TOO_MANY = 4008
_REFUSED = 4001
_MALFORMED = 4002


class Hub:
    """Sends everybody the newest of each kind; lives in the server's event loop.

    Args:
        door: tells who may read.
    """

    def __init__(self, door: Door) -> None:
        self._door = door
        self._newest: dict[str, Payload] = {}
        self._boxes: set[Mailbox] = set()
        self._sockets: set[web.WebSocketResponse] = set()
        self._guesses = Bucket(10, 1)

    @property
    def viewers(self) -> int:
        return len(self._sockets)

    def push(self, payloads: dict[str, Payload]) -> None:
        """New things, by kind."""
        self._newest.update({k: payloads[k] for k in _KEPT if k in payloads})
        for box in self._boxes:
            for kind, payload in payloads.items():
                box.put(kind, payload)

    async def close(self) -> None:
        """Says goodbye to everybody."""
        for socket in list(self._sockets):
            with suppress(Exception):
                await asyncio.wait_for(socket.close(code=1001, message=b"the page ends"), 1.0)

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """One viewer, from its hello to its end."""
        if len(self._sockets) >= MOST_VIEWERS:
            return web.Response(status=503, text=f"{MOST_VIEWERS} viewers are connected, no more")
        socket = web.WebSocketResponse(
            max_msg_size=MOST_BYTES, compress=False, heartbeat=PING_S, timeout=2.0
        )
        self._sockets.add(socket)
        try:
            await socket.prepare(request)
            if await self._welcome(socket):
                await self._feed(socket)
        finally:
            self._sockets.discard(socket)
        return socket

    async def _welcome(self, socket: web.WebSocketResponse) -> bool:
        """Takes the hello and answers it; False: this one may not even read."""
        try:
            message = await asyncio.wait_for(socket.receive(), HELLO_S)
            token = _token_of(message.data) if message.type is WSMsgType.TEXT else None
        except TimeoutError:
            token = None
        if token is None:
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
            return True
        await socket.close(code=_REFUSED, message=f"{why}: reading needs it here".encode())
        return False

    async def _feed(self, socket: web.WebSocketResponse) -> None:
        box = Mailbox()
        for kind, payload in self._newest.items():
            box.put(kind, payload)
        self._boxes.add(box)
        feeding = asyncio.ensure_future(_feed_from(box, socket))
        listening = asyncio.ensure_future(_listen(socket))
        try:
            await asyncio.wait({feeding, listening}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._boxes.discard(box)
            for task in (feeding, listening):
                task.cancel()
            await asyncio.gather(feeding, listening, return_exceptions=True)
        if not socket.closed:
            with suppress(Exception):
                await asyncio.wait_for(socket.close(), 1.0)


async def _feed_from(box: Mailbox, socket: web.WebSocketResponse) -> None:
    with suppress(ConnectionError, asyncio.TimeoutError):
        while not socket.closed:
            for payload in (await box.take()).values():
                await _send(socket, payload)


async def _send(socket: web.WebSocketResponse, payload: Payload) -> None:
    sending = socket.send_str(payload) if isinstance(payload, str) else socket.send_bytes(payload)
    await asyncio.wait_for(sending, SEND_S)


async def _listen(socket: web.WebSocketResponse) -> None:
    """A viewer has nothing more to say; one that talks all the same is sent away."""
    chatter = Bucket(20, 2)
    async for _ in socket:
        if not chatter.take(time.monotonic_ns()):
            await socket.close(code=_TOO_MANY, message=b"too many messages")
            return


def _token_of(text: str) -> str | None:
    """The token of a hello, empty without one; None for what is no hello."""
    try:
        said: Any = json.loads(text)
    except ValueError:
        return None
    if not isinstance(said, dict) or said.get("type") != "hello":
        return None
    token = said.get("token", "")
    return token if isinstance(token, str) else None
