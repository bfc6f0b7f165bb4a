"""From a video file to a bag directory that is whole or not there."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core import names
from ssp_core.bag import BagWriter
from ssp_core.bag.qos import offered_qos
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import make_folder
from ssp_core.hashing import sha256_file
from ssp_core.video import Video
from ssp_eval.import_video import messages
from ssp_eval.import_video.options import (
    ATTACHMENT,
    ImportOptions,
    import_record,
    keep_every,
    output_size,
)

JPEG_QUALITY = 90
STATE_STEP_NS = 20_000_000
IMAGE = names.absolute(names.CAMERA_IMAGE)
INFO = names.absolute(names.CAMERA_INFO)
MOUNT = names.absolute(names.CAMERA_MOUNT)
STATE = names.absolute(names.state_topic(names.VUT_ID))


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """What was imported.

    Args:
        bag: the directory.
        frames: kept.
        keep_every: every n-th source frame was kept.
        rate_hz: of the kept frames.
        duration_s: clip time of the last frame.
        width_px: of the stored frames.
        height_px: of the stored frames.
        record: the content of import.json.
    """

    bag: Path
    frames: int
    keep_every: int
    rate_hz: float
    duration_s: float
    width_px: int
    height_px: int
    record: dict[str, object]


def import_clip(
    options: ImportOptions, advance: Callable[[int], None] = lambda _: None
) -> ImportSummary:
    """Makes the bag.

    Args:
        options: what to import.
        advance: called with the number of frames kept since the last call.

    Raises:
        InputError: source, crop or output are not usable; nothing is left behind.
    """
    if options.out.exists():
        raise InputError(
            "exists already", file=options.out, remedy="name a new directory with --out"
        )
    with Video(options.video) as video:
        step = _keep_every(video, options)
        make_folder(options.out.parent)
        scratch = Path(tempfile.mkdtemp(dir=options.out.parent, prefix=f".{options.out.name}."))
        try:
            with BagWriter(scratch / "bag", name=f"{options.out.name}_0") as writer:
                summary = _write(writer, video, options, step, advance)
            (scratch / "bag").rename(options.out)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return summary


def _keep_every(video: Video, options: ImportOptions) -> int:
    length_s = video.info.frames / video.info.fps
    last_s = options.start_s if options.end_s is None else options.end_s
    if video.info.frames and last_s > length_s + 1.0 / video.info.fps:
        raise _outside(options, length_s)
    try:
        return keep_every(video.info.fps, options.rate_hz)
    except ValueError as error:
        raise InputError(str(error), file=options.video, field="--rate") from error


def _outside(options: ImportOptions, length_s: float) -> InputError:
    end = "on" if options.end_s is None else f"to {options.end_s:g} s"
    return InputError(
        f"the crop from {options.start_s:g} s {end} lies beyond the video, in part or wholly",
        file=options.video,
        remedy=f"the video is {length_s:.3f} s long",
    )


def _write(
    writer: BagWriter,
    video: Video,
    options: ImportOptions,
    step: int,
    advance: Callable[[int], None],
) -> ImportSummary:
    width_px, height_px = output_size(video.info, options.max_width_px)
    writer.add_topic(IMAGE, messages.IMAGE_TYPE, offered_qos(20))
    start_s, stamp_ns, count = 0.0, 0, 0
    for frame in video.frames(options.start_s, options.end_s, step):
        if count == 0:
            start_s = frame.time_s
            _write_camera(writer, options, width_px, height_px)
        stamp_ns = seconds_to_ns(frame.time_s - start_s)
        jpeg = _jpeg(frame.image, width_px, height_px)
        writer.write(IMAGE, messages.image(stamp_ns, jpeg), stamp_ns, stamp_ns, count + 1)
        count += 1
        advance(1)
    end_s = video.reached_s if options.end_s is None else options.end_s
    if count == 0 or video.reached_s < end_s - 0.5 / video.info.fps:
        raise _outside(options, video.reached_s)
    _write_states(writer, options, stamp_ns)
    record = import_record(options, video.info, sha256_file(options.video), start_s, end_s)
    data = json.dumps(record, indent=1, allow_nan=False).encode() + b"\n"
    writer.attach(ATTACHMENT, data, "application/json")
    return ImportSummary(
        bag=options.out,
        frames=count,
        keep_every=step,
        rate_hz=video.info.fps / step,
        duration_s=ns_to_seconds(stamp_ns),
        width_px=width_px,
        height_px=height_px,
        record=record,
    )


def _write_camera(writer: BagWriter, options: ImportOptions, width_px: int, height_px: int) -> None:
    camera, latched = options.camera, offered_qos(20, transient_local=True)
    if camera.hfov_deg is not None:
        writer.add_topic(INFO, messages.INFO_TYPE, latched)
        info = messages.camera_info(0, width_px, height_px, camera.hfov_deg)
        writer.write(INFO, info, 0, 0, 1)
    if camera.height_m is not None and camera.pitch_down_rad is not None:
        writer.add_topic(MOUNT, messages.MOUNT_TYPE, latched)
        mount = messages.mount(0, camera.height_m, camera.pitch_down_rad)
        writer.write(MOUNT, mount, 0, 0, 1)


def _write_states(writer: BagWriter, options: ImportOptions, last_ns: int) -> None:
    """The declared motion at 50 Hz, up to the last frame."""
    if options.ego_speed_mps is None:
        return
    writer.add_topic(STATE, messages.STATE_TYPE, offered_qos(50))
    for k in range(last_ns // STATE_STEP_NS + 1):
        stamp_ns = k * STATE_STEP_NS
        state = messages.vut_state(stamp_ns, k + 1, options.ego_speed_mps)
        writer.write(STATE, state, stamp_ns, stamp_ns, k + 1)


def _jpeg(image: NDArray[np.uint8], width_px: int, height_px: int) -> NDArray[np.uint8]:
    if image.shape[:2] != (height_px, width_px):
        resized = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
        image = np.asarray(resized, dtype=np.uint8)
    encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not encoded:
        raise RuntimeError(f"OpenCV could not encode a frame of {width_px}x{height_px} px")
    return np.asarray(data, dtype=np.uint8).ravel()
