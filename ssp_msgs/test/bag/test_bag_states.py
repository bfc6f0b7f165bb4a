"""States of objects out of a bag, whichever way they were sent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from tests.support.states import object_state

STATE, ARRAY = "ssp_msgs/msg/ObjectState", "ssp_msgs/msg/ObjectStates"
TEN_MS = 10_000_000


def state(name: str, sequence: int) -> ObjectState:
    moved = {"x_m": 1.5 * sequence, "speed_mps": 3.0}
    return object_state(name, stamp_ns=sequence * TEN_MS, sequence=sequence, **moved)


def write(folder: Path, messages: list[tuple[str, str, bytes]]) -> Path:
    path = folder / "run_1"
    with BagWriter(path) as writer:
        for topic, kind in dict.fromkeys((topic, kind) for topic, kind, _ in messages):
            writer.add_topic(topic, kind)
        for k, (topic, _, data) in enumerate(messages):
            writer.write(topic, data, k * TEN_MS, k * TEN_MS)
    return path


def array(*states: ObjectState) -> tuple[str, str, bytes]:
    data = encode_states(StateArray(states[-1].stamp_ns, "object_target", states))
    return "/ssp/object_states", ARRAY, data


def test_states_of_own_topics_and_of_arrays_come_in_the_order_of_recording(tmp_path: Path) -> None:
    a, b, stranger = state("a", 1), state("b", 1), state("stranger", 1)
    own = "/ssp/vut/state", STATE, encode_state(state("vut", 1))
    path = write(
        tmp_path,
        [array(a, b, stranger), own, array(replace(a, sequence=2), replace(b, sequence=2))],
    )
    with BagReader(path) as bag:
        found = object_states(bag, ["vut", "a", "b", "never"])
    assert found == {
        "vut": [state("vut", 1)],
        "a": [a, replace(a, sequence=2)],
        "b": [b, replace(b, sequence=2)],
        "never": [],
    }


def test_what_came_on_an_objects_topic_is_its_own_whatever_it_names(tmp_path: Path) -> None:
    path = write(tmp_path, [("/ssp/a/state", STATE, encode_state(state("b", 1)))])
    with BagReader(path) as bag:
        assert object_states(bag, ["a", "b"]) == {"a": [state("b", 1)], "b": []}


@pytest.mark.parametrize("in_one", [False, True])
def test_a_state_with_a_number_that_stands_for_nothing_is_named(
    tmp_path: Path, in_one: bool
) -> None:
    topic, kind, data = array(state("a", 1))
    if not in_one:
        topic, kind, data = "/ssp/a/state", STATE, encode_state(state("a", 1))
    at = data.index(b"a\0\1\2") + 2
    path = write(tmp_path, [(topic, kind, data[:at] + b"\x63" + data[at + 1 :])])
    with BagReader(path) as bag, pytest.raises(InputError, match="99") as raised:
        object_states(bag, ["a"])
    assert raised.value.field == topic
