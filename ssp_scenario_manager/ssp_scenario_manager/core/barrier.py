"""Which step's messages are all here (lockstep): counts against counts, no assumption on order."""

from __future__ import annotations

from dataclasses import dataclass, field


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

    def on_tick(self, step: int, vut_states_sent: int) -> None:
        self.step = step
        self.vut_states_sent = vut_states_sent

    def is_overtaken_by(self, step: int) -> bool:
        """True when the world takes a step although the last one isn't dealt with."""
        return self.step is not None and self.done_step < self.step < step

    def on_answer(
        self, participant: str, step: int, states_sent: int, acks_sent: int, events_sent: int
    ) -> None:
        if participant in self.participants:
            self.answers[participant] = (step, states_sent, acks_sent, events_sent)

    def forget(self, participant: str) -> None:
        """The world has dropped this one; its answers are not waited for any more."""
        self.participants = tuple(p for p in self.participants if p != participant)

    def complete(self) -> bool:
        """True when everything that belongs to the present step has arrived."""
        if self.step is None or self.step <= self.done_step:
            return False
        if self.vut_states < self.vut_states_sent:
            return False
        answers = [self.answers.get(name) for name in self.participants]
        if any(answer is None or answer[0] < self.step for answer in answers):
            return False
        given = [answer for answer in answers if answer is not None]
        received = (self.states, self.acks, self.safety_events)
        return all(
            have >= sum(answer[k] for answer in given) for k, have in enumerate(received, start=1)
        )
