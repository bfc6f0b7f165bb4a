"""References of an object: the checks before one is accepted, and the queue of those that were."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.motion.reference import PLACES_S, Reference, moving_steps_s, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety.fence import way_excess_m
from ssp_core.vocabulary import ControlState, ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyLimits
from ssp_ot_controller.control.stopping import StoppingRoom

# How far a step's length and change of speed may differ from what its points say.
_STEP_M = 0.1
_STEP_SHARE = 0.05
_ACCELERATION_MPS2 = 0.5
_SPEED_MPS = 1e-3
# How far speeds and headings may lead from the places, all in all.
_AWAY_M = 0.5
_AWAY_SHARE = 0.02


def contradiction(columns: FloatArray) -> str | None:
    """Return the first contradiction between columns, for people; None when there is none.

    Args:
        columns: of a reference: t, x, y, yaw, speed, acceleration, curvature; finite, t rising.
    """
    return _of_steps(columns) or _of_speeds(columns) or _of_headings(columns)


def _travel_m(columns: FloatArray) -> FloatArray:
    t, speed = columns[0], columns[4]
    travel_m: FloatArray = 0.5 * (speed[:-1] + speed[1:]) * np.diff(t)
    return travel_m


def _of_steps(columns: FloatArray) -> str | None:
    moved = np.hypot(np.diff(columns[1]), np.diff(columns[2]))
    travel_m = _travel_m(columns)
    gap = np.abs(moved - travel_m)
    i = int(np.argmax(gap - _STEP_SHARE * travel_m))
    allowed = _STEP_M + _STEP_SHARE * travel_m[i]
    if gap[i] <= allowed:
        return None
    return (
        f"from point {i} to {i + 1} it moves {moved[i]:.3f} m while its speeds say "
        f"{travel_m[i]:.3f} m, limit is {allowed:.3f} m apart"
    )


def _of_speeds(columns: FloatArray) -> str | None:
    t, speed, stated = columns[0], columns[4], np.abs(columns[5])
    change = np.diff(speed)
    most = np.maximum(stated[:-1], stated[1:])
    over = np.abs(change) - (most + _ACCELERATION_MPS2) * np.diff(t) - _SPEED_MPS
    i = int(np.argmax(over))
    if over[i] <= 0.0:
        return None
    return (
        f"from point {i} to {i + 1} its speed changes by {change[i]:.3f} m/s in "
        f"{t[i + 1] - t[i]:.3f} s, while it states {most[i]:.3f} m/s^2 at most, limit is "
        f"{_ACCELERATION_MPS2:g} m/s^2 apart"
    )


def _of_headings(columns: FloatArray) -> str | None:
    _, x, y, yaw = columns[:4]
    travel_m = _travel_m(columns)
    middle = yaw[:-1] + 0.5 * (np.mod(np.diff(yaw) + np.pi, 2.0 * np.pi) - np.pi)
    away = np.hypot(
        x[1:] - x[0] - np.cumsum(travel_m * np.cos(middle)),
        y[1:] - y[0] - np.cumsum(travel_m * np.sin(middle)),
    )
    allowed = _AWAY_M + _AWAY_SHARE * np.cumsum(travel_m)
    over = away - allowed
    i = int(np.argmax(over > 0.0))
    if over[i] <= 0.0:
        return None
    return (
        f"point {i + 1} is {away[i]:.3f} m from where its speeds and headings lead, limit is "
        f"{allowed[i]:.3f} m"
    )


# A reference lasts a day at most; of far larger times no nanoseconds can be made.
_LAST_S = 86_400.0
# For so long it may move in steps that need places between to be judged.
_SPARSE_S = 600.0
# How far a reference may start from where the object will be; pedestrians turn on the spot.
_JUMP_M, _JUMP_RAD, _JUMP_MPS = 0.5, 0.2, 1.0
# Rounding of a profile that drives exactly at a limit is no refusal.
_ROUNDING = 1e-6


class RefusalCode(IntEnum):
    """Numbers of ReferenceAck.msg."""

    STATE = 1
    LATE = 2
    EXPIRED = 3
    MALFORMED = 4
    DISCONTINUOUS = 5
    LIMIT = 6
    FENCE = 7
    MOVING_END = 8
    VERSION = 9


@dataclass(frozen=True, slots=True)
class Refusal:
    """The reason why a reference is refused.

    It is a number, and one sentence with measured value and limit.
    """

    code: RefusalCode
    message: str


def check_reference(
    reference: Reference,
    *,
    now_ns: int,
    current: ObjectState,
    previous: Reference | None,
    limits: Limits,
    geofence: Sequence[tuple[float, float]],
    body_limits: BodyLimits,
    event_version: str,
    control_state: ControlState,
    stop_room: StoppingRoom,
) -> Refusal | None:
    """Return the first reason to refuse a reference, None when it may be taken.

    Args:
        reference: to be driven.
        now_ns: on the object's clock.
        current: the object's own state; its size is used against the fence.
        previous: the reference being tracked or waiting, None when there is none.
        limits: of the run.
        geofence: polygon, m, frame map.
        body_limits: of the object's body.
        event_version: K* version that the object was connected with.
        control_state: references are taken in RUNNING only.
        stop_room: of the object, in this fence.
    """
    return (
        _check_state(control_state)
        or _check_version(reference, event_version)
        or _check_times(reference, now_ns)
        or _check_form(reference, current)
        or _check_start(reference, current, previous)
        or _check_limits(reference, limits, body_limits)
        or _check_steps(reference)
        or _check_fence(reference, current, geofence)
        or _check_end(reference)
        or _check_stops(reference, stop_room)
    )


def _check_state(control_state: ControlState) -> Refusal | None:
    if control_state is ControlState.RUNNING:
        return None
    return Refusal(
        RefusalCode.STATE, f"object is {control_state.name}; references are taken in RUNNING"
    )


def _check_version(reference: Reference, event_version: str) -> Refusal | None:
    if reference.event_version == event_version:
        return None
    return Refusal(
        RefusalCode.VERSION,
        f"reference is of event {reference.event_version or 'none'}, loaded is {event_version}",
    )


def _check_times(reference: Reference, now_ns: int) -> Refusal | None:
    if now_ns >= reference.expires_at_ns:
        over = ns_to_seconds(now_ns - reference.expires_at_ns)
        return Refusal(RefusalCode.EXPIRED, f"expired {over:.3f} s ago; limit is before expires_at")
    if now_ns > reference.execute_at_ns:
        over = ns_to_seconds(now_ns - reference.execute_at_ns)
        way = ns_to_seconds(now_ns - reference.dispatched_ns)
        return Refusal(
            RefusalCode.LATE,
            f"execute_at was {over:.3f} s ago; limit is 0 s. It came {way:.3f} s after its "
            "dispatch: the machine or the link was too slow for its lead_time_s",
        )
    return None


def _malformed(text: str) -> Refusal:
    return Refusal(RefusalCode.MALFORMED, text)


def _check_form(reference: Reference, current: ObjectState) -> Refusal | None:
    if reference.object_id != current.object_id:
        return _malformed(f"is for {reference.object_id!r}, this is {current.object_id!r}")
    if len(reference.points) < 2:
        return _malformed(f"has {len(reference.points)} point(s), needs at least 2")
    columns = reference.columns
    if not np.isfinite(columns).all():
        bad = int(np.flatnonzero(~np.isfinite(columns).all(axis=0))[0])
        return _malformed(f"point {bad} holds a value that isn't finite")
    t, speed = columns[0], columns[4]
    if t[0] < 0.0:
        return _malformed(f"first point is at {t[0]:.3f} s, limit is 0 s")
    falls = np.flatnonzero(np.diff(t) <= 0.0)
    if len(falls):
        i = int(falls[0]) + 1
        return _malformed(f"time of point {i} ({t[i]:.3f} s) isn't after the one before")
    if t[-1] > _LAST_S:
        return _malformed(f"last point is at {t[-1]:.9g} s, limit is {_LAST_S:g} s")
    if (speed < 0.0).any():
        i = int(np.argmin(speed))
        return _malformed(f"speed of point {i} is {speed[i]:.3f} m/s, limit is 0 m/s")
    steps_s = moving_steps_s(columns)
    sparse_s = float(steps_s[steps_s > PLACES_S + _ROUNDING].sum())
    if sparse_s > _SPARSE_S:
        return _malformed(
            f"moves for {sparse_s:.9g} s in steps of more than {PLACES_S:g} s, limit is "
            f"{_SPARSE_S:g} s: place its points closer"
        )
    return None


def _check_start(
    reference: Reference,
    current: ObjectState,
    previous: Reference | None,
) -> Refusal | None:
    if previous is not None:
        p = sample(previous, reference.execute_at_ns)
        there, there_mps = Pose2(p.x_m, p.y_m, p.yaw_rad), p.speed_mps
    else:
        ahead = current.extrapolated(reference.execute_at_ns)
        there, there_mps = ahead.pose, ahead.speed_mps
    start = sample(reference, reference.execute_at_ns)
    turn = abs(wrap_angle(start.yaw_rad - there.yaw_rad))
    jump = math.hypot(start.x_m - there.x_m, start.y_m - there.y_m)
    checks = [
        ("position jumps by", jump, _JUMP_M, "m"),
        ("speed jumps by", abs(start.speed_mps - there_mps), _JUMP_MPS, "m/s"),
    ]
    if current.object_class is not ObjectClass.PEDESTRIAN:
        checks.append(("yaw jumps by", turn, _JUMP_RAD, "rad"))
    return _first_over(RefusalCode.DISCONTINUOUS, checks, " at execute_at", 0.0)


def _first_over(
    code: RefusalCode, checks: list[tuple[str, float, float, str]], where: str, rounding: float
) -> Refusal | None:
    """Return the first measured value above its limit; one that isn't finite is never within."""
    for what, measured, limit, unit in checks:
        if not measured <= limit + rounding:
            text = f"{what} {measured:.3f} {unit}{where}, limit is {limit:g} {unit}"
            return Refusal(code, text)
    return None


