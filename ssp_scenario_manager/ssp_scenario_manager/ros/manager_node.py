"""The scenario_manager node: messages in, the session decides, messages out."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.cdr.codec import MOST_TEXT
from ssp_core.cdr.references import Acknowledgement
from ssp_core.cdr.states import decode_state, decode_states
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState as State
from ssp_core.ros.conversions import body_status_of
from ssp_core.run_file.model import load_run
from ssp_core.run_file.session_token import draw_token, mode_problem
from ssp_core.safety import body_status
from ssp_core.safety.arming import recorder_lacks, refusal_text
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import Exchange
from ssp_core.safety.liveness import WATCHED
from ssp_core.safety.publishers import MOST_TOLD
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.msg import (
    BodyStatus,
    HeartbeatReply,
    LocalisationStatus,
    ObjectState,
    RecorderStatus,
    SafetyEvent,
    StepDone,
    WorldTick,
)
from ssp_scenario_manager.ros.endpoints import (
    DeclarationWatch,
    ObjectEndpoints,
    Publications,
    PublisherWatch,
    reply_of,
    violation_of,
)
from ssp_scenario_manager.ros.parameters import SCENARIO_MANAGER
from ssp_scenario_manager.ros.services import OwnSession, SessionServices
from ssp_scenario_manager.session import limits, outbox
from ssp_scenario_manager.session.inputs import StateInput, StepInputs, WorldMode
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import REFUSED_SESSION, Answer, SessionEvent
from ssp_scenario_manager.session.supervision import LivenessMonitor, Supervisor

WATCHDOG_PERIOD_S = 0.05
# A step of a lockstep world that lacks its messages for so long is worth a line in the log.
INCOMPLETE_STEP_S = 1.0
STATUS_PERIOD_S = 1.0
# While the world holds no step comes: here the watchdog judges what it can.
_JUDGED_WHILE_HOLDING = (SessionPhase.ARMED, SessionPhase.STOPPING, SessionPhase.ABORTING)


class ScenarioManager(Node):
    """Thin node around session.session.Session."""

    def __init__(self) -> None:
        super().__init__(names.SCENARIO_MANAGER, namespace=names.NAMESPACE)
        parameters = ros.declare(self, SCENARIO_MANAGER)
        self._session = Session()
        self._own = OwnSession()
        self._now_ns = 0
        self._liveness = LivenessMonitor()
        self._supervisor = Supervisor(self._session, self._liveness)
        self._inputs = StepInputs((names.OBJECT_TARGET,))
        self._world = WorldMode()
        self._arrival_ns = 0
        self._start_world = False
        self._input = StateInput(
            self._session,
            self._liveness,
            self._inputs,
            ros.tolerant(self, names.OBJECT_STATES, decode_states),
            self.get_logger().error,
        )
        self._links = ObjectEndpoints(
            self,
            self._on_target_state,
            self._on_array,
            self._on_ack,
            self._liveness.rules.hear,
            self._on_object_refusal,
            self._on_command_failure,
        )
        self._publications = Publications(self)
        if parameters["run_file"]:
            spec = load_run(parameters["run_file"])
            self._lead(spec.session_token or draw_token(spec.mode), spec.mode)
        self._commands = SessionServices(self, self._session, self._own, self._load, self._command)
        self._others = PublisherWatch(self, self._liveness)
        self._declarations = DeclarationWatch(self, self._liveness)
        self._subscribe()
        # The watchdog must go on when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WATCHDOG_PERIOD_S, self._on_watchdog, clock=steady)
        self.create_timer(STATUS_PERIOD_S, self._report_links, clock=steady)

    def _subscribe(self) -> None:
        raw = partial(ros.subscribe_raw, self)
        raw(WorldTick, names.WORLD_TICK, steps.decode_tick_head, self.on_tick, ros.STATE)
        raw(StepDone, names.STEP_DONE, steps.decode_done, self.on_step_done, ros.STATE)
        vut_topic = names.state_topic(names.VUT_ID)
        raw(ObjectState, vut_topic, decode_state, self.on_vut_state, ros.STATE)
        reply, event = names.HEARTBEAT_REPLY, names.SAFETY_EVENT
        raw(HeartbeatReply, reply, reply_of, self._on_reply, ros.STATE, raw=False)
        raw(SafetyEvent, event, violation_of, self.on_event, ros.LATCHED, raw=False)
        sub = self.create_subscription
        sub(CameraInfo, names.CAMERA_INFO, self._on_camera_info, ros.SENSOR)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.STATE)
        body = names.BODY_STATUS
        raw(BodyStatus, body, body_status_of, self._on_body_status, ros.STATE, raw=False)
        status = names.LOCALISATION_STATUS
        sub(LocalisationStatus, status, self._on_localisation, ros.STATE)

    @property
    def _live(self) -> bool:
        """Tell whether there is no simulated world: session time is the system clock's."""
        spec = self._session.spec
        return spec is not None and spec.mode == "live"

    @property
    def _in_lockstep(self) -> bool:
        """Tell whether the world waits for our answer to each of its steps."""
        return self._world.lockstep and self._world.running and not self._live

    def _take_time(self) -> None:
        if self._live:
            self._now_ns = time.time_ns()

    # -- what arrives --------------------------------------------------------------------------

    def on_tick(self, tick: steps.WorldTick) -> None:
        """Take a step or a hold of the world. A live session has no world, and follows none."""
        if self._live:
            self._input.tell_stranger("a simulated world", "a live session has its own time")
            return
        if (
            tick.running
            or not self._world.lockstep
            or self._session.state is not SessionPhase.RUNNING
        ):
            # A world that holds while the session runs is as good as silent.
            self._liveness.hear(names.SIL_WORLD, time.monotonic_ns())
        self._arrival_ns = time.monotonic_ns()
        self._supervisor.wake(self._arrival_ns)
        if self._in_lockstep and tick.running and self._inputs.is_dealt_with(tick.step):
            self._liveness.hear_hold(self._arrival_ns)
        self._world.lockstep, self._world.running = tick.lockstep, tick.running
        if self._in_lockstep and self._inputs.is_overtaken_by(tick.step):
            # The world went on without us: what is missing of that step won't come.
            self._do_step()
        self._inputs.on_tick(tick.step, tick.vut_states_sent)
        self._now_ns = tick.stamp_ns
        self._step_when_complete()

    def on_step_done(self, answer: steps.StepDone) -> None:
        """Take a participant's answer to a step."""
        if answer.participant == names.SCENARIO_MANAGER:
            return
        self._liveness.hear_answer(answer.participant)
        self._inputs.on_answer(
            answer.participant,
            answer.step,
            answer.states_sent,
            answer.acks_sent,
            answer.safety_events_sent,
        )
        self._step_when_complete()

    def on_vut_state(self, state: State) -> None:
        """Take a state of the VUT: outside lockstep the instant at which everything is judged."""
        self._arrival_ns = time.monotonic_ns()
        self._supervisor.wake(self._arrival_ns)
        self._take_time()
        # In lockstep each state is counted, and judged with its step.
        if not self._in_lockstep and self._session.refuse_if_ahead(state, self._now_ns):
            self._flush()
            return
        if not self._input.vut(state, self._arrival_ns):
            return
        if self._live:
            self._do_step()
        elif self._world.lockstep:
            self._step_when_complete()
        else:
            self._now_ns = max(self._now_ns, state.stamp_ns)
            if self._world.running:
                self._do_step()

    def _on_target_state(self, state: State) -> None:
        steady_ns = time.monotonic_ns()
        self._supervisor.wake(steady_ns)
        self._input.target(state, steady_ns)
        self._step_when_complete()

    def _on_array(self, data: bytes) -> None:
        """Take states of many: if the world doesn't wait for them, neither does the VUT's."""
        self._input.arrivals.put(data, time.monotonic_ns())
        if self._in_lockstep:
            self._input.waiting()
            self._step_when_complete()

    def _on_ack(self, ack: Acknowledgement) -> None:
        self._session.on_ack(
            ack.reference_id, ack.accepted, ack.error_code, ack.error_msg, ack.stamp_ns
        )
        self._inputs.acks += 1
        self._flush()
        self._step_when_complete()

    def _on_reply(self, reply: tuple[Sequence[str], int, Exchange]) -> None:
        self._liveness.links.on_reply(*reply, time.monotonic_ns())

    def _on_camera_info(self, _: CameraInfo) -> None:
        self._liveness.hear(names.FRONT_CAMERA, time.monotonic_ns())

    def _on_body_status(self, status: body_status.BodyStatus) -> None:
        self._liveness.hear_body(status, time.monotonic_ns())

    def _on_localisation(self, message: LocalisationStatus) -> None:
        self._liveness.hear_localisation(message.reason[:MOST_TEXT], time.monotonic_ns())

    def _on_recorder(self, message: RecorderStatus) -> None:
        """Take the recorder's report; the supervisor would see it a moment later."""
        steady_ns = time.monotonic_ns()
        missing = recorder_lacks(message.missing_topics, message.failure, message.warnings)
        self._liveness.hear_recorder(message.ready, missing, message.lost, steady_ns)
        self._liveness.hear_strangers(message.strangers[:MOST_TOLD])
        self._supervisor.wake(steady_ns)
        self._supervisor.watch_silence(steady_ns, self._now_ns)
        self._flush()

    def on_event(self, event: tuple[limits.Violation, str]) -> None:
        """Take a limit that a node saw passed, and the node's name."""
        violation, source = event
        if source == self.get_name():
            return
        self._supervisor.wake(time.monotonic_ns())
        if source == names.OBJECT_TARGET:
            self._inputs.safety_events += 1
        if violation.code is SafetyCode.PARTICIPANT_LOST:
            self._inputs.forget(violation.object_id)
        if self._in_lockstep:
            # Taken up with the step that it belongs to, in an order of its own.
            self._inputs.report(limits.in_session_time(violation, self._now_ns))
            self._step_when_complete()
            return
        self._session.take_report(violation, self._now_ns)
        self._flush()

    # -- steps ---------------------------------------------------------------------------------

    def _step_when_complete(self) -> None:
        if self._in_lockstep and self._inputs.complete():
            self._do_step()

    def _do_step(self) -> None:
        """Judge the newest states; in lockstep also answer the world."""
        for violation in self._inputs.take_reported():
            self._session.fail(violation, announced=True)
        # First what must not wait.
        newest = self._input.arrivals.over(self._session.targets)
        for decided in self._session.judge_triggers(self._now_ns, newest):
            self._send(decided)
        self._input.waiting()
        self._judge()
        self._flush()
        self._send_poses()
        if self._world.lockstep and not self._live:
            self._send_heartbeat()
            self._answer_world()

    def _judge(self) -> None:
        """Judge the newest states; before a verdict, look at the publishers a last time."""
        session = self._session
        if session.state is SessionPhase.STOPPING and session.stands(self._now_ns):
            steady_ns = time.monotonic_ns()
            self._others.look(steady_ns)
            self._supervisor.watch_silence(steady_ns, self._now_ns)
        session.step(self._now_ns)

    def _send_poses(self) -> None:
        """Send the poses to tf2, after urgent messages and before the answer to the world."""
        vut, targets = self._session.vut, self._session.targets
        states = [] if vut is None else [vut]
        self._publications.poses([*states, *(targets[key] for key in sorted(targets))])

    def _answer_world(self) -> None:
        self._inputs.done_step = self._inputs.step or 0
        self._publications.step_done(self._inputs.done_step, self._session.state)

    def _send_heartbeat(self) -> None:
        session, sent = self._session, self._links.references_sent
        self._liveness.links.on_sent(
            *self._publications.heartbeat(session.state, session.aborts, sent, self._now_ns)
        )

    def _on_watchdog(self) -> None:
        """Watch heartbeats (outside lockstep), silence, arming and script on the steady clock."""
        self._take_time()
        self._input.waiting()
        self._tell_incomplete_step()
        if not self._in_lockstep:
            self._send_heartbeat()
            if (
                self._world.lockstep
                and self._session.state is SessionPhase.RUNNING
                and not self._live
            ):
                # The word that starts the world may have come before it was listening.
                self._answer_world()
        self._links.send_commands()
        self._look_at_arming()
        self._look_at_publishers()
        if self._supervisor.look(time.monotonic_ns(), self._now_ns):
            self._commands.on_standstill_unconfirmed(self._now_ns)
        holding = not self._in_lockstep and self._session.state in _JUDGED_WHILE_HOLDING
        if self._live or holding:
            self._judge()
        self._commands.drive(self._now_ns)
        self._flush()

    def _look_at_publishers(self) -> None:
        """Look for strangers, and tell operators at once of those that came or went."""
        before = self._liveness.strangers
        self._others.look(time.monotonic_ns())
        if self._liveness.strangers != before:
            self._report_links()

    def _tell_incomplete_step(self) -> None:
        """Say once a step, when the world has waited for long, what the answer to it lacks."""
        waited_ns = time.monotonic_ns() - self._arrival_ns
        if not self._in_lockstep or waited_ns <= seconds_to_ns(INCOMPLETE_STEP_S):
            return
        if missing := self._inputs.missing_of_late():
            self.get_logger().warning(f"step {self._inputs.step or 0} lacks {', '.join(missing)}")

    def _report_links(self) -> None:
        losses = self._input.losses
        self._publications.report_links(self._session, self._liveness, losses, self._now_ns)

    # -- sending -------------------------------------------------------------------------------

    def _send(self, fact: outbox.Outgoing) -> None:
        if isinstance(fact, Reference):
            self._links.send(fact)
        elif isinstance(fact, outbox.StateChanged):
            self._announce(fact)
        elif isinstance(fact, outbox.ObjectCommand):
            if (spec := self._session.spec) is not None:
                abort_id = self._publications.abort_id(self._session.aborts)
                self._links.command(spec, fact, self._liveness.rules.checks(spec), abort_id)
                self._look_at_arming()
        else:
            self._publications.send(fact, self._arrival_ns)

    def _look_at_arming(self) -> None:
        """Count the time in which objects must be armed from when they could hear of it."""
        if self._links.take_arming_sent():
            self._supervisor.on_arm_commands(time.monotonic_ns())

    def _flush(self) -> None:
        """Send what the session decided, in its order."""
        while self._session.outbox:
            self._send(self._session.outbox.pop(0))
        if self._start_world:
            # Last, so that the heartbeat counts the references that were sent with the start.
            self._start_world = False
            self._send_heartbeat()
            self._answer_world()

    def _lead(self, token: str, mode: str) -> None:
        """Lead the session of this token from here on, and say so to those who lead by hand."""
        if token != self._own.token:
            self.get_logger().info(f"session_token {token}: goals and commands must carry it")
        self._own.token, self._own.mode = token, mode
        self._publications.session_token = self._links.session_token = token

    def _announce(self, change: outbox.StateChanged) -> None:
        self._own.state, self._own.since_ns = change.state, change.stamp_ns
        self._publications.state_changed(change, self._session.spec)
        if change.event == SessionEvent.ARM_FAILED.value:
            self._commands.on_setback(change.reason)
        if change.state is SessionPhase.ARMED:
            # A simulated world holds: until it runs, this is where they stand.
            self._send_poses()
        if change.event == SessionEvent.ABORT.value:
            self._links.forget_for_abort()
        if change.state is SessionPhase.ABORTING and not self._in_lockstep:
            # Not a moment later than it must be; in lockstep the step's own heartbeat tells it.
            self._send_heartbeat()
        if (
            self._world.lockstep
            and not self._world.running
            and change.state is SessionPhase.RUNNING
        ):
            # The world holds at step 0 until it hears that the session runs.
            self._start_world = True

    def _on_object_refusal(
        self, object_id: str, command: outbox.ObjectCommand, error_msg: str, lasting: bool
    ) -> None:
        reason = refusal_text(object_id, error_msg)
        self.get_logger().error(f"{command.name.lower()}: {reason}")
        if command is outbox.ObjectCommand.ARM:
            self._liveness.hear_refusal(object_id, error_msg, lasting, time.monotonic_ns())
            self._session.arming_failed(self._now_ns, reason)
            if lasting:
                self._commands.give_up(reason)
            self._flush()

    def _on_command_failure(
        self, object_id: str, command: outbox.ObjectCommand, outcome: str
    ) -> None:
        reason = f"{object_id} {outcome}"
        self.get_logger().error(f"{command.name.lower()}: {reason}")
        if command is outbox.ObjectCommand.ARM:
            self._session.arming_failed(self._now_ns, reason)
            self._flush()

    # -- commands ------------------------------------------------------------------------------

    def _load(self, run_file: str) -> Answer:
        try:
            spec = load_run(run_file)
        except InputError as error:
            return Answer(False, 2, str(error), (str(error),))
        if problem := mode_problem(self._own.token, spec.mode):
            text = f"{run_file}: {problem}; start another manager for it"
            return Answer(False, REFUSED_SESSION, text, (text,))
        self._input.waiting()
        if spec.mode == "live":
            self._now_ns = time.time_ns()
        answer = self._session.load(spec, self._now_ns)
        if answer.accepted:
            self._lead(spec.session_token or self._own.token or draw_token(spec.mode), spec.mode)
            self._own.run_file = run_file
            self._input.losses.forget()
            self._publications.loaded(spec)
            self._links.connect((t.id for t in spec.targets), spec.states_in_one)
            self._others.follow(spec, time.monotonic_ns())
            self._declarations.follow(spec)
            self._report_links()
        self._flush()
        return answer

    def _command(self, event: SessionEvent, requested_by: str, reason: str) -> Answer:
        self._take_time()
        self._input.waiting()
        self._supervisor.inform(time.monotonic_ns())
        answer = self._session.command(event, self._now_ns, requested_by, reason)
        self._flush()
        return answer

    def close(self) -> None:
        """End in order: abort and announce what runs before the node goes."""
        if self._session.state in WATCHED:
            self._take_time()
            why = "the manager shuts down"
            self._session.command(SessionEvent.ABORT, self._now_ns, self.get_name(), why)
        self._flush()
        self._send_heartbeat()


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(lambda _: ScenarioManager(), ScenarioManager.close))


if __name__ == "__main__":
    main()
