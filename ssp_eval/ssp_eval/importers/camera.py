"""The camera of a bag, and the check of its data (METHOD 4.3b): lens, and place on the VUT.

Reads no bag: messages are gathered before the frames, since no reading goes on within another one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]  # scipy has no types

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.names import TF_STATIC
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_eval.importers.findings import Finding, Findings
from ssp_eval.importers.target import CameraFacts

# A forward camera doesn't look further up or down than this; a frame that does is no optical one.
_STEEPEST_RAD = math.radians(45.0)
# The principal point lies within a quarter and three quarters of the picture.
_MIDDLE = (0.25, 0.75)
# fx and fy differ by at most this share of the larger one.
_FOCAL_SHARE = 0.1
_FIELD_OF_VIEW_DEG = (10.0, 170.0)
# A quaternion's norm may be off 1 by this; less than the second isn't worth a word.
_NORM_SHARE = 1e-2
_NORM_SAID = 1e-4
# Places that lie no further apart say the same.
_SAME_M = 0.01
_SAME_RAD = math.radians(0.5)
# More different ways than these through a tree of transforms are refused.
_MOST_CHAINS = 64
_FIX = "name the CameraInfo of this camera as it records, or leave --camera-info out"
_MOUNT = "--mount says the camera's place"
# Turns forward, left, up into forward, right, down.
_ABOUT_X = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class CameraSource:
    """The data of a bag on a camera.

    Args:
        info_topic: of its CameraInfo; None: no lens is asked for.
        info: the message that is valid when the clip begins; None: there is none.
        mounting: declared by a person; None: static transforms say it.
        static: TransformStamped that are valid in the clip, as they were received.
        vut_frame: that the VUT's poses are of.
        ahead_m: how far that lies ahead of the VUT's reference point.
        faces_down: the axes of the VUT's frame are forward, right, down.
    """

    file: Path
    info_topic: str | None
    info: Any
    mounting: Mounting | None
    static: Sequence[Any]
    vut_frame: str
    ahead_m: float
    faces_down: bool = False

    def facts(
        self, optical_frame: str, size_px: tuple[int, int], findings: Findings
    ) -> tuple[CameraFacts, list[str]]:
        """Give what is known of the camera, and what is to be said of it.

        Args:
            optical_frame: that the frames name.
            size_px: width and height of the frames.
            findings: takes what can't be.

        Raises:
            InputError: the topic holds no calibrated camera of frames of this size.
        """
        lens: Intrinsics | None = None
        notes: list[str] = []
        if self.info_topic is not None:
            lens, notes = self._lens(self.info_topic, size_px, findings)
        if lens is None:
            if self.mounting is not None:
                notes.append("camera: its place is of no use without a lens (--camera-info)")
            return CameraFacts(), notes
        if self.mounting is not None:
            return CameraFacts("declared", lens, self.mounting), notes
        mounting, more = self._mounted(optical_frame, findings)
        return CameraFacts("measured", lens, mounting), notes + more

    def _lens(
        self, topic: str, size_px: tuple[int, int], findings: Findings
    ) -> tuple[Intrinsics, list[str]]:
        info = self.info
        if info is None:
            raise InputError(
                "holds no message", file=self.file, field=topic, remedy="leave --camera-info out"
            )
        k = [float(value) for value in info.k]
        if not (all(map(math.isfinite, k)) and k[0] > 0.0 and k[4] > 0.0):
            raise InputError(
                "says that the camera isn't calibrated",
                file=self.file,
                field=f"{topic}.k",
                value=k,
                remedy="leave --camera-info out",
            )
        lens, how = _as_recorded(info, k, size_px)
        if (lens.width_px, lens.height_px) != size_px:
            raise InputError(
                f"is of frames of {lens.width_px}x{lens.height_px} px{how}, the camera's have "
                f"{size_px[0]}x{size_px[1]}",
                file=self.file,
                field=topic,
                remedy="name the CameraInfo of this camera",
            )
        for problem in _impossible(lens, k):
            findings.add(Finding("camera_matrix", problem, _FIX, self.file, f"{topic}.k", value=k))
        bent = [float(value) for value in info.d]
        if not all(map(math.isfinite, bent)):
            problem = "has a distortion that is no number"
            findings.add(
                Finding("camera_matrix", problem, _FIX, self.file, f"{topic}.d", value=bent)
            )
        notes = []
        if how:
            notes.append(
                f"{topic}: K is scaled to the frames{how}: fx {lens.fx_px:g}, fy {lens.fy_px:g}, "
                f"cx {lens.cx_px:g}, cy {lens.cy_px:g}"
            )
        if any(bent):
            notes.append(
                f"{topic}: the lens is distorted; what is projected into its frames ignores it"
            )
        return lens, notes

    def _mounted(self, optical_frame: str, findings: Findings) -> tuple[Mounting | None, list[str]]:
        """Give the camera's place by the static transforms, None where they don't say."""
        vut_frame = self.vut_frame
        if not self.static:
            return None, ["camera: its place on the VUT isn't known (--mount says it)"]
        chains = list(islice(self._chains(optical_frame, (), self._leading()), _MOST_CHAINS + 1))
        if not chains:
            return None, [
                f"camera: {TF_STATIC} doesn't lead from {optical_frame or '(no frame)'} to "
                f"{vut_frame or '(no frame)'}; its place isn't known (--mount says it)"
            ]
        if len(chains) > _MOST_CHAINS:
            findings.add(
                Finding(
                    "camera_places",
                    f"leads from {optical_frame} to {vut_frame} by more than {_MOST_CHAINS} ways",
                    _MOUNT,
                    self.file,
                    TF_STATIC,
                    acceptable=False,
                )
            )
            return None, []
        steps = {id(step): step for chain in chains for step in chain}.values()
        broken = [one for step in steps if (one := self._broken(step)) is not None]
        for finding in broken:
            findings.add(finding)
        if broken:
            return None, []
        notes = [note for step in steps if (note := _normalised(step)) is not None]
        places = [_composed(chain) for chain in chains]
        if (two := self._contradiction(optical_frame, places)) is not None:
            findings.add(two)
            return None, notes
        turn, place = places[-1]
        if self.faces_down:
            turn, place = _ABOUT_X * turn, _ABOUT_X.apply(place)
        x, y, z, w = turn.as_quat().tolist()
        ahead_m = float(place[0]) + self.ahead_m
        mounting = Mounting.of_transform((ahead_m, float(place[1]), float(place[2])), (x, y, z, w))
        if abs(mounting.pitch_down_rad) > _STEEPEST_RAD or mounting.height_m <= 0.0:
            return None, [
                f"camera: by {TF_STATIC} it looks down by "
                f"{math.degrees(mounting.pitch_down_rad):.0f} degrees from a height of "
                f"{mounting.height_m:.2f} m: {optical_frame} is no optical frame (REP 103), or "
                f"{vut_frame} isn't on the ground; its place isn't known (--mount says it)"
            ]
        return mounting, [
            *notes,
            f"camera: its place is that of {TF_STATIC}, heights from {vut_frame}",
        ]

    def _leading(self) -> dict[str, list[Any]]:
        """Return by child frame the transforms that lead to the VUT's, of equal ones the last."""
        steps: dict[tuple[object, ...], Any] = {}
        for step in self.static:
            key = (
                step.header.frame_id,
                step.child_frame_id,
                repr((_place(step), _quaternion(step))),
            )
            steps.pop(key, None)
            steps[key] = step
        frames = {self.vut_frame}
        while (
            more := {
                str(step.child_frame_id)
                for step in steps.values()
                if str(step.header.frame_id) in frames
            }
            - frames
        ):
            frames |= more
        leading: dict[str, list[Any]] = {}
        for step in steps.values():
            if str(step.header.frame_id) in frames:
                leading.setdefault(str(step.child_frame_id), []).append(step)
        return leading

    def _chains(
        self, frame: str, before: tuple[Any, ...], leading: Mapping[str, Sequence[Any]]
    ) -> Iterator[tuple[Any, ...]]:
        """Yield the transforms from a frame up to the VUT's, on each way that there is."""
        if frame == self.vut_frame:
            yield before
            return
        if frame in {str(step.child_frame_id) for step in before}:
            return
        for step in leading.get(frame, ()):
            yield from self._chains(str(step.header.frame_id), (*before, step), leading)

    def _broken(self, step: Any) -> Finding | None:
        """Name a transform that is none."""
        values = (*_place(step), *_quaternion(step))
        norm = math.hypot(*_quaternion(step))
        if not all(map(math.isfinite, values)):
            problem = "has a value that is no number (NaN or infinite)"
        elif abs(norm - 1.0) > _NORM_SHARE:
            problem = f"has a rotation of norm {norm:.3g}, not 1"
        else:
            return None
        return Finding(
            "camera_transform",
            f"{_names(step)} {problem}",
            _MOUNT,
            self.file,
            TF_STATIC,
            value=[round(value, 6) for value in values],
            acceptable=False,
        )

    def _contradiction(
        self, optical_frame: str, places: Sequence[tuple[Rotation, FloatArray]]
    ) -> Finding | None:
        """Name two places of the camera that aren't the same."""
        turn, place = places[-1]
        for other_turn, other in places[:-1]:
            apart_m = float(np.linalg.norm(other - place))
            apart_rad = float((turn.inv() * other_turn).magnitude())
            if apart_m > _SAME_M or apart_rad > _SAME_RAD:
                return Finding(
                    "camera_places",
                    f"gives two places of {optical_frame} on {self.vut_frame}: "
                    f"({_text(other)}) and ({_text(place)}) m, {apart_m:.3f} m and "
                    f"{math.degrees(apart_rad):.1f} degrees apart",
                    _MOUNT,
                    self.file,
                    TF_STATIC,
                    acceptable=False,
                )
        return None


