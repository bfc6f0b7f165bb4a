"""The careful driver of UN R157 as a prescribed motion of the VUT, outside the plant (METHOD 8.8).

It is defined for an object that comes into the VUT's lane or leaves it, and for one that brakes
hard ahead of the VUT; elsewhere there is none. Up to its braking, which is prescribed, it moves as
the ``no_response`` twin does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TriggerSpec
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.contact import (
    contact_words,
    first_contact,
    until,
    with_vut,
)
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS, Outcome
from ssp_scenario_manager.closed_loop.starts.start import Start, path_of
from ssp_scenario_manager.closed_loop.values import EPSILON_S, LIMITS
from ssp_scenario_manager.run.in_process import Record

CAREFUL = "careful"
_G_MPS2 = 9.80665


@dataclass(frozen=True, slots=True)
class CarefulDriver:
    """The values of UN R157, annex 3, table 1.

    Args:
        lateral_m: deviation from its lane from which on an object that changes lanes is perceived.
        braking_mps2: deceleration above which an object that brakes is perceived.
        evaluation_s: from the perception on, the risk is evaluated.
        reaction_s: from then on until the braking begins.
        deceleration_mps2: of the braking.
        jerk_mps3: with which it builds up.
        wrap_m: by so much its side may stick out beside the VUT's then.
        wrapped_mps2: deceleration once an object that came in is in the VUT's lane with its whole
            width.
        wrapped_s: within which it is reached.
    """

    lateral_m: float = 0.375
    braking_mps2: float = 5.0
    evaluation_s: float = 0.4
    reaction_s: float = 0.75
    deceleration_mps2: float = 0.774 * _G_MPS2
    jerk_mps3: float = 12.65
    wrap_m: float = 0.1
    wrapped_mps2: float = 0.85 * _G_MPS2
    wrapped_s: float = 0.6


CAREFUL_DRIVER = CarefulDriver()


def is_defined(run: RunSpec) -> bool:
    """Tell whether the careful driver is defined for a run.

    UN R157 doesn't say what it does behind an object that brakes by less than it perceives.
    """
    manoeuvre = _acting(run).manoeuvre
    if manoeuvre.kind == "brake":
        return manoeuvre.deceleration_mps2 > CAREFUL_DRIVER.braking_mps2
    return manoeuvre.kind == "lane_change"


def _acting(run: RunSpec) -> TriggerSpec:
    """Return the trigger of the object that does something: in a cut-out not the initiator."""
    acting = (t for t in run.triggers if t.manoeuvre.kind != "hold")
    return next(acting, run.triggers[0])


def careful_motion(
    start: Start, record: Record, driver: CarefulDriver = CAREFUL_DRIVER
) -> tuple[Outcome, list[StepReport]]:
    """Return the outcome of the careful driver on a start, and the steps of its motion.

    Args:
        start: with its twin.
        record: of any run of the start that went on to T_end, or to the contact of a driver that
            brakes earlier: the objects move alike in all of them.
        driver: its values.
    """
    run = start.run
    others = until(record.reports, start.hand_over_s - EPSILON_S, start.end_s)
    path = path_of(run)
    begin_s, wrap_s = _instants(run, path, others, start.observable_s, driver)
    moved: list[StepReport] = []
    vut, station_m = _twin_at(start, others[0].now_ns), 0.0
    for report in others:
        at_s = ns_to_seconds(report.now_ns)
        twin = start.twin.get(report.now_ns)
        if at_s <= begin_s + EPSILON_S and twin is not None:
            vut = twin
            station_m, _ = path.project_beyond(vut.x_m, vut.y_m)
        else:
            deceleration = _deceleration_mps2(at_s - begin_s, at_s - wrap_s, driver)
            speed = max(vut.speed_mps - deceleration * run.step_s, 0.0)
            station_m += 0.5 * (vut.speed_mps + speed) * run.step_s
            pose = path.pose(station_m)
            vut = replace(
                vut,
                stamp_ns=report.now_ns,
                x_m=pose.x_m,
                y_m=pose.y_m,
                yaw_rad=pose.yaw_rad,
                speed_mps=speed,
                acceleration_mps2=-deceleration if speed > 0.0 else 0.0,
            )
        moved.append(replace(with_vut(report, vut), drive=None))
    return _outcome(start, moved, begin_s), moved


def _outcome(start: Start, moved: Sequence[StepReport], begin_s: float) -> Outcome:
    response_s = None if math.isinf(begin_s) else begin_s
    contact = first_contact(moved, start.run.vut.id)
    if contact is not None:
        kind = "collision" if contact.vut_mps > LIMITS.standing_mps else "struck"
        why = contact_words(start.run, moved, contact)
        return Outcome(kind, contact.at_s, why, contact, response_s, 0.0, False)
    last_s = ns_to_seconds(moved[-1].now_ns)
    if last_s < start.end_s - start.run.step_s - EPSILON_S:
        why = f"the motion of the objects is known up to {last_s:.2f} s"
        return Outcome(HARNESS, last_s, why, None, response_s, 0.0, False)
    why = "no contact until T_end"
    return Outcome("avoided", start.end_s, why, None, response_s, 0.0, False)


def _twin_at(start: Start, stamp_ns: int) -> ObjectState:
    twin = start.twin.get(stamp_ns)
    if twin is None:
        raise ValueError("the twin of a start has no state at the hand-over")
    return twin


def _instants(
    run: RunSpec,
    path: Polyline,
    others: Sequence[StepReport],
    observable_s: float,
    driver: CarefulDriver,
) -> tuple[float, float]:
    """Return when the braking begins, and when the object has come in with its whole width."""
    acting = _acting(run)
    kind, comes_in = acting.manoeuvre.kind, acting.object_id == run.initiator_id
    perceived_s = wrap_s = math.inf
    lane_m: float | None = None
    for report in others:
        at_s = ns_to_seconds(report.now_ns)
        other = next(s for s in report.truths if s.object_id == acting.object_id)
        vut = next(s for s in report.truths if s.object_id == run.vut.id)
        if kind == "brake":
            is_perceptible = (
                at_s >= observable_s and other.acceleration_mps2 <= -driver.braking_mps2
            )
        else:
            _, offset_m = path.project_beyond(other.x_m, other.y_m)
            lane_m = offset_m if lane_m is None else lane_m
            is_perceptible = abs(offset_m - lane_m) >= driver.lateral_m
            spare_m = 0.5 * abs(vut.size.width_m - other.size.width_m)
            if comes_in and math.isinf(wrap_s) and abs(offset_m) <= spare_m + driver.wrap_m:
                wrap_s = at_s
        if is_perceptible and math.isinf(perceived_s):
            perceived_s = at_s
    return perceived_s + driver.evaluation_s + driver.reaction_s, wrap_s


def _deceleration_mps2(braking_s: float, wrapped_s: float, driver: CarefulDriver) -> float:
    """Return the deceleration so long after the braking began, and after the full wrap."""
    deceleration_mps2 = min(driver.deceleration_mps2, driver.jerk_mps3 * max(braking_s, 0.0))
    since_s = min(braking_s, wrapped_s)
    if since_s > 0.0:
        share = min(since_s / driver.wrapped_s, 1.0)
        deceleration_mps2 = max(deceleration_mps2, driver.wrapped_mps2 * share)
    return deceleration_mps2
