"""The first contact of the VUT with a participant or with scenery, by true states."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Box, Pose2, boxes_overlap
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.world.plant import StepReport
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import SceneryBodies


@dataclass(frozen=True, slots=True)
class Contact:
    """The first step at which the polygons of VUT and another body intersect.

    Args:
        other: id of the other participant, or the scenery's type and place in the run file.
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


def first_touch(run: RunSpec, reports: Sequence[StepReport]) -> Contact | None:
    """Return the first contact with a participant or with scenery, in one step with the former.

    Args:
        run: has the road.
        reports: of the steps that count, in time order.
    """
    contacts = [first_contact(reports, run.vut.id), _scenery_contact(run, reports)]
    touched = [contact for contact in contacts if contact is not None]
    return min(touched, key=lambda contact: contact.stamp_ns, default=None)


def _scenery_contact(run: RunSpec, reports: Sequence[StepReport]) -> Contact | None:
    if not run.road.scenery:
        return None
    bodies = SceneryBodies(run.road)
    for report in reports:
        vut = next(s for s in report.truths if s.object_id == run.vut.id)
        touched = bodies.touched_by(vut.box)
        if touched is not None:
            name, body = touched
            sides = _side(vut.box, body), _side(body, vut.box)
            return Contact(vut.stamp_ns, name, abs(vut.speed_mps), vut.speed_mps, *sides)
    return None


def with_vut(report: StepReport, vut: ObjectState) -> StepReport:
    """Return a step with another true state of the VUT."""
    truths = tuple(vut if s.object_id == vut.object_id else s for s in report.truths)
    return replace(report, truths=truths)


def contact_words(run: RunSpec, led: Sequence[StepReport], contact: Contact) -> str:
    """Return with whom a contact is, its sides, its speed, and who entered whose lane.

    Args:
        run: has the road.
        led: reports from the hand-over on.
        contact: one of their steps.
    """
    words = (
        f"with {contact.other}, {contact.vut_side} to {contact.other_side}, "
        f"{contact.relative_mps:.2f} m/s"
    )
    if contact.other not in run.object_ids:  # scenery, which is in no lane
        return words
    at = next(report for report in led if report.now_ns == contact.stamp_ns)
    entered = _entered(run, led[0].truths, at.truths, contact.other)
    return "; ".join([words, *entered])


def _entered(
    run: RunSpec, before: Sequence[ObjectState], at: Sequence[ObjectState], other_id: str
) -> list[str]:
    """Say which of the VUT and another is in the other's lane at a contact, and wasn't before.

    The lane of each is the one that its reference point was in before. One that stood beside the
    road's lanes, or that came over another road, has none.
    """
    line, vut_id = ReferenceLine.of_road(run.road), run.vut.id
    was, now = ({s.object_id: _across(line, s) for s in states} for states in (before, at))
    lane_entries = []
    for own, its in ((vut_id, other_id), (other_id, vut_id)):
        lane = _lane_at(run, was[its].middle_m)
        if lane is not None and now[own].is_in(*lane) and not was[own].is_in(*lane):
            lane_entries.append(f"{own} entered the lane of {its}")
    return lane_entries


@dataclass(frozen=True, slots=True)
class _Across:
    """Offsets of an object from the road's line: of its reference point, and of its outline.

    They are NaN where the road has no coordinates, and then in no lane.
    """

    middle_m: float
    right_m: float
    left_m: float

    def is_in(self, right_m: float, left_m: float) -> bool:
        """Tell whether the outline reaches into a lane."""
        return self.right_m < left_m and self.left_m > right_m


def _across(line: ReferenceLine, state: ObjectState) -> _Across:
    places = np.array([(state.x_m, state.y_m), *state.box.corners()])
    offsets = line.to_local_many(places)[:, 1]
    return _Across(float(offsets[0]), float(offsets[1:].min()), float(offsets[1:].max()))


def _lane_at(run: RunSpec, offset_m: float) -> tuple[float, float] | None:
    """Return the right and left border of the lane at an offset; None: there is none."""
    borders = [
        (lane.y_m - lane.width_m / 2, lane.y_m + lane.width_m / 2) for lane in run.road.lanes
    ]
    return next((one for one in borders if one[0] <= offset_m <= one[1]), None)


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
        _side(vut.box, other.box),
        _side(other.box, vut.box),
    )


def _side(box: Box, other: Box) -> str:
    """Return the side of a rectangle at which the middle of another one lies."""
    x, y = box.pose.to_local(*_middle(other.pose, other.front_m, other.rear_m))
    ahead, behind = x - box.front_m, -box.rear_m - x
    beside = abs(y) - box.width_m / 2.0
    if beside >= max(ahead, behind):
        return "flank"
    return "front" if ahead >= behind else "rear"


def _middle(pose: Pose2, front_m: float, rear_m: float) -> tuple[float, float]:
    ahead = 0.5 * (front_m - rear_m)
    return pose.x_m + ahead * math.cos(pose.yaw_rad), pose.y_m + ahead * math.sin(pose.yaw_rad)


def until(reports: Sequence[StepReport], begin_s: float, end_s: float) -> list[StepReport]:
    """Return the reports in (begin, end]."""
    return [r for r in reports if begin_s < ns_to_seconds(r.now_ns) <= end_s + 1e-9]
