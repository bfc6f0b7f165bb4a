"""Where the VUT was, put together from the ego histories of a cell's requests."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.clock import NS_PER_S
from ssp_core.geometry import Pose2, wrap_angle
from ssp_vla_bridge.trajectory import Trajectory

_SLACK_NS = 1_000


@dataclass(frozen=True)
class EgoPath:
    """Poses of the VUT's reference point over time, in pieces that each have a frame of their own.

    Args:
        pieces: stamps (ns, rising) and poses of each.
    """

    pieces: tuple[tuple[tuple[int, ...], tuple[Pose2, ...]], ...]

    def pose(self, at_ns: int) -> tuple[int, Pose2] | None:
        """The piece that covers a time, and the pose then; None where it isn't known."""
        for index, (stamps, poses) in enumerate(self.pieces):
            if stamps[0] - _SLACK_NS <= at_ns <= stamps[-1] + _SLACK_NS:
                return index, _interpolated(stamps, poses, at_ns)
        return None

    def after(self, at_ns: int, horizon_s: float) -> Trajectory | None:
        """What was driven from a time on, in the ego frame then; None where it isn't known.

        Args:
            at_ns: t = 0 of the result.
            horizon_s: of the result, s; it ends earlier where the recording's requests do.
        """
        found = self.pose(at_ns)
        if found is None:
            return None
        index, origin = found
        end_ns = at_ns + round(horizon_s * NS_PER_S)
        times, xs, ys = [0.0], [0.0], [0.0]
        for stamp_ns, pose in zip(*self.pieces[index], strict=True):
            if at_ns + _SLACK_NS < stamp_ns <= end_ns + _SLACK_NS:
                x_m, y_m = origin.to_local(pose.x_m, pose.y_m)
                times.append((stamp_ns - at_ns) / NS_PER_S)
                xs.append(x_m)
                ys.append(y_m)
        return Trajectory(tuple(times), tuple(xs), tuple(ys)) if len(times) > 1 else None

    def seen_from(self, plan: Trajectory, made_ns: int, at_ns: int) -> Trajectory | None:
        """A plan in the ego frame of another time; None where the way between isn't known.

        Args:
            plan: in the ego frame at made_ns.
            made_ns: when it was made.
            at_ns: when it is looked at; its times stay those since made_ns.
        """
        if made_ns == at_ns:
            return plan
        before, now = self.pose(made_ns), self.pose(at_ns)
        if before is None or now is None or before[0] != now[0]:
            return None
        places = [
            now[1].to_local(*before[1].to_parent(x_m, y_m))
            for x_m, y_m in zip(plan.x_m, plan.y_m, strict=True)
        ]
        return Trajectory(plan.t_s, tuple(x for x, _ in places), tuple(y for _, y in places))


def ego_path(requests: Iterable[Mapping[str, Any]]) -> EgoPath:
    """The path that the ego histories of requests tell.

    Args:
        requests: lines of requests.jsonl; those without a history tell nothing.
    """
    pieces: list[tuple[list[int], list[Pose2]]] = []
    asked = [r for r in requests if r.get("history") and r.get("stamp_ns") is not None]
    for request in sorted(asked, key=lambda r: int(r["stamp_ns"])):
        stamps, local = _history(request)
        joint = pieces[-1][0][-1] if pieces else None
        if joint is None or joint < stamps[0] - _SLACK_NS:
            pieces.append((stamps, local))
            continue
        # The request's own frame, in that of the piece, through the pose that both have.
        shared = _interpolated(stamps, local, joint)
        there = pieces[-1][1][-1]
        yaw = wrap_angle(there.yaw_rad - shared.yaw_rad)
        turned = Pose2(0.0, 0.0, yaw).to_parent(shared.x_m, shared.y_m)
        frame = Pose2(there.x_m - turned[0], there.y_m - turned[1], yaw)
        for stamp_ns, pose in zip(stamps, local, strict=True):
            if stamp_ns > joint + _SLACK_NS:
                x_m, y_m = frame.to_parent(pose.x_m, pose.y_m)
                pieces[-1][0].append(stamp_ns)
                pieces[-1][1].append(Pose2(x_m, y_m, wrap_angle(yaw + pose.yaw_rad)))
    return EgoPath(tuple((tuple(stamps), tuple(poses)) for stamps, poses in pieces))


def _history(request: Mapping[str, Any]) -> tuple[list[int], list[Pose2]]:
    now_ns = int(request["stamp_ns"])
    samples = request["history"]
    stamps = [now_ns + round(float(sample["t_s"]) * NS_PER_S) for sample in samples]
    poses = [
        Pose2(float(sample["x_m"]), float(sample["y_m"]), float(sample.get("yaw_rad", 0.0)))
        for sample in samples
    ]
    return stamps, poses


def _interpolated(stamps: Sequence[int], poses: Sequence[Pose2], at_ns: int) -> Pose2:
    right = min(bisect_left(stamps, at_ns), len(stamps) - 1)
    if right == 0 or stamps[right] <= at_ns:
        return poses[right]
    a, b = poses[right - 1], poses[right]
    share = (at_ns - stamps[right - 1]) / (stamps[right] - stamps[right - 1])
    return Pose2(
        a.x_m + (b.x_m - a.x_m) * share,
        a.y_m + (b.y_m - a.y_m) * share,
        wrap_angle(a.yaw_rad + wrap_angle(b.yaw_rad - a.yaw_rad) * share),
    )
