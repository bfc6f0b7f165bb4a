"""Whether a run's triggers could fire and its event could happen: refused at load, not on the
track.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.encounter import OBSERVABLE_BRAKING_MPS2, corridor_half_m
from ssp_core.motion.event import RESOLUTION_CONFIRMATION_S
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    Brake,
    Condition,
    ElapsedTime,
    FollowPath,
    InRegion,
    LaneChange,
    Leaf,
    ParticipantSpec,
    PhaseReached,
    RelativeDistance,
    SpeedIs,
    TimeHeadway,
    TimeToArrival,
    TimeToCollision,
    TriggerSpec,
)
from ssp_core.run_file.values import Path2
from ssp_core.safety.fence import room_m
from ssp_scenario_manager.dispatch.references import APPROACH_LEAD_S
from ssp_scenario_manager.triggers.conditions import leaves
from ssp_scenario_manager.triggers.on_route import off_route

SPACING_M = 0.5
_LANE_CHANGE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Whose offset from the VUT's path differs by less stays beside it.
_PARALLEL_M = 0.2
# By which a speed is reached at the latest, beyond the time that the motion's acceleration takes.
_SURELY_S = 1.0


class Reach:
    """One participant.

    Args:
        who: the VUT or a target.
        given: triggers that may fire; those of others are left out.
    """

    def __init__(self, who: ParticipantSpec, given: Sequence[TriggerSpec], spec: RunSpec) -> None:
        self.who = who
        self._spec = spec
        self._is_vut = who.id == spec.vut.id
        self._acts = [t for t in given if t.object_id == who.id]

    @property
    def size(self) -> Size:
        return self.who.size

    @property
    def fastest_mps(self) -> float:
        """Speed that no motion asks it to exceed."""
        spec = self._spec
        if self._is_vut:
            driver = spec.driver
            if driver.external or spec.mode == "live":
                return spec.limits.speed_mps
            return max(driver.cruise_mps, *(c.cruise_mps for c in driver.later), 0.0)
        speeds = [0.0] if self.who.approach is None else [self.who.approach.cruise_mps]
        for trigger in self._acts:
            act = trigger.manoeuvre
            share = trigger.adaptation.speed_share[1] if trigger.adaptation else 1.0
            if isinstance(act, FollowPath):
                speeds.append(act.motion.cruise_mps * share)
            elif isinstance(act, LaneChange):
                speeds.append(act.cruise_mps * share)
        return min(max(speeds), spec.limits.speed_mps)

    def below_again(self, speed_mps: float, end_s: float) -> bool:
        """It may be slower than a speed again, once it was as fast and before the run's end."""
        if self._is_vut:
            return True
        for trigger in self._acts:
            act = trigger.manoeuvre
            if isinstance(act, FollowPath):
                return True
            if (act.to_mps if isinstance(act, Brake) else act.cruise_mps) < speed_mps:
                return True
            if trigger.adaptation is not None:
                return True
        drive = self.who.approach
        # It stops at its path's end, and is there at the earliest after this time.
        return drive is not None and Polyline(drive.path).length_m / drive.cruise_mps < end_s

    def surely_reached_s(self, speed_mps: float) -> float:
        """When its approach has it as fast as that at the latest, s after the start; inf: never."""
        drive = self.who.approach
        if self._is_vut or drive is None or speed_mps >= drive.cruise_mps:
            return math.inf
        return APPROACH_LEAD_S + speed_mps / drive.acceleration_mps2 + _SURELY_S

    @cached_property
    def points(self) -> FloatArray:
        """Places of its reference point, about half a metre apart, shape (n, 2), frame map."""
        start = np.array([[self.who.start.x_m, self.who.start.y_m]])
        found = [start]
        approach = self.who.approach
        if approach is not None:
            found.append(_along(Polyline(approach.path), 0.0))
        for trigger in self._acts:
            act = trigger.manoeuvre
            if isinstance(act, FollowPath):
                found.append(_along(Polyline(act.motion.path), 0.0))
            elif isinstance(act, LaneChange) and approach is not None:
                path = Polyline(approach.path)
                found += [
                    _along(path, share * act.lateral_shift_m) for share in _LANE_CHANGE_SHARES
                ]
        return np.concatenate(found)

    def room_m(self, polygon: Sequence[tuple[float, float]]) -> float:
        """The most room that it has inside a polygon, negative: it comes no nearer."""
        return max(room_m(x, y, polygon) for x, y in self.points.tolist())

    def ahead_m(self, path: Polyline) -> float:
        """How far ahead along a path its nearest point gets, m of arc length."""
        stations = [s for s, _ in path.project_all_beyond(self.points.tolist())]
        return max(stations) + max(self.size.front_m, self.size.rear_m)

    def stays_beside(self, path: Polyline, width_m: float) -> bool:
        """It is always outside the corridor of someone on a path, and keeps its distance."""
        offsets = [d for _, d in path.project_all_beyond(self.points.tolist())]
        low, high = min(offsets), max(offsets)
        half = 0.5 * self.size.width_m
        outside = min(abs(low), abs(high)) - half > corridor_half_m(width_m)
        return outside and high - low < _PARALLEL_M


