"""The seeing baseline: classical computer vision on the frames, no weights, deterministic.

It is a baseline and no oracle: a flat, straight road whose surface runs along the direction of
travel is assumed, and what is not the surface's colour is taken for a thing on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_vla_bridge.backend import OptionFree
from ssp_vla_bridge.backends.phrases import (
    action_sentence,
    point_times,
    scene_text,
    travelled_m,
    waypoints,
)
from ssp_vla_bridge.backends.vision.detection import detect_objects
from ssp_vla_bridge.backends.vision.ground import (
    ByteImage,
    GroundPlane,
    foreign_pixels,
    ground_plane,
    horizon_row,
    learn_surface,
    strip_index,
    to_ycc,
)
from ssp_vla_bridge.backends.vision.situation import CAMERA_TO_BUMPER_M, Situation, judge
from ssp_vla_bridge.backends.vision.tracking import Track, track_objects
from ssp_vla_bridge.messages import Answer, Frame, NativeArray, Request

WORK_WIDTH_PX = 720
LOOK_BACK_S = (0.9, 0.6, 0.3, 0.0)
_BLIND_MEAN = 14.0
_BLIND_SPREAD = 4.0
_STANDING_MPS = 0.5
_STOP_BELOW_MPS = 4.0
_STOP_WITHIN_M = 8.0
_ACCELERATION_MPS2 = {"stop": -6.0, "decelerate": -2.0, "maintain": 0.0, "accelerate": 1.0}
_BLIND_SENTENCE = "I can't see anything in the picture."


@dataclass(frozen=True)
class Perception:
    """The intermediate results from the frames, for people who want to look at them.

    Args:
        blind: the newest frame shows nothing.
        tracks: in the newest ego frame.
    """

    blind: bool
    plane: GroundPlane
    tracks: tuple[Track, ...]
    looked_at: int


class OpencvBaseline(OptionFree):
    """Sees, judges, and says what it does; see the modules of ``vision`` for how."""

    name = "opencv_baseline"
    model_id = f"ssp/opencv_baseline/1 (OpenCV {cv2.__version__})"

    def answer(self, request: Request) -> Answer:
        sight = look(request)
        speed = request.history[-1].speed_mps if request.ego_known else None
        situation = judge(sight.tracks, speed)
        lon_action = choose_action(situation, speed, sight.blind)
        scene = scene_text(
            situation.objects, situation.position, situation.motion, situation.conflict
        )
        if sight.blind:
            scene = _BLIND_SENTENCE
        arrays: tuple[NativeArray, ...] = ()
        if speed is not None:
            acceleration = _ACCELERATION_MPS2[lon_action]
            points = [
                (travelled_m(time_s, max(0.0, speed), acceleration), 0.0)
                for time_s in point_times(request.task)
            ]
            arrays = (waypoints(points, request.task),)
        decoding = {
            "frames_looked_at": sight.looked_at,
            "work_width_px": sight.plane.width_px,
            "assumed": [*sight.plane.assumed, f"camera_to_bumper_m={CAMERA_TO_BUMPER_M:g}"],
            "tracks": len(sight.tracks),
        }
        return Answer(f"{scene} {action_sentence(lon_action, 'straight')}", arrays, decoding)


def look(request: Request) -> Perception:
    """Return the road users and other things in a request's frames."""
    frames = choose_frames(request.frames)
    newest = _decode(frames[-1])
    height, width = newest.shape[:2]
    scale = min(1.0, WORK_WIDTH_PX / width)
    size = (round(width * scale), round(height * scale))
    small = _resized(newest, size)
    blind = float(small.mean()) < _BLIND_MEAN or float(small.std()) < _BLIND_SPREAD
    images = [] if blind else [_resized(_decode(frame), size) for frame in frames[:-1]]
    images.append(small)
    camera = request.camera
    has_pitch = camera is not None and camera.pitch_down_rad is not None
    plane = ground_plane(camera, (width, height), scale, None if has_pitch else horizon_row(images))
    if blind:
        return Perception(True, plane, (), 1)
    ycc = [to_ycc(image) for image in images]
    masks = foreign_pixels(ycc, learn_surface(ycc, plane), strip_index(plane))
    detections = [
        (ns_to_seconds(frame.stamp_ns - request.stamp_ns), detect_objects(image, mask, plane))
        for frame, image, mask in zip(frames, ycc, masks, strict=True)
    ]
    history = request.history if request.ego_known else ()
    return Perception(False, plane, tuple(track_objects(detections, history)), len(frames))


def choose_frames(frames: Sequence[Frame]) -> list[Frame]:
    """Return the newest frame and those nearest to LOOK_BACK_S before the request, oldest first."""
    newest_ns = frames[-1].stamp_ns
    indices = {
        min(
            range(len(frames)),
            key=lambda i: abs(ns_to_seconds(newest_ns - frames[i].stamp_ns) - back_s),
        )
        for back_s in LOOK_BACK_S
    }
    return [frames[i] for i in sorted(indices)]


def choose_action(situation: Situation, speed_mps: float | None, blind: bool) -> str:
    """Return the longitudinal action: slow down for a conflict, stop if slow and close enough."""
    standing = speed_mps is not None and speed_mps <= _STANDING_MPS
    must_react = blind or situation.conflict in ("potential", "active")
    if not must_react:
        return "accelerate" if standing else "maintain"
    slow = speed_mps is not None and speed_mps <= _STOP_BELOW_MPS
    near = blind or (situation.distance_m is not None and situation.distance_m < _STOP_WITHIN_M)
    return "stop" if standing or (slow and near) else "decelerate"


def _decode(frame: Frame) -> ByteImage:
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"the frame at {frame.stamp_ns} ns can't be decoded")
    return np.asarray(image, dtype=np.uint8)


def _resized(image: ByteImage, size: tuple[int, int]) -> ByteImage:
    if image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
