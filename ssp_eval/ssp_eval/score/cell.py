"""The scores of one cell, scenario × domain × model, with what a report needs beside them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord, Slot
from ssp_eval.score.columns import NOTHING, Cell, encode
from ssp_eval.score.engine import SLOTS, LabelTerms, Value, batch_terms, responses, score_terms
from ssp_eval.score.metrics import CellMetrics, ivcs_terms
from ssp_eval.score.thresholds import DEFAULT, Thresholds

# The chain of METHOD 6.12, in its order.
STAGES = (
    "output_validity",
    "semantics",
    "critical_interaction",
    "action_commitment",
    "trajectory_quality",
    "consistency",
    "risk_response",
)


# What h of a slot is that isn't missing or wrong: right, or not asked.
_RIGHT = (1.0, None)


@dataclass(frozen=True)
class SlotScore:
    """One slot at one label.

    Args:
        evaluable: e of METHOD 6.3.
        given: z, the record gives a value with evidence.
        h: 0..1, 0 where nothing is given, None where the slot isn't evaluable.
        s: as h, with credit for adjacent classes.
        answer: the value that the record gives with evidence.
    """

    evaluable: bool
    given: bool
    h: float | None
    s: float | None
    answer: Value | None
    truth: Value | None


class Judgement(NamedTuple):
    """One label with the output that was matched to it; a missing output fails everything.

    Args:
        label_t_s: clip time of the label, s.
        record: index of the matched record, None if there is none.
        record_t_s: its clip time, s.
        text_valid: v_txt (5.3).
        trajectory_valid: v_trj (5.3).
        slots: e, z, h, s and the values of the four semantic slots (6.3).
        interaction_evaluable: E (6.4).
        interaction_correct: C (6.4), False where E = 0.
        text_lon, text_lat: the actions that the text commits to with evidence, or None (6.5).
        trajectory_lon, trajectory_lat: the inferred actions, None if v_trj = 0 (6.6).
        feasible: F (6.6), None if v_trj = 0.
        action_correct: the term of ActAcc_eff (6.5).
        feasible_valid: the term of STFR (6.7).
        trajectory_correct: the term of TQSR (6.7).
        consistent: the term of ATC_eff (6.8).
        candidate: a candidate for the risk response (6.9).
        defensive: slows down where that is right (6.9), candidate or not.
        first_failure: the first stage of 6.12 that fails, None if none does.
    """

    label_t_s: float
    record: int | None
    record_t_s: float | None
    text_valid: bool
    trajectory_valid: bool
    slots: dict[str, SlotScore]
    interaction_evaluable: bool
    interaction_correct: bool
    text_lon: str | None
    text_lat: str | None
    trajectory_lon: str | None
    trajectory_lat: str | None
    feasible: bool | None
    action_correct: bool
    feasible_valid: bool
    trajectory_correct: bool
    consistent: bool
    candidate: bool
    defensive: bool
    first_failure: str | None


@dataclass(frozen=True)
class CellDetails:
    """The details with which a report walks from a score back to the outputs behind it.

    Args:
        judgements: one per label, in time order.
        record_labels: per record, the index of its label, None for an unmatched record.
        risk_onset_s: t_r (6.9), clip time, s.
        response_record: index of the record that begins the response (6.9), None if none does.
        ivcs_terms: what each component adds to IVCS (6.10), by its key in the score output.
        ivcs_nulls: components that are null and count as 0 in IVCS (6.11); to be flagged.
        first_failures: per stage of 6.12, how many labels fail there first.
        thresholds_sha256: hash of the thresholds (6.11).
    """

    judgements: tuple[Judgement, ...]
    record_labels: tuple[int | None, ...]
    risk_onset_s: float
    response_record: int | None
    ivcs_terms: dict[str, float]
    ivcs_nulls: tuple[str, ...]
    first_failures: dict[str, int]
    thresholds_sha256: str

    @property
    def unmatched_records(self) -> tuple[int, ...]:
        """Indices of the records that belong to no label and are ignored (6.1)."""
        return tuple(i for i, label in enumerate(self.record_labels) if label is None)


@dataclass(frozen=True)
class CellScore(CellMetrics):
    """The metrics of a cell with what a report needs beside them."""

    details: CellDetails


def score_cell(
    labels: Labels, records: Sequence[BehaviourRecord], thresholds: Thresholds = DEFAULT
) -> CellScore:
    """Score a model's outputs on one clip (METHOD 6).

    Args:
        labels: what is true, N ≥ 1 labels in time order, with a risk onset.
        records: the model's outputs.
        thresholds: METHOD's unless others are given.
    """
    return score_in_detail([(labels, records)], thresholds)[0]


def score_in_detail(cells: Sequence[Cell], thresholds: Thresholds = DEFAULT) -> list[CellScore]:
    """Score many cells at once, with details; see score_cell."""
    if not cells:
        return []
    terms = batch_terms(encode(cells), thresholds)
    metrics = score_terms(terms, thresholds).cells()
    names = [item.name for item in fields(LabelTerms) if item.name != "risk_onset_s"]
    rows = [
        dict(zip(names, row, strict=True))
        for row in zip(*[getattr(terms.rows, name).tolist() for name in names], strict=True)
    ]
    starts = terms.start.tolist()
    first_record = 0
    scores = []
    for (labels, records), values, start, end, response in zip(
        cells, metrics, starts, starts[1:], responses(terms, thresholds).tolist(), strict=False
    ):
        judgements = tuple(
            _judgement(label, records, row, first_record)
            for label, row in zip(labels.labels, rows[start:end], strict=True)
        )
        begun = None if response == NOTHING else judgements[response - start].record
        scores.append(_in_detail(labels, records, values, judgements, begun, thresholds))
        first_record += len(records)
    return scores


def _in_detail(
    labels: Labels,
    records: Sequence[BehaviourRecord],
    metrics: CellMetrics,
    judgements: tuple[Judgement, ...],
    response_record: int | None,
    thresholds: Thresholds,
) -> CellScore:
    values = {item.name: getattr(metrics, item.name) for item in fields(CellMetrics)}
    components = ivcs_terms(values, thresholds)
    label_of = {item.record: index for index, item in enumerate(judgements)}
    failures = Counter(item.first_failure for item in judgements)
    return CellScore(
        **values,
        details=CellDetails(
            judgements=judgements,
            record_labels=tuple(label_of.get(index) for index in range(len(records))),
            risk_onset_s=labels.risk_onset_s,
            response_record=response_record,
            ivcs_terms=components,
            ivcs_nulls=tuple(name for name in components if values[name] is None),
            first_failures={stage: failures[stage] for stage in STAGES},
            thresholds_sha256=thresholds.sha256,
        ),
    )


def _judgement(
    label: Label, records: Sequence[BehaviourRecord], row: dict[str, Any], first_record: int
) -> Judgement:
    """Return the judgement of a label from its row of the terms.

    Args:
        label: what is true.
        records: of the cell.
        row: the label's terms by name.
        first_record: the row of the cell's first record.
    """
    index = None if row["record"] == NOTHING else row["record"] - first_record
    record = None if index is None else records[index]
    answers = {
        name: slot.value if code != NOTHING and slot is not None else None
        for name, code, slot in _slots(record, row["answer"])
    }
    slots = {
        name: SlotScore(
            evaluable,
            answers[name] is not None,
            hard if evaluable else None,
            soft if evaluable else None,
            answers[name],
            getattr(label, name),
        )
        for name, evaluable, hard, soft in zip(
            SLOTS, row["evaluable"], row["hard"], row["soft"], strict=True
        )
    }
    # In the order of STAGES, whether each stage holds.
    stage_outcomes = (
        row["output_valid"],
        all(slot.h in _RIGHT for slot in slots.values()),
        row["interaction_correct"] or not row["interaction_evaluable"],
        row["action_correct"],
        row["trajectory_correct"],
        row["consistent"],
        row["defensive"] or not row["candidate"],
    )
    valid = row["trajectory_valid"]
    return Judgement(
        label_t_s=label.t_s,
        record=index,
        record_t_s=record.t_s if record is not None else None,
        text_valid=row["text_valid"],
        trajectory_valid=valid,
        slots=slots,
        interaction_evaluable=row["interaction_evaluable"],
        interaction_correct=row["interaction_correct"],
        text_lon=_word(answers["lon_action"]),
        text_lat=_word(answers["lat_action"]),
        trajectory_lon=LON_ACTIONS[row["lon"]] if valid else None,
        trajectory_lat=LAT_ACTIONS[row["lat"]] if valid else None,
        feasible=row["feasible"] if valid else None,
        action_correct=row["action_correct"],
        feasible_valid=row["feasible"],
        trajectory_correct=row["trajectory_correct"],
        consistent=row["consistent"],
        candidate=row["candidate"],
        defensive=row["defensive"],
        first_failure=None if all(stage_outcomes) else STAGES[stage_outcomes.index(False)],
    )


def _slots(
    record: BehaviourRecord | None, codes: Sequence[int]
) -> Iterator[tuple[str, int, Slot | None]]:
    for name, code in zip(SLOT_NAMES, codes, strict=True):
        yield name, code, None if record is None else getattr(record.slots, name)


def _word(answer: Value | None) -> str | None:
    """Return the word that a text commits to; a set of objects is none."""
    return answer if isinstance(answer, str) else None
