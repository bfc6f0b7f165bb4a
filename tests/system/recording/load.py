"""A load on a ROS graph whose messages can all be distinguished; started by tests.

``python load.py SPEC.json`` publishes what the specification says until its standard input is
closed, and writes one record per message that was handed to the middleware into a log. What a
message holds follows from topic and number alone, so that a reader of the log knows every byte.
"""

from __future__ import annotations

import hashlib
import json
import math
import select
import struct
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

NS_PER_S = 1_000_000_000
RECORD = struct.Struct("<IIqq")
# So long a busy reader may take for the last messages.
END_S = 30.0
# Between two looks at what is due, the fastest topic has 200 Hz, and at the subscriptions.
ROUND_S, LOOK_S = 0.004, 0.1
_ENCAPSULATION = b"\x00\x01\x00\x00"
IMAGE, TEXT = "sensor_msgs/msg/CompressedImage", "std_msgs/msg/String"


@dataclass(frozen=True)
class LoadTopic:
    """One topic of the load.

    Args:
        name: absolute.
        rate_hz: 0 for a topic on which one message is sent at the start.
        size_bytes: of the payload.
        msgtype: IMAGE or TEXT.
        reliable: or best effort.
        latched: transient local.
        depth: the publisher's history.
        first: number of the first message.
        count: messages to send, None for as long as the load runs.
        stamp_jumps_s: the k-th message is stamped with the load's time plus the k-th of these, in
            turn.
    """

    name: str
    rate_hz: float = 100.0
    size_bytes: int = 200
    msgtype: str = IMAGE
    reliable: bool = True
    latched: bool = False
    depth: int = 50
    first: int = 1
    count: int | None = None
    stamp_jumps_s: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Sent:
    """A message that the middleware took, with the steady time after that and its stamp."""

    topic: str
    number: int
    steady_ns: int
    stamp_ns: int


def payload(topic: str, number: int, size_bytes: int) -> bytes:
    """Make the content of a message: printable, so that every type can carry it."""
    word = hashlib.blake2b(f"{topic} {number}".encode(), digest_size=32).hexdigest()
    head = f"{number:010d} {word} ".encode()
    return (head + word.encode() * (size_bytes // len(word) + 1))[:size_bytes]


def encode(topic: LoadTopic, number: int, stamp_ns: int) -> bytes:
    """The message as CDR, little endian; a payload has at least its ten digits."""
    data = payload(topic.name, number, topic.size_bytes)
    if topic.msgtype == TEXT:
        return _ENCAPSULATION + struct.pack("<I", len(data) + 1) + data + b"\0"
    stamp = struct.pack("<iI", *divmod(stamp_ns, NS_PER_S))
    strings = b"\1\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0"  # empty frame and format, padded
    return _ENCAPSULATION + stamp + strings + struct.pack("<I", len(data)) + data


def read_log(path: Path, topics: tuple[LoadTopic, ...]) -> list[Sent]:
    """Read the messages sent so far; a record that is being written is left out."""
    data = path.read_bytes() if path.is_file() else b""
    whole = data[: len(data) - len(data) % RECORD.size]
    return [
        Sent(topics[index].name, number, steady_ns, stamp_ns)
        for index, number, steady_ns, stamp_ns in RECORD.iter_unpack(whole)
    ]


def sent_count(path: Path) -> int:
    """Return how many messages were sent so far."""
    return path.stat().st_size // RECORD.size if path.is_file() else 0


def heard_file(log: Path) -> Path:
    """The file that is there as soon as each of a load's publishers has a subscription."""
    return log.with_suffix(".heard")


def most_of(topic: LoadTopic) -> float:
    """Return how many messages of a topic are sent, inf for as many as the load has time for."""
    most = math.inf if topic.count is None else topic.count
    return most if topic.rate_hz > 0.0 else min(1, most)


def write_spec(path: Path, topics: tuple[LoadTopic, ...], log: Path) -> None:
    spec = {"log": str(log), "topics": [asdict(topic) for topic in topics]}
    path.write_text(json.dumps(spec))


def main(spec_file: str) -> None:
    import rclpy
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    from ssp_monitor.ros.conversions import message_class

    spec = json.loads(Path(spec_file).read_text())
    topics = [
        LoadTopic(**{**item, "stamp_jumps_s": tuple(item["stamp_jumps_s"])})
        for item in spec["topics"]
    ]
    rclpy.init()
    node = rclpy.create_node("load", start_parameter_services=False, enable_rosout=False)
    publishers = [
        node.create_publisher(
            message_class(topic.msgtype),
            topic.name,
            QoSProfile(
                depth=topic.depth,
                reliability=ReliabilityPolicy.RELIABLE
                if topic.reliable
                else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL
                if topic.latched
                else DurabilityPolicy.VOLATILE,
            ),
        )
        for topic in topics
    ]
    began_ns = time.monotonic_ns()
    sent = [0] * len(topics)
    is_heard, look_s = False, 0.0
    left = list(enumerate(topics))
    with open(spec["log"], "ab", buffering=0) as log:
        print("load: started", flush=True)
        while not select.select([sys.stdin], [], [], ROUND_S)[0]:
            run_s = (time.monotonic_ns() - began_ns) / NS_PER_S
            if not is_heard and run_s >= look_s:
                look_s = run_s + LOOK_S
                is_heard = all(one.get_subscription_count() for one in publishers)
                if is_heard:
                    heard_file(Path(spec["log"])).touch()
            for index, topic in left:
                due = 1 + int(run_s * topic.rate_hz)
                if topic.count is not None:
                    due = min(due, topic.count)
                while sent[index] < due:
                    number = topic.first + sent[index]
                    jump_s = topic.stamp_jumps_s[sent[index] % len(topic.stamp_jumps_s)]
                    stamp_ns = time.time_ns() + int(jump_s * NS_PER_S)
                    publishers[index].publish(encode(topic, number, stamp_ns))
                    sent[index] += 1
                    log.write(RECORD.pack(index, number, time.monotonic_ns(), stamp_ns))
            left = [(index, topic) for index, topic in left if sent[index] < most_of(topic)]
    # Of readers that were killed none is waited for longer than of a busy one.
    end_s = time.monotonic() + END_S
    for publisher, topic in zip(publishers, topics, strict=True):
        if topic.reliable:
            left_s = max(0.0, end_s - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_s))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
