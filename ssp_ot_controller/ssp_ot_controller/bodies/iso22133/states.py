"""States of a session and of an object, and the messages that move them, as tables.

Numbers of states are those of ControlState. A gateway asks ``STATUS_OF`` what its heartbeat says,
``fit`` whether what an object reports suits the session, and a probe asks ``AFTER`` which state a
conforming object takes. An object of SSP that another centre drives asks ``session_of`` what that
centre's heartbeat means.
"""

from __future__ import annotations

from enum import Enum

from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.iso22133.messages import CentreStatus

C, P, H = ControlState, SessionPhase, CentreStatus

# -- the gateway's side ---------------------------------------------------------------------------

# A gateway that doesn't know its session tells objects to stop.
STATUS_OF: dict[SessionPhase, CentreStatus] = {
    P.UNKNOWN: H.ABORT,
    P.IDLE: H.INIT,
    P.LOADED: H.INIT,
    P.CONNECTED: H.READY,
    P.ARMED: H.READY,
    P.RUNNING: H.RUNNING,
    P.STOPPING: H.NORMAL_STOP,
    P.FINISHED: H.TEST_DONE,
    P.ABORTING: H.ABORT,
    P.ABORTED: H.ABORT,
}


class Fit(Enum):
    """The relation of an object's state to a session's."""

    AGREES = "agrees"
    # It may lead there by itself or by a message under way; for how long is a limit of the session.
    COMES = "comes"
    CONTRADICTS = "contradicts"


_NUMBERS = frozenset(ControlState)
_AT_REST = frozenset({C.OFF, C.INIT, C.DISARMED})
_BEFORE = _AT_REST | {C.PRE_ARMING, C.ARMED, C.POSTRUN, C.ABORTING}
# For each session state the states that agree, and those that may lead there.
_FITS: dict[SessionPhase, tuple[frozenset[ControlState], frozenset[ControlState]]] = {
    P.UNKNOWN: (frozenset(), frozenset()),
    P.IDLE: (_AT_REST, _BEFORE),
    P.LOADED: (_AT_REST, _BEFORE),
    P.CONNECTED: (frozenset({C.DISARMED}), frozenset({C.INIT, C.PRE_ARMING, C.ARMED})),
    P.ARMED: (frozenset({C.ARMED}), frozenset({C.DISARMED, C.PRE_ARMING})),
    P.RUNNING: (frozenset({C.RUNNING}), frozenset({C.ARMED, C.PRE_RUNNING})),
    P.STOPPING: (
        frozenset({C.POSTRUN, C.DISARMED}),
        frozenset({C.ARMED, C.PRE_RUNNING, C.RUNNING}),
    ),
    P.FINISHED: (frozenset({C.POSTRUN, C.DISARMED}), frozenset({C.ARMED})),
    # An object that doesn't hear the abort is found by its motion, not by its state.
    P.ABORTING: (frozenset({C.OFF, C.INIT, C.ABORTING}), frozenset(ControlState)),
    P.ABORTED: (frozenset({C.OFF, C.INIT, C.ABORTING}), frozenset({C.DISARMED, C.POSTRUN})),
}


def state_of(number: int | None) -> ControlState | None:
    """Return the state that a MONR reports; None: it is unavailable, or a number without a name."""
    return ControlState(number) if number in _NUMBERS else None


def state_text(number: int | None) -> str:
    """Return a reported state for people: its name, and its number as it came."""
    state = state_of(number)
    if state is not None:
        return f"{state.name} ({number})"
    return "no state" if number is None else f"{number} (no known state)"


def fit(session: SessionPhase, state: ControlState | None) -> Fit:
    """Tell how an object's state suits the session's; one that isn't known contradicts."""
    agree, come = _FITS[session]
    if state in agree:
        return Fit.AGREES
    return Fit.COMES if state in come else Fit.CONTRADICTS


# -- what a conforming object does ----------------------------------------------------------------


class Stimulus(Enum):
    """A stimulus of an object: messages, the connection, and from ON what it notices itself."""

    CONNECTED = "control centre connected"
    DISCONNECTED = "connection or heartbeats lost"
    ARM = "OSTM arm"
    DISARM = "OSTM disarm"
    REMOTE_CONTROL = "OSTM remote control"
    ALL_CLEAR = "OSTM all clear"
    START = "STRT, and its time has come"
    ABORT = "HEAB abort"
    NORMAL_STOP = "HEAB normal stop"
    TEST_DONE = "HEAB test done"
    ON = "switched on"
    ARM_DONE = "arming is done"
    START_DONE = "starting is done"
    STANDSTILL = "it stands"
    FAULT = "internal error"


S = Stimulus
_LOST = {S.DISCONNECTED: C.INIT}
_WATCHED = {S.ABORT: C.ABORTING, **_LOST}

# As the public object has it; what a state does not name changes nothing. SSP's own object
# differs on purpose: it also brakes in INIT and OFF, stops when it loses its centre, and can be
# disarmed while it arms.
AFTER: dict[ControlState, dict[Stimulus, ControlState]] = {
    C.OFF: {S.ON: C.INIT},
    C.INIT: {S.CONNECTED: C.DISARMED, **_LOST},
    C.DISARMED: {S.ARM: C.PRE_ARMING, S.REMOTE_CONTROL: C.REMOTE_CONTROLLED, **_WATCHED},
    C.PRE_ARMING: {S.ARM_DONE: C.ARMED, **_WATCHED},
    C.ARMED: {
        S.DISARM: C.DISARMED,
        S.FAULT: C.DISARMED,
        S.START: C.PRE_RUNNING,
        **_WATCHED,
    },
    C.PRE_RUNNING: {S.START_DONE: C.RUNNING, **_WATCHED},
    C.RUNNING: {S.NORMAL_STOP: C.POSTRUN, S.TEST_DONE: C.POSTRUN, **_WATCHED},
    C.POSTRUN: {S.STANDSTILL: C.DISARMED, **_WATCHED},
    C.REMOTE_CONTROLLED: {S.DISARM: C.DISARMED, **_WATCHED},
    C.ABORTING: {S.ALL_CLEAR: C.DISARMED, **_WATCHED},
}


def after(state: ControlState, stimulus: Stimulus) -> ControlState:
    """Return the state that a conforming object takes; its present one where nothing changes."""
    return AFTER[state].get(stimulus, state)


# -- the object's side ----------------------------------------------------------------------------

# What a centre's heartbeat means for an object that wasn't started, and for one that was. Only a
# STRT starts; a centre that has sent one may say READY for a while, but never INIT.
_SESSIONS: dict[CentreStatus, tuple[SessionPhase, SessionPhase]] = {
    H.INIT: (P.CONNECTED, P.ABORTING),
    H.READY: (P.ARMED, P.RUNNING),
    H.ABORT: (P.ABORTING, P.ABORTING),
    H.RUNNING: (P.ARMED, P.RUNNING),
    H.TEST_DONE: (P.FINISHED, P.STOPPING),
    H.NORMAL_STOP: (P.STOPPING, P.STOPPING),
}
_STATUSES = frozenset(CentreStatus)


def session_of(status: int, started: bool) -> SessionPhase:
    """Return the session's state that a heartbeat of another centre amounts to.

    Args:
        status: of the HEAB; a number without a name is taken for an abort.
        started: a STRT was obeyed since the object was armed.
    """
    if status not in _STATUSES:
        return P.ABORTING
    return _SESSIONS[CentreStatus(status)][started]
