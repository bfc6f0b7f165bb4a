"""The node ``monitor``: records a session into a bag and says whether it can."""

from __future__ import annotations

import sys
import threading
import time

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from ssp_core import names, ros
from ssp_core.bag.seals.verdict import leave_verdict
from ssp_core.cdr import steps
from ssp_core.cdr.steps import RECORDER_STEPS, decode_tick_head, encode_done
from ssp_core.errors import HostError
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_core.world.event_messages import encode_limit
from ssp_core.world.plant import LimitFact
from ssp_monitor.recorder.disk import LEAST_S
from ssp_monitor.recorder.report import RepeatedWarnings, RunOutcome
from ssp_monitor.ros.parameters import MONITOR, session_plan
from ssp_monitor.ros.recording import Recording
from ssp_msgs.msg import RecorderStatus, SafetyEvent, SessionState, StepDone

STATUS_PERIOD_S = 0.5
# A stranger is told of at once.
LOOK_PERIOD_S = 0.05
SESSION_TOPIC = names.absolute(names.SESSION_STATE)
TICK_TOPIC = names.absolute(names.WORLD_TICK)
# Of a hundred warnings the first ones say what is wrong; the status and the bag have the rest.
MOST_SAID = 20
RUN_ENDED = "the run is ended while there is room to record its end"
# A session that is under way when the recorder is told to stop has so long for its last word.
LAST_WORD_S = 3.0
# Once its manager is gone, what it said may still lie here unread.
UNREAD_S = 0.5


class MonitorNode(Node):
    """Owns a recording and publishes RecorderStatus twice a second, and when a stranger speaks.

    Raises:
        InputError: a parameter is missing, the run file is wrong or the bag directory exists.
        HostError: the bag can't be written.
    """

    def __init__(self) -> None:
        super().__init__(names.MONITOR, namespace=names.NAMESPACE)
        self._plan = session_plan(ros.declare(self, MONITOR), self.resolve_topic_name)
        self._last_word = RunOutcome(str(self._plan.run_id))
        self._session_contact = threading.Event()
        self._state = SessionPhase.UNKNOWN
        self._done = self.create_publisher(StepDone, names.STEP_DONE, ros.STATE)
        listen = {SESSION_TOPIC: self._hear, TICK_TOPIC: self._keep_pace}
        # What is latched is heard before there is a recording to ask.
        self._is_ready = False
        self.recording = Recording(self, self._plan, listen, self._is_waiting)
        self._is_ready = True
        self._reported_strangers: tuple[str, ...] = ()
        self._sayings = RepeatedWarnings()
        self._status = self.create_publisher(RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        self._safety = self.create_publisher(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        # Steady: a frozen /clock must not silence the recorder.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STATUS_PERIOD_S, self._publish_status, clock=steady)
        self.create_timer(LOOK_PERIOD_S, self._tell_of_strangers, clock=steady)

    def _tell_of_strangers(self) -> None:
        """Publish the status early where a second publisher has been heard since the last one."""
        if self.recording.present_strangers() != self._reported_strangers:
            self._publish_status()

    def _publish_status(self) -> None:
        intake = self.recording.intake
        if intake.error is not None:
            raise HostError(f"reception ended: {intake.error}") from intake.error
        disk = self.recording.poll()
        status = self.recording.status()
        status.header.stamp = ros.stamp_from_ns(intake.time.newest_ns)
        self._status.publish(status)
        self._reported_strangers = tuple(status.strangers)
        for warning in status.warnings[:MOST_SAID]:
            self._say_once(warning)
        if status.failure and self._say_once(f"nothing is recorded any more: {status.failure}"):
            self._safety.publish(encode_limit(self._passed(float(status.lost), 0.0)))
        # Before a run it is enough that the recorder isn't ready.
        elif disk.ends is not None and self._last_word.is_due and self._say_once(RUN_ENDED):
            passed = self._passed(disk.left_s, LEAST_S)
            self._safety.publish(encode_limit(passed, name="disk_left", unit="s"))

    def _say_once(self, text: str) -> bool:
        """Log a sentence if it is new; figures in it don't make it new."""
        fresh = self._sayings.say(text)
        if fresh:
            self.get_logger().error(text)
        return fresh

    def _passed(self, measured: float, limit: float) -> LimitFact:
        now_ns = self.recording.intake.time.newest_ns
        return LimitFact(SafetyCode.RECORDER, names.MONITOR, "", measured, limit, now_ns)

    def _hear(self, data: bytes) -> None:
        message = deserialize_message(data, SessionState)
        try:
            state, verdict = SessionPhase(message.state), Verdict(message.verdict)
        except ValueError as error:
            self.get_logger().error(f"session state not understood: {error}")
            return
        self._last_word.hear(state, verdict, tuple(message.reasons), message.run_id)
        self._state = state
        if self._is_ready:
            self.recording.session_is(state)
        self._session_contact.set()

    def _is_waiting(self) -> bool:
        """Tell whether a live session isn't armed yet, as it may be for hours."""
        return not self._plan.simulated_time and self._state < SessionPhase.ARMED

    def _keep_pace(self, data: bytes) -> None:
        """Report to a world in lockstep, every RECORDER_STEPS, that the recorder keeps pace."""
        tick = decode_tick_head(data)
        if tick.lockstep and tick.step % RECORDER_STEPS == 0:
            self._done.publish(encode_done(steps.StepDone(names.MONITOR, tick.step)))

    def _await_last_word(self) -> None:
        """Wait, so that an end of all nodes at once doesn't lose the session's end and braking."""
        deadline = time.monotonic() + LAST_WORD_S
        while self._last_word.is_due and time.monotonic() < deadline:
            if self.recording.intake.error is not None:
                return
            if not self.count_publishers(names.SESSION_STATE):
                deadline = min(deadline, time.monotonic() + UNREAD_S)
            self._session_contact.wait(0.05)
            self._session_contact.clear()

    def close(self) -> None:
        """End reception, close the bag, leave the verdict and print one line about it.

        Raises:
            HostError: not everything that arrived is in the bag, or reception ended before.
        """
        self._await_last_word()
        closed = self.recording.close()
        state, check = closed.state, closed.check
        print(
            f"{names.MONITOR}: {state.messages} messages, {state.bytes / 1e6:.1f} MB in "
            f"{self.recording.recorder.path}, {closed.lost} lost"
            + (f", {check.text}, seal {state.seal}" if check is not None else "")
            + "".join(f", {problem}" for problem in closed.incomplete),
            flush=True,
        )
        if check is None:
            raise HostError(str(state.failure))
        problems = (*closed.problems, *self.recording.strangers())
        verdict = self._last_word.verdict(closed.lost, self._plan.lost_limit, problems)
        leave_verdict(self.recording.recorder.path, *verdict, "monitor")
        if closed.incomplete:
            raise HostError("; ".join(closed.incomplete))


def main() -> int:
    return ros.run_node(lambda _: MonitorNode(), MonitorNode.close)


if __name__ == "__main__":
    sys.exit(main())
