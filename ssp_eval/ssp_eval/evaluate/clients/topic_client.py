"""The conversation with one model over topics: one request at a time, deadlines, restarts.

This file owns the open request and what became of those before it (``RequestTracker``), and the
bridge's process with its deaths (``TopicClient``). A request has one reply: an answer, or the
reason for having none. An answer that comes after it is counted, and never used.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ssp_core.errors import PeerError
from ssp_core.host.processes import NodeProcess
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, Loss, ModelReply, unusable
from ssp_vla_bridge.backend import with_end_read
from ssp_vla_bridge.messages import ErrorCode, Request, Response


class RequestTracker:
    """The conversation with one model. Only the first answer to the open request is used."""

    def __init__(self) -> None:
        self.ignored = IgnoredAnswers()
        self._open: Request | None = None
        self._reply: ModelReply | None = None
        self._answered: set[str] = set()
        self._abandoned_ids: set[str] = set()

    def open(self, request: Request) -> None:
        """Open a request that is about to be sent.

        Raises:
            ValueError: another one is open still.
        """
        if self._open is not None:
            raise ValueError(f"request {self._open.request_id} is open still")
        self._open = request
        self._reply = None

    def offer(self, response: Response) -> None:
        """Take an answer: use it, or count it as late, duplicate or unknown."""
        request = self._open
        if request is not None and response.request_id == request.request_id:
            self._answered.add(request.request_id)
            self._open = None
            problem = unusable(response)
            self._reply = (
                ModelReply(None, problem) if problem else ModelReply(with_end_read(response))
            )
            if response.stamp_ns != request.stamp_ns:
                reason = (
                    f"the answer is stamped {response.stamp_ns} ns, asked was {request.stamp_ns}"
                )
                self._reply = ModelReply(None, reason)
        elif response.request_id in self._abandoned_ids:
            self.ignored.late += 1
        elif response.request_id in self._answered:
            self.ignored.duplicate += 1
        else:
            self.ignored.unknown += 1

    def offer_unreadable(self, request_id: str, reason: str) -> None:
        """Take an answer that can't be read; it costs its own request only."""
        if self._open is not None and request_id == self._open.request_id:
            self._answered.add(request_id)
            self._open = None
            self._reply = ModelReply(None, f"the answer can't be read: {reason}")
        else:
            self.ignored.unknown += 1

    def take(self) -> ModelReply | None:
        """Return the reply to the last request, once; None while there is none."""
        reply, self._reply = self._reply, None
        return reply

    def give_up(self) -> None:
        """Give the open request up; an answer from now on is late."""
        if self._open is not None:
            self._abandoned_ids.add(self._open.request_id)
            self._open = None


# A bridge has this long to appear on the topics unless the user says otherwise: it loads its
# model before it subscribes.
CONNECT_S = 30.0
_SPIN_S = 0.05
# The bridge's own timeout comes first, so that its numbered error is what is recorded.
_GRACE_S = 2.0
_MAX_RESTARTS = 2
_STOP_S = 10.0


class TopicLink(Protocol):
    """The topics of one model, as the evaluator's node has them."""

    def send(self, request: Request) -> None:
        """Publish a request."""

    def matched(self) -> bool:
        """Return True while a bridge is on both topics that wasn't forgotten."""

    def forget(self) -> None:
        """Forget the bridge on the topics: it has ended, whatever discovery still reports."""


class Transport(Protocol):
    """A node that talks to bridges; spun only while somebody waits."""

    def link(self, model: str, exchange: RequestTracker) -> TopicLink:
        """Return the topics of a model; its answers go to the exchange."""

    def spin(self, timeout_s: float) -> None:
        """Handle incoming messages, for at most this long."""


@dataclass(frozen=True)
class Timeouts:
    """The times to wait for a bridge."""

    answer_s: float
    start_s: float = CONNECT_S


