"""The HTTP half of a sidecar: `ssp.vla_http/1` in front of one model, in the model's own Python.

Needs Python 3.10 and nothing else; it imports nothing of SSP. One thread, the main one, loads the
model and works, one request after the other. Requests that wait are bounded: a further one gets
503 with `Retry-After`, which tells the bridge that it may ask again. A request whose sender has
gone before its turn is dropped. SIGTERM lets the answer in the works go out, for `--stop-s`, and
ends with status 0.

    python sidecar_service.py --loader my_module:load --port 8300

`load(arguments)` gives a function that takes a request (the JSON object, decoded) and gives
`{"text": …, "arrays": […], "decoding": {…}}`, of which arrays and decoding may be left out.
"""

from __future__ import annotations

import argparse
import hmac
import importlib
import json
import os
import select
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

SCHEMA = "ssp.vla_http/1"
RETRY_AFTER_S = 1
LOADING_RETRY_AFTER_S = 5
READ_TIMEOUT_S = 30.0
LOOK_S = 0.1
FLUSH_S = 1.0

Json = dict[str, Any]
Answerer = Callable[[Json], Json]


class LoadError(Exception):
    """The model can't be loaded; one line for people."""


class UnanswerableError(Exception):
    """The request lacks what this model needs; one line for people."""


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


class _Stop(BaseException):
    """SIGTERM or SIGINT came while the model was being loaded."""


class Service:
    """One model behind HTTP, with the arguments of parser.

    Args:
        token: that callers must send as bearer token, empty for none.
    """

    def __init__(self, arguments: argparse.Namespace, token: str) -> None:
        self.max_bytes = round(arguments.max_mb * (1 << 20))
        self.token = token
        self.model_id = ""
        self.ready = False
        self.detail = "the model is being loaded"
        self.open_exchanges = 0
        self.lock = threading.Lock()
        self._stop_s = arguments.stop_s
        self._loading = True
        self._stopping = False
        self._limit = max(1, arguments.queue)
        self._waiting: list[Job] = []
        self._changed = threading.Condition()
        handler = type("Handler", (Handler,), {"service": self})
        self._server = ThreadingHTTPServer((arguments.host, arguments.port), handler)
        self._server.daemon_threads = True

    @property
    def url(self) -> str:
        host, port = self._server.server_address[:2]
        return f"http://{host!s}:{port}"

    def run(self, load: Callable[[], tuple[str, Answerer]]) -> int:
        """Serves until SIGTERM or SIGINT; returns the exit status.

        Args:
            load: gives the model's id and the function that answers; raises LoadError.
        """
        self._watch_signals()
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()
        try:
            print(f"listening on {self.url}", flush=True)
            self.model_id, answer = load()
            self._loading = False
            self.ready, self.detail = True, ""
            print(f"ready: {self.model_id}", flush=True)
            while (job := self._next()) is not None:
                job.finish(*self._outcome(answer, job.request))
        except _Stop:
            pass
        except LoadError as error:
            print(f"error: {error}", file=sys.stderr, flush=True)
            return 1
        except Exception as error:  # whatever the model's own code raises while it is loaded
            traceback.print_exc()
            print(f"error: the model can't be loaded: {error}", file=sys.stderr, flush=True)
            return 1
        finally:
            self._close()
        return 0

    def offer(self, job: Job) -> bool:
        """Takes a job in; False when the queue is full of jobs that somebody waits for."""
        with self._changed:
            self._waiting = [one for one in self._waiting if not one.abandoned]
            if len(self._waiting) >= self._limit:
                return False
            self._waiting.append(job)
            self._changed.notify()
        return True

    def _watch_signals(self) -> None:
        """A thread learns of a signal at once, whatever the main one is waiting for.

        Python runs handlers in the main thread between two steps of Python, which a model, or a
        lock that is taken just then, may keep it from.
        """
        self._told, self._tells = socket.socketpair()
        self._tells.setblocking(False)
        signal.set_wakeup_fd(self._tells.fileno())
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        threading.Thread(target=self._end_in_time, daemon=True).start()

    def _on_signal(self, *_: Any) -> None:
        if self._loading:
            raise _Stop

    def _end_in_time(self) -> None:
        while not set(self._told.recv(64)) & {signal.SIGTERM, signal.SIGINT}:
            pass
        with self._changed:
            self._stopping = True
            self._changed.notify()
        time.sleep(self._stop_s)
        os._exit(0)  # a model can't be interrupted; its process can

    def _next(self) -> Job | None:
        """The next job that somebody waits for; None when the service is to stop."""
        with self._changed:
            while not self._stopping:
                while self._waiting:
                    job = self._waiting.pop(0)
                    if not job.abandoned:
                        return job
                self._changed.wait()
        return None

    def _outcome(self, answer: Answerer, request: Json) -> tuple[int, Json]:
        try:
            given = answer(request)
            reply = {
                "schema": SCHEMA,
                "request_id": request["request_id"],
                "model_id": self.model_id,
                "text": given["text"],
                "arrays": given.get("arrays", []),
                "decoding": given.get("decoding", {}),
            }
            json.dumps(reply, allow_nan=False)
        except UnanswerableError as error:
            return 422, {"error": str(error)}
        except Exception as error:  # a model's failure costs this answer only
            traceback.print_exc()
            return 500, {"error": f"{type(error).__name__}: {error}"}
        return 200, reply

    def _close(self) -> None:
        self.ready, self.detail = False, "the service is stopping"
        self._server.shutdown()
        with self._changed:
            for job in self._waiting:
                job.finish(503, {"error": self.detail})
        deadline_s = time.monotonic() + FLUSH_S
        while self.open_exchanges and time.monotonic() < deadline_s:
            time.sleep(0.01)
        self._server.server_close()


