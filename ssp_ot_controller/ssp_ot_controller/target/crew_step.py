"""What goes into a step of the objects of one process, and what comes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssp_core.motion.state import ObjectState
from ssp_ot_controller.core.bodies import Command
from ssp_ot_controller.core.local_safety import StopNow
from ssp_ot_controller.core.reference_check import Refusal
from ssp_ot_controller.sil.fault_schedule import FaultChange


@dataclass(frozen=True, slots=True)
class Tick:
    """One step of the world, or one reading of the bodies (WorldTick.msg).

    Args:
        step: of the world, counted from 0.
        now_ns: session time.
        running: False while the world holds at step 0.
        lockstep: True: watchdogs count session time.
        heartbeat: sequence of the manager's last heartbeat before this step.
        truths: true states of objects, by id; those of others are not looked at.
        vut_states_sent: states of the VUT sent so far; in lockstep they are waited for.
    """

    step: int
    now_ns: int
    running: bool
    lockstep: bool
    heartbeat: int
    truths: Mapping[str, ObjectState]
    vut_states_sent: int = 0

    @property
    def in_step(self) -> bool:
        """True when the world waits for the answer."""
        return self.lockstep and self.running


@dataclass(frozen=True, slots=True)
class Ack:
    """Answer to a reference (ReferenceAck.msg); no refusal is an acceptance.

    ``stamp_ns`` is on the object's own clock.
    """

    object_id: str
    reference_id: str
    refusal: Refusal | None
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Stopped:
    """An object stops by itself (SafetyEvent.msg)."""

    object_id: str
    stop: StopNow


@dataclass(frozen=True, slots=True)
class Counts:
    """What was sent so far (StepDone.msg)."""

    states: int = 0
    acks: int = 0
    safety_events: int = 0


@dataclass(frozen=True, slots=True)
class CrewStep:
    """What the objects of a process send for one step, each in the order of the object ids.

    Args:
        step: that is answered.
        now_ns: session time.
        answered: by StepDone; in lockstep, also while the world holds and wants to hear everybody.
        commands: for the bodies, by object id.
        states: those that arrive at the manager now.
        acks: answers to references that arrive at the manager now.
        events: objects that stop by themselves.
        counts: of what was sent, this step's included.
        faults: injected ones that begin or end with this step.
    """

    step: int
    now_ns: int
    answered: bool
    commands: tuple[tuple[str, Command], ...]
    states: tuple[ObjectState, ...]
    acks: tuple[Ack, ...]
    events: tuple[Stopped, ...]
    counts: Counts
    faults: tuple[FaultChange, ...] = ()
