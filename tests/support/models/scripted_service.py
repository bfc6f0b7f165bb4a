"""A service on a real socket that does what a test says, byte for byte."""

from __future__ import annotations

import contextlib
import json
import socketserver
import threading
from collections.abc import Callable
from typing import Any

HEALTHY = {"schema": "ssp.vla_http/1", "model_id": "tested/1", "ready": True, "detail": ""}


def answer(request: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A good answer to a request, with fields changed."""
    array = {
        "name": "trajectory",
        "shape": [3, 2],
        "data": [0.0, 0.0, 4.0, 0.0, 8.0, 0.0],
        "frame": "ego_xy",
        "unit": "m",
        "step_s": 0.5,
        "first_time_s": 0.0,
    }
    return {
        "schema": "ssp.vla_http/1",
        "request_id": request["request_id"],
        "model_id": "tested/1",
        "text": "I keep my speed.",
        "arrays": [array],
        "decoding": {"seed": 1},
        **changes,
    }


def http(status: str, body: bytes, *headers: str, length: int | None = None) -> bytes:
    """The bytes of a response; its Content-Length may be a lie."""
    size = len(body) if length is None else length
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {size}", *headers, "", ""]
    return "\r\n".join(lines).encode() + body


def ok(value: Any, *headers: str) -> bytes:
    return http("200 OK", json.dumps(value).encode(), *headers)


class Exchange:
    """One connection, as the service has it.

    Args:
        connection: the socket.
        head: of the request, text.
        request: its JSON, None without a body.
        ended: set when the test ends.
    """

    def __init__(self, connection, head: str, request, ended: threading.Event) -> None:
        self._connection = connection
        self.head = head
        self.request = request
        self.ended = ended

    def send(self, data: bytes) -> bool:
        """False once the other side has closed."""
        try:
            self._connection.sendall(data)
        except OSError:
            return False
        return True

    def drip(self, data: bytes) -> None:
        """One byte every 20 ms, as long as the other side reads."""
        for value in data:
            if self.ended.wait(0.02) or not self.send(bytes([value])):
                return


class ScriptedService:
    """Listens at once, answers from ``start`` on; requests are counted by path.

    Args:
        on_answer: what it does with ``POST /answer``.
        on_health: what it does with ``GET /health``.
    """

    def __init__(
        self,
        on_answer: Callable[[Exchange], Any] = lambda e: e.send(ok(answer(e.request))),
        on_health: Callable[[Exchange], Any] = lambda e: e.send(ok(HEALTHY)),
    ) -> None:
        self.asked = 0
        self.heads: list[str] = []
        self.most_at_once = 0
        self._now = 0
        self._lock = threading.Lock()
        self._ended = threading.Event()
        scripted = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                scripted._handle(self.request, on_answer, on_health)

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            allow_reuse_address = True

        self._server = Server(("127.0.0.1", 0), Handler, bind_and_activate=False)
        self._server.server_bind()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def start(self) -> ScriptedService:
        """Start the service; before this, connections are refused."""
        self._server.server_activate()
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()
        return self

    def __enter__(self) -> ScriptedService:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()

    def _handle(self, connection, on_answer, on_health) -> None:
        data = b""
        while b"\r\n\r\n" not in data:
            got = connection.recv(65536)
            if not got:
                return
            data += got
        head, _, body = data.partition(b"\r\n\r\n")
        text = head.decode("latin-1")
        length = next(
            (int(x.split(":")[1]) for x in text.lower().split("\r\n") if "content-length:" in x), 0
        )
        while len(body) < length:
            body += connection.recv(65536)
        self.heads.append(text)
        exchange = Exchange(connection, text, json.loads(body) if body else None, self._ended)
        if text.startswith("GET /health "):
            on_health(exchange)
            return
        with self._lock:
            self.asked += 1
            self._now += 1
            self.most_at_once = max(self.most_at_once, self._now)
        with contextlib.suppress(OSError):
            on_answer(exchange)
        with self._lock:
            self._now -= 1
