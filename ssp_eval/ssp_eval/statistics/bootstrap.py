"""Bootstrap intervals of scores over blocks of labels, and of means over cells, runs, scenarios."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from ssp_eval.score.aggregate import Mean, mean
from ssp_eval.score.engine import LabelTerms, response_begins
from ssp_eval.score.metrics import METRIC_NAMES, SUMMED, ivcs_weights, ratios
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_eval.statistics.comparisons import Clip, LabelDifferences, Pair, compared_metrics
from ssp_eval.statistics.resampling import (
    NO_INTERVAL,
    Interval,
    NanMean,
    Numbers,
    bca_shares,
    block_draws,
    block_of,
    cluster_interval,
    generator,
    intervals,
    percentile_shares,
    reach,
    resampled_sums,
    weighted_sums,
    without_blocks,
)
from ssp_eval.statistics.rows import CellRow


def resampled_scores(
    terms: LabelTerms, weights: Numbers, thresholds: Thresholds = DEFAULT
) -> dict[str, Numbers]:
    """Compute all scores of METHOD 6.14 with each label counted as often as it was drawn.

    RSR* = 1 if a label that begins a response was drawn; RL* is that of the earliest one drawn.

    Args:
        terms: of a cell's N labels.
        weights: (B, N).
        thresholds: of the scores.

    Returns:
        By metric (B,); NaN where a denominator is 0, which counts as 0 in IVCS (METHOD 6.11).
    """
    columns = np.column_stack([terms.term(name) for name in SUMMED]).astype(np.float64)
    scores = ratios(dict(zip(SUMMED, weighted_sums(weights, columns), strict=True)))
    response_s = np.full(len(weights), np.nan)
    for place in reversed(np.flatnonzero(response_begins(terms, thresholds))):
        response_s[weights[:, place] > 0] = terms.record_t_s[place]
    scores["rsr"] = (~np.isnan(response_s)).astype(np.float64)
    scores["rl_s"] = np.maximum(response_s - terms.risk_onset_s, 0.0)
    scores["ivcs"] = weighted_ivcs(scores)
    return {metric: scores[metric] for metric in METRIC_NAMES}


def weighted_ivcs(scores: Mapping[str, Numbers]) -> Numbers:
    """Return IVCS of arrays of components (METHOD 6.10), NaN as 0."""
    total = np.zeros_like(scores["rsr"])
    for name, weight in ivcs_weights().items():
        total += weight * np.nan_to_num(scores[name])
    return total


RESAMPLES = 10_000
SEED = 20_260_101


@dataclass(frozen=True)
class Estimate:
    """A score with its intervals.

    Args:
        value: unrounded, null as None.
        n: how many items were drawn from: labels, runs, cells or scenarios; of a mean whose
            labels were drawn, its cells.
        percentile, bca: 95 % intervals.
        null_share: resamples in which the score has no denominator.
        unit: what was drawn, for people.
        student: Student's interval over the units, where these are runs, cells or scenarios.
    """

    value: float | None
    n: int
    percentile: Interval = NO_INTERVAL
    bca: Interval = NO_INTERVAL
    bias: float | None = None
    null_share: float = 0.0
    unit: str = ""
    student: Interval = NO_INTERVAL


def cell_estimates(
    terms: LabelTerms,
    samples: Mapping[str, Numbers],
    block: int = 1,
    thresholds: Thresholds = DEFAULT,
) -> dict[str, Estimate]:
    """Estimate intervals of a cell's scores over its labels.

    Args:
        terms: of the cell's labels.
        samples: resampled scores by metric, (B,).
        block: how many labels were drawn together.
        thresholds: of the scores.
    """
    n = len(terms)
    values = resampled_scores(terms, np.ones((1, n)), thresholds)
    left_out = resampled_scores(terms, without_blocks(n, block), thresholds) if n > 1 else None
    return {
        metric: estimated(
            samples[metric],
            _nullable(values[metric][0]),
            n,
            np.array([]) if left_out is None else left_out[metric],
            n / block,
            label_unit({block}),
        )
        for metric in METRIC_NAMES
    }


def label_unit(blocks: Collection[int]) -> str:
    """Describe what is drawn where labels are, with the lengths of blocks there are."""
    lengths = sorted(set(blocks))
    if lengths == [1]:
        return "labels"
    return f"labels, in blocks of {' or '.join(map(str, lengths))}"


def _nullable(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def estimated(
    samples: Numbers,
    value: float | None,
    n: int,
    jackknife: Numbers,
    items: float,
    unit: str,
) -> Estimate:
    """Return a score with its intervals; none of fewer than two labels or other units.

    Args:
        samples: resampled scores, (B,).
        value: the score; None: null.
        n: what to say that was drawn from.
        jackknife: the score with each item, or each block of items, left out.
        items: units that don't overlap.
        unit: name of what was drawn, in the plural.
    """
    if value is None or n < 2:
        return Estimate(value, n, unit=unit)
    return _estimate(samples, Mean(value, n), reach(items), unit, (jackknife, items))


Group = tuple[str, ...]


@dataclass(frozen=True)
class Bootstrap:
    """Intervals over labels: of each cell, and of the means of groups of cells.

    Args:
        cells: by scenario, domain, model and run, then by metric.
        groups: by grouping (such as ``("model",)``) and its values, then by metric; n counts
            cells.
        differences: of each two models, first less second by name, and metric.
    """

    cells: dict[tuple[str, ...], dict[str, Estimate]]
    groups: dict[Group, dict[Group, dict[str, Estimate]]]
    differences: dict[tuple[Pair, str], Interval] = field(default_factory=dict)


def bootstrap_records(
    cells: Sequence[tuple[CellRow, LabelTerms]],
    groupings: Sequence[Group],
    resamples: int = RESAMPLES,
    seed: int = SEED,
    on_cell: Callable[[], None] = lambda: None,
    block: int | None = None,
    thresholds: Thresholds = DEFAULT,
) -> Bootstrap:
    """Resample the labels of every clip and average the cells.

    The cells of a scenario and domain with as many labels are drawn alike, whatever the model and
    run: they share the label times, and a repetition brings no new ones.

    Args:
        cells: those that enter means, with their terms; the runs of a cell are averaged before
            it enters a group.
        groupings: see ssp_eval.score.aggregate; one that has the domain leaves out what isn't
            admitted.
        resamples: how many, B.
        seed: of the random numbers; the order of the cells makes no difference.
        on_cell: called after each cell.
        block: labels that are drawn together; None: as block_of has it for each clip.
        thresholds: of the scores.
    """
    estimates_by_cell: dict[tuple[str, ...], dict[str, Estimate]] = {}
    sums = {by: _GroupSums(by, resamples) for by in groupings}
    differences = LabelDifferences(compared_metrics({row.model for row, _ in cells}), resamples)
    in_order = sorted(cells, key=lambda one: (*one[0].key, one[0].run))
    scenario = ""
    for key, group in groupby(in_order, key=lambda one: one[0].key):
        if key[0] != scenario:
            scenario = key[0]
            for total in sums.values():
                total.end_scenario()
        runs = []
        rows = []
        clips: dict[Clip, int] = {}
        for row, terms in group:
            count = len(terms)
            length = block_of(count, block)
            weights = block_draws(count, length, resamples, clip_generator(seed, row, count))
            samples = resampled_scores(terms, weights, thresholds)
            estimates = cell_estimates(terms, samples, length, thresholds)
            estimates_by_cell[(*key, row.run)] = estimates
            runs.append((samples, estimates))
            rows.append(row)
            clips[(row.scenario, row.domain, count)] = length
            on_cell()
        cell_samples, scores = _over_runs(runs)
        for total in sums.values():
            total.add(rows, clips, cell_samples, scores)
        differences.add(key[2], clips, cell_samples)
    groups = {by: total.estimates() for by, total in sums.items()}
    return Bootstrap(estimates_by_cell, groups, differences.intervals())


def clip_generator(seed: int, row: CellRow, count: int) -> np.random.Generator:
    """Return random numbers to draw from a cell's labels, the same for all cells of a clip."""
    return generator(seed, "records", row.scenario, row.domain, str(count))


