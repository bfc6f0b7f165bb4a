"""The driven path put together from ego histories."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ssp_core.geometry import Pose2
from ssp_eval.data.ego_path import EgoPath, recorded_paths

SPEED_MPS, RADIUS_M = 10.0, 40.0


def pose_at(t_s: float) -> Pose2:
    """Return the pose at a time on a circle to the left that leaves the origin along x."""
    angle = SPEED_MPS * t_s / RADIUS_M
    return Pose2(RADIUS_M * math.sin(angle), RADIUS_M * (1 - math.cos(angle)), angle)


def request(t_s: float, history_s: float = 1.0) -> dict[str, Any]:
    """Return a request at this time, whose history is the circle in its own frame."""
    now = pose_at(t_s)
    samples = []
    for k in range(round(history_s * 10), -1, -1):
        then = pose_at(t_s - k / 10)
        x_m, y_m = now.to_local(then.x_m, then.y_m)
        samples.append(
            {"t_s": -k / 10, "x_m": x_m, "y_m": y_m, "yaw_rad": then.yaw_rad - now.yaw_rad}
        )
    return {"stamp_ns": round(t_s * 1e9), "history": samples}


def ego_path(requests: list[dict[str, Any]]) -> EgoPath:
    return EgoPath(tuple(map(tuple, recorded_paths(requests))))


def test_histories_join_to_the_path_that_was_driven() -> None:
    path = ego_path([request(t_s) for t_s in (1.0, 1.5, 2.0, 2.9)])
    assert len(path.pieces) == 1
    found = path.after(1.0, 1.5)
    assert found is not None
    assert found.t_s == pytest.approx([k / 10 for k in range(16)])
    start = pose_at(1.0)
    for t_s, x_m, y_m in zip(found.t_s, found.x_m, found.y_m, strict=True):
        true = pose_at(1.0 + t_s)
        assert (x_m, y_m) == pytest.approx(start.to_local(true.x_m, true.y_m), abs=1e-9)


def test_a_gap_between_histories_is_not_bridged() -> None:
    path = ego_path([request(1.0), request(4.0)])
    assert len(path.pieces) == 2
    assert path.pose(2.0) is None
    found = path.after(0.5, 3.0)
    assert found is not None
    assert found.t_s[-1] == pytest.approx(0.5)
    assert path.after(1.0, 3.0) is None
    assert ego_path([{"stamp_ns": 1, "history": []}, {"missing": "x"}]).pieces == ()
