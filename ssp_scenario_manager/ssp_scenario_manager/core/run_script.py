"""The steps of one run_scenario goal: load, connect, arm, start, then wait for the end."""

from __future__ import annotations

from ssp_core.clock import seconds_to_ns
from ssp_core.vocab import SessionPhase
from ssp_scenario_manager.core.session import Answer
from ssp_scenario_manager.core.session_machine import SessionEvent

# How long a step may be refused (a participant still starting, say) before the goal fails.
PATIENCE_S = 20.0

_NEXT = {
    SessionPhase.IDLE: SessionEvent.LOAD,
    SessionPhase.LOADED: SessionEvent.CONNECT,
    SessionPhase.CONNECTED: SessionEvent.ARM,
    SessionPhase.ARMED: SessionEvent.START,
}
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)


class RunScript:
    """Which command to try next. Times are steady-clock nanoseconds."""

    def __init__(self, run_file: str, now_ns: int) -> None:
        self.run_file = run_file
        self.problems: tuple[str, ...] = ()
        self.finished = False
        self._deadline_ns = now_ns + seconds_to_ns(PATIENCE_S)
        self._state: SessionPhase | None = None
        self._last: Answer | None = None
        self._unconfirmed = False

    def next(self, state: SessionPhase, now_ns: int) -> SessionEvent | None:
        """The command to try now, None to wait."""
        if self.finished:
            return None
        if state in _OVER or (state is SessionPhase.ABORTING and self._unconfirmed):
            self.finished = True
            return None
        if state is not self._state:
            self._state = state
            self._deadline_ns = now_ns + seconds_to_ns(PATIENCE_S)
        event = _NEXT.get(state)
        if event is not None and now_ns > self._deadline_ns:
            self.finished = True
            last = self._last
            self.problems = (last.missing or (last.error_msg,)) if last else ("no answer",)
            return None
        return event

    def on_answer(self, answer: Answer) -> None:
        """The answer to the command that next() named. A file that can't be loaded is final."""
        self._last = answer
        if not answer.accepted and self._state is SessionPhase.IDLE:
            self.finished = True
            self.problems = answer.missing or (answer.error_msg,)

    def standstill_unconfirmed(self) -> None:
        """The session aborts and nobody is left to report a standstill."""
        self._unconfirmed = True
