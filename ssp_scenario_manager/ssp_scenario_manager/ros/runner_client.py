"""ROS clients of ``ssp run``: one asks for a run by the action, one goes command by command."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import PeerError
from ssp_core.host.environment import adopt, without_shared_memory
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.publishers import NAMELESS
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_msgs.action import RunScenario
from ssp_msgs.msg import Heartbeat, LinkStatus, SessionState
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.ros.endpoints import full_name
from ssp_scenario_manager.ros.session_events import ArmedObjects, RunListener, SessionEvents
from ssp_scenario_manager.session.run_script import RunOutcome, RunScript
from ssp_scenario_manager.session.state_machine import Answer, SessionEvent

# How long the goal's result may come after the session's last word.
RESULT_GRACE_S = 1.0
# How long the result of a word that ran out may take.
_RESULT_LOST_S = 5.0
# A manager of another session that was heard so recently is there.
_HEARD_S = 2.0
# What one call of ``spin`` counts at most as silence: this process may have stood still itself.
_LISTENED_S = 0.5
_ABORTED = (SessionPhase.ABORTING, SessionPhase.ABORTED)
WHO = "ssp run"
# A lost answer (a server drops one for a client whose end it doesn't know yet) is asked for again.
ANSWER_S = 2.0
_LOADABLE = (None, SessionPhase.IDLE, SessionPhase.LOADED)
_UNDER_WAY = {
    SessionPhase.RUNNING,
    SessionPhase.STOPPING,
    SessionPhase.FINISHED,
    SessionPhase.ABORTING,
    SessionPhase.ABORTED,
}


@dataclass
class _SentGoal:
    """A goal that was sent.

    Args:
        not_after_ns: a person's word holds until then, on the system clock; 0: no word.
        goal: the manager's handle, once it took it.
        result: its result.
        result_at: when that came.
    """

    not_after_ns: int
    goal: Any = None
    result: Any = None
    result_at: float | None = None


class RunClient:
    """A run_scenario goal and what is heard while it lasts.

    Args:
        env: environment of the session's processes; this process joins their domain with it.
        run: whose objects are listened to while they arm.
        remappings: ``from:=to``, as the session's nodes have them.

    Attributes:
        node: for further endpoints, which this client then spins.
        session: its events.
        loaded: why the run could not be loaded, empty when it was; None before the answer.
        silent_s: how long this process has listened without a sign of the manager's.
    """

    def __init__(
        self,
        env: Mapping[str, str],
        say: RunListener,
        run: RunSpec,
        remappings: Sequence[str] = (),
    ) -> None:
        adopt(without_shared_memory(env))
        self._context = rclpy.Context()
        rules = [word for rule in remappings for word in ("-r", rule)]
        domain_id = int(env["ROS_DOMAIN_ID"])
        ros.init(["--ros-args", *rules] if rules else None, self._context, domain_id)
        self.node = Node(names.RUNNER, namespace=names.NAMESPACE, context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._client = ActionClient(self.node, RunScenario, names.RUN_SCENARIO)
        self._token = run.session_token
        self._abort = self.node.create_client(SessionCommand, "abort")
        self._load = self.node.create_client(LoadScenario, names.LOAD_SCENARIO)
        self._request: _SentGoal | None = None
        self.loaded: tuple[str, ...] | None = None
        # What the manager was asked to load, and when last.
        self._load_request: tuple[str, float] | None = None
        # When the manager was asked to abort last; None: it wasn't, or it does.
        self._abort_request_at: float | None = None
        self._has_own_heartbeat = False
        self._other_heartbeat_at: float | None = None
        self.silent_s = 0.0
        self.session = SessionEvents(self.node, run, say, self.hear_manager)
        sub = self.node.create_subscription
        # Whatever the manager sends is a sign of life. Heartbeats come always, but wait for the
        # world in lockstep; the status comes once a second, from when a run is loaded.
        sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE)
        sub(LinkStatus, names.LINK_STATUS, lambda _: self.hear_manager(), ros.STATE)

    def hear_manager(self) -> None:
        """Take a sign of the manager: its silence counts from here."""
        self.silent_s = 0.0

    def lacks(self) -> list[str]:
        """Name what isn't seen yet of this session's manager.

        A manager of another session offers the same action and services.
        """
        missing = [] if self._has_own_heartbeat else [names.HEARTBEAT]
        if not self._client.server_is_ready():
            missing.append(f"the action {names.RUN_SCENARIO}")
        services = (self._load, self._abort)
        return missing + [f"the service {c.srv_name}" for c in services if not c.service_is_ready()]

    def camera_is_there(self) -> bool:
        """Tell whether a node publishes pictures; the simulated camera does once it can draw."""
        topic = self.node.resolve_topic_name(names.CAMERA_IMAGE)
        return bool(self.node.count_publishers(topic))

    def driver_is_there(self) -> bool:
        """Tell whether a node commands the VUT; that of a model does once the model is loaded."""
        topic = self.node.resolve_topic_name(names.VUT_COMMAND)
        return bool(self.node.count_publishers(topic))

    def plant_is_there(self) -> bool:
        """Tell whether a world whose plant is CARLA's has said so, which it does once all stand."""
        topic = self.node.resolve_topic_name(names.WORLD_PLANT)
        return bool(self.node.count_publishers(topic))

    def load(self, run_file: str) -> None:
        """Ask the manager to load a run without beginning it; ``loaded`` has its answer.

        It is asked again while none comes. A session that has gone on from LOADED was loaded.
        """
        self._load_request = run_file, time.monotonic()
        request = LoadScenario.Request(run_file=run_file, session_token=self._token)
        future = self._load.call_async(request)
        future.add_done_callback(self._on_loaded)

    def _ask_to_load(self) -> None:
        """Ask for the load again where no answer came."""
        if self._load_request is None or self.loaded is not None:
            return
        run_file, asked_at = self._load_request
        if time.monotonic() - asked_at < ANSWER_S:
            return
        if self.session.state in _LOADABLE:
            self.load(run_file)
        else:
            self.loaded = ()

    @property
    def under_way(self) -> bool:
        """Tell whether the session left the states before a run, not begun by this client."""
        return self._request is None and self.session.state in _UNDER_WAY

    def begin(self, run_file: str, not_after_ns: int = 0) -> None:
        """Send the goal; the answer is awaited by spinning.

        Args:
            run_file: that the manager loads.
            not_after_ns: a person's word holds until then, on the system clock; 0: no word.
        """
        self._request, self.session.is_led_by_us = _SentGoal(not_after_ns), True
        goal = RunScenario.Goal(run_file=run_file, session_token=self._token)
        goal.not_after = ros.stamp_from_ns(not_after_ns)
        future = self._client.send_goal_async(goal, feedback_callback=self._on_feedback)
        future.add_done_callback(partial(self._on_accepted, self._request))

    @property
    def not_in_time(self) -> tuple[str, ...] | None:
        """Return what kept the run from starting while its word held; None while it may start.

        A result that DDS loses is not waited for: nothing starts after the word has run out.
        """
        request = self._request
        if request is None or not request.not_after_ns:
            return None
        if request.result is not None:
            result = request.result.result
            late = result.error_code == RunScenario.Result.NOT_IN_TIME
            return tuple(result.reasons) if late else None
        over_ns = request.not_after_ns + seconds_to_ns(_RESULT_LOST_S)
        state = self.session.state
        waits = state is None or state < SessionPhase.RUNNING
        if waits and self.session.end is None and time.time_ns() > over_ns:
            return ("the manager gave no answer in time",)
        return None

    def ask_again(self) -> None:
        """Forget a goal whose word ran out; the run may still be begun from elsewhere."""
        self._request, self.session.is_led_by_us = None, False

    def other_managers(self) -> tuple[str, ...]:
        """Name nodes beside our manager that publish heartbeats, by the graph and by messages.

        A publisher of a process that has ended may stay there for some seconds.
        """
        endpoints = self.node.get_publishers_info_by_topic(
            self.node.resolve_topic_name(names.HEARTBEAT)
        )
        managers = sorted(full_name(one) or NAMELESS for one in endpoints)
        at_s = self._other_heartbeat_at
        if len(managers) < 2 and at_s is not None and time.monotonic() - at_s < _HEARD_S:
            managers.append("the manager of another session")
        return tuple(managers) if len(managers) > 1 else ()

    def cancel(self) -> None:
        """Ask the manager to abort, and again while it doesn't."""
        self._abort_request_at = 0.0
        if self._request is not None and self._request.goal is not None:
            self._request.goal.cancel_goal_async()
            self._abort_request_at = time.monotonic()
        self._ask_to_abort()

    def _ask_to_abort(self) -> None:
        """Ask for the abort again, which may be lost with the goal, or before two ends meet."""
        asked_at = self._abort_request_at
        if asked_at is None or time.monotonic() - asked_at < ANSWER_S:
            return
        if self.session.state in _ABORTED:
            self._abort_request_at = None
        elif self._abort.service_is_ready():
            self._abort_request_at = time.monotonic()
            self._abort.call_async(SessionCommand.Request(requested_by=WHO))

    def spin(self, timeout_s: float) -> None:
        began = time.monotonic()
        self._executor.spin_once(timeout_sec=timeout_s)
        self.session.say_armed()
        self._ask_to_abort()
        self._ask_to_load()
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
        end, result = self.session.end, None if self._request is None else self._request.result
        if result is None or (end is None and self.session.times.zero_ns is not None):
            heard_at = self._end_at()
            grace_s = 0.0 if self._request is None else RESULT_GRACE_S
            if heard_at is None or time.monotonic() - heard_at < grace_s:
                return None
        if result is None:
            assert end is not None
            return RunOutcome(Verdict(end.verdict), tuple(end.reasons))
        reasons = list(result.result.reasons)
        if result.result.error_msg and not reasons:
            reasons = [result.result.error_msg]
        return RunOutcome(Verdict(result.result.verdict), tuple(reasons))

    def _end_at(self) -> float | None:
        """Return when the end was heard first, by the result or by the session's last word."""
        end_times_s = [
            self.session.ended_at,
            None if self._request is None else self._request.result_at,
        ]
        return min((at for at in end_times_s if at is not None), default=None)

    def close(self) -> None:
        with ros.bounded_teardown():
            self._executor.shutdown()
            self.node.destroy_node()
            rclpy.shutdown(context=self._context)

    # -- callbacks -----------------------------------------------------------------------------

    def _on_loaded(self, future: Any) -> None:
        self.hear_manager()
        if self.loaded is None:
            answer = future.result()
            self.loaded = () if answer.accepted else (answer.error_msg,)

    def _on_accepted(self, request: _SentGoal, future: Any) -> None:
        request.goal = future.result()
        if not request.goal.accepted:
            raise PeerError("the scenario manager is busy with another run")
        request.goal.get_result_async().add_done_callback(partial(self._on_result, request))

    def _on_result(self, request: _SentGoal, future: Any) -> None:
        self.hear_manager()
        request.result, request.result_at = future.result(), time.monotonic()

    def _on_feedback(self, message: Any) -> None:
        self.hear_manager()
        feedback = message.feedback
        self.session.times.go_on(feedback.elapsed, self.session.end is not None)
        self.session.say_state(feedback.session_state)
        self.session.say_wait(feedback.session_state, feedback.waits_for)

    def _on_heartbeat(self, message: Heartbeat) -> None:
        # One of another session says nothing of our manager. A run by hand may name no session.
        if not self._token or message.session_token in ("", self._token):
            self._has_own_heartbeat = True
            self.hear_manager()
        else:
            self._other_heartbeat_at = time.monotonic()


