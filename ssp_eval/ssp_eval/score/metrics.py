"""The metrics of METHOD 6.14 as one table, their ratios and IVCS (METHOD 6.10, 6.11)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ssp_eval.score.columns import Numbers, Whole
from ssp_eval.score.thresholds import DEFAULT, Thresholds

Role = Literal["component", "shown", "diagnostic", "behind", "response", "sum"]


@dataclass(frozen=True)
class Metric:
    """One metric of a cell.

    Records, rows, CSV lines, tables and intervals have it by this entry. One with new terms needs
    them in ssp_eval.score.engine.LabelTerms too, and a component needs a weight in Thresholds.

    Args:
        section: of METHOD.
        meaning: what it says, for people who read a column of it.
        role: component of IVCS; shown among the components in tables, or as a diagnostic score
            after IVCS; behind: in files alone; response: beside the risk; sum: IVCS itself.
        numerator, denominator: terms whose sums over the labels are divided, fields of
            ssp_eval.score.engine.LabelTerms, or LABELS; empty where the metric is no ratio.
        unit: s, or empty for a share of 1.
    """

    name: str
    section: str
    label: str
    meaning: str
    role: Role
    numerator: str = ""
    denominator: str = ""
    unit: str = ""


# A denominator that counts the labels.
LABELS = "labels"
METRICS = (
    Metric("jovr", "6.2", "JOVR", "valid text and trajectory", "component", "output_valid", LABELS),
    Metric("sem_cov", "6.3", "SemCov", "answered semantic slots", "shown", "given", "evaluable"),
    Metric(
        "sem_acc_cond",
        "6.3",
        "SemAcc cond",
        "accuracy of answered slots",
        "behind",
        "hard",
        "given",
    ),
    Metric(
        "sem_acc_eff",
        "6.3",
        "SemAcc",
        "effective accuracy of the semantic slots",
        "component",
        "hard",
        "evaluable",
    ),
    Metric(
        "sem_acc_soft",
        "6.3",
        "SemAcc soft",
        "the same, near ones half",
        "behind",
        "soft",
        "evaluable",
    ),
    Metric(
        "cia_eff",
        "6.4",
        "CIA",
        "critical interaction accuracy",
        "component",
        "interaction_correct",
        "interaction_evaluable",
    ),
    Metric(
        "act_acc_eff",
        "6.5",
        "ActAcc",
        "admissible actions in the text (diagnostic)",
        "diagnostic",
        "action_correct",
        LABELS,
    ),
    Metric(
        "stfr",
        "6.7",
        "STFR",
        "feasible trajectories (diagnostic)",
        "diagnostic",
        "feasible",
        LABELS,
    ),
    Metric(
        "tqsr",
        "6.7",
        "TQSR",
        "feasible trajectory with an admissible action",
        "component",
        "trajectory_correct",
        LABELS,
    ),
    Metric(
        "atc_eff",
        "6.8",
        "ATC",
        "text and trajectory agree (diagnostic)",
        "diagnostic",
        "consistent",
        LABELS,
    ),
    Metric("rsr", "6.9", "RSR", "risk response", "component"),
    Metric("rl_s", "6.9", "RL (s)", "latency of the risk response", "response", unit="s"),
    Metric("ivcs", "6.10", "IVCS", "weighted sum of the components", "sum"),
)
BY_NAME = {metric.name: metric for metric in METRICS}
METRIC_NAMES = tuple(BY_NAME)
METRIC_LABELS = {metric.name: metric.label for metric in METRICS}


def of_role(*roles: Role) -> tuple[str, ...]:
    """Return the names of the metrics that have one of these roles."""
    return tuple(metric.name for metric in METRICS if metric.role in roles)


# What IVCS is made of (METHOD 6.10), IVCS before and after it, and what stands beside it.
COMPONENTS, DIAGNOSTIC = of_role("component"), of_role("diagnostic")
IVCS_FIRST, IVCS_LAST = ("ivcs", *COMPONENTS), (*COMPONENTS, "ivcs")
RATIOS = tuple(metric for metric in METRICS if metric.numerator)
# The components that stand in columns of scores; the response has a column of its own.
COMPONENT_RATIOS = tuple(metric.name for metric in RATIOS if metric.role == "component")
SUMMED = tuple(dict.fromkeys(x for m in RATIOS for x in (m.numerator, m.denominator)))


def ratio(sums: np.ndarray, denominators: np.ndarray) -> Numbers:
    """Return Σ / denominator, NaN where the denominator is 0 (METHOD 6.11)."""
    result = np.full(len(sums), np.nan)
    np.divide(sums, denominators, out=result, where=denominators > 0)
    return result


def ratios(sums: Mapping[str, np.ndarray]) -> dict[str, Numbers]:
    """Return all metrics that are ratios, from the sums of their terms by name."""
    return {m.name: ratio(sums[m.numerator], sums[m.denominator]) for m in RATIOS}


def ivcs_weights(thresholds: Thresholds = DEFAULT) -> dict[str, float]:
    """Return the weight of each component of IVCS by its key in the score output (METHOD 6.10)."""
    return {name: getattr(thresholds, f"weight_{name}") for name in COMPONENTS}


def ivcs_terms(
    components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT
) -> dict[str, float]:
    """Compute what each component adds to IVCS (METHOD 6.10); a null one adds 0 (METHOD 6.11).

    Args:
        components: ``jovr``, ``sem_acc_eff``, ``cia_eff``, ``tqsr`` and ``rsr``, each 0..1 or None;
            others are ignored.
        thresholds: for the weights.
    """
    return {
        name: weight * (components[name] or 0.0)
        for name, weight in ivcs_weights(thresholds).items()
    }


def ivcs(components: Mapping[str, float | None], thresholds: Thresholds = DEFAULT) -> float:
    """Return IVCS of components that are given alone; a cell's is made by score_terms.

    IVCS = 0.10 JOVR + 0.30 SemAcc_eff + 0.20 CIA_eff + 0.30 TQSR + 0.10 RSR (METHOD 6.10).
    """
    return math.fsum(ivcs_terms(components, thresholds).values())


def exact_sum(columns: Sequence[Numbers]) -> Numbers:
    """Return the sum of arrays, item by item, rounded once as math.fsum does it.

    What an addition loses is itself a number, which is summed beside. Scores lie in 0..1 and are
    no multiples of tiny numbers, so that a sum of losses loses nothing.
    """
    total, lost = columns[0], np.zeros_like(columns[0])
    for column in columns[1:]:
        after = total + column
        added = after - total
        lost += (total - (after - added)) + (column - added)
        total = after
    result: Numbers = total + lost
    return result


def exact_totals(column: Numbers, start: Whole) -> Numbers:
    """Return the sum of each cell's terms, see exact_sum.

    Args:
        column: (L, 4), one row per label.
        start: (C + 1,) where a cell's labels begin.
    """
    length = np.diff(start)
    result = np.empty(len(length))
    for count in np.unique(length).tolist():
        cells = np.flatnonzero(length == count)
        rows = column[start[cells] + np.arange(count)[:, None]]
        result[cells] = exact_sum([*np.moveaxis(rows, 2, 1).reshape(-1, len(cells))])
    return result


_DENOMINATORS = ("semantic", "cia")


@dataclass(frozen=True)
class CellMetrics:
    """The metrics of a cell by the keys of METHOD 6.14; None where a denominator is 0.

    The fields between ``matched`` and the denominators are those of METRICS, in their order.
    """

    n: int
    matched: int
    jovr: float | None
    sem_cov: float | None
    sem_acc_cond: float | None
    sem_acc_eff: float | None
    sem_acc_soft: float | None
    cia_eff: float | None
    act_acc_eff: float | None
    stfr: float | None
    tqsr: float | None
    atc_eff: float | None
    rsr: int
    rl_s: float | None
    ivcs: float | None
    semantic_denominator: int
    cia_denominator: int

    def to_json(self) -> dict[str, Any]:
        """Give the score output of METHOD 6.14: its keys, in its order, nothing rounded."""
        return {
            **{name: getattr(self, name) for name in ("n", "matched", *METRIC_NAMES)},
            "denominators": {n: getattr(self, f"{n}_denominator") for n in _DENOMINATORS},
        }
