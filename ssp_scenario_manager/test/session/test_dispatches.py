"""References of one run: what a trigger sends, what its object drives then, what answers mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Brake, ElapsedTime, FollowPath, Hold, TriggerSpec
from ssp_core.safety.codes import SafetyCode
from ssp_scenario_manager.dispatch.adaptation import MOST_REFUSED
from ssp_scenario_manager.dispatch.planned_motion import as_planned
from ssp_scenario_manager.session.dispatches import CannotFire, Dispatches
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.outbox import TriggerDecision
from ssp_scenario_manager.triggers.conditions import Sample
from ssp_scenario_manager.triggers.evaluator import Firing

MS = 1_000_000
S = 1_000_000_000
FIRED_NS, NOW_NS = 8 * S, 8 * S + 20 * MS
SAMPLES = (Sample(FIRED_NS - 20 * MS, 12.5), Sample(FIRED_NS, 11.5))
FIRING = Firing(FIRED_NS - 10 * MS, FIRED_NS, "gap vut - ot1 < 12 m", 12.0, SAMPLES)
BRAKE = Brake(kind="brake", to_mps=2.0, deceleration_mps2=4.0)
StateMaker = Callable[..., ObjectState]


def trigger_of(run: RunSpec, manoeuvre: Any) -> TriggerSpec:
    return run.triggers[0].model_copy(update={"manoeuvre": manoeuvre})


def fire(
    dispatches: Dispatches, trigger: TriggerSpec, state: ObjectState, now_ns: int = NOW_NS
) -> tuple[Reference, TriggerDecision]:
    reference, decision = dispatches.fire(trigger, FIRING, {"ot1": state}, now_ns)
    assert isinstance(reference, Reference)
    assert isinstance(decision, TriggerDecision)
    return reference, decision


def accept(dispatches: Dispatches, reference: Reference) -> None:
    assert dispatches.answer(reference.reference_id, True, 0, "", NOW_NS) is None


# -- what a trigger sends -------------------------------------------------------------------------


@pytest.mark.parametrize("holds", [True, False])
def test_the_decision_record_has_what_decided_and_which_reference_was_sent(
    run: RunSpec, state: StateMaker, holds: bool
) -> None:
    dispatches = Dispatches(run)
    (approach,) = dispatches.approaches(0)
    trigger = trigger_of(run, Hold(kind="hold") if holds else BRAKE)
    ot = state("ot1", stamp_ns=FIRED_NS, x_m=60.0, y_m=3.5, speed_mps=6.0)
    *facts, decision = dispatches.fire(trigger, FIRING, {"ot1": ot}, NOW_NS)
    references = [fact for fact in facts if isinstance(fact, Reference)]
    assert len(references) == (0 if holds else 1)
    assert decision == TriggerDecision(
        stamp_ns=FIRED_NS,
        trigger_id="gap",
        condition="gap vut - ot1 < 12 m",
        threshold=12.0,
        samples=SAMPLES,
        crossing_ns=FIRED_NS - 10 * MS,
        dispatched_ns=NOW_NS,
        object_ids=tuple(reference.object_id for reference in references),
        reference_ids=tuple(reference.reference_id for reference in references),
    )
    # An answer says by its id which reference it is to.
    assert approach.reference_id not in decision.reference_ids
    assert dispatches.due == (approach, *references)


def test_the_ids_of_all_references_of_a_run_differ(run: RunSpec, state: StateMaker) -> None:
    dispatches = Dispatches(run)
    (approach,) = dispatches.approaches(0)
    ot = state("ot1", stamp_ns=FIRED_NS, x_m=60.0, y_m=3.5, speed_mps=6.0)
    manoeuvres = [fire(dispatches, trigger_of(run, BRAKE), ot)[0] for _ in range(3)]
    assert len({reference.reference_id for reference in (approach, *manoeuvres)}) == 4


def test_an_object_that_has_taken_no_reference_leaves_from_where_it_is_as_the_trigger_fires(
    run: RunSpec, state: StateMaker
) -> None:
    dispatches = Dispatches(run)
    dispatches.approaches(0)
    earlier = state("ot1", stamp_ns=FIRED_NS - 200 * MS, x_m=60.0, y_m=3.5, speed_mps=6.0)
    reference, _ = fire(dispatches, trigger_of(run, BRAKE), earlier)
    first = reference.points[0]
    assert (first.x_m, first.y_m, first.speed_mps) == pytest.approx((61.2, 3.5, 6.0))


class Undecoded(dict[str, ObjectState]):
    """States of which it is known that they are there, and not what they say."""

    def __getitem__(self, object_id: str) -> ObjectState:
        raise AssertionError(f"the state of {object_id} is looked up")


def test_an_object_that_drives_a_reference_leaves_it_and_its_state_is_not_looked_up(
    run: RunSpec, state: StateMaker
) -> None:
    """A state may have to be decoded first, while the dispatch waits."""
    dispatches = Dispatches(run)
    (approach,) = dispatches.approaches(0)
    accept(dispatches, approach)
    states = Undecoded(ot1=state("ot1"))
    reference, _ = dispatches.fire(trigger_of(run, BRAKE), FIRING, states, NOW_NS)
    assert isinstance(reference, Reference)
    there = sample(approach, reference.execute_at_ns)
    first = reference.points[0]
    assert (first.x_m, first.speed_mps) == pytest.approx((there.x_m, there.speed_mps), abs=1e-6)


@pytest.mark.parametrize(
    ("is_heard", "has_approach", "why"),
    [
        (False, True, "^ot1 was never heard$"),
        (True, False, "^its manoeuvre can't be driven: ot1 has no approach"),
    ],
)
def test_a_trigger_that_can_send_nothing_says_why(
    run: RunSpec, state: StateMaker, is_heard: bool, has_approach: bool, why: str
) -> None:
    (target,) = run.targets
    if not has_approach:
        target = target.model_copy(update={"approach": None})
    dispatches = Dispatches(run.model_copy(update={"targets": [target]}))
    targets = {"ot1": state("ot1", stamp_ns=FIRED_NS)} if is_heard else {}
    with pytest.raises(CannotFire, match=why):
        dispatches.fire(trigger_of(run, BRAKE), FIRING, targets, NOW_NS)
    assert dispatches.due == ()


@pytest.mark.parametrize("field", ["x_m", "yaw_rad", "speed_mps", "yaw_rate_radps"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_target_whose_state_is_no_number_ends_the_run_for_that_as_its_trigger_fires(
    run: RunSpec, make_driver: Any, tools: Any, field: str, value: float
) -> None:
    """Its approach isn't answered yet, so that the manoeuvre would leave from that state."""
    elapsed = ElapsedTime(type="elapsed_time", after_s=0.03)
    trigger = run.triggers[0].model_copy(update={"condition": elapsed})
    driver = make_driver(run.model_copy(update={"triggers": [trigger]}))
    driver.until("RUNNING")
    driver.step()
    driver.now_ns += 20 * MS
    driver.session.on_vut_state(replace(driver.vut, stamp_ns=driver.now_ns))
    broken = replace(driver.targets["ot1"], stamp_ns=driver.now_ns - 5 * MS, **{field: value})
    driver.session.on_target_state(broken)
    driver.session.step(driver.now_ns)
    sent = driver.session.outbox
    assert tools.violations(sent)[0] is SafetyCode.STATE_NOT_FINITE
    purposes = [one.purpose for one in sent if isinstance(one, Reference)]
    assert purposes == ["approach"]


