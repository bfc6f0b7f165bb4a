"""How late messages were sent, in a memory that doesn't grow with their number."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

# Each step of the scale is a twentieth of a factor of two: 3.5 %.
_STEPS = 20


@dataclass(slots=True)
class Lateness:
    """Counts on a logarithmic scale; the largest value and the number are exact."""

    count: int = 0
    most_ns: int = 0
    _counts: Counter[int] = field(default_factory=Counter)

    def add(self, late_ns: int) -> None:
        """One more message; what was sent early counts as in time."""
        late_ns = max(late_ns, 0)
        self.count += 1
        self.most_ns = max(self.most_ns, late_ns)
        self._counts[math.ceil(_STEPS * math.log2(late_ns)) if late_ns else -1] += 1

    def quantile_ns(self, share: float) -> int:
        """At least this share of the messages was not later than this; at most 4 % too large.

        Args:
            share: from 0 to 1.
        """
        wanted = math.ceil(share * self.count)
        seen = 0
        for step in sorted(self._counts):
            seen += self._counts[step]
            if seen >= wanted:
                return min(round(2.0 ** (step / _STEPS)) if step >= 0 else 0, self.most_ns)
        return self.most_ns
