"""Single conditions of a trigger (METHOD 2.3): their objects, measures, and when they hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, encounter
from ssp_core.motion.state import ObjectState
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    Condition,
    ElapsedTime,
    InRegion,
    Leaf,
    PhaseReached,
    RelativeDistance,
    SpeedIs,
    TimeHeadway,
    TimeToArrival,
    TimeToCollision,
)
from ssp_core.safety.fence import room_m
from ssp_core.value_class import value_class
from ssp_core.vocabulary import Phase

# Below this speed a time to arrival or a headway is infinite rather than an amplified noise of the
# speed.
_LEAST_ARRIVAL_MPS = 0.1


class Snapshot:
    """The states at the stamp of one VUT state. Values that aren't asked for aren't computed.

    An object's state is extrapolated to the VUT's stamp, with speed and yaw rate held. It is
    unknown (None) where the object was never heard, a number of it isn't finite, or its stamp is
    further from the VUT's than ``state_age_ns``, before or after.

    Args:
        vut: state of the VUT; its stamp is the snapshot's.
        path: the VUT's planned path, frame map.
        state_age_ns: how far a state may be extrapolated (``limits.state_age_s``).
        phases: session times at which phases of the event began, as far as that is known.
    """

    __slots__ = (
        "_age_ns",
        "_extrapolated_states",
        "_front_m",
        "_meetings",
        "_targets",
        "path",
        "phases",
        "vut",
    )

    def __init__(
        self,
        vut: ObjectState,
        targets: Mapping[str, ObjectState],
        path: Polyline,
        state_age_ns: int,
        phases: Mapping[Phase, int],
    ) -> None:
        self.vut = vut
        self.path = path
        self.phases = phases
        self._targets = targets
        self._age_ns = state_age_ns
        self._extrapolated_states: dict[str, ObjectState | None] = {}
        self._meetings: dict[str, Encounter | None] = {}
        self._front_m: float | None = None

    @property
    def stamp_ns(self) -> int:
        return self.vut.stamp_ns

    def state(self, object_id: str) -> ObjectState | None:
        """Return the state of the VUT or an object at the snapshot's stamp; None: unknown."""
        if object_id not in self._extrapolated_states:
            self._extrapolated_states[object_id] = self._extrapolated(object_id)
        return self._extrapolated_states[object_id]

    def _extrapolated(self, object_id: str) -> ObjectState | None:
        state = self.vut if object_id == VUT_ID else self._targets.get(object_id)
        if state is None or not state.is_finite:
            return None
        if state.stamp_ns == self.stamp_ns:
            return state
        if abs(self.stamp_ns - state.stamp_ns) > self._age_ns:
            return None
        return state.extrapolated(self.stamp_ns)

    def meeting(self, object_id: str) -> Encounter | None:
        """Compute how an object stands to the VUT (METHOD 1); None: unknown."""
        if object_id not in self._meetings:
            vut, other = self.state(VUT_ID), self.state(object_id)
            if vut is None or other is None:
                self._meetings[object_id] = None
            else:
                self._meetings[object_id] = encounter(vut, other, self.path)
        return self._meetings[object_id]

    # Values of conditions (METHOD 2.3): NaN where a state is unknown, +inf where there is none.

    def gap_m(self, object_id: str) -> float:
        """Return the bumper gap to an object ahead of the VUT."""
        meeting = self.meeting(object_id)
        if meeting is None:
            return math.nan
        return meeting.gap_m if meeting.gap_m >= 0.0 else math.inf

    def headway_s(self, object_id: str) -> float:
        """Return the gap over the VUT's speed."""
        gap_m, speed_mps = self.gap_m(object_id), self.vut.speed_mps
        if math.isnan(gap_m):
            return math.nan
        return gap_m / speed_mps if speed_mps >= _LEAST_ARRIVAL_MPS else math.inf

    def ttc_s(self, object_id: str) -> float:
        meeting = self.meeting(object_id)
        return math.nan if meeting is None else meeting.ttc_s

    def arrival_s(self, station_m: float) -> float:
        """Compute the time until the VUT's front, at its present speed, is at a station."""
        vut = self.state(VUT_ID)
        if vut is None:
            return math.nan
        if self._front_m is None:
            self._front_m = self.path.project_beyond(vut.x_m, vut.y_m)[0] + vut.size.front_m
        if station_m < self._front_m or vut.speed_mps < _LEAST_ARRIVAL_MPS:
            return math.inf
        return (station_m - self._front_m) / vut.speed_mps

    def speed_mps(self, object_id: str) -> float:
        state = self.state(object_id)
        return math.nan if state is None else state.speed_mps

    def room_m(self, object_id: str, polygon: list[tuple[float, float]]) -> float:
        """Compute how far inside a polygon an object's reference point is, negative outside."""
        state = self.state(object_id)
        return math.nan if state is None else room_m(state.x_m, state.y_m, polygon)


