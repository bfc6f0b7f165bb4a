"""Severity of driven runs and the careful driver of UN R157, on motions with known figures."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import FloatArray
from ssp_core.motion.passing import Passing
from ssp_core.motion.reference import Points
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Brake, FollowPath, Hold
from ssp_core.world.driver import Answer, DriveMode, DriveReport, EffectiveAnswer
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.outcomes.careful import (
    CAREFUL_DRIVER,
    careful_motion,
    is_defined,
)
from ssp_scenario_manager.closed_loop.outcomes.severity import Severity, severity_facts
from ssp_scenario_manager.closed_loop.outcomes.texts import texts_of, write_texts
from ssp_scenario_manager.closed_loop.starts.start import Start
from ssp_scenario_manager.run.in_process import Record
from tests.support.runs import cut_in_run
from tests.support.states import make_reference, object_state

STEP_S, SPEED_MPS = 0.02, 10.0


@pytest.fixture
def run() -> RunSpec:
    return RunSpec.model_validate(cut_in_run()).model_copy(update={"step_s": STEP_S})


def report(t_s: float, *states: ObjectState, drive: DriveReport | None = None) -> StepReport:
    stamp_ns = seconds_to_ns(t_s)
    truths = tuple(replace(state, stamp_ns=stamp_ns) for state in states)
    return StepReport(0, stamp_ns, True, truths, (), (), drive=drive)


def times(end_s: float) -> list[float]:
    return [round(k * STEP_S, 6) for k in range(round(end_s / STEP_S) + 1)]


def start_of(run: RunSpec, end_s: float) -> Start:
    """A start whose twin drives straight on at 10 m/s from x = 50 m at t = 0."""
    twin = {
        seconds_to_ns(t): object_state(
            "vut", x_m=50.0 + SPEED_MPS * t, speed_mps=SPEED_MPS, stamp_ns=seconds_to_ns(t)
        )
        for t in times(end_s)
    }
    return Start(run, {}, 0.0, 0.0, 1.0, end_s, 0.1, None, twin)


def careful_steps(run: RunSpec, other: Any, end_s: float = 8.0) -> tuple[Any, list[StepReport]]:
    """The careful driver's run behind an object whose state at a time is given."""
    reports = [report(t, object_state("vut"), other(t)) for t in times(end_s)]
    return careful_motion(start_of(run, end_s), Record(reports))


def cutting_in(t_s: float) -> ObjectState:
    """Return an object 35 m ahead at 6 m/s that comes over from 3.5 m by 1 m/s from 1 s on."""
    aside_m = max(3.5 - max(t_s - 1.0, 0.0), 0.0)
    return object_state(x_m=85.0 + 6.0 * t_s, y_m=aside_m, speed_mps=6.0)


def decelerations(steps: list[StepReport]) -> dict[float, float]:
    return {
        round(one.now_ns / 1e9, 2): -next(
            s.acceleration_mps2 for s in one.truths if s.object_id == "vut"
        )
        for one in steps
    }


def test_the_careful_driver_perceives_evaluates_reacts_and_brakes_as_r157_says(
    run: RunSpec,
) -> None:
    outcome, steps = careful_steps(run, cutting_in)
    # 0.375 m beside its lane at 1.375 s, seen at the next step; 0.4 s, 0.75 s.
    begin_s = 1.38 + 0.4 + 0.75
    assert outcome.response_s == pytest.approx(begin_s)
    found = decelerations(steps)
    assert found[2.52] == 0.0
    assert found[2.74] == pytest.approx(12.65 * (2.74 - begin_s))
    assert max(found.values()) == pytest.approx(0.774 * 9.80665)
    assert outcome.kind == "avoided"


