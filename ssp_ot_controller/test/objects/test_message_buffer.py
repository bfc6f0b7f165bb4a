"""The order in which a step's messages are processed doesn't depend on that of their delivery."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cdr.steps import Heartbeat, WorldTick
from ssp_core.motion.reference import Reference
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.objects.messages import MessageBuffer

RUNNING, ARMED = SessionPhase.RUNNING, SessionPhase.ARMED


def tick(step: int, heartbeat: int, running: bool = True, lockstep: bool = True) -> WorldTick:
    return WorldTick(0, step, running, lockstep, heartbeat, 0)


def beat(sequence: int, session: SessionPhase, sent: dict[str, int]) -> Heartbeat:
    return Heartbeat(0, "manager", sequence, 0, session, sent)


def reference(name: str, object_id: str = "ot1") -> Reference:
    return Reference(name, object_id, "sha256:0", "approach", 0, 0, 1, ())


def names_of(buffer: MessageBuffer, object_id: str = "ot1") -> list[str]:
    return [r.reference_id for r in buffer.references(object_id)]


def test_a_tick_waits_for_the_heartbeat_that_it_names() -> None:
    buffer = MessageBuffer(["ot1"])
    buffer.on_tick(tick(1, heartbeat=2))
    assert buffer.take() is None
    assert copy.copy(buffer).take(overdue=True).step == 1  # its sender is dead
    buffer.on_heartbeat(beat(1, RUNNING, {"ot1": 0}))
    assert buffer.take() is None
    buffer.on_heartbeat(beat(2, RUNNING, {"ot1": 0}))
    taken = buffer.take()
    assert taken.step == 1
    assert buffer.take() is None  # once


def test_a_step_that_is_said_again_while_the_world_holds_is_dealt_with_once() -> None:
    """A driver's model is waited for: everybody else has answered."""
    buffer = MessageBuffer(["ot1"])
    for step in (4, 5):
        buffer.on_heartbeat(beat(step, RUNNING, {"ot1": 0}))
        buffer.on_tick(tick(step, heartbeat=step))
        taken = buffer.take()
        assert taken is not None
        assert taken.step == step
        for _ in range(3):
            buffer.on_tick(tick(step, heartbeat=step))
            assert buffer.take(overdue=True) is None
    # Before a run the first step comes again and again, each time with what was heard since.
    for _ in range(2):
        buffer.on_tick(tick(0, heartbeat=5, running=False))
        assert buffer.take() is not None


def test_a_tick_waits_for_the_references_that_its_heartbeat_counts() -> None:
    buffer = MessageBuffer(["ot1", "ot2"])
    buffer.on_heartbeat(beat(1, RUNNING, {"ot1": 1, "ot2": 2, "somebody": 5}))
    buffer.on_tick(tick(1, heartbeat=1))
    for object_id in ("ot1", "ot2", "elsewhere"):
        buffer.on_reference(reference("r", object_id))
        assert buffer.take() is None
    buffer.on_reference(reference("r2", "ot2"))
    assert buffer.take() is not None
    assert names_of(buffer, "ot2") == ["r", "r2"]
    assert names_of(buffer, "ot2") == []


def test_a_later_heartbeat_does_not_stand_in_for_what_the_named_one_counts() -> None:
    """Beat 2 counts a reference that belongs to the next step: step 1 needs not wait for it."""
    buffer = MessageBuffer(["ot1"])
    buffer.on_heartbeat(beat(1, RUNNING, {"ot1": 0}))
    buffer.on_heartbeat(beat(2, RUNNING, {"ot1": 1}))
    buffer.on_tick(tick(1, heartbeat=1))
    assert buffer.take() is not None
    assert [b.sequence for b in buffer.heartbeats(1, holding=False)] == [1]
    buffer.on_tick(tick(2, heartbeat=2))
    assert buffer.take() is None
    buffer.on_reference(reference("r"))
    assert buffer.take() is not None


def test_nothing_is_held_back_outside_lockstep_or_while_holding() -> None:
    for one in (tick(0, 9, running=False), tick(5, 9, lockstep=False)):
        buffer = MessageBuffer(["ot1"])
        buffer.on_tick(one)
        assert buffer.take() is one


def test_the_newest_tick_replaces_a_held_one() -> None:
    """The world goes on without an object that doesn't answer."""
    buffer = MessageBuffer(["ot1"])
    buffer.on_tick(tick(1, heartbeat=1))
    buffer.on_tick(tick(2, heartbeat=0))
    assert buffer.take().step == 2


def test_a_start_is_left_for_the_first_step() -> None:
    buffer = MessageBuffer(["ot1"])
    for sequence, session in enumerate((ARMED, ARMED, RUNNING, RUNNING), start=1):
        buffer.on_heartbeat(beat(sequence, session, {}))
    assert [b.sequence for b in buffer.heartbeats(None, holding=True)] == [1, 2]
    assert buffer.heartbeats(None, holding=True) == []
    assert [b.sequence for b in buffer.heartbeats(3, holding=False)] == [3]
    assert [b.sequence for b in buffer.heartbeats(None, holding=False)] == [4]


# -- any interleaving -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Dealt:
    """The actions of a node on one tick."""

    step: int
    beats: tuple[int, ...]
    references: tuple[str, ...]


def play(script: list[list[str]], choose: Any) -> list[Dealt]:
    """One run of world, manager and target over three topics that are ordered each in itself.

    The manager sends the references of a step, then its heartbeat; the world then publishes the
    next tick, which names that heartbeat. ``choose(n)`` picks the topic that delivers next.
    """
    buffer = MessageBuffer(["ot1"])
    done: list[Dealt] = []
    topics: dict[str, list[Any]] = {"references": [], "beats": [], "ticks": []}
    sent = 0
    for step, names in enumerate(script, start=1):
        for name in names:
            sent += 1
            topics["references"].append(reference(name))
        topics["beats"].append(beat(step, RUNNING, {"ot1": sent}))
        topics["ticks"].append(tick(step, heartbeat=step))
        # Deliver until the target has answered this step; the world waits for that.
        while not done or done[-1].step < step:
            waiting = [name for name in topics if topics[name]]
            name = waiting[choose(len(waiting))]
            message = topics[name].pop(0)
            if name == "references":
                buffer.on_reference(message)
            elif name == "beats":
                buffer.on_heartbeat(message)
            else:
                buffer.on_tick(message)
            taken = buffer.take()
            if taken is not None:
                beats = buffer.heartbeats(taken.heartbeat, holding=False)
                done.append(
                    Dealt(taken.step, tuple(b.sequence for b in beats), tuple(names_of(buffer)))
                )
    return done


@settings(max_examples=100, deadline=None)
@given(
    script=st.lists(st.lists(st.sampled_from("abc"), max_size=3), min_size=1, max_size=5),
    data=st.data(),
)
def test_every_interleaving_gives_the_same_order(script: list[list[str]], data: Any) -> None:
    expected = [Dealt(k, (k,), tuple(names)) for k, names in enumerate(script, start=1)]
    assert play(script, lambda n: 0) == expected
    assert play(script, lambda n: n - 1) == expected
    assert play(script, lambda n: data.draw(st.integers(0, n - 1))) == expected