# -- what an object drives ------------------------------------------------------------------------


@pytest.mark.parametrize(("approach_ns", "turns_round"), [(0, False), (0, True), (NOW_NS, False)])
def test_an_object_drives_the_newest_reference_that_it_took_whenever_it_answers(
    run: RunSpec,
    state: StateMaker,
    monkeypatch: pytest.MonkeyPatch,
    approach_ns: int,
    turns_round: bool,
) -> None:
    """Answers may overtake each other; two references may be of one instant."""
    dispatches = Dispatches(run)
    (approach,) = dispatches.approaches(approach_ns)
    motion = run.targets[0].approach
    ahead = FollowPath.model_validate({"kind": "follow_path", "motion": motion})
    manoeuvre, _ = fire(dispatches, trigger_of(run, ahead), state("ot1"))
    for reference in (manoeuvre, approach) if turns_round else (approach, manoeuvre):
        accept(dispatches, reference)
    before: list[Reference | None] = []
    monkeypatch.setattr(dispatches.adaptations, "fire", lambda *of: before.append(of[2]))
    fire(dispatches, trigger_of(run, ahead), state("ot1"), NOW_NS + S)
    assert before == [manoeuvre]


# -- adapted manoeuvres ---------------------------------------------------------------------------


def adapted_manoeuvre(answers: list[Any], refusals: int = 0) -> Any:
    """A manoeuvre that stands for a second, and writes down how its references are answered."""
    columns = np.zeros((7, 2))
    columns[0, 1] = 1.0
    return SimpleNamespace(
        target=SimpleNamespace(id="ot1"),
        planned_motion=SimpleNamespace(columns=columns),
        on_answer=lambda pace, accepted: answers.append((pace, accepted)),
        over="",
        played=SimpleNamespace(refused=refusals),
    )


