"""Answers to references: what is still due, what is sent again, and what a refusal means.

A reference that isn't answered is sent again, under the same id, until the limit for answers has
passed; an object answers a copy as it answered the original. Of adapted references only the newest
is sent again, and a newer one that was accepted settles the older ones: the object drives it, and
it says that the link works.
"""

from __future__ import annotations

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.reference import Reference

# An answer that hasn't come after so long may have been lost, or its reference.
RESEND_S = 0.06
# Refusals of ReferenceAck.msg that say no more than that the link was slow, or lost one before.
# Whatever else is refused tells that object and manager don't agree on what may be driven.
_LATE, _DISCONTINUOUS = 2, 5
ADAPTED = "adapted"


def is_fatal(reference: Reference, code: int) -> bool:
    """A refusal of this reference ends the run.

    Without its approach or its manoeuvre an object doesn't do what the event needs. One that gets
    an adapted reference too late goes on with a manoeuvre that it has accepted. Of any other
    refusal it stops by itself.

    Args:
        reference: that was refused.
        code: REFUSED_* of ReferenceAck.msg.
    """
    return reference.purpose != ADAPTED or code not in (_LATE, _DISCONTINUOUS)


class Answers:
    """References of a run that wait for their answer. Reads no clock."""

    def __init__(self) -> None:
        self._due: dict[str, Reference] = {}
        self._sent_ns: dict[str, int] = {}
        self._copied: set[str] = set()

    def expect(self, reference: Reference) -> None:
        """A reference is sent for the first time."""
        self._due[reference.reference_id] = reference
        self._sent_ns[reference.reference_id] = reference.dispatched_ns

    def take(self, reference_id: str, *, accepted: bool) -> Reference | None:
        """An answer has come; None when none was due, as for the answer to a copy."""
        reference = self._due.get(reference_id)
        if reference is None:
            return None
        settled = [reference_id]
        if accepted:
            settled += [
                r.reference_id
                for r in self._due.values()
                if r.purpose == ADAPTED
                and r.object_id == reference.object_id
                and r.dispatched_ns < reference.dispatched_ns
            ]
        for each in settled:
            del self._due[each], self._sent_ns[each]
            self._copied.discard(each)
        return reference

    @property
    def due(self) -> tuple[Reference, ...]:
        """What hasn't been answered, in the order of dispatch."""
        return tuple(self._due.values())

    def again(self, now_ns: int, step_s: float) -> list[Reference]:
        """What is to be sent once more now.

        Args:
            now_ns: session time.
            step_s: of the world; an answer needs two steps.
        """
        step_ns = seconds_to_ns(step_s)
        wait_ns = max(seconds_to_ns(RESEND_S), 3 * step_ns)
        newest = {r.object_id: r for r in self._due.values()}
        copies = []
        for reference in self._due.values():
            name, adapted = reference.reference_id, reference.purpose == ADAPTED
            hurry = name in self._copied and not adapted
            if now_ns - self._sent_ns[name] < (step_ns if hurry else wait_ns):
                continue
            if adapted and newest[reference.object_id] is not reference:
                continue
            # Also one that can't be taken any more: its answer says whether it was.
            self._sent_ns[name] = now_ns
            self._copied.add(name)
            copies.append(reference)
        return copies
