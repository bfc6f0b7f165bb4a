"""The initiator that holds its place and speed, against part C of K* (a slow or standing lead).

Such an event is there without a manoeuvre. So the object keeps one speed and one offset in the
VUT's lane, from the trigger to the resolution.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from ssp_eval.audit.evidence.further import (
    HELD_SHARE,
    SPEED_TOLERANCE_MPS,
    ScriptEvidence,
    speeds_otherwise,
)
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Of a measured offset: errors of localisation, and a driver's sway.
_OFFSET_TOLERANCE_M = 0.25


def holding_initiator(event: Event) -> str | None:
    """Return the id of an initiator that does nothing; None: it acts.

    Closing in on it takes the place of its manoeuvre.
    """
    kind = KINDS.get(event.interaction.type)
    holds = kind is not None and kind.observable == "closing"
    return event.interaction.initiator if holds else None


def holds_otherwise(event: Event, course: ScriptEvidence) -> Iterator[str]:
    """Yield where the initiator doesn't hold speed and offset as K* has them, for people.

    Args:
        event: K*.
        course: of the initiator.
    """
    who = course.object_id
    for phase, speeds_mps in course.speeds_mps.items():
        yield from speeds_otherwise(event, who, phase, speeds_mps)
    yield from _changes_speed(event, course)
    offset_range = event.constraints.manoeuvre.get("offset")
    if isinstance(offset_range, Interval):
        span, offsets_m = offset_range.si, course.offsets_m
        low_m, high_m = span.low - _OFFSET_TOLERANCE_M, span.high + _OFFSET_TOLERANCE_M
        inside = sum(low_m <= offset_m <= high_m for offset_m in offsets_m)
        if inside < HELD_SHARE * len(offsets_m):
            yield (
                f"{who} is {min(offsets_m):+.2f} to {max(offsets_m):+.2f} m beside the middle of "
                f"the VUT's lane (+ left), K* has {span.low:+g} to {span.high:+g} m"
            )


def _changes_speed(event: Event, course: ScriptEvidence) -> Iterator[str]:
    """Yield that a speed changes which K* has constant, though within its range."""
    trends = {event.motion[course.object_id][phase].speed_trend for phase in course.speeds_mps}
    speeds_mps = [speed for one in course.speeds_mps.values() for speed in one]
    if not trends <= {"constant", "standing"} or not speeds_mps:
        return
    middle_mps = median(speeds_mps)
    steady_count = sum(abs(speed - middle_mps) <= SPEED_TOLERANCE_MPS for speed in speeds_mps)
    if steady_count < HELD_SHARE * len(speeds_mps):
        yield (
            f"{course.object_id} drives {min(speeds_mps):.1f} to {max(speeds_mps):.1f} m/s from "
            f"the trigger to the resolution, K* has a constant speed"
        )
