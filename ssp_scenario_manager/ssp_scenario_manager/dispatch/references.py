"""References that a session dispatches, at the start and at triggers, and unanswered ones."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.approach import approach_points, path_of
from ssp_core.motion.manoeuvre import brake_along, lane_change
from ssp_core.motion.reference import Points, Reference, sample
from ssp_core.motion.speed_profile import DEFAULT_RAMP_S
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Brake, FollowPath, Hold, LaneChange, Manoeuvre, Motion

# The time between dispatch and execute_at of the approach: every link has delivered by then.
APPROACH_LEAD_S = 0.5
# How long after execute_at a reference may still arrive and be answered.
EXPIRY_S = 1.0
# An object that heads further off its path than this is changing lane; a curve's chords are less.
BRAKE_HEADING_RAD = 0.1
# Nearer than this an object counts as on its path; beyond, it brakes beside it.
ON_PATH_M = 0.05


@dataclass(frozen=True, slots=True)
class Address:
    """The parts that all references of one dispatch share, beside their points."""

    reference_id: str
    object_id: str
    event_version: str
    purpose: str
    dispatched_ns: int
    execute_at_ns: int


def reference(address: Address, points: Points) -> Reference:
    return Reference(
        reference_id=address.reference_id,
        object_id=address.object_id,
        event_version=address.event_version,
        purpose=address.purpose,
        dispatched_ns=address.dispatched_ns,
        execute_at_ns=address.execute_at_ns,
        expires_at_ns=address.execute_at_ns + seconds_to_ns(EXPIRY_S),
        points=points,
    )


def prepare(spec: RunSpec) -> None:
    """Plan ahead what doesn't depend on where the objects will be, so that dispatch need not."""
    manoeuvres = [trigger.manoeuvre for trigger in spec.triggers]
    motions = [target.approach for target in spec.targets if target.approach is not None]
    motions += [each.motion for each in manoeuvres if isinstance(each, FollowPath)]
    for motion in motions:
        # One that can't be driven is told of when it is asked for.
        with suppress(ValueError):
            approach_points(motion).row_bytes()


def approach_reference(address: Address, motion: Motion) -> Reference:
    """Make the reference from standstill along the path to its end, and to standstill there."""
    return reference(address, approach_points(motion))


def manoeuvre_reference(
    address: Address,
    manoeuvre: Manoeuvre,
    state: ObjectState | None,
    current: Reference | None,
    approach: Motion | None,
) -> Reference:
    """Return the manoeuvre from where the object's present reference will be at execute_at.

    Args:
        address: of the new reference.
        manoeuvre: that a trigger asks for.
        state: the object's state, used where it has no reference yet; None where it has one.
        current: the reference that it tracks.
        approach: the path that it drives along, needed by all but a path of its own.

    Raises:
        ValueError: the manoeuvre needs an approach and there is none, or it can't be driven from
            there.
    """
    if isinstance(manoeuvre, FollowPath):
        return approach_reference(address, manoeuvre.motion)
    if isinstance(manoeuvre, Hold):
        raise ValueError(f"{address.object_id} holds what it does: there is nothing to send")
    if approach is None:
        raise ValueError(f"{address.object_id} has no approach that it could leave or brake on")
    path = path_of(approach)
    place = _place(path, address.execute_at_ns, state, current)
    if isinstance(manoeuvre, Brake):
        return reference(address, _brake(path, place, manoeuvre))
    points = lane_change(
        path,
        place.station_m,
        place.speed_mps,
        manoeuvre.lateral_shift_m,
        manoeuvre.duration_s,
        manoeuvre.cruise_mps,
        manoeuvre.deceleration_mps2,
        end_station_m=run_out_end_m(path, place.station_m, place.speed_mps, manoeuvre),
    )
    return reference(address, points)


def run_out_end_m(
    path: Polyline, station_m: float, speed_mps: float, manoeuvre: LaneChange | Brake
) -> float | None:
    """Return the station at which an object stands after its run-out; None: at its path's end.

    Args:
        path: of its approach.
        station_m: at which the manoeuvre begins.
        speed_mps: of the object then.
        manoeuvre: with its run-out; None in it: it has none.
    """
    if manoeuvre.run_out_s is None:
        return None
    rate = manoeuvre.deceleration_mps2
    if isinstance(manoeuvre, Brake):
        then_mps = manoeuvre.to_mps
        done_m = (speed_mps**2 - then_mps**2) / (2.0 * rate) + speed_mps * DEFAULT_RAMP_S
    else:
        then_mps = manoeuvre.cruise_mps
        done_m = max(speed_mps, then_mps) * manoeuvre.duration_s
    stop_m = then_mps * (then_mps / (2.0 * rate) + DEFAULT_RAMP_S)
    return min(station_m + done_m + then_mps * manoeuvre.run_out_s + stop_m, path.length_m)


