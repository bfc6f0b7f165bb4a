"""States as they arrive: into the session, counted, and in lockstep checked against each step.

This file owns what a step still waits for; a step that is dealt with is never taken up again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from ssp_core import names
from ssp_core.cdr.states import StateArray, find_state
from ssp_core.motion.state import ObjectState
from ssp_core.safety.link_quality import LossCounters
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.supervision import LivenessMonitor


@dataclass(slots=True)
class WorldMode:
    """The simulated world, as its newest tick tells of it.

    Args:
        lockstep: it waits for the answer to each of its steps.
        running: its time goes; False while it holds.
    """

    lockstep: bool = False
    running: bool = False


@dataclass
class StepInputs:
    """Counts of what the manager has received, and what the others say they have sent.

    Args:
        participants: names of the object target nodes.
    """

    participants: tuple[str, ...]
    step: int | None = None
    done_step: int = -1
    vut_states_sent: int = 0
    vut_states: int = 0
    states: int = 0
    acks: int = 0
    safety_events: int = 0
    answers: dict[str, tuple[int, int, int, int]] = field(default_factory=dict)
    _reported: list[Violation] = field(default_factory=list)
    _reported_step: int = -1

    def on_tick(self, step: int, vut_states_sent: int) -> None:
        self.step = step
        self.vut_states_sent = vut_states_sent

    def is_dealt_with(self, step: int) -> bool:
        """Tell whether a step that comes was answered: the world waits for somebody else."""
        return step == self.step == self.done_step

    def is_overtaken_by(self, step: int) -> bool:
        """Tell whether the world takes a step although the last one isn't dealt with."""
        return self.step is not None and self.done_step < self.step < step

    def on_answer(
        self, participant: str, step: int, states_sent: int, acks_sent: int, events_sent: int
    ) -> None:
        if participant in self.participants:
            self.answers[participant] = (step, states_sent, acks_sent, events_sent)

    def forget(self, participant: str) -> None:
        """Forget a participant that the world has dropped; its answers are not awaited any more."""
        self.participants = tuple(p for p in self.participants if p != participant)
        self.answers.pop(participant, None)

    def complete(self) -> bool:
        """Tell whether everything that belongs to the present step has arrived."""
        return self.step is not None and self.step > self.done_step and not self.missing()

    def missing(self) -> list[str]:
        """List messages of the present step that were sent, or must be, and haven't arrived."""
        step = self.step or 0
        silent = [name for name in self.participants if self.answers.get(name, (-1,))[0] < step]
        sent = [sum(answer[k] for answer in self.answers.values()) for k in (1, 2, 3)]
        counts = (
            ("states of the VUT", self.vut_states, self.vut_states_sent),
            ("states of objects", self.states, sent[0]),
            ("acknowledgements", self.acks, sent[1]),
            ("safety events", self.safety_events, sent[2]),
        )
        lacking = [f"{what} ({have} of {of})" for what, have, of in counts if have < of]
        return [f"the answer of {name}" for name in silent] + lacking

    def missing_of_late(self) -> list[str]:
        """List what is missing once the world has waited for long; each step is listed once."""
        if (self.step or 0) <= self._reported_step or not (missing := self.missing()):
            return []
        self._reported_step = self.step or 0
        return missing

    def report(self, violation: Violation) -> None:
        """Keep a violation that another node saw, until the step that it belongs to."""
        self._reported.append(violation)

    def take_reported(self) -> list[Violation]:
        """Take out the violations that others saw, in an order of their own."""
        violations, self._reported = self._reported, []
        return sorted(violations, key=lambda v: (v.stamp_ns, v.code, v.object_id))


class PendingStates:
    """ObjectStates messages in the order of their arrival, not decoded yet."""

    def __init__(self) -> None:
        self._waiting: list[tuple[bytes, int]] = []

    def put(self, data: bytes, steady_ns: int) -> None:
        """Take a message, and when it arrived on the steady clock."""
        self._waiting.append((data, steady_ns))

    def take(self) -> list[tuple[bytes, int]]:
        """Return the messages with their arrivals, and forget them."""
        messages, self._waiting = self._waiting, []
        return messages

    def newest(self, object_id: str) -> ObjectState | None:
        """Return an object's state that arrived last; None: none waits, or none can be read."""
        for data, _ in reversed(self._waiting):
            try:
                state = find_state(data, object_id)
            except ValueError:
                continue
            if state is not None:
                return state
        return None

    def over(self, states: Mapping[str, ObjectState]) -> Mapping[str, ObjectState]:
        """Return the newest states by id, of those that wait and those that were taken in."""
        return _Over(states, self) if self._waiting else states


class _Over(Mapping[str, ObjectState]):
    """States that wait before those that are known; an older one doesn't replace a newer one."""

    def __init__(self, states: Mapping[str, ObjectState], arrivals: PendingStates) -> None:
        self._stored_states = states
        self._arrivals = arrivals

    def __getitem__(self, object_id: str) -> ObjectState:
        stored_state, state = self._stored_states.get(object_id), self._arrivals.newest(object_id)
        if state is None or (stored_state is not None and state.stamp_ns < stored_state.stamp_ns):
            return self._stored_states[object_id]
        return state

    def __contains__(self, object_id: object) -> bool:
        return object_id in self._stored_states or (
            isinstance(object_id, str) and self._arrivals.newest(object_id) is not None
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self._stored_states)

    def __len__(self) -> int:
        return len(self._stored_states)


class StateInput:
    """Takes states in. Reads no clock: arrivals on the steady clock are given, in ns.

    Args:
        inputs: counts the states of a run, for lockstep.
        decode: reads a message with the states of many; None for bytes that are none.
    """

    def __init__(
        self,
        session: Session,
        liveness: LivenessMonitor,
        inputs: StepInputs,
        decode: Callable[[bytes], StateArray | None],
        tell: Callable[[str], None],
    ) -> None:
        self.losses = LossCounters()
        self.arrivals = PendingStates()
        self._session = session
        self._liveness = liveness
        self._inputs = inputs
        self._decode = decode
        self._tell = tell
        self._strangers: set[str] = set()

    def vut(self, state: ObjectState, steady_ns: int) -> bool:
        """Take a state of the VUT; return False for one that isn't the VUT's."""
        if not self._session.on_vut_state(state):
            self.tell_stranger(state.object_id, "sends states as the vehicle under test")
            return False
        self._liveness.hear(names.VUT_ID, steady_ns)
        self.losses.see(state.object_id, state.sequence)
        # The first is repeated while the world holds, and belongs to no step.
        self._inputs.vut_states += state.sequence > 1
        return True

    def target(self, state: ObjectState, steady_ns: int) -> None:
        """Take a state of an object target; a stranger's only counts for its process."""
        if self._session.on_target_state(state):
            self._liveness.hear(state.object_id, steady_ns)
            self.losses.see(state.object_id, state.sequence)
        else:
            self.tell_stranger(state.object_id, "sends states, but the run doesn't know it")
        self._inputs.states += state.sequence > 1

    def waiting(self) -> None:
        """Take the states of many that have waited in ``arrivals``."""
        for data, arrived_ns in self.arrivals.take():
            array = self._decode(data)
            for state in array.states if array is not None else ():
                self.target(state, arrived_ns)

    def tell_stranger(self, who: str, what: str) -> None:
        """Say once that a sender is heard which has no part in this session."""
        if who not in self._strangers:
            self._strangers.add(who)
            self._tell(f"{who} is not listened to: {what}")
