"""A chat service on a real socket that says whatever a test wants, byte by byte."""

from __future__ import annotations

import contextlib
import json
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

Talk = Callable[["ChatService", socket.socket], None]


@dataclass(frozen=True)
class Asked:
    """One request: its line, headers with names in lower case, JSON body."""

    line: str
    headers: dict[str, str]
    body: dict[str, Any]

    @property
    def text(self) -> str:
        """The text of the user's message, which follows the pictures."""
        text = self.body["messages"][-1]["content"][-1]["text"]
        assert isinstance(text, str)
        return text

    @property
    def pictures(self) -> list[str]:
        parts = self.body["messages"][-1]["content"]
        return [part["image_url"]["url"] for part in parts if part["type"] == "image_url"]


class ChatService(socketserver.ThreadingTCPServer):
    """``queue``: what to do with the next requests; then it answers with ``answers`` in turn."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.queue: list[Talk] = []
        self.answers = ["Answer 1.", "Answer 2.", "Answer 3.", "Answer 4."]
        self.asked: list[Asked] = []
        self.released = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/v1"

    def completion(self, content: Any, finish: str = "stop", **more: Any) -> dict[str, Any]:
        """A chat completion; ``more`` goes into the message where it starts with ``message_``."""
        message = {"role": "assistant", "content": content}
        message |= {
            k.removeprefix("message_"): v for k, v in more.items() if k.startswith("message_")
        }
        return {
            "id": "chatcmpl-1",
            "object": "chat.completion",
            "model": "seer-7b",
            "system_fingerprint": "fp_1",
            "choices": [{"index": 0, "message": message, "finish_reason": finish}],
            "usage": {"prompt_tokens": 900, "completion_tokens": 20, "total_tokens": 920},
            **{k: v for k, v in more.items() if not k.startswith("message_")},
        }

    def http(self, body: Any, status: int = 200, **headers: str) -> bytes:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        lines = {"Content-Type": "application/json", "Content-Length": str(len(data))}
        lines |= {name.replace("_", "-"): text for name, text in headers.items()}
        head = "".join(f"{name}: {text}\r\n" for name, text in lines.items())
        return f"HTTP/1.1 {status} Status\r\n{head}\r\n".encode() + data

    def drip(self, connection: socket.socket, data: bytes) -> None:
        """Sends a byte now and then, for as long as somebody listens."""
        connection.sendall(data)
        end_s = time.monotonic() + 600
        while time.monotonic() < end_s and not self.released.wait(0.02):
            connection.sendall(b" ")


class _Handler(socketserver.BaseRequestHandler):
    server: ChatService

    def handle(self) -> None:
        service = self.server
        data = b""
        while b"\r\n\r\n" not in data:
            data += self._more()
        head, _, body = data.partition(b"\r\n\r\n")
        line, *lines = head.decode().split("\r\n")
        headers = {name.lower(): text for name, text in (one.split(": ", 1) for one in lines)}
        while len(body) < int(headers["content-length"]):
            body += self._more()
        number = len(service.asked)
        service.asked.append(Asked(line, headers, json.loads(body)))
        try:
            if service.queue:
                service.queue.pop(0)(service, self.request)
            else:
                text = service.answers[number % len(service.answers)]
                self.request.sendall(service.http(service.completion(text)))
        except OSError:  # the client has had enough
            pass

    def _more(self) -> bytes:
        data = self.request.recv(1 << 16)
        assert isinstance(data, bytes)
        if not data:
            raise ConnectionError("the client left within its request")
        return data


@contextlib.contextmanager
def chat_service() -> Iterator[ChatService]:
    """A service that serves while the context is open."""
    with ChatService() as found:
        threading.Thread(target=found.serve_forever, args=(0.01,), daemon=True).start()
        yield found
        found.released.set()
        found.shutdown()
