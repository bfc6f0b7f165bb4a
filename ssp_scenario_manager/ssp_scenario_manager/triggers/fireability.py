"""Reasons for which a run file is refused at load.

Refused are unknown ids, times that the run doesn't reach, edges that can't occur, paths and
manoeuvres that can't be driven, and runs that can't show an event. Whether the traffic brings a
condition about isn't judged here: the compiler simulates each plan.
"""

from __future__ import annotations

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import OBSERVABLE_BRAKING_MPS2
from ssp_core.motion.event import RESOLUTION_CONFIRMATION_S
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    Brake,
    Condition,
    ElapsedTime,
    FollowPath,
    Hold,
    InRegion,
    LaneChange,
    Leaf,
    PhaseReached,
    SpeedIs,
    TriggerSpec,
)
from ssp_core.run_file.values import Path2
from ssp_scenario_manager.triggers.conditions import leaves
from ssp_scenario_manager.triggers.on_route import off_route

# Conditions that may name the VUT.
_OF_ANYONE = (SpeedIs, InRegion)


def unknown_objects(spec: RunSpec) -> list[str]:
    """List the ids in conditions that no participant of the run has."""
    targets = {target.id for target in spec.targets}
    problems = []
    for i, trigger in enumerate(spec.triggers):
        for field, leaf in _fields(trigger.condition, f"triggers[{i}].condition"):
            object_id = getattr(leaf, "object_id", None)
            if object_id is None or object_id in targets:
                continue
            if isinstance(leaf, _OF_ANYONE) and object_id == VUT_ID:
                continue
            problems.append(f"{field}.object_id: {object_id} is no target of this run")
    return problems


def _fields(condition: Condition, field: str) -> list[tuple[str, Leaf]]:
    if isinstance(condition, AllOf | AnyOf):
        return [
            pair
            for i, part in enumerate(condition.of)
            for pair in _fields(part, f"{field}.of[{i}]")
        ]
    return [(field, condition)]


def _times(spec: RunSpec, trigger: TriggerSpec, field: str) -> list[str]:
    """List the times of a trigger that the run doesn't reach."""
    end_s = min(spec.end.at_latest_s, spec.limits.duration_s)
    end = f"the end of the run ({end_s:g} s)"
    condition = trigger.condition
    problems = []
    if _earliest_s(condition) >= end_s:
        problems = [
            f"{path}.after_s: {leaf.after_s:g} s is not before {end}"
            for path, leaf in _fields(condition, f"{field}.condition")
            if isinstance(leaf, ElapsedTime) and leaf.after_s >= end_s
        ]
    if trigger.not_before_s >= end_s:
        problems.append(f"{field}.not_before_s: {trigger.not_before_s:g} s is not before {end}")
    if problems:
        return problems
    begin_s = max(_earliest_s(condition), trigger.not_before_s)
    if begin_s + trigger.held_for_s >= end_s:
        problems.append(
            f"{field}.held_for_s: {trigger.held_for_s:g} s from {begin_s:g} s on, when it may "
            f"hold at the earliest, are not over before {end}"
        )
    longest_s = RESOLUTION_CONFIRMATION_S + spec.end.after_resolution_s
    if trigger.held_for_s > longest_s and _needs_resolution(condition):
        problems.append(
            f"{field}.held_for_s: the run ends {longest_s:g} s after the start of the resolution"
        )
    return problems


def _earliest_s(condition: Condition) -> float:
    """Give the time before which its `elapsed_time` parts keep a condition from holding, s."""
    if isinstance(condition, AllOf):
        return max(_earliest_s(part) for part in condition.of)
    if isinstance(condition, AnyOf):
        return min(_earliest_s(part) for part in condition.of)
    return condition.after_s if isinstance(condition, ElapsedTime) else 0.0


def _needs_resolution(condition: Condition) -> bool:
    """Tell whether a condition can't hold before the resolution."""
    if isinstance(condition, AllOf):
        return any(_needs_resolution(part) for part in condition.of)
    if isinstance(condition, AnyOf):
        return all(_needs_resolution(part) for part in condition.of)
    return isinstance(condition, PhaseReached) and condition.phase == "resolution"


def _edge(spec: RunSpec, trigger: TriggerSpec, field: str) -> list[str]:
    """Name an edge that can't occur."""
    edge, condition = trigger.edge, trigger.condition
    if edge == "none":
        return []
    if _always(condition, trigger.not_before_s, spec.limits.speed_mps):
        return [f"{field}.edge: {edge}, but it holds all the while from the first state on"]
    lasting = all(isinstance(part, ElapsedTime | PhaseReached) for part in leaves(condition))
    if edge == "falling" and lasting:
        return [f"{field}.edge: falling, but times and phases don't cease to hold"]
    return []


def _always(condition: Condition, from_s: float, speed_limit_mps: float) -> bool:
    """Tell whether a condition holds from the first state that counts to the end.

    Args:
        condition: any condition.
        from_s: time of that state, s after the start.
        speed_limit_mps: a session in which a participant is faster is aborted.
    """
    if isinstance(condition, AllOf):
        return all(_always(part, from_s, speed_limit_mps) for part in condition.of)
    if isinstance(condition, AnyOf):
        return any(_always(part, from_s, speed_limit_mps) for part in condition.of)
    if isinstance(condition, ElapsedTime):
        return condition.after_s <= from_s
    if isinstance(condition, SpeedIs) and condition.relation == "below":
        return condition.value_mps > speed_limit_mps
    return False


def cannot_fire(spec: RunSpec) -> list[str]:
    """List the reasons for which a run is refused at load, each with its field."""
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
    problems += unknown_objects(spec)
    for i, trigger in enumerate(spec.triggers):
        field = f"triggers[{i}]"
        problems += _times(spec, trigger, field) or _edge(spec, trigger, field)
    return problems + _no_event(spec)


def _not_drivable(trigger: TriggerSpec, field: str, spec: RunSpec) -> list[str]:
    """Name what a manoeuvre needs of the approach that it leaves, and doesn't find."""
    manoeuvre = trigger.manoeuvre
    target = next((t for t in spec.targets if t.id == trigger.object_id), None)
    if target is None or isinstance(manoeuvre, FollowPath | Hold):
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
    """List the reasons for which the run could show no event or no conflict."""
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
    participant_ids = {spec.vut.id}
    for i, target in enumerate(spec.targets):
        if target.id in participant_ids:
            problems.append(f"targets[{i}].id: {target.id} stands twice")
        participant_ids.add(target.id)
    trigger_ids: set[str] = set()
    for i, trigger in enumerate(spec.triggers):
        if trigger.id in trigger_ids:
            problems.append(f"triggers[{i}].id: {trigger.id} stands twice")
        trigger_ids.add(trigger.id)
    return problems


def _not_paths(spec: RunSpec) -> list[str]:
    """List the paths along which nothing can move."""
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
