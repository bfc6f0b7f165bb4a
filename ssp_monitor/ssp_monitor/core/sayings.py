"""Warnings whose figures move: each is one warning, with its newest figures."""

from __future__ import annotations

import re

MOST = 1000
# A number that stands by itself; one within a name is part of the name.
_FIGURES = re.compile(r"(?<![\w/])\d+(?:\.\d+)?(?!\w)")


class Sayings:
    """What was said, at most MOST different things, in the order in which each was said first."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def say(self, text: str) -> bool:
        """Notes a sentence; whether it is new, other than by its figures."""
        key = _FIGURES.sub("#", text)
        fresh = key not in self._texts
        if not fresh or len(self._texts) < MOST:
            self._texts[key] = text
        return fresh

    def texts(self) -> list[str]:
        return list(self._texts.values())
