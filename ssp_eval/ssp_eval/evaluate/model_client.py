"""The way to a model: in this process, or over topics to a bridge started here or attached."""

from __future__ import annotations

import importlib
import json
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import ssp_core
from ssp_core.environment import adopted
from ssp_core.errors import HostError, InputError, PeerError
from ssp_core.files import Closing
from ssp_core.processes import NodeProcess, ProcessGroup, free_domain, session_environment
from ssp_eval.evaluate.models import ModelSpec
from ssp_vla_bridge.backend import OPTION_START, OPTION_TIMEOUT, Backend, make_backend, respond
from ssp_vla_bridge.messages import ErrorCode, Request, Response

# A reason for people is a line, whatever a bridge writes into its error message.
MOST_REASON = 400


class Loss(StrEnum):
    """The reason why a label time has no record, in the words of tables and reports."""

    DIED = "bridge died"
    UNREACHABLE = "bridge unreachable"
    SILENT = "no answer in time"
    OVERLOAD = "bridge overloaded"
    UNUSABLE = "unusable answer"
    BROKEN_OFF = "answer broken off"
    DECLINED = "the model declined"
    ERROR = "bridge answered an error"
    NO_QUESTION = "nothing to ask"


# What is owed to bridge, server or network, and to no model: a cell with such a loss measures them.
OUTAGE = frozenset(Loss) - {Loss.NO_QUESTION, Loss.DECLINED}
# What the same question may get an answer after. A bridge keeps no state between requests, so
# asking again is safe; where the answer would be the same error again, it is useless.
PASSING = frozenset({Loss.DIED, Loss.UNREACHABLE, Loss.SILENT, Loss.OVERLOAD, Loss.BROKEN_OFF})
_OF_CODE = {
    ErrorCode.TIMEOUT: Loss.SILENT,
    ErrorCode.OVERLOAD: Loss.OVERLOAD,
    ErrorCode.BROKEN_OFF: Loss.BROKEN_OFF,
    ErrorCode.DECLINED: Loss.DECLINED,
}


def loss_of(response: Response) -> tuple[Loss | None, str]:
    """Say why a response makes no record, as a loss and for people; (None, "") where it makes
    one.
    """
    code = response.error_code
    if not code:
        return None, ""
    known = code in set(ErrorCode)
    loss = _OF_CODE.get(ErrorCode(code), Loss.ERROR) if known else Loss.ERROR
    return loss, f"the bridge answered error {code}: {response.error_msg[:MOST_REASON]}"


@dataclass(frozen=True)
class ModelReply:
    """The outcome of one request: a response (which may hold an error), or the reason for having
    none.

    Args:
        response: None where none came or it can't be used.
        loss: the kind of that reason; it counts only where there is no response.
    """

    response: Response | None
    reason: str = ""
    loss: Loss = Loss.UNUSABLE


@dataclass
class IgnoredAnswers:
    """Answers that came and weren't used."""

    late: int = 0
    duplicate: int = 0
    unknown: int = 0

    def plus(self, now: IgnoredAnswers, before: IgnoredAnswers) -> IgnoredAnswers:
        """These, and those that came between two counts."""
        return IgnoredAnswers(
            self.late + now.late - before.late,
            self.duplicate + now.duplicate - before.duplicate,
            self.unknown + now.unknown - before.unknown,
        )

    def to_json(self) -> dict[str, int]:
        return {"late": self.late, "duplicate": self.duplicate, "unknown": self.unknown}


class ModelClient(Protocol):
    """Answers the requests of one cell, one at a time."""

    @property
    def ignored(self) -> IgnoredAnswers:
        """Answers that came and weren't used."""

    def ask(self, request: Request) -> ModelReply:
        """The reply; a model that fails costs this reply and raises nothing."""


class ModelClients(Protocol):
    """Gives the client of a cell, starting what has to be started."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        """Raises PeerError: the model's bridge doesn't start or can't be reached."""


class InProcessClient:
    """A backend in this process, without ROS."""

    def __init__(self, name: str, backend: Backend) -> None:
        self._name = name
        self._backend = backend

    @property
    def ignored(self) -> IgnoredAnswers:
        """A call has one result: nothing comes late or twice."""
        return IgnoredAnswers()

    def ask(self, request: Request) -> ModelReply:
        return ModelReply(respond(self._backend, self._name, request).response)


