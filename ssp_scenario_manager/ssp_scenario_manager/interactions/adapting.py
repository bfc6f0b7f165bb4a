"""The time gap that a plan foresees for a VUT that keeps its speed, and how an OT keeps it.

K* gives an interval for the gap, most of which comes of the VUT's response. What an adaptation
holds is the gap before any response: that between the VUT at its speed at the trigger and the
manoeuvre as planned.
"""

from __future__ import annotations

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.run_file.participants import Adaptation
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import ObjectWord
from ssp_scenario_manager.core.dispatch import (
    APPROACH_LEAD_S,
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.core.routine import Routine, routine_of
from ssp_scenario_manager.core.vut_track import follow_vut, foreseen_gap_s
from ssp_scenario_manager.interactions.foresight import Foresight
from ssp_scenario_manager.interactions.motions import Motions

# What every body of a class can do, m/s^2: hardest acceleration and braking. Beyond it a reference
# would be refused.
_BODY_MPS2: dict[ObjectWord, tuple[float, float]] = {
    "pedestrian": (2.4, 2.9),
    "cyclist": (1.7, 3.4),
    "truck": (1.7, 4.8),
    "bus": (1.7, 4.8),
    "car": (3.5, 6.5),
    "motorcycle": (5.0, 6.5),
}
# Of what the place allows; the rest is for the tracking of it.
_SHARE_OF_LIMIT = 0.9


def _routine(told: Motions, seen: Foresight) -> Routine | None:
    """The initiator's manoeuvre from where it is when the trigger fires."""
    trigger, path = told.trigger, told.vut.approach
    target = told.target(trigger.object_id)
    if path is None:
        return None

    def address(execute_s: float) -> Address:
        return Address(target.id, target.id, "", "foreseen", 0, seconds_to_ns(execute_s))

    before = None
    if target.approach is not None:
        before = approach_reference(address(APPROACH_LEAD_S), target.approach)
    state = next(s for s in seen.targets_fired if s.object_id == target.id)
    manoeuvre = manoeuvre_reference(
        address(seen.fired_s + trigger.lead_time_s),
        trigger.manoeuvre,
        state,
        before,
        target.approach,
    )
    fired_ns = seconds_to_ns(seen.fired_s)
    return routine_of(before, manoeuvre, fired_ns, target, told.vut, Polyline(path.path))


def gap_before_response_s(told: Motions, seen: Foresight, *, initiator_first: bool) -> float | None:
    """Second arrival minus first departure (METHOD 1), with a VUT that keeps its speed.

    Args:
        told: what everybody does.
        seen: what will come of it.
        initiator_first: by the passing order.

    Returns:
        s, rounded to 1 ms; None where the initiator's manoeuvre doesn't lead it into the VUT's
        corridor.
    """
    routine = _routine(told, seen)
    if routine is None or told.vut.approach is None:
        return None
    path = Polyline(told.vut.approach.path)
    track = follow_vut(None, seen.vut_fired, path)
    gap = foreseen_gap_s(routine, track, told.vut.size, initiator_first=initiator_first)
    return round(gap, 3)


def adaptation_of(
    told: Motions,
    gap_s: float | None,
    *,
    initiator_first: bool,
    anchor: Point | None,
    most_mps2: float,
) -> Adaptation | None:
    """What a run's trigger is told of keeping the gap; None where there is none to keep.

    Args:
        told: what everybody does.
        gap_s: as ``gap_before_response_s`` gives it.
        initiator_first: by the passing order.
        anchor: the conflict point, where it doesn't move with the place of the trigger.
        most_mps2: acceleration that the place allows.
    """
    if gap_s is None:
        return None
    up, down = _BODY_MPS2[told.target(told.trigger.object_id).object_class]
    most = round(_SHARE_OF_LIMIT * most_mps2, 3)
    return Adaptation(
        anchor=anchor,
        first="initiator" if initiator_first else "vut",
        gap_s=gap_s,
        acceleration_mps2=min(up, most),
        deceleration_mps2=min(down, most),
    )
