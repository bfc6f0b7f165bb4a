"""Publishers of the manager, endpoints of its objects, and conversions from and to messages."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any
from uuid import uuid4

from rclpy.node import Node, NodeNameNonExistentError
from tf2_msgs.msg import TFMessage

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.references import Acknowledgement, decode_ack, encode_reference
from ssp_core.cdr.states import decode_state
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.ros import stamp_from_ns
from ssp_core.ros.conversions import rules_from_msg
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import contradictions, declaring
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.link_quality import (
    Exchange,
    LossCounter,
    LossCounters,
)
from ssp_core.safety.object_rules import ObjectRules, RulesCheck
from ssp_core.safety.publishers import ONE, Publisher, PublisherRules, is_process, whence
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.event_messages import encode_limit, encode_phase
from ssp_core.world.transforms import TransformFilter, encode_transforms, of_camera
from ssp_msgs.msg import (
    Heartbeat,
    HeartbeatReply,
    LinkStatus,
    ObjectState,
    ObjectStates,
    PhaseEvent,
    ReferenceAck,
    SafetyEvent,
    SessionState,
    StepDone,
    TriggerEvent,
)
from ssp_msgs.msg import ObjectRules as ObjectRulesMsg
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.messages import encode_session_state, encode_trigger
from ssp_scenario_manager.session.object_commands import ObjectCommands, Pending
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.supervision import LivenessMonitor

# The graph names a node some 0.1 s after it shows what the node publishes, now and then 0.4 s; a
# stranger isn't left alone for so long.
_NAMED_WITHIN_NS = seconds_to_ns(0.1)
_UNNAMED = "_NODE_NAME_UNKNOWN_"
# Of a publisher's id, what all publishers of one process share.
_PROCESS_BYTES = 12
# Reasons are for people; names that are longer are cut.
_MOST_TEXT = 200
_LONGEST_SENTENCE = 1000


class PublisherWatch:
    """Finds in the graph who publishes what others publish, by ``ssp_core.safety.publishers``.

    Args:
        node: whose graph is looked at.
        liveness: notes what is found.
        receiver: topics of the VUT's GNSS/INS that are known without its adapter.
    """

    def __init__(self, node: Node, liveness: LivenessMonitor, receiver: Iterable[str] = ()) -> None:
        self._node = node
        self._liveness = liveness
        self._receiver = frozenset(map(node.resolve_topic_name, receiver))
        self._unnamed_since_ns: dict[str, int] = {}
        self._take(PublisherRules())

    def _take(self, rules: PublisherRules) -> None:
        self._rules = rules
        self._full_names = {one: self._node.resolve_topic_name(one) for one in rules.expected}
        self._own_names = set(self._full_names.values())
        self._of_drivers: set[str] = set()

    def follow(self, run: RunSpec, steady_ns: int) -> None:
        """Look at the topics of this run from now on."""
        self._take(PublisherRules(run))
        self._liveness.foreign.clear()
        self.look(steady_ns)

    def look(self, steady_ns: int) -> None:
        """Look at all topics of the session, and at those that make the VUT's states."""
        self._follow_receiver()
        for topic in self._rules.expected:
            publishers = self._publishers(topic) if self._needs_names(topic) else []
            strangers = self._rules.strangers(topic, publishers)
            if strangers is not None and self._rules.expected[topic] is not ONE:
                # Those of a part that has just come aren't known yet.
                self._rules.know({proof: self._publishers(proof) for proof in self._rules.proofs})
                strangers = self._rules.strangers(topic, publishers)
            if strangers is None:
                self._liveness.foreign.pop(topic, None)
                self._unnamed_since_ns.pop(topic, None)
            elif self._is_named(topic, publishers, steady_ns):
                self._liveness.foreign[topic] = strangers.count, strangers.text

    def _follow_receiver(self) -> None:
        """Look at what the VUT's adapter hears of its GNSS/INS too, by whatever name."""
        topics = set(self._receiver)
        try:
            subscriptions = self._node.get_subscriber_names_and_types_by_node(
                names.VUT_ADAPTER, names.NAMESPACE
            )
            topics |= {topic for topic, _ in subscriptions}
        except NodeNameNonExistentError:
            topics |= self._of_drivers  # of an adapter that was here before
        topics -= self._own_names
        for topic in self._of_drivers - topics:
            self._liveness.foreign.pop(topic, None)
        self._of_drivers = topics
        self._rules.expect_one(topics)

    def _needs_names(self, topic: str) -> bool:
        """Tell by the number of publishers whether to ask for their names, which is slow.

        ``Node.count_publishers`` resolves and checks each name anew: for the topics of 20 objects
        that is half a millisecond at each look, in which a state waits.
        """
        count = self._node.handle.get_count_publishers(self._full_names.get(topic, topic))
        return bool(count > 1 if self._rules.expected[topic] is ONE else count)

    def _publishers(self, topic: str) -> list[Publisher]:
        endpoints = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        publishers = []
        for one in endpoints:
            name, process = full_name(one), bytes(one.endpoint_gid[:_PROCESS_BYTES])
            where = "" if name else whence(process, self._own_process())
            publishers.append(Publisher(name, process, where))
        return publishers

    def _own_process(self) -> bytes:
        """Return those of the manager's own publishers; empty while the graph shows none."""
        topic = self._node.resolve_topic_name(names.SESSION_STATE)
        for one in self._node.get_publishers_info_by_topic(topic):
            process = bytes(one.endpoint_gid[:_PROCESS_BYTES])
            if is_process(process, os.getpid()):
                return process
        return b""

    def _is_named(self, topic: str, publishers: Iterable[Publisher], steady_ns: int) -> bool:
        """Tell whether all have names, or it was waited long enough for one that hasn't."""
        if all(one.node for one in publishers):
            return True
        since_ns = self._unnamed_since_ns.setdefault(topic, steady_ns)
        return steady_ns - since_ns >= _NAMED_WITHIN_NS