# What keeps an armed session from starting is there by now; no use asking for longer.
START_PATIENCE_S = 5.0


class StepwiseClient:
    """load, connect, arm and start, one at a time, each after the answer to the one before.

    Args:
        run: the run; its objects tell when they are armed.
        run_file: path on the manager's host.
    """

    def __init__(self, node: Node, run: RunSpec, run_file: str) -> None:
        self._run_file, self._word_holds = run_file, False
        self._script = RunScript(run_file, time.monotonic_ns())
        self._token = run.session_token
        self._session = SessionPhase.IDLE
        self._armed = ArmedObjects(node, run)
        self._waiting: Any = None
        self._request_at = 0.0
        self._start_request_at: float | None = None
        self._disarm_request_at = 0.0
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

    def begin(self, not_after_ns: int = 0) -> None:
        """Begin with the first step, or go on from where the session stands on a person's word.

        Args:
            not_after_ns: the word holds until then, on the system clock; 0: no word.
        """
        now_ns, self._word_holds = time.monotonic_ns(), bool(not_after_ns)
        self._waiting, self._start_request_at, self._refusal = None, None, ()
        if not_after_ns:
            start_by_ns = now_ns + not_after_ns - time.time_ns()
            self._script = RunScript(self._run_file, now_ns, start_by_ns, self._run_file)
        else:
            self._script = RunScript(self._run_file, now_ns)

    @property
    def not_in_time(self) -> tuple[str, ...] | None:
        """Return what kept the run from starting while the word held; None while it may start."""
        return self._script.problems if self._script.not_in_time else None

    @property
    def stays_armed(self) -> bool:
        """Tell whether the session says that it is armed, whatever its objects say."""
        return self._session is SessionPhase.ARMED

    @property
    def is_armed(self) -> bool:
        """Tell whether the session and every object say that they are armed."""
        return self._session is SessionPhase.ARMED and self._armed.all

    @property
    def problems(self) -> tuple[str, ...]:
        """List the reasons why the run can't start; empty while it may, or when it has."""
        request_time_s = self._start_request_at
        late = request_time_s is not None and time.monotonic() - request_time_s > START_PATIENCE_S
        if late and not self._word_holds and self._session is SessionPhase.ARMED and self._refusal:
            return self._refusal
        return self._script.problems

    def lacks(self) -> list[str]:
        """Name the services of the manager that aren't seen yet."""
        services = (self._load, *self._commands.values())
        return [f"the service {c.srv_name}" for c in services if not c.service_is_ready()]

    def drive(self, may_start: bool) -> None:
        """Ask for the next step, unless an answer is still due.

        Args:
            may_start: False: an armed session is left as it is.
        """
        if self._waiting is not None and time.monotonic() - self._request_at < ANSWER_S:
            return
        wish = self._script.next(self._session, time.monotonic_ns())
        if wish is None or (wish is SessionEvent.START and not may_start):
            return
        self._request_at = time.monotonic()
        if wish is SessionEvent.START:
            self._start_request_at = self._start_request_at or self._request_at
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
        """Disarm what can't be started; asked again, where it doesn't."""
        waited_s = time.monotonic() - self._disarm_request_at
        if self._session is SessionPhase.ARMED and waited_s >= ANSWER_S:
            self._disarm_request_at = time.monotonic()
            why = "the run can't start"
            request = SessionCommand.Request(
                requested_by=WHO, reason=why, session_token=self._token
            )
            self._commands[SessionEvent.DISARM].call_async(request)

    # -- callbacks -------------------------------------------------------------------------------

    def _on_answer(self, request: Any, future: Any) -> None:
        if request is not self._waiting:
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
        if message.event == SessionEvent.ARM_FAILED.value:
            self._script.on_setback(message.reason)
