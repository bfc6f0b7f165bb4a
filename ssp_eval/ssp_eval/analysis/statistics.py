"""All statistics of a set of cells: from rows alone, and from records where there are any."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ssp_eval.analysis.bootstrap import (
    RESAMPLES,
    SEED,
    Bootstrap,
    Estimate,
    Group,
    bootstrap_records,
)
from ssp_eval.analysis.clusters import bootstrap_mean
from ssp_eval.analysis.compare import Comparison, compare
from ssp_eval.analysis.curvature import Curve, curves
from ssp_eval.analysis.resample import NO_INTERVAL
from ssp_eval.analysis.row import OK, CellRow, entering, one_scale, over_what
from ssp_eval.analysis.sensitivity import (
    GRID,
    Variation,
    WeightSamples,
    sample_weights,
    vary_thresholds,
    vary_weights,
)
from ssp_eval.analysis.stability import Stability, stability
from ssp_eval.report.load import CellData
from ssp_eval.score.aggregate import BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL
from ssp_eval.score.encode import encode
from ssp_eval.score.terms import record_terms

SUBJECTS = ("model", "domain")
GROUPINGS = (BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL)


@dataclass(frozen=True)
class Options:
    """What random numbers depend on.

    Args:
        resamples: of every bootstrap, and sets of weights.
        seed: of all random numbers.
        block: labels that are drawn together; None: ssp_eval.analysis.blocks.block_of.
    """

    resamples: int = RESAMPLES
    seed: int = SEED
    block: int | None = None


@dataclass(frozen=True)
class Beside:
    """The curvature diagnostic at a label, beside the lateral action.

    Args:
        curve: of the recorded path.
        allowed: lateral actions of the label.
        planned: what METHOD 6.6 reads in the model's trajectory, None without a valid one.
    """

    curve: Curve
    allowed: tuple[str, ...]
    planned: str | None


@dataclass(frozen=True)
class Statistics:
    """What ``statistics.json`` holds.

    Args:
        records: intervals over records; None where only component scores are known.
        over_cells: mean IVCS by grouping and group, its interval over the cells, and over their
            scenarios where these differ from cells.
        comparisons: of domains, then of models.
        weights: ranks under random weights, per subject that has at least two names.
        variations: one number changed at a time; thresholds only where records are known.
        runs: how repetitions differ; None without any.
        curves: per cell and run the curvature diagnostic beside the lateral action.
    """

    records: Bootstrap | None
    over_cells: dict[Group, dict[Group, tuple[Estimate, ...]]]
    comparisons: tuple[Comparison, ...]
    weights: tuple[WeightSamples, ...]
    variations: tuple[Variation, ...]
    runs: Stability | None
    curves: dict[tuple[str, ...], tuple[Beside, ...]]


def steps_of(rows: Sequence[CellRow], has_records: bool) -> int:
    """How often compute calls on_step."""
    valid = [row for row in one_scale(rows) if row.status == OK and not row.control]
    from_records = len(valid) + sum(map(len, GRID.values())) if has_records and valid else 0
    return from_records + len(SUBJECTS)


def compute(
    rows: Sequence[CellRow],
    data: Sequence[CellData] = (),
    options: Options = Options(),
    on_step: Callable[[], None] = lambda: None,
) -> Statistics:
    """Everything that the cells allow.

    Args:
        rows: of one or several runs.
        data: the cells themselves in the order of the rows, none where they aren't known.
        options: seed and resamples.
        on_step: called steps_of times.
    """
    chosen = entering(rows)
    over = over_what(rows)
    alike = one_scale(rows)
    kept = {id(row) for row in alike if row.status == OK and not row.control}
    pairs = [(row, cell) for row, cell in zip(rows, data, strict=bool(data)) if id(row) in kept]
    comparisons: list[Comparison] = []
    weights: list[WeightSamples] = []
    variations: list[Variation] = []
    for subject in SUBJECTS:
        on_step()
        if subject in over:
            continue
        comparisons += compare(chosen, subject, options.seed)
        sampled = sample_weights(chosen, subject, options.seed, options.resamples)
        if sampled is not None:
            weights.append(sampled)
            variations += vary_weights(chosen, subject)
    records = None
    if pairs:
        with_terms = [(row, record_terms(cell.score)) for row, cell in pairs if cell.score]
        thresholds = pairs[0][1].thresholds
        records = bootstrap_records(
            with_terms, GROUPINGS, options.resamples, options.seed, on_step, options.block,
            thresholds,
        )  # fmt: skip
        comparisons = [
            replace(
                one,
                over_labels=records.differences.get(
                    ((one.first, one.second), one.metric), NO_INTERVAL
                ),
            )
            if one.subject == "model"
            else one
            for one in comparisons
        ]
        first = _first_runs(pairs)
        columns = encode([(cell.labels, cell.records) for _, cell in first])
        variations += vary_thresholds(
            [row for row, _ in first], columns, SUBJECTS, on_step, thresholds
        )
    return Statistics(
        records,
        {by: _over_cells(chosen, by, options) for by in GROUPINGS if over.isdisjoint(by)},
        tuple(comparisons),
        tuple(weights),
        tuple(variations),
        stability(alike, options.resamples, options.seed),
        _curves(pairs),
    )


def _first_runs(pairs: Sequence[tuple[CellRow, CellData]]) -> list[tuple[CellRow, CellData]]:
    """One run of each cell, the first by name."""
    found: dict[tuple[str, str, str], tuple[CellRow, CellData]] = {}
    for row, cell in sorted(pairs, key=lambda one: (*one[0].key, one[0].run)):
        found.setdefault(row.key, (row, cell))
    return list(found.values())


def _over_cells(
    rows: Sequence[CellRow], by: Group, options: Options
) -> dict[Group, tuple[Estimate, ...]]:
    cells: dict[Group, dict[str, list[float]]] = {}
    scenarios: dict[Group, dict[str, list[float]]] = {}
    for row in rows:
        if row.ivcs is not None and (row.admitted or "domain" not in by):
            key = tuple(getattr(row, name) for name in by)
            cells.setdefault(key, {})["\0".join(row.key)] = [row.ivcs]
            scenarios.setdefault(key, {}).setdefault(row.scenario, []).append(row.ivcs)
    found = {}
    for key in sorted(cells):
        units = [(cells[key], "cells")]
        if 1 < len(scenarios[key]) < len(cells[key]):
            units.append((scenarios[key], "scenarios"))
        found[key] = tuple(
            bootstrap_mean(values, unit, options.resamples, options.seed, unit, *by, *key)
            for values, unit in units
        )
    return found


def _curves(pairs: Sequence[tuple[CellRow, CellData]]) -> dict[tuple[str, ...], tuple[Beside, ...]]:
    """Of each cell, by the time of the label."""
    found: dict[tuple[str, ...], tuple[Beside, ...]] = {}
    for row, cell in pairs:
        if cell.score is None:
            continue
        by_time = {curve.label_t_s: curve for curve in curves(cell.requests)}
        found[(*row.key, row.run)] = tuple(
            Beside(
                by_time.get(label.t_s, Curve(label.t_s)), label.lat_actions, judged.trajectory_lat
            )
            for label, judged in zip(cell.labels.labels, cell.score.details.judgements, strict=True)
        )
    return found
