"""A model's text with the evidence of each slot marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class Segment:
    """A piece of text and the slots that it is evidence for."""

    text: str
    slots: tuple[str, ...]


def segments(text: str, evidence: Mapping[str, Sequence[tuple[int, int]]]) -> tuple[Segment, ...]:
    """Cuts a text where evidence begins and ends; spans may overlap, and may lie outside.

    Args:
        text: raw.
        evidence: per slot its half-open character spans.

    Returns:
        Pieces whose texts put together are the text.
    """
    inside = {
        slot: [(max(0, a), min(len(text), b)) for a, b in spans if max(0, a) < min(len(text), b)]
        for slot, spans in evidence.items()
    }
    cuts = sorted({0, len(text), *(cut for spans in inside.values() for s in spans for cut in s)})
    return tuple(
        Segment(
            text[start:end],
            tuple(slot for slot, spans in inside.items() if any(a <= start < b for a, b in spans)),
        )
        for start, end in pairwise(cuts)
    )
