"""Values of the trigger conditions (METHOD 2.3), and the watch that finds the instant of firing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.run_spec import Condition, RelativeDistance, TriggerSpec
from ssp_core.state import ObjectState

# Below this speed a time to arrival is infinite rather than an amplified noise of the speed.
STANDSTILL_MPS = 0.1


def front_station_m(state: ObjectState, path: Polyline) -> float:
    """Arc length of an object's foremost point along a path."""
    station, _ = path.project_beyond(state.x_m, state.y_m)
    return station + state.size.front_m


def condition_value(
    condition: Condition, vut: ObjectState, others: dict[str, ObjectState], vut_path: Polyline
) -> float:
    """The measured quantity of a condition, in the unit of its threshold.

    Args:
        condition: relative_distance: bumper gap in m along the VUT's path; time_to_arrival: s
            until the VUT's front is at the anchor at its present speed.
        vut: state of the VUT.
        others: states of the objects at the VUT's stamp, by id.
        vut_path: the VUT's planned path.

    Returns:
        The value; +inf where it doesn't exist (object unknown or behind, VUT standing, anchor
        passed).
    """
    front = front_station_m(vut, vut_path)
    if isinstance(condition, RelativeDistance):
        other = others.get(condition.object_id)
        if other is None:
            return math.inf
        station, _ = vut_path.project_beyond(other.x_m, other.y_m)
        gap = station - other.size.rear_m - front
        return gap if gap >= 0.0 else math.inf
    station, _ = vut_path.project(*condition.anchor)
    distance = station - front
    if distance < 0.0 or vut.speed_mps < STANDSTILL_MPS:
        return math.inf
    return distance / vut.speed_mps


def condition_threshold(condition: Condition) -> float:
    if isinstance(condition, RelativeDistance):
        return condition.below_m
    return condition.below_s


def condition_text(condition: Condition) -> str:
    """The condition for people."""
    if isinstance(condition, RelativeDistance):
        return f"gap vut - {condition.object_id} < {condition.below_m:g} m"
    x, y = condition.anchor
    return f"time of vut to anchor ({x:.1f}, {y:.1f}) < {condition.below_s:g} s"


@dataclass(frozen=True, slots=True)
class Sample:
    """A condition's value at a state stamp."""

    stamp_ns: int
    value: float


@dataclass(frozen=True, slots=True)
class Firing:
    """The instant from which the condition has held for as long as asked, and what showed it."""

    crossing_ns: int
    fired_ns: int
    samples: tuple[Sample, ...]


@dataclass(frozen=True, slots=True)
class Watch:
    """What a trigger remembers between samples."""

    last: Sample | None = None
    crossing_ns: int | None = None
    bracket: tuple[Sample, ...] = ()
    fired: bool = False


def _crossing_ns(before: Sample | None, now: Sample, threshold: float) -> int:
    """Time at which the value passed the threshold, linear between the two samples."""
    if before is None or not math.isfinite(before.value) or before.value == now.value:
        return now.stamp_ns
    share = (before.value - threshold) / (before.value - now.value)
    return before.stamp_ns + round(share * (now.stamp_ns - before.stamp_ns))


def observe(
    watch: Watch, spec: TriggerSpec, sample: Sample, start_ns: int
) -> tuple[Watch, Firing | None]:
    """Takes a new sample into account; fires at most once.

    The condition becomes true on an edge: at the interpolated crossing of its threshold, or at
    the first sample that counts if it is true there already. Samples before ``not_before_s`` don't
    count. ``held_for_s`` means held without interruption at every sample.

    Args:
        watch: what is remembered so far.
        spec: the trigger.
        sample: the condition's value at a new, later stamp.
        start_ns: session time at which the run started.
    """
    if watch.fired:
        return watch, None
    if sample.stamp_ns < start_ns + seconds_to_ns(spec.not_before_s):
        return Watch(), None
    threshold = condition_threshold(spec.condition)
    if not sample.value < threshold:
        return Watch(last=sample), None
    crossing, bracket = watch.crossing_ns, watch.bracket
    if crossing is None:
        crossing = _crossing_ns(watch.last, sample, threshold)
        bracket = (watch.last, sample) if watch.last is not None else (sample,)
    if sample.stamp_ns - crossing < spec.held_for_s * NS_PER_S:
        return Watch(last=sample, crossing_ns=crossing, bracket=bracket), None
    return Watch(last=sample, crossing_ns=crossing, bracket=bracket, fired=True), Firing(
        crossing, sample.stamp_ns, bracket
    )
