"""Conversion of others' ROS 2 bags, with their camera, into auditable recordings (METHOD 4.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.pictures.stamps import LEAP_S, settle_stamps
from ssp_core.bag.seals.seal import sources_with
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE, RAW_TYPE
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.geodesy import Datum
from ssp_core.names import VUT_ID
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import Mounting
from ssp_core.world.camera_messages import INFO_TYPE, encode_frame
from ssp_eval.importers.axes import Axes, unstated_axes, with_axes
from ssp_eval.importers.camera import CameraSource
from ssp_eval.importers.clocks import Clock, Times, check_clocks
from ssp_eval.importers.findings import Finding, Findings
from ssp_eval.importers.frames import FrameIntake, speeds_of
from ssp_eval.importers.options import ALL, ImportOptions
from ssp_eval.importers.ros_bag import (
    POSE_TYPES,
    TF_STATIC,
    Poses,
    SourceBag,
    Span,
    read_poses,
)
from ssp_eval.importers.target import (
    IMAGE,
    CameraFacts,
    ImportSummary,
    attach_record,
    check_free,
    make_bag,
    measured_motion,
    thin,
    write_states,
)
from ssp_eval.importers.tracks import Track, make_track
from ssp_eval.recordings.states import STATE_AGE_S

TF_TYPE = "tf2_msgs/msg/TFMessage"
IMAGES = (COMPRESSED_TYPE, RAW_TYPE)
# A camera of which more stamps leap than this share has no clock to go by.
MOST_LEAPS = 0.01
# Frames this long before the first pose of the VUT, or after its last one, are kept.
_BESIDE_NS = 100_000_000
_NS = NDArray[np.int64]


@dataclass(frozen=True)
class BagOptions:
    """One import.

    Args:
        objects: topic and class by id in the recording, the VUT first.
        camera_info: topic, None: none.
        mounting: declared place of the camera from the VUT's reference point, None: that of
            /tf_static, where there is one.
        datum: origin of the map's frame for geodetic positions, None: there are none.
        axes: of the poses, by id, where a person states them.
        twist_in_parent: whether twists are along the axes of the poses' frame, by id, where a
            person states it.
    """

    bag: Path
    clip: ImportOptions
    objects: Mapping[str, tuple[str, ObjectClass]]
    camera: str
    camera_info: str | None
    mounting: Mounting | None
    clock: Clock
    datum: Datum | None
    axes: Mapping[str, Axes] = field(default_factory=dict)
    twist_in_parent: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True)
class _Clip:
    """The frames of the camera's topic that are kept.

    Args:
        inside: places of the clip's frames among the topic's messages.
        stamps_ns: stamps of those that are kept, by their places.
        crop_s: from and to, from the topic's first frame on.
    """

    inside: NDArray[np.int64]
    stamps_ns: Mapping[int, int]
    keep_every: int
    rate_hz: float
    crop_s: tuple[float, float]
    notes: tuple[str, ...]

    @property
    def first_ns(self) -> int:
        return min(self.stamps_ns.values())

    @property
    def last_ns(self) -> int:
        return max(self.stamps_ns.values())


def import_bag(
    options: BagOptions, started: Callable[[int], None], advance: Callable[[int], None]
) -> ImportSummary:
    """Make the recording.

    Args:
        options: of the command.
        started: called once with the number of frames that will be written.
        advance: called with the number of frames written since the last call.

    Raises:
        InputError: bag, topics, clocks, frames or poses can't be used; nothing is left behind.
    """
    check_free(options.clip.out)
    ids = tuple(options.objects)
    options.clip.check_ids(ids)
    findings = Findings(options.clip.accepted)
    with findings.listed(options.bag), SourceBag(options.bag) as bag:
        for topic, types in _topic_types(options):
            with findings.noted("topics"):
                bag.check_topic(topic, types)
                if types is not IMAGES:  # whose layout is known
                    bag.check_definition(topic)
        findings.need()
        with findings.noted("crop"):
            recorded = bag.times(options.camera)
            frame_times, leapt = _settled(options, recorded)
            span = _span(options, frame_times)
        findings.need()
        of_topics = read_poses(
            bag,
            dict.fromkeys(topic for topic, _ in options.objects.values()),
            span,
            options.datum,
            findings,
        )
        findings.need()
        poses = {name: of_topics[topic] for name, (topic, _) in options.objects.items()}
        for finding in unstated_axes(options.bag, poses, options.axes):
            findings.add(finding)
        poses = {
            name: with_axes(one, options.axes.get(name), options.twist_in_parent.get(name))
            for name, one in poses.items()
        }
        notes = list[str]()
        times = [*(p.times for p in poses.values()), span.within(frame_times)]
        notes += check_clocks(options.bag, options.clock, times, findings)
        for error in _frame_errors(options, poses):
            findings.note("frames", error)
        findings.need()
        with findings.noted("crop"):
            clip = _clip(options, frame_times.on(options.clock), poses[VUT_ID], span)
        findings.need()
        notes += _leaps(options, clip, leapt, frame_times.on(options.clock), findings)
        tracks = list[Track]()
        for name in ids:
            with findings.noted("states"):
                tracks.append(_track(options, name, poses[name], clip, findings))
        findings.need()
        for pose, track in zip(poses.values(), tracks, strict=True):
            notes += [*pose.notes, *_assumptions(options, pose, track), *track.notes]
            notes += _coverage(track, clip)
        notes += bag.file_notes()
        notes += bag.unread(_import_topics(options))
        camera = _camera_source(options, bag, clip, frame_times, poses[VUT_ID], tracks[0])
        started(len(clip.stamps_ns))
        return make_bag(
            options.clip.out,
            lambda writer: _write(
                writer,
                options,
                _Camera(bag, options, recorded, leapt),
                camera,
                tracks,
                clip,
                notes,
                findings,
                advance,
            ),
        )


def _topic_types(options: BagOptions) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the topics that a person asked for, each with the types that it may have."""
    for topic in dict.fromkeys(topic for topic, _ in options.objects.values()):
        yield topic, POSE_TYPES
    yield options.camera, IMAGES
    if options.camera_info is not None:
        yield options.camera_info, (INFO_TYPE,)


