"""References that a session dispatches: the approach at the start, a manoeuvre at a trigger."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.profile import drive_along, lane_change
from ssp_core.reference import Reference, ReferencePoint, sample
from ssp_core.run_spec import FollowPath, LaneChange, Manoeuvre, Motion
from ssp_core.state import ObjectState

# The time between dispatch and execute_at of the approach: every link has delivered by then.
APPROACH_LEAD_S = 0.5
# How long after execute_at a reference may still arrive and be answered.
EXPIRY_S = 1.0


@dataclass(frozen=True, slots=True)
class Address:
    """What every reference of one dispatch carries beside its points."""

    reference_id: str
    object_id: str
    event_version: str
    purpose: str
    dispatched_ns: int
    execute_at_ns: int


def _reference(address: Address, points: list[ReferencePoint]) -> Reference:
    return Reference(
        reference_id=address.reference_id,
        object_id=address.object_id,
        event_version=address.event_version,
        purpose=address.purpose,
        dispatched_ns=address.dispatched_ns,
        execute_at_ns=address.execute_at_ns,
        expires_at_ns=address.execute_at_ns + seconds_to_ns(EXPIRY_S),
        points=tuple(points),
    )


def approach_reference(address: Address, motion: Motion) -> Reference:
    """From standstill along the path to its end, where it stands again."""
    return _reference(
        address,
        drive_along(
            Polyline(motion.path),
            0.0,
            0.0,
            motion.cruise_mps,
            motion.acceleration_mps2,
            motion.deceleration_mps2,
        ),
    )


def manoeuvre_reference(
    address: Address,
    manoeuvre: Manoeuvre,
    state: ObjectState,
    current: Reference | None,
    approach: Motion | None,
) -> Reference:
    """The manoeuvre from where the object's present reference will be at execute_at.

    Args:
        address: ids and times.
        manoeuvre: what to do.
        state: the object's state, used where it has no reference yet.
        current: the reference that it tracks.
        approach: the path that it drives along, needed by a lane change.

    Raises:
        ValueError: a lane change for an object that has no approach to leave.
    """
    if isinstance(manoeuvre, FollowPath):
        motion = manoeuvre.motion
        return _reference(
            address,
            drive_along(
                Polyline(motion.path),
                0.0,
                0.0,
                motion.cruise_mps,
                motion.acceleration_mps2,
                motion.deceleration_mps2,
            ),
        )
    if approach is None:
        raise ValueError(f"{address.object_id} has no approach that a lane change could leave")
    return _lane_change(address, manoeuvre, state, current, approach)


def _lane_change(
    address: Address,
    manoeuvre: LaneChange,
    state: ObjectState,
    current: Reference | None,
    approach: Motion,
) -> Reference:
    path = Polyline(approach.path)
    if current is not None:
        point = sample(current, address.execute_at_ns)
        station, _ = path.project(point.x_m, point.y_m)
        speed = point.speed_mps
    else:
        station, _ = path.project(state.x_m, state.y_m)
        speed = state.speed_mps
    points = lane_change(
        path,
        station,
        speed,
        manoeuvre.lateral_shift_m,
        manoeuvre.duration_s,
        manoeuvre.cruise_mps,
        manoeuvre.deceleration_mps2,
    )
    return _reference(address, points)
