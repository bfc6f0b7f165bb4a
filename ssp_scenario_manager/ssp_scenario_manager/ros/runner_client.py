"""ROS clients of ``ssp run``: one asks for a run by the action, one goes command by command."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.environment import adopt
from ssp_core.errors import PeerError
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.publishers import NAMELESS
from ssp_core.vocabulary import ControlState, Phase, SessionPhase, Verdict
from ssp_msgs.action import RunScenario
from ssp_msgs.msg import (
    FaultEvent,
    Heartbeat,
    LinkStatus,
    ObjectState,
    ObjectStates,
    PhaseEvent,
    SafetyEvent,
    SessionState,
    TriggerEvent,
)
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.ros.endpoints import full_name
from ssp_scenario_manager.session.run_script import RunOutcome, RunScript
from ssp_scenario_manager.session.state_machine import STANDSTILL_GIVEN_UP, Answer, SessionEvent

RunListener = Callable[[str], None]
# How long the goal's result may come after the session's last word.
RESULT_GRACE_S = 1.0
# How long the result of a word that ran out may take.
_RESULT_LOST_S = 5.0
# A manager of another session that was heard so recently is there.
_HEARD_S = 2.0
# What one call of ``spin`` counts at most as silence: this process may have stood still itself.
_LISTENED_S = 0.5
_TELL_AGAIN_S = 5.0  # what a step waits for, this long after the last line
# What people are told of a session whose objects were told to arm, until all report that they are.
ARMING = "ARMING"
_ABORTED = (SessionPhase.ABORTING, SessionPhase.ABORTED)
WHO = "ssp run"
# A lost answer (the two ends may have just found each other) is asked for again after this time.
ANSWER_S = 2.0
_UNDER_WAY = {
    SessionPhase.RUNNING,
    SessionPhase.STOPPING,
    SessionPhase.FINISHED,
    SessionPhase.ABORTING,
    SessionPhase.ABORTED,
}


class ArmedObjects:
    """The objects of a run that report that they are armed, watched while a caller wants to know.

    Args:
        run: its objects are listened to.
    """

    def __init__(self, node: Node, run: RunSpec) -> None:
        self._node = node
        self._armed = dict.fromkeys((t.id for t in run.targets), False)
        sub = node.create_subscription
        if run.states_in_one:
            self._heard = [sub(ObjectStates, names.OBJECT_STATES, self._on_states, ros.STATE)]
        else:
            self._heard = [
                sub(ObjectState, names.state_topic(target.id), self._on_state, ros.STATE)
                for target in run.targets
            ]

    @property
    def all(self) -> bool:
        return all(self._armed.values())

    def close(self) -> None:
        for subscription in self._heard:
            self._node.destroy_subscription(subscription)

    def _on_state(self, message: ObjectState) -> None:
        if message.object_id in self._armed:
            self._armed[message.object_id] = message.control_state == ControlState.ARMED

    def _on_states(self, message: ObjectStates) -> None:
        for state in message.states:
            self._on_state(state)


class RunClient:
    """A run_scenario goal and what is heard while it lasts.

    Args:
        env: environment of the session's processes; this process joins their domain with it.
        run: whose objects are listened to while they arm.
        remappings: ``from:=to``, as the session's nodes have them.

    Attributes:
        node: for further endpoints, which this client then spins.
    """

    def __init__(
        self,
        env: Mapping[str, str],
        say: RunListener,
        run: RunSpec,
        remappings: Sequence[str] = (),
    ) -> None:
        adopt(env)
        self._context = rclpy.Context()
        rules = [word for rule in remappings for word in ("-r", rule)]
        domain_id = int(env["ROS_DOMAIN_ID"])
        ros.init(["--ros-args", *rules] if rules else None, self._context, domain_id)
        self.node = Node(names.RUNNER, namespace=names.NAMESPACE, context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._client = ActionClient(self.node, RunScenario, names.RUN_SCENARIO)
        self._say, self._run = say, run
        self._token = run.session_token
        self._not_after_ns = 0
        self._abort = self.node.create_client(SessionCommand, "abort")
        self._load = self.node.create_client(LoadScenario, names.LOAD_SCENARIO)
        self.loaded: tuple[str, ...] | None = None
        """Why the run could not be loaded, empty when it was; None before the answer."""
        self._begun = False
        self._goal: Any = None
        self._result: Any = None
        self._end: SessionState | None = None
        # When the first of both was heard.
        self._ended_at: float | None = None
        self._last_state: int | None = None
        # While the session is ARMED and not every object reports that it is.
        self._arming: ArmedObjects | None = None
        self.was_armed = False
        """The session has been ARMED, or beyond."""
        self._told_at = time.monotonic()
        # When the manager was asked to abort last; None: it wasn't, or it does.
        self._abort_asked_at: float | None = None
        self.trouble: tuple[float, str] | None = None
        """The first sign that the running session is going to end badly: when, and what it was."""
        self.first_event: tuple[int, str, float, int] | None = None
        """The first limit that was passed: code, of whom, limit, and when it was heard, ns."""
        self.elapsed_s = 0.0
        self._running_since: float | None = None
        # Of the start, once it was heard. The clock of a live session counts from 1970, that of a
        # simulated one from 0.
        self._zero_ns: int | None = None
        self.running_wall_s = 0.0
        self._own_heard = False
        self._other_heard_at: float | None = None
        self.silent_s = 0.0
        """How long this process has listened without a sign of the manager's."""
        sub = self.node.create_subscription
        sub(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        sub(TriggerEvent, names.TRIGGER_EVENT, self._on_trigger, ros.LATCHED)
        sub(PhaseEvent, names.PHASE_EVENT, self._on_phase, ros.LATCHED)
        sub(SafetyEvent, names.SAFETY_EVENT, self._on_safety, ros.LATCHED)
        sub(FaultEvent, names.FAULT_EVENT, self._on_fault, ros.LATCHED)
        # Whatever the manager sends is a sign of life. Heartbeats come always, but wait for the
        # world in lockstep; the status comes once a second, from when a run is loaded.
        sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE)
        sub(LinkStatus, names.LINK_STATUS, lambda _: self.hear_manager(), ros.STATE)

    def hear_manager(self) -> None:
        """Take a sign of the manager: its silence counts from here."""
        self.silent_s = 0.0

    def ready(self) -> bool:
        """Tell whether this session's manager is heard, and the action is offered.

        A manager of another session offers the same action and services.
        """
        services = (self._load, self._abort)
        return (
            self._own_heard
            and self._client.server_is_ready()
            and all(c.service_is_ready() for c in services)
        )

    def camera_is_there(self) -> bool:
        """Tell whether a node publishes pictures; the simulated camera does once it can draw."""
        topic = self.node.resolve_topic_name(names.CAMERA_IMAGE)
        return bool(self.node.count_publishers(topic))

    def plant_is_there(self) -> bool:
        """Tell whether a world whose plant is CARLA's has said so, which it does once all stand."""
        topic = self.node.resolve_topic_name(names.WORLD_PLANT)
        return bool(self.node.count_publishers(topic))

    def load(self, run_file: str) -> None:
        """Ask the manager to load a run without beginning it; ``loaded`` has its answer."""
        request = LoadScenario.Request(run_file=run_file, session_token=self._token)
        future = self._load.call_async(request)
        future.add_done_callback(self._on_loaded)

    @property
    def under_way(self) -> bool:
        """Tell whether the session left the states before a run, not begun by this client."""
        return not self._begun and self._last_state in _UNDER_WAY

    def begin(self, run_file: str, not_after_ns: int = 0) -> None:
        """Send the goal; the answer is awaited by spinning.

        Args:
            run_file: that the manager loads.
            not_after_ns: a person's word holds until then, on the system clock; 0: no word.
        """
        self._begun, self._not_after_ns = True, not_after_ns
        self._goal = self._result = None
        goal = RunScenario.Goal(run_file=run_file, session_token=self._token)
        goal.not_after = ros.stamp_from_ns(not_after_ns)
        future = self._client.send_goal_async(goal, feedback_callback=self._on_feedback)
        future.add_done_callback(self._on_accepted)

    @property
    def not_in_time(self) -> tuple[str, ...] | None:
        """Return what kept the run from starting while its word held; None while it may start.

        A result that DDS loses is not waited for: nothing starts after the word has run out.
        """
        if not self._begun or not self._not_after_ns:
            return None
        if self._result is not None:
            result = self._result.result
            late = result.error_code == RunScenario.Result.NOT_IN_TIME
            return tuple(result.reasons) if late else None
        over_ns = self._not_after_ns + seconds_to_ns(_RESULT_LOST_S)
        waits = self._last_state is None or self._last_state < SessionPhase.RUNNING
        if waits and self._end is None and time.time_ns() > over_ns:
            return ("the manager gave no answer in time",)
        return None

    def ask_again(self) -> None:
        """Forget a goal whose word ran out; the run may still be begun from elsewhere."""
        self._begun, self._goal, self._result = False, None, None
        if self._end is None:
            # The refusal ended nothing: what follows isn't late because of it.
            self._ended_at = None

    def other_managers(self) -> tuple[str, ...]:
        """Name nodes beside our manager that publish heartbeats, by the graph and by messages.

        A publisher of a process that has ended may stay there for some seconds.
        """
        known = self.node.get_publishers_info_by_topic(
            self.node.resolve_topic_name(names.HEARTBEAT)
        )
        found = sorted(full_name(one) or NAMELESS for one in known)
        at_s = self._other_heard_at
        if len(found) < 2 and at_s is not None and time.monotonic() - at_s < _HEARD_S:
            found.append("the manager of another session")
        return tuple(found) if len(found) > 1 else ()

    def cancel(self) -> None:
        """Ask the manager to abort, and again while it doesn't."""
        self._abort_asked_at = 0.0
        if self._goal is not None:
            self._goal.cancel_goal_async()
            self._abort_asked_at = time.monotonic()
        self._ask_to_abort()

    def _ask_to_abort(self) -> None:
        """Ask for the abort again, which may be lost with the goal, or before two ends meet."""
        asked_at = self._abort_asked_at
        if asked_at is None or time.monotonic() - asked_at < ANSWER_S:
            return
        if self._last_state in _ABORTED:
            self._abort_asked_at = None
        elif self._abort.service_is_ready():
            self._abort_asked_at = time.monotonic()
            self._abort.call_async(SessionCommand.Request(requested_by=WHO))

    def spin(self, timeout_s: float) -> None:
        began = time.monotonic()
        self._executor.spin_once(timeout_sec=timeout_s)
        self._tell_armed()
        self._ask_to_abort()
        self.silent_s += min(time.monotonic() - began, _LISTENED_S)

    @property
    def outcome(self) -> RunOutcome | None:
        """The result once it is here.

        DDS may lose a goal's response when the two ends have just found each other, and with it
        the result. The session's own last word says the same, and it is latched. That one says
        when the run ended, so it is waited for as well.
        """
        if self.not_in_time is not None:
            return None
        heard_both = self._result is not None and (self._end is not None or self._zero_ns is None)
        if not heard_both:
            grace_s = RESULT_GRACE_S if self._begun else 0.0
            if self._ended_at is None or time.monotonic() - self._ended_at < grace_s:
                return None
        if self._result is None:
            assert self._end is not None
            return RunOutcome(Verdict(self._end.verdict), tuple(self._end.reasons))
        result = self._result.result
        reasons = list(result.reasons)
        if result.error_msg and not reasons:
            reasons = [result.error_msg]
        return RunOutcome(Verdict(result.verdict), tuple(reasons))

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    # -- callbacks -----------------------------------------------------------------------------

    def _on_loaded(self, future: Any) -> None:
        self.hear_manager()
        answer = future.result()
        self.loaded = () if answer.accepted else (answer.error_msg,)

    def _on_accepted(self, future: Any) -> None:
        self._goal = future.result()
        if not self._goal.accepted:
            raise PeerError("the scenario manager is busy with another run")
        self._goal.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        self.hear_manager()
        self._result = future.result()
        self._ended_at = self._ended_at or time.monotonic()

    def _on_feedback(self, message: Any) -> None:
        self.hear_manager()
        feedback = message.feedback
        if self._end is None:
            self.elapsed_s = feedback.elapsed
        if feedback.elapsed > 0.0:
            now = time.monotonic()
            self._running_since = self._running_since or now
            self.running_wall_s = now - self._running_since
        self._tell_state(feedback.session_state)
        if feedback.waits_for and time.monotonic() - self._told_at > _TELL_AGAIN_S:
            self._told_at = time.monotonic()
            self._say(
                f"waiting in {self._state_word(feedback.session_state)}: {feedback.waits_for}"
            )

    def _tell_state(self, state: int) -> None:
        if state != self._last_state:
            self._last_state = state
            self._told_at = time.monotonic()
            if self._arming is not None:
                self._arming.close()
                self._arming = None
            if state == SessionPhase.ARMED:
                # Objects were told to arm, and each may still refuse.
                self._arming = ArmedObjects(self.node, self._run)
                self._say(f"session {ARMING}: an object may still refuse")
            else:
                self._say(f"session {SessionPhase(state).name}")

    def _state_word(self, state: int) -> str:
        arming = state == SessionPhase.ARMED and self._arming is not None
        return ARMING if arming else SessionPhase(state).name

    def _tell_armed(self) -> None:
        if self._arming is not None and self._arming.all:
            self._arming.close()
            self._arming = None
            self._say(f"session {SessionPhase.ARMED.name}: every object reports it")

    def _on_heartbeat(self, message: Heartbeat) -> None:
        # One of another session says nothing of our manager. A run by hand may name no session.
        if not self._token or message.session_token in ("", self._token):
            self._own_heard = True
            self.hear_manager()
        else:
            self._other_heard_at = time.monotonic()

    def _on_session(self, message: SessionState) -> None:
        self.was_armed |= message.state >= SessionState.STATE_ARMED
        self.hear_manager()
        if not self._begun:
            self._tell_state(message.state)
        if message.state == SessionState.STATE_RUNNING:
            self._zero_ns = ros.ns_from_stamp(message.header.stamp)
            self._running_since = self._running_since or time.monotonic()
        if message.state == SessionState.STATE_ABORTING:
            self._note_trouble(message.reason)
        over = message.state in (SessionState.STATE_FINISHED, SessionState.STATE_ABORTED)
        given_up = message.event == STANDSTILL_GIVEN_UP
        if given_up:
            self._say(f"{message.reason}; keep clear")
        if over or given_up:
            self._end = message
            self._ended_at = self._ended_at or time.monotonic()
            if self._zero_ns is not None:
                # The end's own stamp: feedback comes before or after it, and none where somebody
                # else led the run.
                self.elapsed_s = self._since_start_s(message.header.stamp)
                if not self._begun and self._running_since is not None:
                    self.running_wall_s = self._ended_at - self._running_since

    def _note_trouble(self, what: str) -> None:
        self.trouble = self.trouble or (time.monotonic(), what)

    def _since_start_s(self, stamp: Any) -> float:
        return ns_to_seconds(ros.ns_from_stamp(stamp) - (self._zero_ns or 0))

    def _on_trigger(self, message: TriggerEvent) -> None:
        self._say(
            f"trigger {message.trigger_id}: {message.condition} at "
            f"{self._since_start_s(message.crossing_time):.3f} s, reference "
            f"{', '.join(message.reference_ids)} sent {message.processing * 1e3:.1f} ms later"
        )

    def _on_phase(self, message: PhaseEvent) -> None:
        stamp_s = self._since_start_s(message.header.stamp)
        mark = ", provisional: the recording's end tells" if message.provisional else ""
        self._say(f"phase {Phase(message.phase).name.lower()} at {stamp_s:.2f} s{mark}")

    def _on_safety(self, message: SafetyEvent) -> None:
        who = f" {message.object_id}" if message.object_id else ""
        figures = ""
        if message.words:
            figures = f" {message.words}"
        elif message.code != SafetyCode.OPERATOR:
            unit = f" {message.unit}" if message.unit else ""
            figures = f": {message.measured:.3g}{unit}, limit {message.limit:.3g}{unit}"
        stamp_s = self._since_start_s(message.header.stamp)
        if self.was_armed and self.first_event is None:
            at_ns = time.monotonic_ns()
            self.first_event = message.code, message.object_id, message.limit, at_ns
        if self._zero_ns is not None:
            # What came before the start may be left over from another session.
            self._note_trouble(f"{message.limit_name}{who}{figures}")
        self._say(
            f"SAFETY {message.limit_name}{who}{figures} at {stamp_s:.2f} s (seen by "
            f"{message.source}, {message.reaction})"
        )

    def _on_fault(self, message: FaultEvent) -> None:
        if message.source == self.node.get_name():
            # Injected by the runner, which says so itself.
            return
        stamp_s = self._since_start_s(message.header.stamp)
        self._say(
            f"FAULT {message.fault.partition(' ')[2]} of {message.target} "
            f"{'begins' if message.active else 'ends'} ({stamp_s:.2f} s)"
        )


