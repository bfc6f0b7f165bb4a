"""Every (state, event) pair of the object's state machine against an expectation of its own."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.vocabulary import ControlState
from ssp_ot_controller.objects.state_machine import (
    TABLE,
    IllegalTransition,
    ObjectEvent,
    transition,
)

# Everything that is legal; a pair that isn't here must raise.
EXPECTED = """
OFF CONNECT INIT
INIT INIT_DONE DISARMED
DISARMED CONNECT INIT
DISARMED ARM PRE_ARMING
PRE_ARMING PRE_ARM_DONE ARMED
PRE_ARMING DISARM DISARMED
ARMED START RUNNING
ARMED DISARM DISARMED
RUNNING STOP POSTRUN
RUNNING RUN_DONE POSTRUN
POSTRUN STANDSTILL DISARMED
ABORTING ALL_CLEAR DISARMED
ABORTING STANDSTILL ABORTING
OFF ABORT ABORTING
INIT ABORT ABORTING
ARMED ABORT ABORTING
DISARMED ABORT ABORTING
RUNNING ABORT ABORTING
POSTRUN ABORT ABORTING
REMOTE_CONTROLLED ABORT ABORTING
ABORTING ABORT ABORTING
PRE_ARMING ABORT ABORTING
PRE_RUNNING ABORT ABORTING
OFF LOCAL_STOP ABORTING
INIT LOCAL_STOP ABORTING
ARMED LOCAL_STOP ABORTING
DISARMED LOCAL_STOP ABORTING
RUNNING LOCAL_STOP ABORTING
POSTRUN LOCAL_STOP ABORTING
REMOTE_CONTROLLED LOCAL_STOP ABORTING
ABORTING LOCAL_STOP ABORTING
PRE_ARMING LOCAL_STOP ABORTING
PRE_RUNNING LOCAL_STOP ABORTING
"""
LEGAL = {
    (ControlState[a], ObjectEvent[e]): ControlState[b]
    for a, e, b in (line.split() for line in EXPECTED.strip().splitlines())
}
PAIRS = [(s, e) for s in ControlState for e in ObjectEvent]


@pytest.mark.parametrize(("state", "event"), PAIRS, ids=lambda v: v.name)
def test_every_pair(state: ControlState, event: ObjectEvent) -> None:
    if (state, event) in LEGAL:
        assert transition(state, event) is LEGAL[state, event]
        return
    with pytest.raises(IllegalTransition) as caught:
        transition(state, event)
    assert (caught.value.state, caught.value.event) == (state, event)
    assert state.name in str(caught.value)
    assert event.name in str(caught.value)


def test_the_table_has_every_state_and_nothing_else_than_expected() -> None:
    assert set(TABLE) == set(ControlState)
    assert {(s, e): t for s, row in TABLE.items() for e, t in row.items()} == LEGAL


def test_command_numbers_are_those_of_the_service() -> None:
    names = ["CONNECT", "ARM", "DISARM", "START", "STOP", "ABORT", "ALL_CLEAR"]
    assert [ObjectEvent[n].value for n in names] == [1, 2, 3, 4, 5, 6, 7]


@given(st.lists(st.sampled_from(list(ObjectEvent)), max_size=30))
@settings(max_examples=100, deadline=None)
def test_after_an_abort_running_takes_all_clear_arm_and_start(events: list[ObjectEvent]) -> None:
    state = ControlState.ABORTING
    seen: list[ObjectEvent] = []
    for event in events:
        try:
            state = transition(state, event)
        except IllegalTransition:
            continue
        if event in (ObjectEvent.ABORT, ObjectEvent.LOCAL_STOP):
            seen = []
        seen.append(event)
        if state is ControlState.RUNNING:
            order = [ObjectEvent.ALL_CLEAR, ObjectEvent.ARM, ObjectEvent.START]
            places = [seen.index(e) for e in order]
            assert places == sorted(places)
