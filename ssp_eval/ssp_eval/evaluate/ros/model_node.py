"""The evaluator's own node: sends requests on topics and hands answers to their exchange."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node

from ssp_core.names import vla_request_topic, vla_response_topic
from ssp_core.ros import VLA, init, make_executor, make_node
from ssp_eval.evaluate.clients.topic_client import RequestTracker
from ssp_msgs.msg import VlaRequest, VlaResponse
from ssp_vla_bridge.backends.recorded import response_of_message
from ssp_vla_bridge.messages import Request
from ssp_vla_bridge.ros.conversions import request_to_msg

NAME = "evaluator"


class RosLink:
    """The topics of one model."""

    def __init__(self, node: Node, model: str, exchange: RequestTracker) -> None:
        self._node = node
        self._exchange = exchange
        self._topics = vla_request_topic(model), vla_response_topic(model)
        self._departed_gids: set[bytes] = set()
        self._publisher = node.create_publisher(VlaRequest, self._topics[0], VLA)
        self._subscription = node.create_subscription(
            VlaResponse, self._topics[1], self._on_response, VLA
        )

    def send(self, request: Request) -> None:
        """Publish a request."""
        self._publisher.publish(request_to_msg(request))

    def matched(self) -> bool:
        """Return True while a bridge is on both topics that wasn't forgotten."""
        readers, writers = self._endpoints()
        matched = self._publisher.get_subscription_count() > 0
        return (
            matched and bool(readers - self._departed_gids) and bool(writers - self._departed_gids)
        )

    def forget(self) -> None:
        """Ignore the nodes on the topics now: DDS believes in a killed process for a while yet."""
        readers, writers = self._endpoints()
        self._departed_gids |= readers | writers

    def _endpoints(self) -> tuple[set[bytes], set[bytes]]:
        readers = self._node.get_subscriptions_info_by_topic(
            self._node.resolve_topic_name(self._topics[0])
        )
        writers = self._node.get_publishers_info_by_topic(
            self._node.resolve_topic_name(self._topics[1])
        )
        return (
            {bytes(info.endpoint_gid) for info in readers},
            {bytes(info.endpoint_gid) for info in writers},
        )

    def _on_response(self, msg: Any) -> None:
        try:
            response = response_of_message(msg)
        except (ValueError, RecursionError) as error:
            self._exchange.offer_unreadable(msg.request_id, str(error))
            return
        self._exchange.offer(response)


class RosTransport:
    """The evaluator's node with its executor, which runs only while somebody waits."""

    def __init__(self, node: Node, executor: Executor) -> None:
        self._node = node
        self._executor = executor

    def link(self, model: str, exchange: RequestTracker) -> RosLink:
        """Return the topics of a model."""
        return RosLink(self._node, model, exchange)

    def spin(self, timeout_s: float) -> None:
        """Handle incoming messages, for at most this long."""
        self._executor.spin_once(timeout_sec=timeout_s)


@contextmanager
def open_transport() -> Iterator[RosTransport]:
    """Yield a node in the domain that the environment names; an rclpy that runs already is used.

    Signals are left alone: Ctrl-C is a KeyboardInterrupt in the waiting thread.
    """
    with ExitStack() as stack:
        if not rclpy.ok():
            init()
            stack.callback(rclpy.try_shutdown)
        node = make_node(NAME)
        stack.callback(node.destroy_node)
        executor = make_executor()
        stack.callback(executor.shutdown)
        executor.add_node(node)
        yield RosTransport(node, executor)
