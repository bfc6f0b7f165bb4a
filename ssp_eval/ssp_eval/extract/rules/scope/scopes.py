"""Stage 4: which hits are asserted about the present, and which are not, and why not."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.echoes import mark_echoes
from ssp_eval.extract.rules.scope.in_force import Sentence

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


def scopes(words: list[str], hits: list[Hit], ranges: list[tuple[int, int]]) -> list[int]:
    """The flags of every hit, in the order of the hits."""
    flags = [0] * len(hits)
    for start, stop in ranges:
        Sentence(words, hits, flags, start, stop).run()
    mark_echoes(words, hits, flags, ranges)
    return flags
