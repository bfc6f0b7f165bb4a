"""Further participants of a recording against their scripts in K* (parts A, M and C).

A further participant stands, or drives along its lane at one speed. Its course is measured from the
trigger to the resolution, and its place beside the VUT where the recording begins.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ssp_core.geometry import wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Series
from ssp_core.vocabulary import PhaseWord
from ssp_eval.audit.evidence.paths import Lanes, Spot
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.further import cell_of

# A script holds where it does so in this share of the instants from trigger to resolution.
HELD_SHARE = 0.9
# Of measured speeds.
SPEED_TOLERANCE_MPS = 0.5
# Of a gap: arc lengths of the reference line and of the VUT's path differ in a bend.
_GAP_TOLERANCE_M, _GAP_TOLERANCE_SHARE = 1.0, 0.1
_HEADINGS = ("same", "leftwards", "opposite", "rightwards")


@dataclass(frozen=True)
class ScriptEvidence:
    """The course of a further participant.

    Args:
        object_id: its id.
        instants: from trigger to resolution.
        present: of these, those at which it is there.
        places: instants by the place in words of part A; empty without a road.
        headings: instants by the heading relative to the road; empty without a road.
        speeds_mps: by phase, as far as it is there.
        ahead_m: bumper gap to the VUT along the road at the start, negative behind it; 0 beside it;
            None: it isn't there, or there is no road.
    """

    object_id: str
    instants: int
    present: int
    places: Mapping[str, int]
    headings: Mapping[str, int]
    speeds_mps: Mapping[PhaseWord, tuple[float, ...]]
    ahead_m: float | None
    offsets_m: tuple[float, ...] = ()


def script_evidence(
    object_id: str,
    by_phase: Mapping[PhaseWord, Series],
    lanes: Lanes | None,
    own_lane: int | None,
    start: tuple[ObjectState | None, ObjectState | None],
) -> ScriptEvidence:
    """Measure the course of a further participant.

    Args:
        object_id: its id.
        by_phase: states in the trigger and in the conflict.
        lanes: of the road; None: none is bound.
        own_lane: lane in which the VUT starts.
        start: states of the VUT and of the participant where the recording begins.
    """
    speeds: dict[PhaseWord, tuple[float, ...]] = {}
    places, headings, present = Counter[str](), Counter[str](), 0
    offsets_m: list[float] = []
    for phase, series in by_phase.items():
        states = [now[object_id] for _, now in series if object_id in now]
        present += len(states)
        speeds[phase] = tuple(state.speed_mps for state in states)
        if lanes is None:
            continue
        for state in states:
            spot = lanes.spot(state)
            if spot is not None:
                places[lanes.place_word(spot, own_lane)] += 1
                headings[_heading(lanes, spot, state)] += 1
                if own_lane is not None:
                    offsets_m.append(lanes.offset_m(spot, own_lane))
    instants = sum(len(series) for series in by_phase.values())
    at_start_m = None if lanes is None else ahead_m(lanes, *start)
    return ScriptEvidence(
        object_id, instants, present, places, headings, speeds, at_start_m, tuple(offsets_m)
    )


def _heading(lanes: Lanes, spot: Spot, state: ObjectState) -> str:
    road_rad = lanes.line.pose(spot.s_m).yaw_rad + (0.0 if lanes.forward else math.pi)
    quarters = round(wrap_angle(state.yaw_rad - road_rad) / (math.pi / 2))
    return _HEADINGS[quarters % 4]


def ahead_m(lanes: Lanes, vut: ObjectState | None, other: ObjectState | None) -> float | None:
    """Return the gap along the road between the nearest ends of two outlines, m.

    Args:
        lanes: of the road.
        vut: its state; None: it isn't there.
        other: state of the other one; None: it isn't there.

    Returns:
        Negative behind the VUT, 0 beside it; None: one of them isn't there, or not on the road.
    """
    if vut is None or other is None:
        return None
    ends = []
    for state in (vut, other):
        spot = lanes.spot(state)
        if spot is None:
            return None
        turn = state.yaw_rad - lanes.line.pose(spot.s_m).yaw_rad
        half_m = (
            abs(math.cos(turn)) * state.size.length_m + abs(math.sin(turn)) * state.size.width_m
        ) / 2.0
        s_m = spot.s_m if lanes.forward else -spot.s_m
        ends.append((s_m - half_m, s_m + half_m))
    (rear_m, front_m), (near_m, far_m) = ends
    if near_m >= front_m:
        return near_m - front_m
    return min(far_m - rear_m, 0.0)


def gap_slack_m(gap_m: float) -> float:
    """Return by how much a measured gap may lie outside of K*'s interval, m."""
    return _GAP_TOLERANCE_M + _GAP_TOLERANCE_SHARE * gap_m