def _import_topics(options: BagOptions) -> set[str]:
    """Give the topics that a person asked for, and those that say where the camera is."""
    topics = {topic for topic, _ in options.objects.values()} | {options.camera, TF_STATIC}
    return topics if options.camera_info is None else topics | {options.camera_info}


def _camera_source(
    options: BagOptions, bag: SourceBag, clip: _Clip, frame_times: Times, vut: Poses, track: Track
) -> CameraSource:
    """Gather what is said of the camera up to the clip's end."""
    info, static = None, list[Any]()
    if options.camera_info is not None:
        info = bag.valid_at(options.camera_info, int(frame_times.received_ns[min(clip.stamps_ns)]))
        if options.mounting is None and bag.types.get(TF_STATIC) == TF_TYPE:
            last_ns = int(frame_times.received_ns[max(clip.stamps_ns)])
            for received_ns, message in bag.decoded(TF_STATIC):
                if received_ns <= last_ns:
                    static += message.transforms
    return CameraSource(
        options.bag,
        options.camera_info,
        info,
        options.mounting,
        static,
        vut.child_frame_id,
        track.body.ahead_m,
        options.axes.get(VUT_ID, Axes()).body == "frd",
    )


def _frame_errors(options: BagOptions, poses: Mapping[str, Poses]) -> Iterator[InputError]:
    """Yield each object whose poses in one frame are taken for poses in another."""
    plain = {
        name: pose.frame_id
        for name, pose in poses.items()
        if name not in options.clip.motion.transforms
    }
    frames = sorted(set(plain.values()))
    for odd, frame in plain.items():
        if frame != plain.get(VUT_ID, frames[0]):
            yield InputError(
                f"its poses are in frame {frame or '(none)'!r}, the others' in "
                f"{', '.join(repr(f) for f in frames if f != frame)}",
                file=options.bag,
                field=options.objects[odd][0],
                remedy=f"say how its frame lies in theirs with --transform {odd}=X,Y,YAW_DEG "
                "(0,0,0 where they are the same)",
            )


def _settled(options: BagOptions, frame_times: Times) -> tuple[Times, NDArray[np.bool_]]:
    """Return the frames' times, and which are times of receipt since their stamps leap."""
    if options.clock == "receive":
        return frame_times, np.zeros(len(frame_times.stamps_ns), dtype=bool)
    settled = settle_stamps(frame_times.stamps_ns, frame_times.received_ns)
    return replace(frame_times, stamps_ns=settled.times_ns), settled.leapt


def _leaps(
    options: BagOptions, clip: _Clip, leapt: NDArray[np.bool_], stamps_ns: _NS, findings: Findings
) -> list[str]:
    """Find stamps that leap in the clip, or say it where they are few."""
    places = clip.inside[leapt[clip.inside]]
    if not len(places):
        return []
    text = (
        f"{len(places)} of {len(clip.inside)} stamps leave their usual distance to the time of "
        f"receipt by more than {LEAP_S:g} s, the first at "
        f"{ns_to_seconds(int(stamps_ns[places[0]]) - clip.first_ns):.3f} s of the clip"
    )
    if len(places) > MOST_LEAPS * len(clip.inside):
        findings.add(
            Finding(
                "leaping_stamps",
                text,
                "set the camera's clock, or take the times of receipt with --clock receive",
                options.bag,
                options.camera,
            )
        )
    return [f"camera: {text}; these frames take the time of receipt"]


