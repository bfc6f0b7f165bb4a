"""What keeps a run file from ever becoming an event: refused at load, not on the track."""

from __future__ import annotations

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import OBSERVABLE_BRAKING_MPS2
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Brake, FollowPath, LaneChange, TriggerSpec
from ssp_core.run_file.values import Path2
from ssp_scenario_manager.core import fireable


def cannot_fire(spec: RunSpec) -> list[str]:
    """Reasons for which a run's triggers could never fire; refused at load, not on the track."""
    if spec.vut.approach is None:
        return ["vut.approach: the VUT has no path, so that nothing it does can trigger"]
    problems = _not_unique(spec) + _not_paths(spec)
    if problems:
        return problems
    ids = {target.id for target in spec.targets}
    for i, trigger in enumerate(spec.triggers):
        problems += _not_drivable(trigger, f"triggers[{i}].manoeuvre", spec)
        if trigger.object_id not in ids:
            problems.append(
                f"triggers[{i}].object_id: {trigger.object_id} is no target of this run"
            )
    unknown = fireable.unknown_objects(spec)
    problems += unknown or fireable.never_fire(spec)
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
