"""The page's web server as strangers meet it: what it serves, whom it refuses, what it endures."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

import aiohttp
import pytest

from ssp_core.errors import HostError
from ssp_monitor.page import server, viewers
from ssp_monitor.page.server import FOLDER, PageServer, load_assets
from ssp_monitor.status.board import Answer, Shown
from tests.support.waiting import DEADLINE_S

TOKEN = "the-right-token-of-this-test"
Work = Callable[[aiohttp.ClientSession], Awaitable[Any]]


class Manager:
    """Accepts everything at once but what it is told to leave unanswered."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.shown: list[Shown | None] = []
        self.silent: set[str] = set()

    def ask(self, command: str, who: str, shown: Shown | None) -> Future[Answer]:
        self.asked.append((command, who))
        self.shown.append(shown)
        answer: Future[Answer] = Future()
        if command not in self.silent:
            answer.set_result(Answer(True, state="ABORTING"))
        return answer


@pytest.fixture
def manager():
    return Manager()


@pytest.fixture
def page(manager):
    made = PageServer("127.0.0.1", 0, TOKEN, manager)
    yield made
    made.close()


def do(work: Work) -> Any:
    """Runs a client to its end."""

    async def run() -> Any:
        async with aiohttp.ClientSession() as client:
            return await asyncio.wait_for(work(client), DEADLINE_S)

    return asyncio.run(run())


def post(
    page: PageServer, name: str = "abort", token: str | None = TOKEN, **more: Any
) -> tuple[int, Any]:
    async def work(client: aiohttp.ClientSession) -> tuple[int, Any]:
        headers = {
            **({"Authorization": f"Bearer {token}"} if token is not None else {}),
            **more.pop("headers", {}),
        }
        url = f"{page.url}api/command/{name}"
        if name != "abort" and not {"data", "json"} & more.keys():
            more["json"] = {"shown": "4@1"}
        async with client.post(url, headers=headers, **more) as response:
            text = await response.text()
            return response.status, json.loads(text) if text.startswith("{") else text

    return do(work)  # type: ignore[no-any-return]


def get(page: PageServer, path: str = "/", **headers: str) -> tuple[int, Any]:
    """Over a bare socket, so that nobody tidies the path up."""
    lines = {"Host": f"127.0.0.1:{page.door.port}", "Connection": "close", **headers}
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    with socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S) as stream:
        stream.sendall(f"GET {path} HTTP/1.1\r\n{text}\r\n".encode())
        said = b""
        while data := stream.recv(65536):
            said += data
    head, _, body = said.partition(b"\r\n\r\n")
    return int(head.split()[1]), (head.decode(), body)


def test_every_file_of_the_page_is_served_with_its_policy(page):
    for path, asset in load_assets().items():
        status, (head, body) = get(page, path)
        assert (status, body) == (200, asset.body)
        assert "default-src 'none'; script-src 'self'; style-src 'self'" in head
        assert "unsafe" not in head
        assert "X-Content-Type-Options: nosniff" in head
        assert "Cache-Control: no-store" in head


def test_the_page_names_nothing_from_elsewhere():
    for path in FOLDER.iterdir():
        text = path.read_text()
        for word in ("http:", "https:", "<script>", "style=", "onclick=", "innerHTML", "eval("):
            assert word not in text, path


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/%2e%2e/server.py",
        "/static/main.js",
        "//etc/passwd",
        "/node.py",
        "/x" * 900,
    ],
)
def test_nothing_else_is_served(page, path):
    status, (_, body) = get(page, path)
    assert status == 404
    assert b"import" not in body


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "", "127.0.0.1:1"])
def test_a_foreign_host_gets_nothing(page, host):
    assert get(page, "/", Host=host)[0] in (400, 403)


def test_commands_reach_the_manager_with_the_token(page, manager):
    status, answer = post(page, "arm")
    assert (status, answer["accepted"], answer["state"]) == (200, True, "ABORTING")
    assert manager.asked == [("arm", "operator page at 127.0.0.1")]


@pytest.mark.parametrize(("token", "status"), [(None, 401), ("", 401), ("wrong", 403), ("é", 403)])
def test_commands_without_the_token_are_refused(page, manager, token, status):
    found, answer = post(page, "arm", token=token)
    assert found == status
    assert "token" in answer["text"]
    assert not manager.asked


