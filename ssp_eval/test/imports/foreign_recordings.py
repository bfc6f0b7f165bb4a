"""Recordings as other programs make them: plain ROS 2 bags, tables of states, videos.

The event is a cut-in on the shipped boulevard, worked out by hand.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.clock import NS_PER_S
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.event import RecordedEvent, find_event, instants_of
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.motion.state_series import Series
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.vocabulary import ObjectClass, Role
from ssp_eval.data.provenance import Provenance, read_provenance
from ssp_eval.recordings.event import rules_of
from ssp_eval.recordings.states import RecordedStates, clip_zero_ns, read_states
from ssp_scenario_manager.event_spec.load import load_event

TYPES = get_typestore(Stores.ROS2_JAZZY)
ODOMETRY = "nav_msgs/msg/Odometry"
JPEG = "sensor_msgs/msg/CompressedImage"
RAW = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseStamped"
FIX = "sensor_msgs/msg/NavSatFix"
TF = "tf2_msgs/msg/TFMessage"

HEADER = ("t_s", "id", "class", "x_m", "y_m", "yaw_rad", "speed_mps", "length_m", "width_m")

Message = tuple[str, str, int, Any]  # topic, type, time of receipt in ns, message


def stamp(ns: int) -> Any:
    return TYPES.types["builtin_interfaces/msg/Time"](sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


def header(ns: int, frame_id: str) -> Any:
    return TYPES.types["std_msgs/msg/Header"](stamp=stamp(ns), frame_id=frame_id)


def point(x: float, y: float, z: float = 0.0) -> Any:
    return TYPES.types["geometry_msgs/msg/Point"](x=x, y=y, z=z)


def vector(x: float, y: float, z: float = 0.0) -> Any:
    return TYPES.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def turned(yaw_rad: float) -> Any:
    half = yaw_rad / 2.0
    return TYPES.types["geometry_msgs/msg/Quaternion"](
        x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
    )


def pose(x: float, y: float, yaw_rad: float) -> Any:
    return TYPES.types["geometry_msgs/msg/Pose"](position=point(x, y), orientation=turned(yaw_rad))


def odometry(ns: int, state: ObjectState, frame_id: str = "map", child: str = "base_link") -> Any:
    """A state as nav_msgs/Odometry, speeds in the child frame (REP 105)."""
    t = TYPES.types
    twist = t["geometry_msgs/msg/Twist"](
        linear=vector(state.speed_mps, 0.0), angular=vector(0.0, 0.0, state.yaw_rate_radps)
    )
    return t[ODOMETRY](
        header=header(ns, frame_id),
        child_frame_id=child,
        pose=t["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(state.x_m, state.y_m, state.yaw_rad), covariance=np.zeros(36)
        ),
        twist=t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def picture(k: int, size: tuple[int, int] = (64, 48)) -> Any:
    """A frame that shows k in binary, as eight black or white columns."""
    columns = np.array([255 * (k >> bit & 1) for bit in range(8)], dtype=np.uint8)
    row = np.repeat(columns, size[0] // 8)
    return np.broadcast_to(row[None, :, None], (size[1], size[0], 3)).copy()


def number_of(image: Any) -> int:
    """k of a picture."""
    levels = image.reshape(image.shape[0], 8, -1).mean(axis=(0, 2))
    return sum(1 << bit for bit in range(8) if levels[bit] > 128)


def jpeg(ns: int, image: Any, frame_id: str = "camera_optical") -> Any:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].ravel()
    return TYPES.types[JPEG](
        header=header(ns, frame_id), format="rgb8; jpeg compressed bgr8", data=data
    )


def raw(ns: int, image: Any, frame_id: str = "camera_optical") -> Any:
    return TYPES.types[RAW](
        header=header(ns, frame_id),
        height=image.shape[0],
        width=image.shape[1],
        encoding="bgr8",
        is_bigendian=0,
        step=3 * image.shape[1],
        data=image.ravel(),
    )


def camera_info(ns: int, focal_px: float, size: tuple[int, int] = (64, 48)) -> Any:
    k = np.array([focal_px, 0, size[0] / 2, 0, focal_px, size[1] / 2, 0, 0, 1.0])
    p = np.array([*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0])
    roi = TYPES.types["sensor_msgs/msg/RegionOfInterest"](
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return TYPES.types[INFO](
        header=header(ns, "camera_optical"),
        height=size[1],
        width=size[0],
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=p,
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def transform(parent: str, child: str, xyz: Sequence[float], quaternion: Sequence[float]) -> Any:
    x, y, z, w = quaternion
    return TYPES.types["geometry_msgs/msg/TransformStamped"](
        header=header(0, parent),
        child_frame_id=child,
        transform=TYPES.types["geometry_msgs/msg/Transform"](
            translation=vector(*xyz),
            rotation=TYPES.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )


def write_bag(
    path: Path, messages: Sequence[Message], *, sqlite: bool = False, is_sorted: bool = True
) -> Path:
    """A bag directory with these messages, by time of receipt or as they come."""
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, received_ns, message in (
            sorted(messages, key=lambda m: m[2]) if is_sorted else messages
        ):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], received_ns, bytes(TYPES.serialize_cdr(message, kind)))
    return path


@dataclass(frozen=True)
class TrackDay:
    """A recording of VUT and object by a positioning system and a camera.

    Args:
        states: by object id, the stamps count from 0.
        zero_ns: of the recording's clock.
    """

    states: Mapping[str, Sequence[ObjectState]]
    zero_ns: int = 1_700_000_000 * NS_PER_S
    frame_step_ns: int = 100_000_000

    @property
    def frames_ns(self) -> range:
        last_ns = min(states[-1].stamp_ns for states in self.states.values())
        return range(0, last_ns + 1, self.frame_step_ns)

    def messages(
        self,
        make_image: Callable[..., Any] = jpeg,
        image_type: str = JPEG,
        delay_ns: int = 3_000_000,
    ) -> list[Message]:
        """Odometry on /<id>/odom and frames on /cam, received a little after their stamps."""
        found: list[Message] = []
        for name, states in self.states.items():
            for state in states:
                ns = self.zero_ns + state.stamp_ns
                found.append((f"/{name}/odom", ODOMETRY, ns + delay_ns, odometry(ns, state)))
        for k, at_ns in enumerate(self.frames_ns):
            ns = self.zero_ns + at_ns
            found.append(("/cam", image_type, ns + delay_ns, make_image(ns, picture(k))))
        return found


def write_table(path: Path, states: Mapping[str, Sequence[ObjectState]], every: int = 1) -> Path:
    """The states as a table of METHOD 4.3: geometric centres, times from 0."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEADER)
        for name, ones in states.items():
            for s in ones[::every]:
                x, y = s.pose.to_parent((s.size.front_m - s.size.rear_m) / 2.0, 0.0)
                writer.writerow(
                    [
                        s.stamp_ns / NS_PER_S,
                        name,
                        s.object_class.word,
                        x,
                        y,
                        s.yaw_rad,
                        s.speed_mps,
                        s.size.length_m,
                        s.size.width_m,
                    ]
                )
    return path


