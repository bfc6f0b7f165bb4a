"""Seeded sessions in one process whose VUT isn't as fast as planned, with and without adaptation.

The VUT doesn't respond: its cruise speed is off by a seeded share of up to 20 % from the start, and
by another one some time after the trigger. States and references pass links that delay and lose
them, and are noisy. The time gap and the passing order are measured on the true states (METHOD 1).

The runs are the shipped ones with room to adapt in: the trigger fires earlier by as much as the
manoeuvre waits longer (cut_in), or as the gap is longer (vru_crossing: at the shipped one, a VUT
that doesn't respond hits the pedestrian). The specified gap is that of the run with nothing off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.passing import Passing, passing_since
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import LinkDisturbance, RunSpec
from ssp_core.run_file.participants import (
    ParticipantSpec,
    RelativeDistance,
    SpeedChange,
    TimeToArrival,
)
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import Role
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.sil.vut_driver import VutDriver
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.dispatch.planned_motion import planned_motion_of
from ssp_scenario_manager.dispatch.references import (
    APPROACH_LEAD_S,
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.run.in_process import Record, run_in_process
from ssp_scenario_manager.run.result import instants

SCENARIOS = ("cut_in", "vru_crossing")
Scenario = Literal["cut_in", "vru_crossing"]
# How much the VUT's speed is off at most, as a share of its cruise speed.
MOST_OFF = 0.2
# When it changes, s after the trigger.
CHANGES_S = (0.3, 2.0)
# How quickly it changes, m/s^2.
CHANGE_MPS2 = 1.2
TOLERANCE_S = 0.15
NOISE = LinkDisturbance(
    state_delay_s=0.04,
    state_loss=0.01,
    command_delay_s=0.02,
    command_loss=0.01,
    position_noise_m=0.03,
    speed_noise_mps=0.05,
)
# How much longer the lane change waits, and how much earlier the VUT is seen at the crossing.
WAITS_S = 2.9
# Room for a VUT that is 20 % too fast to brake in, once it has passed the conflict point.
SPARE_S = 1.2
EARLIER_S = 1.3
# Of what K* allows, what leaves the VUT the most room.
MILDEST = {"cruise_mps": 6.0, "deceleration_mps2": 1.5}
LONGEST_S = 40.0
# VUT and OT are at their speeds, whatever these are, when the trigger fires: the VUT gets there
# sooner, and the OT that drives starts farther ahead.
ACCELERATION_MPS2 = 3.0
AHEAD_M = 20.0
# So long after it has passed the conflict point the VUT brakes hard, so that nobody is hit.
GIVES_WAY_S = 0.12
GIVES_WAY_MPS2 = 7.0
AFTER_S = 6.0


@dataclass(frozen=True)
class Case:
    """The deviations of one run.

    Args:
        seed: of the run.
        at_first: factor on the cruise speed from the start.
        later: factor from some time after the trigger.
        after_s: that time.
    """

    seed: int
    at_first: float
    later: float
    after_s: float


@dataclass(frozen=True)
class Result:
    """The outcome of one run.

    Args:
        error_s: time gap minus the specified one; inf: there is none.
        right_order: the initiator arrived first.
        adapted: references that the OT drove beside approach and manoeuvre.
        verdict: of the session.
        reasons: of the verdict.
    """

    error_s: float
    right_order: bool
    adapted: int
    verdict: str
    reasons: tuple[str, ...]


def case_of(seed: int) -> Case:
    """The seeded case."""
    rng = np.random.default_rng([seed, 4])
    first, later = rng.uniform(1.0 - MOST_OFF, 1.0 + MOST_OFF, 2)
    return Case(seed, float(first), float(later), float(rng.uniform(*CHANGES_S)))


NOMINAL = Case(0, 1.0, 1.0, CHANGES_S[0])


@lru_cache
def base(scenario: Scenario) -> RunSpec:
    """The shipped run on the boulevard with room to adapt in, and a VUT that doesn't respond."""
    run = compile_task(Request(event=scenario, target="sumo", site="boulevard")).task.run
    trigger = run.triggers[0]
    condition = trigger.condition
    if isinstance(condition, RelativeDistance):
        target = next(t for t in run.targets if t.id == trigger.object_id)
        closing = run.driver.cruise_mps - (target.approach.cruise_mps if target.approach else 0.0)
        below = condition.below_m + closing * (WAITS_S + SPARE_S)
        trigger = trigger.model_copy(
            update={
                "condition": condition.model_copy(update={"below_m": below}),
                "lead_time_s": trigger.lead_time_s + WAITS_S,
                "manoeuvre": trigger.manoeuvre.model_copy(update=MILDEST),
            }
        )
    elif isinstance(condition, TimeToArrival):
        below = condition.below_s + EARLIER_S
        trigger = trigger.model_copy(
            update={"condition": condition.model_copy(update={"below_s": below})}
        )
    # A VUT that is 20 % too fast is faster than the shipped site allows.
    fastest = max(run.limits.speed_mps, run.driver.cruise_mps * (1.0 + MOST_OFF) + 0.5)
    return run.model_copy(
        update={
            "targets": [_ahead(target) for target in run.targets],
            "triggers": [trigger],
            "limits": run.limits.model_copy(update={"speed_mps": fastest}),
            "driver": run.driver.model_copy(
                update={
                    "reacts": False,
                    "acceleration_mps2": ACCELERATION_MPS2,
                    "comfortable_deceleration_mps2": GIVES_WAY_MPS2,
                }
            ),
            # Without a conflict for a while, a run would end before the VUT has passed.
            "end": run.end.model_copy(update={"after_resolution_s": AFTER_S}),
            "traffic": [],
            "camera": None,
            "disturbance": LinkDisturbance(),
        }
    )