def _along(path: Polyline, offset_m: float) -> FloatArray:
    count = max(2, math.ceil(path.length_m / SPACING_M) + 1)
    poses = [path.pose(float(s), offset_m) for s in np.linspace(0.0, path.length_m, count)]
    return np.array([(pose.x_m, pose.y_m) for pose in poses])


# Further beside the VUT's path an anchor isn't on its way.
ANCHOR_BESIDE_M = 10.0
# Conditions that may ask about the VUT by its id.
_OF_ANYONE = (SpeedIs, InRegion)


def unknown_objects(spec: RunSpec) -> list[str]:
    """Ids in conditions that nobody of the run has."""
    targets = {target.id for target in spec.targets}
    problems = []
    for i, trigger in enumerate(spec.triggers):
        for field, leaf in _fields(trigger.condition, f"triggers[{i}].condition"):
            who = getattr(leaf, "object_id", None)
            if who is None or who in targets or (isinstance(leaf, _OF_ANYONE) and who == VUT_ID):
                continue
            problems.append(f"{field}.object_id: {who} is no target of this run")
    return problems


def never_fire(spec: RunSpec) -> list[str]:
    """Why triggers of a run never fire, each with its field.

    Args:
        spec: a run whose VUT has a path, and in which every id is known.
    """
    able: list[TriggerSpec] = []
    while True:
        verdicts = [_Judge(spec, i, able).problems() for i in range(len(spec.triggers))]
        more = [t for t, found in zip(spec.triggers, verdicts, strict=True) if not found]
        if len(more) == len(able):
            return [problem for found in verdicts for problem in found]
        able = more


def _fields(condition: Condition, field: str) -> list[tuple[str, Leaf]]:
    if isinstance(condition, AllOf | AnyOf):
        return [
            pair
            for i, part in enumerate(condition.of)
            for pair in _fields(part, f"{field}.of[{i}]")
        ]
    return [(field, condition)]


@dataclass(frozen=True, slots=True)
class _May:
    """A condition may hold from a time on (s after the start), or can't for these reasons."""

    from_s: float = 0.0
    problems: tuple[str, ...] = ()


