"""Clients of the operators' page: requests, sockets, and a manager that takes their commands."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any

import aiohttp

from ssp_monitor.page.server import PageServer
from ssp_monitor.status.board import Answer, StateOnPage
from tests.support.processes.waiting import DEADLINE_S

TOKEN = "the-right-token-of-this-test"
Work = Callable[[aiohttp.ClientSession], Awaitable[Any]]


class Manager:
    """Accepts everything at once, except commands that it must leave unanswered."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.shown: list[StateOnPage | None] = []
        self.silent: set[str] = set()

    def ask(self, command: str, who: str, shown: StateOnPage | None) -> Future[Answer]:
        self.asked.append((command, who))
        self.shown.append(shown)
        answer: Future[Answer] = Future()
        if command not in self.silent:
            answer.set_result(Answer(True, state="ABORTING"))
        return answer


def do(work: Work) -> Any:
    """Runs a client to its end."""

    async def run() -> Any:
        async with aiohttp.ClientSession() as client:
            return await asyncio.wait_for(work(client), DEADLINE_S)

    return asyncio.run(run())


def shown_now(state: int = 4, since_ns: int = 1) -> str:
    """Return what a page says that it showed, just now."""
    return str(StateOnPage(state, since_ns, time.monotonic_ns()))


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
            more["json"] = {"shown": shown_now()}
        async with client.post(url, headers=headers, **more) as response:
            text = await response.text()
            return response.status, json.loads(text) if text.startswith("{") else text

    return do(work)  # type: ignore[no-any-return]


def get(page: PageServer, path: str = "/", **headers: str) -> tuple[int, Any]:
    """Get a path over a bare socket, so that no client library tidies the path up."""
    lines = {"Host": f"127.0.0.1:{page.door.port}", "Connection": "close", **headers}
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    with socket.create_connection(("127.0.0.1", page.door.port), DEADLINE_S) as stream:
        stream.sendall(f"GET {path} HTTP/1.1\r\n{text}\r\n".encode())
        said = b""
        while data := stream.recv(65536):
            said += data
    head, _, body = said.partition(b"\r\n\r\n")
    return int(head.split()[1]), (head.decode(), body)


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
