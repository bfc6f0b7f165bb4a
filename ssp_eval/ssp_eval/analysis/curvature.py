"""How much of a recorded lateral shift follows from the road's curve; it changes no metric.

In the ego frame a VUT that follows a curve moves sideways, and METHOD 6.6 reads that as a lateral
action. From the recorded path of the VUT about the time t of a request:

    Δl   = lateral shift of the path within [t, t + 1.0 s], in the frame of the VUT at t
    κ    = (ψ(t + 1.0 s) − ψ(t − 1.0 s)) / (arc length between the two)
    Δl_κ = (1 − cos(κ d)) / κ, and 0 for κ = 0, with d the arc length within [t, t + 1.0 s]

ψ is the heading. A change of lane turns the heading and turns it back, so over a whole one κ is
about 0; within a part of one it isn't, and a path alone can't tell that from a curve.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ssp_eval.score.motion import Motion, lat_action, step_of
from ssp_eval.score.thresholds import DEFAULT

HORIZON_S = DEFAULT.support_end_s
BACK_S = 1.0
# Stamps are whole nanoseconds and histories seconds as floats; nearer times are one time.
_SAME_S = 1e-6
_NS = 1e-9


@dataclass(frozen=True)
class Pose:
    """The VUT at a time, in any fixed frame: m, rad, counter-clockwise."""

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True)
class Curve:
    """The diagnostic at one label; None where the path isn't known about it.

    Args:
        label_t_s: clip time, s.
        shift_m: Δl of the recorded path, m, left positive.
        curve_m: Δl_κ, what of it follows from the curve, m.
        curvature_per_m: κ, 1/m, left positive.
        reads_as: the lateral action that METHOD 6.6 reads in Δl_κ alone.
    """

    label_t_s: float
    shift_m: float | None = None
    curve_m: float | None = None
    curvature_per_m: float | None = None
    reads_as: str | None = None


def curves(requests: Sequence[Mapping[str, Any]]) -> list[Curve]:
    """The diagnostic at each label time of a cell.

    Args:
        requests: lines of requests.jsonl in time order. Each one that was asked has the VUT's
            path before it; they are laid end to end by the time that two of them share.
    """
    paths = recorded_paths(requests)
    found = []
    for request in requests:
        label_t_s, stamp_ns = float(request["label_t_s"]), request.get("stamp_ns")
        curve = Curve(label_t_s)
        if stamp_ns is not None:
            t_s = stamp_ns * _NS
            path = next((path for path in paths if path[-1].t_s >= t_s - _SAME_S), [])
            curve = curve_at(path, t_s, label_t_s)
        found.append(curve)
    return found


def recorded_paths(requests: Iterable[Mapping[str, Any]]) -> list[list[Pose]]:
    """The VUT's path over a cell's requests, in parts where histories don't reach each other.

    Args:
        requests: see curves; poses are by the time of their stamps, s.

    Returns:
        In time order, each part in the frame of its first request.
    """
    paths: list[list[Pose]] = []
    for request in requests:
        stamp_ns, history = request.get("stamp_ns"), request.get("history") or []
        if stamp_ns is None or len(history) < 2:
            continue
        now_s = stamp_ns * _NS
        own = sorted(
            (Pose(now_s + h["t_s"], h["x_m"], h["y_m"], h["yaw_rad"]) for h in history),
            key=lambda pose: pose.t_s,
        )
        last = paths[-1][-1] if paths else None
        there = None if last is None else pose_at(own, last.t_s)
        if last is None or there is None:
            paths.append(own)
        else:
            new = (pose for pose in own if pose.t_s > last.t_s + _SAME_S)
            paths[-1] += [_moved(pose, there, last) for pose in new]
    return paths


def _moved(pose: Pose, origin: Pose, onto: Pose) -> Pose:
    """A pose after the rigid motion that takes origin onto another pose."""
    turn = onto.yaw_rad - origin.yaw_rad
    dx, dy = pose.x_m - origin.x_m, pose.y_m - origin.y_m
    return Pose(
        pose.t_s,
        onto.x_m + dx * math.cos(turn) - dy * math.sin(turn),
        onto.y_m + dx * math.sin(turn) + dy * math.cos(turn),
        pose.yaw_rad + turn,
    )


def pose_at(path: Sequence[Pose], t_s: float) -> Pose | None:
    """The pose at a time, between samples by linear interpolation; None outside the path."""
    if not path or not path[0].t_s - _SAME_S <= t_s <= path[-1].t_s + _SAME_S:
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


def curve_at(path: Sequence[Pose], t_s: float, label_t_s: float) -> Curve:
    """The diagnostic at one time of a path.

    Args:
        path: in time order.
        t_s: in the path's time.
        label_t_s: what to call it.
    """
    start, now, end = (pose_at(path, t_s + d) for d in (-BACK_S, 0.0, HORIZON_S))
    if now is None or end is None:
        return Curve(label_t_s)
    dx, dy = end.x_m - now.x_m, end.y_m - now.y_m
    shift_m = dy * math.cos(now.yaw_rad) - dx * math.sin(now.yaw_rad)
    if start is None:
        return Curve(label_t_s, shift_m)
    ahead = _between(path, now, end)
    whole = [*_between(path, start, now), *ahead[1:]]
    turned = math.fsum(math.remainder(b.yaw_rad - a.yaw_rad, math.tau) for a, b in pairwise(whole))
    length_m, distance_m = _length_m(whole), _length_m(ahead)
    curvature_per_m = turned / length_m if length_m > 0 else 0.0
    curve_m = arc_shift_m(curvature_per_m, distance_m)
    motion = Motion((0.0, 0.0, 0.0), (0.0, curve_m / 2, curve_m), step_of(DEFAULT))
    return Curve(label_t_s, shift_m, curve_m, curvature_per_m, lat_action(motion))


def _between(path: Sequence[Pose], first: Pose, last: Pose) -> list[Pose]:
    inside = (p for p in path if first.t_s + _SAME_S < p.t_s < last.t_s - _SAME_S)
    return [first, *inside, last]


def _length_m(path: Sequence[Pose]) -> float:
    return math.fsum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(path))


def arc_shift_m(curvature_per_m: float, distance_m: float) -> float:
    """(1 − cos(κ d)) / κ, how far an arc leads to the left after a distance, m; 0 for κ = 0."""
    half = curvature_per_m * distance_m / 2
    # 1 − cos 2h = 2 sin² h, which loses no digits near 0.
    return 0.0 if half == 0 else distance_m * math.sin(half) ** 2 / half
