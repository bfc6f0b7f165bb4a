"""Messages made without ROS, as they stand serialised in bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import serialize, typestore
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.clock import NS_PER_S

STRING = "std_msgs/msg/String"
CLOCK = "rosgraph_msgs/msg/Clock"


def message(msgtype: str, **fields: Any) -> Any:
    """A message of the typestore."""
    return typestore().types[msgtype](**fields)


def stamp(stamp_ns: int) -> Any:
    """A Time."""
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def header(stamp_ns: int, frame_id: str = "map") -> Any:
    """A Header."""
    return message("std_msgs/msg/Header", stamp=stamp(stamp_ns), frame_id=frame_id)


def messages(bag: Path, topic: str) -> list[Any]:
    """The messages of a topic, decoded by rosbags; none where the bag lacks it."""
    with AnyReader([bag]) as reader:
        chosen = [c for c in reader.connections if c.topic == topic]
        # An empty list of connections would mean all of them.
        found = reader.messages(connections=chosen) if chosen else ()
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in found]


def last_speeds(bag: Path) -> dict[str, float]:
    """Speed of the VUT and of each target in the last recorded ground truth, m/s."""
    last = messages(bag, "/ssp/world/tick")[-1]
    return {o.object_id: o.speed for o in last.objects if o.role in (1, 2)}


def without_index(bag: Path, target: Path) -> Path:
    """A bag of one file as rosbag2 writes it with ``fastwrite``: no chunks, so no index."""
    target.mkdir()
    (target / "metadata.yaml").write_bytes((bag / "metadata.yaml").read_bytes())
    with BagReader(bag) as reader, (target / reader.files[0].name).open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        channels = {}
        for topic, info in reader.topics.items():
            written = reader.definition(topic)
            schema = writer.register_schema(info.msgtype, written.encoding, written.text.encode())
            qos = {"offered_qos_profiles": info.offered_qos}
            channels[topic] = writer.register_channel(topic, "cdr", schema, qos)
        for m in reader.messages():
            writer.add_message(
                channels[m.topic], m.log_time_ns, m.data, m.publish_time_ns, m.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    return target


def text(value: str) -> bytes:
    """A serialised String."""
    return serialize(message(STRING, data=value))


def clock(stamp_ns: int) -> bytes:
    """A serialised /clock."""
    return serialize(message(CLOCK, clock=stamp(stamp_ns)))


def picture(data: bytes, stamp_ns: int, frame_id: str = "camera", form: str = "jpeg") -> bytes:
    """A serialised CompressedImage."""
    pixels = np.frombuffer(data, np.uint8)
    head = header(stamp_ns, frame_id)
    return serialize(message(COMPRESSED_TYPE, header=head, format=form, data=pixels))
