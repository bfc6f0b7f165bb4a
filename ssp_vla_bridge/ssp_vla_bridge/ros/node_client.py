"""A bridge's node that runs already, asked on its topics; for drivers (docs/closed-loop.md).

Each run asks from a process, and as a node, of its own. An answer is taken by the id of its
request, which no other run has, so that one to an earlier run, or to another node, isn't.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ssp_core.errors import PeerError
from ssp_core.names import vla_request_topic, vla_response_topic
from ssp_core.ros import VLA, init, make_executor, make_node
from ssp_msgs.msg import VlaRequest, VlaResponse
from ssp_vla_bridge.backend import NotTakenError
from ssp_vla_bridge.backends.node import error_of, read_options
from ssp_vla_bridge.backends.recorded import response_of_message
from ssp_vla_bridge.messages import Answer, Request
from ssp_vla_bridge.ros.conversions import request_to_msg

_LOOK_S = 0.05
# A node that left its topics in between may be seen late by discovery, and not be gone.
_GONE_S = 2.0


class NodeClient:
    """A client of one running bridge.

    Args:
        topic: the model's name on its topics.
        domain_id: in which it runs.
        start_s: it is waited for so long.

    Raises:
        PeerError: no bridge is on the topics in time.
    """

    def __init__(self, topic: str, domain_id: int, start_s: float) -> None:
        init(domain_id=domain_id)
        self._name = f"{topic} in domain {domain_id}"
        self._run = uuid.uuid4().hex
        self._model_id = ""
        self._request_id = ""
        self._got: Any = None
        self._node = make_node(f"driver_{self._run}")
        self._requests = self._node.create_publisher(VlaRequest, vla_request_topic(topic), VLA)
        self._responses = vla_response_topic(topic)
        self._node.create_subscription(VlaResponse, self._responses, self._on_response, VLA)
        self._executor = make_executor()
        self._executor.add_node(self._node)
        end_s = time.monotonic() + start_s
        while not self._is_there():
            if time.monotonic() >= end_s:
                raise PeerError(f"no bridge of {self._name} is on its topics within {start_s:g} s")
            self._executor.spin_once(timeout_sec=_LOOK_S)

    @property
    def model_id(self) -> str:
        """The newest answer's."""
        return self._model_id

    def answer(self, request: Request) -> Answer:
        """Return the bridge's answer, whenever it comes.

        Raises:
            SspError: it is an error, or no answer.
        """
        self._request_id, self._got = f"{self._run}.{request.request_id}", None
        self._requests.publish(request_to_msg(replace(request, request_id=self._request_id)))
        seen_s = time.monotonic()
        while self._got is None:
            self._executor.spin_once(timeout_sec=_LOOK_S)
            if self._is_there():
                seen_s = time.monotonic()
            elif time.monotonic() - seen_s > _GONE_S:
                raise NotTakenError(f"the bridge of {self._name} left its topics")
        try:
            response = response_of_message(self._got)
        except (ValueError, RecursionError) as error:
            raise PeerError(f"{self._responses}: the answer can't be read: {error}") from error
        self._model_id = response.model_id
        refused = error_of(self._responses, response.error_code, response.error_msg)
        if refused is not None:
            raise refused
        return Answer(response.text, response.arrays, response.decoding)

    def _is_there(self) -> bool:
        has_listener = self._requests.get_subscription_count() > 0
        return has_listener and self._node.count_publishers(self._responses) > 0

    def _on_response(self, message: Any) -> None:
        if self._got is None and message.request_id == self._request_id:
            self._got = message


def make(options: Mapping[str, Any]) -> NodeClient:
    """Make the client of a running node; ROS begins in this process.

    Raises:
        InputError: as ``read_options``.
        PeerError: no node is on the topics in time.
    """
    node = read_options(options)
    return NodeClient(node.topic, node.domain_id, node.start_s)
