"""How the recorded run ended, by the session's own last word and what the recorder knows of itself.

A session that was started by hand has nobody else who could leave a verdict beside its bag.
"""

from __future__ import annotations

from ssp_core.vocabulary import SessionPhase, Verdict

_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)
# What the session says in these states is the end of a run, or leads to it.
_SPOKEN = (*_OVER, SessionPhase.ABORTING)
# In these states the session has more to say.
_UNDER_WAY = (
    SessionPhase.ARMED,
    SessionPhase.RUNNING,
    SessionPhase.STOPPING,
    SessionPhase.ABORTING,
)


class LastWord:
    """Follows the recorded session states.

    Args:
        run_id: of the run that is recorded.
    """

    def __init__(self, run_id: str) -> None:
        self._run_id = run_id
        self._state = SessionPhase.UNKNOWN
        self._runs = 0
        self._others: list[str] = []
        self._end: tuple[Verdict, tuple[str, ...]] | None = None

    @property
    def is_due(self) -> bool:
        """The session is under way, so that its last word is still to come."""
        return self._state in _UNDER_WAY

    def hear(
        self, state: SessionPhase, verdict: Verdict, reasons: tuple[str, ...], run_id: str
    ) -> None:
        """Takes a session state as it was recorded (SessionState.msg)."""
        if state is SessionPhase.RUNNING and state is not self._state:
            self._runs += 1
        self._state = state
        if run_id and run_id != self._run_id and run_id not in self._others:
            self._others.append(run_id)
        if state in _SPOKEN and verdict is not Verdict.NONE:
            self._end = (verdict, reasons)

    def verdict(
        self, lost: int, lost_limit: int = 0, problems: tuple[str, ...] = ()
    ) -> tuple[Verdict, tuple[str, ...]]:
        """The verdict of the recording, with its reasons, the session's own first.

        Args:
            lost: messages that the recorder knows to be missing.
            lost_limit: as many may be.
            problems: what is wrong with the bag that was written.
        """
        ours: list[str] = []
        if self._state is SessionPhase.UNKNOWN:
            ours.append("no session was heard")
        elif self._end is None or self.is_due:
            ours.append(f"the recording ends while the session is {self._state.name}")
        if self._runs > 1:
            ours.append(f"{self._runs} runs are in one recording")
        ours += [f"the session ran {i}, the recording is of {self._run_id}" for i in self._others]
        if lost > lost_limit:
            limit = f", limit {lost_limit}" if lost_limit else ""
            ours.append(f"the recorder lost {lost} messages{limit}")
        ours += problems
        verdict, reasons = self._end or (Verdict.INVALID_HARNESS, ())
        if ours and verdict is Verdict.VALID:
            verdict = Verdict.INVALID_HARNESS
        return verdict, (*reasons, *ours)