def departures(event: Event, courses: Iterable[ScriptEvidence]) -> Iterator[str]:
    """Yield where a further participant doesn't keep to its script in K*, for people."""
    for course in courses:
        who = course.object_id
        if course.present < HELD_SHARE * course.instants:
            yield (
                f"{who} is there at {course.present} of {course.instants} instants from the "
                f"trigger to the resolution, {HELD_SHARE:.0%} of them are needed"
            )
        yield from _at_the_start(event, course)
        region, heading = event.participants[who].region, cell_of(event, who).heading
        yield from _mostly(who, "is in", course.places, region.place)
        if heading != "unresolved":
            yield from _mostly(who, "faces", course.headings, heading)
        for phase, speeds in course.speeds_mps.items():
            yield from speeds_otherwise(event, who, phase, speeds)


def _at_the_start(event: Event, course: ScriptEvidence) -> Iterator[str]:
    """Yield where its place along the road isn't that of part A."""
    who, at_start_m = course.object_id, course.ahead_m
    region = event.participants[who].region
    if at_start_m is None or region.along == "at":
        return
    along = "beside" if at_start_m == 0.0 else "ahead" if at_start_m > 0.0 else "behind"
    if along != region.along:
        yield f"{who} starts {along} the VUT by {abs(at_start_m):.1f} m, K* has {region.along}"
    elif along != "beside" and isinstance(region.gap, Interval):
        span, gap_m = region.gap.si, abs(at_start_m)
        slack_m = gap_slack_m(gap_m)
        if not span.low - slack_m <= gap_m <= span.high + slack_m:
            yield (
                f"{who} starts {gap_m:.1f} m {along} of the VUT, K* has {span.low:g} to "
                f"{span.high:g} m"
            )


def _mostly(who: str, verb: str, counts: Mapping[str, int], event_word: str) -> Iterator[str]:
    total = sum(counts.values())
    if counts.get(event_word, 0) >= HELD_SHARE * total:
        return
    others = ", ".join(word for word in sorted(counts) if word != event_word)
    yield (
        f"{who} {verb} {event_word} at {counts.get(event_word, 0)} of {total} instants from the "
        f"trigger to the resolution, else {others}; K* has {event_word}"
    )


def speeds_otherwise(
    event: Event, who: str, phase: PhaseWord, speeds_mps: Sequence[float]
) -> Iterator[str]:
    """Yield where the speeds of a phase aren't those of part C, for people."""
    speed_range = event.constraints.speeds.get(who, {}).get(phase)
    if not isinstance(speed_range, Interval):
        return
    low, high = speed_range.si.low - SPEED_TOLERANCE_MPS, speed_range.si.high + SPEED_TOLERANCE_MPS
    inside = sum(low <= speed <= high for speed in speeds_mps)
    if inside < HELD_SHARE * len(speeds_mps):
        yield (
            f"{who} drives {min(speeds_mps):.1f} to {max(speeds_mps):.1f} m/s in the {phase}, K* "
            f"has {speed_range.si.low:g} to {speed_range.si.high:g} m/s"
        )
