"""The path of the VUT, by the histories in requests or the states of a recording."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.geometry import Pose2
from ssp_vla_bridge.trajectory import Trajectory

# Stamps are whole nanoseconds and histories seconds as floats; nearer times are one time.
SAME_S = 1e-6
NS = 1e-9


@dataclass(frozen=True)
class Pose:
    """The VUT at a time, in any fixed frame: m, rad, counter-clockwise."""

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float


def recorded_paths(requests: Iterable[Mapping[str, Any]]) -> list[list[Pose]]:
    """Return the VUT's path over a cell's requests, split where histories don't overlap.

    Args:
        requests: lines of requests.jsonl in time order; poses are by the time of their stamps, s.

    Returns:
        In time order, each part in the frame of its first request.
    """
    paths: list[list[Pose]] = []
    for request in requests:
        stamp_ns, history = request.get("stamp_ns"), request.get("history") or []
        if stamp_ns is None or len(history) < 2:
            continue
        now_s = stamp_ns * NS
        own = sorted(
            (Pose(now_s + h["t_s"], h["x_m"], h["y_m"], h["yaw_rad"]) for h in history),
            key=lambda pose: pose.t_s,
        )
        last = paths[-1][-1] if paths else None
        there = None if last is None else pose_at(own, last.t_s)
        if last is None or there is None:
            paths.append(own)
        else:
            new = (pose for pose in own if pose.t_s > last.t_s + SAME_S)
            paths[-1] += [_moved(pose, there, last) for pose in new]
    return paths


def _moved(pose: Pose, origin: Pose, onto: Pose) -> Pose:
    """Return a pose after the rigid motion that takes origin onto another pose."""
    turn = onto.yaw_rad - origin.yaw_rad
    dx, dy = pose.x_m - origin.x_m, pose.y_m - origin.y_m
    return Pose(
        pose.t_s,
        onto.x_m + dx * math.cos(turn) - dy * math.sin(turn),
        onto.y_m + dx * math.sin(turn) + dy * math.cos(turn),
        pose.yaw_rad + turn,
    )


def pose_at(path: Sequence[Pose], t_s: float) -> Pose | None:
    """Return the pose at a time, between samples by linear interpolation; None outside the path."""
    if not path or not path[0].t_s - SAME_S <= t_s <= path[-1].t_s + SAME_S:
        return None
    after = min(bisect_right(path, t_s, key=lambda pose: pose.t_s), len(path) - 1)
    a, b = path[max(after - 1, 0)], path[after]
    share = 0.0 if b.t_s <= a.t_s else min(max((t_s - a.t_s) / (b.t_s - a.t_s), 0.0), 1.0)
    turn = math.remainder(b.yaw_rad - a.yaw_rad, math.tau)
    return Pose(
        t_s,
        a.x_m + share * (b.x_m - a.x_m),
        a.y_m + share * (b.y_m - a.y_m),
        a.yaw_rad + share * turn,
    )


@dataclass(frozen=True)
class EgoPath:
    """Poses of the VUT's reference point over time, in pieces that each have a frame of their own.

    Args:
        pieces: poses of each, in time order.
    """

    pieces: tuple[tuple[Pose, ...], ...]

    def pose(self, t_s: float) -> tuple[int, Pose2] | None:
        """Return the piece that covers a time, and the pose at that time; None outside the path."""
        for index, piece in enumerate(self.pieces):
            if (point := pose_at(piece, t_s)) is not None:
                return index, Pose2(point.x_m, point.y_m, point.yaw_rad)
        return None

    def after(self, at_s: float, horizon_s: float) -> Trajectory | None:
        """Return the path driven from a time on, in the ego frame then; None where it isn't known.

        Args:
            at_s: t = 0 of the result.
            horizon_s: of the result, s; it ends earlier where the piece does.
        """
        start = self.pose(at_s)
        if start is None:
            return None
        index, origin = start
        driven = [
            (pose.t_s - at_s, *origin.to_local(pose.x_m, pose.y_m))
            for pose in self.pieces[index]
            if at_s + SAME_S < pose.t_s <= at_s + horizon_s + SAME_S
        ]
        return Trajectory(*zip((0.0, 0.0, 0.0), *driven, strict=True)) if driven else None
