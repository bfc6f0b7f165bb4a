"""The object targets of one process without ROS: messages and ticks in, a step's answers out.

This file owns the step that the objects are at, which messages wait for it, and what was sent so
far (``Counts``). Each ``Target`` owns what its object does, ``ManagerArbiter`` which manager is
obeyed. Messages are heard with the next tick, in one order, whatever the order of their arrival.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ssp_core.cdr.references import Acknowledgement
from ssp_core.cdr.steps import Heartbeat, WorldTick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState
from ssp_core.world.plant import LimitFact
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.objects.messages import (
    ManagerArbiter,
    MessageBuffer,
    NearbyObjects,
    in_step,
)
from ssp_ot_controller.objects.references import Refusal, RefusalCode
from ssp_ot_controller.objects.state_machine import (
    REFUSED_CONDITION,
    REFUSED_SESSION,
    CommandResponse,
    ObjectEvent,
)
from ssp_ot_controller.objects.target import Target
from ssp_ot_controller.sil.disturbance import Channel, FaultChange, LinkSizes


@dataclass(frozen=True, slots=True)
class ObjectStop:
    """An object stops by itself (SafetyEvent.msg)."""

    object_id: str
    stop: LimitViolation

    def fact(self, source: str, now_ns: int) -> LimitFact:
        """Make the fact that the node of that name reports."""
        stop = self.stop
        return LimitFact(
            stop.code, source, self.object_id, stop.measured, stop.limit, now_ns, stop.words
        )


@value_class(frozen=True, slots=True)
class Counts:
    """The counts of messages sent so far (StepDone.msg)."""

    states: int = 0
    acks: int = 0
    safety_events: int = 0


@value_class(frozen=True, slots=True)
class PoolStep:
    """The messages of a process's objects for one step, each in the order of the object ids.

    Args:
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
    acks: tuple[Acknowledgement, ...]
    events: tuple[ObjectStop, ...]
    counts: Counts
    faults: tuple[FaultChange, ...] = ()


# On the steady clock: without ticks there are no states to judge.
TICK_SILENCE_S = 1.0
# Lockstep: the world may take this long for a step (others may be dropped meanwhile).
WORLD_HANG_S = 12.0
# This process did not run where ``watch`` is not called for so long.
PAUSE_S = 0.25
# In lockstep: what belongs to a tick and hasn't come for so long after it is lost. Less than the
# world waits for an answer.
OVERDUE_S = 0.75
_MAY_MOVE = (
    ControlState.PRE_ARMING,
    ControlState.ARMED,
    ControlState.RUNNING,
    ControlState.POSTRUN,
)


_INACTIVE = Refusal(RefusalCode.STATE, "the node of this object is not active")


def _acknowledged(reference: Reference, refusal: Refusal | None, now_ns: int) -> Acknowledgement:
    """Return the answer to a reference, on the object's own clock; no refusal is an acceptance."""
    code, text = (int(refusal.code), refusal.message) if refusal else (0, "")
    return Acknowledgement(
        now_ns, reference.reference_id, reference.object_id, refusal is None, code, text
    )


class _Member:
    """One object with its localisation, its links and what it has heard."""

    def __init__(self, object_id: str, run: RunSpec) -> None:
        self.target = Target(object_id, run)
        self.channel = Channel(run, object_id)
        self.references: list[Reference] = []
        self.heartbeat_stamp_ns: int | None = None
        self.heartbeat_arrived_ns: int | None = None

    def hear(self, beats: Iterable[Heartbeat], steady_ns: int) -> None:
        for beat in beats:
            self.heartbeat_stamp_ns = beat.stamp_ns
            self.heartbeat_arrived_ns = steady_ns
            self.target.on_session_state(beat.session_state, beat.abort_id)

    def silence_s(self, steady_ns: int) -> float:
        """Return the time since the last heartbeat on the steady clock, inf before the first."""
        if self.heartbeat_arrived_ns is None:
            return float("inf")
        return ns_to_seconds(steady_ns - self.heartbeat_arrived_ns)

    def answer(self, now_ns: int, active: bool) -> list[Acknowledgement]:
        """Deal with the references that have come, on the object's own clock."""
        # While armed they wait for the start, which may be under way on another topic.
        if not self.references or self.target.state is ControlState.ARMED:
            return []
        references, self.references = self.references, []
        return [
            _acknowledged(r, self.target.on_reference(r, now_ns) if active else _INACTIVE, now_ns)
            for r in references
        ]


