"""The one way in which a sum becomes a ratio (METHOD 6.11)."""

from __future__ import annotations

import math
from collections.abc import Iterable


def ratio(terms: Iterable[float], denominator: int) -> float | None:
    """Σ terms / denominator, and None (shown as ``–``) when the denominator is 0 (METHOD 6.11).

    The sum is exactly rounded, so the order of the terms doesn't matter.
    """
    return math.fsum(terms) / denominator if denominator else None
