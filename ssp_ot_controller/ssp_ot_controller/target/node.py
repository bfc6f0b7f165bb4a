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
from ssp_core.cdr import steps
from ssp_core.cdr.references import decode_reference
from ssp_core.cdr.states import StateArray, decode_state, decode_states
from ssp_core.errors import HostError
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import RunSpec, load_run
from ssp_msgs.msg import Heartbeat, ObjectState, ObjectStates, WorldTick
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.core.object_machine import ObjectEvent
from ssp_ot_controller.params import OBJECT_TARGET
from ssp_ot_controller.target.crew import Crew
from ssp_ot_controller.target.crew_step import CrewStep, Tick
from ssp_ot_controller.target.echo import Echo, answers_late
from ssp_ot_controller.target.live import LiveObjects, open_bodies
from ssp_ot_controller.target.outlet.node import Outlet

LATE_ANSWER_PERIOD_S = 0.005
WATCHDOG_PERIOD_S = 0.05


class ObjectTargetNode(LifecycleNode):
    """Thin lifecycle node around target.Crew; with ``autostart`` it activates itself."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.OBJECT_TARGET, namespace=names.NAMESPACE)
        self._given = ros.declare(self, OBJECT_TARGET)
        self._crew: Crew | None = None
        self._live: LiveObjects | None = None
        self._destroyers: list[Callable[[], object]] = []
        self._failure: Exception | None = None
        if self._given["autostart"]:
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

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._crew is not None:
            self._crew.active = True
        return super().on_activate(state)

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
        if self._crew is not None:
            self._crew.active = False
            self._send(self._crew.halt(time.monotonic_ns()))

    def _configure(self) -> None:
        run = load_run(self._given["run_file"])
        wanted = [i for i in self._given["object_ids"].split(",") if i]
        crew = self._crew = Crew(run, wanted, time.monotonic_ns())
        crew.active = False
        self._echo = Echo()
        self._outlet = Outlet(self, crew.object_ids, run.states_in_one, self._destroyers)
        self._hear(crew, run)
        self._timer(WATCHDOG_PERIOD_S, partial(self._watch, crew))
        if answers_late(run, crew.object_ids):
            self._timer(LATE_ANSWER_PERIOD_S, self._answer_late)
        if run.mode == "live":
            self._connect_bodies(crew, run)

    def _connect_bodies(self, crew: Crew, run: RunSpec) -> None:
        """No simulated world: the bodies are read and commanded here, on a steady timer."""
        bodies = open_bodies(run, crew.object_ids, self._given["bodies"], time.time_ns())
        live = self._live = LiveObjects(run, bodies, self.get_logger().error)
        self._destroyers.append(self._disconnect_bodies)
        self._timer(run.step_s, partial(self._live_step, crew, live))

    def _disconnect_bodies(self) -> None:
        if self._live is not None:
            self._live.close()
            self._live = None

    def _live_step(self, crew: Crew, live: LiveObjects) -> None:
        crew.take_tick(live.tick(time.time_ns()), time.monotonic_ns())
        self._send(crew.step(time.monotonic_ns()))

    def _hear(self, crew: Crew, run: RunSpec) -> None:
        sub = self._sub
        for object_id in crew.object_ids:
            on_reference = partial(self._on_reference, crew)
            topic = names.reference_topic(object_id)
            sub(ReferenceMsg, topic, decode_reference, on_reference, ros.COMMAND)
            service = self.create_service(
                ObjectCommand,
                names.command_service(object_id),
                partial(self._on_object_command, crew, object_id),
            )
            self._destroyers.append(partial(self.destroy_service, service))
        others = [t.id for t in run.targets if t.id not in crew.object_ids]
        if others and run.states_in_one:
            on_array = partial(self._on_array, crew)
            sub(ObjectStates, names.OBJECT_STATES, decode_states, on_array, ros.STATE)
            others = []
        for object_id in [names.VUT_ID, *others]:
            topic, on_state = names.state_topic(object_id), partial(self._on_state, crew)
            sub(ObjectState, topic, decode_state, on_state, ros.STATE)
        on_heartbeat = partial(self._on_heartbeat, crew)
        sub(Heartbeat, names.HEARTBEAT, steps.decode_heartbeat, on_heartbeat, ros.STATE)
        if run.mode != "live":
            on_tick = partial(self._on_tick, crew)
            sub(WorldTick, names.WORLD_TICK, steps.decode_tick, on_tick, ros.STATE)

    def _timer(self, period_s: float, callback: Callable[[], None]) -> None:
        timer = self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._destroyers.append(partial(self.destroy_timer, timer))

    def _sub(
        self,
        kind: Any,
        topic: str,
        decode: Callable[[bytes], Any],
        callback: Callable[[Any], None],
        qos: QoSProfile,
    ) -> None:
        subscription = ros.subscribe_raw(self, kind, topic, decode, callback, qos)
        self._destroyers.append(partial(self.destroy_subscription, subscription))

    # -- what arrives --------------------------------------------------------------------------

    def _on_heartbeat(self, crew: Crew, beat: steps.Heartbeat) -> None:
        system_ns, steady_ns = time.time_ns(), time.monotonic_ns()
        crew.take_heartbeat(
            beat.sequence,
            beat.session_state,
            beat.stamp_ns,
            beat.references_sent,
            beat.sender,
            steady_ns,
        )
        if crew.active:
            links = {i: crew.links_of(i) for i in crew.object_ids}
            for reply in self._echo.on_heartbeat(
                beat.sequence, beat.sent_ns, links, system_ns, steady_ns
            ):
                self._outlet.reply(reply)
        self._work(crew)

    def _on_state(self, crew: Crew, state: State) -> None:
        crew.take_states((state,))
        self._work(crew)

    def _on_array(self, crew: Crew, array: StateArray) -> None:
        crew.take_states(s for s in array.states if s.object_id not in crew.object_ids)

    def _on_reference(self, crew: Crew, reference: Reference) -> None:
        crew.take_reference(reference)
        self._work(crew)

    def _on_tick(self, crew: Crew, message: steps.WorldTick) -> None:
        tick = Tick(
            step=message.step,
            now_ns=message.stamp_ns,
            running=message.running,
            lockstep=message.lockstep,
            heartbeat=message.heartbeat,
            truths={s.object_id: s for s in message.objects if s.object_id in crew.object_ids},
            vut_states_sent=message.vut_states_sent,
        )
        crew.take_tick(tick, time.monotonic_ns())
        self._work(crew)

    def _on_object_command(
        self,
        crew: Crew,
        object_id: str,
        request: ObjectCommand.Request,
        response: ObjectCommand.Response,
    ) -> ObjectCommand.Response:
        try:
            event = ObjectEvent(request.command)
        except ValueError:
            response.accepted = False
            response.error_code = ObjectCommand.Response.REFUSED_TRANSITION
            response.error_msg = f"command {request.command} is unknown"
        else:
            reply = crew.command(object_id, event, request.event_version, time.monotonic_ns())
            response.accepted = reply.accepted
            response.error_code = reply.error_code
            response.error_msg = reply.error_msg
        response.control_state = int(crew.state_of(object_id))
        return response

    def _work(self, crew: Crew) -> None:
        """Deals with the newest tick once everything that belongs to it has arrived."""
        if self._live is None:
            self._send(crew.step(time.monotonic_ns()))

    def _send(self, step: CrewStep | None) -> None:
        # Bodies first: what is published can wait.
        if self._live is not None:
            self._live.command(step, time.time_ns())
        self._outlet.send(step)

    def _watch(self, crew: Crew) -> None:
        self._work(crew)
        self._send(crew.watch(time.monotonic_ns()))

    def _answer_late(self) -> None:
        for reply in self._echo.due(time.monotonic_ns()):
            self._outlet.reply(reply)


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(ObjectTargetNode, lambda node: node.trigger_shutdown()))


if __name__ == "__main__":
    main()
