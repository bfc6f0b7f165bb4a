"""Sentences with the slots that a careful reader takes from them, and how the rules do on a table.

A rule may leave a slot empty; what counts above all is that it fills none wrongly.
"""

from __future__ import annotations

from collections.abc import Iterable

from ssp_eval.data.records import Slot
from ssp_eval.extract import extract
from ssp_eval.extract.measure.counts import Score

SHORT = {"o": "objects", "p": "position", "m": "motion", "c": "conflict",
         "lon": "lon_action", "lat": "lat_action"}  # fmt: skip


def told_by(slot: Slot | None) -> str | None:
    """A slot's value as the tables write it: classes with commas, ``-`` for nobody."""
    if slot is None:
        return None
    return slot.value if isinstance(slot.value, str) else ",".join(sorted(slot.value)) or "-"


def score(cases: Iterable[tuple[str, str]], slots: Iterable[str]) -> Score:
    """The rules on texts with expectations such as ``o=car p=front``, over some slots."""
    names, found = tuple(slots), Score()
    for text, told in cases:
        parts = (part.split("=") for part in told.split())
        wanted = {SHORT.get(name, name): ",".join(sorted(v.split(","))) for name, v in parts}
        given = extract(text)
        for name in names:
            value = told_by(getattr(given, name))
            right = value is not None and value == wanted.get(name)
            found.add(value is not None, name in wanted, right)
    return found


def holds(found: Score, precision: float, recall: float) -> bool:
    """Whether a score is at least as good; its shares are shown by pytest where it isn't."""
    assert found.precision.value is not None
    assert found.recall.value is not None
    assert (found.precision.value, found.recall.value) >= (precision, 0.0), found
    assert found.recall.value >= recall, found
    return True
