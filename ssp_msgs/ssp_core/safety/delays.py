"""One constant delay between an object's places and the motion that it states (METHOD 4.3b).

Place, heading and speed may be measured at different times, but always as far apart: a delay that
explains one window must explain those before it too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

# Parts of one state may be measured so far apart.
DELAY_S = 0.3
# Half a step changes less than any bound: 0.25 m/s at 10 m/s^2.
_STEP_S = 0.05
DELAYS_S = tuple(round(_STEP_S * k, 3) for k in range(-6, 7))
# A delay that didn't fit for so long on end isn't the one, for as long as this.
_OUT_AFTER_S = 0.5
_OUT_FOR_S = 10.0


class Delays:
    """The members of DELAYS_S that explain the latest observations.

    One is believed until it is out; while it fits nothing else is tried.
    """

    def __init__(self) -> None:
        self._off_since: list[float | None] = [None] * len(DELAYS_S)
        self._out_until = [-math.inf] * len(DELAYS_S)
        self._believed = DELAYS_S.index(0.0)
        self._none_off = True
        # Nothing needs a delay: none is believed, and none is in doubt.
        self.is_at_rest = True

    @property
    def believed_s(self) -> float:
        """The delay that explains what came so far; 0 until it doesn't."""
        return DELAYS_S[self._believed]

    def begin_anew(self) -> None:
        """Forget which delays don't fit now; what is out stays so."""
        if not self._none_off:
            self._off_since = [None] * len(DELAYS_S)
            self._none_off = True
            self.is_at_rest = self.believed_s == 0.0

    def possible(self, now_s: float) -> list[float]:
        """Give the delays that aren't out."""
        return [d for d, until_s in zip(DELAYS_S, self._out_until, strict=True) if until_s < now_s]

    def take(self, now_s: float, fits: Iterable[bool]) -> bool:
        """Take which delays fit a window that the believed one doesn't fit.

        Args:
            now_s: end of the window, s, rising.
            fits: for each of DELAYS_S.

        Returns:
            True where one that fits is still possible.
        """
        fitting = []
        self._none_off = self.is_at_rest = False
        for k, one in enumerate(fits):
            if one:
                self._off_since[k] = None
                if self._out_until[k] < now_s:
                    fitting.append(k)
                continue
            since_s = self._off_since[k]
            if since_s is None:
                self._off_since[k] = since_s = now_s
            if now_s - since_s >= _OUT_AFTER_S:
                self._out_until[k] = now_s + _OUT_FOR_S
        if fitting and self._out_until[self._believed] >= now_s:
            self._believed = fitting[len(fitting) // 2]
        return bool(fitting)
