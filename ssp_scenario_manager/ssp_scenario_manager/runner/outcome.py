"""How a run ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.run_file.verdict import RecordedVerdict
from ssp_core.vocabulary import Verdict


@dataclass(frozen=True, slots=True)
class Outcome:
    """Verdict of a run, and the reasons for it, the primary one first."""

    verdict: Verdict
    reasons: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return self.verdict is Verdict.VALID

    def with_reason(self, verdict: Verdict, reason: str) -> Outcome:
        """The same with one more reason; the verdict only if there was none that says more."""
        if reason in self.reasons:
            return self
        kept = self.verdict if self.verdict not in (Verdict.NONE, Verdict.VALID) else verdict
        return Outcome(kept, (*self.reasons, reason))

    def with_misses(self, misses: Sequence[str]) -> Outcome:
        """A sound run whose event didn't become that of K* is ``off_spec`` (METHOD 4.4).

        Args:
            misses: what isn't as K* wants it; a run that wasn't valid anyway keeps its verdict.
        """
        return Outcome(Verdict.OFF_SPEC, tuple(misses)) if self.ok and misses else self

    def with_word_of_recorder(self, told: RecordedVerdict | None) -> Outcome:
        """The same with what the recorder alone knows, which it left when it closed the bag.

        Args:
            told: its verdict; None where it left none.
        """
        outcome = self
        if told is not None and told.verdict is not Verdict.VALID:
            for reason in told.reasons:
                outcome = outcome.with_reason(told.verdict, reason)
        return outcome
