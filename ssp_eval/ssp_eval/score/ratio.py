"""The one way in which a sum becomes a ratio (METHOD 6.11)."""

from __future__ import annotations


def ratio(total: float, denominator: int) -> float | None:
    """total / denominator, and None (shown as ``–``) when the denominator is 0 (METHOD 6.11).

    A total of fractions is one of math.fsum, so that the order of its terms doesn't matter.
    """
    return total / denominator if denominator else None
