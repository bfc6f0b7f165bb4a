"""A model in a process of its own, which answers one request after the other.

Whatever the model does there ends its process at most: it may hang, leave, crash or take all of
its memory. A process serves one run, so that the next run's model remembers nothing.

The process is forked from a server that has imported what bridges need and nothing else; a model's
own modules are imported in its process. What comes from it is read as JSON of bounded length, since
a model may write to its connection whatever it likes.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError, PeerError, SspError
from ssp_core.host.children import die_with_parent
from ssp_core.motion.trajectory import Trajectory
from ssp_core.world.driver import GivenAnswer, LatencyParts
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import Backend, failure, make_backend, respond
from ssp_vla_bridge.messages import (
    ErrorCode,
    Request,
    Response,
    response_from_json,
    response_to_json,
)
from ssp_vla_bridge.stopwatch import ENCODING, PARSING, measuring, part

# A model may take this long to load.
START_S = 600.0
# A backend that keeps its own time limit says so itself within this time behind it.
_GRACE_S = 1.0
_END_S = 2.0
# Between two looks at whether a model is still wanted, or its process has ended.
_LOOK_S = 0.2
_MOST_CHARACTERS = 1 << 20
_MOST_NUMBERS = 1 << 18
_MOST_NAME = 400
# Of what a process sends: an answer of the most characters and numbers is shorter.
_MOST_BYTES = 1 << 26
_READY, _REFUSED = "ready", "refused"
_NO_ANSWER = "its process sent what is no answer"


@dataclass(frozen=True)
class MeasuredAnswer:
    """One answer, read.

    Args:
        trajectory: None: there is none that can be driven.
        invalid: why not, for people.
        raised: the backend raised something that isn't an answer's error.
        encoding_s: part of the time that the request's encoding took, by the model's process.
        parsing_s: likewise of the answer's parsing.
    """

    response: Response
    trajectory: Trajectory | None
    invalid: str
    raised: bool
    encoding_s: float
    parsing_s: float

    def latency(self, total_s: float) -> LatencyParts:
        """Return the latency: its total is measured outside of the model's process."""
        encoding_s = min(max(self.encoding_s, 0.0), total_s)
        parsing_s = min(max(self.parsing_s, 0.0), total_s - encoding_s)
        return LatencyParts(*map(seconds_to_ns, (total_s, encoding_s, parsing_s)))


def measured_answer(backend: Backend, model: str, adapter: str, request: Request) -> MeasuredAnswer:
    """Ask a backend, and read its answer.

    Args:
        backend: the model.
        model: its name.
        adapter: that reads it, ``name`` or ``name:mode``.
        request: complete, with the frames as they are recorded.
    """
    with measuring() as parts:
        result = respond(backend, model, request)
        response = _sound(result.response)
        with part(PARSING):
            read = adapt(adapter, response, request)
    invalid = ""
    if read.trajectory is None:
        has_content = bool(response.text.strip() or response.arrays)
        invalid = "; ".join([*read.invalid, *read.info.notes]) if has_content else "not_ready"
    return MeasuredAnswer(
        response=response,
        trajectory=read.trajectory,
        invalid=invalid,
        raised=bool(result.traceback),
        encoding_s=parts.get(ENCODING, 0.0),
        parsing_s=parts.get(PARSING, 0.0),
    )


def _sound(response: Response) -> Response:
    """Return an answer that a session can keep: bounded, of JSON's values, in Unicode."""
    response = replace(response, error_msg=_unicode(response.error_msg))
    numbers = sum(len(array.data) for array in response.arrays)
    try:
        texts = [response.text, response.model_id, *(array.name for array in response.arrays)]
        characters = sum(map(len, texts))
        # A text that is far too long isn't copied: each question of a run may bring one.
        if characters <= _MOST_CHARACTERS:
            texts.append(json.dumps(dict(response.decoding), allow_nan=False))
            characters = len("".join(texts).encode())
    except (TypeError, ValueError, RecursionError) as error:
        return failure(_blank(response), ErrorCode.BACKEND, f"the answer can't be kept: {error}")
    if characters <= _MOST_CHARACTERS and numbers <= _MOST_NUMBERS:
        return response
    return failure(
        _blank(response),
        ErrorCode.BACKEND,
        f"the answer has {characters} characters and {numbers} numbers, at most "
        f"{_MOST_CHARACTERS} and {_MOST_NUMBERS}",
    )


def _blank(response: Response) -> Response:
    return replace(response, model_id=_unicode(str(response.model_id))[:_MOST_NAME])


def _unicode(text: str) -> str:
    """Return a text with a question mark for each half of a pair of surrogates."""
    return text.encode("utf-8", "replace").decode()


