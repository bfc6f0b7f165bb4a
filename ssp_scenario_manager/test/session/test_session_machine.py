"""The session's table: every state with every event against what is expected of it."""

from __future__ import annotations

import pytest

from ssp_core.names import SESSION_COMMANDS
from ssp_core.vocabulary import SessionPhase
from ssp_scenario_manager.session.state_machine import (
    IllegalTransition,
    SessionEvent,
    next_state,
)

# Written down independently: state, then event -> state for each event that it knows.
EXPECTED = """
IDLE       load:LOADED abort:ABORTING
LOADED     load:LOADED connect:CONNECTED reset:IDLE abort:ABORTING
CONNECTED  arm:ARMED reset:IDLE abort:ABORTING
ARMED      disarm:CONNECTED arm_failed:CONNECTED start:RUNNING abort:ABORTING
RUNNING    stop:STOPPING complete:STOPPING abort:ABORTING
STOPPING   standstill:FINISHED abort:ABORTING
FINISHED   reset:IDLE abort:ABORTING
ABORTING   standstill:ABORTED abort:ABORTING
ABORTED    all_clear:IDLE abort:ABORTED
"""
ALLOWED = {
    SessionPhase[line.split()[0]]: {
        SessionEvent(pair.split(":")[0]): SessionPhase[pair.split(":")[1]]
        for pair in line.split()[1:]
    }
    for line in EXPECTED.strip().splitlines()
}


@pytest.mark.parametrize("event", SessionEvent)
@pytest.mark.parametrize("state", SessionPhase)
def test_every_pair(state: SessionPhase, event: SessionEvent) -> None:
    expected = ALLOWED.get(state, {}).get(event)
    if expected is not None:
        assert next_state(state, event) is expected
        return
    with pytest.raises(IllegalTransition) as caught:
        next_state(state, event)
    assert event.value in str(caught.value)
    assert state.name in str(caught.value)
    for possible in ALLOWED.get(state, {}):
        assert possible.value in str(caught.value)


def test_every_command_has_an_event() -> None:
    assert {SessionEvent(name) for name in SESSION_COMMANDS} | {SessionEvent.LOAD} == {
        e for e in SessionEvent if e.value not in ("complete", "arm_failed", "standstill")
    }
