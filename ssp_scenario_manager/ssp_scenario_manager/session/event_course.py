"""Course of the event of one run: its phases, its resolution, and a driven VUT's contact.

This file owns the present phase and when each one began; ``ssp_core.motion.event`` defines them.
Reads no clock.
"""

from __future__ import annotations

from collections.abc import Mapping

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, boxes_overlap
from ssp_core.motion.event import PhaseBegan, PhaseWatch, next_phase
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Phase
from ssp_core.world.scenery import SceneryBodies

# A driven run goes on for so long after the VUT's first contact (METHOD 8.2).
AFTER_CONTACT_S = 1.0


class EventCourse:
    """The course of a run's event.

    Args:
        spec: the run.
        path: the VUT's planned path, frame map.

    Attributes:
        phase_starts: the stamp at which each phase began.
        resolved_ns: stamp of the VUT's state that confirmed the resolution; None before it.
    """

    def __init__(self, spec: RunSpec, path: Polyline) -> None:
        self._spec = spec
        self._path = path
        self._watch = PhaseWatch()
        self.phase_starts: dict[Phase, int] = {}
        self.resolved_ns: int | None = None
        self._contact_ns: int | None = None  # of a driven VUT, the first one
        has_bodies = spec.driven is not None and spec.road.scenery
        self._scenery = SceneryBodies(spec.road) if has_bodies else None

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self._watch.phase

    def judge(self, vut: ObjectState, targets: Mapping[str, ObjectState]) -> PhaseBegan | None:
        """Judge the phases on the states of the VUT and of the OT whose manoeuvre is the event."""
        state = targets.get(self._spec.initiator_id)
        if state is None:
            return None
        self._watch, began = next_phase(
            self._watch,
            vut,
            state.extrapolated(vut.stamp_ns),
            self._path,
            self._spec.thresholds,
            self._spec.observable,
        )
        if began is None:
            return None
        self.phase_starts[began.phase] = began.stamp_ns
        if began.phase is Phase.RESOLUTION:
            self.resolved_ns = vut.stamp_ns
        return began

    def note_contact(self, vut: ObjectState, targets: Mapping[str, ObjectState]) -> None:
        """Remember the first contact of a driven VUT, which ends its run."""
        if self._spec.driven is None or self._contact_ns is not None or not vut.is_finite:
            return
        box = vut.box
        others = [state.extrapolated(vut.stamp_ns) for state in targets.values() if state.is_finite]
        touches = any(boxes_overlap(box, other.box) for other in others)
        if touches or (self._scenery is not None and self._scenery.touched_by(box) is not None):
            self._contact_ns = vut.stamp_ns

    def is_complete(self, now_ns: int, elapsed_s: float) -> bool:
        """Tell whether the event was resolved long enough ago.

        Conditions of K* don't end a driven run: it ends after its first contact, or at T_end.

        Args:
            now_ns: session time.
            elapsed_s: since the start of the run, s.
        """
        if self._spec.driven is not None:
            touched_ns = self._contact_ns
            if touched_ns is not None and now_ns - touched_ns >= seconds_to_ns(AFTER_CONTACT_S):
                return True
            return elapsed_s >= self._spec.driven.end_s - 1e-9
        wait_ns = seconds_to_ns(self._spec.end.after_resolution_s)
        return self.resolved_ns is not None and now_ns - self.resolved_ns >= wait_ns
