"""How well objects kept to their references, and how many of their states are missing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.core.tally import Tally


@dataclass(frozen=True, slots=True)
class Errors:
    """Tracking errors over some states, m: root mean square, and the largest in size.

    Args:
        states: that the errors are of.
        not_finite: left out, because an error is no number.
    """

    states: int
    not_finite: int
    lateral_rms_m: float
    lateral_max_m: float
    longitudinal_rms_m: float
    longitudinal_max_m: float


@dataclass(frozen=True, slots=True)
class Tracking:
    """Tracking errors of one object over the run, and over each of its references in order."""

    whole: Errors
    by_reference: dict[str, Errors] = field(default_factory=dict)


def tracking(states: Iterable[ObjectState]) -> Tracking | None:
    """Tracking errors that an object reports of itself.

    Args:
        states: of one object in order; counted are those in state RUNNING with a reference. An
            object that aborts brakes as it must, and its distance to a reference says nothing.

    Returns:
        None where it never tracked anything.
    """
    counted = [s for s in states if s.reference_id and s.control_state is ControlState.RUNNING]
    if not counted:
        return None
    by_reference: dict[str, list[ObjectState]] = {}
    for state in counted:
        by_reference.setdefault(state.reference_id, []).append(state)
    return Tracking(_errors(counted), {name: _errors(own) for name, own in by_reference.items()})


def _errors(states: Sequence[ObjectState]) -> Errors:
    pairs = [
        (s.error_lateral_m, s.error_longitudinal_m)
        for s in states
        if math.isfinite(s.error_lateral_m) and math.isfinite(s.error_longitudinal_m)
    ]
    lateral, longitudinal = [a for a, _ in pairs], [b for _, b in pairs]
    return Errors(
        states=len(pairs),
        not_finite=len(states) - len(pairs),
        lateral_rms_m=_rms(lateral),
        lateral_max_m=max(map(abs, lateral), default=0.0),
        longitudinal_rms_m=_rms(longitudinal),
        longitudinal_max_m=max(map(abs, longitudinal), default=0.0),
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(math.fsum(v * v for v in values) / len(values)) if values else 0.0


@dataclass(frozen=True, slots=True)
class Receipt:
    """States of one object in the bag.

    Args:
        received: all of them.
        lost: sequence numbers that are missing between the first and the last.
        out_of_order: that came after one with a later stamp.
    """

    received: int
    lost: int
    out_of_order: int


def receipt(states: Sequence[ObjectState]) -> Receipt:
    """Counts the states of one object, in the order in which they were recorded."""
    tally, latest_ns, late = Tally(), -1, 0
    for state in states:
        tally.see(state.sequence)
        late += state.stamp_ns < latest_ns
        latest_ns = max(latest_ns, state.stamp_ns)
    return Receipt(tally.received, tally.lost, late)
