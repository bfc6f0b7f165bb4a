"""Bags that other programs recorded: poses from their topics and types."""

from __future__ import annotations

import math
import sqlite3
from array import array
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ssp_core.bag.metadata import FILE_NAME, ROOT_KEY, unlisted_files
from ssp_core.bag.reading.mcap_file import DAMAGE
from ssp_core.bag.reading.reader import BagReader, files_sha256, mcap_files
from ssp_core.bag.reading.sqlite import SUFFIX, open_bag
from ssp_core.bag.seals.seal import Seal, check_unaltered, read_seal
from ssp_core.bag.types import TypeDefinition, store_from
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.closing import Closing
from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping
from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import yaw_of
from ssp_eval.importers.clocks import Clock, Times
from ssp_eval.importers.findings import Findings
from ssp_eval.importers.tracks import Samples, Source

Number = TypeVar("Number", np.int64, np.float64)
_NS = NDArray[np.int64]

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
FIX = "sensor_msgs/msg/NavSatFix"
POSE_TYPES = (ODOMETRY, POSE, POSE_COVARIANCE, FIX)
TF_STATIC = "/tf_static"
# Geodetic positions name the antenna as their frame; what they are in is the datum's.
DATUM_FRAME = "datum"
# Farther from the datum, lengths in its plane shrink by more than 3e-5, their share d²/2R².
_FARTHEST_M = 50_000.0
_FAILURES = (ReaderError, SerdeError, sqlite3.Error, OSError, RuntimeError, *DAMAGE)
_REPAIRABLE = "a damaged MCAP file is mended by `ssp bag recover`"


