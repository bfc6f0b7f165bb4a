"""The socket of the operators' page: who may listen, what is sent, and how a viewer ends."""

from __future__ import annotations

import asyncio
import json
import socket
from contextlib import suppress
from typing import Any

import aiohttp
import pytest

from ssp_monitor.page import viewers
from ssp_monitor.page.server import PageServer
from tests.support.page_clients import TOKEN, do, echo, hello, live, take
from tests.support.processes.waiting import DEADLINE_S


@pytest.mark.parametrize(
    ("token", "may", "why"),
    [(TOKEN, True, ""), ("", False, "no token"), ("x", False, "wrong token")],
)
def test_anybody_here_may_read(page, token, may, why):
    async def work(stream: Any) -> list[Any]:
        await stream.send_json(hello(token))
        welcome = await stream.receive_json()
        page.push({"snapshot": '{"type": "snapshot"}'})
        return [welcome, json.loads((await take(stream)).data)]

    page.push({"events": '{"type": "events"}'})
    welcome, first = live(page, work)
    assert welcome == {"type": "welcome", "may_command": may, "why": why}
    assert first == {"type": "events"}  # what is kept; an old snapshot isn't


def test_elsewhere_reading_needs_the_token(manager):
    page = PageServer("0.0.0.0", 0, TOKEN, manager)
    try:
        url = f"http://127.0.0.1:{page.door.port}/api/live"

        async def read(client: aiohttp.ClientSession, token: str) -> Any:
            async with client.ws_connect(url) as stream:
                await stream.send_json(hello(token))
                await stream.receive_json()
                page.push({"site": '{"type": "site"}'})
                said = await take(stream)
                return said.type, said.data

        kind, code = do(lambda client: read(client, ""))
        assert (kind, code) == (aiohttp.WSMsgType.CLOSE, 4001)
        kind, data = do(lambda client: read(client, TOKEN))
        assert (kind, data) == (aiohttp.WSMsgType.TEXT, '{"type": "site"}')
    finally:
        page.close()


def test_a_socket_from_another_page_is_refused(page):
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        live(page, lambda stream: stream.receive(), Origin="http://evil.example")
    assert refused.value.status == 403


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"type": "command"}', '{"type":"hello","token":1}']
)
def test_who_says_no_hello_is_sent_away(page, text):
    async def work(stream: Any) -> Any:
        await stream.send_str(text)
        await stream.receive()
        return stream.close_code

    assert live(page, work) == 4002


def test_who_says_nothing_is_sent_away(page, monkeypatch):
    monkeypatch.setattr(viewers, "HELLO_S", 0.2)

    async def work(stream: Any) -> Any:
        await stream.receive()
        return stream.close_code

    assert live(page, work) == 4002


def test_who_talks_too_much_or_at_length_is_sent_away(page):
    async def flood(stream: Any) -> Any:
        await stream.send_json(hello())
        with suppress(aiohttp.ClientConnectionResetError):  # sent away before the last one
            for _ in range(200):
                await stream.send_str("x")
        while (await stream.receive()).type is aiohttp.WSMsgType.TEXT:
            pass
        return stream.close_code

    async def long(stream: Any) -> Any:
        await stream.send_str("x" * 100_000)
        await stream.receive()
        return stream.close_code

    assert live(page, flood) == 4008
    assert live(page, long) == 1009


def test_the_reason_arrives_though_something_was_to_be_sent_meanwhile(page, monkeypatch):
    """A message to a socket that is closing fails, and the closing goes on."""
    send = viewers._send

    async def hold_back(socket: Any, payload: Any) -> None:
        while "mark" in payload and not socket.closed:
            await asyncio.sleep(0.01)
        await send(socket, payload)

    async def work(stream: Any) -> Any:
        await stream.send_json(hello())
        for _ in range(60):
            await stream.send_str("x")
        await asyncio.sleep(0.3)  # The closing isn't confirmed yet.
        while (await stream.receive()).type is aiohttp.WSMsgType.TEXT:
            pass
        return stream.close_code

    monkeypatch.setattr(viewers, "_send", hold_back)
    assert live(page, work) == 4008


def test_viewers_are_counted(page):
    async def work(client: aiohttp.ClientSession) -> int:
        streams = []
        for _ in range(viewers.MOST_VIEWERS):
            streams.append(await client.ws_connect(f"{page.url}api/live"))
            await streams[-1].send_json(hello())
            await streams[-1].receive()  # the welcome
            await streams[-1].receive()
        try:
            await client.ws_connect(f"{page.url}api/live")
        except aiohttp.WSServerHandshakeError as error:
            return error.status
        finally:
            for stream in streams:
                await stream.close()
        return 0

    assert do(work) == 503


