"""The camera of a foreign bag: its CameraInfo, and where /tf_static says that it sits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]  # scipy has no types

from ssp_core.errors import InputError
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_eval.imports.pictures import CameraFacts
from ssp_eval.imports.ros_bag import TF_STATIC, SourceBag

INFO_TYPE = "sensor_msgs/msg/CameraInfo"
TF_TYPE = "tf2_msgs/msg/TFMessage"
# A forward camera doesn't look further up or down than this; a frame that does is no optical one.
_STEEPEST_RAD = math.radians(45.0)


def camera_facts(
    bag: SourceBag,
    info_topic: str | None,
    mounting: Mounting | None,
    optical_frame: str,
    vut_frame: str,
    ahead_m: float,
    size_px: tuple[int, int],
) -> tuple[CameraFacts, list[str]]:
    """What is known of the camera, and what is to be said of it.

    Args:
        bag: open.
        info_topic: of its CameraInfo, None: none.
        mounting: declared, None: look into /tf_static.
        optical_frame: that the frames name.
        vut_frame: that the VUT's poses are of.
        ahead_m: how far that lies ahead of the VUT's reference point.
        size_px: width and height of the frames.

    Raises:
        InputError: the topic holds no calibrated camera of frames of this size.
    """
    lens: Intrinsics | None = None
    notes: list[str] = []
    if info_topic is not None:
        lens, notes = _lens(bag, info_topic, size_px)
    if lens is None:
        if mounting is not None:
            notes.append("camera: its place is of no use without a lens (--camera-info)")
        return CameraFacts(), notes
    if mounting is not None:
        return CameraFacts("declared", lens, mounting), notes
    mounting, more = _mounted(bag, optical_frame, vut_frame, ahead_m)
    return CameraFacts("measured", lens, mounting), notes + more


def _lens(bag: SourceBag, topic: str, size_px: tuple[int, int]) -> tuple[Intrinsics, list[str]]:
    bag.check_topic(topic, (INFO_TYPE,))
    info: Any = next((message for _, message in bag.decoded(topic)), None)
    if info is None:
        raise InputError("holds no message", file=bag.path, field=topic,
                         remedy="leave --camera-info out")  # fmt: skip
    if (info.width, info.height) != size_px:
        raise InputError(
            f"is of frames of {info.width}x{info.height} px, the camera's have "
            f"{size_px[0]}x{size_px[1]}",
            file=bag.path, field=topic, remedy="name the CameraInfo of this camera",
        )  # fmt: skip
    k = [float(value) for value in info.k]
    if not (all(map(math.isfinite, k)) and k[0] > 0.0 and k[4] > 0.0):
        raise InputError("says that the camera isn't calibrated", file=bag.path, field=f"{topic}.k",
                         value=k, remedy="leave --camera-info out")  # fmt: skip
    notes = []
    if np.any(np.asarray(info.d, dtype=float)):
        notes.append(
            f"{topic}: the lens is distorted; what is projected into its frames ignores it"
        )
    return Intrinsics(size_px[0], size_px[1], k[0], k[4], k[2], k[5]), notes


def _mounted(
    bag: SourceBag, optical_frame: str, vut_frame: str, ahead_m: float
) -> tuple[Mounting | None, list[str]]:
    """The camera's place by the static transforms, None where they don't say."""
    if bag.types.get(TF_STATIC) != TF_TYPE:
        return None, ["camera: its place on the VUT isn't known (--mount says it)"]
    parents: dict[str, tuple[str, Any]] = {}
    for _, message in bag.decoded(TF_STATIC):
        for one in message.transforms:
            parents[str(one.child_frame_id)] = (str(one.header.frame_id), one.transform)
    turn, place, frame = Rotation.identity(), np.zeros(3), optical_frame
    seen = set[str]()
    while frame != vut_frame:
        if frame not in parents or frame in seen:
            return None, [
                f"camera: {TF_STATIC} doesn't lead from {optical_frame or '(no frame)'} to "
                f"{vut_frame or '(no frame)'}; its place isn't known (--mount says it)"
            ]
        seen.add(frame)
        frame, step = parents[frame]
        own = Rotation.from_quat([step.rotation.x, step.rotation.y, step.rotation.z,
                                  step.rotation.w])  # fmt: skip
        move = np.array([step.translation.x, step.translation.y, step.translation.z])
        turn, place = own * turn, own.apply(place) + move
    x, y, z, w = turn.as_quat().tolist()
    mounting = Mounting.of_transform((float(place[0]) + ahead_m, float(place[1]), float(place[2])),
                                     (x, y, z, w))  # fmt: skip
    if abs(mounting.pitch_down_rad) > _STEEPEST_RAD or mounting.height_m <= 0.0:
        return None, [
            f"camera: by {TF_STATIC} it looks down by "
            f"{math.degrees(mounting.pitch_down_rad):.0f} degrees from a height of "
            f"{mounting.height_m:.2f} m: {optical_frame} is no optical frame (REP 103), or "
            f"{vut_frame} isn't on the ground; its place isn't known (--mount says it)"
        ]
    return mounting, [f"camera: its place is that of {TF_STATIC}, heights from {vut_frame}"]
