"""Publishers of an object_target: what its objects answer, step by step."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.references import Acknowledgement, encode_ack
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.motion.state import ObjectState as State
from ssp_msgs.msg import (
    ActuatorCommands,
    FaultEvent,
    HeartbeatReply,
    ObjectState,
    ObjectStates,
    ReferenceAck,
    SafetyEvent,
    StepDone,
)
from ssp_ot_controller.sil.conversions import fault_to_msg
from ssp_ot_controller.target.crew_step import Ack, CrewStep, Stopped
from ssp_ot_controller.target.echo import Reply


class Outlet:
    """Publishes for one process of objects.

    Args:
        node: owns the publishers.
        object_ids: its objects.
        states_in_one: all states in one message instead of one per object.
        destroyers: takes what ends each publisher.
    """

    def __init__(
        self,
        node: Node,
        object_ids: tuple[str, ...],
        states_in_one: bool,
        destroyers: list[Callable[[], object]],
    ) -> None:
        self._node = node
        self._destroyers = destroyers
        pub = self._pub
        self._command = pub(ActuatorCommands, names.ACTUATOR_COMMANDS, ros.COMMAND)
        self._done = pub(StepDone, names.STEP_DONE, ros.STATE)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._fault = pub(FaultEvent, names.FAULT_EVENT, ros.LATCHED)
        self._reply = pub(HeartbeatReply, names.HEARTBEAT_REPLY, ros.STATE)
        self._states = None
        self._state: dict[str, Any] = {}
        if states_in_one:
            self._states = pub(ObjectStates, names.OBJECT_STATES, ros.STATE)
        else:
            self._state = {i: pub(ObjectState, names.state_topic(i), ros.STATE) for i in object_ids}
        self._ack = {i: pub(ReferenceAck, names.ack_topic(i), ros.COMMAND) for i in object_ids}

    def _pub(self, kind: Any, topic: str, qos: QoSProfile) -> Any:
        publisher = self._node.create_publisher(kind, topic, qos)
        self._destroyers.append(partial(self._node.destroy_publisher, publisher))
        return publisher

    def send(self, step: CrewStep | None) -> None:
        """Everything that a step led to; nothing for None."""
        if step is None:
            return
        stamp = ros.stamp_from_ns(step.now_ns)
        for change in step.faults:
            self._fault.publish(fault_to_msg(change, self._node.get_name(), step.now_ns))
        for ack in step.acks:
            self._send_ack(ack)
        for event in step.events:
            self._announce(event, stamp)
        self._send_states(step.states)
        if step.answered:
            counts = step.counts
            done = steps.StepDone(
                self._node.get_name(),
                step.step,
                states_sent=counts.states,
                acks_sent=counts.acks,
                safety_events_sent=counts.safety_events,
            )
            self._done.publish(steps.encode_done(done))
        # Last: the manager judges the step meanwhile, and the world waits for it anyway.
        self._command.publish(steps.encode_commands(self._commands_of(step)))

    def reply(self, reply: Reply) -> None:
        """An answer to a heartbeat; one that leaves now is stamped here, as late as may be."""
        message = HeartbeatReply(
            participant=self._node.get_name(),
            object_ids=list(reply.object_ids),
            sequence=reply.sequence,
            heartbeat_sent=ros.stamp_from_ns(reply.sent_ns),
            heartbeat_received=ros.stamp_from_ns(reply.received_ns),
        )
        message.header.frame_id = names.MAP_FRAME
        replied_ns = reply.replied_ns
        if replied_ns is None:
            replied_ns = time.time_ns() + reply.offset_ns
        message.header.stamp = ros.stamp_from_ns(replied_ns)
        self._reply.publish(message)

    def _send_states(self, states: tuple[State, ...]) -> None:
        if self._states is None:
            for state in states:
                self._state[state.object_id].publish(encode_state(state))
        elif states:
            newest_ns = max(state.stamp_ns for state in states)
            array = StateArray(newest_ns, self._node.get_name(), states)
            self._states.publish(encode_states(array))

    def _commands_of(self, step: CrewStep) -> steps.BodyCommands:
        commands = tuple(
            steps.BodyCommand(
                object_id,
                step.step,
                command.acceleration_mps2,
                command.curvature_1pm,
                command.heading_rad,
                command.emergency_stop,
            )
            for object_id, command in step.commands
        )
        return steps.BodyCommands(step.now_ns, self._node.get_name(), step.step, commands)

    def _send_ack(self, ack: Ack) -> None:
        answer = Acknowledgement(
            ack.stamp_ns,
            ack.reference_id,
            ack.object_id,
            ack.refusal is None,
            int(ack.refusal.code) if ack.refusal else 0,
            ack.refusal.message if ack.refusal else "",
        )
        self._ack[ack.object_id].publish(encode_ack(answer))

    def _announce(self, event: Stopped, stamp: Any) -> None:
        stop = event.stop
        message = SafetyEvent(
            code=int(stop.code),
            limit_name=stop.limit_name,
            source=self._node.get_name(),
            object_id=event.object_id,
            measured=stop.measured,
            limit=stop.limit,
            unit=stop.unit,
            reaction="local_stop",
        )
        message.header.stamp = stamp
        message.header.frame_id = names.MAP_FRAME
        self._safety.publish(message)
        self._node.get_logger().error(
            f"{event.object_id}: {stop.limit_name} {stop.measured:.3g} (limit {stop.limit:.3g})"
        )
