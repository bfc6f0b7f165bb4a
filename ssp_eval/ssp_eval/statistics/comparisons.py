"""Paired comparisons between domains and between models, with Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from ssp_eval.score.aggregate import EQUAL, Cell
from ssp_eval.score.metrics import IVCS_FIRST
from ssp_eval.statistics.constants import Place
from ssp_eval.statistics.domains import NO_UNITS, finding, no_interval, over_recordings
from ssp_eval.statistics.resampling import (
    NO_INTERVAL,
    Interval,
    NanMean,
    Numbers,
    generator,
    percentile_interval,
    reach,
    sd,
    t_interval,
)
from ssp_eval.statistics.rows import CellRow
from ssp_eval.statistics.table import in_order

TESTED = "ivcs"
# All 2^n signs are tried up to here.
EXACT_PAIRS = 16
FLIPS = 20_000


@dataclass(frozen=True)
class Comparison:
    """Two domains or two models by one metric.

    Args:
        first, second: the two; differences are first less second.
        n: pairs, scenario × the other factor.
        difference: mean of the differences; None without a pair.
        interval: of Student's t, 95 %; over the pairs of two models, over the scenarios of two
            domains, since all pairs of a scenario rest on one recording in each; none of fewer than
            two.
        standardised: the mean over the standard deviation of the differences (d_z).
        favour: share of pairs in which the first one is ahead, equal ones half.
        p: two-sided, of the sign flips; None where it isn't tested or n < 2.
        p_least: the least that p can be with so many pairs that differ; None where p is.
        exact: all signs were tried; else drawn at random.
        p_scenarios: as p, the signs of a scenario's pairs flipped together; None where p is, or
            with fewer than two scenarios.
        p_scenarios_holm: the same after Holm's correction over those of the family that have it.
        over_labels: of two models, 95 %, over the labels of the clips that both have; with one clip
            too, see ssp_eval.statistics.comparisons.
        labels_alone: of two domains, what the best blind constant gains over the same pairs; None
            where it isn't known.
        without_interval: of two domains, why there may be no interval.
    """

    subject: str
    first: str
    second: str
    metric: str
    n: int
    difference: float | None
    interval: Interval = NO_INTERVAL
    standardised: float | None = None
    favour: float | None = None
    p: float | None = None
    p_holm: float | None = None
    p_least: float | None = None
    family: int = 0
    exact: bool = True
    scenarios: int = 0
    p_scenarios: float | None = None
    p_scenarios_holm: float | None = None
    over_labels: Interval = NO_INTERVAL
    labels_alone: float | None = None
    without_interval: str = NO_UNITS

    @property
    def finding(self) -> str:
        """Say what must be read beside a difference of two domains; empty for nothing."""
        if self.subject != "domain":
            return ""
        return finding(self.difference, self.interval, self.labels_alone, self.without_interval)


def compare(
    rows: Sequence[CellRow],
    subject: str,
    seed: int,
    constants: Mapping[Place, Cell] = MappingProxyType({}),
) -> list[Comparison]:
    """Compare every pair of domains or of models; IVCS is tested, its components are described.

    Args:
        rows: that enter means, one per cell; where domains are compared, only those that were
            admitted count, since the audit alone says that they show the same event.
        subject: "domain" or "model".
        seed: of the random signs.
        constants: the best blind constant's cells; empty: they are unknown.
    """
    usable_rows = [row for row in rows if row.admitted or subject != "domain"]
    values: dict[str, dict[tuple[str, str], CellRow]] = {}
    for row in usable_rows:
        other = row.model if subject == "domain" else row.domain
        values.setdefault(getattr(row, subject), {})[(row.scenario, other)] = row
    names = sorted(values, key=lambda name: in_order([name]))
    comparisons = [
        _comparison(subject, first, second, metric, values, seed, constants)
        for metric in IVCS_FIRST
        for first, second in combinations(names, 2)
    ]
    return holm(comparisons)


def _comparison(
    subject: str,
    first: str,
    second: str,
    metric: str,
    values: Mapping[str, Mapping[tuple[str, str], CellRow]],
    seed: int,
    constants: Mapping[Place, Cell],
) -> Comparison:
    differences, gained = [], []
    of_scenario: dict[str, list[float]] = {}
    for place in sorted(values[first].keys() & values[second].keys()):
        a, b = getattr(values[first][place], metric), getattr(values[second][place], metric)
        if a is not None and b is not None:
            differences.append(a - b)
            of_scenario.setdefault(place[0], []).append(a - b)
            if subject == "domain":
                gained.append(_gained(constants, place[0], first, second, metric))
    n, scenarios = len(differences), len(of_scenario)
    if n == 0:
        return Comparison(subject, first, second, metric, 0, None)
    mean, spread = math.fsum(differences) / n, sd(differences)
    ahead = sum(0.5 if abs(d) <= EQUAL else float(d > 0) for d in differences) / n
    is_domain = subject == "domain"
    labels_alone = math.fsum(gained) / n if is_domain else None
    comparison = Comparison(
        subject,
        first,
        second,
        metric,
        n,
        mean,
        over_recordings(of_scenario) if is_domain else t_interval(differences),
        mean / spread if spread is not None and spread > EQUAL else None,
        ahead,
        scenarios=scenarios,
        labels_alone=None if labels_alone is None or math.isnan(labels_alone) else labels_alone,
        without_interval=no_interval(of_scenario),
    )
    if metric != TESTED or n < 2:
        return comparison
    names = (subject, first, second, metric)
    p, least = _flipped(differences, seed, "signs", *names)
    together = [math.fsum(of_one) for of_one in of_scenario.values()]
    p_scenarios = _flipped(together, seed, "scenarios", *names)[0] if scenarios > 1 else None
    exact = len(_differing(differences)) <= EXACT_PAIRS
    return replace(comparison, p=p, p_least=least, exact=exact, p_scenarios=p_scenarios)


def _gained(
    constants: Mapping[Place, Cell], scenario: str, first: str, second: str, metric: str
) -> float:
    """Compute what a scenario's constant gains from the second domain to the first.

    NaN: not known.
    """
    cells = [constants.get((scenario, domain)) for domain in (first, second)]
    values = [None if cell is None else cell.score[metric] for cell in cells]
    a, b = (math.nan if value is None else value for value in values)
    return a - b


def _differing(differences: Sequence[float]) -> list[float]:
    """Return the differences for which a sign matters."""
    return [d for d in differences if abs(d) > EQUAL]


def _flipped(differences: Sequence[float], seed: int, *names: str) -> tuple[float, float]:
    """Return p of the sign flips, and the least possible one, 2^(1 − m) by m pairs that differ."""
    differing = _differing(differences)
    if not differing:
        return 1.0, 1.0
    exact = len(differing) <= EXACT_PAIRS
    p = sign_flip_p(np.array(differing), None if exact else generator(seed, *names))
    return p, 2.0 ** (1 - len(differing)) if exact else 1 / (FLIPS + 1)


def sign_flip_p(differences: Numbers, rng: np.random.Generator | None = None) -> float:
    """Compute the two-sided p of the mean under random signs.

    p = share of sign patterns whose |sum| is at least that observed. With random numbers,
    (1 + those as large) / (1 + patterns drawn), so that it is never 0.

    Args:
        differences: of the n pairs.
        rng: None tries all 2^n patterns.
    """
    n = len(differences)
    observed = abs(math.fsum(differences)) - EQUAL
    if rng is None:
        sums = np.zeros(1)
        for value in differences:
            sums = np.concatenate((sums + value, sums - value))
        return float(np.mean(np.abs(sums) >= observed))
    # The sum with some signs flipped is the whole less twice what is flipped.
    flipped = np.unpackbits(np.frombuffer(rng.bytes((FLIPS * n + 7) // 8), np.uint8))[: FLIPS * n]
    sums = np.einsum("bn,n->b", flipped.reshape(FLIPS, n), differences)
    as_large = int(np.sum(np.abs(differences.sum() - 2 * sums) >= observed))
    return (1 + as_large) / (1 + FLIPS)


def holm(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Add Holm's step-down correction over all comparisons that have a p, and a p_scenarios."""
    corrected = step_down([one.p for one in comparisons])
    of_scenarios = step_down([one.p_scenarios for one in comparisons])
    family = sum(one.p is not None for one in comparisons)
    return [
        replace(one, p_holm=p, p_scenarios_holm=q, family=family if one.p is not None else 0)
        for one, p, q in zip(comparisons, corrected, of_scenarios, strict=True)
    ]