class DeclarationWatch:
    """Finds participants of a live run that are declared as two different kinds (METHOD 4.4b).

    Args:
        node: that hears them.
        liveness: notes what is found.
    """

    def __init__(self, node: Node, liveness: LivenessMonitor) -> None:
        self._node = node
        self._liveness = liveness
        self._subscriptions: list[Any] = []
        self._declared: dict[str, list[str]] = {}

    def follow(self, run: RunSpec) -> None:
        """Hear the participants of this run from now on; latched messages are heard anew."""
        for one in self._subscriptions:
            self._node.destroy_subscription(one)
        participants = declaring(run) if run.mode == "live" else ()
        self._declared = {who: [] for who in participants}
        self._subscriptions = [
            ros.hear_kind(self._node, who, partial(self._on_kind, who)) for who in participants
        ]

    def _on_kind(self, who: str, kind: str) -> None:
        self._declared[who].append(kind[:_MOST_TEXT])
        for text in contradictions({who: self._declared[who]}):
            self._liveness.foreign[names.declared_topic(who)] = 1, text


def full_name(endpoint: Any) -> str:
    """Return the name of the node that has an endpoint; empty while the graph doesn't know it."""
    name, namespace = endpoint.node_name, endpoint.node_namespace
    return "" if name == _UNNAMED else f"{namespace.rstrip('/')}/{name}"


def reply_of(message: HeartbeatReply) -> tuple[Sequence[str], int, Exchange]:
    """Read the sender of an answer, the heartbeat that it answers, and four stamps.

    The last stamp is now, the answer's arrival.
    """
    sent_ns, received_ns = map(ros.session_ns, (message.heartbeat_sent, message.heartbeat_received))
    replied_ns = ros.session_ns(message.header.stamp)
    exchange = Exchange(sent_ns, received_ns, replied_ns, time.time_ns())
    return message.object_ids, message.sequence, exchange


def violation_of(message: SafetyEvent) -> tuple[Violation, str]:
    """Read a violation that another node reports, and its name; ValueError for an unknown code."""
    code, source = SafetyCode(message.code), message.source[:_MOST_TEXT]
    limit_name = message.limit_name[:_MOST_TEXT]
    is_standard_name = MEANINGS[code].limit_name == limit_name
    violation = Violation(
        code,
        message.object_id[:_MOST_TEXT],
        message.measured,
        message.limit,
        ros.ns_from_stamp(message.header.stamp),
        f"seen by {source}" if is_standard_name else f"{limit_name} of {source}",
        words=message.words[:_LONGEST_SENTENCE],
    )
    return violation, source


# Told of a refused command: object id, command, reason, and whether it stays refused as long as the
# object's process runs.
OnRefusal = Callable[[str, outbox.ObjectCommand, str, bool], None]
# Told of a command that is given up: object id, command, what became of it.
OnGivenUp = Callable[[str, outbox.ObjectCommand, str], None]
_LASTING = (ObjectCommand.Response.REFUSED_VERSION, ObjectCommand.Response.REFUSED_LASTING)


