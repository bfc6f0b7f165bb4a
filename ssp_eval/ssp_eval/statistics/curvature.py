"""How much of a recorded lateral shift follows from the curve of the road; it changes no score."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ssp_core.vocabulary import LAT_ACTIONS
from ssp_eval.data.ego_path import NS, SAME_S, Pose, pose_at, recorded_paths
from ssp_eval.evaluate.results import CellData
from ssp_eval.score.motion import Motion, lat_action, step_of
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.rows import CellRow

HORIZON_S = DEFAULT.support_end_s
BACK_S = 1.0


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
            t_s = stamp_ns * NS
            path = next((path for path in paths if path[-1].t_s >= t_s - SAME_S), [])
            curve = curve_at(path, t_s, label_t_s)
        found.append(curve)
    return found


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
    still = np.zeros(1)
    aside = (still, still + curve_m / 2, still + curve_m)
    motion = Motion((still, still, still), aside, step_of(DEFAULT))
    word = LAT_ACTIONS[int(lat_action(motion)[0])]
    return Curve(label_t_s, shift_m, curve_m, curvature_per_m, word)


def _between(path: Sequence[Pose], first: Pose, last: Pose) -> list[Pose]:
    inside = (p for p in path if first.t_s + SAME_S < p.t_s < last.t_s - SAME_S)
    return [first, *inside, last]


def _length_m(path: Sequence[Pose]) -> float:
    return math.fsum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(path))


def arc_shift_m(curvature_per_m: float, distance_m: float) -> float:
    """(1 − cos(κ d)) / κ, how far an arc leads to the left after a distance, m; 0 for κ = 0."""
    half = curvature_per_m * distance_m / 2
    # 1 − cos 2h = 2 sin² h, which loses no digits near 0.
    return 0.0 if half == 0 else distance_m * math.sin(half) ** 2 / half


@dataclass(frozen=True)
class Beside:
    """The curvature diagnostic at a label, beside the lateral action.

    Args:
        planned: what METHOD 6.6 reads in the model's trajectory, None without a valid one.
    """

    curve: Curve
    allowed: tuple[str, ...]
    planned: str | None


def beside_actions(
    pairs: Iterable[tuple[CellRow, CellData]],
) -> dict[tuple[str, ...], tuple[Beside, ...]]:
    """Of each cell and run with scores, by the time of the label."""
    found: dict[tuple[str, ...], tuple[Beside, ...]] = {}
    for row, cell in pairs:
        if cell.score is None:
            continue
        by_time = {curve.label_t_s: curve for curve in curves(cell.requests)}
        judged = zip(cell.labels.labels, cell.score.details.judgements, strict=True)
        found[(*row.key, row.run)] = tuple(
            Beside(by_time.get(at.t_s, Curve(at.t_s)), at.lat_actions, one.trajectory_lat)
            for at, one in judged
        )
    return found