def _ahead(target: ParticipantSpec) -> ParticipantSpec:
    """A target that drives, moved ahead along its path."""
    if target.approach is None:
        return target
    path = Polyline(target.approach.path)
    pose = path.pose(AHEAD_M)
    start = Start(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)
    rest = [p for p, s in zip(target.approach.path, path.stations_m, strict=True) if s > AHEAD_M]
    motion = target.approach.model_copy(update={"path": [(pose.x_m, pose.y_m), *rest]})
    return target.model_copy(update={"start": start, "approach": motion})


class ForeseenSession:
    """The VUT on its own, which is what it is in these runs until it gives way."""

    def __init__(self, run: RunSpec) -> None:
        self._run = run
        motion = run.vut.approach
        if motion is None:
            raise RuntimeError("the VUT has no path")
        self._path = Polyline(motion.path)
        self._trigger = run.triggers[0]
        self._target = next(t for t in run.targets if t.id == self._trigger.object_id)
        self._approach: Reference | None = None
        if self._target.approach is not None:
            address = Address("a", self._target.id, "", "", 0, seconds_to_ns(APPROACH_LEAD_S))
            self._approach = approach_reference(address, self._target.approach)

    def trace(self, later: Sequence[SpeedChange]) -> list[ObjectState]:
        """States of the VUT from the start on, until it has driven its path or time is up."""
        run = self._run.model_copy(
            update={"driver": self._run.driver.model_copy(update={"later": list(later)})}
        )
        driver, spec = VutDriver(run), run.vut
        body, states = BodyState.at_rest(spec.start.pose), []
        for i in range(round(LONGEST_S / run.step_s)):
            states.append(
                ObjectState(
                    spec.id,
                    spec.cls,
                    Role.VUT,
                    i * seconds_to_ns(run.step_s),
                    body.x_m,
                    body.y_m,
                    body.yaw_rad,
                    body.speed_mps,
                    body.acceleration_mps2,
                    0.0,
                    spec.size,
                )
            )
            command = driver.command(states[-1], [], None, drives=True)
            body = step_body(spec.cls, body, command, run.step_s)
        return states

    def front_m(self, vut: ObjectState) -> float:
        return self._path.project_beyond(vut.x_m, vut.y_m)[0] + vut.size.front_m

    def fires_ns(self, states: Sequence[ObjectState]) -> int:
        """Find when the trigger fires."""
        condition = self._trigger.condition
        for vut in states:
            if vut.stamp_ns < seconds_to_ns(self._trigger.not_before_s):
                continue
            if isinstance(condition, TimeToArrival):
                left = self._path.project(*condition.anchor)[0] - self.front_m(vut)
                if left < condition.below_s * vut.speed_mps:
                    return vut.stamp_ns
            elif isinstance(condition, RelativeDistance) and self._approach is not None:
                point = sample(self._approach, vut.stamp_ns)
                rear = self._path.project_beyond(point.x_m, point.y_m)[0] - self._target.size.rear_m
                if rear - self.front_m(vut) < condition.below_m:
                    return vut.stamp_ns
        raise RuntimeError("the trigger never fires")

    def passes_s(self, fired_ns: int, states: Sequence[ObjectState]) -> float:
        """Find when the VUT's front is at the conflict point."""
        at_ns = fired_ns + seconds_to_ns(self._trigger.lead_time_s)
        address = Address("m", self._target.id, "", "", fired_ns, at_ns)
        there = states[0]  # who has no approach stands at its start, and no state is asked for
        manoeuvre = manoeuvre_reference(
            address, self._trigger.manoeuvre, there, self._approach, self._target.approach
        )
        planned_motion = planned_motion_of(
            self._approach, manoeuvre, fired_ns, self._target, self._run.vut, self._path
        )
        if planned_motion is None:
            raise RuntimeError("the manoeuvre doesn't meet the VUT")
        for vut in states:
            if self.front_m(vut) >= planned_motion.zone.start_m:
                return ns_to_seconds(vut.stamp_ns)
        return LONGEST_S


