"""The triggers of one run that may still fire.

This file owns which state of the VUT they were judged at last, and what came of it;
``triggers.evaluator`` says when one fires. Reads no clock.
"""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TriggerSpec
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.triggers.conditions import Snapshot
from ssp_scenario_manager.triggers.evaluator import Firing, TriggerWatch


class OpenTriggers:
    """A run's triggers; before ``start`` there are none.

    Attributes:
        late_states: states of the VUT that came too late for them.
        failed: the violation of one that fired and had nothing to send.
    """

    def __init__(self, spec: RunSpec) -> None:
        self.late_states = 0
        self.failed: Violation | None = None
        self._spec = spec
        self._watches: list[TriggerWatch] = []
        self._evaluated_ns = -1

    def start(self, path: Polyline, now_ns: int) -> None:
        """Begin to watch all triggers.

        Args:
            path: the VUT's planned path, frame map.
            now_ns: session time, that of the start of the run.
        """
        self._watches = [TriggerWatch(t, path, now_ns) for t in self._spec.triggers]

    def has_evaluated(self, vut: ObjectState) -> bool:
        """Tell whether a state of the VUT is no newer than the last one."""
        return vut.stamp_ns <= self._evaluated_ns

    def is_in_time(self, vut: ObjectState, now_ns: int) -> bool:
        """Take a state of the VUT as the last one; False, and counted, if it is too old."""
        self._evaluated_ns = vut.stamp_ns
        if now_ns - vut.stamp_ns > seconds_to_ns(self._spec.trigger_age_s):
            self.late_states += 1
            return False
        return True

    def firings(self, snapshot: Snapshot) -> Iterator[tuple[TriggerSpec, Firing]]:
        """Yield the triggers that fire at a snapshot, each as soon as it was judged."""
        stamp_ns = snapshot.stamp_ns
        for watch in self._watches:
            # Said here too: of two hundred triggers few are open, and every call takes its time.
            if watch.fired or stamp_ns < watch.begin_ns:
                continue
            firing = watch.observe(snapshot)
            if firing is not None:
                yield watch.spec, firing
