"""The order of the commands of a whole run, and what a run ended with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.run_file.verdict import RecordedVerdict
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_scenario_manager.session.state_machine import Answer, SessionEvent

# How long a step may be refused (a participant still starting, say) before the goal fails. A
# camera that compiles its kernels for the first time on a busy machine takes 30 s.
PATIENCE_S = 45.0

_NEXT = {
    SessionPhase.LOADED: SessionEvent.CONNECT,
    SessionPhase.CONNECTED: SessionEvent.ARM,
    SessionPhase.ARMED: SessionEvent.START,
}
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)


class RunScript:
    """The choice of the next command to try. Times are steady-clock nanoseconds.

    A goal begins with loading its own file; a session that is somewhere else already is refused. A
    person's word goes on from where the session stands with this very file.

    Args:
        run_file: of the goal.
        start_by_ns: a person's word holds until then, and no step is tried later; None: each step
            is tried for PATIENCE_S.
        loaded: run file that the session has loaded; empty: none.
        state: of the session when the goal came.
    """

    def __init__(
        self,
        run_file: str,
        now_ns: int,
        start_by_ns: int | None = None,
        loaded: str = "",
        state: SessionPhase = SessionPhase.IDLE,
    ) -> None:
        self.run_file = run_file
        self.not_in_time = False
        self._start_by_ns = start_by_ns
        self._goes_on = start_by_ns is not None and loaded == run_file
        self.problems: tuple[str, ...] = ()
        self.finished = False
        self.has_begun = False
        self._deadline_ns = now_ns
        self._furthest_state: SessionPhase | None = None
        self._is_armed = state is SessionPhase.ARMED
        self._refusal: tuple[str, ...] = ()
        self._unconfirmed = False

    def next(self, state: SessionPhase, now_ns: int) -> SessionEvent | None:
        """Return the command to try now, None to wait."""
        if self.finished:
            return None
        if self._is_late(state, now_ns):
            return None
        if not self.has_begun and self._goes_on and state in _NEXT:
            self.has_begun = True
        if not self.has_begun:
            if state in (SessionPhase.IDLE, SessionPhase.LOADED):
                return SessionEvent.LOAD
            self._end((f"the session is {state.name} already; reset it or clear its abort first",))
            return None
        if state in _OVER or (state is SessionPhase.ABORTING and self._unconfirmed):
            self.finished = True
            return None
        if state is SessionPhase.IDLE:
            self._end(("the session was reset by somebody else",))
            return None
        if self._is_armed and state is SessionPhase.CONNECTED:
            self._end(("the session was disarmed by somebody else",))
            return None
        self._is_armed = state is SessionPhase.ARMED
        # Only progress buys more time: an object that never arms must not go on for ever.
        if self._furthest_state is None or state > self._furthest_state:
            self._furthest_state = state
            self._refusal = ()
            self._deadline_ns = now_ns + seconds_to_ns(PATIENCE_S)
        event = _NEXT.get(state)
        if event is not None and self._start_by_ns is None and now_ns > self._deadline_ns:
            self._end(self._refusal or (f"{event.value} was not possible in {PATIENCE_S:g} s",))
            return None
        return event

    def give_up(self, problems: tuple[str, ...]) -> None:
        """Give up a goal whose run no waiting lets begin."""
        if self.has_begun and not self.finished:
            self._end(problems)

    def _is_late(self, state: SessionPhase, now_ns: int) -> bool:
        """Tell whether the word for the goal ran out before the start, which ends the goal."""
        waits = not self.has_begun or state in _NEXT
        if self._start_by_ns is None or not waits or now_ns <= self._start_by_ns:
            return False
        self.not_in_time = True
        event = _NEXT.get(state, SessionEvent.LOAD)
        self._end(self._refusal or (f"{event.value} was not possible in time",))
        return True

    def on_answer(self, answer: Answer) -> None:
        """Take the answer to the command that next() named; a final one ends the goal."""
        if not self.has_begun:
            self.has_begun = answer.accepted
            if not answer.accepted:
                self._end(answer.missing or (answer.error_msg,))
        elif not answer.accepted:
            self._refusal = answer.missing or (answer.error_msg,)
            if answer.is_final:
                self._end(self._refusal)

    @property
    def waits_for(self) -> str:
        """Describe what keeps the next command from being accepted; empty when nothing does."""
        return "" if self.finished else "; ".join(self._refusal)

    def on_setback(self, reason: str) -> None:
        """Take the reason why an accepted command came to nothing: an object didn't arm."""
        self._refusal = (reason,)
        self._is_armed = False

    def standstill_unconfirmed(self) -> None:
        """Take that the session aborts and no participant can report a standstill."""
        self._unconfirmed = True

    def _end(self, problems: tuple[str, ...]) -> None:
        self.finished = True
        self.problems = problems


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Verdict of a run, and the reasons for it, the primary one first."""

    verdict: Verdict
    reasons: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return self.verdict is Verdict.VALID

    def with_reason(self, verdict: Verdict, reason: str) -> RunOutcome:
        """Add a reason, and its verdict only if there was none that says more."""
        if reason in self.reasons:
            return self
        final_verdict = (
            self.verdict if self.verdict not in (Verdict.NONE, Verdict.VALID) else verdict
        )
        return RunOutcome(final_verdict, (*self.reasons, reason))

    def with_misses(self, misses: Sequence[str]) -> RunOutcome:
        """Return a sound run whose event didn't become that of K* as ``off_spec`` (METHOD 4.4)."""
        return RunOutcome(Verdict.OFF_SPEC, tuple(misses)) if self.ok and misses else self

    def with_word_of_recorder(self, recorder_verdict: RecordedVerdict | None) -> RunOutcome:
        """Return the same with what only the recorder knows, which it wrote when it closed the bag.

        Args:
            recorder_verdict: its verdict; None where it left none.
        """
        outcome = self
        if recorder_verdict is not None and recorder_verdict.verdict is not Verdict.VALID:
            for reason in recorder_verdict.reasons:
                outcome = outcome.with_reason(recorder_verdict.verdict, reason)
        return outcome