def _changes(case: Case, cruise_mps: float, at_s: float) -> list[SpeedChange]:
    """List the changes from the first speed to the later one, in steps of 0.1 s."""
    first, last = case.at_first * cruise_mps, case.later * cruise_mps
    steps = max(1, math.ceil(abs(last - first) / (CHANGE_MPS2 * 0.1)))
    return [
        SpeedChange(at_s=at_s + 0.1 * i, cruise_mps=first + (last - first) * (i + 1) / steps)
        for i in range(steps)
    ]


def run_of(scenario: Scenario, case: Case, gap_s: float | None, noise: LinkDisturbance) -> RunSpec:
    """The run of one case.

    Args:
        scenario: by name.
        case: what is off.
        gap_s: to be kept; None: nothing is adapted.
        noise: of everybody's links and localisation.
    """
    run = base(scenario)
    cruise = run.driver.cruise_mps
    driver = run.driver.model_copy(update={"cruise_mps": cruise * case.at_first})
    run = run.model_copy(update={"driver": driver})
    foreseen = ForeseenSession(run)
    fired_ns = foreseen.fires_ns(foreseen.trace([]))
    later = _changes(case, cruise, ns_to_seconds(fired_ns) + case.after_s)
    passes_s = foreseen.passes_s(fired_ns, foreseen.trace(later))
    later = [c for c in later if c.at_s < passes_s]
    later.append(SpeedChange(at_s=passes_s + GIVES_WAY_S, cruise_mps=0.2 * cruise))
    trigger = run.triggers[0]
    adaptation = trigger.adaptation
    if adaptation is None:
        raise RuntimeError(f"{scenario} has no adaptation")
    kept = None if gap_s is None else adaptation.model_copy(update={"gap_s": gap_s})
    return run.model_copy(
        update={
            "seed": case.seed,
            "driver": driver.model_copy(update={"later": later}),
            "disturbance": noise,
            "triggers": [trigger.model_copy(update={"adaptation": kept})],
        }
    )


@lru_cache
def specified_gap_s(scenario: Scenario) -> float:
    """The gap of the run with nothing off, s."""
    run = run_of(scenario, NOMINAL, None, LinkDisturbance())
    result, record = run_in_process(run)
    gap = _measured(run, record).time_gap_s
    if gap is None:
        raise RuntimeError(f"{scenario} has no time gap with nothing off: {result.reasons}")
    return gap


def _measured(run: RunSpec, record: Record) -> Passing:
    """Gap and order on the true states, from when both are at their speeds."""
    if run.vut.approach is None:
        raise RuntimeError("the VUT has no path")
    corridor = Corridor(Polyline(run.vut.approach.path), corridor_half_m(run.vut.size.width_m))
    states = record.truths(run.vut.id), record.truths(run.initiator_id)
    return passing_since(instants(*states), corridor, run.triggers[0].not_before_s)


def measure_case(scenario: Scenario, gap_s: float, adapt: bool, seed: int) -> Result:
    """Runs one case and measures it.

    Args:
        scenario: by name.
        gap_s: specified.
        adapt: False: the manoeuvre is dispatched, and that's it.
        seed: of the case.
    """
    run = run_of(scenario, case_of(seed), gap_s if adapt else None, NOISE)
    result, record = run_in_process(run)
    met = _measured(run, record)
    gap = met.time_gap_s
    driven = {s.reference_id for s in record.arrived(run.initiator_id) if s.reference_id}
    planned = {name for trigger in result.triggers for name in trigger.reference_ids}
    if run.targets[0].approach is not None:
        planned.add(f"{run.initiator_id}-1")
    return Result(
        math.inf if gap is None else gap - gap_s,
        met.other_first is True,
        len(driven - planned),
        result.verdict.name.lower(),
        result.reasons,
    )
