"""The severity of a run: TTC, distance, PET, deceleration needed, jerk, plans (METHOD 8.8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline, box_distance
from ssp_core.motion.encounter import encounter
from ssp_core.motion.reference import PLAN, Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.contact import Contact, until
from ssp_scenario_manager.closed_loop.starts.start import path_of
from ssp_scenario_manager.run.in_process import InProcessResult

# A change of the acceleration is taken over so long, so that a step's rounding is no jerk.
_JERK_S = 0.1
# Successive plans are compared at this time after the frame of the later one.
_AHEAD_S = 1.0


@dataclass(frozen=True, slots=True)
class Severity:
    """Measures of harm between the hand-over and the deciding fact of a run.

    Args:
        ttc_s: smallest TTC to any object; None: the VUT never closed in on one.
        distance_m: smallest distance of the outlines of the VUT and an object.
        pet_s: time gap at the conflict point; None where one of the two didn't pass by then.
        needed_mps2: largest deceleration that was needed, (closing speed)² / (2 · bumper gap),
            while an object was in the VUT's swept corridor; None after a contact, before which it
            grows without bound.
        jerk_mps3: largest change of the VUT's acceleration; None of a prescribed motion, whose end
            has none.
        replan_m: mean distance of successive plans, each pair at 1 s after the frame of the later.
    """

    ttc_s: float | None
    distance_m: float | None
    pet_s: float | None
    needed_mps2: float | None
    jerk_mps3: float | None
    replan_m: float | None


def severity_facts(
    run: RunSpec,
    driven: Driven,
    reports: Sequence[StepReport],
    result: InProcessResult | None,
    contact: Contact | None,
    decided_s: float,
) -> Severity:
    """Measure the severity of a driven run.

    Args:
        run: as it was driven.
        driven: its driver.
        reports: of its steps.
        result: of the run, for the time gap; None: the VUT's motion was prescribed.
        contact: the first one; None: there was none.
        decided_s: time of the deciding fact, or T_end.
    """
    led = until(reports, driven.hand_over_s, min(driven.end_s, decided_s))
    nearest = _Nearest(path_of(run))
    accelerations = []
    for report in led:
        vut = next(s for s in report.truths if s.object_id == run.vut.id)
        accelerations.append(vut.acceleration_mps2)
        for other in report.truths:
            if other is not vut:
                nearest.take(vut, other)
    passed = None if contact is not None or result is None else _pet_s(result, decided_s)
    return Severity(
        ttc_s=_finite(nearest.ttc_s),
        distance_m=_finite(nearest.distance_m),
        pet_s=passed,
        needed_mps2=None if contact is not None else nearest.needed_mps2,
        jerk_mps3=None if result is None else _jerk_mps3(accelerations, run.step_s),
        replan_m=_replan_m(led),
    )


class _Nearest:
    """The smallest TTC and distance, and the largest needed deceleration, of many instants.

    An object that is too far off to change any of them costs no projection on the path: neither its
    gap along the path nor its distance is smaller than that of the circles around both.
    """

    def __init__(self, path: Polyline) -> None:
        self._path = path
        self.ttc_s = self.distance_m = math.inf
        self.needed_mps2 = 0.0

    def take(self, vut: ObjectState, other: ObjectState) -> None:
        """Take one object at one instant into account."""
        reach_m = sum(math.hypot(s.size.length_m, s.size.width_m) for s in (vut, other))
        apart_m = math.hypot(vut.x_m - other.x_m, vut.y_m - other.y_m) - reach_m
        if apart_m < self.distance_m:
            self.distance_m = min(self.distance_m, box_distance(vut.box, other.box))
        fastest_mps = vut.speed_mps + other.speed_mps
        is_far = apart_m > 0.0 and (
            apart_m > self.ttc_s * fastest_mps and fastest_mps**2 < 2.0 * apart_m * self.needed_mps2
        )
        if is_far:
            return
        meeting = encounter(vut, other, self._path)
        self.ttc_s = min(self.ttc_s, meeting.ttc_s)
        closing_mps = vut.speed_mps - meeting.along_mps
        if meeting.in_corridor and meeting.gap_m > 0.0 and closing_mps > 0.0:
            needed_mps2 = closing_mps**2 / (2.0 * meeting.gap_m)
            self.needed_mps2 = max(self.needed_mps2, needed_mps2)


def _jerk_mps3(accelerations: Sequence[float], step_s: float) -> float | None:
    steps = max(1, round(_JERK_S / step_s))
    if len(accelerations) <= steps:
        return None
    values = np.array(accelerations)
    return float(np.abs(values[steps:] - values[:-steps]).max()) / (steps * step_s)


def _replan_m(led: Sequence[StepReport]) -> float | None:
    plans = [
        report.drive.effective
        for report in led
        if report.drive is not None and report.drive.effective is not None
    ]
    distances_m = [
        distance
        for before, after in pairwise(one for one in plans if one.purpose == PLAN)
        if (distance := _apart_m(before, after)) is not None
    ]
    return math.fsum(distances_m) / len(distances_m) if distances_m else None


def _apart_m(before: Reference, after: Reference) -> float | None:
    at_ns = after.execute_at_ns + seconds_to_ns(_AHEAD_S)
    if at_ns > min(before.end_ns, after.end_ns):
        return None
    places = []
    for plan in (before, after):
        t, x, y = plan.columns[:3]
        at_s = ns_to_seconds(at_ns - plan.execute_at_ns)
        places.append((float(np.interp(at_s, t, x)), float(np.interp(at_s, t, y))))
    return math.dist(*places)


def _pet_s(result: InProcessResult, decided_s: float) -> float | None:
    """Return the time gap, whose end is the second one's arrival; None where that came later."""
    passing = result.passing
    arrivals_s = (passing.own_arrival_s, passing.other_arrival_s)
    over_s = max((t for t in arrivals_s if t is not None), default=math.inf)
    if passing.time_gap_s is None or over_s > decided_s:
        return None
    return _finite(passing.time_gap_s)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