class ObjectEndpoints:
    """Publishers, subscriptions and clients of the objects that were ever connected.

    Args:
        on_array: takes each ObjectStates message as bytes.
        on_rules: takes what an object says to judge by.
        on_refusal: takes each command that an object refused.
        on_given_up: takes each command that no answer came to in time.
    """

    def __init__(
        self,
        node: Node,
        on_state: Callable[[State], None],
        on_array: Callable[[bytes], None],
        on_ack: Callable[[Acknowledgement], None],
        on_rules: Callable[[tuple[str, ObjectRules]], None],
        on_refusal: OnRefusal,
        on_given_up: OnGivenUp,
    ) -> None:
        self._node = node
        self._on_state = on_state
        self._on_array = on_array
        self._on_ack = on_ack
        self._on_rules = on_rules
        self._on_refusal = on_refusal
        self._on_command_failure = on_given_up
        self._hears_arrays = False
        self._ids_with_state: set[str] = set()
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._commands = ObjectCommands()
        self._is_arming = False
        self.references_sent: dict[str, int] = {}
        self.session_token = ""

    def connect(self, object_ids: Iterable[str], states_in_one: bool) -> None:
        """Make the endpoints of objects that are new; the others keep theirs.

        Args:
            object_ids: of a run.
            states_in_one: their processes send one message for all their states.
        """
        raw = partial(ros.subscribe_raw, self._node)
        if states_in_one and not self._hears_arrays:
            self._hears_arrays = True
            topic = names.OBJECT_STATES
            self._node.create_subscription(ObjectStates, topic, self._on_array, ros.STATE, raw=True)
        for object_id in object_ids:
            if not states_in_one and object_id not in self._ids_with_state:
                self._ids_with_state.add(object_id)
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
            topic, take = names.rules_topic(object_id), self._on_rules
            raw(ObjectRulesMsg, topic, rules_from_msg, take, ros.LATCHED, raw=False)
            self.references_sent[object_id] = 0

    def send(self, reference: Reference) -> None:
        """Publish a reference and count it."""
        self._publishers[reference.object_id].publish(encode_reference(reference))
        self.references_sent[reference.object_id] += 1

    def command(
        self,
        spec: RunSpec,
        command: outbox.ObjectCommand,
        rules: Mapping[str, RulesCheck],
        abort_id: str,
    ) -> None:
        """Give each object of a run a command; only commands that come to nothing are reported.

        Args:
            spec: the run.
            command: for all its objects.
            rules: of each object, as they were found to agree with the run's.
            abort_id: of the session's newest abort, for an all-clear.
        """
        digests = {t.id: rules.get(t.id, RulesCheck()).digest for t in spec.targets}
        version, steady_ns = spec.event_version, time.monotonic_ns()
        self._commands.ask(digests, command, version, abort_id, steady_ns)
        self.send_commands()
        self._is_arming = command is outbox.ObjectCommand.ARM

    def send_commands(self) -> None:
        """Send commands that wait for a service or an answer, and give up overdue ones."""
        steady_ns = time.monotonic_ns()
        for one in self._commands.overdue(steady_ns):
            self._on_command_failure(one.object_id, one.command, one.outcome)
        for one in self._commands.due(self._is_there, steady_ns):
            request = ObjectCommand.Request(
                command=one.command.value,
                event_version=one.event_version,
                session_token=self.session_token,
                rules_digest=one.rules_digest,
                abort_id=one.abort_id,
            )
            future = self._clients[one.object_id].call_async(request)
            future.add_done_callback(partial(self._on_answer, one))

    def forget_for_abort(self) -> None:
        """Send no object an arm or an all-clear any more that waits, since there is an abort."""
        self._commands.forget_for_abort()
        self._is_arming = False

    def take_arming_sent(self) -> bool:
        """Tell, once an arming, whether no object's command service is awaited any more for it."""
        is_complete = self._is_arming and self._commands.all_sent(outbox.ObjectCommand.ARM)
        self._is_arming = self._is_arming and not is_complete
        return is_complete

    def _is_there(self, object_id: str) -> bool:
        return bool(self._clients[object_id].service_is_ready())

    def _on_answer(self, request: Pending, future: Any) -> None:
        answer = future.result()
        if answer is None or not self._commands.on_answer(
            request, answer.accepted, answer.error_msg
        ):
            return
        if not answer.accepted and request.command is not outbox.ObjectCommand.ALL_CLEAR:
            lasting = answer.error_code in _LASTING
            self._on_refusal(request.object_id, request.command, answer.error_msg, lasting)