def test_the_careful_driver_brakes_harder_once_the_object_is_in_its_lane(run: RunSpec) -> None:
    _, steps = careful_steps(run, lambda t: replace(cutting_in(t), x_m=65.0 + 3.0 * t))
    found = decelerations(steps)
    # Within 0.1 m of the VUT's width at 4.4 s; 0.85 g 0.6 s later, unless it stands by then.
    assert all(value <= 0.774 * 9.80665 + 1e-9 for t, value in found.items() if t < 4.4)
    late = replace(CAREFUL_DRIVER, lateral_m=3.3)
    reports = [report(t, object_state("vut"), cutting_in(t)) for t in times(8.0)]
    _, steps = careful_motion(start_of(run, 8.0), Record(reports), late)
    assert max(decelerations(steps).values()) == pytest.approx(0.85 * 9.80665)


def test_the_careful_driver_brakes_behind_one_that_brakes_by_more_than_5_mps2(run: RunSpec) -> None:
    manoeuvre = Brake(kind="brake", to_mps=0.0, deceleration_mps2=6.0)
    brake = run.triggers[0].model_copy(update={"manoeuvre": manoeuvre})
    braked = run.model_copy(update={"triggers": [brake]})

    def ahead(t_s: float, by_mps2: float) -> ObjectState:
        slows_s = min(max(t_s - 1.0, 0.0), SPEED_MPS / by_mps2)
        way_m = SPEED_MPS * min(t_s, 1.0) + SPEED_MPS * slows_s - 0.5 * by_mps2 * slows_s**2
        slows = -by_mps2 if 0.0 < slows_s < SPEED_MPS / by_mps2 else 0.0
        speed = SPEED_MPS - by_mps2 * slows_s
        return object_state(x_m=80.0 + way_m, speed_mps=speed, acceleration_mps2=slows)

    outcome, _ = careful_steps(braked, lambda t: ahead(t, 6.0))
    assert outcome.response_s == pytest.approx(1.02 + 1.15)
    assert is_defined(braked)
    gentle = Brake(kind="brake", to_mps=0.0, deceleration_mps2=4.0)
    brake = brake.model_copy(update={"manoeuvre": gentle})
    assert not is_defined(run.model_copy(update={"triggers": [brake]}))


def test_the_careful_driver_perceives_who_leaves_its_lane_for_one_that_stands(
    run: RunSpec,
) -> None:
    (leaves,) = run.triggers
    stands = leaves.model_copy(update={"manoeuvre": Hold(kind="hold")})
    cut_out = run.model_copy(
        update={"triggers": [stands, leaves.model_copy(update={"object_id": "ot2"})]}
    )
    assert is_defined(cut_out)
    assert not is_defined(run.model_copy(update={"triggers": [stands]}))

    def leaving(t_s: float) -> ObjectState:
        aside_m = min(max(t_s - 1.0, 0.0), 3.5)
        return object_state("ot2", x_m=80.0 + 10.0 * t_s, y_m=aside_m, speed_mps=10.0)

    standing = object_state(x_m=120.0)
    reports = [report(t, object_state("vut"), standing, leaving(t)) for t in times(8.0)]
    outcome, steps = careful_motion(start_of(cut_out, 8.0), Record(reports))
    assert outcome.kind == "avoided"
    assert outcome.response_s == pytest.approx(1.38 + 0.4 + 0.75)
    # It is in the VUT's lane from the beginning, which is no cut-in: 0.774 g, not 0.85 g.
    assert max(decelerations(steps).values()) == pytest.approx(0.774 * 9.80665)


def test_the_careful_driver_collides_where_it_is_too_late(run: RunSpec) -> None:
    outcome, _ = careful_steps(run, lambda t: replace(cutting_in(t), x_m=82.0))
    assert outcome.kind == "collision"
    assert outcome.contact.relative_mps > 0.0


def test_objects_that_are_not_known_up_to_the_end_leave_no_verdict(run: RunSpec) -> None:
    reports = [report(t, object_state("vut"), cutting_in(t)) for t in times(5.0)]
    outcome, _ = careful_motion(start_of(run, 8.0), Record(reports))
    assert outcome.kind == "harness"


