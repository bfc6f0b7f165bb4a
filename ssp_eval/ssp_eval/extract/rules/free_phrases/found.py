"""What a finder of free phrases gives."""

from __future__ import annotations

# The verb that the phrase means, its form, its first word and the word after it.
Found = tuple[str, str, int, int]
# Marks between which a phrase stands alone.
ENDS = frozenset({".", "?", "\n", ",", ";", ":", '"', "|", "[", "=", "("})