def _check_limits(reference: Reference, limits: Limits, body: BodyLimits) -> Refusal | None:
    _, _, _, _, speed, acceleration, curvature = reference.columns
    most = min(limits.acceleration_mps2, body.acceleration_mps2)
    hardest = min(limits.acceleration_mps2, body.deceleration_mps2)
    checks = [
        ("speed reaches", float(speed.max()), min(limits.speed_mps, body.speed_mps), "m/s"),
        ("acceleration reaches", float(acceleration.max()), most, "m/s^2"),
        ("deceleration reaches", float(-acceleration.min()), hardest, "m/s^2"),
    ]
    # A walker turns on the spot, so neither curvature nor grip bounds it.
    if body.curvature_1pm > 0.0:
        grip, most = float((np.abs(curvature) * speed**2).max()), body.lateral_acceleration_mps2
        checks += [
            ("curvature reaches", float(np.abs(curvature).max()), body.curvature_1pm, "1/m"),
            ("lateral acceleration reaches", grip, most, "m/s^2"),
        ]
    return _first_over(RefusalCode.LIMIT, checks, "", _ROUNDING)


def _check_steps(reference: Reference) -> Refusal | None:
    text = contradiction(reference.columns)
    return None if text is None else _malformed(text)


def _check_fence(
    reference: Reference, current: ObjectState, geofence: Sequence[tuple[float, float]]
) -> Refusal | None:
    t, x, y, yaw, _, _, _ = reference.places
    excess = way_excess_m(x, y, yaw, current.size, geofence)
    i = int(np.argmax(excess))
    if excess[i] > 0.0:
        point = int(np.searchsorted(reference.columns[0], t[i]))
        return Refusal(
            RefusalCode.FENCE,
            f"on its way to point {point} (x {x[i]:.2f} m, y {y[i]:.2f} m) the object is "
            f"{excess[i]:.3f} m outside the geofence, limit is 0 m",
        )
    return None