def _over_runs(
    runs: Sequence[tuple[Mapping[str, Numbers], Mapping[str, Estimate]]],
) -> tuple[Mapping[str, Numbers], dict[str, float | None]]:
    """Return samples and scores of a cell: those of its one run, or the means over its runs."""
    values = {m: mean(estimates[m].value for _, estimates in runs).value for m in METRIC_NAMES}
    if len(runs) == 1:
        return runs[0][0], values
    averaged = {}
    for metric in METRIC_NAMES:
        over = NanMean.of(len(runs[0][0][metric]))
        for samples, _ in runs:
            over.add(samples[metric])
        averaged[metric] = over.mean
    return averaged, values


class _GroupSums:
    """Sums over the cells of each group, resample by resample, so that none need be kept."""

    def __init__(self, by: Group, resamples: int) -> None:
        self._by, self._resamples = by, resamples
        self._sums: dict[Group, list[NanMean]] = {}
        self._values: dict[Group, list[list[float]]] = {}
        self._clips: dict[Group, dict[Clip, int]] = {}
        self._ended: dict[Group, dict[str, Estimate]] = {}

    def end_scenario(self) -> None:
        """Release the sums of a scenario's own groups: cells of a scenario come together."""
        if "scenario" in self._by:
            self._ended |= self._estimates()
            for mapping in (self._sums, self._values, self._clips):
                mapping.clear()

    def add(
        self,
        runs: Sequence[CellRow],
        clips: Mapping[Clip, int],
        samples: Mapping[str, Numbers],
        scores: Mapping[str, float | None],
    ) -> None:
        if "domain" in self._by and not all(row.admitted for row in runs):
            return
        key = tuple(getattr(runs[0], name) for name in self._by)
        self._clips.setdefault(key, {}).update(clips)
        if key not in self._sums:
            self._sums[key] = [NanMean.of(self._resamples) for _ in METRIC_NAMES]
        values = self._values.setdefault(key, [[] for _ in METRIC_NAMES])
        for i, metric in enumerate(METRIC_NAMES):
            self._sums[key][i].add(samples[metric])
            if (value := scores[metric]) is not None:
                values[i].append(value)

    def estimates(self) -> dict[Group, dict[str, Estimate]]:
        return dict(sorted((self._ended | self._estimates()).items()))

    def _estimates(self) -> dict[Group, dict[str, Estimate]]:
        estimates: dict[Group, dict[str, Estimate]] = {}
        for key in sorted(self._sums):
            clips = self._clips[key]
            items = sum(count / block for (*_, count), block in clips.items())
            ends, unit = reach(items, len(clips)), label_unit(clips.values())
            estimates[key] = {}
            for i, metric in enumerate(METRIC_NAMES):
                over = mean(self._values[key][i])
                estimates[key][metric] = _estimate(self._sums[key][i].mean, over, ends, unit)
        return estimates


