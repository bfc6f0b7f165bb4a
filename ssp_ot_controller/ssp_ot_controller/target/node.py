"""The object_target node: one or several object targets of a run in one process."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

from ssp_core import names, ros
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.conversions import reference_from_msg, state_to_msg
from ssp_core.errors import HostError, InputError
from ssp_core.messages import object_state
from ssp_core.reference import Reference
from ssp_core.run_spec import RunSpec, load_run
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.vocab import ControlState, SessionPhase
from ssp_msgs.msg import (
    ActuatorCommand,
    Heartbeat,
    ObjectState,
    ReferenceAck,
    SafetyEvent,
    StepDone,
    WorldTick,
)
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.core.local_safety import StopNow
from ssp_ot_controller.core.object_machine import ObjectEvent
from ssp_ot_controller.sil.disturbance import Localisation, make_link
from ssp_ot_controller.target.inbox import Inbox
from ssp_ot_controller.target.target import Target

WATCHDOG_PERIOD_S = 0.05
# Lockstep: the world may take this long for a step (others may be dropped meanwhile).
WORLD_HANG_S = 4.0
_MAY_MOVE = (
    ControlState.PRE_ARMING,
    ControlState.ARMED,
    ControlState.RUNNING,
    ControlState.POSTRUN,
)


class ObjectTargetNode(LifecycleNode):
    """Thin lifecycle node around target.Target; with ``autostart`` it activates itself."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.OBJECT_TARGET, namespace=names.NAMESPACE)
        self.declare_parameter("run_file", "")
        self.declare_parameter("object_ids", "")
        autostart = self.declare_parameter("autostart", True).value
        self._targets: dict[str, Target] = {}
        self._destroyers: list[Callable[[], object]] = []
        self._failure: Exception | None = None
        if autostart:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() is not TransitionCallbackReturn.SUCCESS:
                    raise self._failure or HostError("the node could not be activated")

    # -- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._configure()
        except Exception as error:
            # rclpy turns an exception here into ERROR without a word.
            self.get_logger().error(f"can't configure: {error}")
            self._failure = error
            raise
        return super().on_configure(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        while self._destroyers:
            self._destroyers.pop()()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        return super().on_shutdown(state)

    def _halt(self) -> None:
        """Whatever may move stops, and stays stopped until it is cleared."""
        silence_s = (time.monotonic_ns() - self._tick_arrived_ns) / NS_PER_S
        for target in self._targets.values():
            if target.state in _MAY_MOVE:
                self._stop_by_itself(target, silence_s, 0.0)

    def _stop_by_itself(self, target: Target, silence_s: float, limit_s: float) -> None:
        """Stops an object for which no tick comes: latched, announced, reported, commanded."""
        target.local_stop()
        meaning = MEANINGS[SafetyCode.STATE_STALE]
        stop = StopNow(SafetyCode.STATE_STALE, meaning.limit_name, silence_s, limit_s, meaning.unit)
        self._announce(target.object_id, stop, self._now_ns)
        command = ActuatorCommand(
            object_id=target.object_id, step=self._step_index, emergency_stop=True
        )
        command.header.stamp = ros.stamp_from_ns(self._now_ns)
        self._pub_command.publish(command)
        if (report := target.last_report()) is not None:
            self._pub_state[target.object_id].publish(state_to_msg(report))

    def _configure(self) -> None:
        self._run: RunSpec = load_run(self.get_parameter("run_file").value)
        wanted = [i for i in self.get_parameter("object_ids").value.split(",") if i]
        known = [t.id for t in self._run.targets]
        unknown = sorted(set(wanted) - set(known))
        if unknown:
            raise InputError(
                "not in the run",
                field="parameter object_ids",
                value=", ".join(unknown),
                remedy=f"the run has {', '.join(known)}",
            )
        ids = wanted or known
        self._targets = {i: Target(i, self._run) for i in ids}
        noise, seed = self._run.disturbance, self._run.seed
        self._localisation = {i: Localisation(noise, seed, i) for i in ids}
        self._links = {i: make_link(noise, seed, i, self._run.step_s) for i in ids}
        self._inbox = Inbox(ids)
        self._states_sent = 0
        self._acks_sent = 0
        self._safety_events_sent = 0
        self._now_ns = 0
        self._step_index = 0
        self._heartbeat_arrived_ns: int | None = None
        self._heartbeat_session_ns: int | None = None
        self._tick_arrived_ns = time.monotonic_ns()
        self._lockstep_running = False
        self._make_endpoints()
        for target in self._targets.values():
            target.power_on()

    def _make_endpoints(self) -> None:
        pub, sub = self._pub, self._sub
        self._pub_command = pub(ActuatorCommand, names.ACTUATOR_COMMAND, ros.COMMAND)
        self._pub_done = pub(StepDone, names.STEP_DONE, ros.STATE)
        self._pub_safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._pub_state, self._pub_ack = {}, {}
        for object_id in self._targets:
            self._pub_state[object_id] = pub(ObjectState, names.state_topic(object_id), ros.STATE)
            self._pub_ack[object_id] = pub(ReferenceAck, names.ack_topic(object_id), ros.COMMAND)
            sub(ReferenceMsg, names.reference_topic(object_id), self._on_reference, ros.COMMAND)
            service = self.create_service(
                ObjectCommand,
                names.command_service(object_id),
                partial(self._on_object_command, object_id),
            )
            self._destroyers.append(partial(self.destroy_service, service))
        sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE)
        sub(WorldTick, names.WORLD_TICK, self._on_tick, ros.STATE)
        timer = self.create_timer(
            WATCHDOG_PERIOD_S, self._watchdog, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._destroyers.append(partial(self.destroy_timer, timer))

    def _pub(self, kind: Any, topic: str, qos: QoSProfile) -> Any:
        publisher = self.create_publisher(kind, topic, qos)
        self._destroyers.append(partial(self.destroy_publisher, publisher))
        return publisher

    def _sub(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        subscription = self.create_subscription(kind, topic, callback, qos)
        self._destroyers.append(partial(self.destroy_subscription, subscription))

    # -- what arrives --------------------------------------------------------------------------

    def _on_heartbeat(self, message: Heartbeat) -> None:
        try:
            session = SessionPhase(message.session_state)
            counts = dict(zip(message.object_ids, message.references_sent, strict=True))
        except ValueError as error:
            # As good as silence, which the object knows how to deal with.
            self.get_logger().error(f"heartbeat dropped: {error}")
            return
        self._heartbeat_arrived_ns = time.monotonic_ns()
        stamp_ns = ros.ns_from_stamp(message.header.stamp)
        self._inbox.on_heartbeat(message.sequence, session, stamp_ns, counts)
        self._work()

    def _on_reference(self, message: ReferenceMsg) -> None:
        self._inbox.on_reference(reference_from_msg(message))
        self._work()

    def _on_tick(self, message: WorldTick) -> None:
        self._tick_arrived_ns = time.monotonic_ns()
        self._lockstep_running = message.lockstep and message.running
        self._inbox.on_tick(message)
        self._work()

    def _on_object_command(
        self, object_id: str, request: ObjectCommand.Request, response: ObjectCommand.Response
    ) -> ObjectCommand.Response:
        target = self._targets[object_id]
        if request.command == ObjectCommand.Request.COMMAND_ALL_CLEAR:
            # Beats that came before this command must not abort the object again after it.
            self._take_heartbeats(None, holding=False)
        try:
            event = ObjectEvent(request.command)
        except ValueError:
            response.accepted = False
            response.error_code = ObjectCommand.Response.REFUSED_TRANSITION
            response.error_msg = f"command {request.command} is unknown"
            response.control_state = int(target.state)
            return response
        reply = target.command(event, request.event_version, self._heartbeat_silence_s())
        response.accepted = reply.accepted
        response.error_code = reply.error_code
        response.error_msg = reply.error_msg
        response.control_state = int(target.state)
        return response

    # -- work ----------------------------------------------------------------------------------

    def _work(self) -> None:
        """Deals with the newest tick once everything that belongs to it has arrived."""
        tick = self._inbox.take()
        if tick is None:
            return
        now_ns = self._now_ns = ros.ns_from_stamp(tick.header.stamp)
        self._step_index = tick.step
        in_step = tick.lockstep and tick.running
        holding = tick.lockstep and not tick.running and tick.step == 0
        self._take_heartbeats(tick.heartbeat if in_step else None, holding)
        truths = {m.object_id: m for m in tick.objects if m.object_id in self._targets}
        for object_id, message in truths.items():
            self._step_target(object_id, message, tick, now_ns)
        if in_step:
            self._pub_done.publish(
                StepDone(
                    participant=names.OBJECT_TARGET,
                    step=tick.step,
                    states_sent=self._states_sent,
                    acks_sent=self._acks_sent,
                    safety_events_sent=self._safety_events_sent,
                )
            )

    def _take_heartbeats(self, up_to: int | None, holding: bool) -> None:
        for beat in self._inbox.heartbeats(up_to, holding):
            self._heartbeat_session_ns = beat.stamp_ns
            for target in self._targets.values():
                target.on_session_state(beat.session)

    def _step_target(
        self, object_id: str, message: ObjectState, tick: WorldTick, now_ns: int
    ) -> None:
        target = self._targets[object_id]
        truth = object_state(message)
        own = self._localisation[object_id].measure(truth) if tick.running else truth
        # While armed they wait for the start, which may be under way on another topic.
        if target.state is not ControlState.ARMED:
            for reference in self._inbox.references(object_id):
                self._answer(target, reference, now_ns)
        outcome = target.step(own, now_ns, self._heartbeat_age_s(tick, now_ns))
        if outcome.stopped is not None:
            self._announce(object_id, outcome.stopped, now_ns)
        command = ActuatorCommand(
            object_id=object_id,
            step=tick.step,
            acceleration=outcome.command.acceleration_mps2,
            curvature=outcome.command.curvature_1pm,
            heading=outcome.command.heading_rad,
            emergency_stop=outcome.command.emergency_stop,
        )
        command.header.stamp = tick.header.stamp
        self._pub_command.publish(command)
        if not tick.running:
            self._pub_state[object_id].publish(state_to_msg(outcome.report))
            return
        arrived = self._links[object_id].pass_on(outcome.report)
        if arrived is not None:
            self._states_sent += 1
            self._pub_state[object_id].publish(state_to_msg(arrived))

    def _heartbeat_age_s(self, tick: WorldTick, now_ns: int) -> float:
        """On simulated time in lockstep, where the manager beats once a step; else steady."""
        if tick.lockstep and tick.running:
            if self._heartbeat_session_ns is None:
                return float("inf")
            return ns_to_seconds(now_ns - self._heartbeat_session_ns)
        return self._heartbeat_silence_s()

    def _heartbeat_silence_s(self) -> float:
        if self._heartbeat_arrived_ns is None:
            return float("inf")
        return (time.monotonic_ns() - self._heartbeat_arrived_ns) / NS_PER_S

    def _answer(self, target: Target, reference: Reference, now_ns: int) -> None:
        refusal = target.on_reference(reference, now_ns)
        message = ReferenceAck(
            reference_id=reference.reference_id,
            object_id=target.object_id,
            accepted=refusal is None,
            error_code=int(refusal.code) if refusal else 0,
            error_msg=refusal.message if refusal else "",
        )
        message.header.stamp = ros.stamp_from_ns(now_ns)
        message.header.frame_id = names.MAP_FRAME
        self._acks_sent += 1
        self._pub_ack[target.object_id].publish(message)

    def _announce(self, object_id: str, stopped: StopNow, now_ns: int) -> None:
        message = SafetyEvent(
            code=int(stopped.code),
            limit_name=stopped.limit_name,
            source=self.get_name(),
            object_id=object_id,
            measured=stopped.measured,
            limit=stopped.limit,
            unit=stopped.unit,
            reaction="local_stop",
        )
        message.header.stamp = ros.stamp_from_ns(now_ns)
        message.header.frame_id = names.MAP_FRAME
        self._safety_events_sent += 1
        self._pub_safety.publish(message)
        self.get_logger().error(
            f"{object_id}: {stopped.limit_name} {stopped.measured:.3g} (limit {stopped.limit:.3g})"
        )

    def _watchdog(self) -> None:
        """On the steady clock: without a world there are no states to judge."""
        silence_s = (time.monotonic_ns() - self._tick_arrived_ns) / NS_PER_S
        limit_s = WORLD_HANG_S if self._lockstep_running else 1.0
        if silence_s <= limit_s:
            return
        for target in self._targets.values():
            if target.state in _MAY_MOVE:
                self._stop_by_itself(target, silence_s, limit_s)


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(ObjectTargetNode, lambda node: node.trigger_shutdown()))


if __name__ == "__main__":
    main()
