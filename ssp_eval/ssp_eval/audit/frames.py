"""Frames at the same phases of all recordings, with outlines that are drawn after the fact."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

import cv2
import numpy as np

from ssp_core.bag.frames import Frames
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.world.camera import View, object_corners, project
from ssp_eval.audit.examined import Examined
from ssp_eval.audit.measure import Phases
from ssp_eval.report import svg
from ssp_eval.report.pictures import jpeg_uri

# Columns of the page: clip times that every recording has, if its phases could be located.
COLUMNS = ("start", "trigger", "conflict", "in the conflict", "resolution")
WIDTH_PX = 640
_IMAGE = absolute(CAMERA_IMAGE)
_NEAR_M = 0.5
_GROUND_STEPS = 12


@dataclass(frozen=True)
class Picture:
    """One frame of one recording.

    Args:
        column: of COLUMNS.
        at_s: clip time of the instant, None: the phase isn't located, or there is no frame.
        phi: φ of that instant, None: not known.
        t_s: clip time of the frame, None: likewise.
        uri: data URI, empty without a frame.
        overlay: SVG, empty where there are no states.
    """

    column: str
    at_s: float | None = None
    phi: float | None = None
    t_s: float | None = None
    uri: str = ""
    overlay: str = ""


def column_times(phases: Phases | None) -> dict[str, float | None]:
    """Clip time of each column."""
    if phases is None:
        return dict.fromkeys(COLUMNS)
    middle_s = None
    if phases.conflict_s is not None and phases.resolution_s is not None:
        middle_s = (phases.conflict_s + phases.resolution_s) / 2.0
    times = (phases.start_s, phases.trigger_s, phases.conflict_s, middle_s, phases.resolution_s)
    return dict(zip(COLUMNS, times, strict=True))


def frame_at(frames_s: Sequence[float], t_s: float) -> int:
    """Index of the frame that shows an instant: the newest one then, give or take half a frame.

    A K* gives times in whole milliseconds, and a frame that begins there may come a little later.

    Args:
        frames_s: clip times of the frames, in order, at least one.
        t_s: clip time of the instant.
    """
    gaps_s = [after - before for before, after in pairwise(frames_s)]
    half_s = median(gaps_s) / 2.0 if gaps_s else 0.0
    return max(0, bisect_right(frames_s, t_s + half_s - 1e-6) - 1)


def pictures(one: Examined) -> list[Picture]:
    """The pictures of a recording, one per column.

    Raises:
        InputError: a frame in the bag is no picture.
    """
    wanted = column_times(one.phases)
    frames = one.recording.frames_s
    chosen = {
        column: frame_at(frames, t_s)
        for column, t_s in wanted.items()
        if t_s is not None and frames
    }
    found = _fetch(one, sorted(set(chosen.values())))
    result = []
    for column, t_s in wanted.items():
        if column not in chosen or chosen[column] not in found or t_s is None:
            result.append(Picture(column))
            continue
        index = chosen[column]
        phi = None
        if one.phases is not None and one.phases.end_s > one.phases.start_s:
            phi = (t_s - one.phases.start_s) / (one.phases.end_s - one.phases.start_s)
        uri = jpeg_uri(found[index], one.recording.path, WIDTH_PX)
        result.append(Picture(column, t_s, phi, frames[index], uri, _overlay(one, index)))
    return result


def _fetch(one: Examined, indices: Sequence[int]) -> dict[int, bytes]:
    """JPEG by index into the recording's frames."""
    frames = one.recording.frames_s
    start_ns = one.recording.provenance.session_start_ns
    index_of: dict[int, int] = {}
    with BagReader(one.recording.path) as bag:
        for message in bag.messages([_IMAGE]):
            stamp_ns = peek_stamp_ns(message.data)
            if start_ns is None:
                start_ns = stamp_ns
            t_s = ns_to_seconds(stamp_ns - start_ns)
            for index in indices:
                if abs(frames[index] - t_s) < 1e-6:
                    index_of.setdefault(stamp_ns, index)
        if not index_of:
            return {}
        found: dict[int, bytes] = {}
        for frame in Frames(bag, _IMAGE).jpegs(stamps=index_of):
            found.setdefault(index_of[frame.stamp_ns], frame.data)
    return found


def _overlay(one: Examined, index: int) -> str:
    """Outlines of participants and conflict zone in the picture."""
    who, optics = one.recording.provenance.participants, one.recording.optics
    measured = one.measured
    if who is None or optics is None or measured is None or index >= len(one.moments):
        return ""
    states = one.moments[index].states
    if who.vut not in states:
        return ""
    view = optics.view(states[who.vut].pose)
    parts = []
    if measured.zone is not None:
        parts.append(_zone(view, measured.zone))
    for target in who.targets:
        if target in states:
            kind = "ot main" if target in (measured.initiator, measured.affected) else "ot"
            parts.append(_outline(view, states[target], target, kind))
    box = f"0 0 {optics.lens.width_px} {optics.lens.height_px}"
    return svg.element(
        "svg", "".join(parts), class_="overlay", viewBox=box, preserveAspectRatio="none"
    )


def _outline(view: View, state: ObjectState, name: str, kind: str) -> str:
    seen = project(view, object_corners(state))
    if not seen.in_front.all():
        return ""
    corners = np.column_stack([seen.u_px, seen.v_px]).astype(np.float32)
    hull = cv2.convexHull(corners).reshape(-1, 2)
    size = view.intrinsics.width_px / 20.0
    left, top = float(hull[:, 0].min()), float(hull[:, 1].min())
    points = [(float(u), float(v)) for u, v in hull]
    label = svg.text(left, max(size, top - size / 3.0), name, font_size=size, class_=kind)
    return svg.element("polygon", points=svg.points(points), class_=kind) + label


def _zone(view: View, outline: Sequence[tuple[float, float]]) -> str:
    """The part of the zone that lies before the camera; edges are cut into short pieces."""
    ground = _dense(np.array(outline))
    seen = project(view, np.column_stack([ground, np.zeros(len(ground))]))
    ahead = seen.in_front & (seen.depth_m > _NEAR_M)
    if ahead.sum() < 3:
        return ""
    points = [(float(u), float(v)) for u, v in zip(seen.u_px[ahead], seen.v_px[ahead], strict=True)]
    return svg.element("polygon", points=svg.points(points), class_="zone")


def _dense(outline: FloatArray) -> FloatArray:
    following = np.roll(outline, -1, axis=0)
    steps = np.arange(_GROUND_STEPS) / _GROUND_STEPS
    return np.concatenate(
        [a + (b - a) * steps[:, None] for a, b in zip(outline, following, strict=True)]
    )
