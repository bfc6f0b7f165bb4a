"""How long a manager waits: for objects to arm, and for a standstill that nobody may report.

Times are steady-clock nanoseconds and are given; nothing here reads a clock.
"""

from __future__ import annotations

from collections.abc import Mapping

from ssp_core import names
from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.vigil import Vigil

ARM_CONFIRMATION_S = 3.0
ABORT_STANDSTILL_S = 15.0
# Nobody waits for the standstill of what has not been heard for this long.
SILENT_S = 1.0


class Patience:
    """Since when the session arms or aborts."""

    def __init__(self) -> None:
        self._arming_since_ns: int | None = None
        self._aborting_since_ns: int | None = None

    def arms(self, steady_ns: int) -> None:
        """The objects were told to arm."""
        self._arming_since_ns = steady_ns

    def not_armed(
        self,
        spec: RunSpec,
        state: SessionPhase,
        targets: Mapping[str, ObjectState],
        steady_ns: int,
    ) -> str | None:
        """Why the session can't stay armed; None while there is nothing to say, or time left."""
        if self._arming_since_ns is None:
            return None
        waiting = [
            target.id
            for target in spec.targets
            if (known := targets.get(target.id)) is None
            or known.control_state is not ControlState.ARMED
        ]
        if not waiting or state is not SessionPhase.ARMED:
            self._arming_since_ns = None
        elif steady_ns - self._arming_since_ns > ARM_CONFIRMATION_S * NS_PER_S:
            self._arming_since_ns = None
            return f"{', '.join(waiting)} did not arm in {ARM_CONFIRMATION_S:g} s"
        return None

    def standstill_unconfirmed(
        self, session: Session, vigil: Vigil, steady_ns: int, now_ns: int
    ) -> bool:
        """A dead world can't report a standstill; the result must still be given.

        Args:
            session: that may be aborting.
            vigil: who was heard when.
            steady_ns: now, on the vigil's clock.
            now_ns: session time.
        """
        if session.state is not SessionPhase.ABORTING:
            self._aborting_since_ns = None
            return False
        if self._aborting_since_ns is None:
            self._aborting_since_ns = steady_ns
        waited_s = (steady_ns - self._aborting_since_ns) / NS_PER_S
        # The world was silent while it waited for a participant that died; it goes on after that.
        spec = session.spec
        has_world = spec is None or spec.mode != "live"
        world_age_s = vigil.age_s(names.SIL_WORLD, steady_ns)
        world_dead = has_world and min(world_age_s, waited_s) > SILENT_S
        ids = [t.id for t in spec.targets] if spec else []
        silent = [i for i in ids if vigil.age_s(i, steady_ns) > SILENT_S]
        others_stand = bool(silent) and session.stands(now_ns, without=silent)
        return world_dead or others_stand or waited_s > ABORT_STANDSTILL_S