def _as_recorded(info: Any, k: Sequence[float], size_px: tuple[int, int]) -> tuple[Intrinsics, str]:
    """Give the lens of the frames that leave the camera: its region of interest, then binned.

    Returns:
        The lens, and how it came from that of the whole sensor; empty: it is that one.
    """
    roi = info.roi
    whole = roi.width == 0 or roi.height == 0
    x_px, y_px = (0, 0) if whole else (int(roi.x_offset), int(roi.y_offset))
    width_px, height_px = (info.width, info.height) if whole else (int(roi.width), int(roi.height))
    by_x, by_y = max(1, int(info.binning_x)), max(1, int(info.binning_y))

    def binned(length_px: int, by: int, wanted_px: int) -> int:
        # Drivers round up or down.
        return wanted_px if wanted_px in (length_px // by, -(-length_px // by)) else length_px // by

    lens = Intrinsics(
        binned(width_px, by_x, size_px[0]),
        binned(height_px, by_y, size_px[1]),
        k[0] / by_x,
        k[4] / by_y,
        (k[2] - x_px) / by_x,
        (k[5] - y_px) / by_y,
    )
    how = f", binned {by_x}x{by_y}" if by_x * by_y > 1 else ""
    if not whole and (width_px, height_px) != (info.width, info.height):
        how += f", from ({x_px}, {y_px}) of {info.width}x{info.height} px on"
    return lens, how


def _impossible(lens: Intrinsics, k: Sequence[float]) -> list[str]:
    """Say what no camera of these frames has."""
    problems = []
    low, high = _MIDDLE
    across, down = lens.cx_px / lens.width_px, lens.cy_px / lens.height_px
    size = f"{lens.width_px}x{lens.height_px} px"
    # K of half the resolution has it just at the edge.
    if not (low < across < high and low < down < high):
        problems.append(
            f"has the principal point ({lens.cx_px:g}, {lens.cy_px:g}), outside of the middle half "
            f"of {size}: K of another resolution?"
        )
    if abs(lens.fx_px - lens.fy_px) > _FOCAL_SHARE * max(lens.fx_px, lens.fy_px):
        problems.append(f"has fx {lens.fx_px:g} and fy {lens.fy_px:g} px, more than a tenth apart")
    if list(k[6:]) != [0.0, 0.0, 1.0]:
        problems.append("has a last row that isn't 0 0 1")
    view_deg = math.degrees(2.0 * math.atan(lens.width_px / 2.0 / lens.fx_px))
    least, most = _FIELD_OF_VIEW_DEG
    if not least <= view_deg <= most:
        problems.append(
            f"has a field of view of {view_deg:.1f} degrees over {size} (fx {lens.fx_px:g}), "
            f"{least:g} to {most:g} can be"
        )
    return problems


def _place(step: Any) -> tuple[float, float, float]:
    move = step.transform.translation
    return float(move.x), float(move.y), float(move.z)


def _quaternion(step: Any) -> tuple[float, float, float, float]:
    turn = step.transform.rotation
    return float(turn.x), float(turn.y), float(turn.z), float(turn.w)


def _names(step: Any) -> str:
    return f"{step.header.frame_id} to {step.child_frame_id}"


def _normalised(step: Any) -> str | None:
    norm = math.hypot(*_quaternion(step))
    if abs(norm - 1.0) <= _NORM_SAID:
        return None
    return (
        f"{TF_STATIC}: the rotation of {_names(step)} has the norm {norm:.4f}, and was normalised"
    )


def _composed(chain: Sequence[Any]) -> tuple[Rotation, FloatArray]:
    """Compose the transforms from the camera up to the VUT."""
    turn, place = Rotation.identity(), np.zeros(3)
    for step in chain:
        own = Rotation.from_quat(_quaternion(step))
        turn, place = own * turn, own.apply(place) + np.array(_place(step))
    return turn, place


def _text(place: FloatArray) -> str:
    return ", ".join(f"{value:.2f}" for value in place)
