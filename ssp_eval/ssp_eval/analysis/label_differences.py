"""How far the difference of two models depends on which moments of their clips were labelled.

A paired bootstrap: all models of a clip are drawn the same labels (ssp_eval.analysis.bootstrap), so
what is hard to see is hard for both, and the difference of their scores varies less than either.
It has an interval with a single clip too, which then speaks of that clip alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ssp_eval.analysis.blocks import reach
from ssp_eval.analysis.compare import COMPARED, TESTED
from ssp_eval.analysis.resample import NO_INTERVAL, Interval, Numbers, percentile_interval

# Of more models than the first number only IVCS is compared, of more than the second nothing: each
# pair and metric keeps a number per resample.
MOST_MODELS, MOST_BY_IVCS = 12, 60

Pair = tuple[str, str]
# Scenario, domain and number of labels: what is drawn alike.
Clip = tuple[str, str, int]


def compared_metrics(models: Collection[str]) -> tuple[str, ...]:
    """The metrics whose differences are looked at between so many models."""
    if len(models) > MOST_BY_IVCS:
        return ()
    return COMPARED if len(models) <= MOST_MODELS else (TESTED,)


@dataclass
class _Sum:
    """Over clips, resample by resample.

    Args:
        total: of the differences that aren't null.
        count: of these.
        blocks: of labels that were drawn from, in all clips.
        clips: how many.
    """

    total: Numbers
    count: Numbers
    blocks: float = 0.0
    clips: int = 0


class LabelDifferences:
    """Sums over clips of the differences of each two models, first less second by name.

    Args:
        metrics: that are compared.
        resamples: how many there are.
    """

    def __init__(self, metrics: Sequence[str], resamples: int) -> None:
        self._metrics, self._resamples = tuple(metrics), resamples
        self._clip: tuple[Clip, int] | None = None
        self._models: dict[str, Mapping[str, Numbers]] = {}
        self._sums: dict[tuple[Pair, str], _Sum] = {}

    def add(self, model: str, clips: Mapping[Clip, int], samples: Mapping[str, Numbers]) -> None:
        """A model's resampled scores on a clip; all models of a clip come together.

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
        there = ~np.isnan(difference)
        if not there.any():
            return
        found = self._sums.get((pair, metric))
        if found is None:
            found = _Sum(np.zeros(self._resamples), np.zeros(self._resamples))
            self._sums[pair, metric] = found
        found.total += np.where(there, difference, 0.0)
        found.count += there
        found.blocks += blocks
        found.clips += 1

    def intervals(self) -> dict[tuple[Pair, str], Interval]:
        """By pair and metric the 95 % percentile interval, expanded for few blocks."""
        self._end_clip()
        self._clip = None
        return {key: _interval(self._sums[key]) for key in sorted(self._sums)}


def _interval(found: _Sum) -> Interval:
    if found.blocks <= found.clips:
        return NO_INTERVAL
    samples = np.full_like(found.total, np.nan)
    np.divide(found.total, found.count, out=samples, where=found.count > 0)
    return percentile_interval(samples, reach(found.blocks, found.clips))