def test_the_careful_driver_is_not_defined_for_a_pedestrian(run: RunSpec) -> None:
    path = FollowPath.model_construct(kind="follow_path")
    walks = run.triggers[0].model_copy(update={"manoeuvre": path})
    assert is_defined(run)
    assert not is_defined(run.model_copy(update={"triggers": [walks]}))


# -- severity --------------------------------------------------------------------------------------


def facts(run: RunSpec, reports: list[StepReport], **changes: Any) -> Severity:
    driven = Driven(driver="aeb", first_request_s=0.0, hand_over_s=1.0, end_s=4.0, observable_s=1.5)
    values = {"result": _Passed(), "contact": None, "decided_s": 4.0, **changes}
    return severity_facts(run, driven, reports, **values)


class _Passed:
    """A result of which the passing alone is asked."""

    passing = Passing(other_arrival_s=1.5, own_arrival_s=3.0, time_gap_s=1.25)


def closing(t_s: float) -> StepReport:
    """The VUT at 10 m/s behind one at 6 m/s, whose bumper is 20 m ahead at t = 1 s."""
    vut = object_state("vut", x_m=50.0 + 10.0 * (t_s - 1.0), speed_mps=10.0)
    rear_m = 50.0 + vut.size.front_m + 20.0 + 6.0 * (t_s - 1.0)
    return report(t_s, vut, object_state(x_m=rear_m + vut.size.rear_m, speed_mps=6.0))


def test_ttc_distance_needed_deceleration_and_pet_are_those_of_method_8_8(run: RunSpec) -> None:
    found = facts(run, [closing(t) for t in times(4.0)])
    # The gap is 20 m - 4 m/s * 3 s at the end.
    assert found.ttc_s == pytest.approx(8.0 / 4.0)
    assert found.distance_m == pytest.approx(8.0)
    assert found.needed_mps2 == pytest.approx(4.0**2 / (2 * 8.0))
    assert found.pet_s == 1.25
    assert found.jerk_mps3 == 0.0


def test_nothing_counts_before_the_hand_over_or_behind_the_deciding_fact(run: RunSpec) -> None:
    found = facts(run, [closing(t) for t in times(4.0)], decided_s=2.0)
    assert (found.distance_m, found.pet_s) == (pytest.approx(16.0), None)
    near = report(0.5, object_state("vut", x_m=50.0), object_state(x_m=51.0))
    assert facts(run, [near, closing(2.0)]).distance_m == pytest.approx(16.0)


def test_an_object_beside_the_corridor_needs_no_deceleration(run: RunSpec) -> None:
    def beside(t_s: float) -> StepReport:
        base = closing(t_s)
        other = replace(base.truths[1], y_m=3.5)
        return replace(base, truths=(base.truths[0], other))

    found = facts(run, [beside(t) for t in times(4.0)])
    assert (found.ttc_s, found.needed_mps2) == (None, 0.0)


def test_objects_that_are_left_out_for_being_far_change_no_figure(run: RunSpec) -> None:
    """The short cut must give what asking of each object in each step gives."""
    rng = np.random.default_rng(8)
    reports = []
    for t in times(4.0):
        others = [
            object_state(
                f"ot{k}",
                x_m=50.0 + float(rng.uniform(-60, 120)),
                y_m=float(rng.uniform(-8, 8)),
                yaw_rad=float(rng.uniform(-math.pi, math.pi)),
                speed_mps=float(rng.uniform(0, 15)),
            )
            for k in range(3)
        ]
        reports.append(report(t, object_state("vut", x_m=50.0, speed_mps=10.0), *others))
    whole = facts(run, reports)
    single = [facts(run, [one]) for one in reports if one.now_ns > 1e9]
    assert whole.ttc_s == min(one.ttc_s for one in single if one.ttc_s is not None)
    assert whole.distance_m == min(one.distance_m or 0.0 for one in single)
    assert whole.needed_mps2 == max(one.needed_mps2 or 0.0 for one in single)


