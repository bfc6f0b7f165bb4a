"""Topics and services between the manager and each object target."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.conversions import reference_to_msg
from ssp_core.reference import Reference
from ssp_msgs.msg import ObjectState, ReferenceAck
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand

# Told of a refused command: object id, COMMAND_* number, reason.
OnRefusal = Callable[[str, int, str], None]


class ObjectLinks:
    """Publishers, subscriptions and clients of the objects that were ever connected.

    Args:
        node: owns the endpoints.
        on_state: takes each state message.
        on_ack: takes each acknowledgement.
        on_refusal: takes each command that an object refused.
    """

    def __init__(
        self,
        node: Node,
        on_state: Callable[[ObjectState], None],
        on_ack: Callable[[ReferenceAck], None],
        on_refusal: OnRefusal,
    ) -> None:
        self._node = node
        self._on_state = on_state
        self._on_ack = on_ack
        self._on_refusal = on_refusal
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self.references_sent: dict[str, int] = {}

    def connect(self, object_ids: Iterable[str]) -> None:
        """Makes the endpoints of objects that are new; the others keep theirs."""
        for object_id in object_ids:
            if object_id in self._publishers:
                continue
            node = self._node
            self._publishers[object_id] = node.create_publisher(
                ReferenceMsg, names.reference_topic(object_id), ros.COMMAND
            )
            self._clients[object_id] = node.create_client(
                ObjectCommand, names.command_service(object_id)
            )
            node.create_subscription(
                ObjectState, names.state_topic(object_id), self._on_state, ros.STATE
            )
            node.create_subscription(
                ReferenceAck, names.ack_topic(object_id), self._on_ack, ros.COMMAND
            )
            self.references_sent[object_id] = 0

    def send(self, reference: Reference) -> None:
        """Publishes a reference and counts it."""
        self._publishers[reference.object_id].publish(reference_to_msg(reference))
        self.references_sent[reference.object_id] += 1

    def command(self, object_ids: Iterable[str], command: int, event_version: str) -> None:
        """Sends a command to each object; only refusals are reported back."""
        for object_id in object_ids:
            request = ObjectCommand.Request(command=command, event_version=event_version)
            future = self._clients[object_id].call_async(request)
            future.add_done_callback(partial(self._on_answer, object_id, command))

    def _on_answer(self, object_id: str, command: int, future: Any) -> None:
        answer = future.result()
        if answer is not None and not answer.accepted:
            self._on_refusal(object_id, command, answer.error_msg)
