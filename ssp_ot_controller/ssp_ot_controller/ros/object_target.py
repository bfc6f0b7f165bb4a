"""The object_target node: one or several object targets of a run in one process."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.iso_frames import encode_frames
from ssp_core.cdr.references import decode_reference, encode_ack
from ssp_core.cdr.states import StateArray, decode_state, decode_states, encode_state, encode_states
from ssp_core.errors import HostError
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.ros.conversions import (
    body_status_message,
    rules_to_msg,
)
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.run_file.participation import ParticipantKind, body_of
from ssp_core.safety.body_status import PERIOD_S, BodyStatus
from ssp_core.safety.codes import MEANINGS
from ssp_core.safety.object_rules import ObjectRules, rules_of
from ssp_core.world.event_messages import encode_fault, encode_limit
from ssp_msgs.msg import (
    ActuatorCommands,
    FaultEvent,
    Heartbeat,
    HeartbeatReply,
    IsoFrames,
    ObjectState,
    ObjectStates,
    ReferenceAck,
    SafetyEvent,
    StepDone,
    WorldTick,
)
from ssp_msgs.msg import BodyStatus as BodyStatusMsg
from ssp_msgs.msg import ObjectRules as ObjectRulesMsg
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.bodies.iso22133.conversation import HEAB_RATE_HZ
from ssp_ot_controller.objects.live import LiveObjects, open_bodies
from ssp_ot_controller.objects.messages import (
    HeartbeatAnswer,
    HeartbeatResponder,
    answers_late,
)
from ssp_ot_controller.objects.pool import ObjectPool, ObjectStop, PoolStep
from ssp_ot_controller.objects.state_machine import ObjectEvent, other_rules
from ssp_ot_controller.ros.parameters import OBJECT_TARGET


class ObjectPublishers:
    """Publishes for one process of objects.

    Args:
        states_in_one: all states in one message instead of one per object.
        world: there is a simulated world, which hears commands for bodies.
    """

    def __init__(
        self, node: Node, object_ids: tuple[str, ...], *, states_in_one: bool, world: bool
    ) -> None:
        self._node = node
        pub = node.create_publisher
        self._done = pub(StepDone, names.STEP_DONE, ros.STATE)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._fault = pub(FaultEvent, names.FAULT_EVENT, ros.LATCHED)
        self._reply = pub(HeartbeatReply, names.HEARTBEAT_REPLY, ros.STATE)
        self._status: Any = None
        self._command = None
        if world:
            self._command = pub(ActuatorCommands, names.ACTUATOR_COMMANDS, ros.COMMAND)
        self._states = None
        self._state: dict[str, Any] = {}
        if states_in_one:
            self._states = pub(ObjectStates, names.OBJECT_STATES, ros.STATE)
        else:
            self._state = {i: pub(ObjectState, names.state_topic(i), ros.STATE) for i in object_ids}
        self._ack = {i: pub(ReferenceAck, names.ack_topic(i), ros.COMMAND) for i in object_ids}
        self._rules = {
            i: pub(ObjectRulesMsg, names.rules_topic(i), ros.LATCHED) for i in object_ids
        }

    def tell_rules(self, rules: Mapping[str, ObjectRules]) -> None:
        """Publish the rules that each object judges by."""
        for object_id, one in rules.items():
            self._rules[object_id].publish(rules_to_msg(one, object_id, self._node.get_name()))

    def send(self, step: PoolStep | None) -> None:
        """Publish everything that a step led to; nothing for None."""
        if step is None:
            return
        for change in step.faults:
            self._fault.publish(encode_fault(change.fact(self._node.get_name(), step.now_ns)))
        for ack in step.acks:
            self._ack[ack.object_id].publish(encode_ack(ack))
        for event in step.events:
            self._announce(event, step.now_ns)
        self._send_states(step.states)
        if step.answered:
            counts = step.counts
            step_done = steps.StepDone(
                self._node.get_name(),
                step.step,
                states_sent=counts.states,
                acks_sent=counts.acks,
                safety_events_sent=counts.safety_events,
            )
            self._done.publish(steps.encode_done(step_done))
        # Last: the manager judges the step meanwhile, and the world waits for it anyway.
        if self._command is not None:
            self._command.publish(steps.encode_commands(self._commands_of(step)))

    def reply(self, reply: HeartbeatAnswer) -> None:
        """Publish an answer to a heartbeat; stamp one that leaves now here, as late as may be."""
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

    def offer_statuses(self) -> None:
        """Offer the statuses of live objects: their bodies are real, and may not be there."""
        self._status = self._node.create_publisher(BodyStatusMsg, names.BODY_STATUS, ros.STATE)

    def tell(self, status: BodyStatus, now_ns: int) -> None:
        """Publish what keeps an object from being seen and armed."""
        self._status.publish(body_status_message(status, now_ns))

    def _send_states(self, states: tuple[State, ...]) -> None:
        if self._states is None:
            for state in states:
                self._state[state.object_id].publish(encode_state(state))
        elif states:
            newest_ns = max(state.stamp_ns for state in states)
            array = StateArray(newest_ns, self._node.get_name(), states)
            self._states.publish(encode_states(array))

    def _commands_of(self, step: PoolStep) -> steps.BodyCommands:
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

    def _announce(self, event: ObjectStop, now_ns: int) -> None:
        stop, name = event.stop, MEANINGS[event.stop.code].limit_name
        passed = event.fact(self._node.get_name(), now_ns)
        self._safety.publish(encode_limit(passed, "local_stop"))
        figures = stop.words or f"{stop.measured:.3g} (limit {stop.limit:.3g})"
        self._node.get_logger().error(f"{event.object_id}: {name} {figures}")


class TestObjectEndpoints:
    """The endpoints of test objects beside the steps: heartbeats, reports as they come, raw frames.

    Args:
        on_report: called when a test object has said something new.
    """

    def __init__(self, node: Node, live: LiveObjects, on_report: Callable[[], None]) -> None:
        self._live, self._on_report = live, on_report
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(HEAB_PERIOD_S, self._beat, clock=steady)
        # The executor of events can't wait for sockets.
        node.create_timer(LISTEN_PERIOD_S, self._listen, clock=steady)
        node.create_timer(FRAMES_PERIOD_S, self.publish_frames, clock=steady)
        self._publishers = {
            i: node.create_publisher(IsoFrames, names.iso_frames_topic(i), ros.STATE)
            for i in live.test_object_ids
        }

    def _beat(self) -> None:
        self._live.beat(time.time_ns())

    def _listen(self) -> None:
        if self._live.listen(time.time_ns()):
            self._on_report()

    def beat_at_once(self) -> None:
        """Send heartbeats that don't wait for their timer, which may not run any more."""
        for _ in range(HEABS_AT_ONCE):
            self._beat()
        self.publish_frames()

    def publish_frames(self) -> None:
        """Publish the frames since the last call."""
        for batch in self._live.frames():
            self._publishers[batch.object_id].publish(encode_frames(batch))