class _Judge:
    """One trigger, while only ``able`` ones are known to fire."""

    def __init__(self, spec: RunSpec, index: int, able: Sequence[TriggerSpec]) -> None:
        if spec.vut.approach is None:
            raise ValueError("the VUT has no path")
        self._spec = spec
        self._trigger = spec.triggers[index]
        self._field = f"triggers[{index}]"
        self._able = able
        self._path = Polyline(spec.vut.approach.path)
        self._end_s = min(spec.end.at_latest_s, spec.limits.duration_s)
        self._reaches: dict[str, Reach] = {}

    def problems(self) -> list[str]:
        trigger, field = self._trigger, self._field
        may = self._may(trigger.condition, f"{field}.condition")
        found = list(may.problems)
        if trigger.not_before_s >= self._end_s:
            early = f"{trigger.not_before_s:g} s is not before {self._end}"
            found.append(f"{field}.not_before_s: {early}")
        if found:
            return found
        found = self._edge()
        begin_s = max(may.from_s, trigger.not_before_s)
        if begin_s + trigger.held_for_s >= self._end_s:
            found.append(
                f"{field}.held_for_s: {trigger.held_for_s:g} s from {begin_s:g} s on, when it may "
                f"hold at the earliest, are not over before {self._end}"
            )
        longest_s = RESOLUTION_CONFIRMATION_S + self._spec.end.after_resolution_s
        if trigger.held_for_s > longest_s and _needs_resolution(trigger.condition):
            found.append(
                f"{field}.held_for_s: the run ends {longest_s:g} s after the start of the "
                "resolution"
            )
        return found

    @property
    def _end(self) -> str:
        return f"the end of the run ({self._end_s:g} s)"

    def _reach(self, object_id: str) -> Reach:
        if object_id not in self._reaches:
            spec = self._spec
            everyone = {VUT_ID: spec.vut, **{t.id: t for t in spec.targets}}
            self._reaches[object_id] = Reach(everyone[object_id], self._able, spec)
        return self._reaches[object_id]

    # -- edges ---------------------------------------------------------------------------------

    def _edge(self) -> list[str]:
        edge, condition = self._trigger.edge, self._trigger.condition
        field = f"{self._field}.edge"
        if edge == "none":
            return []
        if self._always(condition):
            return [f"{field}: {edge}, but it holds all the while from the first state on"]
        lasting = all(isinstance(part, ElapsedTime | PhaseReached) for part in leaves(condition))
        if edge == "falling" and lasting:
            return [f"{field}: falling, but times and phases don't cease to hold"]
        return []

    def _always(self, condition: Condition) -> bool:
        """It surely holds from the first state that counts to the end."""
        if isinstance(condition, AllOf):
            return all(self._always(part) for part in condition.of)
        if isinstance(condition, AnyOf):
            return any(self._always(part) for part in condition.of)
        if isinstance(condition, ElapsedTime):
            return condition.after_s <= self._trigger.not_before_s
        if isinstance(condition, SpeedIs) and condition.relation == "below":
            return condition.value_mps > max(
                self._reach(condition.object_id).fastest_mps, self._spec.limits.speed_mps
            )
        return False

    # -- conditions ----------------------------------------------------------------------------

    def _may(self, condition: Condition, field: str) -> _May:
        if isinstance(condition, AllOf):
            parts = [self._may(part, f"{field}.of[{i}]") for i, part in enumerate(condition.of)]
            problems = tuple(p for part in parts for p in part.problems)
            return _May(
                max(p.from_s for p in parts), problems or self._contradiction(condition, field)
            )
        if isinstance(condition, AnyOf):
            parts = [self._may(part, f"{field}.of[{i}]") for i, part in enumerate(condition.of)]
            able = [part.from_s for part in parts if not part.problems]
            if able:
                return _May(min(able))
            return _May(problems=tuple(p for part in parts for p in part.problems))
        return self._single(condition, field)

    def _contradiction(self, condition: AllOf, field: str) -> tuple[str, ...]:
        """Two speeds of one object that exclude each other."""
        speeds = [part for part in condition.of if isinstance(part, SpeedIs)]
        for above in (s for s in speeds if s.relation == "above"):
            for below in (s for s in speeds if s.relation == "below"):
                same = above.object_id == below.object_id
                if same and below.value_mps <= above.value_mps:
                    return (
                        f"{field}: {above.object_id} is never above {above.value_mps:g} m/s and "
                        f"below {below.value_mps:g} m/s at once",
                    )
        return ()

    def _single(self, condition: Leaf, field: str) -> _May:
        match condition:
            case TimeToArrival():
                return self._arrival(condition, field)
            case RelativeDistance() | TimeHeadway() | TimeToCollision():
                return self._ahead(condition, field)
            case SpeedIs():
                return self._speed(condition, field)
            case InRegion():
                return self._region(condition, field)
            case PhaseReached():
                return self._phase(condition, field)
            case ElapsedTime():
                if condition.after_s < self._end_s:
                    return _May(condition.after_s)
                late = f"{condition.after_s:g} s is not before {self._end}"
                return _May(problems=(f"{field}.after_s: {late}",))

    def _arrival(self, condition: TimeToArrival, field: str) -> _May:
        station, offset = self._path.project(*condition.anchor)
        front = self._spec.vut.size.front_m
        where = ""
        if station <= front:
            where = "lies behind the VUT's start"
        elif station >= self._path.length_m:
            where = "lies beyond the VUT's path"
        elif abs(offset) > ANCHOR_BESIDE_M:
            where = f"is {abs(offset):.1f} m beside the VUT's path"
        if where:
            return _May(problems=(f"{field}.anchor: {where}",))
        from_s = (station - front) / self._reach(VUT_ID).fastest_mps - condition.below_s
        if from_s < self._end_s:
            return _May(max(from_s, 0.0))
        why = f"the VUT isn't {condition.below_s:g} s away from it before {self._end}"
        return _May(problems=(f"{field}.anchor: {why}",))

    def _ahead(
        self, condition: RelativeDistance | TimeHeadway | TimeToCollision, field: str
    ) -> _May:
        who, vut = condition.object_id, self._spec.vut
        reach = self._reach(who)
        front, _ = self._path.project_beyond(vut.start.x_m, vut.start.y_m)
        problem = ""
        if reach.ahead_m(self._path) < front + vut.size.front_m:
            problem = f"{who} is never ahead of the VUT"
        elif isinstance(condition, TimeToCollision) and reach.stays_beside(
            self._path, vut.size.width_m
        ):
            problem = f"{who} stays beside the VUT's corridor, so that there is no TTC"
        return _May(problems=(f"{field}.object_id: {problem}",) if problem else ())

    def _speed(self, condition: SpeedIs, field: str) -> _May:
        who, value = condition.object_id, condition.value_mps
        reach = self._reach(who)
        field = f"{field}.value_mps"
        if condition.relation == "above":
            if value < reach.fastest_mps:
                return _May(value / self._spec.limits.acceleration_mps2)
            why = f"{who} is never faster than {reach.fastest_mps:g} m/s"
            return _May(problems=(f"{field}: {why}",))
        if value == 0.0:
            return _May(problems=(f"{field}: nothing is slower than 0 m/s",))
        rising = self._trigger.edge == "rising" and self._trigger.condition is condition
        if rising and reach.fastest_mps < value:
            why = f"{who} is always slower, never faster than {reach.fastest_mps:g} m/s"
            return _May(problems=(f"{field}: {why}",))
        at_first = reach.surely_reached_s(value) > self._trigger.not_before_s and not rising
        if at_first or reach.below_again(value, self._end_s):
            return _May()
        why = f"{who} has no motion that makes it slower than that again"
        return _May(problems=(f"{field}: {why}",))

    def _region(self, condition: InRegion, field: str) -> _May:
        reach = self._reach(condition.object_id)
        near_m = -reach.room_m(condition.polygon)
        if near_m <= self._spec.limits.error_lateral_m + SPACING_M / 2:
            return _May()
        why = f"{condition.object_id} comes no nearer than {near_m:.1f} m"
        return _May(problems=(f"{field}.polygon: {why}",))

    def _phase(self, condition: PhaseReached, field: str) -> _May:
        initiator = self._spec.initiator_id
        if any(t.object_id == initiator for t in self._able):
            return _May()
        why = f"no trigger of {initiator}, whose manoeuvre it needs, fires without it"
        return _May(problems=(f"{field}.phase: {condition.phase} is never reached: {why}",))


