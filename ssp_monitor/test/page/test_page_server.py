"""The page's web server as strangers meet it: what it serves, whom it refuses, what it endures."""

from __future__ import annotations

import asyncio
import socket
import time
from typing import Any

import aiohttp
import pytest

from ssp_core.errors import HostError
from ssp_monitor.page import server
from ssp_monitor.page.server import FOLDER, PageServer, load_assets
from ssp_monitor.status.board import StateOnPage
from tests.support.page_clients import TOKEN, do, get, hello, live, post, shown_now
from tests.support.processes.waiting import DEADLINE_S


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
    assert post(page, f"arm?token={TOKEN}", token=None, json={"shown": shown_now()})[0] == 401
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
    assert post(page, "arm", data=b"x" * 100_000)[0] == 413
    assert not manager.asked


def test_no_answer_is_told_as_none(page, manager, monkeypatch):
    monkeypatch.setattr(server, "ABORT_ANSWER_S", 0.2)
    manager.silent.add("abort")
    status, answer = post(page)
    assert (status, answer["accepted"], answer["answered"]) == (504, False, False)
    assert answer["text"] == "the scenario manager gave no answer within 0.2 s"


def test_a_press_says_which_state_the_page_showed(page, manager):
    """A press that was meant for an earlier state must not count for the present one."""
    since_ns = 1_700_000_000_000_000_001
    assert post(page, "start", json={"shown": shown_now(4, since_ns)})[0] == 200
    (shown,) = manager.shown
    assert (shown.state, shown.since_ns) == (4, since_ns)
    bad = (b'{"shown": 4}', b'{"shown": "0@1@1"}', b'{"shown": "4"}', b'{"shown": "4@1"}')
    for body in (b"", b"{", b"[]", *bad):
        status, answer = post(page, "start", data=body)
        assert (status, answer["accepted"]) == (400, False), body
    assert len(manager.asked) == 1
    assert post(page, "abort", data=b"whatever")[0] == 200
    assert manager.shown[-1] is None


@pytest.mark.parametrize(
    ("after_s", "text"), [(12.0, "s ago, limit 10 s"), (-600.0, "before this computer restarted")]
)
def test_a_press_that_was_long_on_its_way_does_not_count(page, manager, after_s, text):
    """A link that was down for half a minute delivered a start after the page had given it up."""
    made_ns = time.monotonic_ns() - round(after_s * 1e9)
    late = {"shown": str(StateOnPage(4, 1, made_ns))}
    status, answer = post(page, "start", json=late)
    assert (status, answer["accepted"]) == (200, False)
    assert text in answer["text"]
    assert not manager.asked
    assert post(page, "abort", json=late)[0] == 200
    assert len(manager.asked) == 1


def test_a_flood_of_commands_is_bounded_and_leaves_abort_free(page, manager):
    async def flood(client: aiohttp.ClientSession) -> list[int]:
        async def one(name: str, token: str) -> int:
            headers = {"Authorization": f"Bearer {token}"}
            url = f"{page.url}api/command/{name}"
            async with client.post(url, headers=headers, json={"shown": shown_now()}) as response:
                return response.status

        guesses = await asyncio.gather(*(one("arm", f"guess{k}") for k in range(60)))
        starts = await asyncio.gather(*(one("start", TOKEN) for _ in range(60)))
        return [*guesses, *starts, await one("abort", TOKEN)]

    found = do(flood)
    assert set(found[:60]) == {403, 429}
    assert found[60:120].count(429) >= 20
    assert found[-1] == 200
    assert ("abort", "operator page at 127.0.0.1") in manager.asked


def sent(page: PageServer, data: str) -> bytes:
    """Return the page's answer to half a request, read until the connection closes."""
    with socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S) as stream:
        stream.sendall(data.replace("HOST", f"127.0.0.1:{page.door.port}").encode())
        said = b""
        while data_ := stream.recv(65536):
            said += data_
    return said


POST = f"POST /api/command/arm HTTP/1.1\r\nHost: HOST\r\nAuthorization: Bearer {TOKEN}\r\n"


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
    "rest",
    [
        "Content-Length: 100\r\n\r\nabc",
        "Content-Length: 2000\r\n\r\n" + "x" * 2000,
        "Transfer-Encoding: chunked\r\n\r\n5\r\nab",
        "Content-Encoding: gzip\r\nContent-Length: 5\r\n\r\nabcde",
        "Expect: 100-continue\r\nContent-Length: 3\r\n\r\n",
    ],
)
def test_an_abort_counts_whatever_follows_its_head(rest, page, manager):
    said = sent(page, POST.replace("/arm ", "/abort ") + rest)
    assert b'"accepted": true' in said
    assert manager.asked == [("abort", "operator page at 127.0.0.1")]


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
    assert "if anything moves, use the emergency stop" in answer["text"]
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
