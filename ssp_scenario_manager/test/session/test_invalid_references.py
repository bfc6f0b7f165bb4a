"""Strange references are refused by the object's own check, for the reason that is meant."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference, sample
from ssp_core.run_file.model import Limits
from ssp_core.vocabulary import ControlState, ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS, tightened
from ssp_ot_controller.control.stopping import StoppingRoom
from ssp_ot_controller.objects.references import Refusal, RefusalCode, check_reference
from ssp_scenario_manager.dispatch import invalid_references

S = 1_000_000_000
NOW_NS = 8 * S
FENCE = [(-10.0, -6.0), (300.0, -6.0), (300.0, 10.0), (-10.0, 10.0)]


def check_of(reference: Reference, current: Any, previous: Reference | None) -> Refusal | None:
    limits = Limits(speed_mps=15.0, acceleration_mps2=4.5)
    return check_reference(
        reference,
        now_ns=NOW_NS,
        current=current,
        previous=previous,
        limits=limits,
        geofence=FENCE,
        body_limits=tightened(LIMITS[current.object_class], limits),
        event_version="sha256:event",
        control_state=ControlState.RUNNING,
        stop_room=StoppingRoom(current.object_class, current.size, limits, FENCE, 0.02),
    )


@pytest.fixture
def driving() -> Reference:
    """A car's approach in the left lane, six seconds old."""
    path = Polyline([(40.0, 3.5), (250.0, 3.5)])
    return Reference(
        reference_id="ot1-1",
        object_id="ot1",
        event_version="sha256:event",
        purpose="approach",
        dispatched_ns=2 * S,
        execute_at_ns=2 * S,
        expires_at_ns=3 * S,
        points=tuple(drive_along(path, 0.0, 0.0, 7.0, 2.0, 2.0)),
    )


def refusals(here: Any, current: Reference | None) -> tuple[list[RefusalCode], Reference]:
    """Return the refusals of a stale reference and one out of the fence, and the latter itself."""
    old = invalid_references.stale("r", here, current, "sha256:event", NOW_NS)
    out = invalid_references.out_of_fence("r", here, current, "sha256:event", NOW_NS, FENCE)
    given = [check_of(old, here, current), check_of(out, here, current)]
    return [one.code for one in given if one is not None], out


def test_a_driving_car_refuses_both(driving: Reference, state: Any) -> None:
    here = sample(driving, NOW_NS)
    car = state("ot1", stamp_ns=NOW_NS, x_m=here.x_m, y_m=3.5, speed_mps=here.speed_mps)
    codes, out = refusals(car, driving)
    assert codes == [RefusalCode.EXPIRED, RefusalCode.FENCE]
    assert out.points[-1].x_m > 300.0
    assert out.points[-1].speed_mps == 0.0


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, -2.5])
def test_a_standing_dummy_refuses_both(yaw_rad: float, state: Any) -> None:
    person = state(
        "ot1", ObjectClass.PEDESTRIAN, stamp_ns=NOW_NS, x_m=100.0, y_m=-3.0, yaw_rad=yaw_rad
    )
    assert refusals(person, None)[0] == [RefusalCode.EXPIRED, RefusalCode.FENCE]
