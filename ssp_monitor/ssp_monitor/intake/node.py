"""Takes every message of the recorded topics as it came, serialised, outside any executor.

One thread waits for the subscriptions on a wait set and takes each message with the middleware's
times and sequence number. An EventsExecutor gives its callbacks no such information, and losses
are found by it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.subscription import Subscription

from ssp_core import names
from ssp_core.bag import BagMessage
from ssp_monitor.conversions import message_class, recording_profile
from ssp_monitor.core.losses import SequenceGaps
from ssp_monitor.core.recorder import Recorder
from ssp_monitor.core.stamps import SimulatedTime, begins_with_stamp
from ssp_monitor.core.topics import TopicSpec
from ssp_monitor.params import topic_rules

WAIT_NS = 50_000_000


class Intake:
    """Takes every message of the topics, in a thread, and hands it to the recorder.

    Args:
        topics: what to subscribe to.
        recorder: where the messages go.
        simulated_time: messages are dated by their own stamps; otherwise by the middleware's
            times of reception and publication.
        listen: takes the bytes of messages of some topics as they are recorded, in that thread.
    """

    def __init__(
        self,
        topics: tuple[TopicSpec, ...],
        recorder: Recorder,
        simulated_time: bool,
        listen: Mapping[str, Callable[[bytes], None]],
    ) -> None:
        self._listen = listen
        self.gaps = SequenceGaps()
        self.time = SimulatedTime()
        self.error: BaseException | None = None
        self._topics = topics
        self._recorder = recorder
        self._simulated_time = simulated_time
        self._stamped = {
            topic.name: topic.session_time and begins_with_stamp(topic.msgtype) for topic in topics
        }
        # A node of its own, since an executor takes the messages of all subscriptions of a node
        # that it spins; of the process's arguments, which rename every node, it takes those that
        # say where a topic is to be heard. It is recorded under its own name all the same.
        self._node = rclpy.create_node(
            f"{names.MONITOR}_intake",
            namespace=names.NAMESPACE,
            use_global_arguments=False,
            cli_args=topic_rules(sys.argv),
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._subscriptions: list[tuple[TopicSpec, Subscription]] = [
            (
                topic,
                self._node.create_subscription(
                    message_class(topic.msgtype),
                    topic.name,
                    lambda _: None,
                    recording_profile(topic.profile),
                    raw=True,
                ),
            )
            for topic in topics
        ]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Takes what has arrived and ends."""
        self._stop.set()
        self._thread.join()
        self._node.destroy_node()

    def _run(self) -> None:
        try:
            with ExitStack() as handles:
                for _, subscription in self._subscriptions:
                    handles.enter_context(subscription.handle)
                wait_set = rcl.WaitSet(
                    len(self._subscriptions), 0, 0, 0, 0, 0, self._node.context.handle
                )
                handles.enter_context(wait_set)
                while not self._stop.is_set():
                    wait_set.clear_entities()
                    for _, subscription in self._subscriptions:
                        wait_set.add_subscription(subscription.handle)
                    wait_set.wait(WAIT_NS)
                    for index, (topic, subscription) in enumerate(self._subscriptions):
                        if wait_set.is_ready("subscription", index):
                            self._take_all(topic, subscription)
                for topic, subscription in self._subscriptions:
                    self._take_all(topic, subscription)
        except BaseException as error:
            self.error = error
            raise

    def _take_all(self, topic: TopicSpec, subscription: Subscription) -> None:
        while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
            data, info = taken
            sequence = info["publication_sequence_number"] or 0
            if topic.single_publisher and sequence:
                self.gaps.seen(topic.name, sequence)
            if self._simulated_time:
                log_ns = publish_ns = self.time.of(data, self._stamped[topic.name])
            else:
                log_ns, publish_ns = info["received_timestamp"], info["source_timestamp"]
            self._recorder.put(BagMessage(topic.name, log_ns, publish_ns, data, sequence))
            if topic.name in self._listen:
                self._listen[topic.name](data)
