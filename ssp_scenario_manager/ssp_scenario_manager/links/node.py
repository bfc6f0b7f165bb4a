"""Topics and services between the manager and each object target."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.references import Acknowledgement, decode_ack, encode_reference
from ssp_core.cdr.states import decode_state
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import RunSpec
from ssp_msgs.msg import ObjectState, ObjectStates, ReferenceAck
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand
from ssp_scenario_manager.core import outbox

# Told of a refused command: object id, whether it was to arm, reason.
OnRefusal = Callable[[str, bool, str], None]


class ObjectLinks:
    """Publishers, subscriptions and clients of the objects that were ever connected.

    Args:
        node: owns the endpoints.
        on_state: takes each state that comes by itself.
        on_array: takes each ObjectStates message as bytes.
        on_ack: takes each acknowledgement.
        on_refusal: takes each command that an object refused.
    """

    def __init__(
        self,
        node: Node,
        on_state: Callable[[State], None],
        on_array: Callable[[bytes], None],
        on_ack: Callable[[Acknowledgement], None],
        on_refusal: OnRefusal,
    ) -> None:
        self._node = node
        self._on_state = on_state
        self._on_array = on_array
        self._on_ack = on_ack
        self._on_refusal = on_refusal
        self._hears_arrays = False
        self._heard: set[str] = set()
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self.references_sent: dict[str, int] = {}

    def connect(self, object_ids: Iterable[str], states_in_one: bool) -> None:
        """Makes the endpoints of objects that are new; the others keep theirs.

        Args:
            object_ids: objects of the run.
            states_in_one: their processes send one message for all their states.
        """
        raw = partial(ros.subscribe_raw, self._node)
        if states_in_one and not self._hears_arrays:
            self._hears_arrays = True
            topic = names.OBJECT_STATES
            self._node.create_subscription(ObjectStates, topic, self._on_array, ros.STATE, raw=True)
        for object_id in object_ids:
            if not states_in_one and object_id not in self._heard:
                self._heard.add(object_id)
                topic = names.state_topic(object_id)
                raw(ObjectState, topic, decode_state, self._on_state, ros.STATE)
            if object_id in self._publishers:
                continue
            node = self._node
            self._publishers[object_id] = node.create_publisher(
                ReferenceMsg, names.reference_topic(object_id), ros.COMMAND
            )
            self._clients[object_id] = node.create_client(
                ObjectCommand, names.command_service(object_id)
            )
            raw(ReferenceAck, names.ack_topic(object_id), decode_ack, self._on_ack, ros.COMMAND)
            self.references_sent[object_id] = 0

    def send(self, reference: Reference) -> None:
        """Publishes a reference and counts it."""
        self._publishers[reference.object_id].publish(encode_reference(reference))
        self.references_sent[reference.object_id] += 1

    def command(self, spec: RunSpec, wish: outbox.ArmObjects | outbox.ClearObjects) -> None:
        """Sends a command to each object of a run; only refusals are reported back."""
        if isinstance(wish, outbox.ClearObjects):
            command = ObjectCommand.Request.COMMAND_ALL_CLEAR
        elif wish.armed:
            command = ObjectCommand.Request.COMMAND_ARM
        else:
            command = ObjectCommand.Request.COMMAND_DISARM
        for target in spec.targets:
            request = ObjectCommand.Request(command=command, event_version=spec.event_version)
            future = self._clients[target.id].call_async(request)
            future.add_done_callback(partial(self._on_answer, target.id, wish))

    def _on_answer(
        self, object_id: str, wish: outbox.ArmObjects | outbox.ClearObjects, future: Any
    ) -> None:
        answer = future.result()
        if answer is not None and not answer.accepted:
            arming = isinstance(wish, outbox.ArmObjects) and wish.armed
            self._on_refusal(object_id, arming, answer.error_msg)
