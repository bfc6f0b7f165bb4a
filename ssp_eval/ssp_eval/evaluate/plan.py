"""What a campaign is about to ask, told before anything is asked: questions may cost money."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ssp_eval.evaluate.labelled import LabelledClip
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_eval.labels.comparable import compare_by_scenario

NO_CONTROLS = "--no-controls"


@dataclass(frozen=True)
class Plan:
    """How much there is to ask; what is stored already is counted too.

    Args:
        label_times: of all cells, also of those that are refused and not asked.
        cells: that are asked.
        questions: to all models.
        to_answerers: of these, to the harness's own answerers.
        spoilt: of these, to models that are asked once more under a condition.
        goes_on: some may have an answer that is stored, and isn't asked for again.
        label_lines: per scenario how many labels each phase has, and whether the domains compare
            (METHOD 5.2b).
    """

    label_times: int
    cells: int
    questions: int
    to_answerers: int
    spoilt: int
    goes_on: bool = False
    label_lines: tuple[str, ...] = field(default=(), compare=False)

    def line(self, leave_out: str = NO_CONTROLS) -> str:
        """The plan for people.

        Args:
            leave_out: what leaves the controls out.
        """
        text = f"{_count(self.cells, 'cell')}, {_count(self.questions, 'question')}"
        if self.goes_on:
            text += " (those with a stored answer are counted and not asked again)"
        controls = self.to_answerers + self.spoilt
        if not controls:
            return text
        parts = []
        if self.spoilt:
            parts.append(f"{self.spoilt} to the models once more, with spoilt frames")
        if self.to_answerers:
            parts.append(f"{self.to_answerers} to answerers of our own")
        what = ", ".join(parts)
        return f"{text}; of these {controls} for controls: {what} ({leave_out} leaves them out)"


def plan_of(
    clips: Sequence[LabelledClip], models: Sequence[ModelSpec], goes_on: bool = False
) -> Plan:
    """What a campaign will ask.

    Args:
        clips: with their labels.
        models: who is asked, controls included.
        goes_on: the campaign has answers already, and they count.
    """
    compared = compare_by_scenario(
        (clip.labels.scenario, clip.labels.domain, clip.labels) for clip in clips
    )
    label_times = sum(len(clip.labels.labels) for clip in clips)
    asked = [clip for clip in clips if clip.refusal is None]
    each = sum(len(clip.labels.labels) for clip in asked)
    return Plan(
        label_times=label_times * len(models),
        cells=len(asked) * len(models),
        questions=each * len(models),
        to_answerers=each * sum(model.answerer for model in models),
        spoilt=each * sum(bool(model.condition) for model in models),
        goes_on=goes_on,
        label_lines=tuple(f"{name}: {found.line}" for name, found in compared.items()),
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
