"""The first contact of the VUT, by true states."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Pose2, boxes_overlap
from ssp_core.motion.state import ObjectState
from ssp_core.world.plant import StepReport


@dataclass(frozen=True, slots=True)
class Contact:
    """The first step at which the polygons of VUT and another participant intersect.

    Args:
        other: id of the other.
        relative_mps: norm of the relative velocity then.
        vut_mps: speed of the VUT then.
        vut_side: of the VUT that the other's middle lies at: front, flank or rear.
        other_side: of the other, likewise.
    """

    stamp_ns: int
    other: str
    relative_mps: float
    vut_mps: float
    vut_side: str
    other_side: str

    @property
    def at_s(self) -> float:
        """Session time."""
        return ns_to_seconds(self.stamp_ns)


def first_contact(reports: Iterable[StepReport], vut_id: str) -> Contact | None:
    """Return the first contact of a run; of several in one step that with the first id.

    Args:
        reports: of the steps that count, in time order.
        vut_id: id of the VUT.
    """
    for report in reports:
        vut = next(s for s in report.truths if s.object_id == vut_id)
        for other in report.truths:
            if other is not vut and _near(vut, other) and boxes_overlap(vut.box, other.box):
                return _contact(vut, other)
    return None


def _near(a: ObjectState, b: ObjectState) -> bool:
    reach = a.size.length_m + a.size.width_m + b.size.length_m + b.size.width_m
    return abs(a.x_m - b.x_m) <= reach and abs(a.y_m - b.y_m) <= reach


def _contact(vut: ObjectState, other: ObjectState) -> Contact:
    dx = vut.speed_mps * math.cos(vut.yaw_rad) - other.speed_mps * math.cos(other.yaw_rad)
    dy = vut.speed_mps * math.sin(vut.yaw_rad) - other.speed_mps * math.sin(other.yaw_rad)
    return Contact(
        vut.stamp_ns,
        other.object_id,
        math.hypot(dx, dy),
        vut.speed_mps,
        _side(vut, other),
        _side(other, vut),
    )


def _side(state: ObjectState, other: ObjectState) -> str:
    """Return the side of an object at which the middle of another one lies."""
    x, y = state.pose.to_local(*_middle(other.pose, other.size.front_m, other.size.rear_m))
    half = state.size.width_m / 2.0
    ahead, behind = x - state.size.front_m, -state.size.rear_m - x
    beside = abs(y) - half
    if beside >= max(ahead, behind):
        return "flank"
    return "front" if ahead >= behind else "rear"


def _middle(pose: Pose2, front_m: float, rear_m: float) -> tuple[float, float]:
    ahead = 0.5 * (front_m - rear_m)
    return pose.x_m + ahead * math.cos(pose.yaw_rad), pose.y_m + ahead * math.sin(pose.yaw_rad)


def until(reports: Sequence[StepReport], begin_s: float, end_s: float) -> list[StepReport]:
    """Return the reports in (begin, end]."""
    return [r for r in reports if begin_s < ns_to_seconds(r.now_ns) <= end_s + 1e-9]
