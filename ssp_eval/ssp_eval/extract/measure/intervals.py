"""Shares with their intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

Z_95 = 1.959963984540054  # quantile of the normal distribution for two-sided 95 %


@dataclass(frozen=True)
class Share:
    """So many of so many.

    Args:
        part: that have the property.
        whole: that could have it.
    """

    part: int
    whole: int

    @property
    def value(self) -> float | None:
        """The share; None of nothing."""
        return self.part / self.whole if self.whole else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its 95 % interval by Wilson; None of nothing."""
        return wilson(self.part, self.whole)


def wilson(part: int, whole: int) -> tuple[float, float] | None:
    """Wilson's 95 % score interval of a share; None of nothing.

    Raises:
        ValueError: the part is none of the whole.
    """
    if not 0 <= part <= whole:
        raise ValueError(f"{part} of {whole} is no share")
    if whole == 0:
        return None
    share, z2 = part / whole, Z_95 * Z_95
    middle = (share + z2 / (2 * whole)) / (1 + z2 / whole)
    half = Z_95 / (1 + z2 / whole)
    half *= math.sqrt(share * (1 - share) / whole + z2 / (4 * whole * whole))
    # Rounding must not put the ends beyond what is possible, or the share outside.
    low = 0.0 if part == 0 else min(max(middle - half, 0.0), share)
    high = 1.0 if part == whole else max(min(middle + half, 1.0), share)
    return low, high
