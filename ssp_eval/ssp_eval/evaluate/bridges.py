"""The bridges of a campaign: started here in a domain of their own, or attached."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import ssp_core
from ssp_core.closing import Closing
from ssp_core.errors import HostError
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import adopted, session_environment
from ssp_core.host.processes import NodeProcess, ProcessGroup
from ssp_eval.evaluate.clients.model_client import ModelClient
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.clients.topic_client import (
    CONNECT_S,
    RequestTracker,
    Timeouts,
    TopicClient,
    TopicLink,
    Transport,
)
from ssp_vla_bridge.backend import OPTION_START, OPTION_TIMEOUT

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
        """Return the client of a model; its bridge is kept while the backend's options stay.

        Raises:
            PeerError: the bridge doesn't start or isn't on the topics.
            HostError: ROS isn't here.
        """
        timeouts = self._timeouts
        if model.timeout_s is not None:
            timeouts = replace(timeouts, answer_s=model.timeout_s)
        text = json.dumps(_in_time(model, options, timeouts), sort_keys=True)
        entry = self._clients.get(model.name)
        if entry is not None and entry[0] == text:
            self._exchanges[model.name][0].ignored = IgnoredAnswers()
            # At once where it is on its topics; one that was too slow for the cell before may be
            # there by now, and isn't started a second time.
            entry[1].connect()
            return entry[1]
        transport = self._open()
        if model.name not in self._exchanges:
            exchange = RequestTracker()
            self._exchanges[model.name] = exchange, transport.link(model.name, exchange)
        exchange, link = self._exchanges[model.name]
        exchange.ignored = IgnoredAnswers()
        start = None if model.attached else lambda: self._start(model, text, timeouts.answer_s)
        if entry is not None:
            entry[1].stop()
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
                from ssp_eval.evaluate.ros.model_node import open_transport
            except ImportError as error:
                raise HostError(
                    f"ROS 2 can't be imported ({error}); bridges are reached over topics, so use "
                    "`./ssp`, or a shell in which ROS 2 Jazzy and this workspace are set up"
                ) from error
            self._transport = self._stack.enter_context(open_transport())
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
    """Return the options with the campaign's timeouts, for a backend that awaits a service."""
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
