"""The audit as one page: verdicts, phase-aligned frames, phases, properties, coverage, log."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

from ssp_core import __version__
from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.templates import templates
from ssp_core.world.camera import View, object_corners, project
from ssp_eval import pages
from ssp_eval.audit.evidence.reasons import TABLE
from ssp_eval.audit.examine import Examination
from ssp_eval.data.audit import FIELDS, TOPOLOGY, Audit, PropertyEntry
from ssp_eval.pages import jpeg_uri
from ssp_eval.response.page import STYLE as RESPONSE_STYLE
from ssp_eval.response.page import section

COLUMNS = ("start", "trigger", "conflict", "in the conflict", "resolution")
WIDTH_PX = 640
_IMAGE = absolute(CAMERA_IMAGE)
_NEAR_M = 0.5
_GROUND_STEPS = 12


@dataclass(frozen=True)
class Picture:
    """One frame of one recording.

    Args:
        at_s: clip time of the instant, None: the phase isn't located, or there is no frame.
        phi: φ of that instant, None: not known.
        uri: data URI, empty without a frame.
        overlay: SVG, empty where there are no states.
    """

    column: str
    at_s: float | None = None
    phi: float | None = None
    t_s: float | None = None
    uri: str = ""
    overlay: str = ""


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


def pictures(one: Examination) -> list[Picture]:
    """Return the pictures of a recording, one per column.

    Raises:
        InputError: a frame in the bag is no picture.
    """
    phases, frames = one.phases, one.recording.frames_s
    if phases is None or not frames:
        return [Picture(column) for column in COLUMNS]
    middle_s = None
    if phases.conflict_s is not None and phases.resolution_s is not None:
        middle_s = (phases.conflict_s + phases.resolution_s) / 2.0
    times = (phases.start_s, phases.trigger_s, phases.conflict_s, middle_s, phases.resolution_s)
    indices = [None if t_s is None else frame_at(frames, t_s) for t_s in times]
    jpegs = _fetch(one, [index for index in indices if index is not None])
    result = []
    for column, t_s, index in zip(COLUMNS, times, indices, strict=True):
        if t_s is None or index is None or index not in jpegs:
            result.append(Picture(column))
            continue
        phi = None
        if phases.end_s > phases.start_s:
            phi = (t_s - phases.start_s) / (phases.end_s - phases.start_s)
        uri = jpeg_uri(jpegs[index], one.recording.path, WIDTH_PX)
        result.append(Picture(column, t_s, phi, frames[index], uri, _overlay(one, index)))
    return result


def _fetch(one: Examination, indices: Sequence[int]) -> dict[int, bytes]:
    """Return each JPEG by its index into the recording's frames."""
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
        jpegs: dict[int, bytes] = {}
        for frame in Frames(bag, _IMAGE).jpegs(stamps=index_of):
            jpegs.setdefault(index_of[frame.stamp_ns], frame.data)
    return jpegs


def _overlay(one: Examination, index: int) -> str:
    """Return outlines of participants and conflict zone in the picture."""
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
    return pages.element(
        "svg",
        "".join(parts),
        class_="overlay",
        viewBox=box,
        preserveAspectRatio="none",
        aria_hidden="true",
    )


def _outline(view: View, state: ObjectState, name: str, kind: str) -> str:
    projection = project(view, object_corners(state))
    if not projection.in_front.all():
        return ""
    corners = np.column_stack([projection.u_px, projection.v_px]).astype(np.float32)
    hull = cv2.convexHull(corners).reshape(-1, 2)
    size = view.intrinsics.width_px / 20.0
    left, top = float(hull[:, 0].min()), float(hull[:, 1].min())
    points = [(float(u), float(v)) for u, v in hull]
    label = pages.text(left, max(size, top - size / 3.0), name, font_size=size, class_=kind)
    return pages.element("polygon", points=pages.points(points), class_=kind) + label


