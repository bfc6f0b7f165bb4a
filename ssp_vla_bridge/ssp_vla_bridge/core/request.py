"""One question to a model, and the checks that a question must pass before it is asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, field
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np

from ssp_core.hashing import sha256_bytes
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.task import TASK, DrivingTask

_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_AT_ONCE = 4  # pictures that are decoded side by side


@dataclass(frozen=True)
class Frame:
    """One forward-camera image.

    Args:
        stamp_ns: time of exposure, ns.
        jpeg: the compressed image as the camera gave it.
    """

    stamp_ns: int
    jpeg: bytes

    @cached_property
    def sha256(self) -> str:
        """Hash of the picture, worked out once: it stands in keys, questions and file names."""
        return sha256_bytes(self.jpeg)


@dataclass(frozen=True)
class EgoSample:
    """The VUT at one time, in the ego frame at the request's time (x forward, y left).

    Args:
        t_s: time relative to the request's, s, <= 0.
        x_m: m, forward.
        y_m: m, to the left.
        yaw_rad: rad, + is left.
        speed_mps: m/s along the heading.
        yaw_rate_radps: rad/s, + is left.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True)
class CameraGeometry:
    """Pinhole camera without distortion; what is not known of its mount is None.

    Args:
        fx_px: focal length along the image's width, px.
        fy_px: focal length along the image's height, px.
        cx_px: principal point from the left, px.
        cy_px: principal point from the top, px.
        width_px: image width, px.
        height_px: image height, px.
        height_m: optical centre above the ground, m.
        pitch_down_rad: rad, + looks down.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int
    height_m: float | None = None
    pitch_down_rad: float | None = None


@dataclass(frozen=True)
class Request:
    """One question; it holds nothing later than ``stamp_ns``.

    Args:
        request_id: given back with the answer.
        stamp_ns: the time that the answer is about, ns.
        frames: oldest first, the last one at or before stamp_ns.
        camera: geometry of all frames, None when it is not known.
        history: oldest first, the last sample at t = 0; empty when it is not known.
        ego_provenance: where the history comes from: ``measured``, ``declared`` or ``unknown``.
        task: what is asked.
        previous: the model's own last answer about the same clip, for interfaces that carry state
            from answer to answer (interfaces.py); a bridge keeps none itself, so that an answer
            depends on its request only.
    """

    request_id: str
    stamp_ns: int
    frames: tuple[Frame, ...]
    camera: CameraGeometry | None = None
    history: tuple[EgoSample, ...] = ()
    ego_provenance: str = "unknown"
    task: DrivingTask = field(default=TASK)
    previous: Response | None = None

    @property
    def ego_known(self) -> bool:
        """True when the request says how the VUT moved."""
        return bool(self.history) and self.ego_provenance != "unknown"


def request_problems(request: Request) -> tuple[str, ...]:
    """What makes a request unanswerable, one clause each; nothing for a good one.

    Frames are decoded at an eighth of their size, which finds what can't be decoded at a
    fraction of the cost.
    """
    problems = []
    if not request.frames:
        problems.append("it has no frames")
    decoded = _all_decode([frame.jpeg for frame in request.frames])
    for index, (frame, fine) in enumerate(zip(request.frames, decoded, strict=True)):
        if not fine:
            problems.append(f"frames[{index}] is no whole JPEG image ({len(frame.jpeg)} bytes)")
    stamps = [frame.stamp_ns for frame in request.frames]
    if any(after <= before for before, after in pairwise(stamps)):
        problems.append("the frames' stamps don't rise")
    if stamps and stamps[-1] > request.stamp_ns:
        problems.append("the last frame is later than the request's stamp")
    if not all(math.isfinite(value) for sample in request.history for value in astuple(sample)):
        problems.append("the history holds a number that isn't finite")
    times = [sample.t_s for sample in request.history]
    if any(not before < after for before, after in pairwise(times)):
        problems.append("the history's times don't rise")
    if times and times[-1] > 1e-6:
        problems.append("the history goes on after the request's time")
    task = request.task
    step_s, horizon_s = task.trajectory_step_s, task.trajectory_horizon_s
    if not (math.isfinite(step_s) and math.isfinite(horizon_s) and 0.01 <= step_s <= horizon_s):
        problems.append("the task's trajectory step and horizon are no times to plan for")
    elif horizon_s > 60.0:
        problems.append("the task's trajectory horizon is longer than 60 s")
    return tuple(problems)


def _all_decode(jpegs: Sequence[bytes]) -> list[bool]:
    """Which pictures decode. OpenCV gives the interpreter free, so several are tried at a time."""
    if len(jpegs) < 2:
        return [_decodes(jpeg) for jpeg in jpegs]
    with ThreadPoolExecutor(min(len(jpegs), _AT_ONCE)) as pool:
        return list(pool.map(_decodes, jpegs))


def _decodes(jpeg: bytes) -> bool:
    # A cut-off JPEG decodes to a picture with a grey rest, so its end marker is asked for too;
    # some cameras pad with zeros after it.
    if not jpeg.startswith(_JPEG_START) or not jpeg.rstrip(b"\0").endswith(_JPEG_END):
        return False
    data = np.frombuffer(jpeg, dtype=np.uint8)
    try:
        return cv2.imdecode(data, cv2.IMREAD_REDUCED_GRAYSCALE_8) is not None
    except cv2.error:
        return False