def named(path: str) -> Callable[..., Any]:
    """The function `module:function`; the working folder is looked in too.

    Raises:
        LoadError: there is none.
    """
    module_name, _, name = path.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise LoadError(
            f"--loader {path}: {error}; give module:function, and put its folder on PYTHONPATH"
        ) from error
    return found


def parser(description: str, port: int) -> argparse.ArgumentParser:
    """The arguments that every sidecar has."""
    parsed = argparse.ArgumentParser(description=description)
    parsed.add_argument("--host", default="127.0.0.1", help="listen here (default: loopback)")
    parsed.add_argument("--port", type=int, default=port, help="0: any that is free")
    parsed.add_argument("--queue", type=int, default=1, help="requests that may wait")
    parsed.add_argument("--max-mb", type=float, default=64.0, help="of one request")
    parsed.add_argument("--token-env", help="environment variable with the token of callers")
    parsed.add_argument("--stop-s", type=float, default=5.0, help="for the last answer")
    parsed.add_argument("--loader", help="module:function in place of the real model's loading")
    return parsed


def serve(
    arguments: argparse.Namespace,
    load_weights: Callable[[argparse.Namespace], tuple[str, Any]],
    answerer: Callable[[Any], Answerer],
) -> int:
    """Serves a model with the arguments of parser; returns the exit status.

    Args:
        arguments: with ``--loader``, that function stands for the weights.
        load_weights: gives the real model's id, and the model.
        answerer: the function of requests around a model.
    """
    token = ""
    if arguments.token_env is not None:
        token = os.environ.get(arguments.token_env, "")
        if not token:
            print(f"error: {arguments.token_env} holds no token", file=sys.stderr)
            return 2
    if not token and arguments.host not in ("127.0.0.1", "::1", "localhost"):
        print(f"note: {arguments.host} is open to everybody without --token-env", file=sys.stderr)
    try:
        service = Service(arguments, token)
    except OSError as error:
        print(f"error: can't listen on {arguments.host}:{arguments.port}: {error}", file=sys.stderr)
        return 1

    def load() -> tuple[str, Answerer]:
        if arguments.loader is None:
            model_id, model = load_weights(arguments)
        else:
            model = named(arguments.loader)(arguments)
            model_id = str(getattr(model, "model_id", arguments.loader))
        return model_id, answerer(model)

    return service.run(load)


def _no_weights(_: argparse.Namespace) -> tuple[str, Any]:
    raise LoadError("there are no weights of its own")


def main() -> int:
    arguments = parser("Serves any Python function.", 8300).parse_args()
    if arguments.loader is None:
        print("error: --loader is missing: give module:function", file=sys.stderr)
        return 2
    return serve(arguments, _no_weights, lambda answer: answer)


if __name__ == "__main__":
    sys.exit(main())
