"""Which references are still to be answered, and which are sent again."""

from __future__ import annotations

import pytest

from ssp_core.motion.reference import Reference
from ssp_scenario_manager.dispatch.references import PendingReferences, is_fatal

MS = 1_000_000


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