LATE_ANSWER_PERIOD_S = 0.005
# Test objects: of the heartbeats, of looking at their sockets, and of the messages of raw frames.
HEAB_PERIOD_S = 1.0 / HEAB_RATE_HZ
# Datagrams get lost.
HEABS_AT_ONCE = 5
LISTEN_PERIOD_S = 0.002
FRAMES_PERIOD_S = 0.1
WATCHDOG_PERIOD_S = 0.05


class ObjectProcess:
    """The objects of one process from configure to cleanup: endpoints, timers and bodies.

    Args:
        parameters: of the node.

    Raises:
        InputError: the run or a parameter is wrong.
        HostError: there is no way to a body.
    """

    def __init__(self, node: Node, parameters: Mapping[str, Any]) -> None:
        run = load_run(parameters["run_file"])
        object_ids = [i for i in parameters["object_ids"].split(",") if i]
        self._node = node
        self.pool = ObjectPool(run, object_ids, time.monotonic_ns())
        self.pool.active = False
        self._live: LiveObjects | None = None
        if run.mode == "live":
            # No simulated world: the bodies are read and commanded here, on a steady timer.
            log = node.get_logger()
            ids, text = self.pool.object_ids, parameters["bodies"]
            bodies = open_bodies(run, ids, text, time.time_ns(), log.info)
            self._live = LiveObjects(run, bodies, log.error)
        self._before = {id(entity) for entity, _ in self._entities()}
        self._responder = HeartbeatResponder()
        self._outgoing = ObjectPublishers(
            node,
            self.pool.object_ids,
            states_in_one=run.states_in_one,
            world=self._live is None,
        )
        self._rules = {i: rules_of(run, i) for i in self.pool.object_ids}
        self._outgoing.tell_rules(self._rules)
        self._declared: set[str] = set()
        if self._live is not None:
            self._declare_simulated(self._live)
        self._hear(run)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(WATCHDOG_PERIOD_S, self._watch, clock=steady)
        if answers_late(run, self.pool.object_ids):
            node.create_timer(LATE_ANSWER_PERIOD_S, self._answer_late, clock=steady)
        if self._live is not None:
            node.create_timer(run.step_s, partial(self._live_step, self._live), clock=steady)
            self._outgoing.offer_statuses()
            node.create_timer(PERIOD_S, partial(self._tell_statuses, self._live), clock=steady)
        self._test_objects: TestObjectEndpoints | None = None
        if self._live is not None and self._live.test_object_ids:
            self._test_objects = TestObjectEndpoints(node, self._live, self._on_report)

    def _entities(self) -> list[tuple[Any, Callable[[Any], bool]]]:
        """List the node's entities, each with the function that ends it."""
        node = self._node
        return [
            *((one, node.destroy_timer) for one in node.timers),
            *((one, node.destroy_subscription) for one in node.subscriptions),
            *((one, node.destroy_service) for one in node.services),
            *((one, node.destroy_publisher) for one in node.publishers),
        ]

    def close(self) -> None:
        """Take the endpoints and timers away, and leave bodies to their own watchdogs."""
        if self._test_objects is not None:
            self._test_objects.publish_frames()
            self._test_objects = None
        for entity, destroy in self._entities():
            if id(entity) not in self._before:
                destroy(entity)
        if self._live is not None:
            self._live.close()
            self._live = None

    def halt(self) -> None:
        """Stop every object that may move, until it is cleared; test objects hear it at once."""
        self.pool.active = False
        self._send(self.pool.halt(time.monotonic_ns()))
        if self._test_objects is not None:
            self._test_objects.beat_at_once()

    def _hear(self, run: RunSpec) -> None:
        node, pool, sub = self._node, self.pool, partial(ros.subscribe_raw, self._node)
        for object_id in pool.object_ids:
            topic = names.reference_topic(object_id)
            sub(ReferenceMsg, topic, decode_reference, self._on_reference, ros.COMMAND)
            on_command = partial(self._on_object_command, object_id)
            node.create_service(ObjectCommand, names.command_service(object_id), on_command)
        others = [t.id for t in run.targets if t.id not in pool.object_ids]
        if others and run.states_in_one:
            sub(ObjectStates, names.OBJECT_STATES, decode_states, self._on_array, ros.STATE)
            others = []
        for object_id in [names.VUT_ID, *others]:
            topic = names.state_topic(object_id)
            sub(ObjectState, topic, decode_state, self._on_state, ros.STATE)
        sub(Heartbeat, names.HEARTBEAT, steps.decode_heartbeat, self._on_heartbeat, ros.STATE)
        if run.mode != "live":
            sub(WorldTick, names.WORLD_TICK, steps.decode_tick, self._on_tick, ros.STATE)

    # -- what arrives --------------------------------------------------------------------------

    def _on_heartbeat(self, beat: steps.Heartbeat) -> None:
        pool, system_ns, steady_ns = self.pool, time.time_ns(), time.monotonic_ns()
        pool.take_heartbeat(beat, steady_ns)
        if pool.active:
            links = {i: pool.links_of(i) for i in pool.object_ids}
            for reply in self._responder.on_heartbeat(beat, links, system_ns, steady_ns):
                self._outgoing.reply(reply)
        self._work()

    def _on_state(self, state: State) -> None:
        self.pool.take_states((state,))
        self._work()

    def _on_array(self, array: StateArray) -> None:
        own = self.pool.object_ids
        self.pool.take_states(s for s in array.states if s.object_id not in own)

    def _on_reference(self, reference: Reference) -> None:
        self.pool.take_reference(reference)
        self._work()

    def _on_tick(self, tick: steps.WorldTick) -> None:
        self.pool.take_tick(tick, time.monotonic_ns())
        self._work()

    def _on_object_command(
        self, object_id: str, request: ObjectCommand.Request, response: ObjectCommand.Response
    ) -> ObjectCommand.Response:
        try:
            event = ObjectEvent(request.command)
        except ValueError:
            response.accepted = False
            response.error_code = ObjectCommand.Response.REFUSED_TRANSITION
            response.error_msg = f"command {request.command} is unknown"
        else:
            steady_ns = time.monotonic_ns()
            reply = None
            if event is ObjectEvent.ARM:
                reply = other_rules(self._rules[object_id].digest, request.rules_digest)
            if reply is None:
                reply = self.pool.command(
                    object_id,
                    event,
                    request.event_version,
                    steady_ns,
                    request.session_token,
                    request.abort_id,
                )
            response.accepted = reply.accepted
            response.error_code = reply.error_code
            response.error_msg = reply.error_msg
        response.control_state = int(self.pool.state_of(object_id))
        return response

    def _live_step(self, live: LiveObjects, *, only_new: bool = False) -> None:
        tick = live.tick(time.time_ns(), only_new=only_new)
        if only_new and not tick.objects:
            return
        among = [state.object_id for state in tick.objects] if only_new else None
        live.check(self.pool, among)
        self.pool.take_tick(tick, time.monotonic_ns())
        self._send(self.pool.step(time.monotonic_ns()), among)

    def _declare_simulated(self, live: LiveObjects) -> None:
        """Declare each object once it is known to be a model (METHOD 4.4b)."""
        new = [i for i in live.simulated if i not in self._declared]
        self._declared.update(new)
        both = [name for i in new for name in (i, body_of(i))]
        ros.declare_kind(self._node, ParticipantKind.SIMULATED, *both)

    def _tell_statuses(self, live: LiveObjects) -> None:
        self._declare_simulated(live)
        now_ns = time.time_ns()
        for status in live.statuses(now_ns):
            self._outgoing.tell(status, now_ns)

    def _on_report(self) -> None:
        if self._live is not None:
            self._live_step(self._live, only_new=True)

    def _work(self) -> None:
        """Deal with the newest tick once everything that belongs to it has arrived."""
        if self._live is None:
            self._send(self.pool.step(time.monotonic_ns()))

    def _send(self, step: PoolStep | None, among: Iterable[str] | None = None) -> None:
        # Bodies first: what is published can wait.
        if self._live is not None:
            self._live.command(step, time.time_ns())
            self._live.follow(self.pool, time.time_ns(), among)
        self._outgoing.send(step)

    def _watch(self) -> None:
        self._work()
        self._send(self.pool.watch(time.monotonic_ns()))

    def _answer_late(self) -> None:
        for reply in self._responder.due(time.monotonic_ns()):
            self._outgoing.reply(reply)


class ObjectTargetNode(LifecycleNode):
    """Thin lifecycle node around ObjectProcess; with ``autostart`` it activates itself."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__(names.OBJECT_TARGET, namespace=names.NAMESPACE)
        self._parameter_values = ros.declare(self, OBJECT_TARGET)
        self._process: ObjectProcess | None = None
        self._failure: Exception | None = None
        if self._parameter_values["autostart"]:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() is not TransitionCallbackReturn.SUCCESS:
                    raise self._failure or HostError("the node could not be activated")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._process = ObjectProcess(self, self._parameter_values)
        except Exception as error:
            # rclpy turns an exception here into ERROR without a word.
            self.get_logger().error(f"can't configure: {error}")
            self._failure = error
            raise
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._process is not None:
            self._process.pool.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        if self._process is not None:
            self._process.close()
            self._process = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        return super().on_shutdown(state)

    def _halt(self) -> None:
        if self._process is not None:
            self._process.halt()


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(ObjectTargetNode, lambda node: node.trigger_shutdown()))


if __name__ == "__main__":
    main()