def _check_stops(reference: Reference, stop_room: StoppingRoom) -> Refusal | None:
    """Check that the object can stop inside the fence from each of a reference's places."""
    lack = stop_room.lack(reference.places)
    if lack is None:
        return None
    t, x, y, _, speed, _, _ = reference.places[:, lack.point]
    point = int(np.searchsorted(reference.columns[0], t, side="right")) - 1
    return Refusal(
        RefusalCode.FENCE,
        f"{lack.how} from point {point} (x {x:.2f} m, y {y:.2f} m, {speed:.1f} m/s) on leads "
        f"{lack.excess_m:.3f} m outside the geofence, limit is 0 m",
    )


def _check_end(reference: Reference) -> Refusal | None:
    last = reference.points[-1]
    if last.speed_mps > _ROUNDING:
        return Refusal(RefusalCode.MOVING_END, f"ends at {last.speed_mps:.3f} m/s, limit is 0 m/s")
    return None


class ReferenceQueue:
    """Accepted references of one object. Reads no clock."""

    def __init__(self) -> None:
        self.current: Reference | None = None
        self._waiting: list[Reference] = []
        self._accepted_ns: dict[str, int] = {}

    def before(self, execute_at_ns: int) -> Reference | None:
        """Return the reference that will be driven just before a time, as things stand."""
        earlier = [r for r in self._waiting if r.execute_at_ns < execute_at_ns]
        return earlier[-1] if earlier else self.current

    @property
    def planned(self) -> tuple[Reference, ...]:
        """List the reference that is driven, and those that wait, by their time."""
        return (*(() if self.current is None else (self.current,)), *self._waiting)

    @property
    def is_empty(self) -> bool:
        """True when nothing is driven and nothing waits."""
        return self.current is None and not self._waiting

    def has_accepted(self, reference: Reference) -> bool:
        """Tell whether a reference was taken before: the same is answered alike twice."""
        return self._accepted_ns.get(reference.reference_id) == reference.execute_at_ns

    def overtaker(self, reference: Reference) -> Reference | None:
        """Return an accepted reference that waits, begins no earlier, and was sent after this one.

        Taking the older one would put it in the place of what the manager wants now and believes
        to be driven.
        """
        return next(
            (
                waiting
                for waiting in self._waiting
                if waiting.dispatched_ns > reference.dispatched_ns
                and waiting.execute_at_ns >= reference.execute_at_ns
            ),
            None,
        )

    def take(self, reference: Reference) -> None:
        """Let a reference wait for its time, instead of what would have begun then or later."""
        at_ns = reference.execute_at_ns
        self._waiting = [r for r in self._waiting if r.execute_at_ns < at_ns]
        self._waiting.append(reference)
        self._accepted_ns[reference.reference_id] = at_ns

    def advance(self, now_ns: int) -> bool:
        """Begin what is due; return True when another reference is driven from now on."""
        due = [r for r in self._waiting if r.execute_at_ns <= now_ns]
        if not due:
            return False
        self.current = due[-1]
        self._waiting = self._waiting[len(due) :]
        return True

    def clear(self) -> None:
        """Forget everything."""
        self.current = None
        self._waiting.clear()
        self._accepted_ns.clear()
