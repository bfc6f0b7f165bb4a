"""When an object begins to move by a new reference, seen from its states (DESIGN).

The onset is the first state whose speed or acceleration departs from what the previous reference
asks for by more than its noise band; acceleration is looked at along and across the heading, since
a lane change may go on at its speed. The band is the median difference in the two seconds before
the dispatch plus and minus four standard deviations, estimated from the median absolute deviation
so that what the object did just before widens it little, and at least what a state's numbers are
worth. The next state must depart too: of four sigma, two in a row are no noise.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState

BEFORE_S = 2.0
LEAST_STATES = 5
SIGMAS = 4.0
# Of a normal distribution: its standard deviation over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# After execute_at; who hasn't moved by then doesn't.
WITHIN_S = 5.0
# Half the width of a band at least, in the quantity's unit.
FLOORS = {"speed": 0.02, "acceleration": 0.05, "lateral acceleration": 0.05}
UNITS = {"speed": "m/s", "acceleration": "m/s^2", "lateral acceleration": "m/s^2"}


@dataclass(frozen=True, slots=True)
class Band:
    """Differences between states and reference that are noise: middle and half width."""

    middle: float
    half: float

    def holds(self, difference: float) -> bool:
        return abs(difference - self.middle) <= self.half


@dataclass(frozen=True, slots=True)
class Onset:
    """First state outside a noise band.

    Args:
        stamp_ns: of that state.
        quantity: ``speed``, ``acceleration`` or ``lateral acceleration``, the one that is furthest
            outside in terms of its band.
        difference: state minus previous reference, in the quantity's unit.
        band: noise of that difference.
    """

    stamp_ns: int
    quantity: str
    difference: float
    band: Band


def differences(state: ObjectState, previous: Reference | None) -> dict[str, float]:
    """State minus reference, by quantity.

    Args:
        state: of the object.
        previous: reference that it tracked; None: it stood, and was to stand.
    """
    speed, along, across = 0.0, 0.0, 0.0
    if previous is not None:
        point = sample(previous, state.stamp_ns)
        speed, along = point.speed_mps, point.acceleration_mps2
        across = point.speed_mps**2 * point.curvature_1pm
    return {
        "speed": state.speed_mps - speed,
        "acceleration": state.acceleration_mps2 - along,
        "lateral acceleration": state.speed_mps * state.yaw_rate_radps - across,
    }


def bands(
    states: Sequence[ObjectState], previous: Reference | None, until_ns: int
) -> dict[str, Band] | None:
    """Noise bands from the states before an instant, by quantity; None: too few states.

    Args:
        states: of the object, in order.
        previous: as in ``differences``.
        until_ns: the instant.
    """
    name = previous.reference_id if previous is not None else ""
    begin_ns = until_ns - BEFORE_S * NS_PER_S
    before = [
        differences(s, previous)
        for s in states
        if begin_ns <= s.stamp_ns <= until_ns and s.reference_id == name and s.is_finite
    ]
    if len(before) < LEAST_STATES:
        return None
    found = {}
    for quantity, floor in FLOORS.items():
        values = [d[quantity] for d in before]
        middle = statistics.median(values)
        sigma = MAD_TO_SIGMA * statistics.median(abs(v - middle) for v in values)
        found[quantity] = Band(middle, max(SIGMAS * sigma, floor))
    return found


def onset(
    states: Sequence[ObjectState],
    previous: Reference | None,
    noise: dict[str, Band],
    dispatched_ns: int,
    execute_at_ns: int,
) -> Onset | None:
    """The first of two states in a row that depart from the previous reference.

    Args:
        states: of the object, in order of their stamps.
        previous: as in ``differences``.
        noise: as ``bands`` gives it.
        dispatched_ns: looked at are later states.
        execute_at_ns: of the new reference; looked at are states up to ``WITHIN_S`` later.
    """
    candidate: Onset | None = None
    for state in states:
        if not state.is_finite or state.stamp_ns <= dispatched_ns:
            continue
        if ns_to_seconds(state.stamp_ns - execute_at_ns) > WITHIN_S:
            break
        outside = {
            quantity: value
            for quantity, value in differences(state, previous).items()
            if not noise[quantity].holds(value)
        }
        if not outside:
            candidate = None
        elif candidate is not None:
            return candidate
        else:
            widest = max(outside, key=lambda q: abs(outside[q] - noise[q].middle) / noise[q].half)
            candidate = Onset(state.stamp_ns, widest, outside[widest], noise[widest])
    return None
