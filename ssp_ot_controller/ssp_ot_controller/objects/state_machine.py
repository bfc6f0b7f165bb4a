"""The object's state machine after ISO 22133, as one table.

Everything that changes an object's control state goes through ``transition``. PRE_RUNNING and
REMOTE_CONTROLLED are states of the standard that our objects don't enter; they stand in the table
because abort must be legal wherever an object may be.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ssp_core.errors import PeerError
from ssp_core.safety.liveness import ARMING_SHARE
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.body import BodyCheck
from ssp_ot_controller.objects.rules import Rules


class ObjectEvent(IntEnum):
    """Commands by the numbers of ObjectCommand.srv; from 100 on what the object itself notices."""

    CONNECT = 1
    ARM = 2
    DISARM = 3
    START = 4
    STOP = 5
    ABORT = 6
    ALL_CLEAR = 7
    INIT_DONE = 100
    PRE_ARM_DONE = 101
    STANDSTILL = 102
    RUN_DONE = 103
    LOCAL_STOP = 104


class IllegalTransition(PeerError):
    """An event that the present state doesn't know. The state is as it was."""

    def __init__(self, state: ControlState, event: ObjectEvent) -> None:
        self.state = state
        self.event = event
        event_names = ", ".join(e.name for e in TABLE[state])
        super().__init__(f"{event.name} is not possible in {state.name} (possible: {event_names})")


_ALWAYS: dict[ObjectEvent, ControlState] = {
    ObjectEvent.ABORT: ControlState.ABORTING,
    ObjectEvent.LOCAL_STOP: ControlState.ABORTING,
}

TABLE: dict[ControlState, dict[ObjectEvent, ControlState]] = {
    ControlState.OFF: {ObjectEvent.CONNECT: ControlState.INIT, **_ALWAYS},
    ControlState.INIT: {ObjectEvent.INIT_DONE: ControlState.DISARMED, **_ALWAYS},
    ControlState.DISARMED: {
        ObjectEvent.CONNECT: ControlState.INIT,
        ObjectEvent.ARM: ControlState.PRE_ARMING,
        **_ALWAYS,
    },
    ControlState.PRE_ARMING: {
        ObjectEvent.PRE_ARM_DONE: ControlState.ARMED,
        ObjectEvent.DISARM: ControlState.DISARMED,
        **_ALWAYS,
    },
    ControlState.ARMED: {
        ObjectEvent.START: ControlState.RUNNING,
        ObjectEvent.DISARM: ControlState.DISARMED,
        **_ALWAYS,
    },
    ControlState.PRE_RUNNING: dict(_ALWAYS),
    ControlState.RUNNING: {
        ObjectEvent.STOP: ControlState.POSTRUN,
        ObjectEvent.RUN_DONE: ControlState.POSTRUN,
        **_ALWAYS,
    },
    ControlState.POSTRUN: {ObjectEvent.STANDSTILL: ControlState.DISARMED, **_ALWAYS},
    ControlState.REMOTE_CONTROLLED: dict(_ALWAYS),
    ControlState.ABORTING: {
        ObjectEvent.ALL_CLEAR: ControlState.DISARMED,
        ObjectEvent.STANDSTILL: ControlState.ABORTING,
        **_ALWAYS,
    },
}


def transition(state: ControlState, event: ObjectEvent) -> ControlState:
    """Return the state after an event.

    Raises:
        IllegalTransition: the table has no such pair.
    """
    try:
        return TABLE[state][event]
    except KeyError:
        raise IllegalTransition(state, event) from None


# Numbers of ObjectCommand.srv. What is refused with one of the last two stays refused as long as
# the object's process runs.
REFUSED_TRANSITION = 1
REFUSED_CONDITION = 2
REFUSED_VERSION = 3
REFUSED_SESSION = 4
REFUSED_LASTING = 5
# What the manager may ask for; the other events are for the object itself to notice.
COMMANDS = frozenset(
    {
        ObjectEvent.CONNECT,
        ObjectEvent.ARM,
        ObjectEvent.DISARM,
        ObjectEvent.START,
        ObjectEvent.STOP,
        ObjectEvent.ABORT,
        ObjectEvent.ALL_CLEAR,
    }
)


@dataclass(frozen=True, slots=True)
class CommandResponse:
    """Answer to a command of the manager (ObjectCommand.srv)."""

    accepted: bool
    error_code: int = 0
    error_msg: str = ""


def cannot_arm(
    run: Rules, event_version: str, heartbeat_age_s: float, other_managers: int, body: BodyCheck
) -> CommandResponse | None:
    """Return all reasons for which an object can't be armed, None where there are none.

    Args:
        run: gives the K* version and the limits of the object.
        event_version: K* version of the manager's run.
        heartbeat_age_s: since the manager's last heartbeat, inf before the first. Half of the limit
            that stops a driving object is allowed, so that no object is armed that stops next.
        other_managers: how many managers beside ours send heartbeats.
        body: what a body with a control state of its own is found to be.
    """
    ours, limit_s = run.event_version, ARMING_SHARE * run.limits.heartbeat_s
    reasons = []
    code = REFUSED_LASTING if body.lasting else REFUSED_CONDITION
    if event_version != ours:
        code = REFUSED_VERSION
        reasons.append(
            f"this object has K* version {ours[:19]}..., the manager {event_version[:19]}..."
        )
    if not heartbeat_age_s <= limit_s:
        silent_s = f"{heartbeat_age_s:.2g} s, limit {limit_s:g} s"
        reasons.append(f"no heartbeat of the manager for {silent_s}")
    if other_managers:
        reasons.append(f"{other_managers} other manager(s) send heartbeats too")
    reasons += body.cannot_arm
    return CommandResponse(False, code, "; ".join(reasons)) if reasons else None


def other_rules(ours: str, compared: str) -> CommandResponse | None:
    """Refuse arming by a manager that knows other rules of the object; None: it knows these.

    Args:
        ours: digest of what the object judges by.
        compared: of what its manager has found to agree with its own; empty: nothing.
    """
    if compared == ours:
        return None
    knowledge = f"knows {compared[:19]}..." if compared else "doesn't say what it knows"
    text = f"this object judges by the rules {ours[:19]}..., the manager {knowledge}"
    return CommandResponse(False, REFUSED_VERSION, text)
