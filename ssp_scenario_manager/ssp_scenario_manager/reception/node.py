"""Subscriptions of the manager: the world, the VUT, the recorder, the camera, everybody's events.

Messages become dataclasses here; what is none is dropped and logged, which is as good as silence.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Protocol

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.states import decode_state
from ssp_core.cdr.steps import decode_done, decode_tick_head
from ssp_core.motion.state import ObjectState as State
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_msgs.msg import (
    HeartbeatReply,
    ObjectState,
    RecorderStatus,
    SafetyEvent,
    StepDone,
    WorldTick,
)
from ssp_scenario_manager.core.link_clock import Exchange
from ssp_scenario_manager.core.supervisor import Violation
from ssp_scenario_manager.core.vigil import Vigil

# Topics with one publisher in a session: two would lead it, or tell it two truths.
_ONE_PUBLISHER = (
    names.HEARTBEAT,
    names.SESSION_STATE,
    names.state_topic(names.VUT_ID),
    names.WORLD_TICK,
    names.CLOCK,
)
# Reasons are for people; names that are longer are cut.
_MOST_TEXT = 200


class Listener(Protocol):
    """What the manager does with what arrives."""

    def on_tick(self, tick: steps.WorldTick) -> None:
        """The world has stepped, or holds."""

    def on_step_done(self, done: steps.StepDone) -> None:
        """A participant has answered a step."""

    def on_vut_state(self, state: State) -> None:
        """A state of the VUT."""

    def on_event(self, violation: Violation, source: str) -> None:
        """Another node saw a limit passed."""

    def on_recorder(self) -> None:
        """The recorder has told the vigil how it is."""


class Reception:
    """Owns the subscriptions.

    Args:
        node: owns the endpoints.
        vigil: notes who was heard, and measures the links.
        listener: takes the rest.
    """

    def __init__(self, node: Node, vigil: Vigil, listener: Listener) -> None:
        self._node = node
        self._vigil = vigil
        self._listener = listener
        self._looked = 0
        sub, raw = node.create_subscription, partial(ros.subscribe_raw, node)
        raw(WorldTick, names.WORLD_TICK, decode_tick_head, listener.on_tick, ros.STATE)
        raw(StepDone, names.STEP_DONE, decode_done, listener.on_step_done, ros.STATE)
        vut_topic = names.state_topic(names.VUT_ID)
        raw(ObjectState, vut_topic, decode_state, listener.on_vut_state, ros.STATE)
        reply = names.HEARTBEAT_REPLY
        raw(HeartbeatReply, reply, _reply_of, self._on_reply, ros.STATE, raw=False)
        sub(CameraInfo, names.CAMERA_INFO, self._on_camera_info, ros.SENSOR)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        event, take = names.SAFETY_EVENT, self._on_safety_event
        raw(SafetyEvent, event, _violation_of, take, ros.LATCHED, raw=False)

    def look_for_others(self, object_ids: Iterable[str]) -> None:
        """Who else publishes what one node alone may? Heartbeats each time, the rest in turn.

        Args:
            object_ids: whose references are ours alone.
        """
        alone = [*_ONE_PUBLISHER, *map(names.reference_topic, object_ids)]
        self._looked = (self._looked + 1) % len(alone)
        for topic in {names.HEARTBEAT, alone[self._looked]}:
            self._vigil.foreign.pop(topic, None)
            if self._node.count_publishers(topic) <= 1:
                continue
            full = self._node.resolve_topic_name(topic)
            known = self._node.get_publishers_info_by_topic(full)
            # The runner sends the references that a run's faults ask for.
            nodes = sorted(
                f"{one.node_namespace.rstrip('/')}/{one.node_name}"
                for one in known
                if topic in _ONE_PUBLISHER or one.node_name != names.RUNNER
            )
            if len(nodes) > 1:
                self._vigil.foreign[topic] = len(nodes) - 1, f"{topic} has {' and '.join(nodes)}"

    def _on_reply(self, reply: tuple[Sequence[str], int, Exchange]) -> None:
        self._vigil.links.on_reply(*reply, time.monotonic_ns())

    def _on_camera_info(self, _: CameraInfo) -> None:
        self._vigil.hear(names.FRONT_CAMERA, time.monotonic_ns())

    def _on_recorder(self, message: RecorderStatus) -> None:
        # Without a missing topic it is the file or the disk: the first warning says so.
        why = (message.failure,) if message.failure else tuple(message.warnings[:1])
        missing = tuple(message.missing_topics) or why
        self._vigil.hear_recorder(message.ready, missing, message.lost, time.monotonic_ns())
        self._listener.on_recorder()

    def _on_safety_event(self, event: tuple[Violation, str]) -> None:
        if event[1] != self._node.get_name():
            self._listener.on_event(*event)


def _reply_of(message: HeartbeatReply) -> tuple[Sequence[str], int, Exchange]:
    """Whose answer, to which heartbeat, and its four stamps; now is its arrival."""
    sent_ns, received_ns = map(ros.session_ns, (message.heartbeat_sent, message.heartbeat_received))
    replied_ns = ros.session_ns(message.header.stamp)
    exchange = Exchange(sent_ns, received_ns, replied_ns, time.time_ns())
    return message.object_ids, message.sequence, exchange


def _violation_of(message: SafetyEvent) -> tuple[Violation, str]:
    """What another node reports, and which; ValueError for a code that is none."""
    code, source = SafetyCode(message.code), message.source[:_MOST_TEXT]
    limit_name = message.limit_name[:_MOST_TEXT]
    named = MEANINGS[code].limit_name == limit_name
    violation = Violation(
        code,
        message.object_id[:_MOST_TEXT],
        message.measured,
        message.limit,
        ros.ns_from_stamp(message.header.stamp),
        f"seen by {source}" if named else f"{limit_name} of {source}",
    )
    return violation, source
