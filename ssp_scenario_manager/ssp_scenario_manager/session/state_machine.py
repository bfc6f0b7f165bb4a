"""The session's state machine: its table, the function that moves along it, answers to commands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ssp_core.safety.arming import ARM_FAILED
from ssp_core.vocabulary import SessionPhase


class SessionEvent(Enum):
    """The events that move a session. The first nine are commands, the others are observed."""

    LOAD = "load"
    CONNECT = "connect"
    ARM = "arm"
    DISARM = "disarm"
    START = "start"
    STOP = "stop"
    ABORT = "abort"
    ALL_CLEAR = "all_clear"
    RESET = "reset"
    COMPLETE = "complete"
    ARM_FAILED = ARM_FAILED
    STANDSTILL = "standstill"


# Said once in ABORTING, and moves nothing: nobody is left to report the standstill.
STANDSTILL_GIVEN_UP = "standstill_given_up"

S, E = SessionPhase, SessionEvent

# Abort is legal in every state; ABORTED is left by all_clear alone.
TABLE: dict[SessionPhase, dict[SessionEvent, SessionPhase]] = {
    S.IDLE: {E.LOAD: S.LOADED, E.ABORT: S.ABORTING},
    S.LOADED: {
        E.LOAD: S.LOADED,
        E.CONNECT: S.CONNECTED,
        E.RESET: S.IDLE,
        E.ABORT: S.ABORTING,
    },
    S.CONNECTED: {E.ARM: S.ARMED, E.RESET: S.IDLE, E.ABORT: S.ABORTING},
    S.ARMED: {
        E.DISARM: S.CONNECTED,
        E.ARM_FAILED: S.CONNECTED,
        E.START: S.RUNNING,
        E.ABORT: S.ABORTING,
    },
    S.RUNNING: {E.STOP: S.STOPPING, E.COMPLETE: S.STOPPING, E.ABORT: S.ABORTING},
    S.STOPPING: {E.STANDSTILL: S.FINISHED, E.ABORT: S.ABORTING},
    S.FINISHED: {E.RESET: S.IDLE, E.ABORT: S.ABORTING},
    S.ABORTING: {E.ABORT: S.ABORTING, E.STANDSTILL: S.ABORTED},
    S.ABORTED: {E.ABORT: S.ABORTED, E.ALL_CLEAR: S.IDLE},
}


class IllegalTransition(ValueError):
    """The event has no place in this state; nothing has happened."""


def next_state(state: SessionPhase, event: SessionEvent) -> SessionPhase:
    """Return the state after an event.

    Raises:
        IllegalTransition: the table has no such entry.
    """
    try:
        return TABLE[state][event]
    except KeyError:
        allowed = ", ".join(e.value for e in TABLE.get(state, {}))
        raise IllegalTransition(
            f"{event.value} is not possible in state {state.name}; possible are: {allowed}"
        ) from None


REFUSED_TRANSITION = 1
REFUSED_CONDITION = 2
REFUSED_SESSION = 3
REFUSED_OUTDATED = 4


@dataclass(frozen=True, slots=True)
class Answer:
    """A command's answer.

    Args:
        accepted: whether it has had its effect; a refused one has none.
        error_code: 0 when accepted, else REFUSED_*.
        error_msg: for people.
        missing: everything that keeps the command from being accepted.
        is_final: no waiting changes that.
    """

    accepted: bool
    error_code: int = 0
    error_msg: str = ""
    missing: tuple[str, ...] = ()
    is_final: bool = False