# What keeps an armed session from starting is there by now; no use asking for longer.
START_PATIENCE_S = 5.0


class StepwiseClient:
    """load, connect, arm and start, one at a time, each after the answer to the one before.

    Args:
        run: the run; its objects tell when they are armed.
        run_file: path on the manager's host.
    """

    def __init__(self, node: Node, run: RunSpec, run_file: str) -> None:
        self._script = RunScript(run_file, time.monotonic_ns())
        self._token = run.session_token
        self._session = SessionPhase.IDLE
        self._armed = ArmedObjects(node, run)
        self._waiting: Any = None
        self._asked_at = 0.0
        self._start_asked_at: float | None = None
        self._refusal: tuple[str, ...] = ()
        self._load = node.create_client(LoadScenario, names.LOAD_SCENARIO)
        self._commands = {
            event: node.create_client(SessionCommand, event.value)
            for event in (
                SessionEvent.CONNECT,
                SessionEvent.ARM,
                SessionEvent.START,
                SessionEvent.DISARM,
            )
        }
        node.create_subscription(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)

    @property
    def is_armed(self) -> bool:
        """Tell whether the session and every object say that they are armed."""
        return self._session is SessionPhase.ARMED and self._armed.all

    @property
    def problems(self) -> tuple[str, ...]:
        """List the reasons why the run can't start; empty while it may, or when it has."""
        asked = self._start_asked_at
        late = asked is not None and time.monotonic() - asked > START_PATIENCE_S
        if late and self._session is SessionPhase.ARMED and self._refusal:
            return self._refusal
        return self._script.problems

    def ready(self) -> bool:
        """Tell whether the manager offers its services."""
        return all(c.service_is_ready() for c in (self._load, *self._commands.values()))

    def drive(self, may_start: bool) -> None:
        """Ask for the next step, unless an answer is still due.

        Args:
            may_start: False: an armed session is left as it is.
        """
        if self._waiting is not None and time.monotonic() - self._asked_at < ANSWER_S:
            return
        wish = self._script.next(self._session, time.monotonic_ns())
        if wish is None or (wish is SessionEvent.START and not may_start):
            return
        self._asked_at = time.monotonic()
        if wish is SessionEvent.START:
            self._start_asked_at = self._start_asked_at or self._asked_at
        if wish is SessionEvent.LOAD:
            request: Any = LoadScenario.Request(
                run_file=self._script.run_file, session_token=self._token
            )
            self._waiting = self._load.call_async(request)
        else:
            request = SessionCommand.Request(requested_by=WHO, session_token=self._token)
            self._waiting = self._commands[wish].call_async(request)
        self._waiting.add_done_callback(partial(self._on_answer, self._waiting))

    def give_up(self) -> None:
        """Disarm what can't be started."""
        if self._session is SessionPhase.ARMED:
            why = "the run can't start"
            request = SessionCommand.Request(
                requested_by=WHO, reason=why, session_token=self._token
            )
            self._commands[SessionEvent.DISARM].call_async(request)

    # -- callbacks -------------------------------------------------------------------------------

    def _on_answer(self, asked: Any, future: Any) -> None:
        if asked is not self._waiting:
            return
        self._waiting = None
        answer = future.result()
        missing = tuple(getattr(answer, "missing", ()))
        self._refusal = () if answer.accepted else missing or (answer.error_msg,)
        self._script.on_answer(
            Answer(answer.accepted, answer.error_code, answer.error_msg, missing)
        )

    def _on_session(self, message: SessionState) -> None:
        self._session = SessionPhase(message.state)
