"""The node ``monitor``: records a session into a bag and says whether it can."""

from __future__ import annotations

import sys
import threading
import time

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.serialization import deserialize_message

from ssp_core import names, ros
from ssp_core.errors import HostError
from ssp_core.lockstep import RECORDER_STEPS
from ssp_core.run_spec import load_run
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.verdict import write_verdict
from ssp_core.vocab import SessionPhase, Verdict
from ssp_core.wire import steps
from ssp_core.wire.steps import decode_tick_head, encode_done
from ssp_monitor.conversions import recording_profile
from ssp_monitor.core.attachments import run_attachments
from ssp_monitor.core.last_word import LastWord
from ssp_monitor.core.recorder import Recorder
from ssp_monitor.core.topics import TopicSpec, bag_topics, uses_simulated_time
from ssp_monitor.intake.node import Intake
from ssp_monitor.params import read_params
from ssp_msgs.msg import RecorderStatus, SafetyEvent, SessionState, StepDone

STATUS_PERIOD_S = 0.5
SESSION_TOPIC = names.absolute(names.SESSION_STATE)
TICK_TOPIC = names.absolute(names.WORLD_TICK)
# A session that is under way when the recorder is told to stop has so long for its last word.
LAST_WORD_S = 3.0


class MonitorNode(Node):
    """Owns recorder and intake, and publishes RecorderStatus twice a second.

    Raises:
        InputError: a parameter is missing, the run file is wrong or the bag directory exists.
        HostError: the bag can't be written.
    """

    def __init__(self) -> None:
        super().__init__(names.MONITOR, namespace=names.NAMESPACE)
        params = read_params(self)
        run = load_run(params.run_file)
        self._topics = bag_topics(run)
        self._last_word = LastWord(run.run_id)
        self._session_heard = threading.Event()
        self._done = self.create_publisher(StepDone, names.STEP_DONE, ros.STATE)
        attachments = run_attachments(params.run_file)
        self.recorder = Recorder(params.bag_dir, self._topics, attachments)
        try:
            self.intake = Intake(
                self._topics,
                self.recorder,
                uses_simulated_time(run),
                {SESSION_TOPIC: self._hear, TICK_TOPIC: self._keep_pace},
            )
        except BaseException:
            self.recorder.stop()
            raise
        self._failure_said = False
        self._status = self.create_publisher(RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        self._safety = self.create_publisher(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        # Steady: a frozen /clock must not silence the recorder.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STATUS_PERIOD_S, self._publish_status, clock=steady)

    @property
    def lost(self) -> int:
        """Messages known to be lost: never arrived, or not written."""
        return self.intake.gaps.total + self.recorder.state().dropped

    def _is_missing(self, topic: TopicSpec) -> bool:
        """No publisher where one must be, or one that the recorder can't hear, anywhere."""
        wanted = recording_profile(topic.profile)
        heard = [
            qos_check_compatible(publisher.qos_profile, wanted)[0] != QoSCompatibility.ERROR
            for publisher in self.get_publishers_info_by_topic(topic.name)
        ]
        return not all(heard) or (topic.required and not heard)

    def _publish_status(self) -> None:
        if self.intake.error is not None:
            raise HostError(f"reception ended: {self.intake.error}") from self.intake.error
        state = self.recorder.state()
        missing = [topic.name for topic in self._topics if self._is_missing(topic)]
        status = RecorderStatus()
        status.header.stamp = ros.stamp_from_ns(self.intake.time.newest_ns)
        status.ready = not missing and state.failure is None
        status.bag = self.recorder.path.name
        status.messages, status.bytes, status.lost = state.messages, state.bytes, self.lost
        status.missing_topics = missing
        self._status.publish(status)
        if state.failure is not None and not self._failure_said:
            self._failure_said = True
            self.get_logger().error(f"nothing is recorded any more: {state.failure}")
            self._publish_failure()

    def _publish_failure(self) -> None:
        event = SafetyEvent()
        event.header.stamp = ros.stamp_from_ns(self.intake.time.newest_ns)
        event.code = SafetyCode.RECORDER.value
        event.limit_name = MEANINGS[SafetyCode.RECORDER].limit_name
        event.unit = MEANINGS[SafetyCode.RECORDER].unit
        event.source = names.MONITOR
        event.measured = float(self.lost)
        event.reaction = "abort"
        self._safety.publish(event)

    def _hear(self, data: bytes) -> None:
        message = deserialize_message(data, SessionState)
        try:
            state, verdict = SessionPhase(message.state), Verdict(message.verdict)
        except ValueError as error:
            self.get_logger().error(f"session state not understood: {error}")
            return
        self._last_word.hear(state, verdict, tuple(message.reasons), message.run_id)
        self._session_heard.set()

    def _keep_pace(self, data: bytes) -> None:
        """In lockstep the world doesn't run further ahead of the recorder than it says it is."""
        tick = decode_tick_head(data)
        if tick.lockstep and tick.step % RECORDER_STEPS == 0:
            self._done.publish(encode_done(steps.StepDone(names.MONITOR, tick.step)))

    def _await_last_word(self) -> None:
        """Who ends all nodes at once must not lose how the session ends, and the braking."""
        deadline = time.monotonic() + LAST_WORD_S
        while self._last_word.is_due and time.monotonic() < deadline:
            if self.intake.error is not None or not self.count_publishers(names.SESSION_STATE):
                return
            self._session_heard.wait(0.05)
            self._session_heard.clear()

    def close(self) -> None:
        """Ends reception, closes the bag, leaves the verdict and prints one line about it.

        Raises:
            HostError: not everything that arrived is in the bag.
        """
        self._await_last_word()
        self.intake.stop()
        lost = self.lost
        state = self.recorder.stop()
        print(
            f"{names.MONITOR}: {state.messages} messages, {state.bytes / 1e6:.1f} MB in "
            f"{self.recorder.path}, {self.lost} lost",
            flush=True,
        )
        if state.failure is not None:
            raise HostError(state.failure)
        write_verdict(self.recorder.path, *self._last_word.verdict(lost), "monitor")


def main() -> int:
    return ros.run_node(lambda _: MonitorNode(), MonitorNode.close)


if __name__ == "__main__":
    sys.exit(main())
