"""Labels of a clip drawn in blocks, since neighbours resemble each other; and what few blocks cost.

The circular block bootstrap (Politis and Romano 1992): b consecutive labels are drawn together, the
first one following the last. Every label is drawn as often as every other, whatever its place.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_eval.analysis.resample import LEVEL, Numbers, counted, draws, student_quantile


def block_of(count: int, wanted: int | None = None) -> int:
    """How many labels are drawn together: the rounded cube root of their number.

    That is the order of length at which the variance of a mean is estimated best (Hall, Horowitz
    and Jing 1995); 2 for nine labels, 3 for 27, 4 for 64. At least two blocks fit into the clip.

    Args:
        count: labels of the clip.
        wanted: another length, which is cut to half of the clip.
    """
    length = round(count ** (1 / 3)) if wanted is None else wanted
    return max(1, min(length, count // 2))


def block_draws(count: int, block: int, resamples: int, rng: np.random.Generator) -> Numbers:
    """How often each of count labels is drawn in resamples of count labels.

    The last block of a resample is cut where it would be one label too many.

    Returns:
        (resamples, count), each row summing to count.
    """
    if block == 1:
        return draws(count, resamples, rng)
    starts = rng.integers(0, count, size=(resamples, -(-count // block)))
    picked = (starts[:, :, None] + np.arange(block)) % count
    return counted(picked.reshape(resamples, -1)[:, :count], count)


def without_blocks(count: int, block: int) -> Numbers:
    """Weights with each block of consecutive labels left out in turn, for a jackknife.

    Returns:
        (count, count).
    """
    places = np.arange(count)
    apart = (places[None, :] - places[:, None]) % count
    return (apart >= block).astype(np.float64)


def reach(blocks: float, groups: int = 1, level: float = LEVEL) -> float | None:
    """How far from the middle an interval ends, in standard deviations of a normal distribution.

    A resample varies less than the data by 1 − 1/K with K blocks, and K is small. The expanded
    percentile interval (Hesterberg 2015) ends further out: √(K / (K − G)) t, with t Student's
    quantile with K − G degrees of freedom and G groups that are drawn from apart.

    Args:
        blocks: K, that were drawn from in all groups.
        groups: G, such as clips.
        level: of confidence.

    Returns:
        None where there is nothing to tell a spread from.
    """
    free = blocks - groups
    if free <= 0.0:
        return None
    return student_quantile(free, level) * math.sqrt(blocks / free)