class _Storage(Protocol):
    """Reading interface of a bag in any storage; several readings may go on side by side."""

    types: dict[str, str]
    files: tuple[Path, ...]

    def raw(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of receipt in ns and serialised message, in the order of receipt."""
        ...

    def store(self, topic: str) -> Typestore:
        """Give the types of a topic; raises InputError where they can't be read."""
        ...

    def seal(self) -> Seal:
        """Say how the bag's seal stands to what is in it."""
        ...


class _Plain:
    """MCAP files with or without chunks and index, or SQLite files."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        is_open = not (path / FILE_NAME).is_file() and any(path.glob("*.mcap"))
        reader = BagReader(path, mcap_files(path)) if is_open else open_bag(path)
        self._reader = stack.enter_context(reader)
        self.types = {topic: info.msgtype for topic, info in self._reader.topics.items()}
        self.files = self._reader.stored

    def raw(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        for message in self._reader.messages(list(topics)):
            yield message.topic, message.log_time_ns, message.data

    def store(self, topic: str) -> Typestore:
        return self._reader.store(topic)

    def seal(self) -> Seal:
        return read_seal(self._reader)


_FORMATS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


class _Compressed:
    """A bag whose files or messages rosbag2 compressed."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self._path = path
        self._reader = stack.enter_context(Reader(path))
        self.types = {c.topic: c.msgtype for c in self._reader.connections}
        names = read_mapping(path / FILE_NAME)[ROOT_KEY]["relative_file_paths"]
        self.files = tuple(path / PurePosixPath(name).name for name in names)

    def raw(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        for connection, received_ns, data in (
            self._reader.messages(connections) if connections else ()
        ):
            yield connection.topic, received_ns, bytes(data)

    def store(self, topic: str) -> Typestore:
        for one in self._reader.connections:
            if one.topic == topic:
                definition = one.msgdef
                encoding = _FORMATS.get(definition.format, "ros2msg")
                try:
                    return store_from(TypeDefinition(one.msgtype, encoding, definition.data))
                except InputError as error:
                    raise error.in_file(self._path) from None
        raise KeyError(topic)

    def seal(self) -> Seal:
        return Seal()


def _is_compressed(path: Path) -> bool:
    """Return True for a folder whose metadata names files or messages that rosbag2 compressed."""
    if not (path / FILE_NAME).is_file():
        return False
    stated = read_mapping(path / FILE_NAME).get(ROOT_KEY)
    mode = stated.get("compression_mode") if isinstance(stated, dict) else None
    return str(mode or "none").lower() in ("file", "message")


class SourceBag(Closing):
    """A bag directory, a .mcap or a .db3 file of any program, open; a context manager.

    Only what is asked for has to be readable.

    Raises:
        InputError: it isn't there, is no ROS 2 bag, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if path.suffix == ".bag":
            raise InputError(
                "is a bag of ROS 1", file=path, remedy="convert it with rosbags-convert"
            )
        if not path.exists():
            raise InputError("is not there", file=path, remedy="name a bag directory or file")
        self._stack = ExitStack()
        self._storage: _Storage
        with self._failures():
            kind = _Compressed if _is_compressed(path) else _Plain
            self._storage = kind(path, self._stack)
        self.types = self._storage.types

    @contextmanager
    def _failures(self, topic: str | None = None) -> Iterator[None]:
        try:
            yield
        except InputError:
            raise
        except _FAILURES as error:
            raise InputError(
                f"can't be read as a ROS 2 bag: {error}",
                file=self.path,
                field=topic,
                remedy=_REPAIRABLE,
            ) from error

    def file_notes(self) -> list[str]:
        """Say which files were left out, or that nothing names those that were read."""
        if not self.path.is_dir():
            return []
        if not (self.path / FILE_NAME).is_file():
            return [f"there is no {FILE_NAME}: what the folder's files hold was read"]
        return [f"{name} isn't named by {FILE_NAME} and was left out" for name in self._left_out()]

    def _left_out(self) -> list[str]:
        """Name the files of a folder that its metadata.yaml doesn't name."""
        if not (self.path / FILE_NAME).is_file():
            return []
        kinds = (".mcap", SUFFIX)
        return [name for kind in kinds for name in unlisted_files(self.path, kind)]

    def unread(self, topics: Collection[str]) -> list[str]:
        """Say which topics beside these couldn't be read."""
        notes = []
        for topic in sorted(set(self.types).difference(topics)):
            try:
                self._storage.store(topic)
            except InputError as error:
                notes.append(f"{topic}: can't be read and isn't needed: it {error.problem}")
        return notes

    def check_topic(self, topic: str, types: tuple[str, ...]) -> str:
        """Return a topic's type; raise InputError where it is missing or of another type."""
        topic_type = self.types.get(topic)
        if topic_type is None:
            like = [name for name, kind in self.types.items() if kind in types]
            remedy = f"of these types it has {', '.join(like) or 'none'}"
            if left_out := self._left_out():
                remedy += f"; {', '.join(left_out)} isn't named by {FILE_NAME} and was left out"
            raise InputError("is no topic of this bag", file=self.path, field=topic, remedy=remedy)
        if topic_type not in types:
            raise InputError(
                "has messages of another type",
                file=self.path,
                field=topic,
                value=topic_type,
                remedy=f"{', '.join(types)} are read",
            )
        return topic_type

    def check_definition(self, topic: str) -> None:
        """Raise InputError where the type of a topic can't be read."""
        self._storage.store(topic)

    def raw(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Yield time of receipt in ns and serialised message, in the order of receipt."""
        for _, received_ns, data in self.raw_of([topic]):
            yield received_ns, data

    def raw_of(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of receipt in ns and serialised message, in the order of receipt."""
        with self._failures(", ".join(topics)):
            yield from self._storage.raw(topics)

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield time of receipt in ns and message, in the order of receipt.

        Raises:
            InputError: the topic's type can't be read, or a message is none of it.
        """
        for received_ns, data in self.raw(topic):
            yield received_ns, self.decode(topic, received_ns, data)

    def decode(self, topic: str, received_ns: int, data: bytes) -> Any:
        """Decode a message of a topic.

        Raises:
            InputError: the topic's type can't be read, or the message is none of it.
        """
        store, kind = self._storage.store(topic), self.types[topic]
        try:
            return store.deserialize_cdr(data, kind)
        except (SerdeError, *DAMAGE) as error:
            raise InputError(
                f"holds a message at {received_ns} ns that is no {kind}: {error}",
                file=self.path,
                field=topic,
                remedy="leave the topic out, or record the bag again",
            ) from error

    def valid_at(self, topic: str, at_ns: int) -> Any:
        """Give the newest message that was received by a time, else the first one; None: none."""
        newest = None
        for received_ns, data in self.raw(topic):
            if newest is not None and received_ns > at_ns:
                break
            newest = data
        return None if newest is None else self.decode(topic, at_ns, newest)

    def stamp_ns(self, topic: str, received_ns: int, data: bytes) -> int:
        """Read the stamp of a message that begins with a header.

        Raises:
            InputError: it has none that is valid.
        """
        header_ns = leading_stamp_ns(data)
        if header_ns is None:
            raise InputError(
                f"holds a message at {received_ns} ns without a valid stamp",
                file=self.path,
                field=topic,
                remedy="leave the topic out, or record it with stamps",
            )
        return header_ns

    def times(self, topic: str) -> Times:
        """Return stamps and times of receipt, nothing decoded."""
        pairs = array("q")
        for received_ns, data in self.raw(topic):
            pairs.extend((self.stamp_ns(topic, received_ns, data), received_ns))
        if not pairs:
            raise InputError(
                "holds no message", file=self.path, field=topic, remedy="name a topic with messages"
            )
        return Times(topic, *_columns(pairs, 2, np.int64))

    def sha256(self) -> str:
        """Hash of the file that is read; of several, that of the list of their hashes."""
        return files_sha256(self._storage.files)

    def seal(self) -> Seal:
        """Hold the bag's seal against its content.

        Raises:
            InputError: it, or a bag of which it was made, isn't what was sealed.
        """
        seal = self._storage.seal()
        check_unaltered(seal, self.path)
        return seal

    def close(self) -> None:
        self._stack.close()


@dataclass(frozen=True)
class Span:
    """The crop of an import: what lies outside isn't judged.

    Args:
        zero_ns: the camera's first frame, on the clock of the import.
        stamps_ns: of the crop, on that clock.
        received_ns: when the first and the last frame in it were received; None: no frame is.
    """

    clock: Clock
    zero_ns: int
    stamps_ns: tuple[int, int]
    received_ns: tuple[int, int] | None

    def holds(self, stamp_ns: int, received_ns: int) -> bool:
        """Tell whether a message belongs to the crop, by its time or by its receipt."""
        time_ns = stamp_ns if self.clock == "header" else received_ns
        if self.stamps_ns[0] <= time_ns <= self.stamps_ns[1]:
            return True
        of_frames = self.received_ns
        return of_frames is not None and of_frames[0] <= received_ns <= of_frames[1]

    def within(self, times: Times) -> Times:
        """Return the times of the messages that belong to the crop."""
        pairs = zip(times.stamps_ns, times.received_ns, strict=True)
        inside = np.fromiter((self.holds(*pair) for pair in pairs), bool, len(times.stamps_ns))
        return Times(times.topic, times.stamps_ns[inside], times.received_ns[inside])


@dataclass(frozen=True)
class Poses:
    """The poses of one topic.

    Args:
        samples: in the crop.
        times: of the samples.
        reach_ns: time of the first and the last message, in the crop or not.
        child_frame_id: that they are of, and that speeds are in; empty: not said.
    """

    samples: Samples
    times: Times
    reach_ns: tuple[int, int]
    frame_id: str
    child_frame_id: str
    notes: tuple[str, ...]


def read_poses(
    bag: SourceBag, topics: Collection[str], span: Span, datum: Datum | None, findings: Findings
) -> dict[str, Poses]:
    """Read the poses that topics hold in a crop, along the axes of the source (see with_axes).

    The bag is gone through once. Geodetic positions without a datum, none in the crop, frames that
    change, and an orientation that is none are found in each topic by itself.

    Returns:
        Poses by topic.
    """
    readings: dict[str, _PoseReading] = {}
    for topic in topics:
        with findings.noted("poses"):
            readings[topic] = _PoseReading(bag, topic, span, datum)
    with findings.noted("poses"):
        for topic, received_ns, data in bag.raw_of(list(readings)):
            if topic in readings:
                with findings.noted("poses") as part:
                    readings[topic].take(received_ns, data)
                if part.has_ended:
                    del readings[topic]
    poses_by_topic: dict[str, Poses] = {}
    for topic, reading in readings.items():
        with findings.noted("poses"):
            poses_by_topic[topic] = reading.poses()
    return poses_by_topic


class _PoseReading:
    """The poses of one topic, as they are read."""

    def __init__(self, bag: SourceBag, topic: str, span: Span, datum: Datum | None) -> None:
        self._bag, self._topic, self._span, self._datum = bag, topic, span, datum
        self._kind = bag.types[topic]
        if self._kind == FIX and datum is None:
            raise InputError(
                "holds geodetic positions",
                file=bag.path,
                field=topic,
                value=self._kind,
                remedy="give the origin of the map's frame with --datum LAT,LON[,ALT]",
            )
        self._times, self._outside_ns, self._rows = array("q"), array("q"), array("d")
        self._frames: set[tuple[str, str]] = set()
        self._count = 0

    def take(self, received_ns: int, data: bytes) -> None:
        """Take the next message; one outside of the crop isn't decoded."""
        self._count += 1
        stamp = self._bag.stamp_ns(self._topic, received_ns, data)
        at_ns = stamp if self._span.clock == "header" else received_ns
        if not self._span.holds(stamp, received_ns):
            self._outside_ns.append(at_ns)
            return
        message = self._bag.decode(self._topic, received_ns, data)
        self._times.extend((stamp, received_ns))
        child = str(getattr(message, "child_frame_id", ""))
        self._frames.add((str(message.header.frame_id), child))
        try:
            self._rows.extend(_READERS[self._kind](message))
        except ValueError as error:
            after_s = ns_to_seconds(at_ns - self._span.zero_ns)
            raise InputError(
                f"message {self._count}: {error}, {after_s:.3f} s after the first frame",
                file=self._bag.path,
                field=self._topic,
                remedy="leave the span out with --start and --end, or name another topic",
            ) from error

    def poses(self) -> Poses:
        """Give what was read.

        Raises:
            InputError: nothing in the crop, or frames that change.
        """
        self._check_some()
        frame_id, child = self._frames.pop()
        base = Times(self._topic, *_columns(self._times, 2, np.int64))
        names = _COLUMNS[self._kind]
        values = _columns(self._rows, len(names), np.float64)
        columns = dict(zip(names, values, strict=True))
        notes = []
        if self._kind == FIX and self._datum is not None:
            columns["x_m"], columns["y_m"], up_m = self._datum.all_to_site(
                columns.pop("latitude"),
                columns.pop("longitude"),
                np.nan_to_num(columns.pop("altitude")),
            )
            apart_m = np.linalg.norm([columns["x_m"], columns["y_m"], up_m], axis=0)
            if (apart_m > _FARTHEST_M).any():
                raise InputError(
                    f"lies up to {np.nanmax(apart_m) / 1000.0:.0f} km from the datum, more than "
                    f"{_FARTHEST_M / 1000.0:.0f} km",
                    file=self._bag.path,
                    field=self._topic,
                    remedy="give the datum of this site with --datum LAT,LON[,ALT]",
                )
            frame_id, child = DATUM_FRAME, frame_id
            notes.append(f"{self._topic}: geodetic, in the frame of the datum")
        on_clock = base.on(self._span.clock)
        samples = Samples(on_clock, columns, Source(self._bag.path, self._topic))
        ends_ns = [int(on_clock.min()), int(on_clock.max())]
        if self._outside_ns:
            ends_ns += [min(self._outside_ns), max(self._outside_ns)]
        return Poses(samples, base, (min(ends_ns), max(ends_ns)), frame_id, child, tuple(notes))

    def _check_some(self) -> None:
        path, topic = self._bag.path, self._topic
        if not self._count:
            raise InputError(
                "holds no message", file=path, field=topic, remedy="name a topic with messages"
            )
        if not self._times:
            outside_ns, zero_ns = self._outside_ns, self._span.zero_ns
            first_s, last_s = (ns_to_seconds(f(outside_ns) - zero_ns) for f in (min, max))
            raise InputError(
                f"has poses from {first_s:.3f} to {last_s:.3f} s after the first frame, none "
                "within the clip",
                file=path,
                field=topic,
                remedy="frames and poses must be of one time; check the clocks, or use --clock "
                "receive",
            )
        if len(self._frames) > 1:
            frame_pairs = ", ".join(
                sorted(f"{a or '(none)'} of {b or '(none)'}" for a, b in self._frames)[:4]
            )
            raise InputError(
                f"changes its frames: {frame_pairs}",
                file=path,
                field=topic,
                remedy="one topic must be one object in one frame",
            )


def _columns(rows: array[Any], count: int, kind: type[Number]) -> list[NDArray[Number]]:
    """Return rows that stand one behind the other, as arrays of their columns."""
    return [np.array(column) for column in np.frombuffer(rows, kind).reshape(-1, count).T]


def _pose(pose: Any) -> tuple[float, float, float]:
    q = pose.orientation
    return float(pose.position.x), float(pose.position.y), yaw_of((q.x, q.y, q.z, q.w))


def _odometry(message: Any) -> tuple[float, ...]:
    twist = message.twist.twist
    speeds = (float(twist.linear.x), float(twist.linear.y), float(twist.angular.z))
    return (*_pose(message.pose.pose), *speeds)


def _fix(message: Any) -> tuple[float, ...]:
    if message.status.status < 0:
        raise ValueError("it is without a fix")
    place = Place(float(message.latitude), float(message.longitude), float(message.altitude))
    has_number = not (math.isnan(place.latitude_deg) or math.isnan(place.longitude_deg))
    if has_number and place.problem is not None:
        raise ValueError(f"its {place.problem}")
    return place.latitude_deg, place.longitude_deg, place.altitude_m


_READERS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    ODOMETRY: _odometry,
    POSE: lambda message: _pose(message.pose),
    POSE_COVARIANCE: lambda message: _pose(message.pose.pose),
    FIX: _fix,
}
_POSE_COLUMNS = ("x_m", "y_m", "yaw_rad")
_COLUMNS = {
    ODOMETRY: (*_POSE_COLUMNS, "speed_mps", "left_mps", "yaw_rate_radps"),
    POSE: _POSE_COLUMNS,
    POSE_COVARIANCE: _POSE_COLUMNS,
    FIX: ("latitude", "longitude", "altitude"),
}
