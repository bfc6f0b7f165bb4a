"""The verdict of one run, and its reasons.

This file owns them: the first reason gives the verdict, a reason stands once, and the end of the
run closes both. Reads no clock.
"""

from __future__ import annotations

from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.session.limits import Violation


class RunVerdict:
    """The verdict of a run that goes on or is over.

    Attributes:
        value: NONE until there is a reason, or the end.
        reasons: with their times in the run, in the order in which they came.
    """

    def __init__(self) -> None:
        self.value = Verdict.NONE
        self.reasons: list[str] = []
        self._closed = False
        self._texts: set[str] = set()
        self._blamed: set[tuple[SafetyCode, str]] = set()

    def blame(self, violation: Violation, at_s: float | None) -> bool:
        """Take a limit that was passed as a reason; see ``add``.

        Returns:
            False when this limit of this object is a reason already.
        """
        if (violation.code, violation.object_id) in self._blamed:
            return False
        self._blamed.add((violation.code, violation.object_id))
        self.add(violation.verdict, violation.text, at_s)
        return True

    def add(self, verdict: Verdict, text: str, at_s: float | None) -> None:
        """Add a reason with its time in the run; the verdict is that of the first.

        A person who aborts twice gives one reason, and what comes after the end gives none.

        Args:
            verdict: of a run with this as its first reason.
            text: the reason.
            at_s: since the start of the run; None: it hasn't started.
        """
        if self._closed or text in self._texts:
            return
        self._texts.add(text)
        if not self.reasons:
            self.value = verdict
        self.reasons.append(text if at_s is None else f"{text} at {at_s:.2f} s")

    def close(self) -> None:
        """Close the verdict: a run without a reason was valid, and none is added any more."""
        if self.value is Verdict.NONE:
            self.value = Verdict.VALID
        self._closed = True