class InProcessClients:
    """All models in this process; attached ones can't be reached from here."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        if model.attached:
            raise InputError(
                "an attached bridge is reached over topics only", field="attach", value=model.name
            )
        return InProcessClient(model.name, make_backend(model.backend_name, options))


class ClientsWithAnswerers:
    """The way to the models, and in this process the answerers that a campaign adds to them.

    They say the same wherever they are, so that no process is started for them, least of all in a
    ROS domain that isn't ours.
    """

    def __init__(self, models: ModelClients) -> None:
        self._models, self._ours = models, InProcessClients()

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        """The client of a model; see Clients."""
        return (self._ours if model.answerer else self._models).client(model, options)


# Far more than a model has to say about one picture; without a bound one answer could fill the
# disk, and every reader of the cell would have to carry it.
MOST_CHARACTERS = 1 << 20
MOST_NUMBERS = 1 << 18
# Settings are a few lines; all of a cell's answers' together must fit into its summary.
MOST_DECODING = 1 << 16
# Decoding facts that differ by answer and stay with it, such as a model's thoughts.
PER_ANSWER = frozenset(
    (
        "stages",
        "usage",
        "latency_s",
        "notes",
        "frames",
        "prompt_sha256",
        "previous_intent_sha256",
    )
)
# A name is listed in every summary.
MOST_NAME = 1000


def settings_of(response: Response) -> dict[str, Any]:
    """Return the decoding settings of an answer, without those that differ by answer."""
    return {key: value for key, value in response.decoding.items() if key not in PER_ANSWER}


def unusable(response: Response) -> str:
    """Say why an answer can't be stored, whatever its content; empty where it can."""
    texts = (response.text, response.error_msg, response.model_id, response.model)
    characters = sum(len(text) for text in texts)
    if characters > MOST_CHARACTERS:
        return f"the answer has {characters} characters, more than {MOST_CHARACTERS}"
    if len(response.model_id) > MOST_NAME:
        return f"the model's name has {len(response.model_id)} characters, more than {MOST_NAME}"
    numbers = sum(len(array.data) + len(array.shape) for array in response.arrays)
    if numbers > MOST_NUMBERS:
        return f"the answer has {numbers} numbers, more than {MOST_NUMBERS}"
    try:
        decoding = len(json.dumps(dict(response.decoding), allow_nan=False))
        settings = len(json.dumps(settings_of(response), allow_nan=False))
    except (ValueError, TypeError, RecursionError) as error:
        return f"the answer's decoding is no JSON: {error}"
    for count, most in ((decoding, MOST_CHARACTERS), (settings, MOST_DECODING)):
        if count > most:
            return f"the answer's decoding has {count} characters, more than {most}"
    return ""


class RequestTracker:
    """The conversation with one model. Only the first answer to the open request is used."""

    def __init__(self) -> None:
        self.ignored = IgnoredAnswers()
        self._open: Request | None = None
        self._reply: ModelReply | None = None
        self._answered: set[str] = set()
        self._given_up: set[str] = set()

    def open(self, request: Request) -> None:
        """A request is about to be sent.

        Raises:
            ValueError: another one is open still.
        """
        if self._open is not None:
            raise ValueError(f"request {self._open.request_id} is open still")
        self._open = request
        self._reply = None

    def offer(self, response: Response) -> None:
        """An answer came; it is used, or counted as late, duplicate or unknown."""
        asked = self._open
        if asked is not None and response.request_id == asked.request_id:
            self._answered.add(asked.request_id)
            self._open = None
            problem = unusable(response)
            self._reply = ModelReply(None, problem) if problem else ModelReply(response)
            if response.stamp_ns != asked.stamp_ns:
                reason = f"the answer is stamped {response.stamp_ns} ns, asked was {asked.stamp_ns}"
                self._reply = ModelReply(None, reason)
        elif response.request_id in self._given_up:
            self.ignored.late += 1
        elif response.request_id in self._answered:
            self.ignored.duplicate += 1
        else:
            self.ignored.unknown += 1

    def offer_unreadable(self, request_id: str, reason: str) -> None:
        """An answer came that can't be read; it costs its own request only."""
        if self._open is not None and request_id == self._open.request_id:
            self._answered.add(request_id)
            self._open = None
            self._reply = ModelReply(None, f"the answer can't be read: {reason}")
        else:
            self.ignored.unknown += 1

    def take(self) -> ModelReply | None:
        """The reply to the last request, once; None while there is none."""
        reply, self._reply = self._reply, None
        return reply

    def give_up(self) -> None:
        """Give the open request up; an answer from now on is late."""
        if self._open is not None:
            self._given_up.add(self._open.request_id)
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
        """Publishes a request."""

    def matched(self) -> bool:
        """True while a bridge that wasn't forgotten is on both topics."""

    def forget(self) -> None:
        """The bridge that is on the topics now has ended, whatever discovery still says."""


class Transport(Protocol):
    """A node that talks to bridges; spun only while somebody waits."""

    def link(self, model: str, exchange: RequestTracker) -> TopicLink:
        """The topics of a model; its answers go to the exchange."""

    def spin(self, timeout_s: float) -> None:
        """Handles what came, for at most this long."""


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
        """Starts the bridge where it is ours, and waits until it is on the topics.

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
        """Ends the bridge if it was started here; the next request starts it again."""
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
        """The reply to one request; whatever the bridge does costs this reply only.

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


