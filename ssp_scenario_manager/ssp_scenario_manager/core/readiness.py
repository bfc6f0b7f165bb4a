"""What a session needs before it connects, arms and starts: everything that is missing, at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.geometry import Polyline, box_distance, point_in_polygon
from ssp_core.run_spec import LaneChange, Path2, RelativeDistance, RunSpec
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState

START_REGION_M = 1.5


@dataclass(frozen=True, slots=True)
class Facts:
    """What the node knows beside the states. Ages on the steady clock, s; inf is never."""

    recorder_ready: bool = False
    recorder_missing: tuple[str, ...] = ()
    recorder_age_s: float = math.inf
    camera_age_s: float = math.inf
    vut_age_s: float = math.inf
    target_age_s: tuple[tuple[str, float], ...] = ()

    def age_of(self, object_id: str) -> float:
        return dict(self.target_age_s).get(object_id, math.inf)


FRESH_S = 1.0
RECORDER_FRESH_S = 2.0
CAMERA_FRESH_S = 3.0


def cannot_fire(spec: RunSpec) -> list[str]:
    """Reasons for which a run's triggers could never fire; refused at load, not on the track."""
    if spec.vut.approach is None:
        return ["vut.approach: the VUT has no path, so that nothing it does can trigger"]
    problems = _not_unique(spec) + _not_paths(spec)
    if problems:
        return problems
    ids = {target.id for target in spec.targets}
    leaving = {target.id for target in spec.targets if target.approach is not None}
    path = Polyline(spec.vut.approach.path)
    for i, trigger in enumerate(spec.triggers):
        field = f"triggers[{i}]"
        if isinstance(trigger.manoeuvre, LaneChange) and trigger.object_id in ids - leaving:
            problems.append(
                f"{field}.manoeuvre: {trigger.object_id} has no approach that a lane change could "
                "leave"
            )
        if trigger.object_id not in ids:
            problems.append(f"{field}.object_id: {trigger.object_id} is no target of this run")
        condition = trigger.condition
        if isinstance(condition, RelativeDistance):
            if condition.object_id not in ids:
                problems.append(
                    f"{field}.condition.object_id: {condition.object_id} is no target of this run"
                )
        else:
            station, offset = path.project(*condition.anchor)
            if station <= spec.vut.size.front_m:
                problems.append(f"{field}.condition.anchor: lies behind the VUT's start")
            elif station >= path.length_m:
                problems.append(f"{field}.condition.anchor: lies beyond the VUT's path")
            elif abs(offset) > 10.0:
                problems.append(
                    f"{field}.condition.anchor: is {abs(offset):.1f} m beside the VUT's path"
                )
        if trigger.not_before_s >= spec.end.at_latest_s:
            problems.append(
                f"{field}.not_before_s: {trigger.not_before_s:g} s is not before the end of the "
                f"run ({spec.end.at_latest_s:g} s)"
            )
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
        if not isinstance(trigger.manoeuvre, LaneChange):
            path = trigger.manoeuvre.motion.path
            paths.append((f"triggers[{i}].manoeuvre.motion.path", path))
    problems = []
    for field, path in paths:
        try:
            Polyline(path)
        except ValueError as error:
            problems.append(f"{field}: {error}")
    return problems


def missing_to_connect(
    spec: RunSpec, facts: Facts, vut: ObjectState | None, targets: dict[str, ObjectState]
) -> list[str]:
    """Every participant is heard."""
    missing = []
    if vut is None or facts.vut_age_s > FRESH_S:
        missing.append("no state of the VUT arrives")
    missing += [
        f"no state of {target.id} arrives"
        for target in spec.targets
        if target.id not in targets or facts.age_of(target.id) > FRESH_S
    ]
    return missing


def missing_to_arm(
    spec: RunSpec, facts: Facts, vut: ObjectState | None, targets: dict[str, ObjectState]
) -> list[str]:
    """Participants fresh and DISARMED, recorder ready, everybody in place, fence and separation."""
    missing = missing_to_connect(spec, facts, vut, targets)
    if facts.recorder_age_s > RECORDER_FRESH_S:
        missing.append("the recorder is silent")
    elif not facts.recorder_ready:
        topics = ", ".join(facts.recorder_missing) or "its file is not open"
        missing.append(f"the recorder is not ready: {topics}")
    if spec.camera is not None and facts.camera_age_s > CAMERA_FRESH_S:
        missing.append("no camera frame arrives")
    if vut is not None:
        missing += _out_of_place("vut", vut, spec.vut.start.x_m, spec.vut.start.y_m, spec)
    for target in spec.targets:
        state = targets.get(target.id)
        if state is None:
            continue
        if state.control_state not in (ControlState.DISARMED, ControlState.ARMED):
            missing.append(f"{target.id} is {state.control_state.name}, not DISARMED")
        missing += _out_of_place(target.id, state, target.start.x_m, target.start.y_m, spec)
        if vut is not None:
            distance = box_distance(vut.box, state.box)
            if distance < spec.limits.separation_m:
                missing.append(
                    f"{target.id} is {distance:.2f} m from the VUT, "
                    f"limit {spec.limits.separation_m:g} m"
                )
    return missing


def missing_to_start(
    spec: RunSpec, facts: Facts, vut: ObjectState | None, targets: dict[str, ObjectState]
) -> list[str]:
    """Everybody is still heard, every object reports that it is armed, the recorder is there."""
    missing = missing_to_connect(spec, facts, vut, targets)
    if not facts.recorder_ready or facts.recorder_age_s > RECORDER_FRESH_S:
        missing.append("the recorder is not ready")
    for target in spec.targets:
        state = targets.get(target.id)
        if state is not None and state.control_state is not ControlState.ARMED:
            missing.append(f"{target.id} is {state.control_state.name}, not ARMED")
    return missing


def _out_of_place(
    name: str, state: ObjectState, x_m: float, y_m: float, spec: RunSpec
) -> list[str]:
    problems = []
    away = math.hypot(state.x_m - x_m, state.y_m - y_m)
    if away > START_REGION_M:
        problems.append(f"{name} is {away:.2f} m from its start, limit {START_REGION_M:g} m")
    if abs(state.speed_mps) > 0.05:
        problems.append(f"{name} moves at {state.speed_mps:.2f} m/s")
    if not point_in_polygon(state.x_m, state.y_m, spec.geofence):
        problems.append(f"{name} is outside the geofence")
    return problems
