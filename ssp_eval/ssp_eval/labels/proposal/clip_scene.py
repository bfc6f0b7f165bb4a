"""What doesn't change over a clip, and what is seen in it from the VUT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.motion.state import ObjectState
from ssp_eval.labels.proposal.basis import ProposalRules, Truth
from ssp_eval.recordings.crop import TOLERANCE_S
from ssp_eval.recordings.geometry import Corridor, in_view, is_hidden
from ssp_eval.recordings.phases import Event


@dataclass(frozen=True)
class ClipScene:
    """What doesn't change over a clip."""

    truth: Truth
    rules: ProposalRules
    event: Event
    corridor: Corridor
    standing: frozenset[str]

    def hides(self, now: dict[str, ObjectState], by: str | None = None) -> bool:
        """True when other objects, or that one alone, hide the critical OT."""
        critical = now.get(self.event.object_id)
        if critical is None:
            return False
        vut_id = self.truth.vut_id
        others = [
            state
            for object_id, state in now.items()
            if object_id not in (vut_id, self.event.object_id) and by in (None, object_id)
        ]
        return is_hidden(now[vut_id], critical, others)

    def sees(self, now: dict[str, ObjectState], object_id: str) -> bool:
        """True when an object is in the camera's field and range and not hidden."""
        vut_id, rules = self.truth.vut_id, self.rules
        if object_id not in now or vut_id not in now:
            return False
        hfov_rad = rules.hfov_rad if self.truth.hfov_rad is None else self.truth.hfov_rad
        if not in_view(now[vut_id], now[object_id], hfov_rad, rules.range_m):
            return False
        others = [s for key, s in now.items() if key not in (vut_id, object_id)]
        return not is_hidden(now[vut_id], now[object_id], others)

    def risk_s(self, series: Sequence[tuple[float, dict[str, ObjectState]]]) -> float:
        """The trigger, or the first instant after it at which nothing hides the critical OT."""
        for t_s, now in series:
            after = t_s >= self.event.trigger_s - TOLERANCE_S
            if after and self.truth.vut_id in now and not self.hides(now):
                return t_s
        return self.event.trigger_s
