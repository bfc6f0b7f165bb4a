"""How the tables of words are written.

Phrases are given in the words of stage 1: lower case, hyphens as spaces, ``not`` for n't. Of
phrases that start at the same word the longest wins; a phrase stands in one table only.
"""

from __future__ import annotations

Table = dict[str, tuple[str, ...]]


def phrases(text: str) -> tuple[str, ...]:
    """The phrases of a comma-separated list."""
    return tuple(" ".join(phrase.split()) for phrase in text.split(","))