@value_class(frozen=True, slots=True)
class Sample:
    """A condition's value at a state stamp; NaN: unknown, +inf: there is none."""

    stamp_ns: int
    value: float


@value_class(frozen=True, slots=True)
class Reading:
    """A sample, and whether the condition holds there.

    Args:
        sample: value and stamp.
        holds: None: unknown.
        since_ns: from when it has held, where that is known by itself and not from samples.
    """

    sample: Sample
    holds: bool | None
    since_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Quantity:
    """The comparison that a single condition makes.

    Args:
        name: of the quantity, for people.
        relation: of its value to the threshold when the condition holds.
        threshold: in the unit.
        unit: of value and threshold.
    """

    name: str
    relation: Literal["<", ">", ">="]
    threshold: float
    unit: str

    @property
    def text(self) -> str:
        return f"{self.name} {self.relation} {self.threshold:g} {self.unit}"


def quantity(condition: Leaf) -> Quantity:
    """Return the comparison that a single condition makes."""
    match condition:
        case RelativeDistance():
            return Quantity(f"gap vut - {condition.object_id}", "<", condition.below_m, "m")
        case TimeHeadway():
            name = f"time headway vut - {condition.object_id}"
            return Quantity(name, "<", condition.below_s, "s")
        case TimeToCollision():
            return Quantity(f"TTC vut - {condition.object_id}", "<", condition.below_s, "s")
        case TimeToArrival(anchor=(x, y)):
            name = f"time of vut to anchor ({x:.1f}, {y:.1f})"
            return Quantity(name, "<", condition.below_s, "s")
        case SpeedIs():
            relation: Literal["<", ">"] = ">" if condition.relation == "above" else "<"
            return Quantity(f"speed of {condition.object_id}", relation, condition.value_mps, "m/s")
        case InRegion():
            x_m = [p[0] for p in condition.polygon]
            y_m = [p[1] for p in condition.polygon]
            extent = f"({min(x_m):.1f} to {max(x_m):.1f}, {min(y_m):.1f} to {max(y_m):.1f})"
            return Quantity(f"room of {condition.object_id} in region {extent}", ">", 0.0, "m")
        case PhaseReached():
            return Quantity(f"time since phase {condition.phase}", ">=", 0.0, "s")
        case ElapsedTime():
            return Quantity("time since the start", ">=", condition.after_s, "s")


def condition_text(condition: Condition) -> str:
    """Write the condition for people."""
    if isinstance(condition, AllOf | AnyOf):
        parts = "; ".join(condition_text(part) for part in condition.of)
        return f"{condition.type} of ({parts})"
    return quantity(condition).text


class Question(Protocol):
    """One single condition, made ready to be asked at many scenes."""

    @property
    def quantity(self) -> Quantity: ...

    def read(self, snapshot: Snapshot) -> Reading:
        """Read value and truth at a snapshot's stamp."""

    def changed_ns(self, before: Reading, now: Reading) -> int:
        """Return the time of the truth's change between two successive, different readings."""


def _nearest(numerator: int, denominator: int) -> int:
    """Round the quotient to the nearest whole number, half to even."""
    if denominator < 0:
        numerator, denominator = -numerator, -denominator
    quotient, rest = divmod(numerator, denominator)
    over = 2 * rest - denominator
    return quotient + (over > 0 or (over == 0 and quotient % 2 == 1))