BRIDGE_MODULE = "ssp_vla_bridge.ros.vla_bridge"
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
# The backend gives up before its bridge does, so that its own reason is what is recorded.
_SHARE_OF_BACKEND = 0.95
# Of the time to start, this much may go by until a service behind the bridge is ready.
_SHARE_OF_SERVICE = 0.6


class TopicClients(Closing):
    """The bridges of a campaign; leaving the block ends those that were started here.

    Nothing is started before the first client is wanted, so that a campaign whose answers are all
    stored needs no ROS.

    Args:
        timeout_s: for one answer, where the model has no time of its own.
        attached: the bridges run already, in the domain that the environment names.
    """

    def __init__(
        self,
        log_dir: Path,
        timeout_s: float,
        attached: bool,
        start_timeout_s: float = CONNECT_S,
    ) -> None:
        self._log_dir = log_dir
        self._timeouts = Timeouts(timeout_s, start_timeout_s)
        self._attached = attached
        self._stack = ExitStack()
        self._transport: Transport | None = None
        self._group: ProcessGroup | None = None
        self._clients: dict[str, tuple[str, TopicClient]] = {}
        self._exchanges: dict[str, tuple[RequestTracker, TopicLink]] = {}

    def close(self) -> None:
        self._stack.close()

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        """The client of a model with its backend's options; bridges are kept while these stay.

        Raises:
            PeerError: the bridge doesn't start or isn't on the topics.
            HostError: ROS isn't here.
        """
        timeouts = self._timeouts
        if model.timeout_s is not None:
            timeouts = replace(timeouts, answer_s=model.timeout_s)
        text = json.dumps(_in_time(model, options, timeouts), sort_keys=True)
        known = self._clients.get(model.name)
        if known is not None and known[0] == text:
            self._exchanges[model.name][0].ignored = IgnoredAnswers()
            # At once where it is on its topics; one that was too slow for the cell before may be
            # there by now, and isn't started a second time.
            known[1].connect()
            return known[1]
        transport = self._open()
        if model.name not in self._exchanges:
            exchange = RequestTracker()
            self._exchanges[model.name] = exchange, transport.link(model.name, exchange)
        exchange, link = self._exchanges[model.name]
        exchange.ignored = IgnoredAnswers()
        start = None if model.attached else lambda: self._start(model, text, timeouts.answer_s)
        if known is not None:
            known[1].stop()
        gives_up = not model.attached and model.backend_name in OPTION_TIMEOUT
        client = TopicClient(model.name, transport, exchange, link, timeouts, start, gives_up)
        self._clients[model.name] = text, client
        client.connect()
        return client

    def _open(self) -> Transport:
        if self._transport is None:
            if not self._attached:
                # Not in somebody else's domain: leaving a process group removes what is left of
                # the domain's shared memory, whoever uses it.
                domain_id = self._stack.enter_context(free_domain())
                environment = session_environment(domain_id, PROFILE)
                self._stack.enter_context(adopted(environment))
                self._group = self._stack.enter_context(ProcessGroup(environment, self._log_dir))
            try:
                node = importlib.import_module("ssp_eval.ros.model_node")
            except ImportError as error:
                raise HostError(
                    f"ROS 2 can't be imported ({error}); bridges are reached over topics, so use "
                    "`./ssp`, or a shell in which ROS 2 Jazzy and this workspace are set up"
                ) from error
            transport: Transport = self._stack.enter_context(node.open_transport())
            self._transport = transport
        return self._transport

    def _start(self, model: ModelSpec, options: str, timeout_s: float) -> NodeProcess:
        if self._group is None:
            raise ValueError("bridges are started in a domain of their own, or not at all")
        parameters: dict[str, object] = {
            "model": model.name,
            "backend": model.backend_name,
            "timeout_s": float(timeout_s),
        }
        if options != "{}":
            # Parameter values are read as YAML; the quoted text stays one string.
            parameters["backend_options"] = json.dumps(options)
        return self._group.start_node(f"bridge_{model.name}", BRIDGE_MODULE, parameters)


def _in_time(model: ModelSpec, options: Mapping[str, Any], timeouts: Timeouts) -> dict[str, Any]:
    """The options with the campaign's times, for a backend that waits for a service itself."""
    times: dict[str, Any] = {}
    if model.attached:
        return dict(options)
    if model.backend_name in OPTION_TIMEOUT:
        # Also where the options give a longer time: a backend that goes on after its bridge gave up
        # keeps the next requests waiting.
        share_s = timeouts.answer_s * _SHARE_OF_BACKEND
        given_s = options.get("timeout_s")
        times["timeout_s"] = share_s if given_s is None else min(given_s, share_s)
    if model.backend_name in OPTION_START and "start_s" not in options:
        # The rest is for the process to start and to be found.
        times["start_s"] = timeouts.start_s * _SHARE_OF_SERVICE
    return {**options, **times}
