"""Brings graph, reception, bag and disk together; its owner is a node and calls ``poll``.

This file owns what is said of a recording as a whole; each part owns its own figures.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ssp_core import names, ros
from ssp_core.errors import HostError, SspError
from ssp_core.safety.liveness import WATCHED
from ssp_core.vocabulary import SessionPhase
from ssp_monitor.recorder.disk import DiskOutlook, DiskWatch
from ssp_monitor.recorder.losses import LossesOfRun, RivalWatch, losses_beside
from ssp_monitor.recorder.plan import Attachment, RecordingPlan
from ssp_monitor.recorder.recorder import Recorder, RecorderState
from ssp_monitor.recorder.report import (
    ClosedRecording,
    MessageRates,
    RepeatedWarnings,
    TopicCounts,
    check_closed,
    report_attachment,
    seals,
)
from ssp_monitor.recorder.topics import TopicSpec
from ssp_monitor.ros.conversions import is_latched, offered_profiles, topic_status
from ssp_monitor.ros.graph_watch import GraphWatch
from ssp_monitor.ros.recording_subscriptions import RecordingSubscriptions
from ssp_msgs.msg import RecorderStatus

MOST_WARNINGS = 50
# Of so many topics each status says how they are; the bag's own report names all.
MOST_LISTED = 500


class Recording:
    """A bag, the reception for it, and what is known about both.

    Args:
        listen: takes the bytes of messages of some topics as they are recorded.
        is_waiting: as RecordingSubscriptions takes it.

    Raises:
        InputError: the bag directory exists, or a type is not known.
        HostError: the bag can't be written, or a type is not installed.
    """

    def __init__(
        self,
        node: Node,
        plan: RecordingPlan,
        listen: Mapping[str, Callable[[bytes], None]],
        is_waiting: Callable[[], bool] = lambda: False,
    ) -> None:
        self._plan = plan
        self._missing: list[str] = []
        self._sayings = RepeatedWarnings()
        self._rivals = RivalWatch(plan.alone)
        self._losses = LossesOfRun()
        self._disk = DiskWatch(plan.needs)
        self._rates = MessageRates(time.monotonic())
        self._own = frozenset(topic.name for topic in plan.topics)
        video = plan.video
        self.recorder = Recorder(
            plan.bag_dir,
            plan.topics,
            plan.attachments,
            plan.queue_bytes,
            plan.split,
            (lambda _topic, _msgtype: None) if video is None else video.encoder,
        )
        try:
            self.intake = RecordingSubscriptions(
                plan.topics, self.recorder, plan.simulated_time, listen, is_waiting
            )
            self._graph = GraphWatch(node, plan.selection, self._add, self._sayings.say)
            self.poll()
        except BaseException:
            self.recorder.stop()
            raise

    def lost_by_topic(self) -> dict[str, int]:
        """Count messages that were published and never received, as far as known.

        A publisher that is not heard, for its type or its profile, counts as one message, since
        nothing tells how many it lost.
        """
        lost = dict(self.intake.lost_by_topic())
        for name in (*self._graph.topics.changed, *self._graph.unheard):
            lost[name] = lost.get(name, 0) + 1
        return lost

    @property
    def lost(self) -> int:
        """Messages known to be missing of the topics that must be complete.

        They never arrived, or were not written. The topics are the run's own, of which counts what
        is lost since arming or shortly before; without a run all.
        """
        missing = self._missing_of_own()
        unheard = self._of_own(self.lost_by_topic()) - self._of_own(self.intake.lost_by_topic())
        return unheard + (self._losses.of(missing) if self._own else missing)

    def _missing_of_own(self) -> int:
        dropped = self.recorder.dropped_by_topic
        return self._of_own(self.intake.lost_by_topic()) + self._of_own(dropped)

    def _of_own(self, counts: Mapping[str, int]) -> int:
        return sum(n for name, n in counts.items() if not self._own or name in self._own)

    def session_is(self, state: SessionPhase) -> None:
        """Watch from arming to the session's end that topics have the one publisher they should."""
        self._losses.session_is(state)
        if state in WATCHED:
            self._rivals.begin(self.intake.returned_by_topic())
        elif state in (SessionPhase.FINISHED, SessionPhase.ABORTED):
            self.strangers()
            self._rivals.end()

    def strangers(self) -> tuple[str, ...]:
        """Return topics with more publishers than they should have, as sentences."""
        return self._rivals.look(self.intake.returned_by_topic())

    def present_strangers(self) -> tuple[str, ...]:
        """Return the same while a session is under way, and none outside it."""
        return self.strangers() if self._rivals.is_on else ()

    def poll(self) -> DiskOutlook:
        """Look at graph and disk, and record new topics. Twice a second is often enough.

        Returns:
            How long the disk lasts, and whether the recording must end.
        """
        received = self.intake.received_by_topic()
        self._missing = [
            t.name for t in self._plan.topics if self._graph.lacks(t, received[t.name])
        ]
        self._graph.look()
        self._losses.look(self._missing_of_own(), time.monotonic())
        bag_bytes = self.recorder.state().bytes
        return self._disk.look(time.monotonic(), bag_bytes, self.recorder.path)

    def status(self) -> RecorderStatus:
        """Return everything but the stamp, as it was at the last poll."""
        state, disk = self.recorder.state(), self._disk
        lost, dropped = self.lost_by_topic(), self.recorder.dropped_by_topic
        status = RecorderStatus()
        status.ready = not (self._missing or state.failure or disk.outlook.unready)
        status.bag = self.recorder.path.name
        status.failure = state.failure or ""
        status.messages, status.bytes, status.files = state.messages, state.bytes, state.files
        status.dropped = self._of_own(dropped)
        status.lost = self.lost
        status.missing_topics = self._missing
        status.queue_bytes, status.queue_limit_bytes = state.queue_bytes, state.queue_limit_bytes
        status.free_bytes = disk.free or 0
        status.write_bytes_per_s = float(disk.rate_bps)
        status.disk_left_s = float(disk.outlook.left_s)
        status.flush_age_s = float(state.flush_age_s)
        rates = self._rates.take(time.monotonic(), self.intake.received_by_topic())
        records = self.recorder.records()
        status.topics = [
            topic_status(
                record,
                self._graph.publishers.get(record.name, 0),
                lost.get(record.name, 0),
                dropped.get(record.name, 0),
                rates.get(record.name, 0.0),
            )
            for record in records[:MOST_LISTED]
        ]
        # Who was one in a session that is over keeps nobody from arming again.
        status.strangers = list(self.present_strangers())
        status.warnings = self._current_warnings(state, len(records))
        return status

    def close(self) -> ClosedRecording:
        """End reception, close the bag with a report in it, and open it again to check it."""
        self.intake.stop()
        received = self.intake.received_by_topic()
        state = self.recorder.stop(lambda: self._report(received))
        check = None
        if state.failure is None:
            dropped = self.recorder.dropped_by_topic
            left_out = dropped + Counter(self.intake.passed_over_by_topic())
            expected = {name: count - left_out[name] for name, count in received.items()}
            check = check_closed(self.recorder.path, expected, self.recorder.originals)
        names = tuple(record.name for record in self.recorder.records())
        several = frozenset(self._graph.topics.ambiguous)
        return ClosedRecording(state, self.lost, names, check, tuple(self._incomplete()), several)

    def _incomplete(self) -> Iterable[str]:
        if self.intake.error is not None:
            yield f"reception ended: {self.intake.error}"
        for name in sorted(self._graph.topics.ambiguous & self._plan.selection.named):
            yield f"{name} has several types and is not recorded"

    def _report(self, received: Mapping[str, int]) -> Attachment:
        self._current_warnings(self.recorder.state(), 0)
        return report_attachment(
            self.recorder.records(),
            TopicCounts(
                received,
                self.lost_by_topic(),
                self.recorder.dropped_by_topic,
                self.intake.passed_over_by_topic(),
            ),
            run_id=self._plan.run_id,
            missing=self.lost,
            lost_limit=self._plan.lost_limit,
            warnings=self._sayings.texts(),
            sealed=seals(self._plan.attachments),
        )

    def _add(
        self, topic: TopicSpec, publishers: Sequence[TopicEndpointInfo], profile: QoSProfile
    ) -> bool:
        """Record a topic that was found; False, and said, where it can't be."""
        try:
            self.recorder.add(topic, offered_profiles(publishers), is_latched(publishers))
            self.intake.add(topic, profile)
        except (SspError, RuntimeError) as error:
            self._sayings.say(f"{topic.name} is not recorded: {error}")
            return False
        return True

    def _current_warnings(self, state: RecorderState, topics: int) -> list[str]:
        """List the warnings that a person should see now; the bag's report keeps all of them."""
        warnings = [*self._graph.topics.all_warnings(), *state.warnings]
        if self._disk.outlook.warning is not None:
            warnings.insert(0, self._disk.outlook.warning)
        if 2 * state.queue_bytes > state.queue_limit_bytes:
            warnings.append("the disk does not keep up: more than half of the queue is in use")
        counts = Counter(self.lost_by_topic()) + self.recorder.dropped_by_topic
        warnings += losses_beside(counts, self._own)
        if self._own and self._losses.before:
            warnings.append(
                f"{self._losses.before} messages were lost before the session was armed"
            )
        if topics > MOST_LISTED:
            warnings.append(f"only the first {MOST_LISTED} topics are listed")
        for text in warnings:
            self._sayings.say(text)
        all_warnings = [
            *warnings,
            *(text for text in self._sayings.texts() if text not in warnings),
        ]
        return all_warnings[:MOST_WARNINGS]


