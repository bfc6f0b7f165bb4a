"""References of a session: what they say, which are still to be answered, which are sent again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Brake, FollowPath, LaneChange, Motion
from ssp_scenario_manager.dispatch import references
from ssp_scenario_manager.dispatch.references import (
    Address,
    PendingReferences,
    approach_reference,
    is_fatal,
    manoeuvre_reference,
)

MS = 1_000_000
S = 1_000_000_000
StateMaker = Callable[..., ObjectState]
MOTION = Motion(path=[(40.0, 3.5), (250.0, 3.5)], cruise_mps=8.0)
BRAKE = Brake(kind="brake", to_mps=2.0, deceleration_mps2=4.0)
CHANGE = LaneChange(kind="lane_change", lateral_shift_m=-3.5, duration_s=2.5, cruise_mps=8.0)


def address(at_s: float, number: int = 1) -> Address:
    execute_at_ns = round(at_s * S)
    return Address(f"ot1-{number}", "ot1", "sha256:e", "manoeuvre", execute_at_ns, execute_at_ns)


@pytest.fixture
def approach() -> Reference:
    return approach_reference(address(0.0), MOTION)


def same_place(reference: Reference, before: Reference) -> None:
    """The new reference begins where the old one is at that time."""
    old, new = sample(before, reference.execute_at_ns), reference.points[0]
    assert (new.x_m, new.y_m) == pytest.approx((old.x_m, old.y_m), abs=1e-6)
    assert (new.yaw_rad, new.speed_mps) == pytest.approx((old.yaw_rad, old.speed_mps), abs=1e-6)


def test_an_object_brakes_along_its_path_from_where_it_will_be(
    state: StateMaker, approach: Reference
) -> None:
    # What was heard last is of no account: the object is where its reference says.
    heard = state("ot1", x_m=55.0, y_m=3.3, speed_mps=7.0)
    reference = manoeuvre_reference(address(8.0, 2), BRAKE, heard, approach, MOTION)
    same_place(reference, approach)
    t, x, y, yaw, v, a, _ = reference.columns
    assert y == pytest.approx(3.5)
    assert yaw == pytest.approx(0.0)
    assert v[t <= 0.05].max() == pytest.approx(8.0, abs=0.05)
    assert v[(t > 2.0) & (t < 10.0)] == pytest.approx(2.0)
    assert a.min() == pytest.approx(-4.0, abs=0.01)
    assert (x[-1], v[-1]) == pytest.approx((250.0, 0.0))
    assert (reference.execute_at_ns, reference.expires_at_ns) == (8 * S, 9 * S)


def test_braking_to_a_standstill_ends_there(state: StateMaker, approach: Reference) -> None:
    stop = BRAKE.model_copy(update={"to_mps": 0.0})
    reference = manoeuvre_reference(address(8.0), stop, state("ot1"), approach, MOTION)
    began = reference.points[0].x_m
    last = reference.points[-1]
    assert (last.x_m - began, last.speed_mps) == pytest.approx((8.0 + 1.6, 0.0))


def test_without_a_reference_it_brakes_from_the_state(state: StateMaker) -> None:
    heard = state("ot1", x_m=60.0, y_m=3.5, speed_mps=6.0)
    reference = manoeuvre_reference(address(8.0), BRAKE, heard, None, MOTION)
    first = reference.points[0]
    assert (first.x_m, first.y_m, first.speed_mps) == pytest.approx((60.0, 3.5, 6.0))


def test_after_a_lane_change_it_brakes_in_its_new_lane(
    state: StateMaker, approach: Reference
) -> None:
    changed = manoeuvre_reference(address(8.0), CHANGE, state("ot1"), approach, MOTION)
    assert changed.points[-1].y_m == pytest.approx(0.0)
    reference = manoeuvre_reference(address(12.0, 2), BRAKE, state("ot1"), changed, MOTION)
    same_place(reference, changed)
    assert reference.columns[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("at_s", "says"),
    [
        (9.25, "rad off its path"),  # in the middle of a lane change
        (0.0, "from a speed to a lower one"),  # stands
    ],
)
def test_a_braking_that_cannot_be_driven(
    state: StateMaker, approach: Reference, at_s: float, says: str
) -> None:
    current = approach
    if at_s:
        current = manoeuvre_reference(address(8.0), CHANGE, state("ot1"), approach, MOTION)
    with pytest.raises(ValueError, match=says):
        manoeuvre_reference(address(at_s, 2), BRAKE, state("ot1"), current, MOTION)


@pytest.mark.parametrize("manoeuvre", [BRAKE, CHANGE])
def test_an_object_without_an_approach_has_nothing_to_leave(
    state: StateMaker, manoeuvre: Any
) -> None:
    with pytest.raises(ValueError, match="ot1 has no approach"):
        manoeuvre_reference(address(1.0), manoeuvre, state("ot1"), None, None)


def test_a_path_of_its_own_starts_at_its_start(state: StateMaker) -> None:
    motion = Motion(path=[(1.0, 2.0), (1.0, 12.0)], cruise_mps=1.5)
    walk = FollowPath(kind="follow_path", motion=motion)
    reference = manoeuvre_reference(address(3.0), walk, replace(state("ot1")), None, None)
    first, last = reference.points[0], reference.points[-1]
    assert (first.x_m, first.y_m, first.speed_mps) == (1.0, 2.0, 0.0)
    assert (last.x_m, last.y_m, last.speed_mps) == pytest.approx((1.0, 12.0, 0.0))


def test_what_does_not_depend_on_the_object_is_planned_ahead(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = Motion(path=[(0.0, 7.0), (30.0, 7.25)], cruise_mps=3.0)
    target = run.targets[0].model_copy(update={"approach": motion})
    references.prepare(run.model_copy(update={"targets": [target]}))
    monkeypatch.setattr("ssp_core.motion.approach.drive_along", None)
    reference = approach_reference(address(0.0), motion)
    assert reference.points[-1].x_m == pytest.approx(30.0)
    assert reference.points[-1].y_m == pytest.approx(7.25)


def test_a_motion_that_cannot_be_driven_is_told_of_when_it_is_asked_for(run: RunSpec) -> None:
    motion = Motion(path=[(0.0, 8.0), (0.0, 8.0)], cruise_mps=3.0)
    with pytest.raises(ValueError, match=r"."):
        approach_reference(address(0.0), motion)
    stuck = run.targets[0].model_copy(update={"approach": motion})
    references.prepare(run.model_copy(update={"targets": [stuck]}))


def reference(name: str, at_ms: int, purpose: str = "adapted", who: str = "ot1") -> Reference:
    ns = at_ms * MS
    return Reference(name, who, "v", purpose, ns, ns + 100 * MS, ns + 1100 * MS, ())


def ids(found: tuple[Reference, ...] | list[Reference]) -> list[str]:
    return [r.reference_id for r in found]


def test_what_is_not_answered_is_sent_again_until_it_is() -> None:
    answers = PendingReferences()
    answers.expect(reference("a", 0, "manoeuvre"))
    assert answers.again(59 * MS, 0.02) == []
    assert ids(answers.again(60 * MS, 0.02)) == ["a"]
    assert answers.again(79 * MS, 0.02) == []
    assert ids(answers.again(80 * MS, 0.02)) == ["a"]  # there must be one before execute_at
    assert ids(answers.again(100 * MS, 0.02)) == ["a"]
    taken = answers.take("a", accepted=True)
    assert taken is not None
    assert answers.take("a", accepted=True) is None  # the answer to a copy
    assert answers.again(500 * MS, 0.02) == []
    assert answers.due == ()


def test_an_answer_needs_two_steps_of_the_world() -> None:
    answers = PendingReferences()
    answers.expect(reference("a", 0))
    assert answers.again(99 * MS, 0.05) == []
    assert answers.again(149 * MS, 0.05) == []


def test_of_adapted_ones_the_newest_is_sent_again_until_it_is_known_what_became_of_it() -> None:
    answers = PendingReferences()
    for i in range(3):
        answers.expect(reference(f"r{i}", 10 * i))
    answers.expect(reference("other", 0, who="ot2"))
    assert ids(answers.again(90 * MS, 0.02)) == ["r2", "other"]
    assert answers.again(149 * MS, 0.02) == []
    assert ids(answers.again(150 * MS, 0.02)) == ["r2", "other"]  # past execute_at, too
    answers.take("r2", accepted=False)
    assert ids(answers.again(210 * MS, 0.02)) == ["r1", "other"]
    assert ids(answers.due) == ["r0", "r1", "other"]


def test_a_newer_answer_settles_older_adapted_ones_of_the_same_object() -> None:
    answers = PendingReferences()
    answers.expect(reference("m", 0, "manoeuvre"))
    answers.expect(reference("a", 10))
    answers.expect(reference("b", 10, who="ot2"))
    answers.expect(reference("c", 20))
    answers.expect(reference("d", 30))
    answers.take("c", accepted=True)
    assert ids(answers.due) == ["m", "b", "d"]


def test_a_refusal_settles_nothing_else() -> None:
    answers = PendingReferences()
    answers.expect(reference("a", 10))
    answers.expect(reference("c", 20))
    answers.take("c", accepted=False)
    assert ids(answers.due) == ["a"]


@pytest.mark.parametrize("purpose", ["approach", "manoeuvre"])
def test_without_its_part_an_object_makes_no_event(purpose: str) -> None:
    assert all(is_fatal(reference("a", 0, purpose), code) for code in range(1, 10))


def test_an_object_that_gets_an_adapted_one_too_late_goes_on_with_what_it_took() -> None:
    harmless = [code for code in range(1, 10) if not is_fatal(reference("a", 0), code)]
    assert harmless == [2, 5]  # late, and discontinuous where one before it was lost
