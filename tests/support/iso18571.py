"""ISO/TS 18571 a second time, written from its definition for the tests and slow on purpose.

C. Gehre, H. Gades and P. Wernicke, Objective rating of signals using test and simulation responses
(ESV 2009, 09-0407), and the parameters of ISO/TS 18571: corridors of 0.05 and 0.5 of the largest
absolute value with exponent 2; shifts of at most 0.2 of the length; magnitude bound 0.5 behind a
warping of squared differences in a band of 0.1 of the length; slope bound 2.0 on central
differences, smoothed over nine samples; weights 0.4, 0.2, 0.2, 0.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

WEIGHTS = {"corridor": 0.4, "phase": 0.2, "magnitude": 0.2, "slope": 0.2}


def rating(
    reference: Sequence[float], comparison: Sequence[float], step_s: float
) -> dict[str, float]:
    """The four parts and ``overall``, by name."""
    shift = best_shift(reference, comparison)
    # A comparison that is late loses its first samples, the reference its last ones.
    n = len(reference) - abs(shift)
    first = list(reference[max(0, -shift) :][:n])
    second = list(comparison[max(0, shift) :][:n])
    most = 0.2 * len(reference)
    parts = {
        "corridor": corridor(reference, comparison),
        "phase": max(0.0, (most - abs(shift)) / most),
        "magnitude": magnitude(first, second),
        "slope": slope(first, second, step_s),
    }
    return {**parts, "overall": sum(WEIGHTS[name] * value for name, value in parts.items())}


def corridor(reference: Sequence[float], comparison: Sequence[float]) -> float:
    """Mean of 1 inside the inner corridor, 0 outside the outer one, a parabola between them."""
    norm = max(abs(value) for value in reference)
    inner, outer = 0.05 * norm, 0.5 * norm
    total = 0.0
    for a, b in zip(reference, comparison, strict=True):
        off = abs(a - b)
        total += (
            1.0 if off < inner else 0.0 if off > outer else ((outer - off) / (outer - inner)) ** 2
        )
    return total / len(reference)


def best_shift(reference: Sequence[float], comparison: Sequence[float]) -> int:
    """The shift in samples with the largest correlation, + where the comparison is late; of equal
    ones the smallest."""
    most = int(0.2 * len(reference))
    found = {m: correlation(reference, comparison, m) for m in range(-most, most + 1)}
    return min(found, key=lambda m: (-round(found[m], 12), abs(m)))


def correlation(reference: Sequence[float], comparison: Sequence[float], shift: int) -> float:
    """Correlate the overlap when the comparison is moved to the left by a shift."""
    n = len(reference) - abs(shift)
    first = reference[max(0, -shift) :][:n]
    second = comparison[max(0, shift) :][:n]
    means = sum(first) / n, sum(second) / n
    product = sum((a - means[0]) * (b - means[1]) for a, b in zip(first, second, strict=True))
    spread = sum((a - means[0]) ** 2 for a in first) * sum((b - means[1]) ** 2 for b in second)
    return product / spread**0.5 if spread > 0.0 else -1.0


def magnitude(reference: Sequence[float], comparison: Sequence[float]) -> float:
    """Rate the difference that is left after dynamic time warping, over the warped reference."""
    path = warping_path(reference, comparison)
    off = sum(abs(reference[i] - comparison[j]) for i, j in path)
    off /= sum(abs(reference[i]) for i, _ in path)
    return min(1.0, max(0.0, (0.5 - off) / 0.5))


def warping_path(reference: Sequence[float], comparison: Sequence[float]) -> list[tuple[int, int]]:
    """Pairs of indices with the smallest sum of squared differences, inside the band.

    The definition leaves open whether the band holds its border; here it doesn't. With it,
    magnitude changes by less than 0.001 for curves of 3 s.
    """
    n = len(reference)
    band = math.ceil(0.1 * n) - 1
    cost: dict[tuple[int, int], float] = {(-1, -1): 0.0}
    came: dict[tuple[int, int], tuple[int, int]] = {}
    far = float("inf")
    for i in range(n):
        for j in range(max(0, i - band), min(n, i + band + 1)):
            before = min(((i - 1, j - 1), (i - 1, j), (i, j - 1)), key=lambda k: cost.get(k, far))
            came[i, j] = before
            cost[i, j] = cost.get(before, far) + (reference[i] - comparison[j]) ** 2
    path = [(n - 1, n - 1)]
    while (before := came[path[-1]]) != (-1, -1):
        path.append(before)
    return path[::-1]


def slope(reference: Sequence[float], comparison: Sequence[float], step_s: float) -> float:
    """Rate the difference of the smoothed slopes, over the reference's."""
    first, second = (smoothed_slope(curve, step_s) for curve in (reference, comparison))
    off = sum(abs(a - b) for a, b in zip(first, second, strict=True))
    off /= sum(abs(a) for a in first)
    return min(1.0, max(0.0, (2.0 - off) / 2.0))


def smoothed_slope(curve: Sequence[float], step_s: float) -> list[float]:
    """Central differences, one-sided at the ends, then a mean over nine samples, over fewer at the
    ends so that it stays symmetric."""
    n = len(curve)
    steep = [
        (curve[min(i + 1, n - 1)] - curve[max(i - 1, 0)])
        / (step_s * (min(i + 1, n - 1) - max(i - 1, 0)))
        for i in range(n)
    ]
    mean = []
    for i in range(n):
        half = min(4, i, n - 1 - i)
        window = steep[i - half : i + half + 1]
        mean.append(sum(window) / len(window))
    return mean
