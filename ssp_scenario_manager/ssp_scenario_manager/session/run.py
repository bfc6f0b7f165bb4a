"""One run of a session, made of the parts that own its state; a session loads another one anew."""

from __future__ import annotations

from functools import cached_property

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.session.dispatches import Dispatches
from ssp_scenario_manager.session.event_course import EventCourse
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.local_stops import LocalStops
from ssp_scenario_manager.session.open_triggers import OpenTriggers
from ssp_scenario_manager.session.state_history import StateHistory
from ssp_scenario_manager.session.verdict import RunVerdict


def blind_text(limits: Limits) -> str:
    """Describe how far an object may drive before it knows that its link is cut."""
    return (
        f"blind distance on link loss: {limits.speed_mps * limits.heartbeat_s:.1f} m "
        f"({limits.speed_mps:g} m/s for {limits.heartbeat_s:g} s)"
    )


class Run:
    """A run from its loading on: its file, its path and clock, and its parts.

    Args:
        path: the VUT's planned path, frame map.
        loaded_ns: session time.

    Attributes:
        started_ns: session time; None before the start.
        armed: its objects were commanded to arm.
        evaluated_ns: stamp of the VUT's newest state that phases and adaptation were judged at.
    """

    def __init__(self, spec: RunSpec, path: Polyline, loaded_ns: int = 0) -> None:
        self.spec = spec
        self.path = path
        self.loaded_ns = loaded_ns
        self.started_ns: int | None = None
        self.armed = False
        self.evaluated_ns = -1
        self.verdict = RunVerdict()
        self.history = StateHistory(spec)
        self.triggers = OpenTriggers(spec)
        self.dispatches = Dispatches(spec)
        self.event = EventCourse(spec, path)
        self.local_stops = LocalStops()

    @cached_property
    def target_ids(self) -> frozenset[str]:
        """Ids of the object targets."""
        return frozenset(target.id for target in self.spec.targets)

    def elapsed_s(self, now_ns: int) -> float:
        """Return the session time since the start, 0 before it."""
        return self._time_s(now_ns) or 0.0

    def _time_s(self, now_ns: int) -> float | None:
        return None if self.started_ns is None else ns_to_seconds(now_ns - self.started_ns)

    @property
    def blind_text(self) -> str:
        """Return blind_text of this run."""
        return blind_text(self.spec.limits)

    def start(self, now_ns: int) -> None:
        """Start the run's clock, and watch its triggers."""
        self.started_ns = now_ns
        self.triggers.start(self.path, now_ns)

    def see(self, state: ObjectState) -> None:
        """Judge a state that arrived by those before it."""
        self.history.see(state, started=self.started_ns is not None)

    def blame(self, violation: Violation) -> bool:
        """Take a limit that was passed as a reason of the verdict; the first one gives it.

        Returns:
            False when this limit of this object is a reason already.
        """
        return self.verdict.blame(violation, self._time_s(violation.stamp_ns))

    def reason(self, verdict: Verdict, text: str, now_ns: int) -> None:
        """Add a reason with its time in the run; the verdict is that of the first."""
        self.verdict.add(verdict, text, self._time_s(now_ns))

    def end_early(self, requested_by: str, now_ns: int) -> None:
        """Note that a run that ends before its event is resolved isn't valid."""
        if self.event.resolved_ns is None:
            reached = self.event.phase.name.lower()
            text = f"stopped by {requested_by} before resolution, in {reached}"
            self.reason(Verdict.ABORTED, text, now_ns)