POLL_S = 0.5
NODE_NAME = "recorder"


def record(
    plan: RecordingPlan,
    stop: threading.Event,
    duration_s: float | None,
    tell: Callable[[RecorderStatus], None],
) -> tuple[ClosedRecording, str]:
    """Record a plan's topics.

    Args:
        plan: without topics of its own.
        stop: ends it.
        duration_s: ends it too, None for never.
        tell: is given the recorder's state twice a second, and once when all is received.

    Returns:
        What became of the bag, and why the recording ended by itself; empty when it was asked to.

    Raises:
        InputError: the bag can't be made, or a variable of the environment is wrong.
        HostError: the bag can't be written, or reception failed.
    """
    ros.init([])
    try:
        # Nothing is spun: of a node that only looks at the graph, nobody asks anything.
        node = Node(
            NODE_NAME,
            namespace=names.NAMESPACE,
            enable_rosout=False,
            start_parameter_services=False,
        )
        recording = Recording(node, plan, {})
        until_s = None if duration_s is None else time.monotonic() + duration_s
        why = ""
        try:
            while not why and not stop.is_set():
                left_s = POLL_S if until_s is None else min(POLL_S, until_s - time.monotonic())
                if left_s <= 0:
                    break
                stop.wait(left_s)
                why = _poll(recording, tell)
        finally:
            closed = recording.close()
            tell(recording.status())
        node.destroy_node()
        return closed, why
    finally:
        rclpy.try_shutdown()


def _poll(recording: Recording, tell: Callable[[RecorderStatus], None]) -> str:
    if recording.intake.error is not None:
        raise HostError(f"reception ended: {recording.intake.error}") from recording.intake.error
    disk = recording.poll()
    status = recording.status()
    tell(status)
    return str(status.failure) or disk.ends or ""