def _needs_resolution(condition: Condition) -> bool:
    """It can't hold before the resolution."""
    if isinstance(condition, AllOf):
        return any(_needs_resolution(part) for part in condition.of)
    if isinstance(condition, AnyOf):
        return all(_needs_resolution(part) for part in condition.of)
    return isinstance(condition, PhaseReached) and condition.phase == "resolution"


def cannot_fire(spec: RunSpec) -> list[str]:
    """Reasons for which a run's triggers could never fire; refused at load, not on the track."""
    if spec.vut.approach is None:
        return ["vut.approach: the VUT has no path, so that nothing it does can trigger"]
    problems = _not_unique(spec) + _not_paths(spec)
    if problems:
        return problems
    problems = off_route(spec)
    ids = {target.id for target in spec.targets}
    for i, trigger in enumerate(spec.triggers):
        problems += _not_drivable(trigger, f"triggers[{i}].manoeuvre", spec)
        if trigger.object_id not in ids:
            problems.append(
                f"triggers[{i}].object_id: {trigger.object_id} is no target of this run"
            )
    unknown = unknown_objects(spec)
    problems += unknown or never_fire(spec)
    return problems + _no_event(spec)


def _not_drivable(trigger: TriggerSpec, field: str, spec: RunSpec) -> list[str]:
    """What a manoeuvre needs of the approach that it leaves."""
    manoeuvre = trigger.manoeuvre
    target = next((t for t in spec.targets if t.id == trigger.object_id), None)
    if target is None or isinstance(manoeuvre, FollowPath):
        return []
    if target.approach is None:
        leaves = isinstance(manoeuvre, LaneChange)
        what = "a lane change could leave" if leaves else "it could brake on"
        return [f"{field}: {target.id} has no approach that {what}"]
    if isinstance(manoeuvre, Brake) and manoeuvre.to_mps >= target.approach.cruise_mps:
        return [
            f"{field}.to_mps: {manoeuvre.to_mps:g} m/s is not below the "
            f"{target.approach.cruise_mps:g} m/s at which {target.id} drives"
        ]
    return []


