"""Hears a session for a board: states of all objects, session, phases, recorder, links, manager."""

from __future__ import annotations

import time
from functools import partial

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.states import decode_state, decode_states
from ssp_core.cdr.steps import decode_heartbeat
from ssp_core.ros.conversions import rules_from_msg
from ssp_monitor.status import messages
from ssp_monitor.status.board import Board, Newest
from ssp_msgs.msg import (
    BodyStatus,
    Heartbeat,
    LinkStatus,
    LocalisationStatus,
    ObjectRules,
    ObjectState,
    ObjectStates,
    PhaseEvent,
    RecorderStatus,
    SessionState,
)

# Objects that no run file names are looked for this often, s.
LOOK_PERIOD_S = 1.0
# ``ssp replay`` is this node.
_REPLAY_NODE = ("replay", names.NAMESPACE)
_STATE_TYPE = "ssp_msgs/msg/ObjectState"


class SessionSubscriptions:
    """Writes what is heard on a board; the busy topics are decoded only when settle() asks."""

    def __init__(self, node: Node, board: Board) -> None:
        self._node = node
        self._board = board
        self._single = Newest(lambda data: (decode_state(data),))
        self._arrays = Newest(lambda data: decode_states(data).states)
        self._heartbeat: bytes | None = None
        self._warned_topics: set[str] = set()
        self._followed: set[str] = set()
        sub = node.create_subscription
        sub(ObjectStates, names.OBJECT_STATES, self._on_array, ros.STATE, raw=True)
        sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE, raw=True)
        sub(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        sub(PhaseEvent, names.PHASE_EVENT, self._on_phase, ros.LATCHED)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        sub(LinkStatus, names.LINK_STATUS, self._on_links, ros.STATE)
        status = names.LOCALISATION_STATUS
        sub(LocalisationStatus, status, self._on_localisation, ros.STATE)
        sub(BodyStatus, names.BODY_STATUS, self._on_body_status, ros.STATE)
        for target in () if board.run is None else board.run.targets:
            topic, hear = names.rules_topic(target.id), board.rules.hear
            kind, qos = ObjectRules, ros.LATCHED
            ros.subscribe_raw(node, kind, topic, rules_from_msg, hear, qos, raw=False)

    def look_around(self) -> None:
        """Follow objects that have topics of their own, and notice whether a bag is replayed."""
        self._board.replay = _REPLAY_NODE in self._node.get_node_names_and_namespaces()
        for topic, kinds in self._node.get_topic_names_and_types():
            if topic.startswith(f"{names.NAMESPACE}/") and _STATE_TYPE in kinds:
                self.follow(topic)

    def follow(self, topic: str) -> None:
        """Hear the states of one object."""
        if topic not in self._followed:
            self._followed.add(topic)
            take = partial(self._on_state, topic)
            self._node.create_subscription(ObjectState, topic, take, ros.STATE, raw=True)

    def settle(self) -> None:
        """Decode the newest states and heartbeats, and write them on the board."""
        for newest in (self._single, self._arrays):
            states, problems = newest.take()
            for group, at_ns in states:
                self._board.hear_states(group, at_ns)
            for problem in problems:
                self.tell_once(problem)
        if self._heartbeat is None:
            return
        data, self._heartbeat = self._heartbeat, None
        try:
            beat = decode_heartbeat(data)
            self._board.manager.stamp_ns = beat.stamp_ns
            self._board.manager.session_token = beat.session_token
        except ValueError as error:
            self.tell_once(f"{names.HEARTBEAT}: {error}")

    def tell_once(self, problem: str) -> None:
        """Say what is wrong with a topic, ``TOPIC: what``, the first time."""
        topic = problem.partition(":")[0]
        if topic not in self._warned_topics:
            self._warned_topics.add(topic)
            self._node.get_logger().error(
                f"message dropped (more will be without a word): {problem}"
            )

    # -- what is heard ---------------------------------------------------------------------------

    def _on_state(self, topic: str, data: bytes) -> None:
        self._single.put(topic, data, time.monotonic_ns())

    def _on_array(self, data: bytes) -> None:
        try:
            self._arrays.put(messages.source_of(data), data, time.monotonic_ns())
        except ValueError as error:
            self.tell_once(f"{names.OBJECT_STATES}: {error}")

    def _on_heartbeat(self, data: bytes) -> None:
        self._heartbeat = data
        self._board.manager.at_ns = time.monotonic_ns()

    def _on_session(self, message: SessionState) -> None:
        try:
            self._board.hear_session(messages.session_fact(message), time.monotonic_ns())
        except ValueError as error:
            self.tell_once(f"{names.SESSION_STATE}: {error}")

    def _on_phase(self, message: PhaseEvent) -> None:
        try:
            self._board.hear_phase(*messages.phase_of(message))
        except ValueError as error:
            self.tell_once(f"{names.PHASE_EVENT}: {error}")

    def _on_links(self, message: LinkStatus) -> None:
        at_ns, strangers = time.monotonic_ns(), messages.strangers_of(message)
        self._board.hear_links(messages.link_facts(message), at_ns, strangers)

    def _on_localisation(self, message: LocalisationStatus) -> None:
        self._board.hear_localisation(messages.localisation(message), time.monotonic_ns())

    def _on_body_status(self, message: BodyStatus) -> None:
        self._board.hear_body(messages.body_status(message), time.monotonic_ns())

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._board.hear_recorder(messages.recorder_fact(message), time.monotonic_ns())
