"""The scores of a cell when its labels are drawn with replacement (METHOD 6.2 to 6.10).

A label with its record is what is drawn. It keeps what it was in the recording: its terms, and
whether a risk response begins with it (METHOD 6.9), which depends on the candidates that follow it
there. Neighbours aren't drawn apart, since a gap that only the drawing made would say nothing of
the model.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssp_eval.analysis.resample import Numbers, weighted_sums
from ssp_eval.score.aggregate import METRICS
from ssp_eval.score.ivcs import ivcs_weights
from ssp_eval.score.terms import RecordTerms
from ssp_eval.score.thresholds import DEFAULT, Thresholds

# Per metric its column of sums and that of its denominator.
_SUMS = (
    "n", "evaluable", "given", "hard", "soft", "interactions", "interactions_correct",
    "output_valid", "action_correct", "feasible", "trajectory_correct", "consistent",
)  # fmt: skip
_RATIOS = {
    "jovr": ("output_valid", "n"),
    "sem_cov": ("given", "evaluable"),
    "sem_acc_cond": ("hard", "given"),
    "sem_acc_eff": ("hard", "evaluable"),
    "sem_acc_soft": ("soft", "evaluable"),
    "cia_eff": ("interactions_correct", "interactions"),
    "act_acc_eff": ("action_correct", "n"),
    "stfr": ("feasible", "n"),
    "tqsr": ("trajectory_correct", "n"),
    "atc_eff": ("consistent", "n"),
}


def response_begins(terms: RecordTerms, thresholds: Thresholds = DEFAULT) -> np.ndarray:
    """Which labels begin a risk response in the recording (METHOD 6.9).

    Returns:
        (N,) true where K consecutive candidates, the first of them this label's record, are
        defensive with each gap > 0 and ≤ the limit.
    """
    places = np.flatnonzero(terms.candidate)
    defensive, t_s = terms.defensive[places], terms.record_t_s[places]
    gap_s = np.diff(t_s)
    linked = (gap_s > 0) & thresholds.at_most(gap_s, thresholds.response_gap_s)
    begins = np.zeros(len(terms), dtype=np.bool_)
    for i in range(len(places) - thresholds.response_count + 1):
        end = i + thresholds.response_count
        begins[places[i]] = bool(defensive[i:end].all() and linked[i : end - 1].all())
    return begins


def resampled_scores(
    terms: RecordTerms, weights: Numbers, thresholds: Thresholds = DEFAULT
) -> dict[str, Numbers]:
    """All scores of METHOD 6.14 with each label counted as often as it was drawn.

    RSR* = 1 if a label that begins a response was drawn; RL* is that of the earliest one drawn.

    Args:
        terms: of a cell.
        weights: (B, N).
        thresholds: that the cell was scored with.

    Returns:
        By metric (B,); NaN where a denominator is 0, which counts as 0 in IVCS (METHOD 6.11).
    """
    ones = np.ones(len(terms))
    columns = (
        ones, terms.evaluable.sum(1), terms.given.sum(1), terms.hard.sum(1), terms.soft.sum(1),
        terms.interaction_evaluable, terms.interaction_correct, terms.output_valid,
        terms.action_correct, terms.feasible, terms.trajectory_correct, terms.consistent,
    )  # fmt: skip
    totals = weighted_sums(weights, np.column_stack(columns).astype(np.float64))
    sums = dict(zip(_SUMS, totals, strict=True))
    found: dict[str, Numbers] = {}
    for metric, (over, under) in _RATIOS.items():
        found[metric] = np.full(len(weights), np.nan)
        np.divide(sums[over], sums[under], out=found[metric], where=sums[under] > 0)
    response_s = np.full(len(weights), np.nan)
    for place in reversed(np.flatnonzero(response_begins(terms, thresholds))):
        response_s[weights[:, place] > 0] = terms.record_t_s[place]
    found["rsr"] = (~np.isnan(response_s)).astype(np.float64)
    found["rl_s"] = np.maximum(response_s - terms.risk_onset_s, 0.0)
    found["ivcs"] = weighted_ivcs(found)
    return {metric: found[metric] for metric in METRICS}


def weighted_ivcs(scores: Mapping[str, Numbers]) -> Numbers:
    """IVCS of arrays of components (METHOD 6.10), NaN as 0."""
    total = np.zeros_like(scores["rsr"])
    for name, weight in ivcs_weights().items():
        total += weight * np.nan_to_num(scores[name])
    return total
