"""Windows on end in which an object's stated motion contradicts its places (METHOD 4.3b).

This file owns the present contradiction and the doubt that it leaves, and says what ends each.
Reads no clock: times are given, in s, and rise.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.safety.window import OTHER_SPEED

# A contradiction ends a session when it holds for so long on end; a shorter one is kept in mind
# from so many windows on: single places may be wrong by more than three sigma.
HOLDS_S = 0.5
_DOUBT_S = 0.1
_DOUBT_WINDOWS = 3


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Windows on end in which what is stated doesn't fit the places.

    Args:
        kind: what explains it best, for people.
        text: kind, with the newest window's figures.
        held_s: from the first of them to the newest.
        windows: how many.
        moving: the object moved meanwhile, by its places.
    """

    kind: str
    text: str
    held_s: float
    windows: int
    moving: bool

    @property
    def holds(self) -> bool:
        """It has held long enough to end a session."""
        return self.held_s >= HOLDS_S


_NEVER = Contradiction("", "", 0.0, 0, False)


class MotionFindings:
    """The findings on one object's windows, as they come.

    Attributes:
        contradiction: of the newest windows; None: they agree, or there is none yet.
        doubt: the last contradiction, until the same object has moved without one for as long as
            a contradiction takes to hold.
    """

    def __init__(self) -> None:
        self.contradiction: Contradiction | None = None
        self.doubt: Contradiction | None = None
        self._since_s = 0.0
        self._kinds: dict[str, float] = {}  # with their weights, of the present contradiction
        self._agrees_since_s: float | None = None

    def interrupt(self) -> None:
        """End the contradiction without a proof that it is mended."""
        self.contradiction = None
        self._agrees_since_s = None

    def agree(self, now_s: float, *, moves: bool) -> None:
        """Take a window that agrees.

        Args:
            now_s: its end.
            moves: the object moves in it.
        """
        self.contradiction = None
        doubt = self.doubt
        if doubt is None:
            return
        if doubt.moving and not moves:
            self._agrees_since_s = None
        elif self._agrees_since_s is None:
            self._agrees_since_s = now_s
        elif now_s - self._agrees_since_s >= HOLDS_S:
            self.doubt = None

    def contradict(
        self,
        now_s: float,
        kind: str,
        weight: float,
        figures: str,
        *,
        moves: bool,
        other_speed: str = OTHER_SPEED,
    ) -> Contradiction:
        """Take a window that contradicts; return the contradiction that it is part of.

        Args:
            now_s: its end.
            kind: what explains it best.
            weight: of this explanation among those of the windows before.
            figures: of the window, for people.
            moves: the object moves in it, by its places.
            other_speed: what all windows of this contradiction say of a speed that is off.
        """
        before = self.contradiction
        if before is None:
            self._since_s = now_s
            self._kinds.clear()
        self._kinds[kind] = self._kinds.get(kind, 0.0) + weight
        kind = max(self._kinds, key=self._kinds.__getitem__)
        kind = other_speed if kind == OTHER_SPEED else kind
        contradiction = self.contradiction = Contradiction(
            kind,
            f"{kind}: {figures}",
            now_s - self._since_s,
            1 if before is None else before.windows + 1,
            moves or (before or self.doubt or _NEVER).moving,
        )
        self._agrees_since_s = None
        if contradiction.windows >= _DOUBT_WINDOWS and contradiction.held_s >= _DOUBT_S:
            self.doubt = contradiction
        return contradiction
