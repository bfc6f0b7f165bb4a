"""What K* and the place want of participants: sizes, speeds, limits, order."""

from __future__ import annotations

import math

from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.model import ConflictThresholds, WantedPassing
from ssp_core.vocabulary import ObjectClass, ObjectWord
from ssp_scenario_manager.interactions.base import PlaceLimits
from ssp_scenario_manager.interactions.choosing import in_si
from ssp_scenario_manager.spec.model import Event, Interval

# Accelerations of an approach, m/s^2, for those who can't do the usual.
_APPROACH_MPS2 = {"truck": 1.2, "bus": 1.2, "cyclist": 1.2}
_USUAL_MPS2 = 2.0


def size_of(event: Event, name: str) -> Size:
    """Extent of a participant."""
    return DEFAULT_SIZES[ObjectClass.from_word(event.participants[name].class_)]


def classes_of(event: Event) -> dict[str, ObjectWord]:
    """Object classes by participants' ids."""
    return {name: who.class_ for name, who in event.participants.items()}


def thresholds_of(event: Event) -> ConflictThresholds:
    """When a conflict begins, by part C: the middle of what it gives."""

    def middle(interval: Interval | None) -> float | None:
        if interval is None:
            return None
        known = in_si(interval)
        sides = [side for side in (known.min, known.max) if side is not None]
        return sum(sides) / len(sides) if sides else None

    needs = event.constraints.thresholds
    return ConflictThresholds(ttc_s=middle(needs.ttc), arrival_gap_s=middle(needs.arrival_gap))


def approach_acceleration(event: Event, name: str, limits: PlaceLimits) -> float:
    """With which a participant gets to its cruise speed, m/s^2."""
    usual = _APPROACH_MPS2.get(event.participants[name].class_, _USUAL_MPS2)
    return min(usual, limits.acceleration_mps2)


def acceleration_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place and K* allow, m/s^2."""
    most = in_si(event.constraints.safety.acceleration).max
    return min(limits.acceleration_mps2, most if most is not None else math.inf)


def vehicle_speed_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place, road and K* allow, m/s."""
    most = in_si(event.constraints.safety.speed).max
    return min(limits.speed_mps, limits.speed_limit_mps, most if most is not None else math.inf)


def speed_bounds(event: Event, name: str, phases: tuple[str, ...]) -> tuple[float, float]:
    """Largest minimum and smallest maximum of a participant's speed over some phases, m/s."""
    known = event.constraints.speeds.get(name, {})
    found = [in_si(q) for phase, q in known.items() if phase in phases and isinstance(q, Interval)]
    return (
        max((q.min for q in found if q.min is not None), default=0.0),
        min((q.max for q in found if q.max is not None), default=math.inf),
    )


def initiator_first(event: Event) -> bool:
    """The passing order of K*."""
    return event.interaction.passing_order[0] == event.interaction.initiator


def wanted_passing(event: Event) -> WantedPassing:
    """Order and time gap of K*; a side of the gap that it leaves open may be any."""
    gap = event.constraints.time_gap
    known = in_si(gap) if isinstance(gap, Interval) else None
    return WantedPassing(
        first="initiator" if initiator_first(event) else "vut",
        least_gap_s=None if known is None else known.min,
        most_gap_s=None if known is None else known.max,
    )
