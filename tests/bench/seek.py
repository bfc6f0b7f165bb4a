"""Nine label times in a bag of ten minutes: what reading takes beside decoding the frames."""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from measure import report

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, serialize, typestore
from ssp_core.bag.writing.writer import BagWriter

IMAGE, IMAGE_TYPE = "/ssp/vut/front_camera/image/compressed", "sensor_msgs/msg/CompressedImage"
STATE_TYPE = "ssp_msgs/msg/ObjectState"
SECONDS, FRAME_HZ, STATE_HZ, OBJECTS = 600, 10, 50, 20
FLUSH_NS = 500_000_000  # as the recorder
LABEL_S = tuple(30.0 + 65.0 * k for k in range(9))
HISTORY_S = 2.0  # before each label, as a request for a clip has it
ROUNDS = 5


def jpegs(number: int) -> list[np.ndarray]:
    """Frames of 1280x720 that compress as badly as road surfaces do."""
    rng = np.random.default_rng(1)
    base = cv2.GaussianBlur(rng.integers(0, 256, (720, 1280, 3), dtype=np.uint8), (15, 15), 0)
    found = []
    for k in range(number):
        ok, jpeg = cv2.imencode(".jpg", np.roll(base, 13 * k, axis=1))
        if not ok:
            raise RuntimeError("OpenCV did not encode a frame")
        found.append(jpeg.ravel())
    return found


def payloads() -> tuple[list[bytes], bytes]:
    """A few messages of frames and one of a state; a reader takes no notice of their repeating."""
    types = typestore().types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id="map"
    )
    image = types[IMAGE_TYPE]
    frames = [serialize(image(header=header, format="jpeg", data=jpeg)) for jpeg in jpegs(10)]
    state = types[STATE_TYPE]
    numbers = {name: 0 for name, _ in typestore().fielddefs[STATE_TYPE][1]}
    fields = {"header": header, "object_id": "ot1", "reference_id": "ot1-1"}
    return frames, serialize(state(**(numbers | fields)))


def make_bag(path: Path) -> int:
    """Frames of one camera and states of twenty objects; returns the bytes of a frame."""
    frames, state = payloads()
    with BagWriter(path) as writer:
        writer.add_topic(IMAGE, IMAGE_TYPE, offered_qos(20))
        topics = [f"/ssp/ot{k}/state" for k in range(OBJECTS)]
        for topic in topics:
            writer.add_topic(topic, STATE_TYPE, offered_qos(50))
        flush_ns = FLUSH_NS
        for step in range(SECONDS * STATE_HZ):
            now_ns = step * 1_000_000_000 // STATE_HZ
            for topic in topics:
                writer.write(topic, state, now_ns, now_ns, step)
            if step % (STATE_HZ // FRAME_HZ) == 0:
                frame = frames[step // (STATE_HZ // FRAME_HZ) % len(frames)]
                writer.write(IMAGE, frame, now_ns, now_ns, step)
            if now_ns >= flush_ns:
                writer.flush()
                flush_ns += FLUSH_NS
    return len(frames[0])


def wanted(path: Path) -> tuple[list[BagMessage], list[np.ndarray]]:
    """Opens the bag and reads, of each label's history, the frames and nothing else."""
    messages, data = [], []
    with BagReader(path) as reader:
        for label_s in LABEL_S:
            end_ns = int(label_s * 1e9) + 1
            start_ns = end_ns - int(HISTORY_S * 1e9)
            for message in reader.messages([IMAGE], start_ns, end_ns):
                messages.append(message)
                data.append(reader.decode(message).data)
    return messages, data


def decoded(data: list[np.ndarray]) -> None:
    for jpeg in data:
        if cv2.imdecode(jpeg, cv2.IMREAD_COLOR) is None:
            raise RuntimeError("a frame did not decode")


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        frame_bytes = make_bag(path)
        size = sum(file.stat().st_size for file in path.iterdir())
        before_mb = peak_mb()
        with BagReader(path) as reader:
            started = time.perf_counter()
            count = sum(1 for _ in reader.messages())
            whole_s = time.perf_counter() - started
        grown_mb = peak_mb() - before_mb
        reading_s, decoding_s = [], []
        for _ in range(ROUNDS):
            started = time.perf_counter()
            messages, data = wanted(path)
            read = time.perf_counter()
            decoded(data)
            reading_s.append(read - started)
            decoding_s.append(time.perf_counter() - read)
        expected = len(LABEL_S) * int(HISTORY_S * FRAME_HZ)
        if len(messages) != expected:
            raise RuntimeError(f"{len(messages)} frames were read instead of {expected}")
    note = (
        f"{SECONDS} s bag of {size / 1e6:.0f} MB, {len(LABEL_S)} labels, {expected} frames of "
        f"{frame_bytes / 1e3:.0f} kB, best of {ROUNDS}; the bound is decoding them"
    )
    report(
        "seek: open and read for nine labels",
        min(reading_s),
        min(decoding_s),
        "s",
        note,
        lower=True,
        ratio_limit=0.5,
    )
    report(
        "seek: every message of the bag",
        whole_s / count * 1e6,
        None,
        "us a message",
        f"{count} messages, read raw by index",
        lower=True,
    )
    report(
        "seek: memory that reading every message adds",
        grown_mb,
        None,
        "MB",
        "peak beyond that of writing the bag",
        lower=True,
        limit=64.0,
    )


if __name__ == "__main__":
    main()
