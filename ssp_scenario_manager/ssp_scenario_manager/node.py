"""The scenario_manager node: messages in, the session decides, messages out."""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from ssp_core import names, ros
from ssp_core.clock import NS_PER_S
from ssp_core.conversions import reference_to_msg
from ssp_core.errors import InputError
from ssp_core.messages import object_state
from ssp_core.run_spec import RunSpec, load_run
from ssp_core.safety_codes import SafetyCode
from ssp_core.state import ObjectState as State
from ssp_core.vocab import ControlState, SessionPhase
from ssp_msgs.action import RunScenario
from ssp_msgs.msg import (
    Heartbeat,
    ObjectState,
    PhaseEvent,
    RecorderStatus,
    Reference,
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
from ssp_scenario_manager.core.run_script import RunScript
from ssp_scenario_manager.core.session import Answer, Session
from ssp_scenario_manager.core.session_machine import SessionEvent

WATCHDOG_PERIOD_S = 0.05
# A simulated world that is silent this long on the steady clock is taken for dead.
WORLD_SILENT_LOCKSTEP_S = 4.0
WORLD_SILENT_REALTIME_S = 0.5
RECORDER_SILENT_S = 2.0
CAMERA_SILENT_S = 3.0
ARM_CONFIRMATION_S = 3.0
ABORT_STANDSTILL_S = 15.0
_ENDING = (SessionPhase.STOPPING, SessionPhase.ABORTING)


class ScenarioManager(Node):
    """Thin node around core.session.Session."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.SCENARIO_MANAGER, namespace=names.NAMESPACE)
        self._stop = stop
        self._session = Session()
        self._script: RunScript | None = None
        self._goal: Any = None
        self._now_ns = 0
        self._heartbeat = 0
        self._references_sent: dict[str, int] = {}
        self._inputs = StepInputs((names.OBJECT_TARGET,))
        self._lockstep = False
        self._running_world = False
        self._recorder: RecorderStatus | None = None
        self._heard: dict[str, int] = {}
        self._arming_since_ns: int | None = None
        self._aborting_since_ns: int | None = None
        self._object_io: dict[str, tuple[Any, Any]] = {}
        self._arrival_ns = 0
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
        sub(CameraInfo, names.CAMERA_INFO, lambda _: self._hear(names.FRONT_CAMERA), ros.SENSOR)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        sub(SafetyEvent, names.SAFETY_EVENT, self._on_safety_event, ros.LATCHED)
        self.create_service(LoadScenario, names.LOAD_SCENARIO, self._on_load)
        for command in names.SESSION_COMMANDS:
            event = SessionEvent(command)
            self.create_service(SessionCommand, command, partial(self._on_command, event))
        self._action = ActionServer(
            self,
            RunScenario,
            names.RUN_SCENARIO,
            execute_callback=self._finish_goal,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_goal_accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
        )
        # The watchdog must go on when simulated time stands still.
        self.create_timer(
            WATCHDOG_PERIOD_S, self._watchdog, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _connect_objects(self, spec: RunSpec) -> None:
        """Endpoints for the objects of a run; those of objects that stay are kept."""
        for target in spec.targets:
            if target.id in self._object_io:
                continue
            publisher = self.create_publisher(
                Reference, names.reference_topic(target.id), ros.COMMAND
            )
            client = self.create_client(ObjectCommand, names.command_service(target.id))
            self.create_subscription(
                ObjectState, names.state_topic(target.id), self._on_target_state, ros.STATE
            )
            self.create_subscription(
                ReferenceAck, names.ack_topic(target.id), self._on_ack, ros.COMMAND
            )
            self._object_io[target.id] = (publisher, client)
            self._references_sent.setdefault(target.id, 0)

    # -- what arrives --------------------------------------------------------------------------

    def _hear(self, who: str) -> None:
        self._heard[who] = time.monotonic_ns()

    def _age_s(self, who: str) -> float:
        heard = self._heard.get(who)
        return float("inf") if heard is None else (time.monotonic_ns() - heard) / NS_PER_S

    def _on_tick(self, message: WorldTick) -> None:
        self._hear(names.SIL_WORLD)
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
            message.participant, message.step, message.states_sent, message.acks_sent
        )
        self._step_when_complete()

    def _on_vut_state(self, message: ObjectState) -> None:
        self._hear(names.VUT_ID)
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
        self._hear(message.object_id)
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

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._hear(names.MONITOR)
        self._recorder = message

    def _on_safety_event(self, message: SafetyEvent) -> None:
        """Another node saw a limit passed."""
        if message.source == self.get_name():
            return
        try:
            code = SafetyCode(message.code)
        except ValueError:
            self.get_logger().error(f"unknown safety code {message.code} from {message.source}")
            return
        self._session.fail(
            supervisor.Violation(
                code,
                message.object_id,
                message.measured,
                message.limit,
                ros.ns_from_stamp(message.header.stamp),
                f"seen by {message.source}",
            ),
            announced=True,
        )
        self._flush()

    # -- steps ---------------------------------------------------------------------------------

    def _step_when_complete(self) -> None:
        if self._lockstep and self._running_world and self._inputs.complete():
            self._do_step()

    def _do_step(self) -> None:
        """Judges the newest states; in lockstep also answers the world."""
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
            object_ids=list(self._references_sent),
            references_sent=list(self._references_sent.values()),
        )
        message.header.stamp = ros.stamp_from_ns(self._now_ns)
        self._pub_heartbeat.publish(message)

    def _watchdog(self) -> None:
        """On the steady clock: heartbeats outside lockstep, silence, arming, the run's script."""
        in_lockstep = self._lockstep and self._running_world
        if not in_lockstep:
            self._send_heartbeat()
        spec = self._session.spec
        self._session.facts = Facts(
            recorder_ready=bool(self._recorder and self._recorder.ready),
            recorder_missing=tuple(self._recorder.missing_topics) if self._recorder else (),
            recorder_age_s=self._age_s(names.MONITOR),
            camera_age_s=self._age_s(names.FRONT_CAMERA),
            vut_age_s=self._age_s(names.VUT_ID),
            target_age_s=tuple((t.id, self._age_s(t.id)) for t in spec.targets) if spec else (),
        )
        self._watch_silence()
        self._watch_arming()
        self._watch_abort()
        if not in_lockstep and self._session.state in _ENDING:
            # The world holds, so that no step will come; whatever stands may be believed.
            self._session.step(self._now_ns)
        self._drive_script()
        self._flush()

    def _watch_silence(self) -> None:
        if self._session.state not in (SessionPhase.RUNNING, SessionPhase.STOPPING):
            return
        limit_s = WORLD_SILENT_LOCKSTEP_S if self._lockstep else WORLD_SILENT_REALTIME_S
        watched = [
            (SafetyCode.WORLD_SILENT, names.SIL_WORLD, limit_s),
            (SafetyCode.VUT_SILENT, names.VUT_ID, limit_s),
            (SafetyCode.RECORDER, names.MONITOR, RECORDER_SILENT_S),
        ]
        spec = self._session.spec
        if spec is not None and spec.camera is not None:
            watched.append((SafetyCode.PARTICIPANT_LOST, names.FRONT_CAMERA, CAMERA_SILENT_S))
        for code, who, limit in watched:
            violation = supervisor.silent(code, who, self._age_s(who), limit, self._now_ns)
            if violation is not None:
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
        world_dead = self._age_s(names.SIL_WORLD) > 1.0
        if self._script is not None and (world_dead or waited_s > ABORT_STANDSTILL_S):
            self._script.standstill_unconfirmed()

    # -- sending -------------------------------------------------------------------------------

    def _flush(self) -> None:
        """Sends what the session decided, in its order."""
        while self._session.outbox:
            fact = self._session.outbox.pop(0)
            if isinstance(fact, outbox.Dispatch):
                self._send_reference(fact)
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
                self._command_objects(
                    ObjectCommand.Request.COMMAND_ARM
                    if fact.armed
                    else ObjectCommand.Request.COMMAND_DISARM
                )
            else:
                self._command_objects(ObjectCommand.Request.COMMAND_ALL_CLEAR)
        if self._start_world:
            # Last, so that the heartbeat counts the references that were sent with the start.
            self._start_world = False
            self._send_heartbeat()
            self._answer_world()

    def _send_reference(self, fact: outbox.Dispatch) -> None:
        object_id = fact.reference.object_id
        publisher, _ = self._object_io[object_id]
        publisher.publish(reference_to_msg(fact.reference))
        self._references_sent[object_id] += 1

    def _announce(self, change: outbox.StateChanged) -> None:
        self._pub_state.publish(conversions.session_state_to_msg(change, self._session.spec))
        self.get_logger().info(
            f"{change.previous.name} -> {change.state.name} ({change.event}): {change.reason}"
        )
        if change.event == SessionEvent.ARM_FAILED.value and self._script is not None:
            self._script.on_setback(change.reason)
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
        if spec is None:
            return
        for target in spec.targets:
            _, client = self._object_io[target.id]
            request = ObjectCommand.Request(command=command, event_version=spec.event_version)
            future = client.call_async(request)
            future.add_done_callback(partial(self._on_object_answer, target.id, command))

    def _on_object_answer(self, object_id: str, command: int, future: Any) -> None:
        answer = future.result()
        if answer is None or answer.accepted:
            return
        reason = f"{object_id} refused: {answer.error_msg}"
        self.get_logger().error(reason)
        if command == ObjectCommand.Request.COMMAND_ARM:
            self._session.arming_failed(self._now_ns, reason)
            self._flush()

    # -- services and the action ---------------------------------------------------------------

    def _load(self, run_file: str) -> Answer:
        try:
            spec = load_run(run_file)
        except InputError as error:
            return Answer(False, 2, str(error), (str(error),))
        answer = self._session.load(spec, self._now_ns)
        if answer.accepted:
            self._connect_objects(spec)
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
        answer = self._session.command(
            event, self._now_ns, request.requested_by or "unknown", request.reason
        )
        self._flush()
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        response.missing = list(answer.missing)
        response.session_state = int(self._session.state)
        return response

    def _on_goal(self, request: RunScenario.Goal) -> GoalResponse:
        if self._goal is not None:
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_goal_accepted(self, goal: Any) -> None:
        self._goal = goal
        self._script = RunScript(goal.request.run_file, time.monotonic_ns())

    def _on_cancel(self, _: Any) -> CancelResponse:
        self._session.command(SessionEvent.ABORT, self._now_ns, "run_scenario", "goal cancelled")
        self._flush()
        return CancelResponse.ACCEPT

    def _drive_script(self) -> None:
        """Moves a run_scenario goal on: load, connect, arm, start, wait for the end."""
        if self._goal is None or self._script is None:
            return
        wish = self._script.next(self._session.state, time.monotonic_ns())
        if wish is SessionEvent.LOAD:
            self._script.on_answer(self._load(self._script.run_file))
        elif wish is not None:
            self._script.on_answer(self._session.command(wish, self._now_ns, "run_scenario", ""))
        feedback = RunScenario.Feedback()
        feedback.session_state = int(self._session.state)
        feedback.phase = int(self._session.phase)
        feedback.elapsed = self._session.elapsed_s(self._now_ns)
        self._goal.publish_feedback(feedback)
        if self._script.finished:
            if self._script.problems and self._session.state is SessionPhase.ARMED:
                self._session.command(
                    SessionEvent.DISARM, self._now_ns, "run_scenario", "the run can't start"
                )
            goal, self._goal = self._goal, None
            goal.execute()

    def _finish_goal(self, goal: Any) -> RunScenario.Result:
        script = self._script
        problems = script.problems if script else ()
        result = RunScenario.Result()
        if script is not None and script.begun:
            # Otherwise the session is somebody else's, and so is its verdict.
            result.verdict = int(self._session.verdict)
            result.reasons = list(self._session.reasons)
            result.run_id = self._session.spec.run_id if self._session.spec else ""
        result.reasons = list(result.reasons) or list(problems)
        if problems:
            result.error_code = 1
            result.error_msg = "; ".join(problems)
        elif result.verdict != SessionState.VERDICT_VALID:
            result.error_code = 2
            result.error_msg = "; ".join(result.reasons)
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.error_code:
            goal.abort()
        else:
            goal.succeed()
        return result

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
