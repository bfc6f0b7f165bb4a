"""References that an object holds: the one that it drives, and those that wait for their time.

References that are dispatched faster than a link delivers them overlap: a newer one arrives while
an older one still waits. Each begins at its own ``execute_at``, so that a stream of them never
keeps the object from beginning any.
"""

from __future__ import annotations

from ssp_core.motion.reference import Reference


class ReferenceQueue:
    """Accepted references of one object. Reads no clock."""

    def __init__(self) -> None:
        self.current: Reference | None = None
        self._waiting: list[Reference] = []
        self._taken: dict[str, int] = {}

    def before(self, execute_at_ns: int) -> Reference | None:
        """The reference that the object will be driving just before a time, as things stand."""
        earlier = [r for r in self._waiting if r.execute_at_ns < execute_at_ns]
        return earlier[-1] if earlier else self.current

    @property
    def is_empty(self) -> bool:
        """True when nothing is driven and nothing waits."""
        return self.current is None and not self._waiting

    def has_taken(self, reference: Reference) -> bool:
        """True for one that was taken before: what was sent twice is answered alike twice."""
        return self._taken.get(reference.reference_id) == reference.execute_at_ns

    def overtaker(self, reference: Reference) -> Reference | None:
        """An accepted reference that waits, begins no earlier, and was sent after this one.

        Taking the older one would put it in the place of what the manager wants now and believes
        to be driven.
        """
        return next(
            (
                waiting
                for waiting in self._waiting
                if waiting.dispatched_ns > reference.dispatched_ns
                and waiting.execute_at_ns >= reference.execute_at_ns
            ),
            None,
        )

    def take(self, reference: Reference) -> None:
        """Lets a reference wait for its time, instead of what would have begun then or later."""
        at_ns = reference.execute_at_ns
        self._waiting = [r for r in self._waiting if r.execute_at_ns < at_ns]
        self._waiting.append(reference)
        self._taken[reference.reference_id] = at_ns

    def advance(self, now_ns: int) -> bool:
        """Begins what is due; True when another reference is driven from now on."""
        due = [r for r in self._waiting if r.execute_at_ns <= now_ns]
        if not due:
            return False
        self.current = due[-1]
        self._waiting = self._waiting[len(due) :]
        return True

    def clear(self) -> None:
        """Forgets everything."""
        self.current = None
        self._waiting.clear()
        self._taken.clear()
