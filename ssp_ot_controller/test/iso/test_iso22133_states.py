"""Every pair of states, and of state and message, against expectations of its own."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.iso22133.messages import CentreStatus, ObjectCommand
from ssp_ot_controller.bodies.iso22133.states import (
    AFTER,
    STATUS_OF,
    Fit,
    Stimulus,
    after,
    fit,
    session_of,
    state_of,
)
from ssp_ot_controller.objects.state_machine import TABLE, ObjectEvent

# A row for each session state; + agrees, . may lead there, - contradicts. The last column is a
# state that isn't known.
COLUMNS = [
    "OFF",
    "INIT",
    "DISARMED",
    "PRE_ARMING",
    "ARMED",
    "PRE_RUNNING",
    "RUNNING",
    "POSTRUN",
    "REMOTE_CONTROLLED",
    "ABORTING",
    None,
]
FITS = """
UNKNOWN    - - - - - - - - - - -
IDLE       + + + . . - - . - . -
LOADED     + + + . . - - . - . -
CONNECTED  - . + . . - - - - - -
ARMED      - - . . + - - - - - -
RUNNING    - - - - . . + - - - -
STOPPING   - - + - . . . + - - -
FINISHED   - - + - . - - + - - -
ABORTING   + + . . . . . . . + -
ABORTED    + + . - - - - . - + -
"""
MARKS = {"+": Fit.AGREES, ".": Fit.COMES, "-": Fit.CONTRADICTS}
PAIRS = [
    (SessionPhase[line.split()[0]], ControlState[name] if name else None, MARKS[mark])
    for line in FITS.strip().splitlines()
    for name, mark in zip(COLUMNS, line.split()[1:], strict=True)
]


def named(value: object) -> str:
    return str(getattr(value, "name", value))


@pytest.mark.parametrize(("session", "state", "expected"), PAIRS, ids=named)
def test_every_pair_of_states(
    session: SessionPhase, state: ControlState | None, expected: Fit
) -> None:
    assert fit(session, state) is expected


def test_the_pairs_are_all_there_are() -> None:
    states = [*ControlState, None]
    assert {(a, b) for a, b, _ in PAIRS} == {(a, b) for a in SessionPhase for b in states}


def test_an_object_agrees_to_run_only_while_the_session_runs() -> None:
    agreeing = {
        session for session in SessionPhase if fit(session, ControlState.RUNNING) is Fit.AGREES
    }
    assert agreeing == {SessionPhase.RUNNING}
    for session in (SessionPhase.FINISHED, SessionPhase.ABORTED, SessionPhase.CONNECTED):
        assert fit(session, ControlState.RUNNING) is Fit.CONTRADICTS


def test_the_heartbeat_of_every_session_state() -> None:
    assert {session.name: status.name for session, status in STATUS_OF.items()} == {
        "UNKNOWN": "ABORT",
        "IDLE": "INIT",
        "LOADED": "INIT",
        "CONNECTED": "READY",
        "ARMED": "READY",
        "RUNNING": "RUNNING",
        "STOPPING": "NORMAL_STOP",
        "FINISHED": "TEST_DONE",
        "ABORTING": "ABORT",
        "ABORTED": "ABORT",
    }
    assert set(STATUS_OF) == set(SessionPhase)


def test_states_are_read_by_their_numbers() -> None:
    for state in ControlState:
        assert state_of(state.value) is state
    for number in (None, -1, 10, 42, 255):
        assert state_of(number) is None


# -- a conforming object --------------------------------------------------------------------------

MOVES = """
OFF ON INIT
INIT CONNECTED DISARMED
INIT DISCONNECTED INIT
DISARMED ARM PRE_ARMING
DISARMED REMOTE_CONTROL REMOTE_CONTROLLED
DISARMED DISCONNECTED INIT
DISARMED ABORT ABORTING
PRE_ARMING ARM_DONE ARMED
PRE_ARMING DISCONNECTED INIT
PRE_ARMING ABORT ABORTING
ARMED DISARM DISARMED
ARMED FAULT DISARMED
ARMED START PRE_RUNNING
ARMED DISCONNECTED INIT
ARMED ABORT ABORTING
PRE_RUNNING START_DONE RUNNING
PRE_RUNNING DISCONNECTED INIT
PRE_RUNNING ABORT ABORTING
RUNNING NORMAL_STOP POSTRUN
RUNNING TEST_DONE POSTRUN
RUNNING DISCONNECTED INIT
RUNNING ABORT ABORTING
POSTRUN STANDSTILL DISARMED
POSTRUN DISCONNECTED INIT
POSTRUN ABORT ABORTING
REMOTE_CONTROLLED DISARM DISARMED
REMOTE_CONTROLLED DISCONNECTED INIT
REMOTE_CONTROLLED ABORT ABORTING
ABORTING ALL_CLEAR DISARMED
ABORTING DISCONNECTED INIT
ABORTING ABORT ABORTING
"""
LEGAL = {
    (ControlState[a], Stimulus[e]): ControlState[b]
    for a, e, b in (line.split() for line in MOVES.strip().splitlines())
}


@pytest.mark.parametrize("state", ControlState, ids=named)
@pytest.mark.parametrize("stimulus", Stimulus, ids=named)
def test_every_stimulus_in_every_state(state: ControlState, stimulus: Stimulus) -> None:
    assert after(state, stimulus) is LEGAL.get((state, stimulus), state)
    assert (stimulus in AFTER[state]) is ((state, stimulus) in LEGAL)


def test_commands_have_the_names_that_our_object_knows() -> None:
    ours = {command.name for command in ObjectCommand if command.name in ObjectEvent.__members__}
    assert ours == {"ARM", "DISARM", "ALL_CLEAR"}
    assert {command.name for command in ObjectCommand} <= set(Stimulus.__members__)


def test_where_our_object_differs_it_is_the_more_careful_one() -> None:
    same = {"ARM": "ARM", "DISARM": "DISARM", "ALL_CLEAR": "ALL_CLEAR", "ABORT": "ABORT"}
    same |= {"NORMAL_STOP": "STOP", "TEST_DONE": "STOP", "DISCONNECTED": "LOCAL_STOP"}
    differ = {
        (state.name, stimulus.name, ours.name, after(state, stimulus).name)
        for state in ControlState
        for stimulus in Stimulus
        if stimulus.name in same
        and (ours := TABLE[state].get(ObjectEvent[same[stimulus.name]], state))
        is not after(state, stimulus)
    }
    stops = {(n, d, t) for n, s, d, t in differ if s in ("ABORT", "DISCONNECTED")}
    assert {ours for _, ours, _ in stops} == {"ABORTING"}
    assert {row for row in differ if row[1] not in ("ABORT", "DISCONNECTED")} == {
        ("PRE_ARMING", "DISARM", "DISARMED", "PRE_ARMING"),
        # A state that our object doesn't enter.
        ("REMOTE_CONTROLLED", "DISARM", "REMOTE_CONTROLLED", "DISARMED"),
    }


# -- our object under another centre --------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "waiting", "started"),
    [
        ("INIT", "CONNECTED", "ABORTING"),
        ("READY", "ARMED", "RUNNING"),
        ("ABORT", "ABORTING", "ABORTING"),
        ("RUNNING", "ARMED", "RUNNING"),
        ("TEST_DONE", "FINISHED", "STOPPING"),
        ("NORMAL_STOP", "STOPPING", "STOPPING"),
    ],
)
def test_what_a_heartbeat_means(status: str, waiting: str, started: str) -> None:
    number = CentreStatus[status]
    assert session_of(number, started=False) is SessionPhase[waiting]
    assert session_of(number, started=True) is SessionPhase[started]


@given(st.integers(), st.booleans())
def test_no_heartbeat_starts_an_object_and_unknown_ones_stop_it(status: int, started: bool) -> None:
    session = session_of(status, started)
    if not started:
        assert session is not SessionPhase.RUNNING
    if status not in set(CentreStatus):
        assert session is SessionPhase.ABORTING


@pytest.mark.parametrize("session", SessionPhase, ids=named)
def test_a_session_over_the_wire_stops_where_it_stops(session: SessionPhase) -> None:
    """Our gateway drives our object: nothing that ends motion is lost in translation."""
    heard = session_of(STATUS_OF[session], started=True)
    wanted = {
        SessionPhase.RUNNING: {SessionPhase.RUNNING},
        SessionPhase.STOPPING: {SessionPhase.STOPPING},
        SessionPhase.FINISHED: {SessionPhase.STOPPING},
        SessionPhase.CONNECTED: {SessionPhase.RUNNING},
        SessionPhase.ARMED: {SessionPhase.RUNNING},
    }
    assert heard in wanted.get(session, {SessionPhase.ABORTING})
