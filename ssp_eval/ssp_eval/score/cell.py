"""The scores of one cell, scenario × domain × model (METHOD 6.2 to 6.14)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from operator import and_
from typing import Any

from ssp_eval.data.labels import Labels
from ssp_eval.data.records import BehaviourRecord
from ssp_eval.score.judge import (
    STAGES,
    Candidate,
    Judgement,
    Response,
    find_response,
    judge,
    ratio,
    semantic_ratios,
)
from ssp_eval.score.matching import match
from ssp_eval.score.thresholds import DEFAULT, Thresholds


def ivcs_weights(thresholds: Thresholds = DEFAULT) -> dict[str, float]:
    """The weight of each component of IVCS by its key in the score output (METHOD 6.10)."""
    return {
        "jovr": thresholds.weight_jovr,
        "sem_acc_eff": thresholds.weight_sem_acc_eff,
        "cia_eff": thresholds.weight_cia_eff,
        "tqsr": thresholds.weight_tqsr,
        "rsr": thresholds.weight_rsr,
    }


def ivcs_terms(
    components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT
) -> dict[str, float]:
    """What each component adds to IVCS (METHOD 6.10); a null one adds 0 (METHOD 6.11).

    Args:
        components: ``jovr``, ``sem_acc_eff``, ``cia_eff``, ``tqsr`` and ``rsr``, each 0..1 or None;
            others are ignored.
        thresholds: the weights.
    """
    return {
        name: weight * (components[name] or 0.0)
        for name, weight in ivcs_weights(thresholds).items()
    }


def ivcs(components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT) -> float:
    """IVCS = 0.10 JOVR + 0.30 SemAcc_eff + 0.20 CIA_eff + 0.30 TQSR + 0.10 RSR (METHOD 6.10).

    Args:
        components: see ivcs_terms.
        thresholds: the weights.
    """
    return math.fsum(ivcs_terms(components, thresholds).values())


@dataclass(frozen=True)
class CellDetails:
    """What a report needs to walk from a score back to the outputs behind it.

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
class CellMetrics:
    """The metrics of a cell by the keys of METHOD 6.14; None where a denominator is 0."""

    n: int
    matched: int
    jovr: float
    sem_cov: float | None
    sem_acc_cond: float | None
    sem_acc_eff: float | None
    sem_acc_soft: float | None
    cia_eff: float | None
    act_acc_eff: float
    stfr: float
    tqsr: float
    atc_eff: float
    rsr: int
    rl_s: float | None
    ivcs: float
    semantic_denominator: int
    cia_denominator: int

    def to_json(self) -> dict[str, Any]:
        """The score output of METHOD 6.14: its keys, in its order, nothing rounded."""
        return {
            "n": self.n,
            "matched": self.matched,
            "jovr": self.jovr,
            "sem_cov": self.sem_cov,
            "sem_acc_cond": self.sem_acc_cond,
            "sem_acc_eff": self.sem_acc_eff,
            "sem_acc_soft": self.sem_acc_soft,
            "cia_eff": self.cia_eff,
            "act_acc_eff": self.act_acc_eff,
            "stfr": self.stfr,
            "tqsr": self.tqsr,
            "atc_eff": self.atc_eff,
            "rsr": self.rsr,
            "rl_s": self.rl_s,
            "ivcs": self.ivcs,
            "denominators": {"semantic": self.semantic_denominator, "cia": self.cia_denominator},
        }


@dataclass(frozen=True)
class CellScore(CellMetrics):
    """The metrics of a cell with what a report needs beside them."""

    details: CellDetails


def score_cell(
    labels: Labels, records: Sequence[BehaviourRecord], thresholds: Thresholds = DEFAULT
) -> CellScore:
    """Scores a model's outputs on one clip (METHOD 6).

    Args:
        labels: what is true, N ≥ 1 labels in time order, with a risk onset.
        records: the outputs in time order, any number.
        thresholds: all limits and weights.
    """
    pairing = match([x.t_s for x in labels.labels], [x.t_s for x in records], thresholds)
    risk_onset_s = labels.risk_onset_s
    judgements = _judgements(labels, records, pairing, risk_onset_s, thresholds)
    n = len(judgements)

    # By attribute, those of all labels.
    every = dict(zip(Judgement._fields, zip(*judgements, strict=True), strict=True))
    semantics = semantic_ratios([slot for slots in every["slots"] for slot in slots.values()])
    interactions = list(compress(every["interaction_correct"], every["interaction_evaluable"]))
    response = _response(judgements, risk_onset_s, thresholds)
    jovr = sum(map(and_, every["text_valid"], every["trajectory_valid"])) / n
    tqsr = sum(every["trajectory_correct"]) / n
    components = {
        "jovr": jovr,
        "sem_acc_eff": semantics.accuracy_effective,
        "cia_eff": ratio(sum(interactions), len(interactions)),
        "tqsr": tqsr,
        "rsr": float(response.success),
    }
    terms = ivcs_terms(components, thresholds)
    failures = Counter(every["first_failure"])
    label_of = {record: label for label, record in enumerate(pairing) if record is not None}
    return CellScore(
        n=n,
        matched=len(label_of),
        jovr=jovr,
        sem_cov=semantics.coverage,
        sem_acc_cond=semantics.accuracy_conditional,
        sem_acc_eff=semantics.accuracy_effective,
        sem_acc_soft=semantics.accuracy_soft,
        cia_eff=components["cia_eff"],
        act_acc_eff=sum(every["action_correct"]) / n,
        stfr=sum(every["feasible_valid"]) / n,
        tqsr=tqsr,
        atc_eff=sum(every["consistent"]) / n,
        rsr=response.success,
        rl_s=response.latency_s,
        ivcs=math.fsum(terms.values()),
        semantic_denominator=semantics.evaluable,
        cia_denominator=len(interactions),
        details=CellDetails(
            judgements=judgements,
            record_labels=tuple(label_of.get(i) for i in range(len(records))),
            risk_onset_s=risk_onset_s,
            response_record=response.record,
            ivcs_terms=terms,
            ivcs_nulls=tuple(name for name, value in components.items() if value is None),
            first_failures={stage: failures[stage] for stage in STAGES},
            thresholds_sha256=thresholds.sha256,
        ),
    )


def _judgements(
    labels: Labels,
    records: Sequence[BehaviourRecord],
    pairing: Sequence[int | None],
    risk_onset_s: float,
    thresholds: Thresholds,
) -> tuple[Judgement, ...]:
    return tuple(
        judge(
            label,
            records[index] if index is not None else None,
            index,
            dynamics_masked=j == 0 and not labels.first_frame_dynamics,
            risk_onset_s=risk_onset_s,
            thresholds=thresholds,
        )
        for j, (label, index) in enumerate(zip(labels.labels, pairing, strict=True))
    )


def _response(
    judgements: Sequence[Judgement], risk_onset_s: float, thresholds: Thresholds
) -> Response:
    candidates = [
        Candidate(item.record, item.record_t_s, item.defensive)
        for item in judgements
        if item.candidate and item.record is not None and item.record_t_s is not None
    ]
    return find_response(candidates, risk_onset_s, thresholds)
