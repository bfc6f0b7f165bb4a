"""A clip with the labels that it is scored against."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_eval.evaluate.admission import NO_AUDIT, Admission
from ssp_eval.evaluate.clip import Clip
from ssp_eval.labels.model import Labels


@dataclass(frozen=True)
class LabelledClip:
    """A clip with its labels, ready to be asked about.

    Args:
        clip: open.
        labels: of this clip.
        labels_source: where they come from, for people.
        proposed: made from privileged states and not reviewed since.
        admission: what the audit says of the recording.
    """

    clip: Clip
    labels: Labels
    labels_source: str
    proposed: bool
    admission: Admission = NO_AUDIT

    @property
    def name(self) -> str:
        """Scenario and domain as they stand in the cell's folder name."""
        return f"{self.labels.scenario}__{self.labels.domain}"

    @property
    def refusal(self) -> str | None:
        """Why this recording can't be scored against these labels; None when it can."""
        facts = self.clip.provenance
        if facts.refusal is not None:
            return facts.refusal
        if self.admission.refusal is not None:
            return self.admission.refusal
        if facts.event_version not in (None, self.labels.event_version):
            return (
                f"the labels are for event version {self.labels.event_version}, the recording "
                f"realises {facts.event_version}"
            )
        crop = self.clip.crop
        outside = [x.t_s for x in self.labels.labels if crop is not None and not crop.holds(x.t_s)]
        if crop is not None and outside:
            return (
                f"the label at {outside[0]:g} s lies outside the clip that the audit compared, "
                f"{crop.start_s:.3f} to {crop.end_s:.3f} s; `ssp labels new` plans labels inside it"
            )
        return None
