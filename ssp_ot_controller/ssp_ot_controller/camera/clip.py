"""Makes a synthetic clip, ``NAME.mp4``, and the ground truth beside it, ``NAME.truth.json``.

The clip stands in for a generated source video: like one, it is imported and evaluated as bare
frames; the truth file is for labels and for the K* that `ssp spec clip` binds to the clip.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import HostError
from ssp_core.files.writing import write_json
from ssp_core.motion.state import ObjectState
from ssp_ot_controller.camera.frames import Odometer
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene
from ssp_ot_controller.camera.storyboards import LaneCounts, Storyboard, storyboard

TRUTH_SCHEMA = "ssp.truth/1"
GENERATOR = "ssp-clip/1"
_RECORD = (
    "object_id",
    "object_class",
    "role",
    "stamp_ns",
    "x_m",
    "y_m",
    "yaw_rad",
    "speed_mps",
    "acceleration_mps2",
    "yaw_rate_radps",
    "size",
)
_SIZE = ("front_m", "rear_m", "width_m", "height_m")


def board_of(kind: str, seed: int, same: int, opposite: int) -> Storyboard:
    """Return the storyboard of a kind on a road with so many lanes with and against the VUT.

    Raises:
        InputError: the kind isn't drawn on such a road.
    """
    return storyboard(kind, seed, LaneCounts(same, opposite))


def truth_path(video: Path) -> Path:
    """Name the truth file of a video: ``clip.truth.json`` for ``clip.mp4``."""
    return video.with_suffix(".truth.json")


def object_record(state: ObjectState) -> dict[str, Any]:
    """Return plain fields of a state as in the truth file; class and role by their words."""
    record = asdict(state)
    record |= {"object_class": state.object_class.word, "role": state.role.name.lower()}
    record["size"] = {key: record["size"][key] for key in _SIZE}
    return {key: record[key] for key in _RECORD}


def truth(board: Storyboard) -> dict[str, Any]:
    """Return the truth file's content: states per frame, ego speed, road, camera and look."""
    times = board.times()
    camera = board.camera.model_dump(mode="json") | {"provenance": "declared"}
    return {
        "schema": TRUTH_SCHEMA,
        "scenario": board.scenario,
        "generator": GENERATOR,
        "domain": "synthetic",
        "seed": board.seed,
        "fps": board.fps,
        "frame_count": len(times),
        "ego_speed_mps": [{"t_s": t, "speed_mps": board.vut.state(t).speed_mps} for t in times],
        "frames": [
            {"t_s": t, "objects": [object_record(s) for s in board.states(t)]} for t in times
        ],
        "road": board.road.model_dump(mode="json"),
        "camera": camera,
        "look": board.look.model_dump(mode="json"),
    }


def write_clip(board: Storyboard, video: Path, advance: Callable[[], None] = lambda: None) -> None:
    """Draw the clip into an MP4 file and write its truth file beside it.

    Args:
        board: of the clip.
        video: the file to write; its folder is made.
        advance: called after each frame.

    Raises:
        HostError: OpenCV can't write MP4 here.
    """
    video.parent.mkdir(parents=True, exist_ok=True)
    size = (board.camera.width_px, board.camera.height_px)
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(video), code, board.fps, size)
    if not writer.isOpened():
        raise HostError(
            f"{video}: OpenCV can't write MP4 (mp4v) here; check folder and OpenCV build"
        )
    odometer, indicators = Odometer(), Indicators(board.road)
    try:
        for index, t_s in enumerate(board.times()):
            states = board.states(t_s)
            odometer.update(states)
            blinking = indicators.update(states, seconds_to_ns(t_s))
            scene = Scene(board.road, board.vut.state(t_s), states, odometer.snapshot(), blinking)
            writer.write(render(scene, board.look, board.camera, index, board.seed))
            advance()
    finally:
        writer.release()
    write_json(truth_path(video), truth(board))
