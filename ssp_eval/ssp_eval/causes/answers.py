"""The answers of a model to a question, and to the same one with one cause changed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord
from ssp_eval.evaluate.clients.models import CONDITIONS, REPEAT
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.score.cell import Judgement
from ssp_eval.twins.changes import BY_AMOUNT, MOVED, Kind
from ssp_vla_bridge.trajectory import Trajectory

TWIN, PICTURES, REASONING = "twin", "pictures", "reasoning"
FAMILIES = (TWIN, PICTURES, REASONING)
_STRENGTHS = {"1": ", weak", "2": ", strong"}


@dataclass(frozen=True)
class Cause:
    """The changed cause, whichever object it is about and whatever class replaces it.

    Args:
        family: of its condition; black and shuffled are of the pictures.
        kind: of a twin one of Kind; the control of each family has the same word.
        amount: of a shift, a delay, a share or a strength, as the condition's name has it.
    """

    family: str
    kind: str
    amount: str = ""

    @property
    def key(self) -> str:
        """Such as ``twin.shift.m0500``."""
        return ".".join(part for part in (self.family, self.kind, self.amount) if part)

    @property
    def is_control(self) -> bool:
        """A change that must not matter."""
        return self.kind == Kind.CONTROL

    @property
    def of_object(self) -> bool:
        """It changes one object of the scene that matters."""
        return self.family == TWIN and self.kind in MOVED

    @property
    def order(self) -> tuple[int, int, str]:
        """The object first, then the pictures, the own history, the own text."""
        family = FAMILIES.index(self.family)
        return family, 0 if self.of_object else 2 if self.kind == Kind.HISTORY else 1, self.key

    @property
    def words(self) -> str:
        """Describe the cause for people."""
        amount = float(re.sub(r"\D", "", self.amount) or 0) / 1000
        if self.family == PICTURES:
            name = "frames decoded and encoded again" if self.is_control else self.kind
            return name.replace("_", " ") + _STRENGTHS.get(self.amount, "")
        if self.family == REASONING:
            how = "as it was" if self.is_control else f"{self.kind.replace('_', ' ')} turned"
            return f"own text given back, {how}"
        words: dict[str, str] = {
            Kind.WITHOUT: "without the object",
            Kind.CLASS: "another class in its place",
            Kind.MIRROR: "object on the other side",
            Kind.SHIFT: f"object {amount:g} s {'earlier' if self.amount[:1] == 'm' else 'later'}",
            Kind.CONTROL: "a distant, irrelevant object",
            Kind.CAMERA: f"frames from {amount:g} s earlier",
            Kind.HISTORY: f"own history at {amount:g} of the speed",
        }
        return words.get(self.kind, self.key)


def cause_of(condition: str) -> Cause | None:
    """Return the cause of a condition's name; None: it is none that is compared here."""
    if condition in CONDITIONS:
        return Cause(PICTURES, condition)
    family, _, rest = condition.partition(".")
    kind, *more = rest.split(".")
    if family not in FAMILIES or not kind:
        return None
    by_amount = family != TWIN or kind in BY_AMOUNT
    return Cause(family, kind, more[-1] if more and by_amount else "")


@dataclass(frozen=True)
class Answer:
    """One answer.

    Args:
        slots: in the order of SLOT_NAMES, given with evidence; None where the text says nothing.
        trajectory: None unless it is valid (METHOD 5.4).
        driven: longitudinal and lateral action of the trajectory (METHOD 6.6).
    """

    slots: tuple[str | frozenset[str] | None, ...]
    trajectory: Trajectory | None
    driven: tuple[str | None, str | None]

    @property
    def agrees(self) -> bool | None:
        """Tell whether text and trajectory state the same actions; None where one states none.

        The share of True among all label times is ATC_eff (METHOD 6.8).
        """
        text_actions = self.slots[-2:]
        if None in text_actions or self.trajectory is None:
            return None
        return text_actions == self.driven


@dataclass(frozen=True)
class CellAnswers:
    """One cell: a recording's answers under one condition.

    Args:
        campaign: folder that it lies in; runs of different campaigns are compared each by itself.
        recording: which one it is, whatever the campaign.
        answers: by label time, s; None: there is none.
    """

    campaign: str
    recording: str
    scenario: str
    domain: str
    model: str
    condition: str
    answers: Mapping[float, Answer | None]

    @property
    def place(self) -> tuple[str, str, str, str]:
        """Return the identity that its factual cell, twins and controls share."""
        return self.campaign, self.scenario, self.domain, self.model


def comparable_cells(folders: Iterable[str]) -> frozenset[str]:
    """Return the names of the cells to compare: changed questions, and their factual ones.

    Args:
        folders: names of all cells' folders.
    """
    pairs = [(name.rpartition("+")[0], name) for name in folders]
    bases = {
        base
        for base, name in pairs
        if base and name.rpartition("+")[2].partition(".")[0] in FAMILIES
    }
    return frozenset(name for base, name in pairs if base in bases or name in bases)


def answers_of_cell(cell: CellData) -> CellAnswers | None:
    """Collect the answers of a cell; None: it has no answers, or isn't compared."""
    facts, condition = cell.facts, cell.facts.condition
    is_comparable = condition in ("", REPEAT) or cause_of(condition) is not None
    if cell.score is None or not is_comparable:
        return None
    out = cell.folder.parent.parent
    answers = {
        judgement.label_t_s: _answer(judgement, cell.records)
        for judgement in cell.score.details.judgements
    }
    return CellAnswers(
        campaign=str(out),
        recording=facts.hashes.get("bag") or f"{cell.scenario} {cell.domain}",
        scenario=cell.scenario,
        domain=cell.domain,
        model=cell.model.removesuffix(f"+{condition}") if condition else cell.model,
        condition=condition,
        answers=answers,
    )


def _answer(judgement: Judgement, records: Sequence[BehaviourRecord]) -> Answer | None:
    if judgement.record is None:
        return None
    record, slot_scores = records[judgement.record], judgement.slots
    semantic = [slot_scores[name].answer for name in SLOT_NAMES[:4]]
    slots = [frozenset(v) if isinstance(v, tuple) else v for v in semantic]
    return Answer(
        slots=(*slots, judgement.text_lon, judgement.text_lat),
        trajectory=record.trajectory if judgement.trajectory_valid else None,
        driven=(judgement.trajectory_lon, judgement.trajectory_lat),
    )
