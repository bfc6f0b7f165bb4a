"""The scenario_manager node: messages in, the session decides, messages out."""

from __future__ import annotations

import sys
import time
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from ssp_core import names, ros
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.messages import object_state
from ssp_core.run_spec import load_run
from ssp_core.safety_codes import SafetyCode
from ssp_core.state import ObjectState as State
from ssp_core.vocab import ControlState, SessionPhase
from ssp_msgs.msg import (
    Heartbeat,
    ObjectState,
    PhaseEvent,
    RecorderStatus,
    ReferenceAck,
    SafetyEvent,
    SessionState,
    StepDone,
    TriggerEvent,
    WorldTick,
)
from ssp_msgs.srv import LoadScenario, ObjectCommand, SessionCommand
from ssp_scenario_manager import conversions
from ssp_scenario_manager.core import outbox, supervisor
from ssp_scenario_manager.core.barrier import StepInputs
from ssp_scenario_manager.core.readiness import Facts
from ssp_scenario_manager.core.session import Answer, Session
from ssp_scenario_manager.core.session_machine import SessionEvent
from ssp_scenario_manager.core.vigil import Vigil
from ssp_scenario_manager.goal.node import RunGoal
from ssp_scenario_manager.links.node import ObjectLinks

WATCHDOG_PERIOD_S = 0.05
ARM_CONFIRMATION_S = 3.0
ABORT_STANDSTILL_S = 15.0
# Nobody waits for the standstill of what has not been heard for this long.
SILENT_S = 1.0
_ENDING = (SessionPhase.STOPPING, SessionPhase.ABORTING)
_WATCHED = (SessionPhase.RUNNING, SessionPhase.STOPPING)
_ARM = ObjectCommand.Request.COMMAND_ARM
_DISARM = ObjectCommand.Request.COMMAND_DISARM
_ALL_CLEAR = ObjectCommand.Request.COMMAND_ALL_CLEAR