class TopicClient:
    """Asks one model over its topics.

    Args:
        start: starts the bridge (again); None: it is attached and not ours.
        gives_up: the backend gives up by itself, so that its bridge is free again after the error
            that says so.
    """

    def __init__(
        self,
        model: str,
        transport: Transport,
        exchange: RequestTracker,
        link: TopicLink,
        timeouts: Timeouts,
        start: Callable[[], NodeProcess] | None,
        gives_up: bool = False,
    ) -> None:
        self._model = model
        self._transport = transport
        self._exchange = exchange
        self._link = link
        self._timeouts = timeouts
        self._start = start
        self._gives_up = gives_up
        self.process: NodeProcess | None = None
        self._deaths = 0
        self._out_of_time = False
        self._freed = 0  # restarts since the last answer
        self._connected = self._waited_in_vain = False

    @property
    def ignored(self) -> IgnoredAnswers:
        """Answers that came and weren't used."""
        return self._exchange.ignored

    def connect(self, patient: bool = True) -> None:
        """Start the bridge where it is ours, and wait until it is on the topics.

        Args:
            patient: wait also for one that was waited for in vain before.

        Raises:
            PeerError: it doesn't come, or ends before that.
        """
        if self._start is not None and (
            self.process is None or self.process.returncode is not None
        ):
            self._link.forget()
            self.process = self._start()
            self._connected = self._waited_in_vain = False
        wait_s = self._timeouts.start_s if patient or not self._waited_in_vain else 0.0
        deadline = time.monotonic() + wait_s
        while not self._link.matched():
            if self.process is not None and self.process.returncode is not None:
                raise PeerError(self._died("ended before it was ready"))
            if time.monotonic() > deadline:
                self._connected, self._waited_in_vain = False, True
                raise PeerError(
                    f"no bridge for {self._model} on its topics within {self._timeouts.start_s:g} s"
                )
            self._transport.spin(_SPIN_S)
        if not self._connected:
            # We see the bridge; that it sees our subscription too can't be asked, and an answer
            # that it publishes before it does is lost.
            settle = time.monotonic() + 0.2
            while time.monotonic() < settle:
                self._transport.spin(_SPIN_S)
        self._connected, self._waited_in_vain = True, False

    def stop(self) -> None:
        """End the bridge if it was started here; the next request starts it again."""
        if self.process is None:
            return
        self.process.expected_to_stop = True
        self.process.process.terminate()
        try:
            self.process.process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self.process.process.kill()
            self.process.process.wait()
        self._link.forget()

    def ask(self, request: Request) -> ModelReply:
        """Return the reply to one request; whatever the bridge does costs this reply only.

        A model that doesn't come back from one request would cost all those after it, too. So when
        two in a row have no answer in time, a bridge that was started here is started again and
        asked the second one once more. One alone may have been slow, as first requests are. A
        backend that gives up by itself comes back: its question isn't asked, and paid for, twice.
        """
        reply = self._ask(request)
        if self._out_of_time and self._no_time(reply) and self._may_free():
            self._freed += 1
            self.stop()
            reply = self._ask(request)
        self._out_of_time = self._no_time(reply)
        if not self._out_of_time:
            self._freed = 0
        return reply

    def _no_time(self, reply: ModelReply) -> bool:
        """Tell whether the model may be at the request still."""
        if reply.response is None:
            return reply.loss is Loss.SILENT
        return reply.response.error_code == ErrorCode.TIMEOUT and not self._gives_up

    def _may_free(self) -> bool:
        return self.process is not None and self._freed < _MAX_RESTARTS

    def _ask(self, request: Request) -> ModelReply:
        if not self._alive():
            if self._start is not None and self._deaths > _MAX_RESTARTS:
                gone = f"the bridge died {self._deaths} times and was given up"
                return ModelReply(None, gone, Loss.DIED)
            self._connected = False
        if not self._connected:
            try:
                self.connect(patient=False)
            except PeerError as error:
                self._deaths += 1
                return ModelReply(None, str(error), Loss.UNREACHABLE)
        self._exchange.open(request)
        self._link.send(request)
        deadline = time.monotonic() + self._timeouts.answer_s + _GRACE_S
        while time.monotonic() < deadline:
            self._transport.spin(_SPIN_S)
            reply = self._exchange.take()
            if reply is not None:
                return reply
            if not self._alive():
                self._deaths += 1
                self._exchange.give_up()
                return ModelReply(None, self._died("died before it answered"), Loss.DIED)
        self._exchange.give_up()
        return ModelReply(None, f"no answer within {self._timeouts.answer_s:g} s", Loss.SILENT)

    def _alive(self) -> bool:
        if self.process is not None:
            return self.process.returncode is None
        return self._link.matched()

    def _died(self, what: str) -> str:
        if self.process is None:
            return f"the bridge of {self._model} left its topics"
        tail = self.process.log_tail(3).strip().replace("\n", " | ")
        how = f"the bridge {what} ({self.process.describe_exit()})"
        return f"{how}: {tail}" if tail else how
