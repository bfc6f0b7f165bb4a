"""Draws of where an initiator waits before its way: to its stop line, and to the kerb (METHOD 8.1).

The distance to a line is measured on the arm of the junction that the initiator waits on. A run
file has no kerb: the initiator moves by what the drawn distance differs from the compiled one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssp_core.geometry import Point, Polyline, Pose2, wrap_angle
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath, ParticipantSpec, TriggerSpec
from ssp_core.run_file.values import Start
from ssp_core.safety.fence import way_excess_m
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.closed_loop.starts.places import span_of, with_target
from ssp_scenario_manager.compile.task import Tuning
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.scenarios.values import quantity_at

LINE = "constraints.manoeuvre.line_distance"
KERB = "constraints.manoeuvre.kerb_distance"
Uniform = Callable[[float, float], float]
Drawn = tuple[RunSpec, dict[str, float]]
# An initiator on an arm lies so near to the middle of its lane, and turned so little from it.
_IN_LANE_M, _ALONG_RAD = 0.2, 0.1
# Of places in a run file.
_ROUNDING_M = 0.01
# The room inside the fence is looked for in steps of this.
_STEP_M = 0.05


@dataclass(frozen=True)
class Waiting:
    """An initiator that stands until it begins a way of its own.

    Args:
        run: that it is part of.
        one: the initiator.
        trigger: that begins its way.
        motion: its way.
    """

    run: RunSpec
    one: ParticipantSpec
    trigger: TriggerSpec
    motion: FollowPath

    @staticmethod
    def of(run: RunSpec) -> Waiting | None:
        """Return the initiator of a run; None where it doesn't stand, or begins no such way."""
        for trigger in run.triggers:
            if trigger.object_id == run.initiator_id and isinstance(trigger.manoeuvre, FollowPath):
                one = next(target for target in run.targets if target.id == run.initiator_id)
                timed = trigger.manoeuvre.motion.times_s is not None
                if one.approach is None and not timed:
                    return Waiting(run, one, trigger, trigger.manoeuvre)
        return None

    def from_place(self, place: Pose2, way: list[Point]) -> RunSpec:
        """Return the run with the initiator in another place, and its way from there."""
        start = Start(x_m=place.x_m, y_m=place.y_m, yaw_rad=wrap_angle(place.yaw_rad))
        motion = self.motion.motion.model_copy(update={"path": way})
        manoeuvre = self.motion.model_copy(update={"motion": motion})
        run = with_target(self.run, self.one.model_copy(update={"start": start}))
        trigger = self.trigger.model_copy(update={"manoeuvre": manoeuvre})
        triggers = [trigger if t.id == trigger.id else t for t in run.triggers]
        return run.model_copy(update={"triggers": triggers})

    def within(self, span: Span, is_m: float, place_at: Callable[[float], Pose2]) -> Span:
        """Return the part of a span, around a compiled value, at which it stands inside the fence.

        Args:
            span: of distances.
            is_m: as it was compiled, inside the fence.
            place_at: gives its place at a distance.
        """
        bounds = []
        for end in (min(span.low, is_m), max(span.high, is_m)):
            steps = np.linspace(is_m, end, max(2, math.ceil(abs(end - is_m) / _STEP_M) + 1))
            poses = [place_at(float(distance)) for distance in steps]
            x, y, yaw = (
                np.array([getattr(p, k) for p in poses]) for k in ("x_m", "y_m", "yaw_rad")
            )
            leaves = way_excess_m(x, y, yaw, self.one.size, self.run.geofence) > 0.0
            count = int(np.argmax(leaves)) if leaves.any() else len(steps)
            bounds.append(float(steps[max(count - 1, 0)]))
        return Span(max(span.low, bounds[0]), min(span.high, bounds[1]))


def drawn_kerb(
    run: RunSpec, event: Event, tunings: Mapping[str, Tuning], uniform: Uniform
) -> Drawn:
    """Return the run with the distance of who crosses to the kerb drawn, and it by field of K*.

    Args:
        run: as it was compiled.
        event: K*.
        tunings: of its task, by field; without that of the distance it stays as compiled.
        uniform: draws between two bounds.
    """
    span, waiting = span_of(quantity_at(event, KERB)), Waiting.of(run)
    if span is None or waiting is None or KERB not in tunings:
        return run, {}
    is_m, pose = tunings[KERB].value, waiting.one.start.pose

    def place_at(distance_m: float) -> Pose2:
        return Pose2(*pose.to_parent(is_m - distance_m, 0.0), pose.yaw_rad)

    allowed = waiting.within(span, is_m, place_at)
    value = round(uniform(allowed.low, allowed.high), 3)
    place = place_at(value)
    way = [(place.x_m, place.y_m), *waiting.motion.motion.path[1:]]
    return waiting.from_place(place, way), {KERB: value}