def _span(options: BagOptions, frame_times: Times) -> Span:
    """Return the crop.

    Raises:
        InputError: it holds no frame.
    """
    stamps_ns = frame_times.on(options.clock)
    zero_ns = int(stamps_ns[0])
    start_s, end_s = options.clip.start_s, options.clip.end_s
    low_ns = zero_ns + seconds_to_ns(start_s)
    high_ns = int(stamps_ns[-1])
    if end_s is not None:
        high_ns = min(high_ns, zero_ns + seconds_to_ns(end_s))
    if low_ns > int(stamps_ns[-1]) or high_ns <= low_ns:
        length_s = ns_to_seconds(int(stamps_ns[-1]) - zero_ns)
        raise InputError(
            f"has no frame from {start_s:g} s on" + ("" if end_s is None else f" to {end_s:g} s"),
            file=options.bag,
            field=options.camera,
            remedy=f"its frames span {length_s:.3f} s; --start and --end count from the first",
        )
    inside = np.flatnonzero((stamps_ns >= low_ns) & (stamps_ns <= high_ns))
    of_frames = None
    if len(inside):
        received_ns = frame_times.received_ns[inside]
        of_frames = int(received_ns.min()), int(received_ns.max())
    return Span(options.clock, zero_ns, (low_ns, high_ns), of_frames)


