"""The newest states of everybody, and who has been heard since the last abort."""

from __future__ import annotations

from dataclasses import dataclass, field

from ssp_core.motion.state import ObjectState
from ssp_scenario_manager.core.run import Run


@dataclass
class Known:
    """What a session knows of its objects.

    Args:
        vut: newest state of the VUT.
        targets: newest states of the object targets by id.
        heard: ids of those who have sent a state; emptied by an abort.
    """

    vut: ObjectState | None = None
    targets: dict[str, ObjectState] = field(default_factory=dict)
    heard: set[str] = field(default_factory=set)

    def take_vut(self, state: ObjectState, run: Run | None, *, in_order: bool) -> bool:
        """Takes a state of the VUT; see take_target."""
        if run is not None and state.object_id != run.spec.vut.id:
            return False
        if _replaces(self.vut, state, in_order):
            self.vut = state
        self._note(state, run)
        return True

    def take_target(self, state: ObjectState, run: Run | None, *, in_order: bool) -> bool:
        """Takes a state of an object target.

        Args:
            state: of one object.
            run: that is loaded.
            in_order: a run lasts, so that a state older than what is known is dropped. Otherwise
                what came last is the truth: a clock that was wrong must not outlast its correction.

        Returns:
            False for a state of an object that the run doesn't know; nothing has happened then.
        """
        if run is not None and not run.has_target(state.object_id):
            return False
        if _replaces(self.targets.get(state.object_id), state, in_order):
            self.targets[state.object_id] = state
        self._note(state, run)
        return True

    def forget_ahead(self, latest_ns: int) -> None:
        """Forgets states with a later stamp: a clock that was wrong would outlast its correction.

        Args:
            latest_ns: stamp of the latest state that may still be believed.
        """
        if self.vut is not None and self.vut.stamp_ns > latest_ns:
            self.vut = None
        for object_id in [i for i, s in self.targets.items() if s.stamp_ns > latest_ns]:
            del self.targets[object_id]

    def _note(self, state: ObjectState, run: Run | None) -> None:
        self.heard.add(state.object_id)
        if run is not None:
            run.see(state)


def _replaces(known: ObjectState | None, state: ObjectState, in_order: bool) -> bool:
    return known is None or state.stamp_ns >= known.stamp_ns or not in_order