@pytest.mark.parametrize("token", [None, "", "wrong", "é", "of-an-older-page"])
def test_abort_needs_no_token(page, manager, token):
    """A tab that was open before the page started again must stop the objects all the same."""
    status, answer = post(page, "abort", token=token)
    assert (status, answer["accepted"]) == (200, True)
    assert manager.asked == [("abort", "operator page at 127.0.0.1")]


def test_the_token_is_not_taken_from_the_address(page, manager):
    assert post(page, f"arm?token={TOKEN}", token=None, json={"shown": "4@1"})[0] == 401
    assert not manager.asked


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "evil.example"},
    ],
)
def test_other_pages_command_nothing(page, manager, headers):
    assert post(page, headers=headers)[0] == 403
    assert not manager.asked


@pytest.mark.parametrize("name", ["load_scenario", "explode", "abort%2f..%2fstart", "ABORT"])
def test_there_are_no_other_commands(page, manager, name):
    assert post(page, name)[0] == 404
    assert not manager.asked


def test_a_large_body_is_not_taken(page, manager):
    assert post(page, data=b"x" * 100_000)[0] == 413
    assert not manager.asked


def test_no_answer_is_told_as_none(page, manager, monkeypatch):
    monkeypatch.setattr(server, "ABORT_ANSWER_S", 0.2)
    manager.silent.add("abort")
    status, answer = post(page)
    assert (status, answer["accepted"], answer["answered"]) == (504, False, False)
    assert answer["text"] == "the scenario manager gave no answer within 0.2 s"


def test_a_press_says_which_state_the_page_showed(page, manager):
    """A press that was meant for an earlier state must not count for the present one."""
    assert post(page, "start", json={"shown": "4@1700000000000000001"})[0] == 200
    assert manager.shown == [Shown(4, 1_700_000_000_000_000_001)]
    for body in (b"", b"{", b"[]", b'{"shown": 4}', b'{"shown": "0@1"}', b'{"shown": "4"}'):
        status, answer = post(page, "start", data=body)
        assert (status, answer["accepted"]) == (400, False), body
    assert len(manager.asked) == 1
    assert post(page, "abort", data=b"whatever")[0] == 200
    assert manager.shown[-1] is None


def test_a_flood_of_commands_is_bounded_and_leaves_abort_free(page, manager):
    async def flood(client: aiohttp.ClientSession) -> list[int]:
        async def one(name: str, token: str) -> int:
            headers = {"Authorization": f"Bearer {token}"}
            url = f"{page.url}api/command/{name}"
            async with client.post(url, headers=headers, json={"shown": "4@1"}) as response:
                return response.status

        guesses = await asyncio.gather(*(one("arm", f"guess{k}") for k in range(60)))
        starts = await asyncio.gather(*(one("start", TOKEN) for _ in range(60)))
        return [*guesses, *starts, await one("abort", TOKEN)]

    found = do(flood)
    assert set(found[:60]) == {403, 429}
    assert found[60:120].count(429) >= 20
    assert found[-1] == 200
    assert ("abort", "operator page at 127.0.0.1") in manager.asked


# -- the socket ------------------------------------------------------------------------------


def live(page: PageServer, work: Callable[[Any], Awaitable[Any]], **headers: str) -> Any:
    async def run(client: aiohttp.ClientSession) -> Any:
        async with client.ws_connect(f"{page.url}api/live", headers=headers) as stream:
            return await work(stream)

    return do(run)


def hello(token: str = "") -> dict[str, str]:
    return {"type": "hello", "token": token}


async def take(stream: Any) -> Any:
    """The next message that is no mark; marks are confirmed."""
    while True:
        message = await stream.receive()
        if message.type is not aiohttp.WSMsgType.TEXT or '"mark"' not in message.data:
            return message
        await echo(stream, message)


async def echo(stream: Any, mark: Any) -> None:
    await stream.send_str(f'{{"echo":{json.loads(mark.data)["n"]}}}')


