"""What a benchmark prints: one JSON line per figure, read by ``ssp bench``."""

from __future__ import annotations

import json


def percentile(values: list[float], share: float) -> float:
    """The value below which that share of the values lies, by the nearest rank."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def report(name: str, ours: float, bound: float, unit: str, note: str, *, lower: bool) -> None:
    """Prints a figure beside its bound.

    Args:
        name: what was measured.
        ours: the product's figure.
        bound: the lower bound's figure, same unit.
        unit: of both.
        note: sizes and counts that the figure depends on.
        lower: True where less is better. The ratio is always "times as bad as the bound".
    """
    ratio = ours / bound if lower else bound / ours
    print(
        json.dumps(
            {
                "name": name,
                "ours": ours,
                "bound": bound,
                "unit": unit,
                "ratio": ratio,
                "note": note,
            }
        ),
        flush=True,
    )
