"""Single conditions of a trigger (METHOD 2.3): what is measured, and when it holds.

Each has a number in its own unit and a threshold. The number is NaN where it is unknown: the
condition then neither holds nor fails to. It is +inf where it doesn't exist, as the gap to an
object that isn't ahead does, and the condition doesn't hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
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
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.core.scene import Scene

# Below this speed a time to arrival or a headway is infinite rather than an amplified noise of the
# speed.
STANDSTILL_MPS = 0.1


@dataclass(frozen=True, slots=True)
class Sample:
    """A condition's value at a state stamp; NaN: unknown, +inf: there is none."""

    stamp_ns: int
    value: float


@dataclass(frozen=True, slots=True)
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
    """What a single condition compares with what.

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
    """What a single condition compares with what."""
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
    """The condition for people."""
    if isinstance(condition, AllOf | AnyOf):
        parts = "; ".join(condition_text(part) for part in condition.of)
        return f"{condition.type} of ({parts})"
    return quantity(condition).text


class Question(Protocol):
    """One single condition, made ready to be asked at many scenes."""

    @property
    def quantity(self) -> Quantity: ...

    def read(self, scene: Scene) -> Reading:
        """Value and truth at a scene's stamp."""

    def changed_ns(self, before: Reading, now: Reading) -> int:
        """When the truth changed that differs between two readings, one after the other."""


def _nearest(numerator: int, denominator: int) -> int:
    """The quotient rounded to the nearest whole number, half to even."""
    if denominator < 0:
        numerator, denominator = -numerator, -denominator
    quotient, rest = divmod(numerator, denominator)
    over = 2 * rest - denominator
    return quotient + (over > 0 or (over == 0 and quotient % 2 == 1))


@dataclass(frozen=True, slots=True)
class Measured:
    """A value compared with a threshold.

    Between two samples the value is taken for linear, so that the change is at the interpolated
    crossing, rounded to the nearest nanosecond (half to even). From or to a value that is unknown
    or infinite it is at the later sample.
    """

    quantity: Quantity
    measure: Callable[[Scene], float]

    def read(self, scene: Scene) -> Reading:
        value, threshold = self.measure(scene), self.quantity.threshold
        holds: bool | None = (
            value < threshold if self.quantity.relation == "<" else (value > threshold)
        )
        return Reading(Sample(scene.stamp_ns, value), None if math.isnan(value) else holds)

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
class Timed:
    """Holds from an instant on, which may become known only after it.

    Args:
        quantity: its threshold is how long after ``zero_ns`` it begins to hold.
        zero_ns: instant from which the value counts, None while that isn't known.
    """

    quantity: Quantity
    zero_ns: Callable[[Scene], int | None]

    def read(self, scene: Scene) -> Reading:
        zero_ns = self.zero_ns(scene)
        if zero_ns is None:
            return Reading(Sample(scene.stamp_ns, -math.inf), False)
        since_ns = zero_ns + seconds_to_ns(self.quantity.threshold)
        sample = Sample(scene.stamp_ns, ns_to_seconds(scene.stamp_ns - zero_ns))
        return Reading(sample, scene.stamp_ns >= since_ns, since_ns)

    def changed_ns(self, before: Reading, now: Reading) -> int:
        return now.sample.stamp_ns if now.since_ns is None else now.since_ns


def question(condition: Leaf, path: Polyline, started_ns: int) -> Question:
    """Makes a single condition ready to be asked.

    Args:
        condition: of a run file.
        path: the VUT's planned path, frame map.
        started_ns: session time at which the run started.
    """
    what = quantity(condition)
    match condition:
        case RelativeDistance():
            return Measured(what, _gap_m(condition.object_id))
        case TimeHeadway():
            return Measured(what, _headway_s(condition.object_id))
        case TimeToCollision():
            return Measured(what, _ttc_s(condition.object_id))
        case TimeToArrival():
            return Measured(what, _arrival_s(path.project(*condition.anchor)[0]))
        case SpeedIs():
            return Measured(what, _speed_mps(condition.object_id))
        case InRegion():
            return Measured(what, _room_m(condition.object_id, condition.polygon))
        case PhaseReached():
            phase = Phase[condition.phase.upper()]
            return Timed(what, lambda scene: scene.phases.get(phase))
        case ElapsedTime():
            return Timed(what, lambda _: started_ns)


def _gap_m(object_id: str) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        meeting = scene.meeting(object_id)
        if meeting is None:
            return math.nan
        return meeting.gap_m if meeting.gap_m >= 0.0 else math.inf

    return measure


def _headway_s(object_id: str) -> Callable[[Scene], float]:
    gap_m = _gap_m(object_id)

    def measure(scene: Scene) -> float:
        gap, speed = gap_m(scene), scene.vut.speed_mps
        if math.isnan(gap):
            return math.nan
        return gap / speed if speed >= STANDSTILL_MPS else math.inf

    return measure


def _ttc_s(object_id: str) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        meeting = scene.meeting(object_id)
        return math.nan if meeting is None else meeting.ttc_s

    return measure


def _arrival_s(anchor_m: float) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        front = scene.vut_front_m()
        if front is None:
            return math.nan
        speed = scene.vut.speed_mps
        if anchor_m < front or speed < STANDSTILL_MPS:
            return math.inf
        return (anchor_m - front) / speed

    return measure


def _speed_mps(object_id: str) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        state = scene.state(object_id)
        return math.nan if state is None else state.speed_mps

    return measure


def _room_m(object_id: str, polygon: list[tuple[float, float]]) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        state = scene.state(object_id)
        return math.nan if state is None else room_m(state.x_m, state.y_m, polygon)

    return measure


def leaves(condition: Condition) -> list[Leaf]:
    """The single conditions of a condition, in the order of the file."""
    if isinstance(condition, AllOf | AnyOf):
        return [leaf for part in condition.of for leaf in leaves(part)]
    return [condition]
