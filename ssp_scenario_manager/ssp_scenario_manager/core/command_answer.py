"""What a command of a session is answered (SessionCommand.srv)."""

from __future__ import annotations

from dataclasses import dataclass

REFUSED_TRANSITION = 1
REFUSED_CONDITION = 2


@dataclass(frozen=True, slots=True)
class Answer:
    """A command's answer.

    Args:
        accepted: whether it has had its effect; a refused one has none.
        error_code: 0 when accepted, else REFUSED_*.
        error_msg: for people.
        missing: everything that keeps the command from being accepted.
    """

    accepted: bool
    error_code: int = 0
    error_msg: str = ""
    missing: tuple[str, ...] = ()