def _no_event(spec: RunSpec) -> list[str]:
    """Reasons for which no trigger or no conflict could ever be seen."""
    problems = []
    acts = [t.manoeuvre for t in spec.triggers if t.object_id == spec.initiator_id]
    if not acts:
        problems.append(f"initiator: {spec.initiator_id} has no trigger")
    if spec.observable == "braking":
        hardest = max((a.deceleration_mps2 for a in acts if isinstance(a, Brake)), default=None)
        if hardest is not None and hardest <= OBSERVABLE_BRAKING_MPS2:
            problems.append(
                f"observable: {spec.initiator_id} brakes at {hardest:g} m/s^2, which is not above "
                f"the {OBSERVABLE_BRAKING_MPS2:g} m/s^2 that can be seen"
            )
    if spec.thresholds.ttc_s is None and spec.thresholds.arrival_gap_s is None:
        problems.append("thresholds: neither ttc_s nor arrival_gap_s is given, so no conflict")
    return problems


def _not_unique(spec: RunSpec) -> list[str]:
    problems = []
    known = {spec.vut.id}
    for i, target in enumerate(spec.targets):
        if target.id in known:
            problems.append(f"targets[{i}].id: {target.id} stands twice")
        known.add(target.id)
    seen: set[str] = set()
    for i, trigger in enumerate(spec.triggers):
        if trigger.id in seen:
            problems.append(f"triggers[{i}].id: {trigger.id} stands twice")
        seen.add(trigger.id)
    return problems


def _not_paths(spec: RunSpec) -> list[str]:
    """Paths along which nothing can move."""
    paths: list[tuple[str, Path2]] = []
    for field, participant in [
        ("vut", spec.vut),
        *((f"targets[{i}]", target) for i, target in enumerate(spec.targets)),
    ]:
        if participant.approach is not None:
            paths.append((f"{field}.approach.path", participant.approach.path))
    for i, trigger in enumerate(spec.triggers):
        if isinstance(trigger.manoeuvre, FollowPath):
            path = trigger.manoeuvre.motion.path
            paths.append((f"triggers[{i}].manoeuvre.motion.path", path))
    problems = []
    for field, path in paths:
        try:
            Polyline(path)
        except ValueError as error:
            problems.append(f"{field}: {error}")
    return problems