def test_who_has_said_nothing_yet_takes_no_viewers_place(page):
    async def work(client: aiohttp.ClientSession) -> int:
        silent = [
            await client.ws_connect(f"{page.url}api/live") for _ in range(viewers.MOST_STRANGERS)
        ]
        assert page.viewers == 0
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await client.ws_connect(f"{page.url}api/live")
        await silent[0].send_json(hello())
        await silent[0].receive()
        await silent[0].receive()
        async with client.ws_connect(f"{page.url}api/live"):  # a place is free again
            assert page.viewers == 1
        for stream in silent:
            await stream.close()
        return refused.value.status

    assert do(work) == 503


def test_the_next_bundle_waits_for_the_echo_of_the_last(page):
    """However much is buffered on the way, one bundle is under way, and its delay is known."""

    async def work(stream: Any) -> tuple[list[str], dict[str, Any]]:
        await stream.send_json(hello())
        await stream.receive()
        first = await stream.receive()  # an empty bundle: nothing is shown before its echo
        page.push({"snapshot": '"old"'})
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(stream.receive(), 0.3)
        page.push({"snapshot": '"new"'})
        page.push({"snapshot": '"newest"'})
        await asyncio.sleep(0.1)  # in the box for so long at least
        await echo(stream, first)
        said = [(await stream.receive()).data]
        mark = await stream.receive()
        return said, json.loads(mark.data)

    said, mark = live(page, work)
    assert said == ['"newest"']
    assert (mark["type"], mark["n"]) == ("mark", 2)
    assert mark["held_s"] < -0.05  # what waited is counted as older, not as held


def test_an_echo_that_never_comes_ends_the_connection(page, monkeypatch):
    monkeypatch.setattr(viewers, "ECHO_S", 0.2)

    async def work(stream: Any) -> Any:
        await stream.send_json(hello())
        while not stream.closed:
            await stream.receive()
        return stream.close_code

    assert live(page, work) == 4009


def test_echoes_are_no_chatter(page):
    async def work(stream: Any) -> list[str]:
        await stream.send_json(hello())
        await stream.receive()
        await echo(stream, await stream.receive())  # from now on it is a viewer
        said = []
        for k in range(60):
            page.push({"snapshot": str(k)})
            said.append((await take(stream)).data)
        return said

    assert live(page, work) == [str(k) for k in range(60)]


def test_what_is_no_text_is_refused_without_a_traceback(page, manager, caplog):
    request = (
        f"POST /api/command/arm HTTP/1.1\r\nHost: 127.0.0.1:{page.door.port}\r\n"
        "Connection: close\r\nContent-Length: 0\r\n"
    ).encode()
    for _ in range(30):
        with socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S) as stream:
            stream.sendall(request + b"Authorization: Bearer \xff\r\n\r\n")
            said = b""
            while data := stream.recv(65536):
                said += data
    assert said.startswith(b"HTTP/1.1 429")  # counted as guesses

    async def deep(stream: Any) -> Any:
        await stream.send_str("[" * 2000)
        await stream.receive()
        return stream.close_code

    async def surrogate(stream: Any) -> Any:
        await stream.send_str('{"type":"hello","token":"\\ud800"}')
        return await stream.receive_json()

    assert live(page, deep) == 4002
    assert live(page, surrogate)["why"] == "wrong token"
    assert not manager.asked
    assert not [record for record in caplog.records if record.exc_info]


def test_a_viewer_that_takes_nothing_holds_up_nobody(page, monkeypatch):
    """One never reads; the other gets the newest while much is pushed, and the first is let go."""
    monkeypatch.setattr(viewers, "SEND_S", 0.3)
    monkeypatch.setattr(viewers, "ECHO_S", 0.5)
    large = json.dumps({"type": "snapshot", "x": "y" * 500_000})
    stuck = socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S)
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stuck.sendall(
        f"GET /api/live HTTP/1.1\r\nHost: 127.0.0.1:{page.door.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
    )
    said = json.dumps(hello()).encode()
    stuck.sendall(bytes([0x81, 0x80 | len(said), 0, 0, 0, 0]) + said)  # masked with zeros

    async def work(stream: Any) -> str:
        await stream.send_json(hello())
        await stream.receive()
        while page.viewers < 2:
            await asyncio.sleep(0.01)
        while page.viewers > 1:
            page.push({"site": large})
            await take(stream)
        page.push({"site": '"last"'})
        while (newest := await take(stream)).data == large:
            pass
        return str(newest.data)

    try:
        assert live(page, work) == '"last"'
    finally:
        stuck.close()