def write_frames(path: Path, images: Sequence[Any], fps: float = 10.0) -> Path:
    """A video of these pictures."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (64, 48))
    for image in images:
        writer.write(image)
    writer.release()
    return path


def write_video(path: Path, frames: int) -> Path:
    """A video whose frame k shows k, 10 a second."""
    return write_frames(path, [picture(k) for k in range(frames)])


CUT_IN = load_event("cut_in")[0]
STEP_NS = 20_000_000
SHIFT_S = (4.0, 6.5)
LANE_M = 3.5


def state(
    name: str, ns: int, x_m: float, y_m: float, yaw: float, v: float, role: Role
) -> ObjectState:
    """A car's state."""
    return ObjectState(
        name, ObjectClass.CAR, role, ns, x_m, y_m, yaw, v, 0.0, 0.0, DEFAULT_SIZES[ObjectClass.CAR]
    )


def cut_in(duration_s: float = 10.0) -> TrackDay:
    """VUT at 10 m/s in the right lane; 14 m ahead of it a car at 9 m/s comes from the left one."""
    vut, other = [], []
    for k in range(round(duration_s * 1e9) // STEP_NS + 1):
        ns = k * STEP_NS
        t = ns / 1e9
        u = min(1.0, max(0.0, (t - SHIFT_S[0]) / (SHIFT_S[1] - SHIFT_S[0])))
        y = LANE_M * (1.0 - u * u * (3.0 - 2.0 * u))
        left = -LANE_M * 6.0 * u * (1.0 - u) / (SHIFT_S[1] - SHIFT_S[0])
        vut.append(state("vut", ns, 20.0 + 10.0 * t, 0.0, 0.0, 10.0, Role.VUT))
        other.append(
            state(
                "ot1", ns, 38.0 + 9.0 * t, y, math.atan2(left, 9.0), math.hypot(left, 9.0), Role.OT
            )
        )
    return TrackDay({"vut": vut, "ot1": other})


def event_of(series: Series) -> RecordedEvent:
    """The cut-in that states show."""
    samples = instants_of(series, "vut", "ot1")
    path = Corridor.of([s.vut for s in samples]).path
    found = find_event(samples, path, rules_of(CUT_IN).thresholds)
    assert found is not None
    return found


def truth(day: TrackDay) -> RecordedEvent:
    """The event of the source itself."""
    return event_of(
        [
            (vut.stamp_ns / 1e9, {"vut": vut, "ot1": ot})
            for vut, ot in zip(day.states["vut"], day.states["ot1"], strict=True)
        ]
    )


def read(bag: Path) -> tuple[RecordedStates, Provenance]:
    """States and provenance of a recording, as audit, labels and evaluation read them."""
    with BagReader(bag) as reader:
        provenance = read_provenance(reader)
        frames_ns = sorted(peek_stamp_ns(m.data) for m in reader.messages([absolute(CAMERA_IMAGE)]))
        return read_states(reader, provenance, clip_zero_ns(provenance, frames_ns)), provenance


def imported(bag: Path) -> tuple[RecordedEvent, Provenance]:
    """The event that a recording shows, and its provenance."""
    states, provenance = read(bag)
    return event_of(states.series), provenance


def starts(event: RecordedEvent, zero_s: float = 0.0) -> tuple[float | None, ...]:
    """Starts of trigger, conflict and resolution on the source's clock."""
    times = (event.trigger_s, event.conflict_s, event.resolution_s)
    return tuple(None if t is None else t + zero_s for t in times)
