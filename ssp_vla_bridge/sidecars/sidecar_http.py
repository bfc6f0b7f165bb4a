"""The exchanges of a sidecar: `GET /health` and `POST /answer` of `ssp.vla_http/1`."""

from __future__ import annotations

import hmac
import json
import select
import socket
import threading
from http.server import BaseHTTPRequestHandler
from typing import Any

SCHEMA = "ssp.vla_http/1"
RETRY_AFTER_S = 1
LOADING_RETRY_AFTER_S = 5
READ_TIMEOUT_S = 30.0
LOOK_S = 0.1

Json = dict[str, Any]


class Job:
    """A request on its way through the queue."""

    def __init__(self, request: Json) -> None:
        self.request = request
        self.abandoned = False
        self.done = threading.Event()
        self.status = 500
        self.reply: Json = {}

    def finish(self, status: int, reply: Json) -> None:
        self.status, self.reply = status, reply
        self.done.set()


class Handler(BaseHTTPRequestHandler):
    """One exchange; a connection serves one."""

    service: Any  # the Service that it belongs to
    timeout = READ_TIMEOUT_S

    def do_GET(self) -> None:
        service = self.service
        if not self._allowed() or not self._known("/health"):
            return
        self._send(
            200,
            {
                "schema": SCHEMA,
                "model_id": service.model_id,
                "ready": service.ready,
                "detail": service.detail,
            },
        )

    def do_POST(self) -> None:
        with self.service.lock:
            self.service.open_exchanges += 1
        try:
            self._answer()
        finally:
            with self.service.lock:
                self.service.open_exchanges -= 1

    def _answer(self) -> None:
        if not self._allowed() or not self._known("/answer"):
            return
        request = self._request()
        if request is None:
            return
        if not self.service.ready:
            self._send(503, {"error": self.service.detail}, LOADING_RETRY_AFTER_S)
            return
        job = Job(request)
        if not self.service.offer(job):
            self._send(503, {"error": "another request is in the works"}, RETRY_AFTER_S)
            return
        while not job.done.wait(LOOK_S):
            if _has_gone(self.connection):
                job.abandoned = True
                return
        self._send(job.status, job.reply)

    def _request(self) -> Json | None:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or len(length) > 12:
            self._send(411, {"error": "a request needs its Content-Length"})
            return None
        if int(length) > self.service.max_bytes:
            self._send(413, {"error": f"a request has at most {self.service.max_bytes} bytes"})
            return None
        try:
            body = self.rfile.read(int(length))
            value = json.loads(body)
        except (OSError, ValueError, RecursionError) as error:
            self._send(400, {"error": f"the request is no JSON: {error}"})
            return None
        if not isinstance(value, dict) or value.get("schema") != SCHEMA:
            self._send(400, {"error": f"the request must be an object of schema {SCHEMA}"})
            return None
        if not isinstance(value.get("request_id"), str):
            self._send(400, {"error": "request_id must be a string"})
            return None
        return value

    def _allowed(self) -> bool:
        given = self.headers.get("Authorization", "").encode("utf-8", "replace")
        wanted = f"Bearer {self.service.token}".encode()
        if not self.service.token or hmac.compare_digest(given, wanted):
            return True
        self._send(401, {"error": "a bearer token is needed"})
        return False

    def _known(self, path: str) -> bool:
        if self.path == path:
            return True
        self._send(404, {"error": "there are GET /health and POST /answer"})
        return False

    def _send(self, status: int, value: Json, retry_after_s: int | None = None) -> None:
        body = json.dumps(value).encode()
        try:
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            if retry_after_s is not None:
                self.send_header("Retry-After", str(retry_after_s))
            self.end_headers()
            self.wfile.write(body)
        except OSError:  # who asked has gone
            self.close_connection = True

    def log_message(self, *_: Any) -> None:
        """Says nothing: what counts stands in the answers."""


def _has_gone(connection: socket.socket) -> bool:
    """True when the other side has closed its connection."""
    readable, _, _ = select.select([connection], [], [], 0)
    if not readable:
        return False
    try:
        return connection.recv(1, socket.MSG_PEEK) == b""
    except OSError:
        return True