@dataclass(frozen=True, slots=True)
class ThresholdCondition:
    """A value compared with a threshold.

    Between two samples the value is taken for linear, so that the change is at the interpolated
    crossing, rounded to the nearest nanosecond (half to even). From or to a value that is unknown
    or infinite it is at the later sample.
    """

    quantity: Quantity
    measure: Callable[[Snapshot], float]

    def read(self, snapshot: Snapshot) -> Reading:
        value, threshold = self.measure(snapshot), self.quantity.threshold
        holds: bool | None = (
            value < threshold if self.quantity.relation == "<" else (value > threshold)
        )
        return Reading(Sample(snapshot.stamp_ns, value), None if math.isnan(value) else holds)

    def changed_ns(self, before: Reading, now: Reading) -> int:
        a, b = before.sample, now.sample
        if not (math.isfinite(a.value) and math.isfinite(b.value)):
            return b.stamp_ns
        # (a - threshold) / (a - b) of the way, in whole numbers; Fraction does the same and takes
        # four times as long, while a dispatch waits.
        (p, q), (r, s) = a.value.as_integer_ratio(), b.value.as_integer_ratio()
        t, u = self.quantity.threshold.as_integer_ratio()
        way, whole = (p * u - t * q) * s, (p * s - r * q) * u
        return _nearest(a.stamp_ns * whole + way * (b.stamp_ns - a.stamp_ns), whole)


@dataclass(frozen=True, slots=True)
class DelayedCondition:
    """Holds from an instant on, which may become known only after it.

    Args:
        quantity: its threshold is how long after ``zero_ns`` it begins to hold.
        zero_ns: instant from which the value counts, None while that isn't known.
    """

    quantity: Quantity
    zero_ns: Callable[[Snapshot], int | None]

    def read(self, snapshot: Snapshot) -> Reading:
        zero_ns = self.zero_ns(snapshot)
        if zero_ns is None:
            return Reading(Sample(snapshot.stamp_ns, -math.inf), False)
        since_ns = zero_ns + seconds_to_ns(self.quantity.threshold)
        sample = Sample(snapshot.stamp_ns, ns_to_seconds(snapshot.stamp_ns - zero_ns))
        return Reading(sample, snapshot.stamp_ns >= since_ns, since_ns)

    def changed_ns(self, _before: Reading, now: Reading) -> int:
        return now.sample.stamp_ns if now.since_ns is None else now.since_ns


def question(condition: Leaf, path: Polyline, started_ns: int) -> Question:
    """Make a single condition ready to be asked.

    Args:
        condition: the single condition.
        path: the VUT's planned path, frame map.
        started_ns: session time at which the run started.
    """
    what = quantity(condition)
    match condition:
        case RelativeDistance(object_id=who):
            return ThresholdCondition(what, partial(Snapshot.gap_m, object_id=who))
        case TimeHeadway(object_id=who):
            return ThresholdCondition(what, partial(Snapshot.headway_s, object_id=who))
        case TimeToCollision(object_id=who):
            return ThresholdCondition(what, partial(Snapshot.ttc_s, object_id=who))
        case TimeToArrival(anchor=anchor):
            station_m, _ = path.project(*anchor)
            return ThresholdCondition(what, partial(Snapshot.arrival_s, station_m=station_m))
        case SpeedIs(object_id=who):
            return ThresholdCondition(what, partial(Snapshot.speed_mps, object_id=who))
        case InRegion(object_id=who, polygon=polygon):
            return ThresholdCondition(
                what, partial(Snapshot.room_m, object_id=who, polygon=polygon)
            )
        case PhaseReached():
            phase = Phase[condition.phase.upper()]
            return DelayedCondition(what, lambda now: now.phases.get(phase))
        case ElapsedTime():
            return DelayedCondition(what, lambda _: started_ns)


def leaves(condition: Condition) -> list[Leaf]:
    """Return the single conditions of a condition, in the order of the file."""
    if isinstance(condition, AllOf | AnyOf):
        return [leaf for part in condition.of for leaf in leaves(part)]
    return [condition]