@dataclass(frozen=True, slots=True)
class _Place:
    """A place along an object's path: arc length, offset to the left, heading off it."""

    station_m: float
    offset_m: float
    turned_rad: float
    speed_mps: float


def _place(
    path: Polyline, execute_at_ns: int, state: ObjectState | None, current: Reference | None
) -> _Place:
    here = state if current is None else sample(current, execute_at_ns)
    if here is None:
        raise ValueError("neither a reference nor a state says where it is")
    station, offset = path.project(here.x_m, here.y_m)
    turned = wrap_angle(here.yaw_rad - path.pose(station).yaw_rad)
    return _Place(station, offset, turned, here.speed_mps)


def _brake(path: Polyline, place: _Place, manoeuvre: Brake) -> Points:
    if abs(place.turned_rad) > BRAKE_HEADING_RAD:
        raise ValueError(
            f"it heads {abs(place.turned_rad):.2f} rad off its path and can't brake along it"
        )
    offset = place.offset_m if abs(place.offset_m) > ON_PATH_M else 0.0
    return brake_along(
        path,
        place.station_m,
        place.speed_mps,
        manoeuvre.to_mps,
        manoeuvre.deceleration_mps2,
        offset,
        run_out_end_m(path, place.station_m, place.speed_mps, manoeuvre),
    )


# An answer that hasn't come after so long may have been lost, or its reference.
RESEND_S = 0.06
# Refusals of ReferenceAck.msg that say no more than that the link was slow, or lost one before.
# Whatever else is refused tells that object and manager don't agree on what may be driven.
NOT_RUNNING, _LATE, _DISCONTINUOUS = 1, 2, 5
ADAPTED = "adapted"


def is_fatal(reference: Reference, code: int) -> bool:
    """Tell whether a refusal of this reference ends the run.

    Without its approach or its manoeuvre an object doesn't do what the event needs. An object that
    gets an adapted reference too late goes on with a manoeuvre that it has accepted; after any
    other refusal it stops by itself.

    Args:
        reference: that was refused.
        code: REFUSED_* of ReferenceAck.msg.
    """
    return reference.purpose != ADAPTED or code not in (_LATE, _DISCONTINUOUS)


class PendingReferences:
    """References of a run that wait for their answer. Reads no clock."""

    def __init__(self) -> None:
        self._due: dict[str, Reference] = {}
        self._sent_ns: dict[str, int] = {}
        self._copied: set[str] = set()

    def expect(self, reference: Reference) -> None:
        """Expect the answer to a reference that is sent for the first time."""
        self._due[reference.reference_id] = reference
        self._sent_ns[reference.reference_id] = reference.dispatched_ns

    def take(self, reference_id: str, *, accepted: bool) -> Reference | None:
        """Take an answer; return None when none was due, as for the answer to a copy."""
        reference = self._due.get(reference_id)
        if reference is None:
            return None
        settled = [reference_id]
        if accepted:
            settled += [
                r.reference_id
                for r in self._due.values()
                if r.purpose == ADAPTED
                and r.object_id == reference.object_id
                and r.dispatched_ns < reference.dispatched_ns
            ]
        for each in settled:
            del self._due[each], self._sent_ns[each]
            self._copied.discard(each)
        return reference

    @property
    def due(self) -> tuple[Reference, ...]:
        """List the references that haven't been answered, in the order of dispatch."""
        return tuple(self._due.values())

    def again(self, now_ns: int, step_s: float) -> list[Reference]:
        """List the references to send again now.

        Args:
            now_ns: session time.
            step_s: of the world; an answer needs two steps.
        """
        step_ns = seconds_to_ns(step_s)
        wait_ns = max(seconds_to_ns(RESEND_S), 3 * step_ns)
        newest = {r.object_id: r for r in self._due.values()}
        copies = []
        for reference in self._due.values():
            name, adapted = reference.reference_id, reference.purpose == ADAPTED
            hurry = name in self._copied and not adapted
            if now_ns - self._sent_ns[name] < (step_ns if hurry else wait_ns):
                continue
            if adapted and newest[reference.object_id] is not reference:
                continue
            # Also one that can't be taken any more: its answer says whether it was.
            self._sent_ns[name] = now_ns
            self._copied.add(name)
            copies.append(reference)
        return copies