def test_an_adapted_reference_takes_effect_when_its_pace_begins(run: RunSpec) -> None:
    pace = as_planned(NOW_NS + 150 * MS)
    reference = Dispatches(run).adapt(adapted_manoeuvre([]), pace, NOW_NS)
    assert (reference.object_id, reference.purpose) == ("ot1", "adapted")
    assert (reference.dispatched_ns, reference.execute_at_ns) == (NOW_NS, NOW_NS + 150 * MS)


@pytest.mark.parametrize(
    ("accepted", "code", "is_fatal"),
    [(True, 0, False), (False, 2, False), (False, 5, False), (False, 1, True), (False, 7, True)],
)
def test_only_a_refusal_with_which_an_object_can_not_go_on_ends_the_run(
    run: RunSpec, accepted: bool, code: int, is_fatal: bool
) -> None:
    """One that came too late (2), or doesn't follow since another was lost (5), does no harm."""
    dispatches = Dispatches(run)
    answers: list[Any] = []
    pace = as_planned(NOW_NS + 100 * MS)
    reference = dispatches.adapt(adapted_manoeuvre(answers), pace, NOW_NS)
    refusal = dispatches.answer(reference.reference_id, accepted, code, "why", NOW_NS + MS)
    fatal = Violation(SafetyCode.REFERENCE_REFUSED, "ot1", float(code), 0.0, NOW_NS + MS, "why")
    assert refusal == (fatal if is_fatal else None)
    assert answers == ([] if is_fatal else [(pace, accepted)])
    assert dispatches.due == ()


def test_an_adaptation_that_ends_by_refusals_tells_what_the_object_said(run: RunSpec) -> None:
    dispatches = Dispatches(run)
    manoeuvre = adapted_manoeuvre([], MOST_REFUSED)
    reference = dispatches.adapt(manoeuvre, as_planned(NOW_NS), NOW_NS)
    assert dispatches.answer(reference.reference_id, False, 2, "came 0.1 s late", NOW_NS) is None
    (note,) = dispatches.adaptations.take_notes()
    assert note.endswith(f"{reference.reference_id} was refused: came 0.1 s late")


@pytest.mark.parametrize("accepted", [True, False])
def test_an_adapted_reference_that_was_taken_settles_the_older_ones(
    run: RunSpec, accepted: bool
) -> None:
    dispatches, manoeuvre = Dispatches(run), adapted_manoeuvre([])
    old, new = (
        dispatches.adapt(manoeuvre, as_planned(at_ns + 100 * MS), at_ns)
        for at_ns in (NOW_NS, NOW_NS + 100 * MS)
    )
    dispatches.answer(new.reference_id, accepted, 0 if accepted else 2, "", NOW_NS + 120 * MS)
    assert dispatches.due == (() if accepted else (old,))
