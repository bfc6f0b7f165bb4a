"""A chat server on a real socket that answers as a test says, and an extractor that asks it."""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from ssp_core.chat.client import OpenAIChat, Policy
from ssp_eval.extract.combined.extractor import Extractor

TEXT = "A velocipede wobbles along up the road from us. We take the pace out."
KEY = "sk-not-to-be-seen-anywhere"


def one(label: str, quote: str) -> dict[str, str]:
    return {"label": label, "quote": quote}


GOOD = {
    "objects": [one("cyclist", "velocipede")],
    "motion": one("same_direction", "wobbles along"),
    "position": one("front", "up the road from us"),
    "conflict": None,
    "lon_action": one("decelerate", "take the pace out"),
    "lat_action": None,
}


def completion(content: Any, **choice: Any) -> bytes:
    text = content if isinstance(content, str) else json.dumps(content)
    message = {"role": "assistant", "content": text}
    return json.dumps(
        {"choices": [{"message": message, "finish_reason": "stop", **choice}]}
    ).encode()


class Server:
    """A chat server; ``reply`` makes status and body of what was asked."""

    def __init__(self, reply: Callable[[dict[str, Any]], tuple[int, bytes]]) -> None:
        self.requests: list[dict[str, Any]] = []
        self.released = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                length = int(self.headers["Content-Length"])
                request = json.loads(self.rfile.read(length))
                outer.requests.append(request)
                status, body = reply(request)
                if status == 0:
                    outer.released.wait(20.0)
                    return
                self.send_response(status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                pass

        class Quiet(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, request: Any, client_address: Any) -> None:
                socketserver.BaseServer.shutdown_request(self, request)

        self._server = Quiet(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1"
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def close(self) -> None:
        self.released.set()
        self._server.shutdown()
        self._server.server_close()


@contextmanager
def serving(reply: Callable[[dict[str, Any]], tuple[int, bytes]]) -> Iterator[Server]:
    server = Server(reply)
    try:
        yield server
    finally:
        server.close()


def extractor(
    url: str,
    cache: Path | None = None,
    model: str = "tested",
    timeout_s: float = 5.0,
    use_schema: bool = True,
) -> Extractor:
    policy = Policy(timeout_s=timeout_s, tries=1)
    return Extractor(OpenAIChat(url, model, KEY, policy), cache, use_schema)


def answering(content: Any) -> Callable[[dict[str, Any]], tuple[int, bytes]]:
    return lambda _: (200, completion(content))