def step_down(values: Sequence[float | None]) -> list[float | None]:
    """Apply Holm's correction: the k-th least p times m − k + 1, never decreasing."""
    present = sorted((p, i) for i, p in enumerate(values) if p is not None)
    p_holm: list[float | None] = [None] * len(values)
    reached = 0.0
    for step, (p, i) in enumerate(present):
        reached = max(reached, min(1.0, p * (len(present) - step)))
        p_holm[i] = reached
    return p_holm


# Of more models than the first number only IVCS is compared, of more than the second nothing: each
# pair and metric keeps a number per resample.
MOST_MODELS, MOST_BY_IVCS = 12, 60

Pair = tuple[str, str]
# Scenario, domain and number of labels: what is drawn alike.
Clip = tuple[str, str, int]


def compared_metrics(models: Collection[str]) -> tuple[str, ...]:
    """Return the metrics whose differences are looked at between so many models."""
    if len(models) > MOST_BY_IVCS:
        return ()
    return IVCS_FIRST if len(models) <= MOST_MODELS else (TESTED,)


@dataclass
class _OverClips:
    """Differences over clips, with the blocks of labels that were drawn from in all of them."""

    differences: NanMean
    blocks: float = 0.0
    clips: int = 0


class LabelDifferences:
    """Sums over clips of the differences of each two models, first less second by name."""

    def __init__(self, metrics: Sequence[str], resamples: int) -> None:
        self._metrics, self._resamples = tuple(metrics), resamples
        self._clip: tuple[Clip, int] | None = None
        self._models: dict[str, Mapping[str, Numbers]] = {}
        self._sums: dict[tuple[Pair, str], _OverClips] = {}

    def add(self, model: str, clips: Mapping[Clip, int], samples: Mapping[str, Numbers]) -> None:
        """Add a model's resampled scores on a clip; all models of a clip come together.

        Args:
            model: its name.
            clips: the clip with the length of its blocks; runs of a cell with different numbers of
                labels aren't drawn alike, and are left out.
            samples: by metric, (B,).
        """
        if not self._metrics:
            return
        clip = next(iter(clips.items())) if len(clips) == 1 else None
        if clip != self._clip:
            self._end_clip()
            self._clip = clip
        if clip is not None:
            self._models[model] = {metric: samples[metric] for metric in self._metrics}

    def _end_clip(self) -> None:
        if self._clip is not None:
            (*_, count), block = self._clip
            for pair in combinations(sorted(self._models), 2):
                first, second = (self._models[name] for name in pair)
                for metric in self._metrics:
                    self._add_pair(pair, metric, first[metric] - second[metric], count / block)
        self._models = {}

    def _add_pair(self, pair: Pair, metric: str, difference: Numbers, blocks: float) -> None:
        if np.isnan(difference).all():
            return
        if (pair, metric) not in self._sums:
            self._sums[pair, metric] = _OverClips(NanMean.of(self._resamples))
        sums = self._sums[pair, metric]
        sums.differences.add(difference)
        sums.blocks += blocks
        sums.clips += 1

    def intervals(self) -> dict[tuple[Pair, str], Interval]:
        """Return by pair and metric the 95 % percentile interval, expanded for few blocks."""
        self._end_clip()
        self._clip = None
        return {key: _interval(self._sums[key]) for key in sorted(self._sums)}


def _interval(sums: _OverClips) -> Interval:
    return percentile_interval(sums.differences.mean, reach(sums.blocks, sums.clips))
