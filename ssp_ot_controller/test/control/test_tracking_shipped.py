"""Accuracy on the shipped scenarios: their own references, tracked on the plant."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.reference import Reference, sample
from ssp_core.run_file.participants import Hold, ParticipantSpec
from ssp_ot_controller.bodies.dynamics import LIMITS as BODIES
from ssp_ot_controller.bodies.dynamics import BodyLimits, BodyState, step_body, tightened
from ssp_ot_controller.control.tracker import Tracker
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.dispatch.references import (
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.places import site_of
from tests.support.states import object_state, state_of_body

LATERAL_RMS_M = 0.05
LONGITUDINAL_RMS_M = 0.10
# When the manoeuvre is asked for: at cruise speed, or at once by who has no approach.
TRIGGER_S = 10.0


@cache
def shipped(event: str) -> tuple[ParticipantSpec, BodyLimits, tuple[Reference, ...]]:
    """The object that acts in an event, its body on the site, and the references that it gets."""
    site = site_of(event)
    run = compile_task(Request(event=event, target="sumo", site=site)).task.run
    trigger = run.triggers[-1]
    target = next(t for t in run.targets if t.id == trigger.object_id)
    start = target.start
    state = object_state(target.id, target.cls, start.x_m, start.y_m, start.yaw_rad)
    references = []
    if target.approach is not None:
        first = Address("a", target.id, run.event_version, "approach", 0, 0)
        references.append(approach_reference(first, target.approach))
    at_ns = seconds_to_ns(TRIGGER_S) if references else 0
    second = Address("b", target.id, run.event_version, "manoeuvre", at_ns, at_ns)
    current = references[0] if references else None
    if not isinstance(trigger.manoeuvre, Hold):
        references.append(
            manoeuvre_reference(second, trigger.manoeuvre, state, current, target.approach)
        )
    return target, tightened(BODIES[target.cls], run.limits), tuple(references)


def errors_m(event: str, step_s: float, to_s: float) -> tuple[float, float]:
    """Rms of the longitudinal and lateral errors over both references, to the last standstill."""
    target, body_limits, references = shipped(event)
    tracker = Tracker(target.cls, body_limits, step_s)
    step_ns = seconds_to_ns(step_s)
    at = sample(references[0], 0)
    body = BodyState(at.x_m, at.y_m, at.yaw_rad, at.speed_mps, at.acceleration_mps2)
    rows = []
    end_ns = min(references[-1].end_ns + seconds_to_ns(1.0), seconds_to_ns(to_s))
    for k in range(end_ns // step_ns):
        now_ns = k * step_ns
        driven = [r for r in references if r.execute_at_ns <= now_ns][-1]
        state = state_of_body(body, now_ns, target.id, target.cls)
        command, error = tracker.track(state, driven, now_ns)
        rows.append((error.longitudinal_m, error.lateral_m))
        body = step_body(target.cls, body, command, step_s)
    longitudinal_m, lateral_m = np.sqrt((np.array(rows) ** 2).mean(axis=0)).tolist()
    return longitudinal_m, lateral_m


@pytest.mark.parametrize("event", sorted(KINDS))
def test_tracking_errors_at_100_hz(event: str) -> None:
    longitudinal_m, lateral_m = errors_m(event, 0.01, 30.0)
    assert longitudinal_m <= LONGITUDINAL_RMS_M
    assert lateral_m <= LATERAL_RMS_M