class ScenarioManager(Node):
    """Thin node around core.session.Session."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.SCENARIO_MANAGER, namespace=names.NAMESPACE)
        self._stop = stop
        self._session = Session()
        self._now_ns = 0
        self._heartbeat = 0
        self._links = ObjectLinks(
            self, self._on_target_state, self._on_ack, self._on_object_refusal
        )
        self._goal = RunGoal(self, self._session, self._load, self._command)
        self._vigil = Vigil()
        self._inputs = StepInputs((names.OBJECT_TARGET,))
        self._lockstep = False
        self._running_world = False
        self._recorder: RecorderStatus | None = None
        self._arming_since_ns: int | None = None
        self._aborting_since_ns: int | None = None
        self._arrival_ns = 0
        self._reported: list[supervisor.Violation] = []
        self._start_world = False
        self._make_endpoints()

    # -- wiring --------------------------------------------------------------------------------

    def _make_endpoints(self) -> None:
        pub, sub = self.create_publisher, self.create_subscription
        self._pub_state = pub(SessionState, names.SESSION_STATE, ros.LATCHED)
        self._pub_heartbeat = pub(Heartbeat, names.HEARTBEAT, ros.STATE)
        self._pub_trigger = pub(TriggerEvent, names.TRIGGER_EVENT, ros.LATCHED)
        self._pub_phase = pub(PhaseEvent, names.PHASE_EVENT, ros.LATCHED)
        self._pub_safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._pub_done = pub(StepDone, names.STEP_DONE, ros.STATE)
        sub(WorldTick, names.WORLD_TICK, self._on_tick, ros.STATE)
        sub(StepDone, names.STEP_DONE, self._on_step_done, ros.STATE)
        sub(ObjectState, names.state_topic(names.VUT_ID), self._on_vut_state, ros.STATE)
        sub(CameraInfo, names.CAMERA_INFO, self._on_camera_info, ros.SENSOR)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        sub(SafetyEvent, names.SAFETY_EVENT, self._on_safety_event, ros.LATCHED)
        self.create_service(LoadScenario, names.LOAD_SCENARIO, self._on_load)
        for command in names.SESSION_COMMANDS:
            event = SessionEvent(command)
            self.create_service(SessionCommand, command, partial(self._on_command, event))
        # The watchdog must go on when simulated time stands still.
        self.create_timer(
            WATCHDOG_PERIOD_S, self._watchdog, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    # -- what arrives --------------------------------------------------------------------------

    def _on_tick(self, message: WorldTick) -> None:
        if message.running or not self._lockstep or self._session.state is not SessionPhase.RUNNING:
            # A world that holds while the session runs is as good as silent.
            self._vigil.hear(names.SIL_WORLD, time.monotonic_ns())
        self._arrival_ns = time.monotonic_ns()
        self._lockstep = message.lockstep
        self._running_world = message.running
        late = self._inputs.step
        in_step = message.lockstep and message.running
        if in_step and late is not None and self._inputs.done_step < late < message.step:
            # The world went on without us: what is missing of that step won't come.
            self._do_step()
        self._inputs.on_tick(message.step, message.vut_states_sent)
        self._now_ns = ros.ns_from_stamp(message.header.stamp)
        if in_step:
            self._step_when_complete()

    def _on_step_done(self, message: StepDone) -> None:
        if message.participant == names.SCENARIO_MANAGER:
            return
        self._inputs.on_answer(
            message.participant,
            message.step,
            message.states_sent,
            message.acks_sent,
            message.safety_events_sent,
        )
        self._step_when_complete()

    def _on_vut_state(self, message: ObjectState) -> None:
        self._vigil.hear(names.VUT_ID, time.monotonic_ns())
        self._arrival_ns = time.monotonic_ns()
        state = self._state(message)
        if state is not None:
            self._session.on_vut_state(state)
        if not self._lockstep:
            self._now_ns = max(self._now_ns, ros.ns_from_stamp(message.header.stamp))
            if self._running_world:
                self._do_step()
            return
        self._inputs.vut_states += ros.ns_from_stamp(message.header.stamp) > 0
        self._step_when_complete()

    def _on_target_state(self, message: ObjectState) -> None:
        self._vigil.hear(message.object_id, time.monotonic_ns())
        state = self._state(message)
        if state is not None:
            self._session.on_target_state(state)
        self._inputs.states += ros.ns_from_stamp(message.header.stamp) > 0
        self._step_when_complete()

    def _state(self, message: ObjectState) -> State | None:
        """The state, None for one with an unknown number in it: as good as silence."""
        try:
            return object_state(message)
        except ValueError as error:
            self.get_logger().error(f"state of {message.object_id} dropped: {error}")
            return None

    def _on_ack(self, message: ReferenceAck) -> None:
        self._session.on_ack(
            message.reference_id,
            message.accepted,
            message.error_code,
            message.error_msg,
            ros.ns_from_stamp(message.header.stamp),
        )
        self._inputs.acks += 1
        self._flush()
        self._step_when_complete()

    def _on_camera_info(self, _: CameraInfo) -> None:
        self._vigil.hear(names.FRONT_CAMERA, time.monotonic_ns())

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._vigil.hear(names.MONITOR, time.monotonic_ns())
        self._recorder = message
        if message.lost and self._session.state in _WATCHED:
            self._session.fail(
                supervisor.Violation(
                    SafetyCode.RECORDER,
                    "",
                    float(message.lost),
                    0.0,
                    self._now_ns,
                    "messages lost by the recorder",
                )
            )
            self._flush()

    def _on_safety_event(self, message: SafetyEvent) -> None:
        """Another node saw a limit passed."""
        if message.source == self.get_name():
            return
        try:
            code = SafetyCode(message.code)
        except ValueError:
            self.get_logger().error(f"unknown safety code {message.code} from {message.source}")
            return
        violation = supervisor.Violation(
            code,
            message.object_id,
            message.measured,
            message.limit,
            ros.ns_from_stamp(message.header.stamp),
            f"seen by {message.source}",
        )
        if message.source == names.OBJECT_TARGET:
            self._inputs.safety_events += 1
        if code is SafetyCode.PARTICIPANT_LOST:
            self._inputs.forget(message.object_id)
        if self._lockstep and self._running_world:
            # Taken up with the step that it belongs to, whenever it arrived.
            self._reported.append(violation)
            self._step_when_complete()
            return
        self._session.fail(violation, announced=True)
        self._flush()

    # -- steps ---------------------------------------------------------------------------------

    def _step_when_complete(self) -> None:
        if self._lockstep and self._running_world and self._inputs.complete():
            self._do_step()

    def _do_step(self) -> None:
        """Judges the newest states; in lockstep also answers the world."""
        for violation in self._reported:
            self._session.fail(violation, announced=True)
        self._reported.clear()
        self._session.step(self._now_ns)
        self._flush()
        if self._lockstep:
            self._send_heartbeat()
            self._answer_world()

    def _answer_world(self) -> None:
        step = self._inputs.step or 0
        self._inputs.done_step = step
        self._pub_done.publish(
            StepDone(
                participant=names.SCENARIO_MANAGER,
                step=step,
                heartbeat=self._heartbeat,
                session_state=int(self._session.state),
            )
        )

    def _send_heartbeat(self) -> None:
        self._heartbeat += 1
        message = Heartbeat(
            sender=self.get_name(),
            sequence=self._heartbeat,
            session_state=int(self._session.state),
            object_ids=list(self._links.references_sent),
            references_sent=list(self._links.references_sent.values()),
        )
        message.header.stamp = ros.stamp_from_ns(self._now_ns)
        self._pub_heartbeat.publish(message)

    def _watchdog(self) -> None:
        """On the steady clock: heartbeats outside lockstep, silence, arming, the run's script."""
        in_lockstep = self._lockstep and self._running_world
        if not in_lockstep:
            self._send_heartbeat()
        self._session.facts = self._facts()
        self._watch_silence()
        self._watch_arming()
        self._watch_abort()
        if not in_lockstep and self._session.state in _ENDING:
            # The world holds, so that no step will come; whatever stands may be believed.
            self._session.step(self._now_ns)
        self._goal.drive(self._now_ns)
        self._flush()

    def _facts(self) -> Facts:
        spec, recorder, now_ns = self._session.spec, self._recorder, time.monotonic_ns()
        targets = [t.id for t in spec.targets] if spec else []
        return Facts(
            recorder_ready=bool(recorder and recorder.ready),
            recorder_missing=tuple(recorder.missing_topics) if recorder else (),
            recorder_age_s=self._vigil.age_s(names.MONITOR, now_ns),
            camera_age_s=self._vigil.age_s(names.FRONT_CAMERA, now_ns),
            vut_age_s=self._vigil.age_s(names.VUT_ID, now_ns),
            target_age_s=tuple((i, self._vigil.age_s(i, now_ns)) for i in targets),
        )

    def _watch_silence(self) -> None:
        spec = self._session.spec
        if spec is None or self._session.state not in _WATCHED:
            return
        for violation in self._vigil.violations(
            spec, self._lockstep, time.monotonic_ns(), self._now_ns
        ):
            self._session.fail(violation)

    def _watch_arming(self) -> None:
        """A session stays armed only if every object says in time that it is."""
        if self._arming_since_ns is None or self._session.spec is None:
            return
        waiting = [
            target.id
            for target in self._session.spec.targets
            if (state := self._session.targets.get(target.id)) is None
            or state.control_state is not ControlState.ARMED
        ]
        if not waiting or self._session.state is not SessionPhase.ARMED:
            self._arming_since_ns = None
        elif time.monotonic_ns() - self._arming_since_ns > ARM_CONFIRMATION_S * NS_PER_S:
            self._arming_since_ns = None
            self._session.arming_failed(
                self._now_ns, f"{', '.join(waiting)} did not arm in {ARM_CONFIRMATION_S:g} s"
            )

    def _watch_abort(self) -> None:
        """A dead world can't report a standstill; the result must still be given."""
        if self._session.state is not SessionPhase.ABORTING:
            self._aborting_since_ns = None
            return
        if self._aborting_since_ns is None:
            self._aborting_since_ns = time.monotonic_ns()
        waited_s = (time.monotonic_ns() - self._aborting_since_ns) / NS_PER_S
        now_ns = time.monotonic_ns()
        # The world was silent while it waited for a participant that died; it goes on after that.
        world_age_s = self._vigil.age_s(names.SIL_WORLD, now_ns)
        world_dead = min(world_age_s, waited_s) > SILENT_S
        spec = self._session.spec
        ids = [t.id for t in spec.targets] if spec else []
        silent = [i for i in ids if self._vigil.age_s(i, now_ns) > SILENT_S]
        others_stand = bool(silent) and self._session.stands(self._now_ns, without=silent)
        if world_dead or others_stand or waited_s > ABORT_STANDSTILL_S:
            self._goal.on_standstill_unconfirmed()

    # -- sending -------------------------------------------------------------------------------

    def _flush(self) -> None:
        """Sends what the session decided, in its order."""
        while self._session.outbox:
            fact = self._session.outbox.pop(0)
            if isinstance(fact, outbox.Dispatch):
                self._links.send(fact.reference)
            elif isinstance(fact, outbox.StateChanged):
                self._announce(fact)
            elif isinstance(fact, outbox.Triggered):
                processing_s = (time.monotonic_ns() - self._arrival_ns) / NS_PER_S
                self._pub_trigger.publish(
                    conversions.trigger_to_msg(fact, self._now_ns, processing_s)
                )
            elif isinstance(fact, outbox.PhaseBegan):
                self._pub_phase.publish(conversions.phase_to_msg(fact))
            elif isinstance(fact, outbox.LimitPassed):
                self._pub_safety.publish(conversions.limit_to_msg(fact, self.get_name()))
            elif isinstance(fact, outbox.ArmObjects):
                self._command_objects(_ARM if fact.armed else _DISARM)
            else:
                self._command_objects(_ALL_CLEAR)
        if self._start_world:
            # Last, so that the heartbeat counts the references that were sent with the start.
            self._start_world = False
            self._send_heartbeat()
            self._answer_world()

    def _announce(self, change: outbox.StateChanged) -> None:
        self._pub_state.publish(conversions.session_state_to_msg(change, self._session.spec))
        self.get_logger().info(
            f"{change.previous.name} -> {change.state.name} ({change.event}): {change.reason}"
        )
        if change.event == SessionEvent.ARM_FAILED.value:
            self._goal.on_setback(change.reason)
        if change.state is SessionPhase.ARMED:
            self._arming_since_ns = time.monotonic_ns()
            self._report_blind_distance()
        if self._lockstep and not self._running_world and change.state is SessionPhase.RUNNING:
            # The world holds at step 0 until it hears that the session runs.
            self._start_world = True

    def _report_blind_distance(self) -> None:
        spec = self._session.spec
        if spec is not None:
            limits = spec.limits
            self.get_logger().info(
                f"blind distance on link loss: {limits.speed_mps * limits.heartbeat_s:.1f} m "
                f"({limits.speed_mps:g} m/s for {limits.heartbeat_s:g} s)"
            )

    def _command_objects(self, command: int) -> None:
        spec = self._session.spec
        if spec is not None:
            self._links.command([t.id for t in spec.targets], command, spec.event_version)

    def _on_object_refusal(self, object_id: str, command: int, error_msg: str) -> None:
        reason = f"{object_id} refused: {error_msg}"
        self.get_logger().error(reason)
        if command == _ARM:
            self._session.arming_failed(self._now_ns, reason)
            self._flush()

    # -- services ------------------------------------------------------------------------------

    def _load(self, run_file: str) -> Answer:
        try:
            spec = load_run(run_file)
        except InputError as error:
            return Answer(False, 2, str(error), (str(error),))
        answer = self._session.load(spec, self._now_ns)
        if answer.accepted:
            self._links.connect(t.id for t in spec.targets)
        self._flush()
        return answer

    def _command(self, event: SessionEvent, requested_by: str, reason: str) -> Answer:
        answer = self._session.command(event, self._now_ns, requested_by, reason)
        self._flush()
        return answer

    def _on_load(
        self, request: LoadScenario.Request, response: LoadScenario.Response
    ) -> LoadScenario.Response:
        answer = self._load(request.run_file)
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        spec = self._session.spec
        response.event_version = spec.event_version if answer.accepted and spec else ""
        return response

    def _on_command(
        self,
        event: SessionEvent,
        request: SessionCommand.Request,
        response: SessionCommand.Response,
    ) -> SessionCommand.Response:
        answer = self._command(event, request.requested_by or "unknown", request.reason)
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        response.missing = list(answer.missing)
        response.session_state = int(self._session.state)
        return response

    def close(self) -> None:
        """An orderly end: whatever runs is aborted and announced before the node goes."""
        if self._session.state in (
            SessionPhase.ARMED,
            SessionPhase.RUNNING,
            SessionPhase.STOPPING,
        ):
            self._session.command(
                SessionEvent.ABORT, self._now_ns, self.get_name(), "the manager shuts down"
            )
        self._flush()
        self._send_heartbeat()


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(ScenarioManager, lambda node: node.close()))


if __name__ == "__main__":
    main()
