"""The objects of one run that stopped by themselves, and the time that each has to say why.

This file owns since when each has been heard to abort, and the refusals that its stop may explain.
Reads no clock.
"""

from __future__ import annotations

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.session.limits import Violation

OWN_REASON_S = 0.1


class LocalStops:
    """Stops by objects themselves, which their own safety events should explain."""

    def __init__(self) -> None:
        self._since_ns: dict[str, int] = {}
        # Refusals of objects that had left RUNNING; their own word for that may be on its way.
        self._refused: dict[str, Violation] = {}

    def take_refusal(self, refused: Violation) -> None:
        """Take an object's refusal to drive, which its stop may explain; the first one counts."""
        self._refused.setdefault(refused.object_id, refused)

    def own_abort(self, state: ObjectState, now_ns: int, *, started: bool) -> Violation | None:
        """Find an object that stopped by itself.

        In a run that has started it may first say why, by a safety event.
        """
        if state.control_state is not ControlState.ABORTING:
            return None
        since = self._since_ns.setdefault(state.object_id, now_ns)
        if started and now_ns - since < seconds_to_ns(OWN_REASON_S):
            return None
        return Violation(
            SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, "local stop"
        )

    def unexplained(self, state: ObjectState, now_ns: int) -> Violation | None:
        """Find an unexplained refusal of an object that isn't running.

        It counts after the object's time to explain it.
        """
        refused = self._refused.get(state.object_id)
        if refused is None or state.control_state is ControlState.ABORTING:
            return None
        waited_s = ns_to_seconds(now_ns - refused.stamp_ns)
        return None if waited_s < OWN_REASON_S else refused
