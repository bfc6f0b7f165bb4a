"""The interval of a share, as every table has it."""

from __future__ import annotations


def wilson_interval(share: float, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return the ends of Wilson's score interval of a share.

    Args:
        share: of the units, 0 to 1; it may be a mean of shares.
        n: units, at least one.
        level: of the interval.
    """
    # It takes a second to import, and few commands need it.
    from statsmodels.stats.proportion import (  # type: ignore[import-untyped]  # no types
        proportion_confint,
    )

    low, high = proportion_confint(share * n, n, alpha=1.0 - level, method="wilson")
    return float(low), float(high)
