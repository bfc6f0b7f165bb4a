"""The same thing over several frames: where it is now and how it moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_vla_bridge.backends.vision.detection import Detection
from ssp_vla_bridge.messages import EgoSample

_ASIDE_M = 0.5
_ASIDE_MPS = 4.0
_ALONG_M = 1.5
_ALONG_SHARE = 0.12
_ALONG_MPS = 12.0
_WIDTH_RATIO = 2.2
_FLUSH_M = 0.4
_NARROW_M = 1.3
_VEHICLE_HALF_WIDTH_M = 0.95


@dataclass(frozen=True)
class Track:
    """A thing at the newest frame.

    Velocities are over ground in the newest ego frame when the VUT's own motion is known, and
    relative to the VUT when it isn't; they are None after a single sighting.

    Args:
        x_m: ahead of the camera.
        y_m: of its centre, + is left.
        right_m: of its right edge.
        left_m: of its left edge.
        width_m: median over the sightings.
        height_m: median over the sightings.
        vx_mps: along the VUT's heading.
        vy_mps: to the left.
        sightings: number of frames that show it.
        box: in the newest frame, px of the image that was looked at.
    """

    x_m: float
    y_m: float
    right_m: float
    left_m: float
    width_m: float
    height_m: float
    vx_mps: float | None
    vy_mps: float | None
    sightings: int
    box: tuple[int, int, int, int]


@dataclass(frozen=True)
class _Sighting:
    t_s: float
    x_m: float
    y_m: float
    thing: Detection


def ego_pose(history: Sequence[EgoSample], t_s: float) -> Pose2:
    """Return the VUT's pose at a time in the newest ego frame, linear between samples and before.

    Args:
        history: not empty, oldest first.
        t_s: relative to the request's time, s, <= 0.
    """
    first = history[0]
    if t_s < first.t_s:
        back_m = first.speed_mps * (t_s - first.t_s)
        return Pose2(
            first.x_m + back_m * math.cos(first.yaw_rad),
            first.y_m + back_m * math.sin(first.yaw_rad),
            first.yaw_rad,
        )
    times = [sample.t_s for sample in history]
    return Pose2(
        float(np.interp(t_s, times, [sample.x_m for sample in history])),
        float(np.interp(t_s, times, [sample.y_m for sample in history])),
        float(np.interp(t_s, times, [sample.yaw_rad for sample in history])),
    )


def centre_m(thing: Detection) -> float:
    """Return the lateral position of a thing's centre from the edge that doesn't mislead, m.

    Beside the VUT's path a vehicle shows its inner side too, which makes it look wider towards
    the path; its outer edge belongs to its end alone.
    """
    if thing.width_m < _NARROW_M:
        return thing.y_m
    if thing.right_m > _FLUSH_M:
        return max(thing.y_m, thing.left_m - _VEHICLE_HALF_WIDTH_M)
    if thing.left_m < -_FLUSH_M:
        return min(thing.y_m, thing.right_m + _VEHICLE_HALF_WIDTH_M)
    return thing.y_m


def track_objects(
    detections: Sequence[tuple[float, Sequence[Detection]]], history: Sequence[EgoSample]
) -> list[Track]:
    """Follow the things of the newest frame back through the older ones.

    Args:
        detections: time relative to the request's, s, and the things of each frame, oldest first.
        history: the VUT's own motion, empty when it isn't known.
    """
    frames = []
    for t_s, things in detections:
        pose = ego_pose(history, t_s) if history else Pose2(0.0, 0.0, 0.0)
        frames.append(
            [_Sighting(t_s, *pose.to_parent(t.x_m, centre_m(t)), thing=t) for t in things]
        )
    tracks = [[sighting] for sighting in frames[-1]]
    for older in reversed(frames[:-1]):
        _extend(tracks, older)
    return [_fit(track) for track in tracks]


def _extend(tracks: list[list[_Sighting]], older: list[_Sighting]) -> None:
    """Give each track its best sighting of an older frame; each sighting to one track."""
    pairs = sorted(
        (cost, i, j)
        for i, track in enumerate(tracks)
        for j, sighting in enumerate(older)
        if (cost := _cost(track, sighting)) is not None
    )
    taken_tracks: set[int] = set()
    taken_sightings: set[int] = set()
    for _, i, j in pairs:
        if i not in taken_tracks and j not in taken_sightings:
            taken_tracks.add(i)
            taken_sightings.add(j)
            tracks[i].append(older[j])


def _cost(track: list[_Sighting], older: _Sighting) -> float | None:
    last = track[-1]
    back_s = last.t_s - older.t_s
    expected_x, expected_y = last.x_m, last.y_m
    if len(track) >= 2:
        vx, vy = _velocity(track)
        expected_x, expected_y = last.x_m - vx * back_s, last.y_m - vy * back_s
        back_s /= 2.0  # what is known to move steadily is looked for more closely
    aside = abs(older.y_m - expected_y)
    along = abs(older.x_m - expected_x)
    widths = sorted((last.thing.width_m, older.thing.width_m))
    if (
        aside > _ASIDE_M + _ASIDE_MPS * back_s
        or along > _ALONG_M + _ALONG_SHARE * last.thing.x_m + _ALONG_MPS * back_s
        or widths[1] > _WIDTH_RATIO * widths[0]
    ):
        return None
    return 2.0 * aside + along


def _velocity(track: Sequence[_Sighting]) -> tuple[float, float]:
    """Return slopes of the least-squares lines, m/s."""
    times = np.array([s.t_s for s in track])
    times = times - times.mean()
    spread = float((times**2).sum())
    if spread < 1e-6:
        return 0.0, 0.0
    vx = float((times * np.array([s.x_m for s in track])).sum()) / spread
    vy = float((times * np.array([s.y_m for s in track])).sum()) / spread
    return vx, vy


def _fit(track: Sequence[_Sighting]) -> Track:
    newest = track[0]
    vx, vy = _velocity(track) if len(track) > 1 else (None, None)
    return Track(
        x_m=newest.x_m,
        y_m=newest.y_m,
        right_m=newest.thing.right_m,
        left_m=newest.thing.left_m,
        width_m=float(np.median([s.thing.width_m for s in track])),
        height_m=float(np.median([s.thing.height_m for s in track])),
        vx_mps=vx,
        vy_mps=vy,
        sightings=len(track),
        box=newest.thing.box,
    )