class Publications:
    """Owns the publishers and counts the heartbeats.

    Args:
        node: owns the endpoints; its name is the sender's.
    """

    def __init__(self, node: Node) -> None:
        pub = node.create_publisher
        self._name = node.get_name()
        self._log = node.get_logger()
        # Two managers have the same node name; who hears both must be able to tell them apart.
        self._sender = f"{self._name}-{uuid4().hex[:12]}"
        self._state = pub(SessionState, names.SESSION_STATE, ros.LATCHED)
        self._heartbeats = pub(Heartbeat, names.HEARTBEAT, ros.STATE)
        self._trigger = pub(TriggerEvent, names.TRIGGER_EVENT, ros.LATCHED)
        self._phase = pub(PhaseEvent, names.PHASE_EVENT, ros.LATCHED)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._done = pub(StepDone, names.STEP_DONE, ros.STATE)
        self._links = pub(LinkStatus, names.LINK_STATUS, ros.STATE)
        self._tf = pub(TFMessage, names.TF, ros.TF)
        self._tf_static = pub(TFMessage, names.TF_STATIC, ros.TF_STATIC)
        self._poses = TransformFilter()
        self._count = 0
        self.session_token = ""

    def state_changed(self, change: outbox.StateChanged, spec: RunSpec | None) -> None:
        """Publish a transition on its topic and in the log."""
        self._state.publish(encode_session_state(change, spec))
        self._log.info(
            f"{change.previous.name} -> {change.state.name} ({change.event}): {change.reason}"
        )

    def send(
        self,
        fact: outbox.TriggerDecision | PhaseBegan | Violation | outbox.Note,
        arrival_ns: int,
    ) -> None:
        """Publish a decision record, a phase or an event, or log a word for people.

        Args:
            fact: any of these.
            arrival_ns: when the deciding state arrived, on the steady clock.
        """
        if isinstance(fact, outbox.TriggerDecision):
            processing_s = (time.monotonic_ns() - arrival_ns) / NS_PER_S
            self._trigger.publish(encode_trigger(fact, processing_s))
        elif isinstance(fact, PhaseBegan):
            self._phase.publish(encode_phase(fact))
        elif isinstance(fact, outbox.Note):
            self._log.info(fact.text)
        else:
            self._safety.publish(encode_limit(fact.announcement(self._name)))

    def report_links(
        self, session: Session, liveness: LivenessMonitor, losses: LossCounters, now_ns: int
    ) -> None:
        """Report links and strangers to operators and the record; losses go to the log too.

        Args:
            session: gives the newest states; nothing is published before a run is loaded.
            liveness: has clock offset and delay of each object, and the strangers.
            losses: received and lost states of each object.
            now_ns: session time.
        """
        if session.spec is not None:
            message, steady_ns = LinkStatus(), time.monotonic_ns()
            message.header.stamp = stamp_from_ns(now_ns)
            message.object_ids = ids = session.spec.object_ids
            states = {**session.targets, session.spec.vut.id: session.vut}
            measured = [liveness.links.link(i, steady_ns) for i in ids]
            counts = [losses.of.get(i, LossCounter()) for i in ids]
            message.clock_offset = [link.offset_s for link in measured]
            message.delay = [link.delay_s for link in measured]
            message.state_age = [
                math.nan if state is None else ns_to_seconds(now_ns - state.stamp_ns)
                for state in map(states.get, ids)
            ]
            message.states_received = [count.received for count in counts]
            message.states_lost = [count.lost for count in counts]
            message.strangers = list(liveness.strangers)
            self._links.publish(message)
        for line in losses.news():
            self._log.warning(line)

    def loaded(self, spec: RunSpec) -> None:
        """Send a run's camera to tf2; poses begin anew, since runs may differ in their clock."""
        self._poses = TransformFilter()
        if spec.camera is not None:
            self._tf_static.publish(encode_transforms(of_camera(spec.camera)))

    def poses(self, states: Iterable[State]) -> None:
        """Send all base_link frames to tf2, in one message, at the stamps of the states."""
        if news := self._poses.news(states):
            self._tf.publish(encode_transforms(news))

    def abort_id(self, aborts: int) -> str:
        """Name the newest of so many aborts among those of all managers; empty without any."""
        return f"{self._sender}/{aborts}" if aborts else ""

    def heartbeat(
        self, session: SessionPhase, aborts: int, sent: dict[str, int], now_ns: int
    ) -> tuple[int, int]:
        """Publish a sign of life with what an object must have heard by now.

        Args:
            session: its state.
            aborts: that the session has had.
            sent: references, by object id.
            now_ns: session time.

        Returns:
            Its sequence number and when it was sent, ns on the system clock.
        """
        self._count += 1
        sent_ns = time.time_ns()
        abort_id, token = self.abort_id(aborts), self.session_token
        beat = steps.Heartbeat(
            now_ns, self._sender, self._count, sent_ns, session, sent, token, abort_id
        )
        self._heartbeats.publish(steps.encode_heartbeat(beat))
        return self._count, sent_ns

    def step_done(self, step: int, session: SessionPhase) -> None:
        """Tell the world that this step was judged, and which heartbeat belongs to it."""
        answer = steps.StepDone(names.SCENARIO_MANAGER, step, self._count, session)
        self._done.publish(steps.encode_done(answer))
