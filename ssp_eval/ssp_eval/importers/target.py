"""The bag that an import makes, whole or not there, with its frames and camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ssp_core import RULES_VERSION, names
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.pictures.images import Bgr, encode_jpeg
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.states import encode_state
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.files.folders import new_folder
from ssp_core.motion.state import ObjectState
from ssp_core.names import TF_STATIC, VUT_ID
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_core.world.camera_messages import INFO_TYPE, MOUNT_TYPE, encode_camera_info
from ssp_core.world.transforms import (
    TF_TYPE,
    encode_transform,
    encode_transforms,
    mount,
    of_camera,
    of_state,
)
from ssp_eval.data.provenance import (
    IMPORT_ATTACHMENT,
    ImportedCamera,
    ImportedEgo,
    ImportedStates,
    ImportRecord,
)
from ssp_eval.importers.findings import Findings
from ssp_eval.importers.options import DeclaredFacts, MotionOptions
from ssp_eval.importers.road import RecordingRoad, bind_road
from ssp_eval.importers.tracks import Track
from ssp_scenario_manager.compile.task import EVENT_FILE
from ssp_scenario_manager.event_spec.log import Record, append_record, utc_now

STATE_TYPE = "ssp_msgs/msg/ObjectState"


IMAGE = names.absolute(names.CAMERA_IMAGE)
INFO = names.absolute(names.CAMERA_INFO)
MOUNT = names.absolute(names.CAMERA_MOUNT)

Made = TypeVar("Made")


@dataclass(frozen=True)
class ImportSummary:
    """The imported data.

    Args:
        keep_every: every n-th source frame was kept.
        rate_hz: of the kept frames.
        duration_s: clip time of the last frame.
        size_px: width and height of the stored frames.
    """

    bag: Path
    frames: int
    keep_every: int
    rate_hz: float
    duration_s: float
    size_px: tuple[int, int]
    record: ImportRecord

    def as_json(self) -> dict[str, object]:
        """Describe the import for programs."""
        return {
            "bag": str(self.bag),
            "frames": self.frames,
            "keep_every": self.keep_every,
            "rate_hz": self.rate_hz,
            "duration_s": self.duration_s,
            "width_px": self.size_px[0],
            "height_px": self.size_px[1],
            "import": self.record.model_dump(mode="json", by_alias=True),
        }

    @property
    def text(self) -> str:
        """Describe the import for people, in one line."""
        width_px, height_px = self.size_px
        return (
            f"{self.bag}: {self.frames} frames of {width_px}x{height_px} px, "
            f"{self.duration_s:.3f} s"
        )


_REMEDY = "name a new directory with --out"


def check_free(out: Path) -> None:
    """Raise InputError where something is already there."""
    if out.exists() or out.is_symlink():
        raise InputError("exists already", file=out, remedy=_REMEDY)


def make_bag(out: Path, fill: Callable[[BagWriter], Made]) -> Made:
    """Make a bag directory in a folder beside it and put it in place when it is whole.

    Raises:
        InputError: the directory exists, or what ``fill`` raises; nothing is left behind.
    """
    with (
        new_folder(out, _REMEDY) as folder,
        BagWriter(folder, name=f"{out.name}_0", maker=Maker.IMPORT) as writer,
    ):
        return fill(writer)


def write_states(
    writer: BagWriter, objects: Mapping[str, Callable[[], Iterable[ObjectState]]]
) -> None:
    """Write each object's states on its own topic, and all as poses on /tf.

    Args:
        writer: of the new bag.
        objects: each gives its states anew, stamps rising; they are the log times.
    """
    for object_id, states in objects.items():
        topic = names.absolute(names.state_topic(object_id))
        writer.add_topic(topic, STATE_TYPE, offered_qos(50))
        for state in states():
            writer.write(topic, encode_state(state), state.stamp_ns, state.stamp_ns, state.sequence)
    writer.add_topic(names.TF, TF_TYPE, offered_qos(100))
    stamp = attrgetter("stamp_ns")
    together = groupby(merge(*(states() for states in objects.values()), key=stamp), key=stamp)
    for count, (stamp_ns, present) in enumerate(together, 1):
        poses = encode_transforms(map(of_state, present))
        writer.write(names.TF, poses, stamp_ns, stamp_ns, count)


@dataclass(frozen=True)
class Motion:
    """The origin of a recording's states, and the road under the VUT's way."""

    tracks: Sequence[Track]
    states: ImportedStates
    road: RecordingRoad | None


def measured_motion(
    options: MotionOptions,
    tracks: Sequence[Track],
    name: str,
    sha256: str,
    notes: list[str],
    time_offset_s: float = 0.0,
) -> Motion:
    """Bind the road under the VUT's path, and state where the tracks come from.

    Args:
        options: site and block of the road.
        tracks: the VUT's first.
        name: of the file that they stand in, or of the bag.
        sha256: hash of that file or bag.
        notes: on the states so far.
        time_offset_s: that was added to the source's times.

    Raises:
        InputError: the road isn't there; see bind_road.
    """
    road = None
    if options.site is not None:
        road = bind_road(options.site, options.block, tracks[0])
        block = road.site.block
        notes = [*notes, f"{100 * road.share:.0f} % of the VUT's way lie on {block}"]
        notes += [f"{block}: {note}" for note in road.notes]
    states = ImportedStates(
        name=name,
        sha256=sha256,
        vut=VUT_ID,
        objects={t.body.object_id: t.body.object_class.word for t in tracks[1:]},
        time_offset_s=time_offset_s,
        notes=notes,
    )
    return Motion(tracks, states, road)


def attach_record(
    writer: BagWriter,
    declared: DeclaredFacts,
    source: dict[str, object],
    crop_s: tuple[float, float],
    camera: CameraFacts,
    motion: Motion | float | None,
    findings: Findings,
    notes: Sequence[str] = (),
) -> ImportRecord:
    """Attach import.json, the K* and the map.

    Args:
        writer: of the new bag.
        declared: what a person declares about the recording.
        source: name, sha256, kind.
        crop_s: from and to, on the source's clock.
        camera: facts about the camera.
        motion: measured; the VUT's declared constant speed, m/s; or None: unknown.
        findings: of the whole import.
        notes: on file and frames, beside those on the states.

    Raises:
        InputError: one of the findings isn't accepted.
    """
    findings.check()
    ego = ImportedEgo(provenance="unknown", speed_mps=None)
    states = road = None
    if isinstance(motion, Motion):
        ego = ImportedEgo(provenance="measured", speed_mps=None)
        states, road = motion.states, motion.road
    elif motion is not None:
        ego = ImportedEgo(provenance="declared", speed_mps=motion)
    record = ImportRecord(
        source=source,
        crop={"start_s": crop_s[0], "end_s": crop_s[1]},
        generator=declared.generator,
        domain=declared.domain,
        scenario=declared.scenario,
        event_version=declared.event_version,
        ego=ego,
        camera=camera.record,
        declaration=declared.declaration,
        log=declared.log,
        states=states,
        site=None if road is None else road.site,
        accepted=findings.accepted,
        rules_version=RULES_VERSION,
        notes=list(notes),
    )
    data = record.model_dump_json(by_alias=True, indent=1).encode() + b"\n"
    writer.attach(IMPORT_ATTACHMENT, data, "application/json")
    if declared.event_file is not None:
        writer.attach(EVENT_FILE, declared.event_file, "application/yaml")
    if road is not None:
        writer.attach(road.site.attachment, road.data, "application/octet-stream")
    return record


def log_source(summary: ImportSummary, who: str) -> None:
    """Enter the origin of a recording into log L, beside the bag (METHOD 1)."""
    record = summary.record
    details: dict[str, object] = {
        "generator": record.generator,
        "original": record.source_name,
        "sha256": record.source_sha256,
        "crop": record.crop,
    }
    if record.states is not None:
        details["states"] = {"name": record.states.name, "sha256": record.states.sha256}
    if record.site is not None:
        details["site"] = {"name": record.site.name, "sha256": record.site.sha256}
    if record.declaration is not None:
        details["domain"] = f"{record.domain}, {record.declaration.text}"
    if record.log is not None:
        details["declared"] = record.log.model_dump(mode="json")
    if record.accepted:
        details["accepted"] = [one.model_dump() for one in record.accepted]
    entry = Record(
        kind="source",
        when=utc_now(),
        who=who,
        subject=record.scenario or record.source_name,
        version=record.event_version,
        reason="imported as a bag",
        details=details,
    )
    append_record(summary.bag.with_name(f"{summary.bag.name}.log.jsonl"), entry)


JPEG_QUALITY = 90
# Fewer frames a second than this are never kept where a source has more.
DEFAULT_RATE_HZ = 10.0
# Two kept frames lie at most this many periods of that rate apart.
_GAP = 1.1


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """Geometry of the camera as far as somebody states it; nothing here is ever made up.

    Args:
        provenance: ``measured`` (by the recording itself), ``declared`` (known), ``assumed`` (a
            guess) or ``unknown``.
        lens: None: unknown.
        mounting: on the VUT, from its reference point; None: unknown.
    """

    provenance: Literal["measured", "declared", "assumed", "unknown"] = "unknown"
    lens: Intrinsics | None = None
    mounting: Mounting | None = None

    @property
    def record(self) -> ImportedCamera:
        """Make the entry of import.json."""
        lens, mounting = self.lens, self.mounting
        half = None if lens is None else math.atan(lens.width_px / 2 / lens.fx_px)
        return ImportedCamera(
            provenance=self.provenance,
            hfov_deg=None if half is None else round(math.degrees(2 * half), 9),
            height_m=None if mounting is None else mounting.height_m,
            pitch_down_rad=None if mounting is None else mounting.pitch_down_rad,
        )

    def write(self, writer: BagWriter, stamp_ns: int) -> None:
        """Write CameraInfo and mount, as far as they are known."""
        latched = offered_qos(20, transient_local=True)
        if self.lens is not None:
            writer.add_topic(INFO, INFO_TYPE, latched)
            writer.write(INFO, encode_camera_info(stamp_ns, self.lens), stamp_ns, stamp_ns, 1)
        if self.mounting is not None:
            writer.add_topic(MOUNT, MOUNT_TYPE, latched)
            mounted = encode_transform(mount(self.mounting, stamp_ns))
            writer.write(MOUNT, mounted, stamp_ns, stamp_ns, 1)
            writer.add_topic(TF_STATIC, TF_TYPE, offered_qos(1, transient_local=True))
            fixed = encode_transforms(of_camera(self.mounting))
            writer.write(TF_STATIC, fixed, stamp_ns, stamp_ns, 1)


def pinhole(width_px: int, height_px: int, hfov_deg: float) -> Intrinsics:
    """Return a lens of square pixels with its principal point in the middle."""
    focal_px = width_px / 2 / math.tan(math.radians(hfov_deg) / 2)
    return Intrinsics(width_px, height_px, focal_px, focal_px, width_px / 2, height_px / 2)


def keep_every(fps: float, rate_hz: float | None) -> int:
    """Return the largest n of which every n-th frame leaves at least the wanted rate.

    Whole frames at an even spacing and never under 10 Hz by default, so that a frame is always
    near enough to a label (METHOD 6.1 allows 0.11 s).

    Raises:
        ValueError: there are fewer frames per second than were asked for.
    """
    if rate_hz is None:
        rate_hz = min(DEFAULT_RATE_HZ, fps)
    if rate_hz > fps * 1.001:
        raise ValueError(f"has {fps:g} frames per second, fewer than {rate_hz:g}")
    return max(1, math.floor(fps / rate_hz + 1e-3))


@dataclass(frozen=True)
class FrameSelection:
    """The frames that are kept of a clip.

    Args:
        places: of the kept frames among all.
        keep_every: one in so many, where the rate is steady.
        rate_hz: mean rate of the kept frames.
        notes: what is to be said of them.
    """

    places: NDArray[np.int64]
    keep_every: int
    rate_hz: float
    notes: tuple[str, ...]


def thin(
    times_ns: NDArray[np.int64], rate_hz: float | None, fps: float | None = None
) -> FrameSelection:
    """Keep every n-th frame, and more where the rate is lower than on the average.

    Args:
        times_ns: of all frames of the clip, rising, at least two.
        rate_hz: as in keep_every.
        fps: that the source states; None: of the times.

    Raises:
        ValueError: as keep_every.
    """
    if fps is None:
        fps = (len(times_ns) - 1) * NS_PER_S / float(times_ns[-1] - times_ns[0])
    step = keep_every(fps, rate_hz)
    places = np.arange(0, len(times_ns), step)
    notes: tuple[str, ...] = ()
    longest_ns = _GAP * NS_PER_S / min(DEFAULT_RATE_HZ if rate_hz is None else rate_hz, fps)
    selection, end = [0], len(times_ns) - 1
    for until in [*places[1:].tolist(), end]:
        for place in range(selection[-1] + 1, until):
            if times_ns[place + 1] - times_ns[selection[-1]] > longest_ns:
                selection.append(place)
        if until % step == 0 or times_ns[until] - times_ns[selection[-1]] > longest_ns:
            selection.append(until)
    selection = sorted(set(selection))
    if more := len(selection) - len(places):
        notes = (
            f"its rate varies; {more} frames more than one in {step} are kept, so that none is "
            f"{longest_ns / NS_PER_S:.2g} s after another where there are some between",
        )
    frame_indices = np.array(selection, dtype=np.int64)
    span_ns = float(times_ns[frame_indices[-1]] - times_ns[0])
    rate = (len(frame_indices) - 1) * NS_PER_S / span_ns if more and span_ns else fps / step
    return FrameSelection(frame_indices, step, rate, notes)


def jpeg(image: Bgr) -> bytes:
    """Return a frame as JPEG."""
    return encode_jpeg(image, JPEG_QUALITY)