def measured_to_bytes(measured: MeasuredAnswer) -> bytes:
    """Return a read answer as JSON; one of wrong types as the error that it is."""
    try:
        response = response_to_json(measured.response)
        response_from_json(response)
    except (InputError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        failed = failure(
            _blank(measured.response), ErrorCode.BACKEND, f"the answer can't be kept: {error}"
        )
        measured = replace(measured, response=failed, trajectory=None, invalid="")
        response = response_to_json(failed)
    plan = measured.trajectory
    value = {
        "response": response,
        "trajectory": None if plan is None else asdict(plan),
        "invalid": measured.invalid,
        "raised": measured.raised,
        "encoding_s": measured.encoding_s,
        "parsing_s": measured.parsing_s,
    }
    return json.dumps(value).encode()


def measured_from_bytes(data: bytes) -> MeasuredAnswer:
    """Read what measured_to_bytes wrote.

    Raises:
        ValueError: it is something else, or its answer is too long.
    """
    try:
        value = json.loads(data)
        response = response_from_json(value["response"])
        plan = value["trajectory"]
        measured = MeasuredAnswer(
            response=_sound(response),
            trajectory=None
            if plan is None
            else Trajectory(*(tuple(map(float, plan[key])) for key in ("t_s", "x_m", "y_m"))),
            invalid=str(value["invalid"]),
            raised=value["raised"] is True,
            encoding_s=float(value["encoding_s"]),
            parsing_s=float(value["parsing_s"]),
        )
    except (InputError, LookupError, TypeError, ArithmeticError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if measured.response.error_code != response.error_code:
        raise ValueError(measured.response.error_msg)
    if not (math.isfinite(measured.encoding_s) and math.isfinite(measured.parsing_s)):
        raise ValueError("its times aren't finite")
    return measured


def _serve(
    connection: Connection,
    model: str,
    backend_name: str,
    options: Mapping[str, Any],
    adapter: str,
    environment: Mapping[str, str],
) -> None:
    """Answer requests until the connection ends; the main function of the process."""
    die_with_parent()
    # Of a group of its own, so that processes that the model starts end with it.
    os.setsid()
    # Where a model takes the machine's memory, it ends before the session does.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    threading.Thread(target=_end_with_owner, daemon=True).start()
    # An interrupt ends the session, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.clear()
    os.environ.update(environment)
    # The command's own name the event, and the folder in which its triggers' times lie.
    sys.argv[:] = [model]
    # A model that prints doesn't write into the command's result.
    os.dup2(2, 1)
    try:
        backend = make_backend(backend_name, options)
    except Exception as error:  # a model that can't be loaded may raise anything
        words = str(error) if isinstance(error, SspError) else f"{type(error).__name__}: {error}"
        connection.send_bytes(json.dumps([_REFUSED, _unicode(words)]).encode())
        return
    connection.send_bytes(json.dumps([_READY, ""]).encode())
    while True:
        try:
            request = connection.recv()
        except EOFError:
            return
        answer = measured_answer(backend, model, adapter, request)
        connection.send_bytes(measured_to_bytes(answer))


def _end_with_owner() -> None:
    """End this process and its group when the process that asks it is gone, however it ended.

    The parent by the kernel's account is the server that this process was forked from, which lives
    for as long as a model does.
    """
    owner = multiprocessing.parent_process()
    if owner is None:
        return
    wait([owner.sentinel])
    if os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os.kill(os.getpid(), signal.SIGKILL)


def _context() -> multiprocessing.context.ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "ssp_vla_bridge.backends.http"])
    return context


