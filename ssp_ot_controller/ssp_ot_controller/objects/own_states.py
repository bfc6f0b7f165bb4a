"""An object's own states as they come, each judged by those before it.

This file owns what an object remembers of its own states; nothing of them is forgotten while it
may move. Reads no clock.
"""

from __future__ import annotations

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.contradiction import Contradiction
from ssp_core.safety.limits import (
    Continuity,
    LimitViolation,
    follow,
    is_standing,
    net_way_m,
    state_contradicts,
)
from ssp_core.safety.start_heading import start_heading

# An object that knows its own motion has stopped below this speed.
OWN_STANDSTILL_MPS = 0.02


class OwnStates:
    """The newest own state, and what the states so far say of it.

    Attributes:
        newest: None before the first.
    """

    def __init__(self, spec: ParticipantSpec, limits: Limits) -> None:
        self.newest: ObjectState | None = None
        self._limits = limits
        self._continuity = Continuity()
        self._motion = ConsistencyWatch(Bounds.of(spec.id, spec.cls, limits))
        self._heading = start_heading(spec, limits)

    @property
    def doubt(self) -> Contradiction | None:
        """The contradiction between states and places that isn't mended yet."""
        return self._motion.doubt

    @property
    def stands(self) -> bool:
        """Tell whether speed and places say that the object stands."""
        own = self.newest
        stands = own is not None and abs(own.speed_mps) <= OWN_STANDSTILL_MPS
        return stands and net_way_m(self._motion) is None

    def see(self, own: ObjectState) -> None:
        """Take the newest own state."""
        self.newest = own
        if own.is_finite:
            self._motion.see(own)

    def judge(
        self, own: ObjectState, *, asked_mps: float, may_move: bool, running: bool
    ) -> list[LimitViolation]:
        """List what the newest own state passes, judged by those before it.

        Args:
            own: the state that was seen last.
            asked_mps: see ``ssp_core.safety.limits.follow``.
            may_move: the object moves or is about to.
            running: the object is RUNNING.
        """
        memory = self._continuity if may_move else self._continuity.before_motion(own)
        self._continuity, broken = follow(memory, own, self._limits, asked_mps)
        if (contradicts := state_contradicts(self._motion)) is not None:
            broken.append(contradicts)
        if (turned := self._heading_violation(own, running=running)) is not None:
            broken.append(turned)
        return broken

    def _heading_violation(self, own: ObjectState, *, running: bool) -> LimitViolation | None:
        """Judge how far the object faces off its start's heading, once its first metre shows it."""
        if self._heading is None or not own.is_finite:
            return None
        if not running:
            self._heading.clear()
            return None
        return self._heading.see(own, stands=is_standing(own, self._motion))