def _zone(view: View, outline: Sequence[tuple[float, float]]) -> str:
    """Return the part of the zone that lies before the camera; edges are cut into short pieces."""
    ground = _dense(np.array(outline))
    projection = project(view, np.column_stack([ground, np.zeros(len(ground))]))
    ahead = projection.in_front & (projection.depth_m > _NEAR_M)
    if ahead.sum() < 3:
        return ""
    points = [
        (float(u), float(v))
        for u, v in zip(projection.u_px[ahead], projection.v_px[ahead], strict=True)
    ]
    return pages.element("polygon", points=pages.points(points), class_="zone")


def _dense(outline: FloatArray) -> FloatArray:
    following = np.roll(outline, -1, axis=0)
    steps = np.arange(_GROUND_STEPS) / _GROUND_STEPS
    return np.concatenate(
        [a + (b - a) * steps[:, None] for a, b in zip(outline, following, strict=True)]
    )


# Arrows on the road: how far it moves in this time, and where they begin, ahead and to the left.
_ARROW_S = 0.2
_AHEAD_M, _LEFT_M = (9.0, 12.0, 16.0, 21.0), (3.0, 1.2, -1.2, -3.0)


def moving_road(one: Examination) -> Picture | None:
    """Return a frame with the motion of the road, recorded and seen; None: none was followed.

    Raises:
        InputError: the frame is no picture.
    """
    optics, frames = one.recording.optics, one.recording.frames_s
    followed = [pair for pair in one.pictures.road if pair.is_followed]
    if not followed or optics is None:
        return None
    middle_s = (frames[0] + frames[-1]) / 2.0
    trigger_s = None if one.phases is None else one.phases.trigger_s
    at_s = middle_s if trigger_s is None else trigger_s
    pair = min(followed, key=lambda pair: abs(pair.t_s - at_s))
    index = frame_at(frames, pair.t_s - pair.apart_s / 2.0)
    jpegs = _fetch(one, [index])
    if index not in jpegs:
        return None
    view = optics.view(Pose2(0.0, 0.0, 0.0))
    arrows = _arrows(view, pair.speed_mps, "recorded") + _arrows(view, pair.picture_mps, "seen")
    box = f"0 0 {optics.lens.width_px} {optics.lens.height_px}"
    overlay = pages.element(
        "svg",
        arrows,
        class_="overlay",
        viewBox=box,
        preserveAspectRatio="none",
        aria_hidden="true",
    )
    uri = jpeg_uri(jpegs[index], one.recording.path, WIDTH_PX)
    column = f"recorded {pair.speed_mps:.1f} m/s, seen {pair.picture_mps:.1f} m/s"
    return Picture(column, pair.t_s, None, frames[index], uri, overlay)


def _arrows(view: View, speed_mps: float, kind: str) -> str:
    starts = np.array([(x, y, 0.0) for x in _AHEAD_M for y in _LEFT_M])
    ends = starts - [speed_mps * _ARROW_S, 0.0, 0.0]
    a, b = project(view, starts), project(view, ends)
    radius = view.intrinsics.width_px / (160.0 if kind == "recorded" else 240.0)
    parts = []
    for k in np.flatnonzero(a.in_front & b.in_front):
        x, y, to_x, to_y = (float(v[k]) for v in (a.u_px, a.v_px, b.u_px, b.v_px))
        parts.append(pages.element("line", x1=x, y1=y, x2=to_x, y2=to_y, class_=kind))
        parts.append(pages.element("circle", cx=to_x, cy=to_y, r=radius, class_=kind))
    return "".join(parts)


_HERE = Path(__file__).parent
_FACTS = {
    "time_gap_s": ("time gap at the conflict point", "s"),
    "min_ttc_s": ("smallest TTC, trigger to resolution", "s"),
    "min_distance_m": ("smallest distance", "m"),
    "trigger_gap_m": ("gap at the trigger", "m"),
    "vut_speed_at_trigger_mps": ("VUT's speed at the trigger", "m/s"),
    "ot_speed_at_trigger_mps": ("OT's speed at the trigger", "m/s"),
    "vut_speed_at_conflict_mps": ("VUT's speed at the conflict", "m/s"),
    "ot_speed_at_conflict_mps": ("OT's speed at the conflict", "m/s"),
}