def sent(page: PageServer, data: str) -> bytes:
    """What the page answers to half a request before it closes the connection."""
    with socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S) as stream:
        stream.sendall(data.replace("HOST", f"127.0.0.1:{page.door.port}").encode())
        said = b""
        while data_ := stream.recv(65536):
            said += data_
    return said


POST = f"POST /api/command/abort HTTP/1.1\r\nHost: HOST\r\nAuthorization: Bearer {TOKEN}\r\n"


@pytest.mark.parametrize(
    ("half", "status"),
    [
        ("", b""),
        ("GE", b""),
        ("GET / HTTP/1.1\r\nHost: HO", b""),
        (f"{POST}Content-Length: 100\r\n\r\nabc", b"408"),
        (f"{POST}Transfer-Encoding: chunked\r\n\r\n5\r\nab", b"408"),
    ],
)
def test_half_a_request_is_closed(half, status, manager, monkeypatch):
    monkeypatch.setattr(server, "REQUEST_S", 0.3)
    page = PageServer("127.0.0.1", 0, TOKEN, manager)
    try:
        assert sent(page, half)[9:12] == status
        assert manager.asked == []
        assert get(page)[0] == 200
    finally:
        page.close()


@pytest.mark.parametrize(
    "data",
    [
        "nonsense\r\n\r\n",
        "\x16\x03\x01\x02\x00",
        "GET / HTTP/9.9\r\n\r\n",
        "GET / HTTP/1.1\r\nHost HOST\r\n\r\n",
        f"GET /{'a' * 9000} HTTP/1.1\r\nHost: HOST\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: HOST\r\nX: " + "y" * 9000 + "\r\n\r\n",
        f"{POST}Content-Length: -5\r\n\r\n",
        f"{POST}Content-Length: 5\r\nContent-Length: 6\r\n\r\n",
        f"{POST}Transfer-Encoding: chunked\r\n\r\nZZZ\r\n",
        f"{POST}Content-Encoding: gzip\r\nContent-Length: 5\r\n\r\nabcde",
    ],
)
def test_a_malformed_request_is_answered_and_leaves_no_traceback(
    data, page, manager, caplog, capfd
):
    assert sent(page, data + "\r\n")[9:10] == b"4"
    assert (manager.asked, caplog.records) == ([], [])
    assert get(page)[0] == 200
    assert "Traceback" not in capfd.readouterr().err


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
    """What is sent to a socket that is being closed fails; the closing goes on."""
    send = viewers._send

    async def held_back(socket: Any, payload: Any) -> None:
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

    monkeypatch.setattr(viewers, "_send", held_back)
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


# -- beginning and end ------------------------------------------------------------------------


def test_a_taken_port_is_said(page, manager):
    with pytest.raises(HostError, match=f"port {page.door.port} of 127.0.0.1 is taken; choose"):
        PageServer("127.0.0.1", page.door.port, TOKEN, manager)


def test_a_page_whose_run_has_ended_leaves_its_port_to_the_next(page, manager):
    page.retire()
    after = PageServer("127.0.0.1", page.door.port, TOKEN, manager)
    try:
        assert after.door.port == page.door.port
        assert get(after)[0] == 200
        status, answer = post(after, "abort")
        assert (status, answer["accepted"]) == (200, True)
    finally:
        after.close()


def test_a_page_whose_run_has_ended_says_so_to_a_command(page, manager):
    page.retire()
    status, answer = post(page, "abort")
    assert (status, answer["accepted"], answer["answered"]) == (200, False, True)
    assert "the run has ended" in answer["text"]
    assert manager.asked == []


@pytest.mark.parametrize("host", ["no.such.host.invalid", "203.0.113.7"])
def test_a_foreign_address_is_said(host, manager):
    with pytest.raises(HostError, match="listen on"):
        PageServer(host, 0, TOKEN, manager)


def test_a_page_that_ends_says_goodbye(manager):
    page = PageServer("127.0.0.1", 0, TOKEN, manager)

    async def work(stream: Any) -> Any:
        await stream.send_json(hello())
        await stream.receive()
        asyncio.get_running_loop().run_in_executor(None, page.close)
        while not stream.closed:
            await stream.receive()
        return stream.close_code

    assert live(page, work) == 1001
    assert not page.is_alive
