"""Rating of two curves by ISO/TS 18571: corridor, phase, magnitude and slope (docs/audit.md).

`objective-rating-metrics` computes it. Here are its preconditions, which it doesn't check, and the
machine code of its time warping, which it would compile anew in every process.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from ssp_core.geometry import FloatArray

# The slope's mean runs over nine samples, and phase may cut a fifth off both curves.
MIN_SAMPLES = 12
# Half widths of the corridors, as shares of the reference's largest absolute value.
INNER, OUTER = 0.05, 0.5
# Correlations that differ by less are equal.
_AS_GOOD = 1e-9
# The warping holds a matrix of so many samples squared.
MAX_SAMPLES = 2500
# With these the package draws, which is never asked of it; they bring pandas and pyarrow, 130 MB.
_DRAWING = ("matplotlib", "matplotlib.pyplot", "networkx", "seaborn")


@dataclass(frozen=True, slots=True)
class Rating:
    """The four parts and their weighted mean (0.4, 0.2, 0.2, 0.2), each from 0 to 1."""

    overall: float
    corridor: float
    phase: float
    magnitude: float
    slope: float


def rate(reference: FloatArray, comparison: FloatArray, step_s: float) -> Rating:
    """Rate a curve against a reference with the parameters of ISO/TS 18571.

    Args:
        reference: samples at a constant step, shape (n,).
        comparison: samples at the same times, shape (n,), same unit.
        step_s: time between samples, s.

    Raises:
        ValueError: the lengths differ, are too small or too large, a sample isn't finite, or a
            curve is constant, so that there is no correlation to look for.
    """
    if reference.ndim != 1 or reference.shape != comparison.shape:
        raise ValueError(f"curves of shapes {reference.shape} and {comparison.shape} differ")
    if not MIN_SAMPLES <= len(reference) <= MAX_SAMPLES:
        raise ValueError(f"{len(reference)} samples aren't {MIN_SAMPLES} to {MAX_SAMPLES}")
    if not (np.isfinite(reference).all() and np.isfinite(comparison).all()):
        raise ValueError("a sample isn't finite")
    if np.ptp(reference) == 0.0 or np.ptp(comparison) == 0.0:
        raise ValueError("a constant curve can't be rated")
    times_s = step_s * np.arange(len(reference))
    curves = [np.column_stack([times_s, curve]) for curve in (reference, comparison)]
    # A part of a curve that a shift leaves over may be constant; it has no correlation.
    with np.errstate(invalid="ignore", divide="ignore"):
        rated = _metric()(*curves, dt=step_s)
        return Rating(
            overall=_share(rated.overall_rating(-1)),
            corridor=_share(rated.corridor_rating(-1)),
            phase=_share(rated.phase_rating(-1)),
            magnitude=_share(rated.magnitude_rating(-1)),
            slope=_share(rated.slope_rating(-1)),
        )


def _share(value: float) -> float:
    return min(1.0, max(0.0, float(value)))


@cache
def _metric() -> Any:
    """Return the package's class; imported here, since numba comes with it."""
    with _without_drawing():
        metric = importlib.import_module("objective_rating_metrics.rating").ISO18571
    for module, function in (("cost", "_calc_cumsum_matrix_jit"), ("backtrack", "_backtrack_jit")):
        compiled = getattr(importlib.import_module(f"dtwalign.{module}"), function)
        with suppress(RuntimeError):  # no folder can be written: it is compiled once a process
            compiled.enable_caching()
    return type("Metric", (metric,), {"_get_shifted_curve_and_pr": _shifted})


@contextmanager
def _without_drawing() -> Iterator[None]:
    """Keep packages for drawing that aren't loaded from being loaded by what is imported here."""
    absent = [name for name in _DRAWING if name not in sys.modules]
    sys.modules.update((name, ModuleType(name)) for name in absent)
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


def _shifted(metric: Any) -> tuple[FloatArray, FloatArray, int, float]:
    """Return both curves after the best-correlated shift, the shift, and the correlation.

    It takes the place of the package's own: of shifts that correlate equally well the least one
    counts, and on straight pieces the last digit would choose.
    """
    reference, comparison = metric.reference_curve, metric.comparison_curve

    def correlation(pair: tuple[FloatArray, FloatArray]) -> float:
        return float(np.corrcoef(pair[0][:, 1], pair[1][:, 1])[0, 1])

    best, steps = (reference, comparison), 0
    highest = correlation(best)
    for k in range(1, int(len(comparison) * metric._max_shift) + 1):
        for pair in ((reference[:-k], comparison[k:]), (reference[k:], comparison[:-k])):
            coefficient = correlation(pair)
            if coefficient > highest + _AS_GOOD:
                best, steps, highest = pair, k, coefficient
    return best[1].copy(), best[0].copy(), steps, highest
