"""Conversion of a video file, and a table of its states, into a bag directory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.pictures.images import Bgr
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.hashing import sha256_file
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.names import VUT_ID
from ssp_core.video import Soundness, Video, sound_video
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera_messages import encode_frame
from ssp_eval.importers.findings import Finding, Findings
from ssp_eval.importers.frames import Repeats, speeds_of
from ssp_eval.importers.options import OBJECT_ID, ImportOptions
from ssp_eval.importers.table import Table, TableObject, read_table
from ssp_eval.importers.target import (
    IMAGE,
    CameraFacts,
    FrameSelection,
    ImportSummary,
    Motion,
    attach_record,
    check_free,
    jpeg,
    keep_every,
    make_bag,
    measured_motion,
    thin,
    write_states,
)
from ssp_eval.importers.tracks import LEAST_SAMPLES, Track, make_track

STATE_STEP_NS = 20_000_000
TABLE_ATTACHMENT = "states.csv"
# The table's VUT may begin this much after the first frame and end this much before the last one.
UNCOVERED_S = 0.5
# An earlier first frame isn't worth a word.
_OFFSET_SAID_S = 0.001
_STANDING_MPS = 0.1
_DRIVING_MPS = 2.0
# So many pairs of frames of either kind are needed to say anything.
_LEAST_PAIRS = 5
# Frames that change so many times as much while the VUT stands are another run's.
_CONTRARY = 2.0
_COMPARED_PX = (64, 36)
# So many objects, and so long a note, import.json holds.
_MOST_OBJECTS, _LONGEST_NOTE = 64, 450
# Times of one frame by two decoders differ by less than this part of a frame's period.
_SLACK = 0.01


@dataclass(frozen=True)
class TableOptions:
    """A table of states beside the video.

    Args:
        vut: id of the VUT in it.
        objects: id in the table by id in the recording; empty: all others, by their own ids.
        time_offset_s: is added to its times; they are then the video's.
    """

    file: Path
    vut: str
    objects: dict[str, str]
    time_offset_s: float


@dataclass(frozen=True)
class VideoOptions:
    """One import.

    Args:
        camera: as a person describes it, declared or assumed; its lens is of the stored frames.
        ego_speed_mps: declared constant speed of the camera's vehicle on a straight line, None:
            unknown, or measured where there is a table.
        table: of states, None: there is none.
        most_damaged: at most so many errors of the decoder are accepted.
    """

    video: Path
    clip: ImportOptions
    camera: Callable[[int, int], CameraFacts]
    ego_speed_mps: float | None
    table: TableOptions | None
    most_damaged: int


def import_clip(options: VideoOptions, advance: Callable[[int], None]) -> ImportSummary:
    """Make the bag.

    Args:
        options: of the command.
        advance: called with the number of frames kept since the last call.

    Raises:
        InputError: source, crop, table or output are not usable; nothing is left behind.
    """
    check_free(options.clip.out)
    findings = Findings(options.clip.accepted)
    with findings.listed(options.video), Video(options.video) as video:
        every = _keep_every(video, options)
        sound = _sound(options, findings)
        selection = _frame_selection(video, options, every, sound)
        table = None
        with findings.noted("table"):
            table = None if options.table is None else read_table(options.table.file, findings)
        findings.need()
        return make_bag(
            options.clip.out,
            lambda writer: _write(
                writer, video, options, table, selection, sound, findings, advance
            ),
        )


def _frame_selection(
    video: Video, options: VideoOptions, every: int, sound: Soundness
) -> FrameSelection:
    """Return the frames of the crop that are kept."""
    fps = video.info.fps
    times_s = _times_s(video, options, sound)
    if len(times_s) < 2:
        return FrameSelection(np.arange(len(times_s)), every, fps / every, ())
    return thin(np.array([seconds_to_ns(t) for t in times_s]), options.clip.rate_hz, fps)


def _times_s(video: Video, options: VideoOptions, sound: Soundness) -> FloatArray:
    """Return the times of the crop's frames, by the strict decoder."""
    clip, slack_s = options.clip, _SLACK / video.info.fps
    end_s = math.inf if clip.end_s is None else clip.end_s
    times_s = np.array(sound.times_s)
    return times_s[(times_s >= clip.start_s - slack_s) & (times_s < end_s - slack_s)]


def _sound(options: VideoOptions, findings: Findings) -> Soundness:
    """Decode the part that is imported strictly, and note the findings."""
    soundness = sound_video(options.video, options.clip.end_s)
    if soundness.damaged > options.most_damaged:
        findings.add(
            Finding(
                "damaged_video",
                f"is damaged: the decoder reports {soundness.damaged} errors beside "
                f"{soundness.frames} frames",
                f"get the file again from its source; --accept-damaged {soundness.damaged} takes "
                "so many errors",
                options.video,
                "--accept-damaged",
                value=options.most_damaged,
            )
        )
    return soundness


