"""Where the sentences of a text begin and end."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind

SENTENCE_MARKS = frozenset({".", "?", "\n"})


def sentences(hits: list[Hit]) -> list[tuple[int, int]]:
    """The half-open ranges of hits between full stops, question marks and line breaks."""
    ranges = []
    start = 0
    for index, hit in enumerate(hits):
        if hit.kind is Kind.MARK and hit.value in SENTENCE_MARKS:
            ranges.append((start, index + 1))
            start = index + 1
    if start < len(hits):
        ranges.append((start, len(hits)))
    return ranges