class ObjectPool:
    """The object targets of one process. Reads no clock; see the arguments of each method.

    Args:
        object_ids: which of its targets; all of them when empty.

    Attributes:
        active: False: nothing is armed or accepted, whatever comes.

    Raises:
        InputError: an id that is none of the run's targets.
    """

    def __init__(self, run: RunSpec, object_ids: Iterable[str] = (), steady_ns: int = 0) -> None:
        run_ids = [t.id for t in run.targets]
        requested_ids = list(object_ids)
        unknown = sorted(set(requested_ids) - set(run_ids))
        if unknown:
            raise InputError(
                "not in the run",
                field="parameter object_ids",
                value=", ".join(unknown),
                remedy=f"the run has {', '.join(run_ids)}",
            )
        self.object_ids = tuple(sorted(set(requested_ids or run_ids)))
        self._members = {i: _Member(i, run) for i in self.object_ids}
        self.active = True
        self._buffer = MessageBuffer(self.object_ids)
        self._arbiter = ManagerArbiter(run.limits.heartbeat_s, run.session_token, run.mode)
        self._nearby = NearbyObjects(run.limits)
        self._driven = run.driven is not None
        self._counts = Counts()
        self._now_ns = 0
        self._step = 0
        self._tick_arrived_ns = steady_ns
        self._watched_ns = steady_ns
        self._in_step = False
        for member in self._members.values():
            member.target.power_on()

    # -- what arrives --------------------------------------------------------------------------

    def take_heartbeat(self, beat: Heartbeat, steady_ns: int) -> None:
        """Take a heartbeat of a manager, which the objects hear with the next tick.

        Another sender than before is not obeyed, but stops us.
        """
        may_move = any(m.target.state in _MAY_MOVE for m in self._members.values())
        if self._arbiter.is_ours(
            beat.sender, beat.sequence, steady_ns, may_move=may_move, token=beat.session_token
        ):
            self._buffer.on_heartbeat(beat)

    def take_reference(self, reference: Reference) -> None:
        """Take a reference; ignore one for an object of another process."""
        self._buffer.on_reference(reference)

    def take_states(self, states: Iterable[ObjectState]) -> None:
        """Take states of others that are heard: the VUT's, and objects' of other processes."""
        for state in states:
            self._buffer.on_state(state)

    def take_tick(self, tick: WorldTick, steady_ns: int) -> None:
        """Take the newest tick, and when it came on the steady clock."""
        self._tick_arrived_ns = steady_ns
        self._in_step = in_step(tick)
        self._buffer.on_tick(tick)

    def command(
        self,
        object_id: str,
        event: ObjectEvent,
        event_version: str,
        steady_ns: int,
        session_token: str = "",
        abort_id: str = "",
    ) -> CommandResponse:
        """Pass a command of the manager to one object; an abort counts from any sender."""
        if event is not ObjectEvent.ABORT and (
            problem := self._arbiter.command_problem(session_token, steady_ns)
        ):
            return CommandResponse(False, REFUSED_SESSION, problem)
        if event is ObjectEvent.ALL_CLEAR:
            # Beats that came before this command must not abort the object again after it.
            beats = self._buffer.heartbeats(None, holding=False)
            for member in self._members.values():
                member.hear(beats, steady_ns)
        member = self._members[object_id]
        if not self.active and event is not ObjectEvent.ABORT:
            return CommandResponse(False, REFUSED_CONDITION, _INACTIVE.message)
        return member.target.command(
            event,
            event_version,
            member.silence_s(steady_ns),
            self._arbiter.strangers(steady_ns),
            abort_id,
        )

    def links_of(self, object_id: str) -> LinkSizes:
        """Return the clock and delays of an object's links as they are now."""
        return self._members[object_id].channel.links()

    def target_of(self, object_id: str) -> Target:
        return self._members[object_id].target

    def state_of(self, object_id: str) -> ControlState:
        return self._members[object_id].target.state

    # -- steps ---------------------------------------------------------------------------------

    def step(self, steady_ns: int) -> PoolStep | None:
        """Answer the newest tick; None where there is none or something before it is missing.

        Args:
            steady_ns: now on the steady clock; in lockstep it decides only when something is lost.
        """
        waited_s = ns_to_seconds(steady_ns - self._tick_arrived_ns)
        tick = self._buffer.take(overdue=waited_s > OVERDUE_S)
        if tick is None:
            return None
        now_ns = tick.stamp_ns
        self._now_ns, self._step = now_ns, tick.step
        truths = {state.object_id: state for state in tick.objects}
        holding = tick.lockstep and not tick.running and tick.step == 0
        beats = self._buffer.heartbeats(tick.heartbeat if in_step(tick) else None, holding)
        other_states = self._buffer.states()
        if self._driven:
            # Nothing that an object does depends on a driven VUT (METHOD 8.2).
            other_states = [state for state in other_states if state.object_id != VUT_ID]
        self._nearby.take(other_states)
        strangers = self._arbiter.strangers(steady_ns)
        commands: list[tuple[str, Command]] = []
        states: list[ObjectState] = []
        acks: list[Acknowledgement] = []
        events: list[ObjectStop] = []
        faults: list[FaultChange] = []
        for object_id, member in self._members.items():
            channel = member.channel
            armed = member.target.state is ControlState.ARMED
            faults += channel.begin(now_ns, running=tick.running, armed=armed)
            member.hear(channel.down_heartbeats(beats, now_ns), steady_ns)
            truth = truths.get(object_id)
            if truth is None:
                continue
            own = channel.measure(truth, now_ns)
            own_ns = channel.clock_ns(now_ns)
            if member.target.state is not ControlState.ARMED:
                sent = self._buffer.references(object_id)
                member.references += channel.down_references(sent, now_ns)
            acks += channel.up_acks(member.answer(own_ns, self.active), now_ns)
            outcome = member.target.step(
                own,
                own_ns,
                self._heartbeat_age_s(member, tick, steady_ns),
                self._nearby.near(own),
                strangers,
            )
            if outcome.stopped is not None:
                events.append(ObjectStop(object_id, outcome.stopped))
            commands.append((object_id, outcome.command))
            states += channel.up(outcome.report, now_ns)
        # What the objects of one process tell the manager, they hear of each other a step later.
        self._nearby.take(states)
        counts = self._count(len(states) if tick.running else 0, len(acks), len(events))
        return PoolStep(
            tick.step,
            now_ns,
            tick.lockstep,
            tuple(commands),
            tuple(states),
            tuple(acks),
            tuple(events),
            counts,
            tuple(faults),
        )

    def watch(self, steady_ns: int) -> PoolStep | None:
        """Stop whatever may move when no tick comes any more; None when nothing is to be done.

        Called often. After a pause of its own this process has not read yet what came meanwhile,
        and judges at the next call.
        """
        paused_s = ns_to_seconds(steady_ns - self._watched_ns)
        self._watched_ns = steady_ns
        limit_s = WORLD_HANG_S if self._in_step else TICK_SILENCE_S
        if ns_to_seconds(steady_ns - self._tick_arrived_ns) <= limit_s or paused_s > PAUSE_S:
            return None
        return self.halt(steady_ns, limit_s)

    def halt(self, steady_ns: int, limit_s: float = 0.0) -> PoolStep | None:
        """Stop every object that may move, latched and announced; None when there is none."""
        silence_s = ns_to_seconds(steady_ns - self._tick_arrived_ns)
        stop = LimitViolation(SafetyCode.STATE_STALE, silence_s, limit_s)
        moving = {i: m.target for i, m in self._members.items() if m.target.state in _MAY_MOVE}
        if not moving:
            return None
        commands = tuple((i, target.stop_blindly()) for i, target in moving.items())
        reports = [target.last_report() for target in moving.values()]
        return PoolStep(
            self._step,
            self._now_ns,
            False,
            commands,
            tuple(report for report in reports if report is not None),
            (),
            tuple(ObjectStop(i, stop) for i in moving),
            self._count(0, 0, len(moving)),
        )

    # -- inside --------------------------------------------------------------------------------

    def _heartbeat_age_s(self, member: _Member, tick: WorldTick, steady_ns: int) -> float:
        """Return the heartbeat's age on session time in lockstep, where one comes per step.

        Else steady.
        """
        if not in_step(tick):
            return member.silence_s(steady_ns)
        if member.heartbeat_stamp_ns is None:
            return float("inf")
        return ns_to_seconds(tick.stamp_ns - member.heartbeat_stamp_ns)

    def _count(self, states: int, acks: int, safety_events: int) -> Counts:
        c = self._counts
        self._counts = Counts(c.states + states, c.acks + acks, c.safety_events + safety_events)
        return self._counts
