"""The load that ``recording`` records: cameras and objects, published by a process of its own.

``python traffic.py LOAD SECONDS`` waits until every topic has a subscriber, publishes
and says on standard output, one JSON line each, when it begins, and when it ends how many messages
it sent on each topic. Messages are ready bytes; the first thing in each is a stamp that counts
them, so that each can be distinguished from all others.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from dataclasses import asdict, dataclass

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from ssp_core import names, ros
from ssp_core.cdr.codec import ENCAPSULATION, START, padded_text, stamp_bytes, u32_bytes
from ssp_core.cdr.states import encode_state
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import ObjectClass, Role
from ssp_monitor.recorder.topics import Profile, TopicSpec
from ssp_monitor.ros.conversions import message_class

WIDTH_PX, HEIGHT_PX = 1280, 720
JPEG_BYTES = 100_000
OBJECT_HZ = 100.0
CAMERA_HZ = 30.0
MATCH_TIMEOUT_S = 30.0
# A publisher knows of a subscription before that knows of the publisher.
BOTH_MATCHED_S = 1.0
ACK_TIMEOUT_S = 10.0

STATE_TYPE = "ssp_msgs/msg/ObjectState"
JPEG_TYPE = "sensor_msgs/msg/CompressedImage"
RAW_TYPE = "sensor_msgs/msg/Image"


@dataclass(frozen=True, slots=True)
class Load:
    """The published load: cameras at CAMERA_HZ, and objects on topics of their own.

    Args:
        jpegs: cameras whose frames are JPEG_BYTES.
        raws: cameras with uncompressed frames.
        objects: how many.
        object_hz: rate of each.
    """

    jpegs: int = 0
    raws: int = 0
    objects: int = 0
    object_hz: float = OBJECT_HZ

    @property
    def topics(self) -> tuple[TopicSpec, ...]:
        """All topics, in the form that a recorder gets them."""
        kinds = (
            ("jpeg", self.jpegs, JPEG_TYPE, Profile.SENSOR),
            ("raw", self.raws, RAW_TYPE, Profile.SENSOR),
            ("object", self.objects, STATE_TYPE, Profile.STATE),
        )
        return tuple(
            TopicSpec(f"{names.NAMESPACE}/bench/{name}{k}", msgtype, profile)
            for name, count, msgtype, profile in kinds
            for k in range(count)
        )

    @property
    def messages_per_s(self) -> float:
        return sum(self.rate_hz(topic) for topic in self.topics)

    @property
    def bytes_per_s(self) -> float:
        """Message data, without what the middleware adds."""
        return sum(len(template(topic.msgtype)) * self.rate_hz(topic) for topic in self.topics)

    def rate_hz(self, topic: TopicSpec) -> float:
        """Return the rate at which a topic is published."""
        return self.object_hz if topic.msgtype == STATE_TYPE else CAMERA_HZ

    def __str__(self) -> str:
        rate = "" if self.object_hz == OBJECT_HZ else f" at {self.object_hz:g} Hz"
        parts = [
            f"{self.jpegs} JPEG cameras" if self.jpegs else "",
            f"{self.raws} raw cameras" if self.raws else "",
            f"{self.objects} objects{rate}" if self.objects else "",
        ]
        return " + ".join(part for part in parts if part)

    def to_json(self) -> str:
        return json.dumps(asdict(self))


def template(msgtype: str) -> bytes:
    """A message of a type, whose stamp is to be replaced."""
    if msgtype == STATE_TYPE:
        size = Size(3.0, 1.0, 1.8, 1.5)
        return encode_state(
            ObjectState("ot1", ObjectClass.CAR, Role.OT, 0, 1.0, 2.0, 0.1, 8.0, 0.0, 0.0, size)
        )
    head = ENCAPSULATION + stamp_bytes(0) + padded_text("camera")
    if msgtype == JPEG_TYPE:
        data = os.urandom(JPEG_BYTES)
        return head + padded_text("jpeg") + u32_bytes(len(data)) + data
    data = os.urandom(WIDTH_PX) * (3 * HEIGHT_PX)
    head += u32_bytes(HEIGHT_PX) + u32_bytes(WIDTH_PX) + padded_text("rgb8")
    return head + bytes(4) + u32_bytes(3 * WIDTH_PX) + u32_bytes(len(data)) + data


@dataclass(slots=True)
class _Group:
    """Topics that are published together, one right after the other."""

    period_s: float
    message: bytearray
    publishers: list[Publisher]
    due_s: float = 0.0
    sent: int = 0

    def send(self) -> None:
        self.sent += 1
        self.message[START : START + 8] = stamp_bytes(self.sent)
        data = bytes(self.message)
        for publisher in self.publishers:
            publisher.publish(data)
        self.due_s += self.period_s


class _Sender:
    """Publishes a load for some time."""

    def __init__(self, node: Node, load: Load) -> None:
        profiles = {Profile.STATE: ros.STATE, Profile.SENSOR: ros.SENSOR}
        groups: dict[str, _Group] = {}
        for topic in load.topics:
            group = groups.get(topic.msgtype)
            if group is None:
                message = bytearray(template(topic.msgtype))
                group = _Group(1.0 / load.rate_hz(topic), message, [])
                groups[topic.msgtype] = group
            cls = message_class(topic.msgtype)
            publisher = node.create_publisher(cls, topic.name, profiles[topic.profile])
            group.publishers.append(publisher)
        self._groups = list(groups.values())

    @property
    def sent(self) -> dict[str, int]:
        """Messages by topic."""
        return {p.topic_name: group.sent for group in self._groups for p in group.publishers}

    def wait_for_subscribers(self) -> None:
        """Every topic has one.

        Raises:
            TimeoutError: not so in time.
        """
        deadline = time.monotonic() + MATCH_TIMEOUT_S
        for group in self._groups:
            for publisher in group.publishers:
                while not publisher.get_subscription_count():
                    if time.monotonic() > deadline:
                        raise TimeoutError(f"nobody has subscribed to {publisher.topic_name}")
                    time.sleep(0.02)

    def send(self, seconds: float) -> None:
        """Publishes what is due, late where it must, and nothing that is due after the end."""
        started = time.monotonic()
        while True:
            group = min(self._groups, key=lambda group: group.due_s)
            now_s = time.monotonic() - started
            if now_s >= seconds or group.due_s >= seconds:
                return
            if group.due_s > now_s:
                time.sleep(group.due_s - now_s)
            group.send()

    def wait_until_taken(self) -> None:
        """Wait until all that can still be requested has been delivered."""
        for group in self._groups:
            for publisher in group.publishers:
                publisher.wait_for_all_acked(Duration(seconds=ACK_TIMEOUT_S))


def main(load: Load, seconds: float) -> None:
    rclpy.init()
    sender = _Sender(ros.make_node("bench_traffic"), load)
    sender.wait_for_subscribers()
    time.sleep(BOTH_MATCHED_S)
    gc.collect()
    gc.freeze()
    print(json.dumps({"begins": True}), flush=True)
    sender.send(seconds)
    sender.wait_until_taken()
    print(json.dumps({"sent": sender.sent}), flush=True)
    sys.stdin.read()  # whoever asked for all this says when the publishers may go
    os._exit(0)


if __name__ == "__main__":
    main(Load(**json.loads(sys.argv[1])), float(sys.argv[2]))