def _keep_every(video: Video, options: VideoOptions) -> int:
    length_s = video.info.offset_s + video.info.frames / video.info.fps
    clip = options.clip
    last_s = clip.start_s if clip.end_s is None else clip.end_s
    if video.info.frames and last_s > length_s + 1.0 / video.info.fps:
        raise _outside(options, length_s)
    try:
        return keep_every(video.info.fps, clip.rate_hz)
    except ValueError as error:
        raise InputError(
            str(error), file=options.video, field="--rate", remedy="give a lower rate"
        ) from error


def _outside(options: VideoOptions, length_s: float) -> InputError:
    start_s, end_s = options.clip.start_s, options.clip.end_s
    end = "on" if end_s is None else f"to {end_s:g} s"
    return InputError(
        f"the crop from {start_s:g} s {end} lies beyond the video, in part or wholly",
        file=options.video,
        remedy=f"the video is {length_s:.3f} s long",
    )


def _write(
    writer: BagWriter,
    video: Video,
    options: VideoOptions,
    table: Table | None,
    selection: FrameSelection,
    sound: Soundness,
    findings: Findings,
    advance: Callable[[int], None],
) -> ImportSummary:
    clip, info = options.clip, video.info
    size_px = info.width_px, info.height_px
    camera = options.camera(*size_px)
    writer.add_topic(IMAGE, COMPRESSED_TYPE, offered_qos(20))
    start_s, stamps_ns, change = 0.0, list[int](), _FrameChange()
    repeats, last = Repeats(), None
    planned_s = _times_s(video, options, sound)[selection.places]

    def is_planned(time_s: float) -> bool:
        return bool((np.abs(planned_s - time_s) < _SLACK / info.fps).any())

    for frame in video.frames(clip.start_s, clip.end_s, is_planned):
        if not stamps_ns:
            start_s = frame.time_s
            camera.write(writer, 0)
        stamp_ns = seconds_to_ns(frame.time_s - start_s)
        stamps_ns.append(stamp_ns)
        repeats.take(stamp_ns, is_same=last is not None and np.array_equal(last, frame.image))
        last = frame.image
        if table is not None:
            change.take(frame.image)
        data = encode_frame(stamp_ns, jpeg(frame.image))
        writer.write(IMAGE, data, stamp_ns, stamp_ns, len(stamps_ns))
        advance(1)
    if len(stamps_ns) != len(planned_s):
        raise InputError(
            f"gave {len(stamps_ns)} frames, {len(planned_s)} were planned: decoding ended at "
            f"{video.reached_s:.3f} s",
            file=options.video,
            remedy="cut the damaged span out with --start and --end, or get the file again",
        )
    end_s = video.reached_s if clip.end_s is None else clip.end_s
    if not stamps_ns or video.reached_s < end_s - 0.5 / info.fps:
        raise _outside(options, video.reached_s)
    motion: Motion | float | None = options.ego_speed_mps
    notes = [*_of_file(video), *(f"camera: {one}" for one in selection.notes)]
    if table is not None and options.table is not None:
        zero_ns = seconds_to_ns(start_s)
        motion = _measured(options, options.table, table, zero_ns, stamps_ns[-1], findings)
        _check_motion(motion, change, np.array(stamps_ns) + zero_ns)
        speeds = speeds_of(motion.tracks[0])
        notes += [
            f"camera: {one}"
            for one in repeats.notes(lambda at: speeds([ns + zero_ns for ns in at]), 0)
        ]
        write_states(writer, {t.body.object_id: partial(t.states, zero_ns) for t in motion.tracks})
        writer.attach(TABLE_ATTACHMENT, options.table.file.read_bytes(), "text/csv")
    elif options.ego_speed_mps is not None:
        speed_mps = options.ego_speed_mps
        notes += [
            f"camera: {one}" for one in repeats.notes(lambda at: np.full(len(at), speed_mps), 0)
        ]
        write_states(writer, {VUT_ID: partial(_declared_states, speed_mps, stamps_ns[-1])})
    source: dict[str, object] = {
        "name": options.video.name,
        "sha256": sha256_file(options.video),
        "kind": "video",
        "width_px": info.width_px,
        "height_px": info.height_px,
        "fps": info.fps,
        "frames": info.frames,
    }
    if sound.damaged:
        source["decoder_errors"] = sound.damaged
    crop_s = start_s, end_s
    record = attach_record(writer, clip.declared, source, crop_s, camera, motion, findings, notes)
    duration_s = ns_to_seconds(stamps_ns[-1])
    return ImportSummary(
        clip.out,
        len(stamps_ns),
        selection.keep_every,
        selection.rate_hz,
        duration_s,
        size_px,
        record,
    )


