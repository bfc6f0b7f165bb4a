"""How old what was heard is, in one place for all who show it."""

from __future__ import annotations

import math

from ssp_monitor.watch.board import Board
from ssp_monitor.watch.facts import Heard, LinkFact

# A manager that was heard this lately tells what session time it is.
_MANAGER_FRESH_S = 1.0
# The manager tells of its links once a second; three periods without are silence.
LINKS_FRESH_S = 3.0


def age_s(now_ns: int, at_ns: int | None) -> float:
    """How long ago something was heard; inf: never."""
    return math.inf if at_ns is None else max(0, now_ns - at_ns) / 1e9


def links_of(board: Board, now_ns: int) -> dict[str, LinkFact]:
    """The links as they are now; nothing when the manager hasn't told of them lately.

    Args:
        board: what was heard.
        now_ns: steady clock.
    """
    return board.links if age_s(now_ns, board.links_at_ns) <= LINKS_FRESH_S else {}


def object_age_s(board: Board, heard: Heard, now_ns: int) -> float:
    """How old an object's state is: the worst of what arrival, stamp and manager say of it.

    A state that was held up on its way arrives late and looks new by its arrival alone.

    Args:
        board: what was heard.
        heard: the state.
        now_ns: steady clock.
    """
    age = age_s(now_ns, heard.at_ns)
    if (
        board.manager_stamp_ns is not None
        and age_s(now_ns, board.manager_at_ns) <= _MANAGER_FRESH_S
    ):
        age = max(age, (board.manager_stamp_ns - heard.state.stamp_ns) / 1e9)
    link = links_of(board, now_ns).get(heard.state.object_id)
    if link is not None and math.isfinite(link.state_age_s):
        age = max(age, link.state_age_s)
    return age
