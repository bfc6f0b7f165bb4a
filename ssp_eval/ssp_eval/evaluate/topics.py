"""Bridges over topics: started here in a ROS domain of their own, or attached where they run."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import ssp_core
from ssp_core.domains import free_domain
from ssp_core.errors import HostError, PeerError
from ssp_core.processes import NodeProcess, ProcessGroup, session_environment
from ssp_eval.evaluate.asker import Asker, Ignored, Loss, Reply
from ssp_eval.evaluate.exchange import Exchange
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_vla_bridge.core.request import Request

BRIDGE_MODULE = "ssp_vla_bridge.node"
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
# A bridge has this long to appear on the topics unless the user says otherwise: it loads its
# model before it subscribes.
CONNECT_S = 30.0
_SPIN_S = 0.05
# The bridge's own timeout comes first, so that its numbered error is what is recorded.
_GRACE_S = 2.0
_MAX_RESTARTS = 2
_VARIABLES = (
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "RMW_IMPLEMENTATION",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)


class Link(Protocol):
    """The topics of one model, as the evaluator's node has them."""

    def send(self, request: Request) -> None:
        """Publishes a request."""

    def matched(self) -> bool:
        """True while a bridge that wasn't forgotten is on both topics."""

    def forget(self) -> None:
        """The bridge that is on the topics now has ended, whatever discovery still says."""


class Transport(Protocol):
    """A node that talks to bridges; spun only while somebody waits."""

    def link(self, model: str, exchange: Exchange) -> Link:
        """The topics of a model; its answers go to the exchange."""

    def spin(self, timeout_s: float) -> None:
        """Handles what came, for at most this long."""


@dataclass(frozen=True)
class Timeouts:
    """How long a bridge is waited for.

    Args:
        answer_s: for one answer.
        start_s: until it is on the topics.
    """

    answer_s: float
    start_s: float = CONNECT_S


class TopicAsker:
    """Asks one model over its topics.

    Args:
        model: name.
        transport: the evaluator's node.
        exchange: the model's conversation.
        link: the model's topics.
        timeouts: for an answer and for a start.
        start: starts the bridge (again); None: it is attached and not ours.
    """

    def __init__(
        self,
        model: str,
        transport: Transport,
        exchange: Exchange,
        link: Link,
        timeouts: Timeouts,
        start: Callable[[], NodeProcess] | None,
    ) -> None:
        self._model = model
        self._transport = transport
        self._exchange = exchange
        self._link = link
        self._timeouts = timeouts
        self._start = start
        self.process: NodeProcess | None = None
        self._deaths = 0
        self._connected = False

    @property
    def ignored(self) -> Ignored:
        """Answers that came and weren't used."""
        return self._exchange.ignored

    def connect(self) -> None:
        """Starts the bridge where it is ours, and waits until it is on the topics.

        Raises:
            PeerError: it doesn't come, or ends before that.
        """
        if self._start is not None and (
            self.process is None or self.process.returncode is not None
        ):
            self._link.forget()
            self.process = self._start()
        wait_s = self._timeouts.start_s
        if self._start is None and self._deaths:
            # It didn't come back within the whole wait; the other records don't wait for it again.
            wait_s = 0.0
        deadline = time.monotonic() + wait_s
        while not self._link.matched():
            if self.process is not None and self.process.returncode is not None:
                raise PeerError(self._died("ended before it was ready"))
            if time.monotonic() > deadline:
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
        self._connected = True

    def ask(self, request: Request) -> Reply:
        """The reply to one request; whatever the bridge does costs this reply only."""
        if not self._alive():
            if self._start is not None and self._deaths > _MAX_RESTARTS:
                gone = f"the bridge died {self._deaths} times and was given up"
                return Reply(None, gone, Loss.DIED)
            self._connected = False
            try:
                self.connect()
            except PeerError as error:
                self._deaths += 1
                return Reply(None, str(error), Loss.UNREACHABLE)
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
                return Reply(None, self._died("died before it answered"), Loss.DIED)
        self._exchange.give_up()
        return Reply(None, f"no answer within {self._timeouts.answer_s:g} s", Loss.SILENT)

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


class TopicAskers:
    """The bridges of a campaign; leaving the block ends those that were started here.

    Nothing is started before the first asker is wanted, so that a campaign whose answers are all
    stored needs no ROS.

    Args:
        log_dir: for the bridges' output.
        timeout_s: for one answer, where the model has no time of its own.
        start_timeout_s: until a bridge is on its topics.
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
        self._askers: dict[str, tuple[str, TopicAsker]] = {}
        self._exchanges: dict[str, tuple[Exchange, Link]] = {}
        self._running: dict[str, NodeProcess] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        """The asker of a model with its backend's options; bridges are kept while these stay.

        Raises:
            PeerError: the bridge doesn't start or isn't on the topics.
            HostError: ROS isn't here.
        """
        text = json.dumps(dict(options), sort_keys=True)
        known = self._askers.get(model.name)
        if known is not None and known[0] == text:
            self._exchanges[model.name][0].ignored = Ignored()
            return known[1]
        transport = self._open()
        if model.name not in self._exchanges:
            exchange = Exchange()
            self._exchanges[model.name] = exchange, transport.link(model.name, exchange)
        exchange, link = self._exchanges[model.name]
        exchange.ignored = Ignored()
        timeouts = self._timeouts
        if model.timeout_s is not None:
            timeouts = replace(timeouts, answer_s=model.timeout_s)
        start = None if model.attached else lambda: self._start(model, text, timeouts.answer_s)
        if known is not None:
            self._stop(model.name, link)
        asker = TopicAsker(model.name, transport, exchange, link, timeouts, start)
        asker.connect()
        self._askers[model.name] = text, asker
        return asker

    def _open(self) -> Transport:
        if self._transport is None:
            if not self._attached:
                # Not in somebody else's domain: leaving a process group removes what is left of
                # the domain's shared memory, whoever uses it.
                domain_id = self._stack.enter_context(free_domain())
                environment = session_environment(domain_id, PROFILE)
                self._stack.enter_context(_variables(environment))
                self._group = self._stack.enter_context(ProcessGroup(environment, self._log_dir))
            try:
                node = importlib.import_module("ssp_eval.evaluate.node")
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
        process = self._group.start_node(f"bridge_{model.name}", BRIDGE_MODULE, parameters)
        self._running[model.name] = process
        return process

    def _stop(self, model: str, link: Link) -> None:
        """Ends a bridge whose options change."""
        process = self._running.get(model)
        if process is None:
            return
        process.expected_to_stop = True
        process.process.terminate()
        try:
            process.process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.process.kill()
            process.process.wait()
        link.forget()


@contextmanager
def _variables(environment: Mapping[str, str]) -> Iterator[None]:
    """Gives this process the bridges' ROS environment, and its own back afterwards."""
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update({n: environment[n] for n in _VARIABLES if n in environment})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