def _estimate(
    samples: Numbers,
    over: Mean,
    ends: float | None,
    unit: str,
    left_out: tuple[Numbers, float] | None = None,
) -> Estimate:
    """Return a score with its intervals by resamples.

    Args:
        samples: resampled scores, (B,).
        over: the score.
        ends: see percentile_interval.
        unit: of what was drawn.
        left_out: jackknife and items of bca_interval; None: there is no such interval.
    """
    if over.value is None:
        return Estimate(None, over.n, unit=unit)
    null = np.isnan(samples)
    present = samples[~null] if null.any() else samples
    null_share = (len(samples) - len(present)) / len(samples)
    bias = None
    if len(present):
        # nanmean gives the same number, in twice the time.
        middle = samples.mean() if present is samples else np.nanmean(samples)
        bias = float(middle - over.value)
    bca = None
    if left_out is not None:
        bca = bca_shares(present, over.value, left_out[0], ends, left_out[1])
    percentile, accelerated = intervals(present, percentile_shares(ends), bca)
    return Estimate(over.value, over.n, percentile, accelerated, bias, null_share, unit)


def bootstrap_mean(
    values: Mapping[str, Sequence[float]],
    unit: str,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    *names: str,
) -> Estimate:
    """Return the mean of all values with its intervals, where whole clusters of them are drawn.

    Args:
        values: by cluster, such as a scenario's cells, or a run's one score; there are no
            intervals of fewer than two clusters.
        unit: what a cluster is, in the plural.
        resamples: how many, B.
        seed: of the random numbers.
        *names: distinguish draws with one seed.
    """
    clusters = [values[name] for name in sorted(values)]
    sums = np.array([math.fsum(one) for one in clusters])
    sizes = np.array([len(one) for one in clusters], dtype=np.float64)
    n = len(clusters)
    if n < 2:
        return Estimate(float(sums[0] / sizes[0]) if n else None, n, unit=unit)
    rng = generator(seed, *names)
    total, count = resampled_sums(np.column_stack((sums, sizes)), resamples, rng)
    left_out = (sums.sum() - sums) / (sizes.sum() - sizes)
    value = float(sums.sum() / sizes.sum())
    estimate = estimated(total / count, value, n, left_out, n, unit)
    return replace(estimate, student=cluster_interval(sums.tolist(), sizes.tolist()))
