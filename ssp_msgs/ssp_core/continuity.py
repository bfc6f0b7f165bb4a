"""Does each state of an object follow from the one before: jumps, and positions that stand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core import limits as judge
from ssp_core.clock import ns_to_seconds
from ssp_core.limits import Passed
from ssp_core.run_spec import Limits
from ssp_core.state import ObjectState

# An object whose own state says that it is faster than this can't stay where it is.
MOVING_MPS = 0.2
# It has stayed when it is still so near; receivers repeat a position to the last digit.
STOOD_M = 0.01


@dataclass(frozen=True, slots=True)
class Continuity:
    """What is remembered of one object's states.

    Args:
        before: the newest state that could be judged; None before the first.
        stood_at: the first state at the present position of an object that moves, as it says, or
            that must move; None while the position moves, or while the object may stand.
    """

    before: ObjectState | None = None
    stood_at: ObjectState | None = None


def follow(
    memory: Continuity, state: ObjectState, limits: Limits, asked_mps: float = 0.0
) -> tuple[Continuity, list[Passed]]:
    """Judges a state by those before it.

    A state with a value that is no number is not judged and not remembered, nor is one that is
    older than the newest. After a jump the new position is believed, so that it is told once.

    Args:
        memory: of the states so far.
        state: the next state of the same object.
        limits: of the site.
        asked_mps: speed that an object which isn't ahead of its reference is asked for, 0 for
            none. A state that froze while the object stood says that it stands for ever.

    Returns:
        The memory with this state, and the limits that it passes.
    """
    before = memory.before
    if not state.is_finite or (before is not None and state.stamp_ns <= before.stamp_ns):
        return memory, []
    found = [] if before is None else [judge.position_jump(before, state, limits)]
    stood_at = _stood_at(memory, state, asked_mps)
    if stood_at is not None:
        stood_s = ns_to_seconds(state.stamp_ns - stood_at.stamp_ns)
        found.append(judge.state_frozen(stood_s, limits))
    return Continuity(state, stood_at), [passed for passed in found if passed is not None]


def _stood_at(memory: Continuity, state: ObjectState, asked_mps: float) -> ObjectState | None:
    if max(abs(state.speed_mps), asked_mps) <= MOVING_MPS:
        return None
    since = memory.stood_at
    if since is None:
        return state
    moved_m = math.hypot(state.x_m - since.x_m, state.y_m - since.y_m)
    return since if moved_m <= STOOD_M else state
