"""Frames and camera of an imported recording: which are kept, in which size, seen how."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from ssp_core.bag.images import Bgr, encode_jpeg
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.writer import BagWriter
from ssp_core.names import TF_STATIC
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_core.world.transforms import TF_TYPE, encode_transform, encode_transforms, mount, of_camera
from ssp_eval.imports import messages
from ssp_eval.imports.target import INFO, MOUNT
from ssp_eval.recordings.import_record import ImportedCamera

JPEG_QUALITY = 90
# Fewer frames a second than this are never kept where a source has more.
DEFAULT_RATE_HZ = 10.0


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

    def scaled(self, width_px: int, height_px: int) -> CameraFacts:
        """The camera of frames that were scaled to this size."""
        lens = self.lens
        if lens is None or (lens.width_px, lens.height_px) == (width_px, height_px):
            return self
        x, y = width_px / lens.width_px, height_px / lens.height_px
        # Pixel (0, 0) is the centre of the first pixel, half a pixel from the image's border.
        scaled = Intrinsics(
            width_px, height_px, lens.fx_px * x, lens.fy_px * y,
            (lens.cx_px + 0.5) * x - 0.5, (lens.cy_px + 0.5) * y - 0.5,
        )  # fmt: skip
        return replace(self, lens=scaled)

    @property
    def record(self) -> ImportedCamera:
        """What import.json says of it."""
        lens, mounting = self.lens, self.mounting
        half = None if lens is None else math.atan(lens.width_px / 2 / lens.fx_px)
        return ImportedCamera(
            provenance=self.provenance,
            hfov_deg=None if half is None else round(math.degrees(2 * half), 9),
            height_m=None if mounting is None else mounting.height_m,
            pitch_down_rad=None if mounting is None else mounting.pitch_down_rad,
        )

    def write(self, writer: BagWriter, stamp_ns: int) -> None:
        """CameraInfo and mount, as far as they are known."""
        latched = offered_qos(20, transient_local=True)
        if self.lens is not None:
            writer.add_topic(INFO, messages.INFO_TYPE, latched)
            writer.write(INFO, messages.camera_info(stamp_ns, self.lens), stamp_ns, stamp_ns, 1)
        if self.mounting is not None:
            writer.add_topic(MOUNT, messages.MOUNT_TYPE, latched)
            mounted = encode_transform(mount(self.mounting, stamp_ns))
            writer.write(MOUNT, mounted, stamp_ns, stamp_ns, 1)
            writer.add_topic(TF_STATIC, TF_TYPE, offered_qos(1, transient_local=True))
            fixed = encode_transforms(of_camera(self.mounting))
            writer.write(TF_STATIC, fixed, stamp_ns, stamp_ns, 1)


def pinhole(width_px: int, height_px: int, hfov_deg: float) -> Intrinsics:
    """Square pixels, the principal point in the middle: fx = fy = (w / 2) / tan(hfov / 2)."""
    focal_px = width_px / 2 / math.tan(math.radians(hfov_deg) / 2)
    return Intrinsics(width_px, height_px, focal_px, focal_px, width_px / 2, height_px / 2)


def keep_every(fps: float, rate_hz: float | None) -> int:
    """n, where every n-th frame is kept: the largest that leaves at least the wanted rate.

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


def output_size(width_px: int, height_px: int, max_width_px: int | None) -> tuple[int, int]:
    """Width and height of the stored frames, px, aspect ratio kept."""
    if max_width_px is None or width_px <= max_width_px:
        return width_px, height_px
    return max_width_px, max(1, round(height_px * max_width_px / width_px))


def jpeg(image: Bgr, width_px: int, height_px: int) -> bytes:
    """A frame in this size as JPEG."""
    if image.shape[:2] != (height_px, width_px):
        resized = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
        image = np.asarray(resized, dtype=np.uint8)
    return encode_jpeg(image, JPEG_QUALITY)