def _of_file(video: Video) -> list[str]:
    """List the remarks on a video's pixels and times."""
    info, notes = video.info, []
    if info.stored_px is not None:
        notes.append(
            f"camera: pixels aren't square; pictures of {info.stored_px[0]}x{info.stored_px[1]} px "
            f"were stretched to {info.width_px}x{info.height_px}"
        )
    if info.offset_s >= _OFFSET_SAID_S:
        notes.append(
            f"camera: the video's first frame is at {info.offset_s:.3f} s of the file; times of "
            "tables and of --start and --end are those of the file"
        )
    return notes


def _declared_states(speed_mps: float, last_ns: int) -> Iterator[ObjectState]:
    """Yield the states at 50 Hz of a vehicle that drives along the map's x axis from its origin."""
    for k in range(last_ns // STATE_STEP_NS + 1):
        yield ObjectState(
            object_id=VUT_ID,
            object_class=ObjectClass.CAR,
            role=Role.VUT,
            stamp_ns=k * STATE_STEP_NS,
            x_m=speed_mps * ns_to_seconds(k * STATE_STEP_NS),
            y_m=0.0,
            yaw_rad=0.0,
            speed_mps=speed_mps,
            acceleration_mps2=0.0,
            yaw_rate_radps=0.0,
            size=DEFAULT_SIZES[ObjectClass.CAR],
            sequence=k + 1,
        )


def _measured(
    options: VideoOptions,
    table_options: TableOptions,
    table: Table,
    low_ns: int,
    last_ns: int,
    findings: Findings,
) -> Motion:
    """Return the tracks of VUT and objects within the clip.

    Args:
        options: of the command.
        table_options: the table's file, its ids and its time base.
        table: its content.
        low_ns: the first frame's time in the video.
        last_ns: clip time of the last frame.
        findings: take what contradicts itself in the table.
    """
    names = _names(table_options, table, findings)
    options.clip.check_ids(tuple(names))
    high_ns = low_ns + last_ns
    notes, tracks = [], []
    if table.ignored:
        notes.append(f"columns that are not read: {_listed(table.ignored)}")
    if others := len(table.objects) - len(names):
        notes.append(f"{others} other objects of the table are left out")
    for object_id, name in names.items():
        with findings.noted("states"):
            track = _track(
                options, table_options, object_id, table.objects[name], low_ns, high_ns, findings
            )
            notes += [*track.notes, *_coverage(track, low_ns, high_ns)]
            tracks.append(track)
    findings.need()
    return measured_motion(
        options.clip.motion,
        tracks,
        table_options.file.name,
        sha256_file(table_options.file),
        notes,
        table_options.time_offset_s,
    )


def _track(
    options: VideoOptions,
    table_options: TableOptions,
    object_id: str,
    one: TableObject,
    low_ns: int,
    high_ns: int,
    findings: Findings,
) -> Track:
    """Return the track of an object within the clip, which lasts from and to times of the video."""
    stamps_ns = one.samples.stamps_ns + seconds_to_ns(table_options.time_offset_s)
    inside = (stamps_ns >= low_ns) & (stamps_ns <= high_ns)
    if inside.sum() < LEAST_SAMPLES:
        raise one.samples.source.error(
            f"has {int(inside.sum())} rows within the clip, from "
            f"{ns_to_seconds(low_ns):.3f} to {ns_to_seconds(high_ns):.3f} s of the video: its "
            f"rows go from {ns_to_seconds(int(stamps_ns.min())):.3f} to "
            f"{ns_to_seconds(int(stamps_ns.max())):.3f} s",
            "give the table of this run, times in s; --time-offset S is added to them",
            index=0,
        )
    role = Role.VUT if object_id == VUT_ID else Role.OT
    body = options.clip.motion.body(object_id, one.object_class, "centre", role, one.size)
    samples = replace(one.samples, stamps_ns=stamps_ns).select(np.flatnonzero(inside))
    return make_track(samples, body, findings)


@dataclass
class _FrameChange:
    """The difference of each frame of a clip from the one before, in grey levels.

    A table of another run shows itself by frames that change while its VUT stands.
    """

    _last: FloatArray | None = None
    _changes: list[float] = field(default_factory=list)

    def take(self, image: Bgr) -> None:
        """Take the next frame."""
        small = cv2.resize(image, _COMPARED_PX, interpolation=cv2.INTER_AREA)
        grey = np.asarray(small, dtype=np.float64).mean(axis=2)
        if self._last is not None:
            self._changes.append(float(np.abs(grey - self._last).mean()))
        self._last = grey

    def contrast(self, speed_mps: FloatArray) -> float | None:
        """Change while the VUT stands over change while it drives, medians.

        Args:
            speed_mps: of the VUT at each frame.

        Returns:
            None where the clip doesn't show enough of both; otherwise well under 1 where the
            speeds are those of the camera.
        """
        speed = np.abs(speed_mps)
        changes = np.array(self._changes)
        standing = changes[np.maximum(speed[1:], speed[:-1]) < _STANDING_MPS]
        driving = changes[np.minimum(speed[1:], speed[:-1]) > _DRIVING_MPS]
        if min(len(standing), len(driving)) < _LEAST_PAIRS:
            return None
        # A still picture changes by less than a hundredth of a grey level.
        return float(np.median(standing) / max(float(np.median(driving)), 0.01))


def _check_motion(measured: Motion, change: _FrameChange, frames_ns: NDArray[np.int64]) -> None:
    """Refuse a table whose VUT stands while the frames move; note where they may.

    Args:
        measured: tracks of the VUT and the objects.
        change: the differences between the frames.
        frames_ns: their times in the video.
    """
    vut = measured.tracks[0]
    speed = np.interp(frames_ns, vut.samples.stamps_ns, vut.samples["speed_mps"])
    ratio = change.contrast(speed)
    if ratio is None or ratio < 1.0:
        return
    text = (
        f"says that the VUT stands where the frames change {ratio:.1f} times as much as where it "
        "drives"
    )
    if ratio >= _CONTRARY:
        raise vut.samples.source.error(
            f"{text}: another run's table, or another time base?",
            "give the table of this run; --time-offset S is added to its times",
            index=0,
        )
    measured.states.notes.append(f"the table {text}: is it of this run?")


def _listed(columns: Sequence[str]) -> str:
    """List columns for people; of many the first twelve, with the count."""
    text = ", ".join(columns)
    if len(text) <= _LONGEST_NOTE:
        return text
    return f"{len(columns)}, such as {', '.join(name[:24] for name in columns[:12])}"


def _names(table_options: TableOptions, table: Table, findings: Findings) -> dict[str, str]:
    """Return the id in the table by the id in the recording, the VUT first."""
    table_ids = {VUT_ID: table_options.vut, **table_options.objects}
    if not table_options.objects:
        table_ids |= {
            name: name for name in table.objects if name not in (table_options.vut, VUT_ID)
        }
    for object_id, name in table_ids.items():
        if name not in table.objects:
            option = "--vut" if object_id == VUT_ID else f"--object {object_id}"
            findings.note(
                "table",
                InputError(
                    "is no id of the table",
                    file=table_options.file,
                    field=option,
                    value=name,
                    remedy=f"its ids are {', '.join(list(table.objects)[:12])}",
                ),
            )
        elif not OBJECT_ID.fullmatch(object_id):
            findings.note(
                "table",
                InputError(
                    "is no id of a recording's object: a-z, then a-z, 0-9 and _, at most 32",
                    file=table_options.file,
                    field="id",
                    value=name,
                    remedy=f"name the event's objects, as in --object 'ot1={name}'",
                ),
            )
    findings.need()
    if len(table_ids) - 1 > _MOST_OBJECTS:
        raise InputError(
            f"holds {len(table_ids) - 1} objects beside the VUT, more than {_MOST_OBJECTS}",
            file=table_options.file,
            field="id",
            remedy="name those of the event with --object ot1=ID",
        )
    if len(table_ids) < 2:
        raise InputError(
            "holds no object beside the VUT",
            file=table_options.file,
            field="id",
            value=table_options.vut,
            remedy="an event needs an object target",
        )
    twice = [name for name in set(table_ids.values()) if list(table_ids.values()).count(name) > 1]
    if twice:
        raise InputError(
            "is named twice",
            file=table_options.file,
            field="--object",
            value=twice[0],
            remedy="give each object one place",
        )
    return table_ids


def _coverage(track: Track, low_ns: int, high_ns: int) -> list[str]:
    """Refuse a VUT that the table lacks for part of the clip; note it of other objects."""
    late_s, early_s = ns_to_seconds(track.first_ns - low_ns), ns_to_seconds(high_ns - track.last_ns)
    who = track.body.object_id
    if max(late_s, early_s) <= UNCOVERED_S:
        return []
    text = (
        f"covers the clip from {late_s:.2f} s after its first frame to {early_s:.2f} s before its "
        "last one"
    )
    if track.body.role is Role.VUT:
        source = track.samples.source
        raise source.error(
            text,
            f"at most {UNCOVERED_S:g} s may be missing; cut the video with --start and --end",
            index=0,
        )
    return [f"{who}: {text}"]
