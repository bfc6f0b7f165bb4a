"""Conversion of the axes of third-party poses and twists to those of REP 103.

Poses come out with x east, y north and yaw counter-clockwise, twists along the heading and to its
left. Others count downwards: north-east-down or forward-right-down frames mirror a world that is
taken for the other kind.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_eval.importers.findings import Finding
from ssp_eval.importers.ros_bag import DATUM_FRAME, Poses
from ssp_eval.importers.tracks import Samples

World = Literal["enu", "ned", "frd"]
BodyAxes = Literal["flu", "frd"]
WORLDS: tuple[World, ...] = get_args(World)
BODIES: tuple[BodyAxes, ...] = get_args(BodyAxes)
# Words of a frame's name.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_DOWNWARD = frozenset(("ned", "frd"))


@dataclass(frozen=True)
class Axes:
    """Axes of a topic of poses.

    Args:
        world: of the poses' frame: east, north, up; north, east, down; forward, right, down.
        body: of the child frame: forward, left, up; forward, right, down.
    """

    world: World = "enu"
    body: BodyAxes = "flu"

    @staticmethod
    def of_text(text: str) -> Axes:
        """Give the axes of WORLD or WORLD/BODY; raises ValueError for other words."""
        first, sign, second = text.partition("/")
        usual: BodyAxes = "flu" if first == "enu" else "frd"
        for world in WORLDS:
            for body in BODIES:
                if (first, second or usual) == (world, body) and bool(sign) == bool(second):
                    return Axes(world, body)
        raise ValueError(f"give {', '.join(WORLDS)}, or one with /{' or /'.join(BODIES)} behind it")

    @property
    def text(self) -> str:
        return f"{self.world}/{self.body}"

    def vector(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bring a vector of the poses' frame to east and north."""
        if self.world == "ned":
            return y, x
        return (x, -y) if self.world == "frd" else (x, y)

    def yaw(self, yaw_rad: FloatArray) -> FloatArray:
        """Bring a yaw to counter-clockwise from east."""
        if self.world == "ned":
            return math.pi / 2.0 - yaw_rad
        return -yaw_rad if self.world == "frd" else yaw_rad


def unstated_axes(
    file: Path, topics: Mapping[str, Poses], stated: Mapping[str, Axes]
) -> list[Finding]:
    """Name the topics whose frames are named as if their axes led downwards, and are not stated.

    Args:
        file: the bag.
        topics: poses by id.
        stated: axes by id.
    """
    findings = []
    for name, poses in topics.items():
        frames = (poses.frame_id, poses.child_frame_id)
        if name in stated or poses.frame_id == DATUM_FRAME:
            continue
        for frame in frames:
            words = {word.lower() for word in _WORD.findall(frame)}
            if not words.isdisjoint(_DOWNWARD):
                findings.append(
                    Finding(
                        "axes",
                        f"its frame is named {frame!r}, as if its axes led downwards; taken as "
                        "those of REP 103 the world would be mirrored",
                        f"state its axes with --axes {name}=ned (north, east, down), "
                        f"{name}=frd (forward, right, down) or {name}=enu (as REP 103 has them)",
                        file,
                        poses.times.topic,
                        value=" of ".join(frames),
                        acceptable=False,
                    )
                )
                break
    return findings


def with_axes(poses: Poses, axes: Axes | None, twist_in_parent: bool | None) -> Poses:
    """Bring poses and twists to the axes of REP 103.

    Args:
        poses: of one topic.
        axes: as a person states them; None: those of REP 103.
        twist_in_parent: a twist is along the axes of the poses' frame, as a person states it; None:
            as its child frame says (REP 105, nav_msgs).
    """
    if poses.frame_id == DATUM_FRAME:
        return poses
    notes = list(poses.notes)
    topic, frame, child = poses.times.topic, poses.frame_id, poses.child_frame_id
    columns = dict(poses.samples.columns)
    if axes is not None:
        columns["x_m"], columns["y_m"] = axes.vector(columns["x_m"], columns["y_m"])
        columns["yaw_rad"] = axes.yaw(columns["yaw_rad"])
        notes.append(f"{topic}: its axes are stated as {axes.text}")
    if "left_mps" in columns:
        axes = axes or Axes()
        by_name = bool(child) and child == frame
        if twist_in_parent or (by_name and twist_in_parent is None):
            x, y = axes.vector(columns["speed_mps"], columns["left_mps"])
            c, s = np.cos(columns["yaw_rad"]), np.sin(columns["yaw_rad"])
            columns["speed_mps"], columns["left_mps"] = c * x + s * y, c * y - s * x
            downwards = axes.world != "enu"
            notes.append(f"{topic}: speeds are in {frame}, and were turned into the heading")
        else:
            downwards = axes.body == "frd"
            if downwards:
                columns["left_mps"] = -columns["left_mps"]
            if not child:
                notes.append(
                    f"{topic}: names no child frame; speeds are taken as along the heading"
                )
        if downwards:
            columns["yaw_rate_radps"] = -columns["yaw_rate_radps"]
        if not np.isfinite(columns["left_mps"]).all():
            del columns["left_mps"]  # nobody said it
    samples = Samples(poses.samples.stamps_ns, columns, poses.samples.source)
    return replace(poses, samples=samples, notes=tuple(notes))