class ModelProcess:
    """The process of one model, for one run.

    Args:
        model: its name.
        backend_name: of BACKENDS, or ``module:factory``.
        options: of the backend.
        adapter: that reads its answers.
        start_s: it must have loaded within this time.
        is_wanted: tells, while it loads, whether it is still waited for.

    Raises:
        InputError: the backend can't be made, for the reason that it gives.
        PeerError: its process ended, didn't get ready in time, or was given up.
    """

    def __init__(
        self,
        model: str,
        backend_name: str,
        options: Mapping[str, Any],
        adapter: str,
        start_s: float = START_S,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        context = _context()
        # A process that is closed while it is asked ends, and then the question does.
        self._asking = threading.Lock()
        self._is_closed = False
        self._connection, theirs = context.Pipe()
        arguments = (theirs, model, backend_name, dict(options), adapter, dict(os.environ))
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()
        try:
            self._await_ready(start_s, is_wanted)
        except BaseException:
            self.close()
            raise

    def _await_ready(self, start_s: float, is_wanted: Callable[[], bool]) -> None:
        end_s = time.monotonic() + start_s
        while self._connection not in wait([self._connection, self._process.sentinel], _LOOK_S):
            # A process that the model started may hold the other end of the connection open.
            if self._process.exitcode is not None and not self._connection.poll():
                raise PeerError(f"{self._ending()} while it was loaded")
            if not is_wanted():
                raise PeerError("it was given up while it was loaded")
            if time.monotonic() >= end_s:
                raise PeerError(f"it isn't ready within {start_s:g} s")
        try:
            word, reason = json.loads(self._connection.recv_bytes(_MOST_BYTES))
        except (EOFError, OSError):
            raise PeerError(f"{self._ending()} while it was loaded") from None
        except (ValueError, TypeError, RecursionError):
            raise PeerError(f"{_NO_ANSWER} while it was loaded") from None
        if word == _REFUSED:
            raise InputError(reason)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    def ask(
        self, request: Request, timeout_s: float
    ) -> tuple[MeasuredAnswer, LatencyParts] | GivenAnswer:
        """Return the answer to a request, or how the process ended, or was ended after its time.

        The latency runs from the complete request to the parsed trajectory, by this process's
        clock.

        Args:
            request: complete.
            timeout_s: of the driver.
        """
        with self._asking:
            if self._is_closed:
                return GivenAnswer(None, ended="its process was ended")
            return self._ask(request, timeout_s)

    def _ask(
        self, request: Request, timeout_s: float
    ) -> tuple[MeasuredAnswer, LatencyParts] | GivenAnswer:
        if self._has_sent():
            return GivenAnswer(None, ended="its process sent an answer that wasn't asked for")
        begin_s = time.perf_counter()
        replies: list[tuple[MeasuredAnswer | None, float]] = []
        # Sending, too, waits for a process that doesn't read.
        exchange = threading.Thread(target=self._exchange, args=(request, replies), daemon=True)
        exchange.start()
        self._await_end(exchange, timeout_s + _GRACE_S)
        if exchange.is_alive():
            code = self._process.exitcode
            self._kill()
            exchange.join()  # its connection is shut down
            if code is None:
                return no_answer_within(timeout_s)
        if not replies:
            latency = LatencyParts(seconds_to_ns(time.perf_counter() - begin_s))
            return GivenAnswer(None, latency, self._ending())
        measured, end_s = replies[0]
        if measured is None:
            latency = LatencyParts(seconds_to_ns(end_s - begin_s))
            return GivenAnswer(None, latency, _NO_ANSWER)
        return measured, measured.latency(end_s - begin_s)

    def _await_end(self, exchange: threading.Thread, limit_s: float) -> None:
        """Wait for an exchange, or until its process has ended while another one holds its pipe."""
        end_s = time.monotonic() + limit_s
        while exchange.is_alive() and (left_s := end_s - time.monotonic()) > 0.0:
            exchange.join(min(left_s, _LOOK_S))
            if self._process.exitcode is not None:
                # What it said last may still be on its way.
                exchange.join(min(left_s, _GRACE_S))
                return

    def _has_sent(self) -> bool:
        """Tell whether the process sent something between two questions."""
        try:
            if self._connection.poll():
                self._connection.recv_bytes(_MOST_BYTES)
                return True
        except EOFError:
            return False
        except OSError as error:
            return _is_too_long(error)
        return False

    def _exchange(
        self, request: Request, replies: list[tuple[MeasuredAnswer | None, float]]
    ) -> None:
        measured = None
        try:
            self._connection.send(request)
            with suppress(ValueError):
                measured = measured_from_bytes(self._connection.recv_bytes(_MOST_BYTES))
        except EOFError:
            return
        except OSError as error:
            if not _is_too_long(error):
                return
        replies.append((measured, time.perf_counter()))

    def _ending(self) -> str:
        self._process.join(_END_S)
        code = self._process.exitcode
        if code is None:
            return "its process closed its connection"
        if code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}"

    def _kill(self) -> None:
        self.interrupt()
        self._process.kill()
        self._process.join()

    def interrupt(self) -> None:
        """End the process while another thread asks it, which gets that as its ending.

        The connection is shut down: a process that left the model's group may hold its other end.
        """
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        with suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End the process, from any thread: a question that is open is answered by its end."""
        if self._is_closed:
            return
        self._is_closed = True
        self.interrupt()
        with self._asking:
            self._connection.close()
            self._kill()
            self._process.close()


def _is_too_long(error: OSError) -> bool:
    """Tell whether a message was refused by its length."""
    return error.errno is None and "length" in str(error)


def no_answer_within(timeout_s: float) -> GivenAnswer:
    """Return what comes of a question to a driver that gave no answer in time."""
    reason = f"gave no answer within its timeout_s of {timeout_s:g} s"
    return GivenAnswer(None, LatencyParts(seconds_to_ns(timeout_s)), reason)