def _clip(options: BagOptions, stamps_ns: _NS, vut: Poses, span: Span) -> _Clip:
    """Return the frames within the crop and the VUT's states, thinned to the rate."""
    zero_ns, (low_ns, high_ns) = span.zero_ns, span.stamps_ns
    first_ns, last_ns = vut.reach_ns
    notes = []
    # A frame just before the first pose is of the same time as it.
    first_ns, last_ns = first_ns - _BESIDE_NS, last_ns + _BESIDE_NS
    for moved_ns, what in ((first_ns - low_ns, "begin"), (high_ns - last_ns, "end")):
        if moved_ns > 0:
            notes.append(
                f"the VUT's poses {what} {ns_to_seconds(moved_ns):.3f} s "
                f"{'after' if what == 'begin' else 'before'} the frames: these were left out"
            )
    low_ns, high_ns = max(low_ns, first_ns), min(high_ns, last_ns)
    inside = np.flatnonzero((stamps_ns >= low_ns) & (stamps_ns <= high_ns))
    rising = np.diff(stamps_ns[inside], prepend=np.iinfo(np.int64).min // 2) > 0
    if not rising.all():
        notes.append(f"{int((~rising).sum())} frames that repeat a stamp were left out")
    inside = inside[rising]
    if len(inside) < 2:
        raise InputError(
            f"has {len(inside)} frames within the clip",
            file=options.bag,
            field=options.camera,
            remedy="at least 2 are needed; move --start and --end",
        )
    times = stamps_ns[inside]
    try:
        thinned = thin(times, options.clip.rate_hz)
    except ValueError as error:
        raise InputError(
            str(error), file=options.bag, field="--rate", remedy="give a lower rate"
        ) from error
    notes += [f"camera: {one}" for one in thinned.notes]
    gaps = np.diff(times) / NS_PER_S
    if gaps.max() > STATE_AGE_S:
        at_s = ns_to_seconds(int(times[int(np.argmax(gaps))]) - int(times[0]))
        notes.append(
            f"camera: {int((gaps > STATE_AGE_S).sum())} gaps of more than {STATE_AGE_S:g} s, the "
            f"longest {gaps.max():.2f} s from {at_s:.2f} s of the clip on"
        )
    stamps_by_place = {int(i): int(stamps_ns[i]) for i in inside[thinned.places]}
    crop_s = tuple(ns_to_seconds(ns - zero_ns) for ns in (int(times[0]), int(times[-1])))
    return _Clip(
        inside,
        stamps_by_place,
        thinned.keep_every,
        thinned.rate_hz,
        (crop_s[0], crop_s[1]),
        tuple(notes),
    )


def _track(options: BagOptions, name: str, poses: Poses, clip: _Clip, findings: Findings) -> Track:
    _, object_class = options.objects[name]
    role = Role.VUT if name == VUT_ID else Role.OT
    body = options.clip.motion.body(name, object_class, "rear_axle", role)
    stamps_ns = poses.samples.stamps_ns
    inside = (stamps_ns >= clip.first_ns) & (stamps_ns <= clip.last_ns)
    return make_track(poses.samples.select(np.flatnonzero(inside)), body, findings)


def _assumptions(options: BagOptions, poses: Poses, track: Track) -> list[str]:
    """List the assumptions about an object's frames."""
    name = track.body.object_id
    if {name, ALL} & set(options.clip.motion.references):
        return []
    point = poses.child_frame_id or "the reported point"
    return [f"{name}: {point} is taken as its reference point (rear axle, or middle of a person)"]


def _coverage(track: Track, clip: _Clip) -> list[str]:
    late_s = ns_to_seconds(track.first_ns - clip.first_ns)
    early_s = ns_to_seconds(clip.last_ns - track.last_ns)
    if max(late_s, early_s) <= STATE_AGE_S:
        return []
    return [
        f"{track.body.object_id}: its poses cover the clip from {late_s:.2f} s after its first "
        f"frame to {early_s:.2f} s before its last one"
    ]


@dataclass(frozen=True)
class _Camera:
    """The messages of the camera's topic, read once more to be written.

    Args:
        recorded: the times that were found when they were read first.
        leapt: whose stamps leap, by their places.
    """

    bag: SourceBag
    options: BagOptions
    recorded: Times
    leapt: NDArray[np.bool_]

    def frames(self, stamps_by_place: Mapping[int, int]) -> Iterator[tuple[int, bytes]]:
        """Yield the messages that are kept, each with its own stamp, on the clock of the import.

        Args:
            stamps_by_place: settled stamps; they are those of frames whose own ones leap.

        Raises:
            InputError: a message isn't the one that stood there before.
        """
        topic, recorded = self.options.camera, self.recorded
        for place, (received_ns, data) in enumerate(self.bag.raw(topic)):
            if place not in stamps_by_place:
                continue
            own_ns = self.bag.stamp_ns(topic, received_ns, data)
            before = int(recorded.stamps_ns[place]), int(recorded.received_ns[place])
            if (own_ns, received_ns) != before:
                raise InputError(
                    f"message {place + 1} has the stamp {own_ns} ns and was received at "
                    f"{received_ns} ns, and {before[0]} and {before[1]} when it was read first",
                    file=self.options.bag,
                    field=topic,
                    remedy="let nothing write to the bag during the import",
                )
            if self.leapt[place]:
                own_ns = stamps_by_place[place]
            yield received_ns if self.options.clock == "receive" else own_ns, data


def _write(
    writer: BagWriter,
    options: BagOptions,
    source: _Camera,
    source_camera: CameraSource,
    tracks: list[Track],
    clip: _Clip,
    notes: list[str],
    findings: Findings,
    advance: Callable[[int], None],
) -> ImportSummary:
    writer.add_topic(IMAGE, COMPRESSED_TYPE, offered_qos(20))
    kind = source.bag.types[options.camera]
    camera = CameraFacts()
    intake = FrameIntake(
        options.bag,
        options.camera,
        clip.first_ns,
        accepts_cut="cut_pictures" in options.clip.accepted,
        has_lens=options.camera_info is not None,
    )
    notes = [*notes, *clip.notes]
    count = picture_count = 0
    for stamp_ns, data in source.frames(clip.stamps_ns):
        count += 1
        picture = intake.take(stamp_ns, kind, data)
        if picture is not None:
            if not picture_count and intake.describes_lens:
                with findings.noted("camera"):
                    camera, more = source_camera.facts(intake.frame_id, intake.size_px, findings)
                    notes += more
                    camera.write(writer, stamp_ns)
            picture_count += 1
            writer.write(IMAGE, encode_frame(stamp_ns, picture), stamp_ns, stamp_ns, count)
        advance(1)
    if count < len(clip.stamps_ns):
        raise InputError(
            f"gave {count} frames, {len(clip.stamps_ns)} were planned",
            file=options.bag,
            field=options.camera,
            remedy="let nothing write to the bag during the import",
        )
    notes += [f"camera: {one}" for one in intake.close(findings)]
    notes += [f"camera: {one}" for one in intake.repeats.notes(speeds_of(tracks[0]), clip.first_ns)]
    write_states(writer, {track.body.object_id: track.states for track in tracks})
    digest = source.bag.sha256()
    writer.add_sources(sources_with(options.bag.resolve().name, digest, source.bag.seal()))
    motion = measured_motion(options.clip.motion, tracks, options.bag.name, digest, notes)
    described: dict[str, object] = {
        "name": options.bag.name,
        "sha256": digest,
        "kind": "bag",
        "topics": {name: topic for name, (topic, _) in options.objects.items()}
        | {"camera": options.camera},
        "clock": options.clock,
    }
    record = attach_record(
        writer, options.clip.declared, described, clip.crop_s, camera, motion, findings
    )
    duration_s = ns_to_seconds(clip.last_ns - clip.first_ns)
    return ImportSummary(
        options.clip.out, count, clip.keep_every, clip.rate_hz, duration_s, intake.size_px, record
    )
