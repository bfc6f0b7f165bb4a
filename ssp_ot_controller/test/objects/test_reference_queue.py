"""The reference that an object drives when references come twice, or faster than the link is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ssp_core.motion.reference import Reference
from ssp_ot_controller.objects.references import ReferenceQueue


def reference(name: str, execute_at_ns: int) -> Reference:
    return Reference(name, "ot1", "v", "adapted", 0, execute_at_ns, execute_at_ns + 1, ())


def test_a_waiting_reference_begins_though_a_newer_one_has_come() -> None:
    queue = ReferenceQueue()
    assert queue.is_empty
    first, second = reference("a", 100), reference("b", 150)
    queue.take(first)
    assert not queue.is_empty
    queue.take(second)
    assert not queue.advance(99)
    assert queue.advance(100)
    assert queue.current is first
    assert queue.before(150) is first
    assert queue.before(151) is second
    assert queue.advance(150)
    assert queue.current is second
    assert not queue.advance(151)


def test_a_newer_one_replaces_what_would_begin_then_or_later() -> None:
    queue = ReferenceQueue()
    for name, at in (("a", 100), ("b", 200), ("c", 200), ("d", 150)):
        queue.take(reference(name, at))
    queue.advance(1000)
    assert queue.current is not None
    assert queue.current.reference_id == "d"


def test_what_was_taken_once_is_known_until_all_is_forgotten() -> None:
    queue = ReferenceQueue()
    queue.take(reference("a", 100))
    queue.take(reference("b", 50))
    assert queue.has_accepted(reference("a", 100))
    assert not queue.has_accepted(reference("a", 101))
    assert not queue.has_accepted(reference("c", 100))
    queue.clear()
    assert not queue.has_accepted(reference("a", 100))
    assert queue.current is None
    assert not queue.advance(1000)


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 12)), max_size=30))
def test_at_any_time_the_last_sent_of_those_that_are_due_is_driven(
    sent: list[tuple[int, int]],
) -> None:
    """Sent in time order, each with a lead: nothing starves, nothing begins early."""
    queue, driven, held = ReferenceQueue(), None, {}
    messages = sorted((at, at + lead, i) for i, (at, lead) in enumerate(sent))
    for now in range(45):
        for at, execute, i in messages:
            if at == now:
                held = {e: name for e, name in held.items() if e < execute}
                held[execute] = str(i)
                queue.take(reference(str(i), execute))
        queue.advance(now)
        due = [e for e in held if e <= now]
        if due:
            driven = held[max(due)]
            held = {e: name for e, name in held.items() if e > now}
        current = queue.current
        assert (current.reference_id if current else None) == driven