@dataclass(frozen=True)
class _Arm:
    """The lane of a junction's arm that an initiator waits on.

    Args:
        line: reference line of the arm, towards the junction.
        offset_m: of the lane from it, + left.
    """

    line: ReferenceLine
    offset_m: float

    @cached_property
    def lane(self) -> Polyline:
        """Middle of the lane, up to where the junction begins."""
        return Polyline(self.line.path(0.0, self.line.length_m, self.offset_m))

    def place(self, station_m: float) -> Pose2:
        """Return the pose at a station of the lane."""
        at = self.lane.pose(station_m)
        s_m, _ = self.line.to_local(at.x_m, at.y_m)
        return Pose2(at.x_m, at.y_m, self.line.pose(s_m).yaw_rad)


def _arm_of(run: RunSpec, start: Start) -> _Arm | None:
    """Return the lane of an arm that a place lies on and faces along; None where none is there."""
    for road in run.road.junction:
        if road.junction_at == "both":
            continue
        line, ends = ReferenceLine.of_road(road), road.junction_at == "end"
        line = line if ends else line.reversed()
        with suppress(NotOneToOne):
            s_m, l_m = line.to_local(start.x_m, start.y_m)
            if not 0.0 <= s_m <= line.length_m:
                continue
            if abs(wrap_angle(start.yaw_rad - line.pose(s_m).yaw_rad)) > _ALONG_RAD:
                continue
            for lane in road.lanes:
                middle_m = lane.y_m if ends else -lane.y_m
                comes = (lane.direction == "forward") is ends
                if comes and abs(l_m - middle_m) <= _IN_LANE_M:
                    return _Arm(line, middle_m)
    return None


def drawn_line(run: RunSpec, event: Event, uniform: Uniform) -> Drawn:
    """Return the run with the distance of the initiator's front to its line, and it by field of K*.

    It stays as compiled where the initiator waits on no arm of the run's junction, and where it was
    moved by hand to a distance that isn't K*'s.

    Args:
        run: as it was compiled.
        event: K*.
        uniform: draws between two bounds.
    """
    span, waiting = span_of(quantity_at(event, LINE)), Waiting.of(run)
    arm = None if waiting is None else _arm_of(run, waiting.one.start)
    if span is None or waiting is None or arm is None:
        return run, {}
    start, size = waiting.one.start, waiting.one.size
    own_m, _ = arm.lane.project(start.x_m, start.y_m)
    is_m = arm.lane.length_m - own_m - size.front_m
    if not span.low - _ROUNDING_M <= is_m <= span.high + _ROUNDING_M:
        return run, {}

    def station_m(distance_m: float) -> float:
        return arm.lane.length_m - distance_m - size.front_m

    # Its rear stays on the arm.
    longest = Span(span.low, max(is_m, min(span.high, station_m(size.rear_m))))
    allowed = waiting.within(longest, is_m, lambda distance: arm.place(station_m(distance)))
    value = round(uniform(allowed.low, allowed.high), 3)
    place = arm.place(station_m(value))
    return waiting.from_place(place, _way_from(waiting, arm, station_m(value))), {LINE: value}


def _way_from(waiting: Waiting, arm: _Arm, station_m: float) -> list[Point]:
    """Return an initiator's way from another station of its lane, in front of it or behind it."""
    own_m, _ = arm.lane.project(waiting.one.start.x_m, waiting.one.start.y_m)
    way, driven_m = waiting.motion.motion.path, station_m - own_m
    left = [
        point
        for point, at_m in zip(way[1:], Polyline(way).stations_m[1:].tolist(), strict=True)
        if at_m > driven_m + _STEP_M
    ]
    before = [
        (float(x), float(y))
        for (x, y), at_m in zip(arm.lane.points, arm.lane.stations_m.tolist(), strict=True)
        if station_m + _STEP_M < at_m < own_m - _STEP_M
    ]
    place = arm.place(station_m)
    return [(place.x_m, place.y_m), *before, *left]
