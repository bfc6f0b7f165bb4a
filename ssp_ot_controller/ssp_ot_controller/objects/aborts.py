"""The aborts that an object knows: the one that it heard of since it stopped, and the last cleared.

This file owns both. An all-clear clears the abort that it names; a heartbeat that still names a
cleared abort was under way when that was cleared.
"""

from __future__ import annotations


class Aborts:
    """The identities of an object's aborts, as the manager names them."""

    def __init__(self) -> None:
        self._abort_id: str | None = None
        self._cleared: str | None = None

    def hear(self, abort_id: str) -> None:
        """Take the session's newest abort."""
        self._abort_id = abort_id

    def forget(self) -> None:
        """Begin a stop of the object's own, before which no abort was heard."""
        self._abort_id = None

    def may_clear(self, abort_id: str | None) -> bool:
        """Tell whether an all-clear concerns what stops the object; None names no abort."""
        return abort_id is None or abort_id == self._abort_id

    def clear(self, abort_id: str | None) -> None:
        """Take an all-clear."""
        self._abort_id, self._cleared = None, abort_id or ""

    def is_cleared(self, abort_id: str | None) -> bool:
        """Tell whether this abort is the last one that was cleared."""
        return bool(abort_id) and abort_id == self._cleared