def field_rows(audit: Audit) -> list[dict[str, Any]]:
    """Return the table of properties: every field of KPR with its parts.

    Each part has per recording its words and how they compare: same, other, or unknown.
    """
    rows = []
    for field in FIELDS:
        entries = [recording.properties[field] for recording in audit.recordings]
        varying = {part for recording in audit.recordings for part in recording.varying}
        apart = varying if field == TOPOLOGY else set()
        names = dict.fromkeys(
            name for entry in entries for name in entry.words or {} if name not in apart
        )
        rows.append(
            {
                "name": field.replace("_", " "),
                "weight": audit.weights[field],
                "parts": {
                    name.replace("_", " ") if len(names) > 1 else "": [
                        _cell(entry, name) for entry in entries
                    ]
                    for name in names or [""]
                },
                "how": [entry.how for entry in entries],
            }
        )
    return rows


def _cell(entry: PropertyEntry, part: str) -> tuple[str, str]:
    if entry.words is None:
        return "unverified" if entry.source == "unverified" else "not determined", "unknown"
    words = entry.words.get(part, ["–"])
    digits = len(words) > 2 and all(word.isdigit() for word in words)
    text = f"{words[0]} to {words[-1]}" if digits else " or ".join(words)
    return text.replace("_", " "), "other" if part in entry.differences else "same"


def fact_rows(audit: Audit) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return measured quantities with their unit, one column per recording."""
    rows = []
    for key, (name, unit) in _FACTS.items():
        values = [recording.facts.get(key) for recording in audit.recordings]
        if any(value is not None for value in values):
            cells = tuple("–" if value is None else f"{value:.2f}" for value in values)
            rows.append((name, unit, cells))
    return rows


def _side_by_side(rows: Sequence[Mapping[str, str]]) -> list[tuple[str, list[str]]]:
    """Tabulate the values of recordings under each name, one column per recording."""
    names = dict.fromkeys(name for row in rows for name in row)
    return [(name, [row.get(name, "–") for row in rows]) for name in names]


@dataclass(frozen=True)
class PagePictures:
    """The pictures of an audit's page, by domain.

    Args:
        strips: one picture per column.
        roads: a frame with the motion of the road; None: none was followed.
    """

    strips: Mapping[str, Sequence[Picture]]
    roads: Mapping[str, Picture | None]


def draw(
    examined: Sequence[Examination],
    on_picture: Callable[[int, int], None] = lambda _done, _of: None,
) -> PagePictures:
    """Return the pictures of examined recordings.

    Args:
        examined: the recordings of one audit.
        on_picture: is called with the number of recordings that have their pictures, and of all.

    Raises:
        InputError: a frame in a bag is no picture.
    """
    strips: dict[str, Sequence[Picture]] = {}
    roads: dict[str, Picture | None] = {}
    for count, one in enumerate(examined, start=1):
        strips[one.recording.provenance.domain] = pictures(one)
        roads[one.recording.provenance.domain] = moving_road(one)
        on_picture(count, len(examined))
    return PagePictures(strips, roads)


def render(audit: Audit, page_pictures: PagePictures) -> str:
    """Return the page as HTML: its words are the audit's, its pictures those of the recordings."""
    environment = templates(_HERE)
    environment.filters["plain"] = _plain
    environment.filters["coordinate"] = pages.number
    return environment.get_template("page.html.j2").render(
        audit=audit,
        recordings=audit.recordings,
        columns=COLUMNS,
        strips=page_pictures.strips,
        roads=page_pictures.roads,
        fields=field_rows(audit),
        varying=_side_by_side([{k: v[0] for k, v in r.varying.items()} for r in audit.recordings]),
        facts=fact_rows(audit),
        disclosures=_side_by_side([r.disclosures for r in audit.recordings]),
        checks=TABLE,
        response=None if audit.response is None else section(audit.response),
        style=pages.style(_HERE / "style.css", RESPONSE_STYLE),
        version=__version__,
    )


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
