"""The HTTP half of a sidecar: `ssp.vla_http/1` in front of one model, in the model's own Python.

Needs Python 3.10 and nothing else; it imports nothing of SSP. One thread loads the model and works,
one request after the other. Requests that wait are bounded: a further one gets 503 with
`Retry-After`, which tells the bridge that it may ask again. A request whose sender has gone before
its turn is dropped. SIGTERM lets the answer in the works go out, for `--stop-s`, and ends with
status 0.

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
from concurrent.futures import Future, ThreadPoolExecutor, wait
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
Outcome = tuple[int, Json]  # status of HTTP, and the body


class LoadError(Exception):
    """The model can't be loaded; one line for people."""


class UnanswerableError(Exception):
    """The request lacks what this model needs; one line for people."""


class RefusedError(Exception):
    """A request gets this status and line instead of an answer."""

    def __init__(self, status: int, problem: str, retry_after_s: int | None = None) -> None:
        super().__init__(problem)
        self.status, self.retry_after_s = status, retry_after_s


class Handler(BaseHTTPRequestHandler):
    """One exchange; a connection serves one."""

    service: Any  # the Service that it belongs to
    timeout = READ_TIMEOUT_S

    def do_GET(self) -> None:
        self._reply("/health", self._health)

    def do_POST(self) -> None:
        service = self.service
        with service.lock:
            service.open_exchanges += 1
        try:
            self._reply("/answer", self._answer)
        finally:
            with service.lock:
                service.open_exchanges -= 1

    def _reply(self, path: str, make: Callable[[], Outcome | None]) -> None:
        try:
            self._check_sender(path)
            outcome = make()
        except RefusedError as error:
            self._send(error.status, {"error": str(error)}, error.retry_after_s)
            return
        if outcome is not None:
            self._send(*outcome)

    def _health(self) -> Outcome:
        service = self.service
        said = {"model_id": service.model_id, "ready": service.ready, "detail": service.detail}
        return 200, {"schema": SCHEMA, **said}

    def _answer(self) -> Outcome | None:
        """Return the outcome; None where the sender has gone before its turn."""
        future = self.service.offer(self._request())
        while not wait([future], LOOK_S).done:
            if _is_closed(self.connection) and future.cancel():
                return None
        if future.cancelled():
            raise RefusedError(503, "the service is stopping")
        outcome: Outcome = future.result()
        return outcome

    def _request(self) -> Json:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or len(length) > 12:
            raise RefusedError(411, "a request needs its Content-Length")
        if int(length) > self.service.max_bytes:
            raise RefusedError(413, f"a request has at most {self.service.max_bytes} bytes")
        try:
            value = json.loads(self.rfile.read(int(length)))
        except (OSError, ValueError, RecursionError) as error:
            raise RefusedError(400, f"the request is no JSON: {error}") from error
        if not isinstance(value, dict) or value.get("schema") != SCHEMA:
            raise RefusedError(400, f"the request must be an object of schema {SCHEMA}")
        if not isinstance(value.get("request_id"), str):
            raise RefusedError(400, "request_id must be a string")
        return value

    def _check_sender(self, path: str) -> None:
        given = self.headers.get("Authorization", "").encode("utf-8", "replace")
        wanted = f"Bearer {self.service.token}".encode()
        if self.service.token and not hmac.compare_digest(given, wanted):
            raise RefusedError(401, "a bearer token is needed")
        if self.path != path:
            raise RefusedError(404, "there are GET /health and POST /answer")

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
        """Log nothing: what counts stands in the answers."""


def _is_closed(connection: socket.socket) -> bool:
    """Tell whether the other side has closed its connection."""
    readable, _, _ = select.select([connection], [], [], 0)
    if not readable:
        return False
    try:
        return connection.recv(1, socket.MSG_PEEK) == b""
    except OSError:
        return True


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
        self._answer: Answerer = _no_model
        self._stop_s = arguments.stop_s
        self._limit = max(1, arguments.queue)
        self._waiting: list[Future[Outcome]] = []
        self._stop = threading.Event()
        # One thread for loading and for all answers: frameworks keep state for each.
        self._worker = ThreadPoolExecutor(1)
        handler = type("Handler", (Handler,), {"service": self})
        self._server = ThreadingHTTPServer((arguments.host, arguments.port), handler)
        self._server.daemon_threads = True

    @property
    def url(self) -> str:
        host, port = self._server.server_address[:2]
        return f"http://{host!s}:{port}"

    def run(self, load: Callable[[], tuple[str, Answerer]]) -> int:
        """Serve until SIGTERM or SIGINT, which end the process; return where loading fails.

        Args:
            load: gives the model's id and the function that answers; raises LoadError.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._stop.set())
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()
        print(f"listening on {self.url}", flush=True)
        loading = self._worker.submit(load)
        while not (loading.done() or self._stop.is_set()):
            wait([loading], LOOK_S)
        try:
            if not self._stop.is_set():
                self.model_id, self._answer = loading.result()
                self.ready, self.detail = True, ""
                print(f"ready: {self.model_id}", flush=True)
        except LoadError as error:
            print(f"error: {error}", file=sys.stderr, flush=True)
            return 1
        except Exception as error:  # whatever the model's own code raises while it is loaded
            traceback.print_exc()
            print(f"error: the model can't be loaded: {error}", file=sys.stderr, flush=True)
            return 1
        # A wait without an end isn't left for a signal that another thread took: a model has many.
        while not self._stop.wait(LOOK_S):
            pass
        self._end()
        return 0

    def offer(self, request: Json) -> Future[Outcome]:
        """Take a request in.

        Raises:
            RefusedError: the model isn't ready, or as many requests wait as may.
        """
        with self.lock:
            if not self.ready:
                raise RefusedError(503, self.detail, LOADING_RETRY_AFTER_S)
            self._waiting = [one for one in self._waiting if not (one.running() or one.done())]
            if len(self._waiting) >= self._limit:
                raise RefusedError(503, "another request is in the works", RETRY_AFTER_S)
            future = self._worker.submit(self._outcome, request)
            self._waiting.append(future)
            return future

    def _outcome(self, request: Json) -> Outcome:
        try:
            given = self._answer(request)
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

    def _end(self) -> None:
        """Let the answer in the works go out, and end the process."""
        with self.lock:
            was_ready, self.ready, self.detail = self.ready, False, "the service is stopping"
            self._worker.shutdown(wait=False, cancel_futures=True)
        deadline_s = time.monotonic() + (self._stop_s + FLUSH_S if was_ready else FLUSH_S)
        while self.open_exchanges and time.monotonic() < deadline_s:
            time.sleep(0.01)
        os._exit(0)  # a model can't be interrupted; its process can


def first_line(error: Exception) -> str:
    """Return the first line of an error, or its kind where it has none."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _no_model(_: Json) -> Json:
    raise UnanswerableError("the model isn't loaded")


def named(path: str) -> Callable[..., Any]:
    """Return the function `module:function`; the working folder is looked in too.

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
    """Make a parser of the arguments that every sidecar has."""
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
    """Serve a model with the arguments of parser; return the exit status.

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