def test_jerk_is_the_largest_change_over_a_tenth_of_a_second(run: RunSpec) -> None:
    reports = [
        report(t, object_state("vut", acceleration_mps2=-4.0 if t >= 2.0 else 0.0))
        for t in times(4.0)
    ]
    assert facts(run, reports).jerk_mps3 == pytest.approx(40.0)


def test_successive_plans_are_compared_one_second_behind_the_frame_of_the_later(
    run: RunSpec,
) -> None:
    def plan(stamp_s: float, speed: float) -> DriveReport:
        t: FloatArray = np.linspace(0.0, 3.0, 31)
        zeros = np.zeros(31)
        columns = np.vstack([t, speed * (t + stamp_s), zeros, zeros, zeros + speed, zeros, zeros])
        reference = replace(
            make_reference(purpose="plan", execute_at_ns=seconds_to_ns(stamp_s)),
            points=Points(columns),
        )
        return DriveReport(DriveMode.PLAN, effective=reference)

    vut = object_state("vut")
    reports = [report(1.5, vut, drive=plan(1.4, 10.0)), report(2.5, vut, drive=plan(2.4, 9.0))]
    # At 3.4 s: 34 m by the first, 30.6 m by the second.
    assert facts(run, reports).replan_m == pytest.approx(3.4)


# -- texts -----------------------------------------------------------------------------------------


def answered(number: int, text: str, speed: float, slows_mps2: float) -> DriveReport:
    """An answer about the frame of 0.1 s · number, which is effective in its step."""
    t: FloatArray = np.linspace(0.0, 4.0, 41)
    v = np.maximum(speed - slows_mps2 * t, 0.0)
    zeros = np.zeros(41)
    reference = replace(
        make_reference(purpose="plan", execute_at_ns=round(1e8 * number)),
        reference_id=f"plan-{number}",
        points=Points(np.vstack([t, t, zeros, zeros, v, zeros, zeros])),
    )
    answer = EffectiveAnswer(number, round(1e8 * number), 0.0, Answer(None, text))
    return DriveReport(DriveMode.PLAN, effective_answer=answer, effective=reference)


def test_texts_are_kept_from_t_obs_on_with_what_their_own_plans_do(tmp_path: Path) -> None:
    driven = Driven(
        driver="mine", first_request_s=0.0, hand_over_s=1.0, end_s=9.0, observable_s=1.5
    )
    vut = object_state("vut")
    reports = [
        report(1.4, vut, drive=answered(14, "before T_obs", 10.0, 1.0)),
        report(1.5, vut, drive=answered(15, "I brake.", 10.0, 0.2)),
        report(1.6, vut, drive=answered(16, "  ", 10.0, 0.2)),
        # Its plan was refused: the one before it goes on, and no text is held against it.
        report(1.7, vut, drive=replace(answered(17, "refused", 10.0, 0.2), effective=None)),
        report(1.8, vut, drive=answered(18, "I stop.", 3.0, 2.0)),
        report(2.5, vut, drive=answered(25, "behind the contact", 10.0, 1.0)),
    ]
    kept = tuple(texts_of(driven, reports, decided_s=2.0))
    assert [one["text"] for one in kept] == ["I brake.", "I stop."]
    assert [one["stamp_s"] for one in kept] == [1.5, 1.8]
    # Within 2 s of the frame.
    assert [one["slows_mps"] for one in kept] == [0.4, 3.0]
    write_texts(tmp_path, 3, 2, [(), kept])
    lines = (tmp_path / "texts" / "000003.jsonl").read_text().splitlines()
    assert [json.loads(line)["row"] for line in lines] == [8, 8]
    write_texts(tmp_path, 4, 2, [(), ()])
    assert len(list((tmp_path / "texts").iterdir())) == 1
